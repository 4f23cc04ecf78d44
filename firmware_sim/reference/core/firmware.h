/* Firmware of the indenter: a state machine that controls the coil (docs/protocol.md).
 *
 * A board calls firmware_init() once, then firmware_interrupt() from its sample timer and firmware_poll() from its main
 * loop. Requests are executed in the main loop with the sample interrupt masked, but for the long ones: those of section
 * 4.3 and ARM touch nothing that the interrupt uses meanwhile, and SETPOINTS are stored in parts. */
#ifndef FIRMWARE_H
#define FIRMWARE_H

#include <stdbool.h>
#include <stdint.h>

#include "answers.h"
#include "board.h"
#include "frames.h"
#include "guard.h"
#include "limits.h"
#include "messages.h"
#include "outbox.h"
#include "player.h"
#include "setpoints.h"
#include "stage.h"
#include "stimulus.h"

#define SAMPLE_BYTES 16u
#define STATUS_BYTES 28u

/* A STATUS as it was at a change of state. */
struct event {
    uint8_t payload[STATUS_BYTES];
    uint64_t index;
};

/* Samples of a DATA frame. */
struct data_frame {
    uint8_t payload[MAX_SAMPLES_PER_FRAME * SAMPLE_BYTES];
    uint64_t first;
};

struct firmware {
    const struct board_properties *device;
    enum state state;
    uint16_t faults;
    bool streaming;
    bool greeted; /* the host of this connection has a common protocol version */
    bool armed;   /* the limits of a run are agreed */
    bool has_token;
    uint32_t token;
    uint32_t boot_id;
    uint64_t sample_index;
    uint64_t last_frame_us;
    uint64_t last_heartbeat_us;
    struct limits limits;

    bool amplifier;         /* the amplifier is enabled */
    bool pending;           /* a command was set whose sample is not yet taken */
    bool pending_run;       /* it belongs to the run */
    uint32_t pending_first; /* its place in the run */
    int16_t pending_code;
    uint16_t pending_flags;

    struct event events[EVENTS]; /* ring from first_event on */
    uint32_t first_event;
    uint32_t event_count;
    struct data_frame data[DATA_FRAMES]; /* ring; the one after the complete ones is being filled */
    uint32_t first_data;
    uint32_t data_count;
    uint32_t in_frame;
    uint32_t samples_per_frame;
    uint32_t lost_data;

    struct decoder decoder;
    struct answers answers;
    struct outbox outbox;
    struct stimulus stimulus;
    struct setpoints setpoints;
    struct player player;
    struct guard guard;
    struct stage stage;
};

/* Start in IDLE with the amplifier disabled. */
void firmware_init(struct firmware *firmware);

/* Sample interrupt: take the sample of the held command, check it, set the next command. */
void firmware_interrupt(struct firmware *firmware);

/* Main loop: process received bytes, and send what waits. */
void firmware_poll(struct firmware *firmware);

/* A new connection, on a line that has connections (USB CDC: DTR rises; TCP): its host has to send HELLO first. A UART
 * has none. Called from the main loop. */
void firmware_connected(struct firmware *firmware);

/* Parts of the above, for a board that calls them one by one. */
void firmware_watch(struct firmware *firmware);
void firmware_play(struct firmware *firmware);
void firmware_take(struct firmware *firmware);
void firmware_receive(struct firmware *firmware, const uint8_t *bytes, size_t count);
void firmware_collect(struct firmware *firmware);

/* For requests.c, with the sample interrupt masked. */
void firmware_enter(struct firmware *firmware, enum state state);
void firmware_trip(struct firmware *firmware, uint16_t fault);
void firmware_disarm(struct firmware *firmware);
void firmware_status(struct firmware *firmware);
void firmware_send(struct firmware *firmware, uint8_t type, const uint8_t *payload, size_t size);

#endif
