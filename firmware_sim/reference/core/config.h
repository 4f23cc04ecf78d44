/* Sizes and times of the firmware. A board may override the sizes marked "board" on the compiler's command line. */
#ifndef CONFIG_H
#define CONFIG_H

#ifndef STIMULUS_CAPACITY
#define STIMULUS_CAPACITY 240000u /* board: samples of the longest stimulus, 2 bytes each */
#endif
#ifndef TRANSMIT_BYTES
#define TRANSMIT_BYTES 65536u /* board: bytes that may wait for the line */
#endif

#define PROTOCOL_VERSION 1u
#define MAX_PAYLOAD 2048u
#define CHANNELS 7u /* converters of a sample, the command first */
#define MAX_RATE_HZ 5000u
#define SETPOINT_BUFFER 8192u /* set-points ahead of the sample being played; a power of two */
#define ANSWERS 64u           /* answers kept for repeated requests */
#define EVENTS 16u            /* changes of state that may wait for the main loop */
#define DATA_FRAMES 16u       /* frames of samples, 10 ms each, that may wait for the main loop, which checks a stimulus */
#define SETPOINT_STEPS 32u    /* set-points that are stored or looked at with the sample interrupt masked */

#define WATCHDOG_US 500000u      /* longest time without a heartbeat, armed or running */
#define HOST_SILENCE_US 2000000u /* time without a frame after which streaming and the stage stop */
#define MAX_RUN_S 90u            /* longest run */

#define MAX_SAMPLES_PER_FRAME (MAX_RATE_HZ / 100u)
#define MAX_SOFT_SAMPLES (MAX_RATE_HZ / 20u)

#endif
