/* Properties of the desktop indenter, without its name, rate and stage: the figures of the simulated device. */
#ifndef DESKTOP_DEVICE_H
#define DESKTOP_DEVICE_H

#define DESKTOP_DEVICE \
    .coil_resistance_ohm = 12.0, .coil_inductance_h = 1.0e-3, .force_constant_n_per_a = 3.0, .moving_mass_kg = 0.060, \
    .bearing_damping_n_s_per_m = 3.5, .amplifier_gain = 1.0, .amplifier_limit_v = 48.0, .stroke_m = 0.032, \
    .max_force_n = 15.0, .max_temperature_c = 85.0, .filter_corner_hz = 2000.0, \
    .channels = { \
        {"command", "V", 60.0 / 32768.0, 0.0}, \
        {"voltage", "V", 60.0 / 32768.0, 0.0}, \
        {"current", "A", 6.0 / 32768.0, 0.0}, \
        {"position", "m", 0.5e-6, 0.016384}, \
        {"temperature", "degC", 250.0 / 65536.0, 100.0}, \
        {"acceleration_x", "m/s^2", 2.2 * 9.80665 / 32768.0, 0.0}, \
        {"acceleration_y", "m/s^2", 2.2 * 9.80665 / 32768.0, 0.0}, \
    }

#endif
