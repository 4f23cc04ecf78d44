/* POSIX board: the board layer with a simulated plant behind it. */
#ifndef POSIX_BOARD_H
#define POSIX_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "line.h"
#include "plant.h"

struct posix_board {
    struct board_properties properties;
    struct world world;
    struct line line;
    enum plant_kind kind;
    uint32_t boot_id;
    uint64_t clock_us;
    double stage_m_per_s; /* 0: arrives at once */
    bool locked;
};

extern struct posix_board posix_board;

/* Set the properties of the simulated device, and reset the plant. */
void posix_board_init(uint32_t sample_rate_hz, enum plant_kind kind, uint32_t boot_id);

#endif
