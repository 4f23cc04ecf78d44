#include "limits.h"

#include <math.h>

#include "messages.h"

/* Ratio of the trip to the limit, so that converter noise on a test at the limit does not end it. */
static const double FORCE_MARGIN = 1.05;

/* Up to this force limit the probe may press against the ends of its stroke, which locates them. */
static const double GENTLE_FORCE_N = 2.0;
static const double BEYOND_STROKE_M = 1.0e-3;

static bool gentle(const struct limits *limits)
{
    return limits->max_force_n <= GENTLE_FORCE_N;
}

bool limits_valid(const struct limits *limits, const struct board_properties *device)
{
    if (!isfinite(limits->max_force_n) || !isfinite(limits->min_position_m) || !isfinite(limits->max_position_m) ||
        !isfinite(limits->max_temperature_c)) {
        return false;
    }
    const double beyond = gentle(limits) ? BEYOND_STROKE_M : 0.0;
    const double step_n = device->channels[CURRENT].gain * device->force_constant_n_per_a;
    const struct channel *sensor = &device->channels[TEMPERATURE];
    const double coldest_c = sensor->offset + (double)INT16_MIN * sensor->gain;
    return limits->max_force_n >= step_n && limits->max_force_n <= device->max_force_n &&
           limits->min_position_m >= -beyond &&
           limits->max_position_m - limits->min_position_m >= device->channels[POSITION].gain &&
           limits->max_position_m <= device->stroke_m + beyond && limits->max_temperature_c >= coldest_c &&
           limits->max_temperature_c <= device->max_temperature_c && limits->max_samples > 0u &&
           limits->max_samples <= MAX_RUN_S * device->sample_rate_hz;
}

bool limits_permit(const struct limits *limits, double volts, const struct board_properties *device)
{
    const double newton_per_volt =
        device->amplifier_gain * device->force_constant_n_per_a / device->coil_resistance_ohm;
    return fabs(volts) * newton_per_volt <= limits->max_force_n * FORCE_MARGIN;
}

bool limits_off_near_end(const struct limits *limits, const struct readings *readings)
{
    return readings->position_m >= limits->min_position_m &&
           (gentle(limits) || readings->position_code > INT16_MIN);
}

static bool at_an_end(int16_t code)
{
    return code == INT16_MIN || code == INT16_MAX;
}

uint16_t limits_violated(const struct limits *limits, const struct readings *readings,
                         const struct board_properties *device, int64_t sample, bool lifted)
{
    if (fabs(readings->current_a) * device->force_constant_n_per_a > limits->max_force_n * FORCE_MARGIN ||
        at_an_end(readings->current_code)) {
        return FAULT_OVER_FORCE;
    }
    if ((lifted && !limits_off_near_end(limits, readings)) || readings->position_m > limits->max_position_m ||
        (!gentle(limits) && readings->position_code == INT16_MAX)) {
        return FAULT_STROKE;
    }
    if (readings->temperature_c > limits->max_temperature_c || readings->temperature_code == INT16_MAX) {
        return FAULT_OVER_TEMPERATURE;
    }
    if (sample >= (int64_t)limits->max_samples) {
        return FAULT_OVER_TIME;
    }
    return readings->button ? FAULT_BUTTON : FAULT_NONE;
}
