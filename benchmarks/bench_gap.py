"""Fits of a diagnosis: the compiled simulation with one compiled effect against the same simulation in numpy."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks import plain_gap
from benchmarks.base import Comparison
from tissueid.device import DeviceDescription
from tissueid.gap.fitting import fit
from tissueid.gap.preparation import prepare
from tissueid.sessions import Session, Test
from tissueid.twin.catalogue import effect
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.simulation import ActiveEffect, Start, simulate

RATE = 2000.0
SAMPLES = 2000
SURFACE = 0.010
TRUE = np.array([0.025, 8.0, 250.0, 500.0, 250.0, 0.4])
NOISE = {"voltage": 2e-3, "current": 1e-3, "position": 2e-6}
PLAIN_STEPS = 5


def comparisons() -> Iterable[Comparison]:
    rng = np.random.Generator(np.random.PCG64(5))
    command = 14.0 + 14.0 * np.convolve(rng.uniform(-1.0, 1.0, SAMPLES), np.ones(5) / 5.0, "same")
    drag = effect("quadratic_drag")
    acting = [ActiveEffect(drag, np.array([TRUE[5], 2.0]))]
    instrument, tissue = InstrumentParameters(weight_n=0.0), Tissue(SURFACE, *TRUE[:5])
    start = Start(float(command[0]) / plain_gap.RESISTANCE, SURFACE)

    def compiled() -> np.ndarray:
        return simulate(command, RATE, instrument, tissue, start, acting, substeps=plain_gap.SUBSTEPS).readings.position

    def in_numpy() -> np.ndarray:
        return plain_gap.simulate(command, RATE, TRUE[:, None], SURFACE)[1][:, 0]

    yield Comparison(
        title="Chain with one effect, free run",
        setting=f"{SAMPLES} samples in steps of 0.125 ms, quadratic drag",
        product=compiled,
        plain=in_numpy,
        agreement=lambda ours, theirs: float(np.std(ours - theirs) / np.std(theirs)),
        tolerance=1e-3,
        floor=30.0,
        blocks=2,
        runs_in_block=2,
    )

    # The fitted record was simulated by the numpy implementation.
    currents, positions = plain_gap.simulate(command, RATE, TRUE[:, None], SURFACE)
    clean = {"voltage": command, "current": currents[:, 0], "position": positions[:, 0]}
    signals = {name: values + NOISE[name] * rng.standard_normal(SAMPLES) for name, values in clean.items()}
    test = Test(1, "stochastic", {"command": command, **signals}, RATE, surface_position_m=SURFACE)
    observed = prepare(Session(DeviceDescription(), tests=(test,)))

    def diagnosed() -> float:
        baseline = fit(observed)
        found = fit(observed, [drag], near=baseline)
        return float(found.parameters.effect_values(found.theta, drag, 1)[0])

    def in_steps() -> float:
        noise = NOISE["current"], NOISE["position"]
        found = plain_gap.fitted(command, RATE, SURFACE, signals["current"], signals["position"], noise, PLAIN_STEPS)
        return float(found[5])

    yield Comparison(
        title="Fits of baseline and one effect against plain Gauss-Newton",
        setting=f"{SAMPLES} samples; here two fits to convergence, there {PLAIN_STEPS} steps of one, 6 figures",
        product=diagnosed,
        plain=in_steps,
        agreement=lambda ours, theirs: abs(ours / theirs - 1.0),
        tolerance=0.1,
        blocks=1,
        runs_in_block=1,
    )
