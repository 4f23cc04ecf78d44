#include "stimulus.h"

#include <string.h>

#include "bytes.h"
#include "frames.h"

void stimulus_init(struct stimulus *stimulus)
{
    stimulus->samples = 0;
    stimulus->id = 0;
    stimulus->crc = 0;
    stimulus->lowest = 0;
    stimulus->highest = 0;
}

enum result stimulus_begin(struct stimulus *stimulus, uint32_t id, uint32_t samples, uint32_t crc, uint64_t *detail)
{
    if (samples == 0u) {
        return RESULT_BAD_ARGUMENT;
    }
    if (samples > STIMULUS_CAPACITY) {
        *detail = STIMULUS_CAPACITY;
        return RESULT_TOO_LARGE;
    }
    memset(stimulus->codes, 0, samples * sizeof stimulus->codes[0]);
    stimulus->samples = samples;
    stimulus->id = id;
    stimulus->crc = crc;
    return RESULT_OK;
}

enum result stimulus_chunk(struct stimulus *stimulus, uint32_t id, uint32_t offset, const uint8_t *codes, size_t size,
                           uint64_t *detail)
{
    const uint64_t end = (uint64_t)offset + size / 2u;
    if (id != stimulus->id || size % 2u != 0u || end > stimulus->samples) {
        return RESULT_BAD_ARGUMENT;
    }
    for (size_t k = 0; k < size / 2u; k++) {
        stimulus->codes[offset + k] = get_i16(codes + 2u * k);
    }
    *detail = end;
    return RESULT_OK;
}

enum result stimulus_commit(struct stimulus *stimulus, uint32_t id, uint64_t *detail)
{
    if (id != stimulus->id || stimulus->samples == 0u) {
        return RESULT_BAD_ARGUMENT;
    }
    uint32_t crc = 0;
    stimulus->lowest = stimulus->codes[0];
    stimulus->highest = stimulus->codes[0];
    for (uint32_t k = 0; k < stimulus->samples; k++) {
        const int16_t code = stimulus->codes[k];
        uint8_t bytes[2];
        (void)put_u16(bytes, (uint16_t)code);
        crc = crc32_of(crc, bytes, sizeof bytes);
        stimulus->lowest = code < stimulus->lowest ? code : stimulus->lowest;
        stimulus->highest = code > stimulus->highest ? code : stimulus->highest;
    }
    if (crc != stimulus->crc) {
        *detail = crc;
        return RESULT_CHECKSUM;
    }
    *detail = stimulus->samples;
    return RESULT_OK;
}

void stimulus_forget(struct stimulus *stimulus)
{
    stimulus->samples = 0;
}
