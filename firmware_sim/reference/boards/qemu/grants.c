#include "grants.h"

#include "bytes.h"
#include "registers.h"

#define GRANT_BYTES 8u

static struct {
    volatile uint32_t bytes;   /* received of the present grant */
    volatile uint32_t samples; /* left of the present grant */
    volatile uint32_t longest_ticks;
    uint32_t masked_ticks;
    uint8_t grant[GRANT_BYTES];
    bool begun;
    bool active;
} grants;

static void run_timers(bool on)
{
    TIMER_CONTROL(SAMPLE_TIMER) = on ? TIMER_INTERRUPT | TIMER_ON : TIMER_INTERRUPT;
    TIMER_CONTROL(CLOCK_TIMER) = on ? TIMER_ON : 0u;
}

void grants_begin(void)
{
    grants.active = true;
    run_timers(false);
}

bool grants_running(void)
{
    return grants.samples > 0u;
}

void grants_receive(uint8_t byte)
{
    if (grants.bytes < GRANT_BYTES) {
        grants.grant[grants.bytes] = byte;
        grants.bytes++;
    }
}

void grants_count(uint32_t ticks)
{
    grants.longest_ticks = ticks > grants.longest_ticks ? ticks : grants.longest_ticks;
    if (grants.active && grants.samples > 0u) {
        grants.samples--;
        if (grants.samples == 0u) {
            run_timers(false);
        }
    }
}

void grants_masked(uint32_t ticks)
{
    grants.masked_ticks = ticks > grants.masked_ticks ? ticks : grants.masked_ticks;
}

static void answer(uint32_t sent)
{
    uint8_t bytes[12];
    (void)put_u32(put_u32(put_u32(bytes, sent), grants.longest_ticks), grants.masked_ticks);
    grants.longest_ticks = 0;
    grants.masked_ticks = 0;
    grants.begun = false;
    grants.bytes = 0;
    for (uint32_t k = 0; k < sizeof bytes; k++) {
        while ((UART_STATE(GRANT_UART) & UART_TRANSMIT_FULL) != 0u) {
        }
        UART_DATA(GRANT_UART) = bytes[k];
    }
}

void grants_poll(struct world *world, uint32_t received, uint32_t sent, bool idle)
{
    if (grants.bytes < GRANT_BYTES || !idle) {
        return;
    }
    if (!grants.begun && received == get_u32(grants.grant + 4)) {
        world_set(world, grants.grant[0]);
        grants.begun = true;
        grants.samples = get_u16(grants.grant + 2);
        if (grants.samples > 0u) {
            run_timers(true);
            return;
        }
    }
    if (grants.begun && grants.samples == 0u) {
        answer(sent);
    }
}
