#include "plausibility.h"

#include <math.h>
#include <string.h>

#include "messages.h"

/* A position code that is constant for 100 ms while the force changes by this much. */
static const double FROZEN_SWING_N = 0.3;

/* A position within STILL_M for 100 ms while the force changes by this much: no tissue is so stiff. */
static const double STILL_SWING_N = 3.0;
static const double STILL_M = 6.0e-6;

/* Largest plausible speed. */
static const double JUMP_M_PER_S = 10.0;

/* Open coil: over two blocks this voltage is commanded and measured, and less than the share of the current flows. */
#define OPEN_BLOCKS 2u
static const double OPEN_VOLTS = 2.0;
static const double OPEN_SHARE = 0.15;

/* A current code that is constant for five blocks while the voltage changes by this much. */
#define CURRENT_BLOCKS 5u
static const double CURRENT_SWING_V = 1.0;

void plausibility_init(struct plausibility *checks, const struct board_properties *device)
{
    memset(checks, 0, sizeof *checks);
    checks->block_samples = device->sample_rate_hz / 100u;
    checks->jump_m = JUMP_M_PER_S / (double)device->sample_rate_hz;
    checks->force_constant_n_per_a = device->force_constant_n_per_a;
    checks->resistance_ohm = device->coil_resistance_ohm;
}

void plausibility_begin(struct plausibility *checks, bool near_end)
{
    checks->newest = FROZEN_BLOCKS - 1u;
    checks->blocks = 0;
    checks->in_block = 0;
    checks->has_position = false;
    checks->near_end = near_end;
}

/* Return the summary that is back blocks old; 0 is the newest. */
static const struct summary *recent(const struct plausibility *checks, uint32_t back)
{
    return &checks->history[(checks->newest + FROZEN_BLOCKS - back) % FROZEN_BLOCKS];
}

static bool position_is_dead(const struct plausibility *checks)
{
    if (recent(checks, 0)->position_low == INT16_MAX) {
        return true;
    }
    if (checks->blocks < FROZEN_BLOCKS) {
        return false;
    }
    struct summary low = *recent(checks, 0);
    struct summary high = low;
    for (uint32_t back = 1; back < FROZEN_BLOCKS; back++) {
        const struct summary *item = recent(checks, back);
        low.force_n = fmin(low.force_n, item->force_n);
        high.force_n = fmax(high.force_n, item->force_n);
        low.position_m = fmin(low.position_m, item->position_m);
        high.position_m = fmax(high.position_m, item->position_m);
        low.position_low = item->position_low < low.position_low ? item->position_low : low.position_low;
        high.position_high = item->position_high > high.position_high ? item->position_high : high.position_high;
    }
    if (checks->near_end && low.position_low == INT16_MIN) {
        return false;
    }
    const double swing = high.force_n - low.force_n;
    const bool frozen = low.position_low == high.position_high;
    const bool still = high.position_m - low.position_m <= STILL_M;
    return (frozen && swing >= FROZEN_SWING_N) || (still && swing >= STILL_SWING_N);
}

static bool no_current(const struct plausibility *checks)
{
    double asked = 0.0;
    double measured = 0.0;
    double drawn = 0.0;
    if (checks->blocks < OPEN_BLOCKS) {
        return false;
    }
    for (uint32_t back = OPEN_BLOCKS; back > 0u; back--) {
        const struct summary *item = recent(checks, back - 1u);
        asked += item->asked_v / (double)OPEN_BLOCKS;
        measured += item->measured_v / (double)OPEN_BLOCKS;
        drawn += item->drawn_a / (double)OPEN_BLOCKS;
    }
    return fmin(asked, measured) >= OPEN_VOLTS && drawn * checks->resistance_ohm < OPEN_SHARE * measured;
}

static bool current_is_frozen(const struct plausibility *checks)
{
    if (checks->blocks < CURRENT_BLOCKS) {
        return false;
    }
    struct summary low = *recent(checks, 0);
    struct summary high = low;
    for (uint32_t back = 1; back < CURRENT_BLOCKS; back++) {
        const struct summary *item = recent(checks, back);
        low.mean_v = fmin(low.mean_v, item->mean_v);
        high.mean_v = fmax(high.mean_v, item->mean_v);
        low.current_low = item->current_low < low.current_low ? item->current_low : low.current_low;
        high.current_high = item->current_high > high.current_high ? item->current_high : high.current_high;
    }
    return low.current_low == high.current_high && high.mean_v - low.mean_v >= CURRENT_SWING_V;
}

/* Add a sample to the block in progress. */
static void add(struct plausibility *checks, const struct readings *readings)
{
    struct summary *sums = &checks->sums;
    if (checks->in_block == 0u) {
        memset(sums, 0, sizeof *sums);
        sums->current_low = sums->current_high = readings->current_code;
        sums->position_low = sums->position_high = readings->position_code;
    }
    sums->asked_v += fabs(readings->command_v);
    sums->measured_v += fabs(readings->voltage_v);
    sums->drawn_a += fabs(readings->current_a);
    sums->mean_v += readings->voltage_v;
    sums->force_n += readings->current_a;
    sums->position_m += readings->position_m;
    if (readings->current_code < sums->current_low) {
        sums->current_low = readings->current_code;
    }
    if (readings->current_code > sums->current_high) {
        sums->current_high = readings->current_code;
    }
    if (readings->position_code < sums->position_low) {
        sums->position_low = readings->position_code;
    }
    if (readings->position_code > sums->position_high) {
        sums->position_high = readings->position_code;
    }
    checks->in_block++;
}

/* End the block in progress: its sums become means. */
static void end_block(struct plausibility *checks)
{
    const double count = (double)checks->in_block;
    checks->newest = (checks->newest + 1u) % FROZEN_BLOCKS;
    struct summary *item = &checks->history[checks->newest];
    *item = checks->sums;
    item->asked_v /= count;
    item->measured_v /= count;
    item->drawn_a /= count;
    item->mean_v /= count;
    item->force_n = item->force_n / count * checks->force_constant_n_per_a;
    item->position_m /= count;
    checks->in_block = 0;
    if (checks->blocks < FROZEN_BLOCKS) {
        checks->blocks++;
    }
}

uint16_t plausibility_check(struct plausibility *checks, const struct readings *readings)
{
    const double step = checks->has_position ? fabs(readings->position_m - checks->last_position_m) : 0.0;
    checks->has_position = true;
    checks->last_position_m = readings->position_m;
    add(checks, readings);
    if (step > checks->jump_m) {
        return FAULT_SENSOR;
    }
    if (checks->in_block < checks->block_samples) {
        return FAULT_NONE;
    }
    end_block(checks);
    if (position_is_dead(checks)) {
        return FAULT_SENSOR;
    }
    return no_current(checks) || current_is_frozen(checks) ? FAULT_OPEN_COIL : FAULT_NONE;
}
