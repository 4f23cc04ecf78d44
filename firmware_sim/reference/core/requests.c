#include "requests.h"

#include <math.h>

#include "bytes.h"
#include "handshake.h"

/* A result and its detail; deferred: the answer follows later. */
struct reply {
    enum result result;
    uint64_t detail;
    bool deferred;
};

static struct reply reply_of(enum result result, uint64_t detail)
{
    const struct reply reply = {result, detail, false};
    return reply;
}

static double volts_of(const struct firmware *firmware, int16_t code)
{
    const struct channel *channel = &firmware->device->channels[COMMAND];
    return channel->gain * (double)code + channel->offset;
}

/* -- stimulus, outside the lock: the interrupt uses it in RUNNING only ---------------------------------- */

static struct reply load(struct firmware *firmware, const struct frame *frame)
{
    const bool begin = frame->type == STIMULUS_BEGIN;
    if (firmware->state != STATE_IDLE && !(begin && firmware->state == STATE_LOADED)) {
        return reply_of(RESULT_BAD_STATE, 0);
    }
    struct reply reply = reply_of(RESULT_BAD_ARGUMENT, 0);
    const uint8_t *at = frame->payload;
    if (frame->type == STIMULUS_CHUNK) {
        if (frame->size >= 8u) {
            reply.result = stimulus_chunk(&firmware->stimulus, get_u32(at), get_u32(at + 4), at + 8, frame->size - 8u,
                                          &reply.detail);
        }
        return reply;
    }
    if (begin && frame->size == 12u) {
        reply.result =
            stimulus_begin(&firmware->stimulus, get_u32(at), get_u32(at + 4), get_u32(at + 8), &reply.detail);
    } else if (!begin && frame->size == 4u) {
        reply.result = stimulus_commit(&firmware->stimulus, get_u32(at), &reply.detail);
    }
    board_lock();
    if (reply.result == RESULT_OK && firmware->state == STATE_FAULT) { /* a brown-out meanwhile */
        reply = reply_of(RESULT_FAULT_LATCHED, firmware->faults);
    } else if (reply.result == RESULT_OK) {
        setpoints_agree(&firmware->setpoints, 0, 0.0);
        firmware_enter(firmware, begin ? STATE_IDLE : STATE_LOADED);
    }
    board_unlock();
    return reply;
}

/* -- runs, with the sample interrupt masked only where it must be ------------------------------------------- */

static struct reply arm(struct firmware *firmware, const struct frame *frame)
{
    if (frame->size != 44u) {
        return reply_of(RESULT_BAD_ARGUMENT, 0);
    }
    const uint8_t *at = frame->payload;
    const struct limits limits = {get_f64(at + 8), get_f64(at + 16), get_f64(at + 24), get_f64(at + 32),
                                  get_u32(at + 40)};
    const struct stimulus *stimulus = &firmware->stimulus;
    if (firmware->state != STATE_LOADED || get_u32(at + 4) != stimulus->id || firmware->stage.moving) {
        return reply_of(RESULT_BAD_STATE, 0);
    }
    const uint32_t length = stimulus->samples + firmware->setpoints.samples;
    if (!limits_valid(&limits, firmware->device) || length > limits.max_samples ||
        !limits_permit(&limits, volts_of(firmware, stimulus->lowest), firmware->device) ||
        !limits_permit(&limits, volts_of(firmware, stimulus->highest), firmware->device) ||
        !limits_permit(&limits, firmware->setpoints.hold_v, firmware->device)) {
        return reply_of(RESULT_BEYOND_LIMITS, 0);
    }
    /* In LOADED the interrupt uses none of these. */
    firmware->limits = limits;
    setpoints_begin(&firmware->setpoints, stimulus->samples);
    player_begin(&firmware->player, stimulus, &firmware->device->channels[COMMAND], length);
    guard_begin(&firmware->guard, &limits);
    board_lock();
    const bool usable = firmware->state == STATE_LOADED; /* no brown-out meanwhile */
    if (usable) {
        firmware->token = get_u32(at);
        firmware->has_token = true;
        firmware->armed = true;
        firmware->last_heartbeat_us = board_clock_us();
        firmware_enter(firmware, STATE_ARMED);
    }
    board_unlock();
    return usable ? reply_of(RESULT_OK, 0) : reply_of(RESULT_FAULT_LATCHED, firmware->faults);
}

/* Find the next missing sample, a few steps at a time. */
static uint32_t next_missing(struct firmware *firmware)
{
    bool found = false;
    uint32_t next = 0;
    while (!found) {
        board_lock();
        found = setpoints_seek(&firmware->setpoints, firmware->player.cursor);
        next = setpoints_next_missing(&firmware->setpoints, firmware->player.cursor);
        board_unlock();
    }
    return next;
}

/* Store a block in parts: the sample interrupt must not wait for all of it. The parts are stored faster than played. */
static void store_setpoints(struct firmware *firmware, uint32_t offset, const uint8_t *codes, uint32_t count)
{
    for (uint32_t k = 0; k < count; k += SETPOINT_STEPS) {
        const uint32_t part = count - k < SETPOINT_STEPS ? count - k : SETPOINT_STEPS;
        board_lock();
        setpoints_store(&firmware->setpoints, offset + k, codes + (size_t)2u * k, part, firmware->player.cursor);
        board_unlock();
    }
}

static struct reply take_setpoints(struct firmware *firmware, const struct frame *frame)
{
    if (frame->size < 8u) {
        return reply_of(RESULT_BAD_ARGUMENT, 0);
    }
    if (!firmware->has_token || get_u32(frame->payload) != firmware->token) {
        return reply_of(RESULT_BAD_STATE, 0);
    }
    board_lock();
    const uint32_t played = player_played(&firmware->player);
    const bool over = !firmware->armed || player_releasing(&firmware->player);
    board_unlock();
    if (over) {
        return reply_of(RESULT_LATE, played); /* the run is over */
    }
    const uint8_t *codes = frame->payload + 8;
    const uint32_t offset = get_u32(frame->payload + 4);
    const uint32_t count = (uint32_t)((frame->size - 8u) / 2u);
    enum result result = RESULT_OK;
    if (count == 0u || frame->size % 2u != 0u) {
        result = RESULT_BAD_ARGUMENT;
    }
    for (uint32_t k = 0; k < count && result == RESULT_OK; k++) {
        if (!limits_permit(&firmware->limits, volts_of(firmware, get_i16(codes + 2u * k)), firmware->device)) {
            result = RESULT_BEYOND_LIMITS;
        }
    }
    if (result == RESULT_OK) {
        board_lock();
        result = setpoints_judge(&firmware->setpoints, offset, count, firmware->player.cursor);
        if (result == RESULT_LATE) {
            firmware->setpoints.late_blocks++;
        }
        board_unlock();
        if (result == RESULT_OK || result == RESULT_LATE) {
            store_setpoints(firmware, offset, codes, count);
        }
    }
    return reply_of(result, next_missing(firmware));
}

/* -- runs, with the sample interrupt masked ------------------------------------------------------------- */

static struct reply release(struct firmware *firmware, bool forget)
{
    firmware_disarm(firmware);
    if (firmware->stage.moving) {
        board_stage_stop();
        firmware->stage.stopped = true;
    }
    if (firmware->state == STATE_ARMED || firmware->state == STATE_RUNNING) {
        firmware_enter(firmware, STATE_LOADED);
    }
    if (forget && firmware->state == STATE_LOADED) {
        stimulus_forget(&firmware->stimulus);
        firmware_enter(firmware, STATE_IDLE);
    }
    return reply_of(RESULT_OK, player_played(&firmware->player));
}

static struct reply follow(struct firmware *firmware, const struct frame *frame)
{
    if (frame->size != 10u) {
        return reply_of(RESULT_BAD_ARGUMENT, 0);
    }
    const uint32_t samples = get_u32(frame->payload + 4);
    if (firmware->state != STATE_LOADED || get_u32(frame->payload) != firmware->stimulus.id) {
        return reply_of(RESULT_BAD_STATE, 0);
    }
    const uint32_t most = MAX_RUN_S * firmware->device->sample_rate_hz;
    if (firmware->stimulus.samples > most || samples > most - firmware->stimulus.samples) {
        return reply_of(RESULT_TOO_LARGE,
                        firmware->stimulus.samples > most ? 0u : most - firmware->stimulus.samples);
    }
    setpoints_agree(&firmware->setpoints, samples, volts_of(firmware, get_i16(frame->payload + 8)));
    return reply_of(RESULT_OK, (uint64_t)firmware->stimulus.samples + samples);
}

static struct reply start(struct firmware *firmware, const struct frame *frame)
{
    if (frame->size != 4u) {
        return reply_of(RESULT_BAD_ARGUMENT, 0);
    }
    if (firmware->state != STATE_ARMED || !firmware->armed || get_u32(frame->payload) != firmware->token) {
        return reply_of(RESULT_BAD_STATE, 0);
    }
    /* The command of the sample in progress is already set: the run begins with the one after it. */
    const uint64_t first = firmware->sample_index + (firmware->pending ? 1u : 0u);
    firmware_enter(firmware, STATE_RUNNING);
    return reply_of(RESULT_OK, first);
}

static struct reply finish(struct firmware *firmware)
{
    if (firmware->state == STATE_FAULT) {
        return reply_of(RESULT_FAULT_LATCHED, firmware->faults);
    }
    if (firmware->state == STATE_ARMED) {
        return release(firmware, false);
    }
    if (firmware->state == STATE_RUNNING) {
        player_finish(&firmware->player);
    }
    return reply_of(RESULT_OK, player_played(&firmware->player));
}

static struct reply move_stage(struct firmware *firmware, const struct frame *frame)
{
    if (frame->size != 8u) {
        return reply_of(RESULT_BAD_ARGUMENT, 0);
    }
    if (firmware->state == STATE_FAULT) {
        return reply_of(RESULT_FAULT_LATCHED, firmware->faults);
    }
    if (firmware->state == STATE_ARMED || firmware->state == STATE_RUNNING || firmware->stage.moving) {
        return reply_of(RESULT_BAD_STATE, 0);
    }
    const double position_m = get_f64(frame->payload);
    const bool away = isnan(position_m);
    if (!away && !(position_m >= 0.0 && position_m <= firmware->device->stroke_m)) {
        return reply_of(RESULT_BAD_ARGUMENT, 0);
    }
    board_stage_move(away ? 0.0 : position_m, away);
    if (board_stage_progress() == STAGE_ARRIVED) {
        return reply_of(RESULT_OK, 0);
    }
    firmware->stage.moving = true;
    firmware->stage.stopped = false;
    firmware->stage.sequence = frame->sequence;
    const struct reply later = {RESULT_OK, 0, true};
    return later;
}

/* -- dispatch ------------------------------------------------------------------------------------------ */

/* Whether a request releases the coil: accepted from any host, in any state, without a handshake. */
static bool always_obeyed(uint8_t type)
{
    return type == STOP || type == RELEASE || type == FINISH;
}

static struct reply obey(struct firmware *firmware, const struct frame *frame)
{
    switch (frame->type) {
    case STREAM:
        if (frame->size != 1u) {
            return reply_of(RESULT_BAD_ARGUMENT, 0);
        }
        firmware->streaming = frame->payload[0] != 0u;
        firmware->in_frame = 0;
        return reply_of(RESULT_OK, firmware->sample_index);
    case FOLLOW:
        return follow(firmware, frame);
    case START:
        return start(firmware, frame);
    case STOP:
        return release(firmware, false);
    case RELEASE:
        return release(firmware, true);
    case FINISH:
        return finish(firmware);
    case CLEAR_FAULTS:
        firmware->faults = FAULT_NONE;
        if (firmware->state == STATE_FAULT) {
            firmware_enter(firmware, STATE_IDLE);
        }
        return reply_of(RESULT_OK, 0);
    case STAGE:
        return firmware->device->has_stage ? move_stage(firmware, frame) : reply_of(RESULT_UNKNOWN, 0);
    default:
        return reply_of(RESULT_UNKNOWN, 0);
    }
}

/* Execute a new request. */
static struct reply execute(struct firmware *firmware, const struct frame *frame)
{
    const uint8_t type = frame->type;
    if (!firmware->greeted && !always_obeyed(type)) {
        return reply_of(RESULT_BAD_STATE, 0);
    }
    if (firmware->state == STATE_FAULT && type >= STIMULUS_BEGIN && type <= START) {
        return reply_of(RESULT_FAULT_LATCHED, firmware->faults);
    }
    if (type == STIMULUS_BEGIN || type == STIMULUS_CHUNK || type == STIMULUS_COMMIT) {
        return load(firmware, frame);
    }
    if ((type == ARM || type == START || type == STAGE) && board_button()) {
        return reply_of(RESULT_FAULT_LATCHED, FAULT_BUTTON); /* no motion while the button is pressed */
    }
    if (type == ARM) {
        return arm(firmware, frame);
    }
    if (type == SETPOINTS) {
        return take_setpoints(firmware, frame);
    }
    board_lock();
    const struct reply reply = obey(firmware, frame);
    board_unlock();
    return reply;
}

static void send_answer(struct firmware *firmware, const struct answer *answer)
{
    uint8_t payload[12];
    uint8_t *at = put_u8(put_u8(payload, answer->type), answer->result);
    (void)put_u64(put_u16(at, answer->sequence), answer->detail);
    firmware_send(firmware, ACK, payload, sizeof payload);
}

static void answer_new(struct firmware *firmware, uint8_t type, uint16_t sequence, const struct reply *reply)
{
    const struct answer answer = {type, sequence, (uint8_t)reply->result, reply->detail};
    answers_keep(&firmware->answers, &answer);
    send_answer(firmware, &answer);
}

static void greet(struct firmware *firmware, const struct frame *frame)
{
    uint8_t payload[HANDSHAKE_BYTES];
    answers_clear(&firmware->answers);
    if (frame->size < HELLO_BYTES) {
        return;
    }
    board_lock();
    firmware->greeted = frame->payload[0] <= PROTOCOL_VERSION && frame->payload[1] >= PROTOCOL_VERSION;
    if (!firmware->greeted) {
        (void)release(firmware, false); /* the host of the run has disconnected */
    }
    board_unlock();
    firmware_send(firmware, HELLO_ACK, payload, handshake_write(payload, firmware->device, firmware->boot_id));
}

void requests_handle(struct firmware *firmware, const struct frame *frame)
{
    if (frame->type == HEARTBEAT) {
        if (firmware->greeted) {
            board_lock();
            firmware->last_heartbeat_us = board_clock_us();
            board_unlock();
        }
    } else if (frame->type == STATUS_REQUEST) {
        board_lock();
        firmware_status(firmware);
        board_unlock();
        firmware_collect(firmware);
    } else if (frame->type == HELLO) {
        greet(firmware, frame);
    } else {
        const struct answer *known = answers_find(&firmware->answers, frame->type, frame->sequence);
        const bool under_way =
            firmware->stage.moving && frame->type == STAGE && frame->sequence == firmware->stage.sequence;
        if (known != NULL) {
            send_answer(firmware, known);
        } else if (!under_way) {
            const struct reply reply = execute(firmware, frame);
            if (!reply.deferred) {
                answer_new(firmware, frame->type, frame->sequence, &reply);
            }
        }
    }
}

void requests_stage(struct firmware *firmware)
{
    if (!firmware->stage.moving) {
        return;
    }
    struct reply reply = reply_of(RESULT_OK, 0);
    board_lock();
    const bool faulty = firmware->state == STATE_FAULT;
    if (faulty) {
        reply = reply_of(RESULT_FAULT_LATCHED, firmware->faults);
    }
    if (!faulty && firmware->stage.stopped) {
        reply = reply_of(RESULT_BAD_STATE, 0);
    }
    const bool ended = faulty || firmware->stage.stopped || board_stage_progress() == STAGE_ARRIVED;
    if (ended) {
        firmware->stage.moving = false;
    }
    board_unlock();
    if (ended) {
        answer_new(firmware, STAGE, firmware->stage.sequence, &reply);
    }
}
