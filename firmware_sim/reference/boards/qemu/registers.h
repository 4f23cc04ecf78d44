/* Registers of QEMU's mps2-an500: CMSDK UARTs and timers, and the interrupt controller of the Cortex-M7. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))

/* UART 0 is the line to the host, UART 1 grants time (grants.h). */
#define LINE_UART 0x40004000u
#define GRANT_UART 0x40005000u
#define UART_DATA(base) REGISTER((base) + 0x0u)
#define UART_STATE(base) REGISTER((base) + 0x4u)
#define UART_CONTROL(base) REGISTER((base) + 0x8u)
#define UART_CLEAR(base) REGISTER((base) + 0xCu)
#define UART_DIVIDER(base) REGISTER((base) + 0x10u)
#define UART_TRANSMIT_FULL 1u
#define UART_RECEIVED 2u
#define UART_ON 0xBu /* send, receive, interrupt at each received byte */

#define SAMPLE_TIMER 0x40000000u
#define CLOCK_TIMER 0x40001000u
#define TIMER_CONTROL(base) REGISTER((base) + 0x0u)
#define TIMER_VALUE(base) REGISTER((base) + 0x4u)
#define TIMER_RELOAD(base) REGISTER((base) + 0x8u)
#define TIMER_CLEAR(base) REGISTER((base) + 0xCu)
#define TIMER_ON 1u
#define TIMER_INTERRUPT 8u

/* The processor's own timer counts how long the sample interrupt is masked. */
#define MASK_CONTROL REGISTER(0xE000E010u)
#define MASK_RELOAD REGISTER(0xE000E014u)
#define MASK_VALUE REGISTER(0xE000E018u)
#define MASK_ON 5u
#define MASK_MOST 0xFFFFFFu

#define INTERRUPT_ENABLE REGISTER(0xE000E100u)
#define INTERRUPT_PRIORITY(number) (*(volatile uint8_t *)(0xE000E400u + (number)))
#define LINE_INTERRUPT 0u
#define GRANT_INTERRUPT 2u
#define SAMPLE_INTERRUPT 8u
#define CLOCK_HZ 25000000u

/* Words that QEMU's generic loader writes before the start (firmware_sim/reference/emulator.py). */
#define STRAPS ((volatile const uint32_t *)0x203FFFF0u)
#define STRAP_LOCKSTEP 1u
#define STRAP_PLANT 8u /* the byte from this bit on: enum plant_kind */

#endif
