/* Set-points: a stimulus that the host computes during the run, and what replaces it when the host is late (4.5). */
#ifndef SETPOINTS_H
#define SETPOINTS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "board.h"
#include "messages.h"

/* The set-points of one run are its samples from first to end, counted from the first played sample. */
struct setpoints {
    int16_t codes[SETPOINT_BUFFER]; /* ring: sample k at k modulo its length */
    bool known[SETPOINT_BUFFER];
    uint32_t samples; /* agreed by FOLLOW; 0: none */
    double hold_v;
    uint32_t first;
    uint32_t end;
    uint32_t frontier; /* no sample between the played one and this is missing */
    uint32_t late_blocks;
    uint32_t missing; /* consecutive missing samples */
    uint32_t holding; /* samples of the ramp to the hold level that were played */
    uint32_t fading;  /* samples of the return to the set-points that are left */
    double from_v;    /* command at the start of the ramp or of the return */
    uint32_t hold_ramp;
    uint32_t fade;
    uint32_t starved;
};

void setpoints_init(struct setpoints *setpoints, uint32_t sample_rate_hz);

/* Agree on a number of set-points after the stimulus and on the level that replaces a missing one, V. */
void setpoints_agree(struct setpoints *setpoints, uint32_t samples, double hold_v);

/* Begin a run whose stimulus has first samples. */
void setpoints_begin(struct setpoints *setpoints, uint32_t first);

/* Whether set-points were missing for so long that the run must end. */
bool setpoints_starved(const struct setpoints *setpoints);

/* Look on for the first missing sample from cursor on; return whether it is found, after a bounded number of steps. */
bool setpoints_seek(struct setpoints *setpoints, uint32_t cursor);

/* Return the first missing sample that was found; the end of the run or of the buffer if there is none. */
uint32_t setpoints_next_missing(const struct setpoints *setpoints, uint32_t cursor);

/* Return whether a block of count codes from sample offset on is in time (RESULT_OK), late, or refused as a whole. */
enum result setpoints_judge(const struct setpoints *setpoints, uint32_t offset, uint32_t count, uint32_t cursor);

/* Store a part of a block that was not refused; cursor is the next sample to be played. */
void setpoints_store(struct setpoints *setpoints, uint32_t offset, const uint8_t *codes, uint32_t count,
                     uint32_t cursor);

/* Return the command of sample cursor, V, and whether it is not the host's. present_v is the previous command. */
double setpoints_play(struct setpoints *setpoints, const struct channel *command, uint32_t cursor, double present_v,
                      bool *held);

#endif
