/* Answers to the newest requests: a repeated request gets the same answer and is not executed again (4.2). */
#ifndef ANSWERS_H
#define ANSWERS_H

#include <stddef.h>
#include <stdint.h>

#include "config.h"

struct answer {
    uint8_t type;
    uint16_t sequence;
    uint8_t result;
    uint64_t detail;
};

struct answers {
    struct answer kept[ANSWERS];
    size_t count;
    size_t oldest;
};

/* Forget all answers: a new host restarts its sequence numbers. */
void answers_clear(struct answers *answers);

/* Return the answer to a request, or NULL if it is new. */
const struct answer *answers_find(const struct answers *answers, uint8_t type, uint16_t sequence);

/* Keep an answer in place of the oldest. */
void answers_keep(struct answers *answers, const struct answer *answer);

#endif
