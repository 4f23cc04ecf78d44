/* Board layer: what the firmware needs of the hardware. A port to another microcontroller implements these functions.
 *
 * The board calls firmware_interrupt() (firmware.h) from a timer at the sample rate, and firmware_poll() from its main
 * loop. Nothing else of the firmware runs in an interrupt. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "config.h"

/* A converter: physical value = gain * code + offset. */
struct channel {
    const char *name;
    const char *unit;
    double gain;
    double offset;
};

/* Order of the channels in a sample. */
enum channel_index { COMMAND, VOLTAGE, CURRENT, POSITION, TEMPERATURE, ACCELERATION_X, ACCELERATION_Y };

/* Fixed properties, reported in HELLO_ACK. SI; the temperature in degC. The ranges of docs/protocol.md, 4.1 apply. */
struct board_properties {
    const char *model;
    const char *serial_number;
    const char *firmware_version;
    uint32_t sample_rate_hz; /* 2000 to MAX_RATE_HZ, a multiple of 100 */
    double coil_resistance_ohm;
    double coil_inductance_h;
    double force_constant_n_per_a;
    double moving_mass_kg;
    double bearing_damping_n_s_per_m;
    double amplifier_gain;
    double amplifier_limit_v;
    double stroke_m;
    double max_force_n;
    double max_temperature_c;
    double filter_corner_hz; /* 0: unknown */
    bool has_stage;
    struct channel channels[CHANNELS];
};

/* Readings of all converters at one moment; the command's code is ignored. */
struct board_sample {
    int16_t code[CHANNELS];
    bool saturated; /* a converter is at the end of its range */
};

enum stage_progress { STAGE_MOVING, STAGE_ARRIVED };

const struct board_properties *board_properties(void);

/* Enable the amplifier, or disable it and short the coil. Must act at once, also from an interrupt. */
void board_amplifier(bool enabled);

/* Set the output of the digital-to-analogue converter. */
void board_command(int16_t code);

/* Read all converters. Their conversion is started by the sample timer itself, so that it has no jitter. */
void board_read(struct board_sample *sample);

/* Whether the button is pressed. A broken wire reads as pressed. */
bool board_button(void);

/* Whether the amplifier's supply is below 40 % of its nominal voltage. */
bool board_supply_low(void);

/* Microseconds since the start, from another oscillator than that of the sample timer. */
uint64_t board_clock_us(void);

/* Random number for the boot id: from a noise source, or a counter in non-volatile memory. */
uint32_t board_random(void);

/* Move bytes from and to the line without waiting; return their number. */
size_t board_receive(uint8_t *bytes, size_t most);
size_t board_send(const uint8_t *bytes, size_t count);

/* Mask and unmask the sample interrupt. Calls are not nested. */
void board_lock(void);
void board_unlock(void);

/* Restart the hardware watchdog, which resets the board, and so disables the amplifier, if this is not called for 50 ms. */
void board_kick(void);

/* Stage: start the motion (away: out of the probe's reach), report its progress, stop at once. */
void board_stage_move(double position_m, bool away);
enum stage_progress board_stage_progress(void);
void board_stage_stop(void);

#endif
