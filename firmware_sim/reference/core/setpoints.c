#include "setpoints.h"

#include <string.h>

#include "bytes.h"

static uint32_t larger(uint32_t a, uint32_t b)
{
    return a > b ? a : b;
}

void setpoints_init(struct setpoints *setpoints, uint32_t sample_rate_hz)
{
    memset(setpoints, 0, sizeof *setpoints);
    setpoints->hold_ramp = sample_rate_hz / 20u; /* 50 ms */
    setpoints->fade = sample_rate_hz / 200u;     /* 5 ms */
    setpoints->starved = sample_rate_hz / 2u;    /* 0.5 s */
}

void setpoints_agree(struct setpoints *setpoints, uint32_t samples, double hold_v)
{
    setpoints->samples = samples;
    setpoints->hold_v = samples > 0u ? hold_v : 0.0;
}

void setpoints_begin(struct setpoints *setpoints, uint32_t first)
{
    memset(setpoints->known, 0, sizeof setpoints->known);
    setpoints->first = first;
    setpoints->end = first + setpoints->samples;
    setpoints->frontier = first;
    setpoints->late_blocks = 0;
    setpoints->missing = 0;
    setpoints->holding = 0;
    setpoints->fading = 0;
    setpoints->from_v = 0.0;
}

bool setpoints_starved(const struct setpoints *setpoints)
{
    return setpoints->missing >= setpoints->starved;
}

/* Return the end of what can be stored: of the run, or of the buffer. */
static uint32_t stop_of(const struct setpoints *setpoints, uint32_t cursor)
{
    const uint32_t full = larger(cursor, setpoints->first) + SETPOINT_BUFFER;
    return full < setpoints->end ? full : setpoints->end;
}

bool setpoints_seek(struct setpoints *setpoints, uint32_t cursor)
{
    const uint32_t stop = stop_of(setpoints, cursor);
    uint32_t at = larger(larger(cursor, setpoints->first), setpoints->frontier);
    uint32_t steps = 0;
    while (at < stop && setpoints->known[at % SETPOINT_BUFFER] && steps < SETPOINT_STEPS) {
        at++;
        steps++;
    }
    setpoints->frontier = at;
    return at >= stop || !setpoints->known[at % SETPOINT_BUFFER];
}

uint32_t setpoints_next_missing(const struct setpoints *setpoints, uint32_t cursor)
{
    const uint32_t stop = stop_of(setpoints, cursor);
    return setpoints->frontier < stop ? setpoints->frontier : stop;
}

enum result setpoints_judge(const struct setpoints *setpoints, uint32_t offset, uint32_t count, uint32_t cursor)
{
    const uint64_t end = (uint64_t)offset + count;
    const uint32_t wanted_from = larger(cursor, setpoints->first);
    if (count == 0u || offset < setpoints->first || end > setpoints->end) {
        return RESULT_BAD_ARGUMENT;
    }
    if (end > (uint64_t)wanted_from + SETPOINT_BUFFER) {
        return RESULT_TOO_LARGE;
    }
    return offset < wanted_from ? RESULT_LATE : RESULT_OK;
}

void setpoints_store(struct setpoints *setpoints, uint32_t offset, const uint8_t *codes, uint32_t count,
                     uint32_t cursor)
{
    for (uint32_t at = larger(offset, larger(cursor, setpoints->first)); at < offset + count; at++) {
        setpoints->codes[at % SETPOINT_BUFFER] = get_i16(codes + 2u * (at - offset));
        setpoints->known[at % SETPOINT_BUFFER] = true;
        setpoints->missing = 0;
    }
}

/* Return the command of a sample without a set-point: on the ramp to the hold level, or at it. */
static double hold(struct setpoints *setpoints, double present_v)
{
    if (setpoints->holding == 0u) {
        setpoints->from_v = present_v;
    }
    if (setpoints->holding < setpoints->hold_ramp) {
        setpoints->holding++;
    }
    setpoints->fading = 0;
    return setpoints->from_v +
           (setpoints->hold_v - setpoints->from_v) * (double)setpoints->holding / (double)setpoints->hold_ramp;
}

/* Return the command of a sample with a set-point; after a hold it is approached without a jump. */
static double resume(struct setpoints *setpoints, double wanted_v, bool *held)
{
    if (setpoints->holding > 0u) {
        setpoints->from_v +=
            (setpoints->hold_v - setpoints->from_v) * (double)setpoints->holding / (double)setpoints->hold_ramp;
        setpoints->holding = 0;
        setpoints->fading = setpoints->fade;
    }
    *held = setpoints->fading > 0u;
    if (!*held) {
        return wanted_v;
    }
    const double share = 1.0 - (double)setpoints->fading / (double)(setpoints->fade + 1u);
    setpoints->fading--;
    return setpoints->from_v + (wanted_v - setpoints->from_v) * share;
}

double setpoints_play(struct setpoints *setpoints, const struct channel *command, uint32_t cursor, double present_v,
                      bool *held)
{
    const uint32_t place = cursor % SETPOINT_BUFFER;
    if (setpoints->known[place]) {
        setpoints->known[place] = false;
        setpoints->missing = 0;
        return resume(setpoints, command->gain * (double)setpoints->codes[place] + command->offset, held);
    }
    setpoints->missing++;
    *held = true;
    return hold(setpoints, present_v);
}
