/* Memory for one stimulus: announced, filled in chunks, verified, and played from (4.3). */
#ifndef STIMULUS_H
#define STIMULUS_H

#include <stddef.h>
#include <stdint.h>

#include "config.h"
#include "messages.h"

struct stimulus {
    int16_t codes[STIMULUS_CAPACITY];
    uint32_t samples;
    uint32_t id;
    uint32_t crc;
    int16_t lowest; /* smallest and largest code, after a commit */
    int16_t highest;
};

void stimulus_init(struct stimulus *stimulus);

/* Announce a stimulus, which replaces the previous one; all its codes are 0. */
enum result stimulus_begin(struct stimulus *stimulus, uint32_t id, uint32_t samples, uint32_t crc, uint64_t *detail);

/* Store a chunk of codes, size bytes, from sample offset on. */
enum result stimulus_chunk(struct stimulus *stimulus, uint32_t id, uint32_t offset, const uint8_t *codes, size_t size,
                           uint64_t *detail);

/* Verify that the stimulus is complete, and find its extremes. */
enum result stimulus_commit(struct stimulus *stimulus, uint32_t id, uint64_t *detail);

void stimulus_forget(struct stimulus *stimulus);

#endif
