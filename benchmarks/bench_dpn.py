"""Free run of the dynamic-parameter nonlinearity with sensitivities: compiled loop against numpy."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks import plain_dpn
from benchmarks.base import Comparison
from tissueid.identification.dpn.curves import LogCurves
from tissueid.identification.dpn.simulation import integrate, intersample
from tissueid.identification.engines.dpn import Dpn
from tissueid.records import Record

RATE = 2000.0
SAMPLES = 8000
LOW, HIGH = 0.0105, 0.0125
THETA = np.array([np.log(0.08), np.log(12.0), 0.3, np.log(3400.0), 0.45, 4.0])


def comparisons() -> Iterable[Comparison]:
    rng = np.random.Generator(np.random.PCG64(3))
    spectrum = np.fft.rfft(rng.standard_normal(SAMPLES))
    spectrum[int(200.0 / RATE * SAMPLES) :] = 0.0
    force = np.fft.irfft(spectrum, SAMPLES)
    force = 4.0 + 2.0 * force / np.std(force)
    start = np.array([0.0115, 0.0])
    curves = LogCurves(
        low=LOW,
        high=HIGH,
        mass=THETA[:1],
        damping=THETA[1:3],
        stiffness=THETA[3:5],
        level=float(THETA[5]),
        direction=np.zeros(0),
        speed_scale=0.0,
        inertia=np.zeros(0),
    )

    def compiled() -> tuple[np.ndarray, np.ndarray]:
        tables = curves.tables
        push = intersample(force, tables.steps(RATE), "band-limited")
        position, _, slopes, _ = integrate(
            tables, tables.table(), curves.slopes(), curves.owner, push, RATE, start, tables.bounds()
        )
        return position, slopes

    def in_numpy() -> tuple[np.ndarray, np.ndarray]:
        return plain_dpn.with_slopes(force, RATE, THETA, LOW, HIGH, start)

    def difference(ours: tuple[np.ndarray, np.ndarray], theirs: tuple[np.ndarray, np.ndarray]) -> float:
        middle = slice(500, -100)  # the numpy implementation assumes a periodic record
        return max(
            float(np.max(np.std((a - b)[middle], axis=0) / np.std(b[middle], axis=0)))
            for a, b in ((ours[0], theirs[0]), (ours[1][:, :6], theirs[1][:, :6]))
        )

    yield Comparison(
        title="DPN free run with sensitivities",
        setting=f"{SAMPLES} samples, {THETA.size} parameters and 2 starting values",
        product=compiled,
        plain=in_numpy,
        agreement=difference,
        tolerance=1e-3,
        floor=30.0,
        blocks=2,
        runs_in_block=1,
    )

    noisy = compiled()[0]
    noisy = noisy + 0.01 * np.std(noisy) * rng.standard_normal(SAMPLES)
    record = Record(force, noisy, RATE)

    def fitted() -> float:
        return Dpn().fit(record).report.vaf_percent

    def five_steps() -> float:
        theta, state = THETA.copy(), start.copy()
        theta[[2, 4]] = 0.1
        for _ in range(5):
            position, slopes = plain_dpn.with_slopes(force, RATE, theta, LOW, HIGH, state)
            step = np.linalg.lstsq(slopes, noisy - position, rcond=None)[0]
            theta, state = theta + step[:6], state + step[6:]
        position = plain_dpn.with_slopes(force, RATE, theta, LOW, HIGH, state)[0]
        return 100.0 * (1.0 - float(np.var(noisy - position) / np.var(noisy)))

    yield Comparison(
        title="DPN engine against five plain Gauss-Newton steps",
        setting=f"{SAMPLES} samples, here with choice of degrees and bands",
        product=fitted,
        plain=five_steps,
        agreement=lambda ours, theirs: abs(ours - theirs),
        tolerance=0.01,
        blocks=1,
        runs_in_block=1,
    )
