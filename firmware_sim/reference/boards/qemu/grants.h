/* Lockstep of the emulated processor with a test: time passes only when it is granted, over UART 1.
 *
 * A grant has eight bytes: u8 disturbances (as in posix/lockstep.h, W), u8 0, u16 samples, u32 bytes that the test has
 * sent to UART 0 since the start. The timers stand still until the firmware has processed those bytes, then run for the
 * granted samples. When the firmware has nothing left to do, the answer is u32 bytes that it has sent on UART 0, and the
 * largest numbers of ticks since the last answer: u32 that one sample interrupt has taken, without the plant, and u32 that
 * it was masked. */
#ifndef GRANTS_H
#define GRANTS_H

#include <stdbool.h>
#include <stdint.h>

#include "plant.h"

/* Stop the timers: from now on time is granted. */
void grants_begin(void);

/* Whether granted time is passing. */
bool grants_running(void);

/* Store a received byte; called by the interrupt of UART 1. */
void grants_receive(uint8_t byte);

/* Count a sample, and stop the timers after the last granted one; called at the end of the sample interrupt. */
void grants_count(uint32_t ticks);

/* Note for how many ticks the sample interrupt was masked. */
void grants_masked(uint32_t ticks);

/* Begin a grant, or answer it. received, sent: bytes of UART 0; idle: the firmware has nothing to do. */
void grants_poll(struct world *world, uint32_t received, uint32_t sent, bool idle);

#endif
