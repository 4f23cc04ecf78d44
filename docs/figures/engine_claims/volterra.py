"""Volterra kernels of known systems (Chen 2010, 4.2), and held-out simulation on the rig."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from identification import simulated_cascades, simulated_dpn
from identification.simulated import Array
from outside_data import RIG
from scipy import ndimage

from engine_claims.base import Claim
from tissueid.errors import UnusableInputError
from tissueid.identification import validated
from tissueid.identification.engines.volterra import Volterra
from tissueid.identification.volterra.structure import VolterraModel
from tissueid.sessions import read_session

FIT_SHARE = 0.75
SEEDS = (1, 2, 3)
THESIS_VAF = (90.0, 97.0)


def alike(one: Array, other: Array) -> float:
    """Cosine between two arrays of one shape."""
    return float(np.sum(one * other) / np.linalg.norm(one) / np.linalg.norm(other))


def diagonal_percent(kernel2: Array) -> float:
    """Share of a second-order kernel's energy on its diagonal, percent."""
    return 100.0 * float(np.sum(np.diag(kernel2) ** 2) / np.sum(kernel2**2))


def linear_percent(model: VolterraModel, u: Array) -> float:
    """Share of the modelled variance that the first-order kernel has, percent."""
    _, first, second = model.contributions(u)
    return 100.0 * float(np.var(first) / np.var(first + second))


def signature(structure: str, curve: str) -> tuple[VolterraModel, Array, Array]:
    """The exact model of a simulated cascade under a white input, its impulse response, and the input."""
    simulate = simulated_cascades.wiener if structure == "wiener" else simulated_cascades.hammerstein
    system = simulate(1, curve=curve)
    memory = simulated_cascades.LAGS / simulated_cascades.RATE
    model = Volterra(memory=memory, downsample=1, method="exact").fit(system.record)
    return model, system.impulse_response, system.record.input


def cascades() -> Iterator[Claim]:
    """The four simulated systems of Figs. 4.3 and 4.4."""
    model, h, _ = signature("wiener", "exponential")
    assert model.kernel1 is not None
    assert model.kernel2 is not None
    first, second = alike(model.kernel1, h), alike(model.kernel2, -np.outer(h, h))
    yield Claim(
        "Volterra, Wiener system with an exponential",
        "h1 as the dynamics, h2 negative and of the shape of h1 x h1",
        f"cosine of h1 with the dynamics {first:.4f}, of h2 with -h1 x h1 {second:.3f}, "
        f"VAF {model.report.vaf_percent:.1f} %",
        first > 0.99 and second > 0.9,
    )
    model, h, _ = signature("hammerstein", "exponential")
    assert model.kernel2 is not None
    share, second = diagonal_percent(model.kernel2), alike(np.diag(model.kernel2), -h)
    yield Claim(
        "Volterra, Hammerstein system with an exponential",
        "h2 on the diagonal only",
        f"{share:.1f} % of h2 on the diagonal, its cosine with minus the dynamics {second:.3f}, "
        f"VAF {model.report.vaf_percent:.2f} %",
        share > 95.0 and second > 0.99,
    )
    model, h, u = signature("wiener", "square")
    assert model.kernel2 is not None
    linear, second = linear_percent(model, u), alike(model.kernel2, np.outer(h, h))
    yield Claim(
        "Volterra, Wiener system with a square",
        "h1 near zero, VAF 100 %",
        f"h1 contributes {linear:.2f} % of the output, cosine of h2 with the product of the dynamics {second:.6f}, "
        f"VAF {model.report.vaf_percent:.4f} %",
        linear < 1.0 and second > 0.9999 and model.report.vaf_percent > 99.999,
    )
    model, h, u = signature("hammerstein", "square")
    assert model.kernel2 is not None
    linear, share = linear_percent(model, u), diagonal_percent(model.kernel2)
    yield Claim(
        "Volterra, Hammerstein system with a square",
        "h1 near zero, h2 on the diagonal only",
        f"h1 contributes {linear:.2f} % of the output, {share:.2f} % of h2 on the diagonal, "
        f"VAF {model.report.vaf_percent:.4f} %",
        linear < 1.0 and share > 99.9,
    )


def across(kernel2: Array, lag: int) -> float:
    """Width, in lags, at half height, of the lobe at (lag, lag), measured across the diagonal."""
    off = np.linspace(-lag, lag, 2001)
    line = ndimage.map_coordinates(kernel2 / kernel2[lag, lag], [lag + off, lag - off], order=3)
    low = np.flatnonzero(line < 0.5)
    return float(off[low[off[low] > 0.0][0]] - off[low[off[low] < 0.0][-1]])


def dynamic_parameters() -> Iterator[Claim]:
    """A system whose damping and stiffness grow with depth (Fig. 4.5)."""
    found = []
    for seed in SEEDS:
        model = Volterra().fit(simulated_dpn.record(simulated_dpn.SKIN, seed))
        assert model.kernel1 is not None
        assert model.kernel2 is not None
        diagonal = np.diag(model.kernel2)
        peak = int(np.argmax(np.abs(diagonal)))
        wiener = np.outer(model.kernel1, model.kernel1)
        wiener_peak = int(np.argmax(np.diag(wiener)))
        lobes = 100.0 * float(np.max(-diagonal * np.sign(diagonal[peak])) / abs(diagonal[peak]))
        narrow = 100.0 * (1.0 - across(model.kernel2, peak) / across(wiener, wiener_peak))
        found.append((narrow, lobes, diagonal[peak] < 0.0, peak / wiener_peak, model.report.vaf_percent))
    narrow, lobes, _, later, vaf = np.median(found, axis=0)
    negative = all(one[2] for one in found)
    yield Claim(
        "Volterra, DPN system, against the h1 x h1 of a Wiener system with the same h1",
        "h2 negative, its main lobe narrower, side lobes of opposite sign",
        f"{'negative' if negative else 'not always negative'}; across the diagonal {narrow:.0f} % narrower, though it "
        f"peaks {later:.1f} times as late; lobes of {lobes:.0f} % of the peak on the diagonal, h1 x h1 has none; "
        f"VAF {vaf:.2f} % (median of {len(SEEDS)})",
        bool(negative and narrow > 0.0 and lobes > 10.0),
    )


def held_out(path: Path, engine: Volterra) -> float:
    """VAF, percent, of the free run on the last quarter of a session's first stochastic test."""
    record = read_session(path).test(None).record("force", "position")
    cut = round(FIT_SHARE * len(record))
    model = validated(engine.fit(record, slice(0, cut)), record, slice(cut, None))
    vaf = model.report.vaf_validation_percent
    assert vaf is not None
    return vaf


def on_the_rig() -> Iterator[Claim]:
    """Held-out free-run simulation on the independent rig, where its sessions are here."""
    sessions = sorted(RIG.glob("rig-*.h5"))
    if not sessions:
        return
    for method in ("exact", "regularised"):
        vafs = []
        for path in sessions:
            try:
                vafs.append(held_out(path, Volterra.from_options({"method": method})))
            except UnusableInputError:
                continue
        low, middle, high = np.percentile(vafs, (10, 50, 90))
        yield Claim(
            f"Volterra, {method}, second order: held-out free-run VAF on the rig's stochastic tests",
            f"median at or above {THESIS_VAF[0]:.0f} to {THESIS_VAF[1]:.0f} %",
            f"{middle:.2f} % (median of {len(vafs)}; 10 to 90 % of sessions: {low:.1f} to {high:.1f})",
            bool(middle >= THESIS_VAF[1]),
        )


def claims() -> Iterator[Claim]:
    """What is claimed of Volterra kernels."""
    yield from cascades()
    yield from dynamic_parameters()
    yield from on_the_rig()
