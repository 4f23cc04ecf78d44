#include "lockstep.h"

#include <stdio.h>

#include "bytes.h"
#include "posix_board.h"
#include "requests.h"

static bool read_exactly(uint8_t *bytes, size_t count)
{
    return fread(bytes, 1, count, stdin) == count;
}

static uint64_t get_u64(const uint8_t *at)
{
    return (uint64_t)get_u32(at) | ((uint64_t)get_u32(at + 4) << 32);
}

static bool receive(struct firmware *firmware)
{
    uint8_t head[12];
    uint8_t bytes[256];
    if (!read_exactly(head, sizeof head)) {
        return false;
    }
    posix_board.clock_us = get_u64(head);
    uint32_t left = get_u32(head + 8);
    while (left > 0u) {
        const size_t count = left < sizeof bytes ? left : sizeof bytes;
        if (!read_exactly(bytes, count)) {
            return false;
        }
        firmware_receive(firmware, bytes, count);
        left -= (uint32_t)count;
    }
    firmware_collect(firmware);
    return true;
}

static bool advance(struct firmware *firmware)
{
    uint8_t head[12];
    if (!read_exactly(head, sizeof head)) {
        return false;
    }
    posix_board.clock_us = get_u64(head);
    for (uint32_t left = get_u32(head + 8); left > 0u; left--) {
        firmware_watch(firmware);
        firmware_play(firmware);
        firmware_take(firmware);
        firmware_collect(firmware);
    }
    return true;
}

static bool interrupts(struct firmware *firmware)
{
    uint8_t head[4];
    if (!read_exactly(head, sizeof head)) {
        return false;
    }
    for (uint32_t left = get_u32(head); left > 0u; left--) {
        posix_board.clock_us += 1000000u / posix_board.properties.sample_rate_hz;
        firmware_interrupt(firmware);
        requests_stage(firmware);
        firmware_collect(firmware);
    }
    return true;
}

static bool set_world(void)
{
    uint8_t bits;
    if (!read_exactly(&bits, 1)) {
        return false;
    }
    world_set(&posix_board.world, bits);
    return true;
}

static bool transmit(struct firmware *firmware)
{
    uint8_t head[4];
    (void)put_u32(head, (uint32_t)firmware->outbox.used);
    (void)fwrite(head, 1, sizeof head, stdout);
    while (firmware->outbox.used > 0u) {
        const uint8_t *bytes;
        const size_t count = outbox_next(&firmware->outbox, &bytes);
        (void)fwrite(bytes, 1, count, stdout);
        outbox_sent(&firmware->outbox, count);
    }
    return fflush(stdout) == 0;
}

int lockstep_run(struct firmware *firmware)
{
    bool usable = true;
    int command = getchar();
    while (usable && command != EOF) {
        switch (command) {
        case 'R':
            usable = receive(firmware);
            break;
        case 'A':
            usable = advance(firmware);
            break;
        case 'V':
            usable = interrupts(firmware);
            break;
        case 'W':
            usable = set_world();
            break;
        case 'T':
            usable = transmit(firmware);
            break;
        default:
            usable = false;
            break;
        }
        command = usable ? getchar() : EOF;
    }
    return usable ? 0 : 1;
}
