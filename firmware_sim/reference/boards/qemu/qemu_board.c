/* Board of QEMU's mps2-an500 (Cortex-M7, 25 MHz): the line is UART 0, the sample clock timer 0, the plant is behind it.
 *
 * firmware_sim/reference/emulator.py starts it, in real time or in lockstep with a test (grants.h). */
#include "qemu_board.h"

#include "desktop_device.h"
#include "firmware.h"
#include "grants.h"
#include "plant.h"
#include "registers.h"
#include "start.h"

#define RING 4096u /* received bytes that wait for the main loop; a power of two */

static struct firmware firmware;
static struct world world;
static bool amplifier;
static int16_t command;
static uint32_t newest_ticks;
static uint64_t ticks;
static uint32_t plant_ticks;

static struct {
    uint8_t bytes[RING];
    volatile uint32_t in; /* bytes since the start: written by the interrupt */
    uint32_t out;         /* taken by the main loop */
    uint32_t sent;
} line;
static volatile bool interrupted; /* an interrupt has run in this pass of the main loop */
static bool moved;                /* bytes were moved in this pass */

static const struct board_properties PROPERTIES = {
    .model = "desktop indenter (QEMU)",
    .serial_number = "QEMU-0001",
    .firmware_version = "ref-1.1",
    .sample_rate_hz = 2000,
    .has_stage = false,
    DESKTOP_DEVICE,
};

const struct board_properties *board_properties(void)
{
    return &PROPERTIES;
}

void board_amplifier(bool enabled)
{
    amplifier = enabled;
}

void board_command(int16_t code)
{
    command = code;
}

static uint32_t counted_ticks(void)
{
    return 0xFFFFFFFFu - TIMER_VALUE(CLOCK_TIMER);
}

void board_read(struct board_sample *sample)
{
    const uint32_t begin = counted_ticks();
    plant_step(&world, amplifier, command, sample);
    plant_ticks = counted_ticks() - begin;
}

bool board_button(void)
{
    return world.button;
}

bool board_supply_low(void)
{
    return world.supply_low;
}

/* The counter runs down and wraps after 172 s; it is read at least once per sample, with the interrupt masked. */
uint64_t board_clock_us(void)
{
    const uint32_t now = counted_ticks();
    ticks += now - newest_ticks;
    newest_ticks = now;
    return ticks / (CLOCK_HZ / 1000000u);
}

/* QEMU's board has no source of noise: whoever starts it draws the number. */
uint32_t board_random(void)
{
    return STRAPS[1];
}

size_t board_receive(uint8_t *bytes, size_t most)
{
    size_t count = 0;
    while (count < most && line.out != line.in) {
        bytes[count] = line.bytes[line.out % RING];
        line.out++;
        count++;
    }
    moved = moved || count > 0u;
    return count;
}

size_t board_send(const uint8_t *bytes, size_t count)
{
    size_t sent = 0;
    while (sent < count && (UART_STATE(LINE_UART) & UART_TRANSMIT_FULL) == 0u) {
        UART_DATA(LINE_UART) = bytes[sent];
        sent++;
    }
    line.sent += (uint32_t)sent;
    moved = moved || sent > 0u;
    return sent;
}

void board_lock(void)
{
    __asm volatile("cpsid i" ::: "memory");
    MASK_VALUE = 0;
    MASK_CONTROL = MASK_ON;
}

void board_unlock(void)
{
    grants_masked(MASK_MOST - MASK_VALUE);
    MASK_CONTROL = 0;
    __asm volatile("cpsie i" ::: "memory");
}

void board_kick(void)
{
}

void board_stage_move(double position_m, bool away)
{
    (void)position_m;
    (void)away;
}

enum stage_progress board_stage_progress(void)
{
    return STAGE_ARRIVED;
}

void board_stage_stop(void)
{
}

void line_interrupt(void)
{
    UART_CLEAR(LINE_UART) = UART_RECEIVED;
    const uint8_t byte = (uint8_t)(UART_DATA(LINE_UART) & 0xFFu);
    if (line.in - line.out < RING) {
        line.bytes[line.in % RING] = byte;
        line.in++;
    }
    interrupted = true;
}

void grant_interrupt(void)
{
    UART_CLEAR(GRANT_UART) = UART_RECEIVED;
    grants_receive((uint8_t)(UART_DATA(GRANT_UART) & 0xFFu));
    interrupted = true;
}

void sample_interrupt(void)
{
    const uint32_t begin = counted_ticks();
    TIMER_CLEAR(SAMPLE_TIMER) = 1u;
    firmware_interrupt(&firmware);
    interrupted = true;
    grants_count(counted_ticks() - begin - plant_ticks);
}

/* Wait for an interrupt, unless one has run in this pass. In lockstep the processor sleeps only while the timers stand
 * still: QEMU 7.2 skips a period of a timer when a processor sleeps whose instructions are its clock. A masked interrupt
 * also ends the sleep. */
static void rest(void)
{
    while (grants_running() && !interrupted) {
    }
    __asm volatile("cpsid i" ::: "memory");
    if (!interrupted) {
        __asm volatile("wfi");
    }
    __asm volatile("cpsie i" ::: "memory");
}

static void start_uart(uint32_t base, uint32_t interrupt)
{
    UART_DIVIDER(base) = 16u;
    UART_CONTROL(base) = UART_ON;
    INTERRUPT_PRIORITY(interrupt) = 0x40u; /* the sample interrupt, at 0, comes first */
    INTERRUPT_ENABLE = 1u << interrupt;
}

int main(void)
{
    TIMER_RELOAD(CLOCK_TIMER) = 0xFFFFFFFFu;
    TIMER_CONTROL(CLOCK_TIMER) = TIMER_ON;
    newest_ticks = counted_ticks();
    MASK_RELOAD = MASK_MOST;
    plant_init((enum plant_kind)((STRAPS[0] >> STRAP_PLANT) & 3u), &PROPERTIES, 0.008);
    firmware_init(&firmware);
    TIMER_RELOAD(SAMPLE_TIMER) = CLOCK_HZ / PROPERTIES.sample_rate_hz - 1u;
    TIMER_CONTROL(SAMPLE_TIMER) = TIMER_INTERRUPT | TIMER_ON;
    if ((STRAPS[0] & STRAP_LOCKSTEP) != 0u) {
        grants_begin();
        start_uart(GRANT_UART, GRANT_INTERRUPT);
    }
    INTERRUPT_ENABLE = 1u << SAMPLE_INTERRUPT;
    start_uart(LINE_UART, LINE_INTERRUPT);
    for (;;) {
        moved = false;
        interrupted = false;
        firmware_poll(&firmware);
        const bool idle = !moved && !interrupted;
        grants_poll(&world, line.in, line.sent, idle);
        if (idle) {
            rest();
        }
    }
}

__attribute__((section(".vectors.board"), used)) static const vector VECTORS[SAMPLE_INTERRUPT + 1u] = {
    [LINE_INTERRUPT] = line_interrupt,
    [GRANT_INTERRUPT] = grant_interrupt,
    [SAMPLE_INTERRUPT] = sample_interrupt,
};
