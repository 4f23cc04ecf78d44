/* Board of QEMU's mps2-an500 (Cortex-M7, 25 MHz): the line is UART 0, the sample clock timer 0, the plant is behind it.
 *
 *   qemu-system-arm -M mps2-an500 -nographic -monitor none -serial tcp:127.0.0.1:7800,server,nowait -kernel PROGRAM */
#include "board.h"
#include "desktop_device.h"
#include "firmware.h"
#include "plant.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u)
#define UART_CONTROL REGISTER(0x40004008u)
#define UART_DIVIDER REGISTER(0x40004010u)
#define SAMPLE_CONTROL REGISTER(0x40000000u)
#define SAMPLE_RELOAD REGISTER(0x40000008u)
#define SAMPLE_CLEAR REGISTER(0x4000000Cu)
#define CLOCK_CONTROL REGISTER(0x40001000u)
#define CLOCK_VALUE REGISTER(0x40001004u)
#define CLOCK_RELOAD REGISTER(0x40001008u)
#define INTERRUPT_ENABLE REGISTER(0xE000E100u)
#define COPROCESSORS REGISTER(0xE000ED88u)
#define SAMPLE_INTERRUPT 8u
#define CLOCK_HZ 25000000u

static struct firmware firmware;
static struct world world;
static bool amplifier;
static int16_t command;
static uint32_t newest_ticks;
static uint64_t ticks;

static const struct board_properties PROPERTIES = {
    .model = "desktop indenter (QEMU)",
    .serial_number = "QEMU-0001",
    .firmware_version = "ref-1.0",
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

void board_read(struct board_sample *sample)
{
    plant_step(&world, amplifier, command, sample);
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
    const uint32_t now = 0xFFFFFFFFu - CLOCK_VALUE;
    ticks += now - newest_ticks;
    newest_ticks = now;
    return ticks / (CLOCK_HZ / 1000000u);
}

uint32_t board_random(void)
{
    return 0x51E3Au; /* QEMU's board has no source of noise: each start looks the same */
}

size_t board_receive(uint8_t *bytes, size_t most)
{
    size_t count = 0;
    while (count < most && (UART_STATE & 2u) != 0u) {
        bytes[count] = (uint8_t)(UART_DATA & 0xFFu);
        count++;
    }
    return count;
}

size_t board_send(const uint8_t *bytes, size_t count)
{
    size_t sent = 0;
    while (sent < count && (UART_STATE & 1u) == 0u) {
        UART_DATA = bytes[sent];
        sent++;
    }
    return sent;
}

void board_lock(void)
{
    __asm volatile("cpsid i" ::: "memory");
}

void board_unlock(void)
{
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

static void sample_interrupt(void)
{
    SAMPLE_CLEAR = 1u;
    firmware_interrupt(&firmware);
}

int main(void)
{
    UART_DIVIDER = 16u;
    UART_CONTROL = 3u;
    CLOCK_RELOAD = 0xFFFFFFFFu;
    CLOCK_CONTROL = 1u;
    newest_ticks = 0xFFFFFFFFu - CLOCK_VALUE;
    plant_init(PLANT_FREE, &PROPERTIES, 0.008);
    firmware_init(&firmware);
    SAMPLE_RELOAD = CLOCK_HZ / PROPERTIES.sample_rate_hz - 1u;
    SAMPLE_CONTROL = 9u; /* enabled, with interrupt */
    INTERRUPT_ENABLE = 1u << SAMPLE_INTERRUPT;
    for (;;) {
        firmware_poll(&firmware);
    }
}

/* -- start of the processor ----------------------------------------------------------------------------- */

extern uint32_t data_load[], data_start[], data_end[], bss_start[], bss_end[], stack_top[];

void reset(void);

void reset(void)
{
    COPROCESSORS |= 0xFu << 20; /* the floating-point unit */
    __asm volatile("dsb\n isb");
    for (uint32_t *to = data_start, *from = data_load; to < data_end; to++, from++) {
        *to = *from;
    }
    for (uint32_t *to = bss_start; to < bss_end; to++) {
        *to = 0;
    }
    (void)main();
}

/* A fault of the processor: the amplifier is off, and the hardware watchdog of a real board restarts it. */
static void halt(void)
{
    amplifier = false;
    for (;;) {
    }
}

typedef void (*vector)(void);

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    vector handlers[15 + SAMPLE_INTERRUPT + 1];
} VECTORS = {stack_top,
             {reset, halt, halt, halt, halt, halt, 0, 0, 0, 0, halt, halt, 0, halt, halt, [15 + SAMPLE_INTERRUPT] = sample_interrupt}};
