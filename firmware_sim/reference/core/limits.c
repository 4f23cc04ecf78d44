#include "limits.h"

#include <math.h>

#include "messages.h"

/* Ratio of the trip to the limit, so that converter noise on a test at the limit does not end it. */
static const double FORCE_MARGIN = 1.05;

/* Up to this force limit the probe may press against the ends of its stroke, which locates them. */
static const double GENTLE_FORCE_N = 2.0;
static const double BEYOND_STROKE_M = 1.0e-3;

bool limits_valid(const struct limits *limits, const struct board_properties *device)
{
    if (!isfinite(limits->max_force_n) || !isfinite(limits->min_position_m) || !isfinite(limits->max_position_m) ||
        !isfinite(limits->max_temperature_c)) {
        return false;
    }
    const double beyond = limits->max_force_n <= GENTLE_FORCE_N ? BEYOND_STROKE_M : 0.0;
    return limits->max_force_n > 0.0 && limits->max_force_n <= device->max_force_n &&
           limits->min_position_m >= -beyond && limits->min_position_m < limits->max_position_m &&
           limits->max_position_m <= device->stroke_m + beyond &&
           limits->max_temperature_c <= device->max_temperature_c && limits->max_samples > 0u &&
           limits->max_samples <= MAX_RUN_S * device->sample_rate_hz;
}

bool limits_permit(const struct limits *limits, double volts, const struct board_properties *device)
{
    const double newton_per_volt =
        device->amplifier_gain * device->force_constant_n_per_a / device->coil_resistance_ohm;
    return fabs(volts) * newton_per_volt <= limits->max_force_n * FORCE_MARGIN;
}

uint16_t limits_violated(const struct limits *limits, const struct readings *readings,
                         const struct board_properties *device, int64_t sample, bool lifted)
{
    if (fabs(readings->current_a) * device->force_constant_n_per_a > limits->max_force_n * FORCE_MARGIN) {
        return FAULT_OVER_FORCE;
    }
    if ((lifted && readings->position_m < limits->min_position_m) || readings->position_m > limits->max_position_m) {
        return FAULT_STROKE;
    }
    if (readings->temperature_c > limits->max_temperature_c) {
        return FAULT_OVER_TEMPERATURE;
    }
    if (sample >= (int64_t)limits->max_samples) {
        return FAULT_OVER_TIME;
    }
    return readings->button ? FAULT_BUTTON : FAULT_NONE;
}
