/* Transmit queue: whole frames that wait for the line, numbered in the order of creation. */
#ifndef OUTBOX_H
#define OUTBOX_H

#include <stddef.h>
#include <stdint.h>

#include "frames.h"

/* A ring of bytes. Frames that do not fit are dropped whole and counted. */
struct outbox {
    uint8_t bytes[TRANSMIT_BYTES];
    size_t first;
    size_t used;
    uint16_t sequence;
    uint32_t dropped_frames;
    uint8_t encoded[MAX_ENCODED + 1u];
};

void outbox_init(struct outbox *outbox);

/* Queue a frame; a dropped one leaves a gap in the sequence numbers. */
void outbox_put(struct outbox *outbox, uint8_t type, uint64_t time_us, uint64_t index, const uint8_t *payload,
                size_t size);

/* Return the number of contiguous bytes that can be sent next, and where they are. */
size_t outbox_next(const struct outbox *outbox, const uint8_t **bytes);

/* Remove bytes that were sent. */
void outbox_sent(struct outbox *outbox, size_t count);

#endif
