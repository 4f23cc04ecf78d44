/* Plants behind the POSIX board: what the converters of the board read. */
#ifndef PLANT_H
#define PLANT_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"

enum plant_kind {
    PLANT_TISSUE, /* coil against a spring with a damper */
    PLANT_FREE,   /* coil in free air */
    PLANT_DUMMY,  /* a resistor in place of the coil, and a fixed position */
    PLANT_SCRIPT  /* whole-number readings without physics, the same in tests/reference/script_bench.py */
};

/* Disturbances that a test can set. */
struct world {
    bool button;
    bool supply_low;
    bool position_stuck;
    bool coil_open;
};

/* Set the disturbances: button 1, supply low 2, position stuck 4, coil open 8. */
void world_set(struct world *world, uint8_t bits);

/* Reset the plant; surface_m is the position of the tissue's surface. */
void plant_init(enum plant_kind kind, const struct board_properties *device, double surface_m);

/* Move the surface of the tissue. */
void plant_place(double surface_m);

/* Advance by one sample with a held command, and read all converters. */
void plant_step(const struct world *world, bool amplifier, int16_t command, struct board_sample *sample);

#endif
