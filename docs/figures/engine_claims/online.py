"""Online engines: agreement with least squares, coverage of intervals, benefit of adaptation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from identification import simulated
from outside_data import RIG
from scipy import linalg, signal

from engine_claims.base import Claim
from tissueid.errors import UnusableInputError
from tissueid.identification import get_engine, validated
from tissueid.identification.engines.als import Als
from tissueid.identification.engines.rls import Rls
from tissueid.identification.engines.wiener import Wiener
from tissueid.records import Record
from tissueid.sessions import read_session

LAGS = 250
RUNS = 60


def claims() -> Iterator[Claim]:
    """Recursive and adaptive least squares, and the feedback form of the Wiener iteration."""
    yield _reference()
    yield _last_bit()
    yield _coverage(1.0)
    yield _coverage(0.998)
    yield _unstable()
    yield _feedback()
    if RIG.is_dir():
        yield from _rig()


def _reference() -> Claim:
    """250 lags and an offset against scipy on the explicit regressor matrix, with the ridge as rows of its own."""
    record = simulated.linear_record(60)
    model = Rls().fit(record)
    x, y = record.input - record.input.mean(), record.output - record.output.mean()
    std = float(np.std(x))
    rows = np.column_stack([x[LAGS - 1 - k : x.size - k] for k in range(LAGS)] + [np.full(x.size - LAGS + 1, std)])
    tall = np.vstack([rows, std / np.sqrt(200.0) * np.eye(LAGS + 1)])
    expected = linalg.lstsq(tall, np.concatenate([y[LAGS - 1 :], np.zeros(LAGS + 1)]))[0][:LAGS]
    apart = float(np.linalg.norm(model.impulse_response / record.sample_rate_hz - expected) / np.linalg.norm(expected))
    return Claim("RLS after 8,000 samples against scipy's lstsq, 250 lags", "1e-8", f"{apart:.0e}", apart < 1e-8)


def _last_bit() -> Claim:
    record = simulated.wiener_record(61)
    equal = True
    for engine in (Rls(), Rls(forgetting=0.999), Als()):
        one, many = engine.start(record.sample_rate_hz), engine.start(record.sample_rate_hz)
        errors = [one.update(u, y) for u, y in zip(record.input.tolist(), record.output.tolist(), strict=True)]
        equal &= np.array_equal(errors, many.batch(record.input, record.output), equal_nan=True)
        equal &= np.array_equal(one.impulse_response, many.impulse_response)
    return Claim(
        "RLS and ALS: single updates against a batch", "bitwise equal", "same" if equal else "different", equal
    )


def _coverage(forgetting: float) -> Claim:
    """Share of 95 % intervals that hold the lag they are for, under noise of pole 0.9."""
    k = np.arange(30)
    truth = np.exp(-k / 6.0) * np.sin((k + 1) / 4.0)
    held = []
    for run in range(RUNS):
        rng = simulated.generator(62, run)
        u = rng.standard_normal(4000)
        e = signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal(4000))
        model = Rls(memory=0.03, forgetting=forgetting).fit(
            Record(u, signal.lfilter(truth, [1.0], u) + 0.5 * e, 1000.0)
        )
        held.append(np.abs(model.impulse_response / 1000.0 - truth) < 1.96 * model.impulse_response_std / 1000.0)
    share = 100.0 * float(np.mean(held))
    return Claim(
        f"RLS, forgetting {forgetting:g}, coloured noise: coverage of the 95 % intervals of the lags ({RUNS} runs)",
        "92 to 97 %",
        f"{share:.1f} %",
        92.0 <= share <= 97.0,
    )


def _unstable() -> Claim:
    told = ""
    try:
        Als(change_factor=1.0).fit(simulated.wiener_record(63))
    except UnusableInputError as error:
        told = str(error)
    kept = told.startswith("unstable ALS step") and "\n" not in told
    return Claim("an unstable ALS step", "rejected with a message", "refused" if kept else told or "not refused", kept)


def _feedback() -> Claim:
    """Curves without an inverse and, for a Gaussian input, with little or no linear part, at 20 dB."""
    worst = 1.0
    for degree, fold in (
        (2, lambda z: z**2),
        (2, lambda z: z**2 + 0.1 * z),
        (3, lambda z: z**3 - 2.0 * z),
        (4, lambda z: z**4 - 2.0 * z**2),
    ):
        rng = simulated.generator(64)
        force, load = simulated.second_order(rng, simulated.SCALED_MASS, simulated.SCALED_DAMPING, 1.0, n=6000)
        clean = 1e-3 * fold(load / np.std(load))
        record = Record(force, clean + simulated.noise(rng, clean, 20.0), simulated.RATE)
        z = Wiener(nonlinearity="polynomial", degree=degree).fit(record).linear_output(force)
        worst = min(worst, float(np.corrcoef(z[500:], load[500:])[0, 1]))
    return Claim(
        "Wiener, g a non-monotone square, cubic or quartic: correlation of the linear output with the true one",
        "0.999",
        f"{worst:.4f} or more",
        worst >= 0.999,
    )


def _rig() -> Iterator[Claim]:
    """Medians over the sessions of the independent rig, fitted to three quarters of the first stochastic test."""
    held: dict[str, list[float]] = {"lms": [], "rls": [], "als": []}
    tracking = []
    for path in sorted(RIG.glob("rig-*.h5")):
        record = read_session(path).test(None).record("force", "position")
        cut = round(0.75 * len(record))
        for name, found in held.items():
            report = validated(get_engine(name)().fit(record, slice(0, cut)), record, slice(cut, None)).report
            found.append(float(report.vaf_validation_percent or np.nan))
            if name == "als":
                tracking.append(report.details["vaf_tracking_percent"])
    line, recursive, adaptive = (float(np.median(found)) for found in held.values())
    yield Claim(
        f"RLS on the rig, held out, free run, median of {len(tracking)} sessions",
        f"as LMS: {line:.1f} %",
        f"{recursive:.1f} %",
        recursive > line - 0.5,
    )
    yield Claim(
        "ALS on the rig: average response held out, free run (predictions during adaptation, not a free run)",
        f"within a point of LMS: {line:.1f} %",
        f"{adaptive:.1f} % ({float(np.median(tracking)):.1f} %)",
        adaptive > line - 1.0,
    )
