/* Lockstep: a test gives bytes and time on standard input, and reads what the firmware sends on standard output. */
#ifndef LOCKSTEP_H
#define LOCKSTEP_H

#include "firmware.h"

/* Obey commands until the end of standard input; return an exit status.
 *
 * R u64 us, u32 n, n bytes   the firmware receives bytes at this time of its clock
 * A u64 us, u32 n            n samples, all at this time: first the command, then the sample, as in the simulator
 * V u32 n                    n samples, each with its own time: first the sample, then the next command
 * W u8 bits                  button 1, supply low 2, position stuck 4, coil open 8
 * T                          answers u32 n and the n bytes that wait to be sent */
int lockstep_run(struct firmware *firmware);

#endif
