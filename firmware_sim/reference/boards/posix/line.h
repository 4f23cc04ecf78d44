/* The device's end of the cable: a pseudo-terminal, or one TCP connection on the loopback interface. */
#ifndef LINE_H
#define LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct line {
    int listener; /* -1: a pseudo-terminal */
    int host;     /* -1: no host is connected */
    int spare;    /* the terminal's other end, kept open between hosts */
    char url[128];
};

/* Open a pseudo-terminal; return whether it succeeded. */
bool line_open_terminal(struct line *line);

/* Listen on a port of 127.0.0.1, 0 for a free one; return whether it succeeded. */
bool line_open_socket(struct line *line, uint16_t port);

/* Wait until bytes or a host arrive, at most for a time; return whether a host has connected. */
bool line_wait(struct line *line, uint64_t most_us);

/* Move bytes without waiting; return their number. Without a host, sent bytes are discarded. */
size_t line_receive(struct line *line, uint8_t *bytes, size_t most);
size_t line_send(struct line *line, const uint8_t *bytes, size_t count);

#endif
