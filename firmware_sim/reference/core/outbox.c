#include "outbox.h"

void outbox_init(struct outbox *outbox)
{
    outbox->first = 0;
    outbox->used = 0;
    outbox->sequence = 0;
    outbox->dropped_frames = 0;
}

void outbox_put(struct outbox *outbox, uint8_t type, uint64_t time_us, uint64_t index, const uint8_t *payload,
                size_t size)
{
    const size_t length = frame_encode(outbox->encoded, type, outbox->sequence, time_us, index, payload, size);
    outbox->sequence++;
    if (outbox->used + length > TRANSMIT_BYTES) {
        outbox->dropped_frames++;
        return;
    }
    size_t at = (outbox->first + outbox->used) % TRANSMIT_BYTES;
    for (size_t k = 0; k < length; k++) {
        outbox->bytes[at] = outbox->encoded[k];
        at = (at + 1u) % TRANSMIT_BYTES;
    }
    outbox->used += length;
}

size_t outbox_next(const struct outbox *outbox, const uint8_t **bytes)
{
    const size_t to_the_end = TRANSMIT_BYTES - outbox->first;
    *bytes = outbox->bytes + outbox->first;
    return outbox->used < to_the_end ? outbox->used : to_the_end;
}

void outbox_sent(struct outbox *outbox, size_t count)
{
    outbox->first = (outbox->first + count) % TRANSMIT_BYTES;
    outbox->used -= count;
}
