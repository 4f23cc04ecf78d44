/* Frames: header, payload and CRC-32 in COBS encoding, ended by a zero byte (docs/protocol.md, section 2). */
#ifndef FRAMES_H
#define FRAMES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "config.h"

#define FRAME_HEADER 20u
#define FRAME_CRC 4u
#define MIN_FRAME (FRAME_HEADER + FRAME_CRC)
#define MAX_FRAME (MIN_FRAME + MAX_PAYLOAD)
#define MAX_ENCODED (MAX_FRAME + MAX_FRAME / 254u + 1u)

/* A decoded frame. The payload lies in the decoder and is valid until its next byte. */
struct frame {
    uint8_t type;
    uint16_t sequence;
    const uint8_t *payload;
    size_t size;
};

/* Decoder of a byte stream; refused counts the damaged frames. */
struct decoder {
    uint8_t bytes[MAX_ENCODED];
    size_t used;
    bool overlong;
    uint32_t refused;
};

/* Return the CRC-32 of bytes that follow others whose result was crc; 0 at the start. */
uint32_t crc32_of(uint32_t crc, const uint8_t *bytes, size_t count);

void decoder_init(struct decoder *decoder);

/* Process a byte; return true if it completes a frame. */
bool decoder_push(struct decoder *decoder, uint8_t byte, struct frame *frame);

/* Encode a frame, with its zero, into out (MAX_ENCODED + 1 bytes); return its length. The payload must fit. */
size_t frame_encode(uint8_t *out, uint8_t type, uint16_t sequence, uint64_t time_us, uint64_t index,
                    const uint8_t *payload, size_t size);

#endif
