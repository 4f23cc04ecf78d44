"""Early stopping: how soon a designed test is as good as 4 s of the default noise (two skin presets, 50 tests each)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from engine_claims.base import Claim
from stopping_study import (
    CURVE_PRESETS,
    HALF_S,
    LENGTH_S,
    LOADS_N,
    PARAMETERS,
    RUNS,
    TIMES,
    appraised,
    course,
    curves,
    pooled_times,
    stopped,
    times_to_reference,
)

PRESETS = CURVE_PRESETS
CURVES = CURVE_PRESETS[0]
HALF = int(np.searchsorted(TIMES, HALF_S))
LINE = "mass, damping, stiffness about 5.5 N"


def claims() -> Iterator[Claim]:
    """The line about a load, the rule that ends a test, the curves over depth, and what each costs."""
    yield _as_good("told", f"median of {RUNS} reported deviations")
    yield _as_good("spread", f"spread of {RUNS} estimates")
    yield _as_good("error", "rms distance from the plant's own values")
    yield _prediction()
    yield from _stopping()
    yield _worst_load("told", f"median of {RUNS} reported deviations")
    yield _worst_load("spread", f"spread of {RUNS} estimates")
    yield _middle_load()
    yield _comfort()


def _percent(values: np.ndarray) -> str:
    return ", ".join(f"{100.0 * value:.2g}" for value in values) + " %"


def _as_good(measure: str, said: str) -> Claim:
    each = [times_to_reference(preset)[measure] for preset in PRESETS]
    worst = max(max(times) for times in each)
    pooled = ", ".join(f"{time:.2f}" for time in pooled_times(PRESETS, measure))
    return Claim(
        f"designed about a load, {LINE}: when it is as good as 4 s of the Gaussian default, by the {said}",
        f"{HALF_S:g} s, each parameter on each preset",
        f"{pooled} s (the slowest on any preset {worst:.2f} s; {TIMES[0]:.2f} s is the first look)",
        worst <= HALF_S,
    )


def _prediction() -> Claim:
    """The reported deviation is compared with the spread, which it must not understate by much."""
    ratio = np.array([course(p, "designed").told[HALF] / course(p, "designed").spread[HALF] for p in PRESETS])
    return Claim(
        f"designed, {HALF_S:g} s, {LINE}: reported deviation over the spread of {RUNS} estimates, by preset",
        "0.75 to 1.5",
        "; ".join(", ".join(f"{value:.2f}" for value in row) for row in ratio),
        bool(np.all((ratio > 0.75) & (ratio < 1.5))),
    )


def _stopping() -> Iterator[Claim]:
    ends = [stopped(preset, "designed") for preset in PRESETS]
    seconds = np.concatenate([end.seconds for end in ends])
    yield Claim(
        f"designed, stopped when it knows what 4 s of the default tell: length, median of {seconds.size} (range)",
        f"{HALF_S:g} s",
        f"{np.median(seconds):.2f} s ({seconds.min():g} to {seconds.max():g} s)",
        float(np.median(seconds)) <= HALF_S,
    )
    held = 100.0 * np.mean([end.held_limit for end in ends], axis=0)
    own = 100.0 * np.mean([end.held_own for end in ends], axis=0)
    yield Claim(
        f"the same: 95 % intervals at the end that hold what the stimulus finds on average ({LINE})",
        "92 % or more",
        ", ".join(f"{share:.0f}" for share in held)
        + " % (the plant's own values: "
        + ", ".join(f"{share:.0f}" for share in own)
        + " %)",
        bool(np.all(held >= 92.0)),
    )


def _worst_load(measure: str, said: str) -> Claim:
    whole = getattr(curves(CURVES, "gaussian", LENGTH_S), measure).max(axis=1)
    even = getattr(curves(CURVES, "even", HALF_S), measure).max(axis=1)
    return Claim(
        f"curves (dpn), even noise over the range, {HALF_S:g} s, worst of {LOADS_N[0]:g} to {LOADS_N[-1]:g} N: "
        f"{said} of {', '.join(PARAMETERS)}",
        f"4 s of the default: {_percent(whole)}",
        _percent(even),
        bool(np.all(even <= whole)),
    )


def _middle_load() -> Claim:
    middle = LOADS_N.index(5.5)
    whole = curves(CURVES, "gaussian", LENGTH_S).told[:, middle]
    even = curves(CURVES, "even", HALF_S).told[:, middle]
    return Claim(
        "the same at the mean load, where the default spends most of its time",
        f"no promise; 4 s of the default: {_percent(whole)}",
        _percent(even),
        True,
    )


def _comfort() -> Claim:
    default = appraised("gaussian")
    others = {kind: appraised(kind) for kind in ("designed", "even")}
    edges = {kind: found.steepest_edge_n_per_ms / default.steepest_edge_n_per_ms for kind, found in others.items()}
    heat = {kind: found.heating.energy_j / found.seconds for kind, found in (others | {"gaussian": default}).items()}
    return Claim(
        "steepest edge against the default's (designed, even); heat in the coil (default, designed, even)",
        "no steeper than the default",
        f"{edges['designed']:.2f}, {edges['even']:.2f}; "
        f"{heat['gaussian']:.0f}, {heat['designed']:.0f}, {heat['even']:.0f} W",
        max(edges.values()) <= 1.0,
    )
