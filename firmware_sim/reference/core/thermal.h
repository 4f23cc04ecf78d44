/* Temperature of the winding, calculated from its current (5, rule 7). No request of the host changes it. */
#ifndef THERMAL_H
#define THERMAL_H

#include <stdbool.h>
#include <stdint.h>

struct winding {
    double resistance_ohm;
    double heat_capacity_j_per_k;
    double thermal_resistance_k_per_w;
    double interval_s;
    double temperature_c;
    bool started; /* whether a sample was received since the reset */
};

/* resistance_ohm is the nominal resistance, which determines the length of the wire. */
void winding_init(struct winding *winding, double resistance_ohm, uint32_t sample_rate_hz);

/* Advance by one sample. The sensor can raise the temperature, never lower it. */
void winding_advance(struct winding *winding, double current_a, double sensor_c);

#endif
