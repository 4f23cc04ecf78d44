/* Limits of one test, as agreed by ARM, and the check of a sample against them (5, rules 3 and 4). */
#ifndef LIMITS_H
#define LIMITS_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"

struct limits {
    double max_force_n;
    double min_position_m;
    double max_position_m;
    double max_temperature_c;
    uint32_t max_samples;
};

/* Physical values of a sample that the checks need. */
struct readings {
    double command_v;
    double voltage_v;
    double current_a;
    double position_m;
    double temperature_c;
    int16_t current_code;
    int16_t position_code;
    int16_t temperature_code;
    bool button;
};

/* Whether all limits are finite and valid, none exceeds that of the device, and a reading can lie within each. */
bool limits_valid(const struct limits *limits, const struct board_properties *device);

/* Whether the force of a command at rest lies within the limit. Motion against the force increases it: guard.h. */
bool limits_permit(const struct limits *limits, double volts, const struct board_properties *device);

/* Whether the probe is inside the near limit. */
bool limits_off_near_end(const struct limits *limits, const struct readings *readings);

/* Return the first limit that a sample violates, as a fault. sample counts those of the run without the release;
 * lifted is false while the probe may still rest at the near end. A reading at the end of its converter violates the
 * limit on that side, which the converter could not read beyond. */
uint16_t limits_violated(const struct limits *limits, const struct readings *readings,
                         const struct board_properties *device, int64_t sample, bool lifted);

#endif
