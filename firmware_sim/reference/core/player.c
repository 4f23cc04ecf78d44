#include "player.h"

#include <math.h>
#include <string.h>

static double volts_of(const struct channel *channel, int16_t code)
{
    return channel->gain * (double)code + channel->offset;
}

void player_init(struct player *player, uint32_t sample_rate_hz)
{
    const double half_pi = 1.5707963267948966;
    memset(player, 0, sizeof *player);
    player->soft_samples = sample_rate_hz / 20u; /* 50 ms */
    player->ramp_samples = sample_rate_hz / 20u;
    for (uint32_t k = 0; k < player->soft_samples; k++) {
        player->soft_share[k] = sin(half_pi * ((double)k + 1.0) / (double)player->soft_samples);
    }
}

void player_begin(struct player *player, const struct stimulus *stimulus, const struct channel *command,
                  uint32_t length)
{
    player->cursor = 0;
    player->length = length;
    player->stimulus_samples = stimulus->samples;
    player->held_samples = 0;
    player->present_v = 0.0;
    player->peak_v = 0.0;
    for (uint32_t k = 0; k < player->soft_samples && k < stimulus->samples; k++) {
        player->peak_v = fmax(player->peak_v, fabs(volts_of(command, stimulus->codes[k])));
    }
}

uint32_t player_played(const struct player *player)
{
    return player->cursor < player->length ? player->cursor : player->length;
}

bool player_releasing(const struct player *player)
{
    return player->cursor >= player->length;
}

bool player_over(const struct player *player)
{
    return player->cursor >= player->length + player->ramp_samples;
}

void player_finish(struct player *player)
{
    player->length = player_played(player);
}

/* Limit a command of the first 50 ms to the curve of the soft start. */
static void soften(const struct player *player, const struct channel *channel, struct command *command)
{
    if (player->cursor >= player->soft_samples) {
        return;
    }
    const double size = fabs(command->volts);
    const double most = player->soft_share[player->cursor] * fmax(player->peak_v, size);
    if (size > most + channel->gain) { /* one step of the converter is tolerated, because of rounding */
        command->volts = command->volts < 0.0 ? -most : most;
        command->flags |= FLAG_SOFT_START;
    }
}

struct command player_next(struct player *player, const struct stimulus *stimulus, struct setpoints *setpoints,
                           const struct channel *channel)
{
    struct command command = {0.0, 0};
    if (player_releasing(player)) {
        const double done = (double)(player->cursor - player->length);
        command.volts = player->present_v * (1.0 - (done + 1.0) / (double)player->ramp_samples);
        return command;
    }
    command.flags = FLAG_PLAYING;
    if (player->cursor < player->stimulus_samples) {
        command.volts = volts_of(channel, stimulus->codes[player->cursor]);
    } else {
        bool held = false;
        command.volts = setpoints_play(setpoints, channel, player->cursor, player->present_v, &held);
        command.flags |= held ? FLAG_HELD : 0u;
    }
    soften(player, channel, &command);
    return command;
}

void player_advance(struct player *player, const struct command *played)
{
    if (!player_releasing(player)) {
        player->present_v = played->volts;
    }
    player->cursor++;
    if ((played->flags & FLAG_HELD) != 0u) {
        player->held_samples++;
    }
}
