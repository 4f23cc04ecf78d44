#include "thermal.h"

#include <math.h>

/* Constants of the coil of 12 ohm, on the hot side of the estimates (docs/safety.md). */
static const double COIL_OHM = 12.0;
static const double HEAT_CAPACITY_J_PER_K = 16.5;
static const double THERMAL_RESISTANCE_K_PER_W = 9.0;
static const double AMBIENT_C = 28.0;
static const double COPPER_PER_K = 0.0039;

/* Margin after a reset: the winding may be warmer than its sensor, which lags. */
static const double RESTART_MARGIN_K = 5.0;

/* Plausible range of the sensor; a reading outside it is replaced by the nearer end. */
static const double SENSOR_LOW_C = 20.0;
static const double SENSOR_HIGH_C = 150.0;

void winding_init(struct winding *winding, double resistance_ohm, uint32_t sample_rate_hz)
{
    const double wire = resistance_ohm / COIL_OHM;
    winding->resistance_ohm = resistance_ohm;
    winding->heat_capacity_j_per_k = HEAT_CAPACITY_J_PER_K * wire;
    winding->thermal_resistance_k_per_w = THERMAL_RESISTANCE_K_PER_W / wire;
    winding->interval_s = 1.0 / (double)sample_rate_hz;
    winding->temperature_c = 0.0;
    winding->started = false;
}

void winding_advance(struct winding *winding, double current_a, double sensor_c)
{
    const double sensor = fmin(fmax(sensor_c, SENSOR_LOW_C), SENSOR_HIGH_C);
    if (!winding->started) {
        winding->temperature_c = sensor + RESTART_MARGIN_K;
        winding->started = true;
    }
    const double above = fmax(0.0, winding->temperature_c - 20.0);
    const double heat_w = winding->resistance_ohm * (1.0 + COPPER_PER_K * above) * (current_a * current_a);
    const double lost_w = (winding->temperature_c - AMBIENT_C) / winding->thermal_resistance_k_per_w;
    winding->temperature_c += (heat_w - lost_w) * winding->interval_s / winding->heat_capacity_j_per_k;
    winding->temperature_c = fmax(winding->temperature_c, sensor);
}
