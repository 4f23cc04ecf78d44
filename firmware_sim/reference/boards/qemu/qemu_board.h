/* Interrupts of the board of QEMU's mps2-an500. */
#ifndef QEMU_BOARD_H
#define QEMU_BOARD_H

/* Interrupts: a byte on UART 0, a byte on UART 1, the sample timer. */
void line_interrupt(void);
void grant_interrupt(void);
void sample_interrupt(void);

#endif
