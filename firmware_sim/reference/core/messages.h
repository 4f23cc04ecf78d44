/* Types, states, results, faults and flags of docs/protocol.md, sections 3 to 5. */
#ifndef MESSAGES_H
#define MESSAGES_H

enum message {
    HELLO = 0x01,
    STREAM = 0x02,
    STIMULUS_BEGIN = 0x10,
    STIMULUS_CHUNK = 0x11,
    STIMULUS_COMMIT = 0x12,
    FOLLOW = 0x13,
    SETPOINTS = 0x14,
    ARM = 0x20,
    START = 0x21,
    STOP = 0x22,
    RELEASE = 0x23,
    CLEAR_FAULTS = 0x24,
    FINISH = 0x25,
    STAGE = 0x26,
    HEARTBEAT = 0x30,
    STATUS_REQUEST = 0x31,
    HELLO_ACK = 0x81,
    ACK = 0x82,
    DATA = 0x83,
    STATUS = 0x84
};

enum state { STATE_IDLE = 0, STATE_LOADED = 1, STATE_ARMED = 2, STATE_RUNNING = 3, STATE_FAULT = 4 };

enum result {
    RESULT_OK = 0,
    RESULT_BAD_STATE = 1,
    RESULT_BAD_ARGUMENT = 2,
    RESULT_TOO_LARGE = 3,
    RESULT_CHECKSUM = 4,
    RESULT_FAULT_LATCHED = 5,
    RESULT_BEYOND_LIMITS = 6,
    RESULT_UNKNOWN = 7,
    RESULT_LATE = 8
};

#define FAULT_NONE 0u
#define FAULT_WATCHDOG 1u
#define FAULT_OVER_FORCE 2u
#define FAULT_STROKE 4u
#define FAULT_OVER_TEMPERATURE 8u
#define FAULT_OVER_TIME 16u
#define FAULT_BUTTON 32u
#define FAULT_STARVED 64u
#define FAULT_BROWN_OUT 128u
#define FAULT_SENSOR 256u
#define FAULT_OPEN_COIL 512u

#define FLAG_BUTTON 1u
#define FLAG_PLAYING 2u
#define FLAG_ENERGISED 4u
#define FLAG_SATURATED 8u
#define FLAG_HELD 16u
#define FLAG_SOFT_START 32u
#define FLAG_LIMITED 64u

#endif
