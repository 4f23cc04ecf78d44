/* Playback sample by sample: soft start, stimulus, set-points and soft release (4.4, 4.5 and 5, rule 5). */
#ifndef PLAYER_H
#define PLAYER_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "setpoints.h"
#include "stimulus.h"

/* cursor counts the samples of the run, with those of the release, which begins at length. */
struct player {
    uint32_t cursor;
    uint32_t length;
    uint32_t stimulus_samples;
    uint32_t held_samples;
    double present_v;                      /* newest command of the run itself */
    double peak_v;                         /* largest command of the stimulus within the soft start */
    double soft_share[MAX_SOFT_SAMPLES];   /* quarter of a sine */
    uint32_t soft_samples;
    uint32_t ramp_samples;
};

/* A command, V, and the flags of its source. */
struct command {
    double volts;
    uint16_t flags;
};

void player_init(struct player *player, uint32_t sample_rate_hz);

/* Set up a run of the stimulus that has length samples with its set-points. */
void player_begin(struct player *player, const struct stimulus *stimulus, const struct channel *command,
                  uint32_t length);

/* Number of played samples of the newest run, without those of the release. */
uint32_t player_played(const struct player *player);

/* Whether all samples of the run itself have been played. */
bool player_releasing(const struct player *player);

/* Whether the release has ended, too. */
bool player_over(const struct player *player);

/* End the run at the present sample. */
void player_finish(struct player *player);

/* Return the next command. */
struct command player_next(struct player *player, const struct stimulus *stimulus, struct setpoints *setpoints,
                           const struct channel *channel);

/* Advance the run by a command, as it was finally played. */
void player_advance(struct player *player, const struct command *played);

#endif
