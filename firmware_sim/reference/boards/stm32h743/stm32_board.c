/* Template for a physical board: NUCLEO-H743ZI2 with an AD7606 (eight inputs, 16 bit, all at once, +-10 V) and an AD5761R
 * (16 bit, +-10 V) on SPI 1; pins in registers.h. It compiles, and has not run on hardware: bring it up in the steps of
 * docs/build-an-instrument.md. */
#include "desktop_device.h"
#include "firmware.h"
#include "hardware.h"
#include "registers.h"
#include "start.h"

#define RING 4096u /* received bytes that wait for the main loop; a power of two */
#define MASKED 0x20u

static struct firmware firmware;

static struct {
    uint8_t bytes[RING];
    volatile uint32_t in; /* bytes since the start: written by the interrupt */
    uint32_t out;         /* taken by the main loop */
} line;

static struct {
    uint32_t newest;
    uint64_t ticks;
} slow_clock;

/* Replace the figures by those that were measured on your instrument. */
static const struct board_properties PROPERTIES = {
    .model = "desktop indenter",
    .serial_number = "H743-0001",
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
    pin_set(PIN_AMPLIFIER, enabled);
}

/* AD5761R: command 3 writes and updates the output; code 0x8000 is 0 V. */
void board_command(int16_t code)
{
    const uint16_t bits = (uint16_t)((uint16_t)code ^ 0x8000u);
    const uint16_t words[3] = {0x03u, (uint16_t)(bits >> 8), (uint16_t)(bits & 0xFFu)};
    spi_exchange(PIN_DAC, 8, words, 0, 3);
}

/* The inputs of the AD7606, in the order of the channels after the command; the last two are not used. */
void board_read(struct board_sample *sample)
{
    uint16_t words[8];
    spi_exchange(PIN_ADC, 16, 0, words, 8);
    sample->saturated = false;
    for (uint32_t k = VOLTAGE; k < CHANNELS; k++) {
        const uint16_t word = words[k - 1u];
        sample->code[k] = (int16_t)word;
        sample->saturated = sample->saturated || word == 0x7FFFu || word == 0x8000u;
    }
}

bool board_button(void)
{
    return (GPIO_INPUT(PORT_E) & BIT(PIN_BUTTON)) != 0u;
}

bool board_supply_low(void)
{
    return (GPIO_INPUT(PORT_E) & BIT(PIN_SUPPLY)) == 0u;
}

/* The counter of the slow oscillator is read until two readings agree. It wraps after 2 s, and is read at every sample. */
uint64_t board_clock_us(void)
{
    uint32_t now = SLOW_CNT;
    for (uint32_t again = SLOW_CNT; again != now; again = SLOW_CNT) {
        now = again;
    }
    slow_clock.ticks += (now - slow_clock.newest) & 0xFFFFu;
    slow_clock.newest = now;
    return slow_clock.ticks * 1000000u / SLOW_HZ;
}

uint32_t board_random(void)
{
    for (uint32_t k = 0; k < 100000u; k++) {
        if ((RNG_SR & BIT(0)) != 0u) {
            return RNG_DR;
        }
    }
    return SLOW_CNT; /* the noise source does not start */
}

size_t board_receive(uint8_t *bytes, size_t most)
{
    size_t count = 0;
    while (count < most && line.out != line.in) {
        bytes[count] = line.bytes[line.out % RING];
        line.out++;
        count++;
    }
    return count;
}

size_t board_send(const uint8_t *bytes, size_t count)
{
    size_t sent = 0;
    while (sent < count && (USART_ISR & USART_ROOM) != 0u) {
        USART_TDR = bytes[sent];
        sent++;
    }
    return sent;
}

/* The interrupt of the line is not masked: its queue of 16 bytes would overflow within 170 us. */
void board_lock(void)
{
    __asm volatile("msr basepri, %0" ::"r"(MASKED) : "memory");
}

void board_unlock(void)
{
    __asm volatile("msr basepri, %0" ::"r"(0) : "memory");
}

void board_kick(void)
{
    WATCHDOG_KR = 0xAAAAu;
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

static void line_interrupt(void)
{
    USART_ICR = BIT(3); /* an overrun costs the frame in progress */
    if ((USART_ISR & USART_RECEIVED) != 0u) {
        const uint8_t byte = (uint8_t)(USART_RDR & 0xFFu);
        if (line.in - line.out < RING) {
            line.bytes[line.in % RING] = byte;
            line.in++;
        }
    }
}

static void sample_interrupt(void)
{
    EXTI_PR1 = BIT(7);
    firmware_interrupt(&firmware);
}

int main(void)
{
    hardware_begin();
    slow_clock.newest = SLOW_CNT & 0xFFFFu;
    /* AD5761R: command 4 sets the range of +-10 V, and 0 V after a start and a clear. */
    const uint16_t range[3] = {0x04u, 0x02u, 0x48u};
    spi_exchange(PIN_DAC, 8, range, 0, 3);
    firmware_init(&firmware);
    hardware_run(PROPERTIES.sample_rate_hz);
    for (;;) {
        firmware_poll(&firmware);
    }
}

__attribute__((section(".vectors.board"), used)) static const vector VECTORS[USART_INTERRUPT + 1u] = {
    [SAMPLE_INTERRUPT] = sample_interrupt,
    [USART_INTERRUPT] = line_interrupt,
};
