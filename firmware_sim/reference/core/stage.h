/* Motorised stage of a calibration rig: one motion at a time, answered when it has ended (4.7). */
#ifndef STAGE_H
#define STAGE_H

#include <stdbool.h>
#include <stdint.h>

struct stage {
    bool moving;
    bool stopped; /* by a request that releases the coil */
    uint16_t sequence; /* of the request that is answered on arrival */
};

#endif
