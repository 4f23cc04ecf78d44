/* Requests of the host (docs/protocol.md, sections 3 and 4). */
#ifndef REQUESTS_H
#define REQUESTS_H

#include "firmware.h"

/* Handle a frame: execute and answer it. */
void requests_handle(struct firmware *firmware, const struct frame *frame);

/* Answer the request of the stage when its motion has ended. */
void requests_stage(struct firmware *firmware);

#endif
