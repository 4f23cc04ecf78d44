#include "posix_board.h"

#include "desktop_device.h"

#include <math.h>
#include <stdlib.h>

struct posix_board posix_board;

static struct {
    bool amplifier;
    int16_t command;
    bool moving;
    uint64_t arrival_us;
    double from_m;
    double target_m;
} output;

static const double SURFACE_M = 0.008;

/* Position of a stage that is out of the probe's reach. */
static const double AWAY_M = 1.0;

void posix_board_init(uint32_t sample_rate_hz, enum plant_kind kind, uint32_t boot_id)
{
    const struct board_properties properties = {
        .model = "desktop indenter (reference)",
        .serial_number = "REF-0001",
        .firmware_version = "ref-1.0",
        .sample_rate_hz = sample_rate_hz,
        .has_stage = true,
        DESKTOP_DEVICE,
    };
    posix_board.properties = properties;
    posix_board.kind = kind;
    posix_board.boot_id = boot_id;
    output.amplifier = false;
    output.command = 0;
    output.moving = false;
    output.from_m = SURFACE_M;
    plant_init(kind, &posix_board.properties, SURFACE_M);
}

const struct board_properties *board_properties(void)
{
    return &posix_board.properties;
}

void board_amplifier(bool enabled)
{
    output.amplifier = enabled;
}

void board_command(int16_t code)
{
    output.command = code;
}

void board_read(struct board_sample *sample)
{
    plant_step(&posix_board.world, output.amplifier, output.command, sample);
}

bool board_button(void)
{
    return posix_board.world.button;
}

bool board_supply_low(void)
{
    return posix_board.world.supply_low;
}

uint64_t board_clock_us(void)
{
    return posix_board.clock_us;
}

uint32_t board_random(void)
{
    return posix_board.boot_id;
}

size_t board_receive(uint8_t *bytes, size_t most)
{
    return line_receive(&posix_board.line, bytes, most);
}

size_t board_send(const uint8_t *bytes, size_t count)
{
    return line_send(&posix_board.line, bytes, count);
}

/* Nothing interrupts this process: the calls are only checked. */
void board_lock(void)
{
    if (posix_board.locked) {
        abort();
    }
    posix_board.locked = true;
}

void board_unlock(void)
{
    if (!posix_board.locked) {
        abort();
    }
    posix_board.locked = false;
}

void board_kick(void)
{
}

void board_stage_move(double position_m, bool away)
{
    output.target_m = away ? AWAY_M : position_m;
    output.moving = true;
    output.arrival_us = posix_board.clock_us;
    if (posix_board.stage_m_per_s > 0.0) {
        const double seconds = fmin(fabs(output.target_m - output.from_m), 0.1) / posix_board.stage_m_per_s;
        output.arrival_us += (uint64_t)(seconds * 1e6);
    }
}

enum stage_progress board_stage_progress(void)
{
    if (output.moving && posix_board.clock_us < output.arrival_us) {
        return STAGE_MOVING;
    }
    if (output.moving) {
        output.moving = false;
        output.from_m = output.target_m;
        plant_place(output.target_m);
    }
    return STAGE_ARRIVED;
}

void board_stage_stop(void)
{
    output.moving = false;
}
