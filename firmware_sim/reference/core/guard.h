/* Safety monitor of the coil: checks every sample of a run, independent of the host (5, rules 4, 7 and 8). */
#ifndef GUARD_H
#define GUARD_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"
#include "plausibility.h"
#include "thermal.h"

/* The temperature and the newest positions are kept as long as the device has power; guard_begin resets the rest. */
struct guard {
    const struct board_properties *device;
    struct winding winding;
    struct plausibility plausibility;
    double newest_m[3]; /* oldest first */
    uint32_t positions; /* number of them that were read */
    uint32_t lift_samples;
    uint32_t release_samples;
    bool lifted;
};

void guard_init(struct guard *guard, const struct board_properties *device);

/* Start the monitoring of a run under these limits. */
void guard_begin(struct guard *guard, const struct limits *limits);

/* Return a command, V, lowered if the motion of the coil would raise its force above the limit. */
double guard_lowered(const struct guard *guard, double volts, const struct limits *limits);

/* Return the fault of a sample of the run; first counts the samples from the start, with those of the release. */
uint16_t guard_judge(struct guard *guard, const struct readings *readings, const struct limits *limits,
                     uint32_t first);

/* Update temperature and positions with a sample, played or not. */
void guard_update(struct guard *guard, const struct readings *readings);

#endif
