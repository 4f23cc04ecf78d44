#include "plant.h"

#include <math.h>

/* Tissue, stops and coil that the handshake does not report; as in the Python simulator where it has them. */
static const double STIFFNESS_N_PER_M = 1500.0;
static const double DAMPING_N_S_PER_M = 6.0;
static const double GRAVITY_N = 0.060 * 9.80665;
static const double STOP_N_PER_M = 2.0e5;
static const double STOP_N_S_PER_M = 60.0;
static const double HEAT_J_PER_K = 18.0;
static const double COOLING_K_PER_W = 8.0;
static const double AMBIENT_C = 23.0;
static const double SENSOR_LAG_S = 2.5;
#define SUBSTEPS 12

static struct {
    enum plant_kind kind;
    const struct board_properties *device;
    double surface_m;
    double current_a;
    double position_m;
    double speed_m_per_s;
    double winding_c;
    double sensor_c;
    double filtered[3]; /* voltage, current, position */
    uint32_t random;
    int32_t script_position;
    uint32_t script_index;
    int16_t stuck;
    bool was_stuck;
} plant;

/* Next pseudo-random number. */
static uint32_t next_random(void)
{
    plant.random = plant.random * 1664525u + 1013904223u;
    return plant.random >> 8;
}

/* Noise with unit standard deviation, nearly normal. */
static double noise(void)
{
    double sum = 0.0;
    for (int k = 0; k < 4; k++) {
        sum += (double)next_random() / 16777216.0 - 0.5;
    }
    return sum * 1.7320508075688772;
}

void world_set(struct world *world, uint8_t bits)
{
    world->button = (bits & 1u) != 0u;
    world->supply_low = (bits & 2u) != 0u;
    world->position_stuck = (bits & 4u) != 0u;
    world->coil_open = (bits & 8u) != 0u;
}

void plant_init(enum plant_kind kind, const struct board_properties *device, double surface_m)
{
    plant.kind = kind;
    plant.device = device;
    plant.surface_m = surface_m;
    plant.current_a = 0.0;
    plant.position_m = kind == PLANT_TISSUE ? surface_m + GRAVITY_N / STIFFNESS_N_PER_M : device->stroke_m;
    if (kind == PLANT_DUMMY) {
        plant.position_m = 0.5 * device->stroke_m;
    }
    plant.speed_m_per_s = 0.0;
    plant.winding_c = AMBIENT_C;
    plant.sensor_c = AMBIENT_C;
    plant.filtered[0] = 0.0;
    plant.filtered[1] = 0.0;
    plant.filtered[2] = plant.position_m;
    plant.random = 1;
    plant.script_position = 0;
    plant.script_index = 0;
    plant.was_stuck = false;
}

void plant_place(double surface_m)
{
    plant.surface_m = surface_m;
}

/* Return the code of a physical value, and note if the converter ends there. */
static int16_t code_of(const struct channel *channel, double value, bool *saturated)
{
    const double code = rint((value - channel->offset) / channel->gain);
    *saturated = *saturated || code < (double)INT16_MIN || code > (double)INT16_MAX;
    return (int16_t)fmin(fmax(code, (double)INT16_MIN), (double)INT16_MAX);
}

/* Return the force of stops and tissue on the probe, N. */
static double resistance_n(void)
{
    const double beyond = plant.position_m - plant.device->stroke_m;
    double force = 0.0;
    if (plant.position_m < 0.0) {
        force -= STOP_N_PER_M * plant.position_m + STOP_N_S_PER_M * plant.speed_m_per_s;
    } else if (beyond > 0.0) {
        force -= STOP_N_PER_M * beyond + STOP_N_S_PER_M * plant.speed_m_per_s;
    }
    const double depth = plant.position_m - plant.surface_m;
    if (plant.kind == PLANT_TISSUE && depth > 0.0) {
        force -= fmax(0.0, STIFFNESS_N_PER_M * depth + DAMPING_N_S_PER_M * plant.speed_m_per_s);
    }
    return force;
}

/* Integrate over one sample; return the voltage across the coil. */
static double integrate(const struct world *world, bool amplifier, int16_t command)
{
    const struct board_properties *device = plant.device;
    const double dt = 1.0 / (double)device->sample_rate_hz / (double)SUBSTEPS;
    const double asked = device->amplifier_gain * device->channels[COMMAND].gain * (double)command;
    const double limit = device->amplifier_limit_v;
    const double volts = amplifier ? fmin(fmax(asked, -limit), limit) : 0.0;
    const double filter = 1.0 - exp(-6.283185307179586 * device->filter_corner_hz * dt);
    const double decay = exp(-device->coil_resistance_ohm / device->coil_inductance_h * dt);
    for (int k = 0; k < SUBSTEPS; k++) {
        const double induced = device->force_constant_n_per_a * plant.speed_m_per_s;
        const double final = (volts - (plant.kind == PLANT_DUMMY ? 0.0 : induced)) / device->coil_resistance_ohm;
        plant.current_a = world->coil_open ? 0.0 : final + (plant.current_a - final) * decay;
        if (plant.kind != PLANT_DUMMY) {
            const double force = device->force_constant_n_per_a * plant.current_a + GRAVITY_N + resistance_n() -
                                 device->bearing_damping_n_s_per_m * plant.speed_m_per_s;
            plant.speed_m_per_s += force / device->moving_mass_kg * dt;
            plant.position_m += plant.speed_m_per_s * dt;
        }
        plant.filtered[0] += (volts - plant.filtered[0]) * filter;
        plant.filtered[1] += (plant.current_a - plant.filtered[1]) * filter;
        plant.filtered[2] += (plant.position_m - plant.filtered[2]) * filter;
    }
    const double step = dt * (double)SUBSTEPS;
    const double heat = device->coil_resistance_ohm * plant.current_a * plant.current_a;
    plant.winding_c += (heat - (plant.winding_c - AMBIENT_C) / COOLING_K_PER_W) * step / HEAT_J_PER_K;
    plant.sensor_c += (plant.winding_c - plant.sensor_c) * step / SENSOR_LAG_S;
    return volts;
}

/* Whole-number readings: any other implementation gets the same ones. */
static void script_step(const struct world *world, bool amplifier, int16_t command, struct board_sample *sample)
{
    const uint32_t hash = (plant.script_index * 2654435761u) >> 16;
    plant.script_index++;
    const int32_t volts = amplifier ? command : 0;
    const int32_t current = world->coil_open ? 0 : volts * 5 / 6 + (int32_t)(hash % 7u) - 3;
    int32_t position = plant.script_position + (int32_t)(hash % 201u) - 100 + current / 64;
    if (hash % 8192u == 0u) {
        position += 15000; /* faster than any probe */
    }
    sample->saturated = position < INT16_MIN || position > INT16_MAX;
    position = position < INT16_MIN ? INT16_MIN : position;
    position = position > INT16_MAX ? INT16_MAX : position;
    if (!world->position_stuck) {
        plant.script_position = position;
    }
    sample->code[VOLTAGE] = (int16_t)volts;
    sample->code[CURRENT] = (int16_t)current;
    sample->code[POSITION] = (int16_t)plant.script_position;
    sample->code[TEMPERATURE] = (int16_t)(-20185 + (int32_t)(hash % 3u));
    sample->code[ACCELERATION_X] = (int16_t)(hash % 1000u);
    sample->code[ACCELERATION_Y] = (int16_t)(hash % 100u);
}

void plant_step(const struct world *world, bool amplifier, int16_t command, struct board_sample *sample)
{
    if (plant.kind == PLANT_SCRIPT) {
        script_step(world, amplifier, command, sample);
        return;
    }
    const struct channel *channels = plant.device->channels;
    bool saturated = false;
    (void)integrate(world, amplifier, command);
    sample->code[VOLTAGE] = code_of(&channels[VOLTAGE], plant.filtered[0] + 2.7e-3 * noise(), &saturated);
    sample->code[CURRENT] = code_of(&channels[CURRENT], plant.filtered[1] + 13.0e-3 * noise(), &saturated);
    sample->code[POSITION] = code_of(&channels[POSITION], plant.filtered[2] + 1.0e-6 * noise(), &saturated);
    sample->code[TEMPERATURE] = code_of(&channels[TEMPERATURE], plant.sensor_c + 0.05 * noise(), &saturated);
    sample->code[ACCELERATION_X] = code_of(&channels[ACCELERATION_X], 9.80665 + 0.07 * noise(), &saturated);
    sample->code[ACCELERATION_Y] = code_of(&channels[ACCELERATION_Y], 0.07 * noise(), &saturated);
    if (world->position_stuck && plant.was_stuck) {
        sample->code[POSITION] = plant.stuck;
    }
    plant.stuck = sample->code[POSITION];
    plant.was_stuck = world->position_stuck;
    sample->saturated = saturated;
}
