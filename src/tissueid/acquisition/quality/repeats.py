"""A test against those before it at the same site: does it differ by more than they do, is the tissue settling."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.acquisition.quality.evidence import Array, Evidence
from tissueid.sessions import Test
from tissueid.sessions.quality import QualityFinding
from tissueid.wording import fixed

MOST_EARLIER = 10
"""How many of the tests before count."""

UNUSUAL_SHARE, UNUSUAL_REPEAT_SHARE = 0.10, 0.40
"""Difference of two responses to the same command over their spread. Thesis Table 7.1: repeats vary by some 4 %."""
UNUSUAL_TIMES = 3.0
"""Times the usual difference of repeats."""
PARAMETER_SHARE = 0.30
"""Where commands differ, a parameter this far off the median is unusual, and beyond the spread of the others too."""
SHIFTED_M = 0.15e-3
SETTLING_M = 0.05e-3
SETTLING_SHARE = 0.02

_STEP = 4
"""Responses are compared at every fourth sample: nothing moves between."""
_LABELS = {"mass": "mass", "damping": "damping", "stiffness": "stiffness"}


@dataclass(frozen=True, eq=False)
class QuickFit:
    """Mass, damping and stiffness by the balance of forces, kg, N s/m, N/m; good enough to compare tests by."""

    mass: float
    damping: float
    stiffness: float


def quick_fit(evidence: Evidence) -> QuickFit | None:
    """Least squares of force = M a + B v + K x + constant on the filtered signals; None where it has no answer."""
    if not evidence.mechanical:
        return None
    known = evidence.known
    columns = np.column_stack(
        [evidence.acceleration[known], evidence.velocity[known], evidence.position[known], np.ones(known.sum())]
    )
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    if not np.all(scale > 0.0):
        return None
    columns /= scale
    found, _, rank, _ = np.linalg.lstsq(columns, evidence.force[known], rcond=None)
    if rank < scale.size:
        return None
    mass, damping, stiffness, _ = found / scale
    return QuickFit(float(mass), float(damping), float(stiffness))


def comparable(test: Test, earlier: Sequence[Test]) -> list[Test]:
    """The newest tests before of the same site, kind and configuration that were completed."""
    same = [
        other
        for other in earlier
        if (other.site, other.kind, other.configuration) == (test.site, test.kind, test.configuration)
        and other.status == "completed"
        and other.sample_rate_hz == test.sample_rate_hz
        and other.number != test.number
    ]
    return same[-MOST_EARLIER:]


def same_command(test: Test, others: Sequence[Test]) -> list[Test]:
    """Those of the others that played the same command."""
    command = test.signals.get("command")
    if command is None:
        return []
    found = []
    for other in others:
        theirs = other.signals.get("command")
        if theirs is None or theirs.shape != command.shape:
            continue
        there = np.isfinite(command) & np.isfinite(theirs)
        if there.any() and np.max(np.abs(command[there] - theirs[there])) < 1e-6 + 1e-3 * np.ptp(command[there]):
            found.append(other)
    return found


def compared(evidence: Evidence, others: Sequence[Test]) -> Iterator[QualityFinding]:
    """What differs from the tests before at this site."""
    if not others or "position" not in evidence.test.signals:
        return
    repeats = same_command(evidence.test, others)
    if repeats:
        yield from _against_repeats(evidence, repeats)
    elif len(others) > 1:
        yield from _against_parameters(evidence, others)


def _against_repeats(evidence: Evidence, repeats: Sequence[Test]) -> Iterator[QualityFinding]:
    """The same command again: the response itself is compared."""
    responses = [_response(test, evidence.first) for test in (*repeats, evidence.test)]
    spread = float(np.nanstd(responses[-1])) or 1.0
    levels = [float(np.nanmean(response)) for response in responses]
    settling = _settling(evidence, levels)
    if settling is not None:
        yield settling
    elif (shifted := _shifted(evidence, levels)) is not None:
        yield shifted
    shapes = [response - np.nanmean(response) for response in responses]
    mine = float(np.median([_difference(shapes[-1], other) for other in shapes[:-1]])) / spread
    pairs = [
        _difference(a, b) / spread for place, a in enumerate(shapes[:-1]) for b in shapes[place + 1 : len(repeats)]
    ]
    usual = float(np.median(pairs)) if pairs else 0.0
    if mine > max(UNUSUAL_SHARE, UNUSUAL_TIMES * usual):
        others = "test" if len(repeats) == 1 else "tests"
        against = f"; theirs differ by {fixed(100 * usual, 0)} %" if pairs else ""
        yield QualityFinding(
            "unusual",
            "repeat" if mine > UNUSUAL_REPEAT_SHARE else "look",
            f"The response differs by {fixed(100 * mine, 0)} % from {len(repeats)} earlier {others} with the same "
            f"command at this site{against}.",
            evidence.setting.to_look,
            mine,
        )


def _settling(evidence: Evidence, levels: Sequence[float]) -> QualityFinding | None:
    """The mean depth moves from test to test, as tissue does that is compressed by each (thesis 7.1.2, Fig. 7.4)."""
    surface = evidence.test.surface_position_m
    depth = levels[-1] - surface if np.isfinite(surface) else np.inf
    steps = np.diff(levels)
    last = float(steps[-1])
    least = max(SETTLING_M, SETTLING_SHARE * depth if np.isfinite(depth) else 0.0)
    if abs(last) < least:
        return None
    calmer = len(steps) == 1 or bool(np.sign(steps[-2]) == np.sign(last) and abs(last) <= abs(steps[-2]))
    if not calmer:
        return None
    way = "deeper" if last > 0 else "less deep"
    which = "the first test at this site" if len(steps) == 1 else "the one before"
    return QualityFinding(
        "settling",
        "look",
        f"{evidence.setting.unsettled}: on average the probe stood {fixed(1e3 * abs(last), 2)} mm {way} than in "
        f"{which}, under the same force.",
        evidence.setting.to_settle,
        abs(last),
    )


def _shifted(evidence: Evidence, levels: Sequence[float]) -> QualityFinding | None:
    """The mean position lies elsewhere than in all the repeats before, by more than they differ."""
    before = np.array(levels[:-1])
    off = float(levels[-1] - np.median(before))
    if before.size < 2 or abs(off) <= max(SHIFTED_M, UNUSUAL_TIMES * float(np.ptp(before))):
        return None
    return QualityFinding(
        "unusual",
        "look",
        f"On average the probe stood {fixed(1e3 * abs(off), 2)} mm {'deeper' if off > 0 else 'less deep'} than in "
        f"{before.size} earlier tests with the same command at this site.",
        evidence.setting.to_look,
        abs(off),
    )


def _response(test: Test, first: int) -> Array:
    return np.asarray(test.signals["position"][first::_STEP], dtype=np.float64)


def _difference(a: Array, b: Array) -> float:
    return float(np.sqrt(np.nanmean((a - b) ** 2)))


def _against_parameters(evidence: Evidence, others: Sequence[Test]) -> Iterator[QualityFinding]:
    """Other commands: mass, damping and stiffness of a quick fit are compared, where the loads are alike."""
    mine = quick_fit(evidence)
    if mine is None:
        return
    load = _load(evidence)
    fits = []
    for other in others:
        theirs = Evidence(other, evidence.device)
        if theirs.mechanical and np.allclose(_load(theirs), load, rtol=0.1, atol=0.2):
            fits.append(quick_fit(theirs))
    known = [fit for fit in fits if fit is not None]
    if len(known) < 2:
        return
    for name, label in _LABELS.items():
        values = np.array([getattr(fit, name) for fit in known])
        middle = float(np.median(values))
        deviation = 1.4826 * float(np.median(np.abs(values - middle)))
        off = abs(getattr(mine, name) - middle)
        if middle > 0.0 and off > max(PARAMETER_SHARE * middle, 5.0 * deviation):
            yield QualityFinding(
                "unusual",
                "look",
                f"The {label} is {fixed(100 * off / middle, 0)} % off that of {len(known)} earlier tests at this site.",
                evidence.setting.to_look,
                off / middle,
            )


def _load(evidence: Evidence) -> Array:
    """Mean and spread of the force, N, shape (2,)."""
    force = evidence.stimulus("force")
    return np.array([force.mean(), force.std()]) if force.size else np.full(2, np.nan)
