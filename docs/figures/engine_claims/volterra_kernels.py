"""Regularised Volterra kernels (prior, Laguerre functions, kernel regression): smoothness, accuracy, cost and bands."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from identification import simulated, simulated_dpn, simulated_kernels
from identification.simulated import Array
from outside_data import RIG

from engine_claims.base import Claim
from tissueid.identification.validation import vaf_percent
from tissueid.identification.volterra.laguerre import laguerre_kernels
from tissueid.identification.volterra.methods import factor_stimulus, regression_kernels
from tissueid.identification.volterra.prior import regularised_fit, roughness
from tissueid.identification.volterra.regressors import (
    THESIS_SIGMA,
    Kernels,
    VolterraRegressors,
    kernels_of,
    lagged_inputs,
    smoothed,
)
from tissueid.records import Record
from tissueid.sessions import read_session

EVERY = 5
"""One session in so many is taken, to keep the time down."""

FIT_SHARE = 0.75
LAGS, SPACING = 41, 3
"""The lags of 4.3: 903 coefficients of a record of 2 kHz; every sample is a row."""

SPREAD = THESIS_SIGMA
LOST_POINTS = 0.5
THIRD_S, THIRD_GIB = 10.0, 2.0
RUNS = 5

_CHILD = """
import json, resource, sys, time
import numpy as np
from identification.simulated_kernels import polynomial
from tissueid.identification.volterra.methods import regression_kernels, simulate_third
n, lags, order = (int(word) for word in sys.argv[1:])
known = polynomial(60, n=n + lags - 1, lags=lags, cube=2.0 if order == 3 else 0.0, cutoff_hz=500.0, snr_db=30.0,
                   slowness=lags / 30.0)
begin = time.process_time()
found = regression_kernels(known.x, known.y, known.used, lags, 1, order)
fit = time.process_time() - begin
begin = time.process_time()
if order == 3:
    simulate_third(found.kernel3, np.resize(known.x, 8000), 1)
run = time.process_time() - begin
off = [float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in (
    (found.kernel1, known.kernel1), (found.kernel2, known.kernel2), (found.kernel3, known.kernel3))[:order]]
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
print(json.dumps({"fit": fit, "run": run, "off": off, "gib": peak}))
"""


@dataclass(frozen=True)
class Outcome:
    """What the exact, the filtered, the regularised, and the regularised and filtered kernels are worth.

    ``held_out`` is their VAF in percent, ``rough`` the roughness of their h2.
    """

    held_out: tuple[float, ...]
    seconds: float
    spent: float
    second: tuple[Array, ...]

    @property
    def rough(self) -> tuple[float, ...]:
        """Roughness of each h2."""
        return tuple(roughness(kernel) for kernel in self.second)


def compare(record: Record) -> Outcome:
    """All of them on the first three quarters of a record, scored on the rest."""
    cut = round(FIT_SHARE * len(record))
    x = record.input - record.input[:cut].mean()
    n = np.arange(len(record))
    held_out = VolterraRegressors(x, n >= cut, LAGS, SPACING, 2)
    stimulus = factor_stimulus(x, (n >= (LAGS - 1) * SPACING) & (n < cut), LAGS, SPACING, 2)
    y = record.output[stimulus.regressors.rows]
    exact = kernels_of(stimulus.solve(record.output), LAGS, 2)
    begin = time.process_time()
    found = regularised_fit(stimulus.regressors.normal_equations(stimulus.gram, y), stimulus.regressors, y)
    seconds = time.process_time() - begin
    prior = kernels_of(found.coefficients, LAGS, 2)
    assert exact.second is not None
    assert prior.second is not None
    second = (exact.second, smoothed(exact.second, SPREAD), prior.second, smoothed(prior.second, SPREAD))
    measured = record.output[held_out.rows]
    scores = [
        vaf_percent(measured, response(Kernels(low.zeroth, low.first, kernel), held_out.windows))
        for low, kernel in zip((exact, exact, prior, prior), second, strict=True)
    ]
    return Outcome(tuple(scores), seconds, found.effective_parameters, second)


def response(kernels: Kernels, windows: Array) -> Array:
    """Output (n,) of kernels to second order for lagged inputs (n, L)."""
    assert kernels.first is not None
    assert kernels.second is not None
    second = np.einsum("ni,ni->n", windows @ kernels.second, windows)
    return np.asarray(kernels.zeroth + windows @ kernels.first + second, dtype=np.float64)


def listed(values: Array, digits: int) -> str:
    """Numbers with so many decimals, separated by commas."""
    return ", ".join(f"{value:.{digits}f}" for value in values)


def told(name: str, found: list[Outcome]) -> Claim:
    """One claim about the medians of some records."""
    vaf = np.median([one.held_out for one in found], axis=0)
    rough = np.median([one.rough for one in found], axis=0)
    lost = max(one.held_out[0] - one.held_out[2] for one in found)
    return Claim(
        f"second-order kernel, exact, filtered as in 4.3.2, regularised, both: {name}",
        f"regularised at least as smooth as filtered, with a loss of held-out VAF of at most {LOST_POINTS:g} points",
        f"roughness {listed(rough, 4)}; held-out VAF {listed(vaf, 2)} %; largest loss of the "
        f"regularised against the exact {lost:+.2f} points; "
        f"{np.median([one.spent for one in found]):.0f} effective of 903 parameters, "
        f"{np.median([one.seconds for one in found]):.1f} s of one core",
        bool(rough[2] <= rough[1] and lost < LOST_POINTS),
    )


def wiener(runs: int) -> Iterator[Claim]:
    """The same where the shape of h2 is known: that of h x h, which is rougher than the filter lets through."""
    found = [compare(simulated.wiener_record(62, run)) for run in range(runs)]
    natural = simulated.SCALED_MASS**-0.5
    damping_ratio = 0.5 * simulated.SCALED_DAMPING * natural
    t = np.arange(LAGS) * SPACING / simulated.RATE
    h = np.exp(-damping_ratio * natural * t) * np.sin(np.sqrt(1.0 - damping_ratio**2) * natural * t)
    truth = -np.outer(h, h)
    cosine = [
        [float(np.sum(k * truth) / np.linalg.norm(k) / np.linalg.norm(truth)) for k in one.second] for one in found
    ]
    near = np.median(cosine, axis=0)
    yield told("Wiener systems, 200 Hz, 30 dB (the true h2 is rougher than the filtered one)", found)
    yield Claim(
        "the same: cosine of h2 with the true one",
        "regularised closer than filtered",
        f"{listed(near, 3)}; roughness of the true one {roughness(truth):.4f}",
        bool(near[2] > near[1]),
    )


def rig_records() -> list[Record]:
    """First stochastic test of each chosen session."""
    paths = sorted(RIG.glob("rig-*.h5"))[::EVERY]
    return [read_session(path).test(None).record("force", "position") for path in paths]


def sitting() -> Record:
    """The main test of the demonstration."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "tissueid", "demo", "--out", folder], check=True, capture_output=True)
        return read_session(Path(folder) / "session.h5").test(None).record("force", "position")


def cost(n: int, lags: int, order: int) -> dict[str, object]:
    """Seconds of one core, peak memory and errors of kernel regression, in a separate process."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    child = subprocess.run(
        [sys.executable, "-c", _CHILD, str(n), str(lags), str(order)],
        check=True,
        capture_output=True,
        text=True,
        env=environment,
    )
    return dict(json.loads(child.stdout))


def third_order() -> Iterator[Claim]:
    """What third order and a long memory cost."""
    for n in (2700, 6750):
        found = cost(n, 41, 3)
        first, second, third = found["off"]
        yield Claim(
            f"third-order kernels, memory 40 (13,244 coefficients), {n:,} rows",
            f"under {THIRD_S:g} s and under {THIRD_GIB:g} GiB",
            f"{found['fit']:.1f} s of one core, {found['gib']:.2f} GiB at most; h1, h2, h3 of a cubic system off by "
            f"{100 * first:.1f}, {100 * second:.1f}, {100 * third:.1f} %; 8,000 samples simulated in "
            f"{found['run']:.2f} s",
            found["fit"] < THIRD_S and found["gib"] < THIRD_GIB and third < 0.3,
        )
    found = cost(6000, 250, 2)
    first, second = found["off"]
    yield Claim(
        "second-order kernel over 250 lags (31,626 coefficients), 6,000 rows",
        "solved, under 2 GiB",
        f"{found['fit']:.1f} s of one core, {found['gib']:.2f} GiB at most; h1, h2 off by {100 * first:.1f}, "
        f"{100 * second:.1f} %",
        found["gib"] < THIRD_GIB and second < 0.3,
    )


def expansion(name: str, records: list[Record]) -> Claim:
    """Laguerre expansions of second order beside what a coefficient a lag spends."""
    scores, spent = [], []
    for record in records:
        cut = round(FIT_SHARE * len(record))
        x = record.input - record.input[:cut].mean()
        n = np.arange(len(record))
        found = laguerre_kernels(x, record.output, (n >= (LAGS - 1) * SPACING) & (n < cut), LAGS, SPACING, 2)
        windows = lagged_inputs(x, np.arange(cut, len(record)), LAGS, SPACING)
        modelled = response(Kernels(found.kernel0, found.kernel1, found.kernel2), windows)
        scores.append(vaf_percent(record.output[cut:], modelled))
        spent.append(found.n_parameters)
    return Claim(
        f"Laguerre expansion of second order: {name}",
        "fewer than 150 parameters instead of 903",
        f"{np.median(spent):.0f} parameters, held-out VAF {np.median(scores):.2f} %",
        bool(max(spent) < 150),
    )


def bands() -> Iterator[Claim]:
    """Share of lags within 1.96 standard deviations, with low-passed input and coloured noise."""
    lags = simulated_kernels.LAGS
    upper = np.triu_indices(lags)
    for colour in (0.0, 0.95):
        inside: dict[str, list[tuple[float, float]]] = {}
        for run in range(RUNS):
            known = simulated_kernels.polynomial(61, run, cutoff_hz=600.0, colour=colour)
            regressors = VolterraRegressors(known.x, known.used, lags, 1, 2)
            y = known.y[known.used]
            prior = regularised_fit(regressors.normal_equations(regressors.gram(), y), regressors, y)
            mean, std = kernels_of(prior.coefficients, lags, 2), kernels_of(prior.std, lags, 2)
            dual = regression_kernels(known.x, known.y, known.used, lags, 1, 2)
            laguerre = laguerre_kernels(known.x, known.y, known.used, lags, 1, 2)
            for name, first, first_std, second, second_std in (
                ("regularised", mean.first, std.first, mean.second, std.second),
                ("kernel regression", dual.kernel1, dual.kernel1_std, dual.kernel2, dual.kernel2_std),
                ("Laguerre", laguerre.kernel1, laguerre.kernel1_std, laguerre.kernel2, laguerre.kernel2_std),
            ):
                assert second is not None
                held = (
                    float(np.mean(np.abs(first - known.kernel1) < 1.96 * first_std)),
                    float(np.mean((np.abs(second - known.kernel2) < 1.96 * second_std)[upper])),
                )
                inside.setdefault(name, []).append(held)
        shares = {name: 100.0 * np.mean(held, axis=0) for name, held in inside.items()}
        yield Claim(
            f"coverage of the 95 % bands of h1 and h2, noise at 20 dB {'with' if colour else 'without'} colour "
            f"({RUNS} runs)",
            "at least 90 % of lags",
            "; ".join(f"{name} {share[0]:.0f}, {share[1]:.0f} %" for name, share in shares.items()),
            bool(min(share.min() for share in shares.values()) >= 90.0),
        )


def claims() -> Iterator[Claim]:
    """All of them."""
    yield from wiener(2)
    skin = [compare(simulated_dpn.record(simulated_dpn.SKIN, 62, run, snr_db=30.0)) for run in range(2)]
    yield told("DPN systems, 200 Hz, 30 dB", skin)
    records = rig_records()
    if records:
        yield told(f"{len(records)} sessions of the independent rig", [compare(record) for record in records])
        yield expansion(f"{len(records)} sessions of the independent rig", records)
    demonstration = sitting()
    yield told("the demonstration", [compare(demonstration)])
    yield expansion("the demonstration", [demonstration])
    yield from third_order()
    yield from bands()
