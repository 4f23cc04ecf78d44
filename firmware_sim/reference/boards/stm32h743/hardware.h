/* Set-up of the microcontroller, and transfers to its converters. */
#ifndef HARDWARE_H
#define HARDWARE_H

#include <stdbool.h>
#include <stdint.h>

/* Set a pin of port E. */
void pin_set(uint32_t pin, bool high);

/* Clocks and pins; the amplifier is off. Must be called first. */
void hardware_begin(void);

/* Start the sample clock, the line and the hardware watchdog; interrupts come from now on. */
void hardware_run(uint32_t sample_rate_hz);

/* Exchange words of 8 or 16 bits with the converter that a pin selects; sent may be 0. */
void spi_exchange(uint32_t pin, uint32_t bits, const uint16_t *sent, uint16_t *received, uint32_t count);

#endif
