#include "guard.h"

#include <math.h>

#include "messages.h"

/* Predicted force, relative to its limit, above which a command is lowered; the trip is at 1.05. */
static const double FORCE_CEILING = 1.01;

void guard_init(struct guard *guard, const struct board_properties *device)
{
    guard->device = device;
    winding_init(&guard->winding, device->coil_resistance_ohm, device->sample_rate_hz);
    plausibility_init(&guard->plausibility, device);
    guard->positions = 0;
    guard->lift_samples = device->sample_rate_hz / 2u;     /* 0.5 s */
    guard->release_samples = device->sample_rate_hz / 20u; /* 50 ms */
    guard->lifted = false;
}

void guard_begin(struct guard *guard, const struct limits *limits)
{
    guard->lifted = false;
    plausibility_begin(&guard->plausibility, limits->min_position_m <= 0.0);
}

double guard_lowered(const struct guard *guard, double volts, const struct limits *limits)
{
    const struct board_properties *device = guard->device;
    if (guard->positions < 3u) {
        return volts;
    }
    /* The current follows the voltage within a sample: F = k (V - k v) / R, with the speed extrapolated to its start. */
    const double rate = (double)device->sample_rate_hz;
    const double before = (guard->newest_m[1] - guard->newest_m[0]) * rate;
    const double latest = (guard->newest_m[2] - guard->newest_m[1]) * rate;
    const double speed = latest + 0.5 * (latest - before);
    const double ceiling_v =
        FORCE_CEILING * limits->max_force_n * device->coil_resistance_ohm / device->force_constant_n_per_a;
    const double sign = volts < 0.0 ? -1.0 : 1.0;
    const double induced_v = device->force_constant_n_per_a * speed * sign;
    const double most_v = fmax(0.0, ceiling_v + induced_v) / device->amplifier_gain;
    return fabs(volts) > most_v ? sign * most_v : volts;
}

uint16_t guard_judge(struct guard *guard, const struct readings *readings, const struct limits *limits,
                     uint32_t first)
{
    if (limits_off_near_end(limits, readings) || first >= guard->lift_samples) {
        guard->lifted = true;
    }
    uint16_t fault = plausibility_check(&guard->plausibility, readings);
    if (fault == FAULT_NONE) {
        const int64_t sample = (int64_t)first - (int64_t)guard->release_samples;
        fault = limits_violated(limits, readings, guard->device, sample, guard->lifted);
    }
    if (fault == FAULT_NONE && guard->winding.temperature_c > limits->max_temperature_c) {
        fault = FAULT_OVER_TEMPERATURE;
    }
    return fault;
}

void guard_update(struct guard *guard, const struct readings *readings)
{
    guard->newest_m[0] = guard->newest_m[1];
    guard->newest_m[1] = guard->newest_m[2];
    guard->newest_m[2] = readings->position_m;
    if (guard->positions < 3u) {
        guard->positions++;
    }
    winding_advance(&guard->winding, readings->current_a, readings->temperature_c);
}
