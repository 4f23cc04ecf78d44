/* Plausibility of the sensors: position against force, current against voltage, in blocks of 10 ms (5, rule 8). */
#ifndef PLAUSIBILITY_H
#define PLAUSIBILITY_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"

#define FROZEN_BLOCKS 10u

/* Summary of a block of 10 ms: means, and the smallest and largest codes. */
struct summary {
    double asked_v;    /* |command| */
    double measured_v; /* |voltage| */
    double drawn_a;    /* |current| */
    double mean_v;
    double force_n;
    double position_m;
    int16_t current_low;
    int16_t current_high;
    int16_t position_low;
    int16_t position_high;
};

struct plausibility {
    struct summary history[FROZEN_BLOCKS]; /* ring; the newest at newest */
    struct summary sums;                   /* of the block in progress */
    uint32_t newest;
    uint32_t blocks;
    uint32_t in_block;
    uint32_t block_samples;
    double jump_m;
    double last_position_m;
    double force_constant_n_per_a;
    double resistance_ohm;
    bool has_position;
    bool near_end; /* the probe may press on the near end, where the converter ends, too */
};

void plausibility_init(struct plausibility *checks, const struct board_properties *device);

/* Start a run. */
void plausibility_begin(struct plausibility *checks, bool near_end);

/* Process a sample of a run; return FAULT_SENSOR, FAULT_OPEN_COIL or FAULT_NONE. */
uint16_t plausibility_check(struct plausibility *checks, const struct readings *readings);

#endif
