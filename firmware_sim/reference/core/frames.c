#include "frames.h"

#include "bytes.h"

/* CRC-32 of the sixteen values of four bits, polynomial 0x04C11DB7 reflected. */
static const uint32_t CRC_TABLE[16] = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
    0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu};

uint32_t crc32_of(uint32_t crc, const uint8_t *bytes, size_t count)
{
    uint32_t value = crc ^ 0xFFFFFFFFu;
    for (size_t k = 0; k < count; k++) {
        value ^= bytes[k];
        value = (value >> 4) ^ CRC_TABLE[value & 15u];
        value = (value >> 4) ^ CRC_TABLE[value & 15u];
    }
    return value ^ 0xFFFFFFFFu;
}

/* Decode COBS in place; return the length, or 0 if the encoding is invalid. The bytes contain no zero. */
static size_t cobs_decode(uint8_t *bytes, size_t count)
{
    size_t from = 0;
    size_t to = 0;
    while (from < count) {
        const size_t code = bytes[from];
        from++;
        if (from + code - 1u > count) {
            return 0;
        }
        for (size_t k = 1; k < code; k++) {
            bytes[to] = bytes[from];
            to++;
            from++;
        }
        if (from < count && code < 0xFFu) {
            bytes[to] = 0;
            to++;
        }
    }
    return to;
}

void decoder_init(struct decoder *decoder)
{
    decoder->used = 0;
    decoder->overlong = false;
    decoder->refused = 0;
}

/* Decode the collected bytes; return whether they are a frame. */
static bool decode(struct decoder *decoder, struct frame *frame)
{
    const size_t size = cobs_decode(decoder->bytes, decoder->used);
    if (size < MIN_FRAME || size > MAX_FRAME) {
        return false;
    }
    const uint8_t *bytes = decoder->bytes;
    if (crc32_of(0, bytes, size - FRAME_CRC) != get_u32(bytes + size - FRAME_CRC)) {
        return false;
    }
    frame->type = bytes[1];
    frame->sequence = get_u16(bytes + 2);
    frame->payload = bytes + FRAME_HEADER;
    frame->size = size - MIN_FRAME;
    return true;
}

bool decoder_push(struct decoder *decoder, uint8_t byte, struct frame *frame)
{
    if (byte != 0u) {
        if (decoder->used < MAX_ENCODED) {
            decoder->bytes[decoder->used] = byte;
            decoder->used++;
        } else {
            decoder->overlong = true; /* ignored up to the next zero */
        }
        return false;
    }
    const bool empty = decoder->used == 0u;
    const bool complete = !empty && !decoder->overlong && decode(decoder, frame);
    if (!empty && !complete) {
        decoder->refused++;
    }
    decoder->used = 0;
    decoder->overlong = false;
    return complete;
}

/* State of an encoding in progress: out[code_at] receives the length code of the present group. */
struct cobs_writer {
    uint8_t *out;
    size_t code_at;
    size_t next;
    uint8_t code;
    bool open; /* the group must be written even if it is empty */
};

static void cobs_close(struct cobs_writer *writer, bool open)
{
    writer->out[writer->code_at] = writer->code;
    writer->code_at = writer->next;
    writer->next++;
    writer->code = 1;
    writer->open = open;
}

static void cobs_write(struct cobs_writer *writer, const uint8_t *bytes, size_t count)
{
    for (size_t k = 0; k < count; k++) {
        if (bytes[k] == 0u) {
            cobs_close(writer, true);
        } else {
            writer->out[writer->next] = bytes[k];
            writer->next++;
            writer->code++;
            if (writer->code == 0xFFu) {
                cobs_close(writer, false);
            }
        }
    }
}

size_t frame_encode(uint8_t *out, uint8_t type, uint16_t sequence, uint64_t time_us, uint64_t index,
                    const uint8_t *payload, size_t size)
{
    uint8_t header[FRAME_HEADER];
    uint8_t tail[FRAME_CRC];
    uint8_t *at = put_u16(put_u8(put_u8(header, PROTOCOL_VERSION), type), sequence);
    (void)put_u64(put_u64(at, time_us), index);
    (void)put_u32(tail, crc32_of(crc32_of(0, header, FRAME_HEADER), payload, size));

    struct cobs_writer writer = {out, 0, 1, 1, true};
    cobs_write(&writer, header, FRAME_HEADER);
    cobs_write(&writer, payload, size);
    cobs_write(&writer, tail, FRAME_CRC);
    if (writer.code > 1u || writer.open) {
        cobs_close(&writer, false);
    }
    out[writer.code_at] = 0;
    return writer.code_at + 1u;
}
