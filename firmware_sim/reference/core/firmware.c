#include "firmware.h"

#include <math.h>
#include <string.h>

#include "bytes.h"
#include "requests.h"

static double physical(const struct firmware *firmware, const struct board_sample *sample, enum channel_index at)
{
    const struct channel *channel = &firmware->device->channels[at];
    return channel->gain * (double)sample->code[at] + channel->offset;
}

void firmware_init(struct firmware *firmware)
{
    board_amplifier(false);
    memset(firmware, 0, sizeof *firmware);
    firmware->device = board_properties();
    firmware->boot_id = board_random();
    firmware->samples_per_frame = firmware->device->sample_rate_hz / 100u;
    decoder_init(&firmware->decoder);
    answers_clear(&firmware->answers);
    outbox_init(&firmware->outbox);
    stimulus_init(&firmware->stimulus);
    setpoints_init(&firmware->setpoints, firmware->device->sample_rate_hz);
    player_init(&firmware->player, firmware->device->sample_rate_hz);
    guard_init(&firmware->guard, firmware->device);
    board_command(0);
}

/* -- changes of state, with the sample interrupt masked ------------------------------------------------ */

void firmware_status(struct firmware *firmware)
{
    const uint32_t place = firmware->event_count < EVENTS ? firmware->event_count : EVENTS - 1u;
    struct event *event = &firmware->events[(firmware->first_event + place) % EVENTS];
    uint8_t *at = put_u8(event->payload, (uint8_t)firmware->state);
    at = put_u8(at, firmware->streaming ? 1u : 0u);
    at = put_u16(at, firmware->faults);
    at = put_u32(at, firmware->boot_id);
    at = put_u32(at, firmware->outbox.dropped_frames + firmware->lost_data);
    at = put_u32(at, firmware->decoder.refused);
    at = put_u32(at, player_played(&firmware->player));
    at = put_u32(at, firmware->setpoints.late_blocks);
    (void)put_u32(at, firmware->player.held_samples);
    event->index = firmware->sample_index;
    firmware->event_count = place + 1u;
}

/* Disable the amplifier. A command whose sample is not yet taken no longer counts as played. */
static void release_coil(struct firmware *firmware)
{
    board_amplifier(false);
    board_command(0);
    firmware->amplifier = false;
    if (firmware->pending && firmware->pending_run) {
        firmware->player.cursor--;
        firmware->player.held_samples -= (firmware->pending_flags & FLAG_HELD) != 0u ? 1u : 0u;
        firmware->pending_run = false;
        firmware->pending_code = 0;
        firmware->pending_flags = 0;
    }
}

void firmware_enter(struct firmware *firmware, enum state state)
{
    if (state != STATE_RUNNING) {
        release_coil(firmware);
    }
    firmware->state = state;
    firmware_status(firmware);
}

void firmware_disarm(struct firmware *firmware)
{
    firmware->armed = false;
    setpoints_agree(&firmware->setpoints, 0, 0.0);
}

void firmware_trip(struct firmware *firmware, uint16_t fault)
{
    board_amplifier(false);
    board_stage_stop();
    firmware->faults |= fault;
    firmware_disarm(firmware);
    firmware_enter(firmware, STATE_FAULT);
}

/* -- sample interrupt ---------------------------------------------------------------------------------- */

void firmware_watch(struct firmware *firmware)
{
    const uint64_t now = board_clock_us();
    const bool active = firmware->state == STATE_ARMED || firmware->state == STATE_RUNNING;
    if (active && now - firmware->last_heartbeat_us > WATCHDOG_US) {
        firmware_trip(firmware, FAULT_WATCHDOG);
    }
    if (firmware->stage.moving && firmware->state != STATE_FAULT && now - firmware->last_frame_us > HOST_SILENCE_US) {
        firmware_trip(firmware, FAULT_WATCHDOG);
    }
}

void firmware_play(struct firmware *firmware)
{
    const struct channel *channel = &firmware->device->channels[COMMAND];
    struct command command = {0.0, 0};
    if (board_supply_low() && (firmware->faults & FAULT_BROWN_OUT) == 0u) {
        firmware_trip(firmware, FAULT_BROWN_OUT);
    }
    firmware->pending = true;
    firmware->pending_run = firmware->state == STATE_RUNNING;
    firmware->pending_first = firmware->player.cursor;
    if (firmware->pending_run) {
        command = player_next(&firmware->player, &firmware->stimulus, &firmware->setpoints, channel);
        const double lowered = guard_lowered(&firmware->guard, command.volts, &firmware->limits);
        if (lowered < command.volts || lowered > command.volts) {
            command.volts = lowered;
            command.flags |= FLAG_LIMITED;
        }
        player_advance(&firmware->player, &command);
    }
    const double code = rint((command.volts - channel->offset) / channel->gain);
    firmware->pending_code = (int16_t)fmin(fmax(code, (double)INT16_MIN), (double)INT16_MAX);
    firmware->pending_flags = command.flags;
    board_command(firmware->pending_code);
    if (firmware->pending_run && !firmware->amplifier) {
        firmware->amplifier = true;
        board_amplifier(true);
    }
}

/* Append a sample to the DATA frame in progress. A complete one waits for the main loop if the host wants it. */
static void store(struct firmware *firmware, const struct board_sample *sample, uint16_t flags)
{
    const uint32_t place = (firmware->first_data + firmware->data_count) % DATA_FRAMES;
    struct data_frame *frame = &firmware->data[place];
    uint8_t *at = frame->payload + (size_t)firmware->in_frame * SAMPLE_BYTES;
    if (firmware->in_frame == 0u) {
        frame->first = firmware->sample_index;
    }
    for (uint32_t k = 0; k < CHANNELS; k++) {
        at = put_u16(at, (uint16_t)sample->code[k]);
    }
    (void)put_u16(at, flags);
    firmware->sample_index++;
    firmware->in_frame++;
    if (firmware->in_frame == firmware->samples_per_frame) {
        firmware->in_frame = 0;
        if (firmware->streaming && firmware->data_count < DATA_FRAMES - 1u) {
            firmware->data_count++;
        } else if (firmware->streaming) {
            firmware->lost_data++;
        }
    }
}

void firmware_take(struct firmware *firmware)
{
    struct board_sample sample;
    board_read(&sample);
    sample.code[COMMAND] = firmware->pending ? firmware->pending_code : 0;
    const struct readings readings = {
        .command_v = physical(firmware, &sample, COMMAND),
        .voltage_v = physical(firmware, &sample, VOLTAGE),
        .current_a = physical(firmware, &sample, CURRENT),
        .position_m = physical(firmware, &sample, POSITION),
        .temperature_c = physical(firmware, &sample, TEMPERATURE),
        .current_code = sample.code[CURRENT],
        .position_code = sample.code[POSITION],
        .temperature_code = sample.code[TEMPERATURE],
        .button = board_button(),
    };
    uint16_t flags = firmware->pending ? firmware->pending_flags : 0u;
    flags |= readings.button ? FLAG_BUTTON : 0u;
    flags |= firmware->amplifier ? FLAG_ENERGISED : 0u;
    flags |= sample.saturated ? FLAG_SATURATED : 0u;

    const bool in_run = firmware->pending && firmware->pending_run;
    uint16_t fault = FAULT_NONE;
    firmware->pending = false;
    if (in_run) {
        fault = guard_judge(&firmware->guard, &readings, &firmware->limits, firmware->pending_first);
        if (fault == FAULT_NONE && setpoints_starved(&firmware->setpoints)) {
            fault = FAULT_STARVED;
        }
    }
    if (fault != FAULT_NONE) {
        board_amplifier(false); /* before anything else */
    }
    guard_update(&firmware->guard, &readings);
    store(firmware, &sample, flags);
    if (fault != FAULT_NONE) {
        firmware_trip(firmware, fault);
    } else if (in_run && player_over(&firmware->player)) {
        firmware_disarm(firmware);
        firmware_enter(firmware, STATE_LOADED);
    } else if (readings.button && firmware->state != STATE_FAULT &&
               (firmware->state == STATE_ARMED || firmware->state == STATE_RUNNING || firmware->stage.moving)) {
        firmware_trip(firmware, FAULT_BUTTON);
    }
    if (board_clock_us() - firmware->last_frame_us > HOST_SILENCE_US) {
        firmware->streaming = false; /* the next host finds a quiet line */
    }
}

void firmware_interrupt(struct firmware *firmware)
{
    if (firmware->pending) { /* the first interrupt only sets the command of the first sample */
        firmware_take(firmware);
    }
    firmware_watch(firmware);
    firmware_play(firmware);
    board_kick();
}

/* -- main loop ----------------------------------------------------------------------------------------- */

/* Return the device time of a sample index, microseconds. */
static uint64_t time_of(const struct firmware *firmware, uint64_t index)
{
    const uint64_t rate = firmware->device->sample_rate_hz;
    return (index * 1000000u + rate / 2u) / rate;
}

static void put(struct firmware *firmware, uint8_t type, uint64_t index, const uint8_t *payload, size_t size)
{
    outbox_put(&firmware->outbox, type, time_of(firmware, index), index, payload, size);
}

/* Queue the changes of state that wait, in their order. */
static void collect_events(struct firmware *firmware)
{
    for (;;) {
        struct event event;
        board_lock();
        const bool found = firmware->event_count > 0u;
        if (found) {
            event = firmware->events[firmware->first_event];
            firmware->first_event = (firmware->first_event + 1u) % EVENTS;
            firmware->event_count--;
        }
        board_unlock();
        if (!found) {
            return;
        }
        put(firmware, STATUS, event.index, event.payload, STATUS_BYTES);
    }
}

void firmware_collect(struct firmware *firmware)
{
    collect_events(firmware);
    for (;;) {
        board_lock();
        const bool found = firmware->data_count > 0u;
        board_unlock();
        if (!found) {
            return;
        }
        /* The interrupt fills another frame meanwhile. */
        const struct data_frame *frame = &firmware->data[firmware->first_data];
        put(firmware, DATA, frame->first, frame->payload, (size_t)firmware->samples_per_frame * SAMPLE_BYTES);
        board_lock();
        firmware->first_data = (firmware->first_data + 1u) % DATA_FRAMES;
        firmware->data_count--;
        board_unlock();
    }
}

void firmware_send(struct firmware *firmware, uint8_t type, const uint8_t *payload, size_t size)
{
    collect_events(firmware); /* a change of state is reported before the answer to its request */
    board_lock();
    const uint64_t index = firmware->sample_index;
    board_unlock();
    put(firmware, type, index, payload, size);
}

void firmware_connected(struct firmware *firmware)
{
    firmware->greeted = false;
}

void firmware_receive(struct firmware *firmware, const uint8_t *bytes, size_t count)
{
    for (size_t k = 0; k < count; k++) {
        struct frame frame;
        if (decoder_push(&firmware->decoder, bytes[k], &frame)) {
            board_lock();
            firmware->last_frame_us = board_clock_us();
            board_unlock();
            requests_handle(firmware, &frame);
        }
    }
}

void firmware_poll(struct firmware *firmware)
{
    uint8_t bytes[64];
    const size_t count = board_receive(bytes, sizeof bytes);
    firmware_receive(firmware, bytes, count);
    requests_stage(firmware);
    firmware_collect(firmware);
    const uint8_t *waiting;
    const size_t most = outbox_next(&firmware->outbox, &waiting);
    if (most > 0u) {
        outbox_sent(&firmware->outbox, board_send(waiting, most));
    }
}
