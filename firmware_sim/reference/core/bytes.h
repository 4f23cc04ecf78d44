/* Little-endian fields of payloads, on any processor and at any address. */
#ifndef BYTES_H
#define BYTES_H

#include <stdint.h>
#include <string.h>

static inline uint16_t get_u16(const uint8_t *at)
{
    return (uint16_t)((uint16_t)at[0] | (uint16_t)((uint16_t)at[1] << 8));
}

static inline int16_t get_i16(const uint8_t *at)
{
    const uint16_t bits = get_u16(at);
    return (int16_t)(bits < 0x8000u ? (int32_t)bits : (int32_t)bits - 65536);
}

static inline uint32_t get_u32(const uint8_t *at)
{
    return (uint32_t)get_u16(at) | ((uint32_t)get_u16(at + 2) << 16);
}

static inline double get_f64(const uint8_t *at)
{
    const uint64_t bits = (uint64_t)get_u32(at) | ((uint64_t)get_u32(at + 4) << 32);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline uint8_t *put_u8(uint8_t *at, uint8_t value)
{
    at[0] = value;
    return at + 1;
}

static inline uint8_t *put_u16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value & 0xFFu);
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static inline uint8_t *put_u32(uint8_t *at, uint32_t value)
{
    return put_u16(put_u16(at, (uint16_t)(value & 0xFFFFu)), (uint16_t)(value >> 16));
}

static inline uint8_t *put_u64(uint8_t *at, uint64_t value)
{
    return put_u32(put_u32(at, (uint32_t)(value & 0xFFFFFFFFu)), (uint32_t)(value >> 32));
}

static inline uint8_t *put_f64(uint8_t *at, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return put_u64(at, bits);
}

/* Write a text of fixed width: cut or padded with zeros. */
static inline uint8_t *put_text(uint8_t *at, const char *text, size_t width)
{
    size_t k = 0;
    for (; k < width && text[k] != '\0'; k++) {
        at[k] = (uint8_t)text[k];
    }
    memset(at + k, 0, width - k);
    return at + width;
}

#endif
