/* Payload of HELLO_ACK (4.1). */
#ifndef HANDSHAKE_H
#define HANDSHAKE_H

#include <stddef.h>
#include <stdint.h>

#include "board.h"

#define HELLO_BYTES 32u
#define HANDSHAKE_BYTES (172u + CHANNELS * 40u + 8u)

/* Write the payload; return its length. */
size_t handshake_write(uint8_t *payload, const struct board_properties *device, uint32_t boot_id);

#endif
