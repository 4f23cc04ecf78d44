#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE

#include "line.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static bool set_nonblocking(int file)
{
    const int flags = fcntl(file, F_GETFL);
    return flags >= 0 && fcntl(file, F_SETFL, flags | O_NONBLOCK) == 0;
}

bool line_open_terminal(struct line *line)
{
    struct termios settings;
    line->listener = -1;
    line->spare = -1;
    line->host = posix_openpt(O_RDWR | O_NOCTTY);
    if (line->host < 0 || grantpt(line->host) != 0 || unlockpt(line->host) != 0) {
        return false;
    }
    const char *name = ptsname(line->host);
    if (name == NULL) {
        return false;
    }
    (void)snprintf(line->url, sizeof line->url, "%s", name);
    line->spare = open(name, O_RDWR | O_NOCTTY);
    if (line->spare < 0 || tcgetattr(line->spare, &settings) != 0) {
        return false;
    }
    cfmakeraw(&settings);
    return tcsetattr(line->spare, TCSANOW, &settings) == 0 && set_nonblocking(line->host);
}

bool line_open_socket(struct line *line, uint16_t port)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(port)};
    socklen_t size = sizeof address;
    const int on = 1;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    line->host = -1;
    line->spare = -1;
    line->listener = socket(AF_INET, SOCK_STREAM, 0);
    if (line->listener < 0 || setsockopt(line->listener, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) != 0 ||
        bind(line->listener, (struct sockaddr *)&address, sizeof address) != 0 || listen(line->listener, 4) != 0 ||
        getsockname(line->listener, (struct sockaddr *)&address, &size) != 0) {
        return false;
    }
    (void)snprintf(line->url, sizeof line->url, "socket://127.0.0.1:%u", (unsigned)ntohs(address.sin_port));
    return set_nonblocking(line->listener);
}

/* Accept a host; return whether there is one. Only one at a time, as on a cable: another is turned away. */
static bool accept_host(struct line *line)
{
    const int on = 1;
    const int newcomer = accept(line->listener, NULL, NULL);
    if (newcomer < 0) {
        return false;
    }
    if (line->host >= 0 || !set_nonblocking(newcomer)) {
        (void)close(newcomer);
        return false;
    }
    (void)setsockopt(newcomer, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    line->host = newcomer;
    return true;
}

static void hang_up(struct line *line)
{
    if (line->listener >= 0 && line->host >= 0) {
        (void)close(line->host);
        line->host = -1;
    }
}

bool line_wait(struct line *line, uint64_t most_us)
{
    struct pollfd files[2] = {{line->host, POLLIN, 0}, {line->listener, POLLIN, 0}};
    const struct timespec most = {(time_t)(most_us / 1000000u), (long)(most_us % 1000000u) * 1000L};
    /* poll() counts milliseconds, too coarse for a sample: sleep first, then look. */
    if (most_us < 2000u) {
        (void)nanosleep(&most, NULL);
        (void)poll(files, 2, 0);
    } else {
        (void)poll(files, 2, (int)(most_us / 1000u));
    }
    return (files[1].revents & POLLIN) != 0 && accept_host(line);
}

size_t line_receive(struct line *line, uint8_t *bytes, size_t most)
{
    if (line->host < 0) {
        return 0;
    }
    const ssize_t count = read(line->host, bytes, most);
    if (count > 0) {
        return (size_t)count;
    }
    if (count == 0 || (errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR && errno != EIO)) {
        hang_up(line);
    }
    return 0;
}

size_t line_send(struct line *line, const uint8_t *bytes, size_t count)
{
    if (line->host < 0) {
        return count;
    }
    const ssize_t sent = write(line->host, bytes, count);
    if (sent >= 0) {
        return (size_t)sent;
    }
    if (errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR && errno != EIO) {
        hang_up(line);
    }
    return 0;
}
