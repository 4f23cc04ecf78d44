/* The reference firmware as a process: on a pseudo-terminal or a TCP port in real time, or in lockstep with a test. */
#define _XOPEN_SOURCE 700

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "firmware.h"
#include "lockstep.h"
#include "posix_board.h"

static struct firmware firmware;
static volatile sig_atomic_t stopping;

/* Longest delay of this process that is caught up; for longer ones the clock of the device stops, as no real one does. */
#define LAG_US 20000u

static const char USAGE[] =
    "usage: reference-posix [--pty | --tcp PORT | --lockstep] [--plant tissue|free|dummy|script] [--rate HZ]\n"
    "                       [--boot-id N] [--stage M_PER_S]\n";

static void stop(int number)
{
    (void)number;
    stopping = 1;
}

static uint64_t now_us(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

/* Run the device in real time until a signal arrives. */
static void serve(struct line *line)
{
    const uint64_t period_us = 1000000u / posix_board.properties.sample_rate_hz;
    uint64_t start_us = now_us();
    uint64_t samples = 0;
    while (stopping == 0) {
        uint64_t now = now_us();
        const uint64_t due_us = start_us + samples * period_us;
        if (now > due_us + LAG_US) {
            start_us += now - due_us - LAG_US;
        }
        while (stopping == 0 && start_us + samples * period_us <= now) {
            posix_board.clock_us = now;
            firmware_interrupt(&firmware);
            firmware_collect(&firmware);
            samples++;
        }
        for (int k = 0; k < 64; k++) { /* 4 kB of requests, and what they are answered */
            posix_board.clock_us = now_us();
            firmware_poll(&firmware);
        }
        now = now_us();
        const uint64_t wake_us = start_us + samples * period_us;
        if (line_wait(line, wake_us > now ? wake_us - now : 0u)) {
            firmware_connected(&firmware);
        }
    }
}

/* Return a number from the command line, or end the process. */
static double number(const char *text, double least, double most)
{
    char *end;
    const double value = strtod(text, &end);
    if (end == text || *end != '\0' || !(value >= least && value <= most)) {
        (void)fprintf(stderr, "reference-posix: not a number from %g to %g: %s\n", least, most, text);
        exit(2);
    }
    return value;
}

static enum plant_kind plant_of(const char *name)
{
    static const char *const NAMES[] = {"tissue", "free", "dummy", "script"};
    for (size_t k = 0; k < 4u; k++) {
        if (strcmp(name, NAMES[k]) == 0) {
            return (enum plant_kind)k;
        }
    }
    (void)fprintf(stderr, "reference-posix: no plant %s; there are tissue, free, dummy and script\n", name);
    exit(2);
}

int main(int count, char **arguments)
{
    bool lockstep = false;
    bool tcp = false;
    double port = 0.0;
    double rate = 2000.0;
    double boot_id = (double)(now_us() % 0xFFFFFFFFu);
    enum plant_kind kind = PLANT_TISSUE;
    for (int k = 1; k < count; k++) {
        const char *name = arguments[k];
        const char *value = k + 1 < count ? arguments[k + 1] : "";
        k++;
        if (strcmp(name, "--lockstep") == 0) {
            lockstep = true;
            k--;
        } else if (strcmp(name, "--pty") == 0) {
            k--;
        } else if (strcmp(name, "--tcp") == 0) {
            tcp = true;
            port = number(value, 0.0, 65535.0);
        } else if (strcmp(name, "--rate") == 0) {
            rate = number(value, 2000.0, (double)MAX_RATE_HZ);
        } else if (strcmp(name, "--boot-id") == 0) {
            boot_id = number(value, 0.0, 4294967295.0);
        } else if (strcmp(name, "--stage") == 0) {
            posix_board.stage_m_per_s = number(value, 0.0, 1.0);
        } else if (strcmp(name, "--plant") == 0) {
            kind = plant_of(value);
        } else {
            (void)fputs(USAGE, stderr);
            return 2;
        }
    }
    posix_board_init(((uint32_t)rate / 100u) * 100u, kind, (uint32_t)boot_id);
    firmware_init(&firmware);
    if (lockstep) {
        return lockstep_run(&firmware);
    }
    if (!(tcp ? line_open_socket(&posix_board.line, (uint16_t)port) : line_open_terminal(&posix_board.line))) {
        perror("reference-posix");
        return 2;
    }
    (void)signal(SIGINT, stop);
    (void)signal(SIGTERM, stop);
    (void)signal(SIGPIPE, SIG_IGN);
    (void)printf("%s\n", posix_board.line.url);
    (void)fflush(stdout);
    serve(&posix_board.line);
    return 0;
}
