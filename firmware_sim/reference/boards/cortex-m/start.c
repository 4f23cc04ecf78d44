/* Start of a Cortex-M: floating-point unit, variables, main(). A board adds its interrupts in section .vectors.board. */
#include "start.h"

#include <stdint.h>

#include "board.h"

#define COPROCESSORS (*(volatile uint32_t *)0xE000ED88u)

extern uint32_t data_load[], data_start[], data_end[], bss_start[], bss_end[], stack_top[];

void reset(void)
{
    COPROCESSORS |= 0xFu << 20; /* the floating-point unit */
    __asm volatile("dsb\n isb");
    for (uint32_t *to = data_start, *from = data_load; to < data_end; to++, from++) {
        *to = *from;
    }
    /* cppcheck-suppress comparePointers ; the linker sets both */
    for (uint32_t *to = bss_start; to < bss_end; to++) {
        *to = 0;
    }
    (void)main();
}

/* A fault of the processor: the amplifier is off, and the hardware watchdog of a real board restarts it. */
void halt(void)
{
    board_amplifier(false);
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack; /* cppcheck-suppress unusedStructMember ; read by the processor */
    /* cppcheck-suppress unusedStructMember */
    vector handlers[15];
} VECTORS = {stack_top, {reset, halt, halt, halt, halt, halt, 0, 0, 0, 0, halt, halt, 0, halt, halt}};
