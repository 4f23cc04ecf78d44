#include "hardware.h"

#include "registers.h"

#define BAUD_RATE 921600u
#define LINE_PRIORITY 0x10u
#define SAMPLE_PRIORITY 0x20u

enum mode { INPUT, OUTPUT, ALTERNATE };
enum pull { NO_PULL, PULL_UP, PULL_DOWN };

static void pin_mode(enum port port, uint32_t pin, enum mode mode, enum pull pull)
{
    GPIO_PULL(port) = (GPIO_PULL(port) & ~(3u << (2u * pin))) | ((uint32_t)pull << (2u * pin));
    GPIO_SPEED(port) |= 2u << (2u * pin);
    GPIO_MODE(port) = (GPIO_MODE(port) & ~(3u << (2u * pin))) | ((uint32_t)mode << (2u * pin));
}

static void pin_function(enum port port, uint32_t pin, uint32_t function)
{
    const uint32_t shift = 4u * (pin % 8u);
    GPIO_FUNCTION(port, pin) = (GPIO_FUNCTION(port, pin) & ~(15u << shift)) | (function << shift);
    pin_mode(port, pin, ALTERNATE, NO_PULL);
}

void pin_set(uint32_t pin, bool high)
{
    GPIO_SET_CLEAR(PORT_E) = BIT(high ? pin : pin + 16u);
}

static void begin_pins(void)
{
    RCC_AHB4ENR |= BIT(PORT_A) | BIT(PORT_C) | BIT(PORT_D) | BIT(PORT_E);
    (void)RCC_AHB4ENR;
    pin_set(PIN_AMPLIFIER, false); /* before the pin is an output */
    pin_set(PIN_DAC, true);
    pin_set(PIN_ADC, true);
    pin_mode(PORT_E, PIN_AMPLIFIER, OUTPUT, NO_PULL);
    pin_mode(PORT_E, PIN_DAC, OUTPUT, NO_PULL);
    pin_mode(PORT_E, PIN_ADC, OUTPUT, NO_PULL);
    pin_mode(PORT_E, PIN_ADC_RESET, OUTPUT, NO_PULL);
    pin_mode(PORT_E, PIN_BUTTON, INPUT, PULL_UP);
    pin_mode(PORT_E, PIN_SUPPLY, INPUT, PULL_DOWN);
    pin_mode(PORT_C, 7u, INPUT, PULL_DOWN);
    pin_function(PORT_A, 5u, 5u);
    pin_function(PORT_A, 6u, 5u);
    pin_function(PORT_A, 7u, 5u);
    pin_function(PORT_C, 6u, 2u);
    pin_function(PORT_D, 8u, 7u);
    pin_function(PORT_D, 9u, 7u);
}

/* The slow oscillator: its timer must not depend on that of the samples. */
static void begin_slow_clock(void)
{
    RCC_CSR |= BIT(0);
    while ((RCC_CSR & BIT(1)) == 0u) {
    }
    RCC_D2CCIP2R = (RCC_D2CCIP2R & ~(7u << 28)) | (4u << 28);
    RCC_APB1LENR |= BIT(9);
    (void)RCC_APB1LENR;
    SLOW_CFGR = 0;
    SLOW_CR = BIT(0);
    SLOW_ARR = 0xFFFFu;
    while ((SLOW_ISR & BIT(4)) == 0u) {
    }
    SLOW_CR = BIT(0) | BIT(2);
}

static void begin_noise(void)
{
    RCC_CR |= BIT(12);
    while ((RCC_CR & BIT(13)) == 0u) {
    }
    RCC_AHB2ENR |= BIT(6);
    (void)RCC_AHB2ENR;
    RNG_CR = BIT(2);
}

/* Both converters take data at the falling edge of a clock that rests high. */
static void begin_spi(void)
{
    RCC_D2CCIP1R = (RCC_D2CCIP1R & ~(7u << 12)) | (4u << 12); /* from the internal oscillator, not the PLL */
    RCC_APB2ENR |= BIT(12);
    (void)RCC_APB2ENR;
    SPI_CR1 = BIT(12);
    SPI_CFG2 = BIT(22) | BIT(25) | BIT(26) | BIT(31); /* master, clock high at rest, select by pins, keep the pins */
}

void hardware_begin(void)
{
    begin_pins();
    begin_slow_clock();
    begin_noise();
    begin_spi();
    pin_set(PIN_ADC_RESET, true);
    for (uint32_t k = 0; k < 1000u; k++) {
        (void)RCC_CR;
    }
    pin_set(PIN_ADC_RESET, false);
}

static void allow(uint32_t interrupt, uint8_t priority)
{
    INTERRUPT_PRIORITY(interrupt) = priority;
    INTERRUPT_ENABLE(interrupt) = BIT(interrupt % 32u);
}

void hardware_run(uint32_t sample_rate_hz)
{
    RCC_APB1LENR |= BIT(1) | BIT(18);
    RCC_APB4ENR |= BIT(1);
    (void)RCC_APB4ENR;

    USART_BRR = (CLOCK_HZ + BAUD_RATE / 2u) / BAUD_RATE;
    USART_CR1 = BIT(29) | BIT(5) | BIT(3) | BIT(2) | BIT(0); /* queue, interrupt at a byte, send, receive, on */
    allow(USART_INTERRUPT, LINE_PRIORITY);

    SYSCFG_EXTICR2 = (SYSCFG_EXTICR2 & ~(15u << 12)) | ((uint32_t)PORT_C << 12);
    EXTI_FTSR1 |= BIT(7);
    EXTI_IMR1 |= BIT(7);
    allow(SAMPLE_INTERRUPT, SAMPLE_PRIORITY);

    WATCHDOG_KR = 0xCCCCu;
    WATCHDOG_KR = 0x5555u;
    WATCHDOG_PR = 0;                           /* a quarter of the slow oscillator */
    WATCHDOG_RLR = SLOW_HZ / 4u * 50u / 1000u; /* 50 ms */
    while (WATCHDOG_SR != 0u) {
    }
    WATCHDOG_KR = 0xAAAAu;

    TIMER_ARR = CLOCK_HZ / sample_rate_hz - 1u;
    TIMER_CCR1 = CLOCK_HZ / 1000000u; /* a pulse of 1 us */
    TIMER_CCMR1 = 6u << 4;
    TIMER_CCER = BIT(0);
    TIMER_EGR = BIT(0);
    TIMER_CR1 = BIT(0);
}

void spi_exchange(uint32_t pin, uint32_t bits, const uint16_t *sent, uint16_t *received, uint32_t count)
{
    SPI_CFG1 = (1u << 28) | (bits - 1u); /* 16 MHz */
    SPI_CR2 = count;
    SPI_CR1 = BIT(12) | BIT(0);
    pin_set(pin, false);
    SPI_CR1 = BIT(12) | BIT(9) | BIT(0);
    for (uint32_t k = 0; k < count; k++) {
        while ((SPI_SR & SPI_ROOM) == 0u) {
        }
        if (bits > 8u) {
            *(volatile uint16_t *)&SPI_TXDR = sent != 0 ? sent[k] : 0u;
        } else {
            *(volatile uint8_t *)&SPI_TXDR = (uint8_t)(sent != 0 ? sent[k] : 0u);
        }
        while ((SPI_SR & SPI_ARRIVED) == 0u) {
        }
        const uint16_t word = bits > 8u ? *(volatile uint16_t *)&SPI_RXDR : *(volatile uint8_t *)&SPI_RXDR;
        if (received != 0) {
            received[k] = word;
        }
    }
    while ((SPI_SR & SPI_ENDED) == 0u) {
    }
    pin_set(pin, true);
    SPI_IFCR = BIT(3) | BIT(4);
    SPI_CR1 = BIT(12);
}
