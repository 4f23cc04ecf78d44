/* Start of the processor: floating-point unit, variables, vectors. */
#include <stdint.h>

#include "qemu_board.h"
#include "registers.h"

extern uint32_t data_load[], data_start[], data_end[], bss_start[], bss_end[], stack_top[];

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
    board_amplifier(false);
    for (;;) {
    }
}

typedef void (*vector)(void);

#define EXTERNAL(number) [15u + (number)]

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    vector handlers[15u + SAMPLE_INTERRUPT + 1u];
} VECTORS = {stack_top,
             {reset, halt, halt, halt, halt, halt, 0, 0, 0, 0, halt, halt, 0, halt, halt,
              EXTERNAL(LINE_INTERRUPT) = line_interrupt, EXTERNAL(GRANT_INTERRUPT) = grant_interrupt,
              EXTERNAL(SAMPLE_INTERRUPT) = sample_interrupt}};
