"""Effects of mechanics and tissue: in the whole chain on noise, and along a prescribed motion."""

from __future__ import annotations

import numpy as np
from scipy import signal

from tissueid.twin import bus
from tissueid.twin.catalogue import effect
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.simulation import ActiveEffect, Start, simulate

RATE = 2000.0
SURFACE = 0.0095
TISSUE = Tissue(SURFACE, 0.015, 5.0, 200.0, 400.0, 250.0)
DEVICE = InstrumentParameters(weight_n=0.2)


def noise(seconds=0.5, mean=15.0, amplitude=26.0, seed=1):
    band = signal.butter(4, 200.0, fs=RATE, output="sos")
    uniform = np.random.default_rng(seed).uniform(-1.0, 1.0, round(seconds * RATE))
    return np.clip(mean + amplitude * signal.sosfilt(band, uniform), -46.0, 46.0)


def play(name=None, values=None, command=None, substeps=5, tissue=TISSUE, on_tissue=True, device=DEVICE):
    volts = noise() if command is None else command
    acting = () if name is None else (ActiveEffect(effect(name), np.array(values, float)),)
    start = Start(float(volts[0]) / device.resistance_ohm, tissue.surface_m)
    return simulate(volts, RATE, device, tissue, start, acting, on_tissue=on_tissue, substeps=substeps)


def change(name, values, signal_name="position", **how):
    """Return the root mean square of the change by the effect, relative to the signal's deviation."""
    with_it = getattr(play(name, values, **how).readings, signal_name)
    without = getattr(play(**how).readings, signal_name)
    return float(np.sqrt(np.mean((with_it - without) ** 2)) / np.std(without))


def moved(name, values, position, dt, velocity=None, setting=None):
    """Return the bus of a hook along a prescribed motion, in plain Python."""
    declared = effect(name)
    numbers, state, out = np.zeros(bus.SIZE), np.zeros(bus.MOST_STATES), []
    speed = np.gradient(position, dt) if velocity is None else velocity
    for n, (x, v) in enumerate(zip(position, speed, strict=True)):
        numbers[:] = 0.0
        numbers[bus.TIME], numbers[bus.SAMPLE] = n * dt, n * dt * RATE
        numbers[bus.POSITION], numbers[bus.DEPTH], numbers[bus.VELOCITY] = x, x, v
        if bus.LIFT_OFF in declared.places:
            declared.hook(bus.LIFT_OFF, numbers, np.array(values, float), state, dt)
        if setting is not None:
            setting(numbers)
        declared.hook(declared.places[-1], numbers, np.array(values, float), state, dt)
        out.append(numbers.copy())
    return np.array(out)
