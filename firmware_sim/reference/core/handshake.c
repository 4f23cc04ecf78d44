#include "handshake.h"

#include "bytes.h"

size_t handshake_write(uint8_t *payload, const struct board_properties *device, uint32_t boot_id)
{
    const double numbers[] = {
        (double)device->sample_rate_hz,
        (double)WATCHDOG_US / 1e6,
        device->coil_resistance_ohm,
        device->coil_inductance_h,
        device->force_constant_n_per_a,
        device->moving_mass_kg,
        device->bearing_damping_n_s_per_m,
        device->amplifier_gain,
        device->amplifier_limit_v,
        device->stroke_m,
        device->max_force_n,
        device->max_temperature_c,
    };
    uint8_t *at = put_u8(put_u8(payload, PROTOCOL_VERSION), PROTOCOL_VERSION);
    at = put_u8(at, CHANNELS);
    at = put_u8(at, (uint8_t)(device->sample_rate_hz / 100u));
    at = put_u32(put_u32(at, boot_id), STIMULUS_CAPACITY);
    at = put_text(at, device->firmware_version, 16);
    at = put_text(at, device->model, 32);
    at = put_text(at, device->serial_number, 16);
    for (size_t k = 0; k < sizeof numbers / sizeof numbers[0]; k++) {
        at = put_f64(at, numbers[k]);
    }
    for (size_t k = 0; k < CHANNELS; k++) {
        at = put_text(at, device->channels[k].name, 16);
        at = put_text(at, device->channels[k].unit, 8);
        at = put_f64(put_f64(at, device->channels[k].gain), device->channels[k].offset);
    }
    at = put_f64(at, device->filter_corner_hz);
    return (size_t)(at - payload);
}
