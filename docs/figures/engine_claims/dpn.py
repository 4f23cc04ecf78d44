"""Dynamic-parameter nonlinearity (Eq. 3.33): curves, bands, held-out simulation on the rig and on known systems."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from identification import simulated, simulated_dpn
from identification.simulated_dpn import Tissue
from outside_data import RIG

from engine_claims.base import Claim
from tissueid.identification import validated
from tissueid.identification.engines.dpn import Dpn, DpnModel
from tissueid.records import Record
from tissueid.sessions import read_session

DEPTHS = np.linspace(0.05, 0.95, 19)
RUNS = 20


def claims() -> Iterator[Claim]:
    """All of them, in about a minute."""
    yield from _curves()
    yield from _bands()
    yield _linear()
    yield _wiener()
    if RIG.is_dir():
        yield from _rig()


def _curves() -> Iterator[Claim]:
    known = {
        "exponential B and K, constant M, 2 kHz": (simulated_dpn.SKIN, False),
        "M grows too, 2 kHz": (simulated_dpn.GROWING, False),
        "the constants of C.1.4, 2 kHz": (simulated_dpn.THESIS, False),
        "the constants of C.1.4, zero-order hold at 500 Hz": (simulated_dpn.THESIS, True),
    }
    for name, (tissue, slow) in known.items():
        worst = np.zeros(3)
        for run in range(3):
            record = simulated_dpn.slow_record(tissue, 60, run) if slow else simulated_dpn.record(tissue, 60, run)
            model = Dpn(hold="zero-order" if slow else "band-limited").fit(record)
            truth, found = _truth(tissue, record), _found(model, record)
            worst = np.maximum(worst, np.max(np.abs(found[:, 0] / truth - 1.0), axis=1))
        yield Claim(
            f"DPN, {name}, 40 dB: largest error of M, B, K over the central 90 % of depths in 3 runs",
            "2 %",
            ", ".join(f"{100.0 * error:.2f} %" for error in worst),
            bool(np.all(worst < 0.02)),
        )


def _bands() -> Iterator[Claim]:
    for name, tissue, snr_db, colour in (
        ("40 dB white", simulated_dpn.SKIN, 40.0, 0.0),
        ("30 dB coloured", simulated_dpn.GROWING, 30.0, 0.9),
    ):
        held = np.zeros((3, DEPTHS.size))
        for run in range(RUNS):
            record = simulated_dpn.record(tissue, 61, run, snr_db=snr_db, colour=colour)
            _, low, high = np.moveaxis(_found(Dpn().fit(record), record), 1, 0)
            truth = _truth(tissue, record)
            held += (low < truth) & (truth < high)
        share = held.mean(axis=1) / RUNS
        # The depths of one run err together: with so few runs the share itself is known to some five points only.
        margin = 2.0 * np.sqrt(0.94 * 0.06 / RUNS)
        yield Claim(
            f"DPN, {name}: coverage of the 95 % bands of M, B, K ({RUNS} runs; 200 in the soak tests)",
            "90 to 98 %",
            ", ".join(f"{100.0 * each:.0f} %" for each in share),
            bool(np.all((share > 0.90 - margin) & (share < 0.98 + margin))),
        )


def _linear() -> Claim:
    false = 0
    for run in range(RUNS):
        degrees = Dpn().fit(simulated_dpn.record(simulated_dpn.PLAIN, 62, run)).degrees
        false += any(degrees[name] > 0 for name in ("mass", "damping", "stiffness"))
    return Claim(
        f"DPN on a linear system: false detections of depth dependence in {RUNS} records",
        "none",
        f"{false}",
        false <= 1,
    )


def _wiener() -> Claim:
    record = simulated.wiener_record(63)
    low, high = np.quantile(record.output, [0.05, 0.95])
    changes, _ = Dpn().fit(record).estimated.changes(float(low), float(high))
    depth = np.array([low, high]) - simulated.SURFACE
    truth = (simulated.C1 - depth[0]) / (simulated.C1 - depth[1])
    factors = np.exp(changes)
    return Claim(
        f"DPN on a Wiener system: factors of M, B, K over the central 90 % of depths (all {truth:.2f})",
        "one factor",
        ", ".join(f"{factor:.2f}" for factor in factors),
        bool(np.all(np.abs(factors / truth - 1.0) < 0.05)),
    )


def _rig() -> Iterator[Claim]:
    held_out, seconds = [], []
    for path in sorted(RIG.glob("rig-*.h5")):
        record = read_session(path).test(None).record("force", "position")
        cut = round(0.75 * len(record))
        begin = time.perf_counter()
        model = Dpn().fit(record, slice(0, cut))
        seconds.append(time.perf_counter() - begin)
        figure = validated(model, record, slice(cut, None)).report.vaf_validation_percent
        assert figure is not None
        held_out.append(figure)
    quarter, median = np.quantile(held_out, [0.25, 0.5])
    yield Claim(
        f"DPN on the independent rig: median held-out free-run VAF over {len(held_out)} sessions",
        "90 to 97 %",
        f"{median:.2f} % (lower quartile {quarter:.1f} %, the worst {min(held_out):.1f} %)",
        bool(median > 97.0),
    )
    yield Claim(
        "DPN, the fit of 6,000 samples with bands: median seconds",
        "under 3 s",
        f"{np.median(seconds):.2f} s (longest {max(seconds):.1f} s)",
        bool(np.median(seconds) < 3.0),
    )


def _truth(tissue: Tissue, record: Record) -> np.ndarray:
    """M, B and tangent K at the depths, shape (3, depths)."""
    y = np.quantile(record.output, DEPTHS)
    return np.array([tissue.masses(y), tissue.dampings(y), tissue.tangents(y)])


def _found(model: DpnModel, record: Record) -> np.ndarray:
    """M, B and K at the depths, each with its band, shape (3, 3, depths)."""
    y = np.quantile(record.output, DEPTHS)
    bands = model.estimated.mass(y), model.estimated.damping(y), model.estimated.stiffness(y)
    return np.array([[band.value, band.low, band.high] for band in bands])
