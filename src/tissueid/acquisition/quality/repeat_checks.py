"""Quality checks against earlier tests at the same site: unusual response, settling tissue."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.acquisition.quality.prepared_test import Array, PreparedTest
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.sessions import Test
from tissueid.sessions.quality import QualityFinding
from tissueid.test_settings import placement

MAX_EARLIER = 10
"""Maximum number of earlier tests that are compared."""

UNUSUAL_SHARE, UNUSUAL_REPEAT_SHARE = 0.10, 0.40
"""Differences of two responses to one command, relative to their spread: doubtful, repeat. Usual: 4 % (thesis Table
7.1).
"""
UNUSUAL_RATIO = 3.0
"""Difference from the repeats, relative to their usual difference, above which a test is unusual."""
PARAMETER_SHARE = 0.30
"""Relative deviation of a parameter from the median of tests with other commands above which a test is unusual."""
SHIFTED_M = 0.15e-3
"""Change of the mean position, m, above which a test is unusual."""
SETTLING_M = 0.05e-3
"""Change of the mean position from test to test, m, that is reported as settling."""
SETTLING_SHARE = 0.02
"""The same, relative to the depth."""

_STEP = 4
"""Decimation of the compared responses, still faster than any motion."""
_PARAMETERS = {
    "mass": marked("The mass differs by {percent:.0f} % from that of {count} earlier tests at this site."),
    "damping": marked("The damping differs by {percent:.0f} % from that of {count} earlier tests at this site."),
    "stiffness": marked("The stiffness differs by {percent:.0f} % from that of {count} earlier tests at this site."),
}
_DEEPER, _LESS_DEEP = marked("deeper"), marked("less deep")


@dataclass(frozen=True, eq=False)
class QuickFit:
    """Mass, kg, damping, N s/m, and stiffness, N/m, from a fast fit that is accurate enough to compare tests."""

    mass: float
    damping: float
    stiffness: float


def quick_fit(prepared: PreparedTest) -> QuickFit | None:
    """Fit force = M a + B v + K x + constant to the filtered signals; return None if the fit is not determined."""
    if not prepared.mechanical:
        return None
    known = prepared.known
    columns = np.column_stack(
        [prepared.acceleration[known], prepared.velocity[known], prepared.position[known], np.ones(known.sum())]
    )
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    if not np.all(scale > 0.0):
        return None
    columns /= scale
    found, _, rank, _ = np.linalg.lstsq(columns, prepared.force[known], rcond=None)
    if rank < scale.size:
        return None
    mass, damping, stiffness, _ = found / scale
    return QuickFit(float(mass), float(damping), float(stiffness))


def comparable_tests(test: Test, earlier: Sequence[Test]) -> list[Test]:
    """Return the newest completed earlier tests of the same site, kind, configuration and sample rate."""
    same = [
        other
        for other in earlier
        if (other.site, other.kind, other.configuration) == (test.site, test.kind, test.configuration)
        and placement(other.notes) == placement(test.notes)
        and other.status == "completed"
        and other.sample_rate_hz == test.sample_rate_hz
        and other.number != test.number
    ]
    return same[-MAX_EARLIER:]


def tests_with_same_command(test: Test, others: Sequence[Test]) -> list[Test]:
    """Return the tests that played the same command."""
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


def check_against_earlier(prepared: PreparedTest, others: Sequence[Test]) -> Iterator[QualityFinding]:
    """Report differences from the earlier tests at this site."""
    if not others or "position" not in prepared.test.signals:
        return
    repeats = tests_with_same_command(prepared.test, others)
    if repeats:
        yield from _against_repeats(prepared, repeats)
    elif len(others) > 1:
        yield from _against_parameters(prepared, others)


def _against_repeats(prepared: PreparedTest, repeats: Sequence[Test]) -> Iterator[QualityFinding]:
    """Compare the responses to the same command."""
    responses = [_response(test, prepared.first) for test in (*repeats, prepared.test)]
    spread = float(np.nanstd(responses[-1])) or 1.0
    levels = [float(np.nanmean(response)) for response in responses]
    settling = _settling(prepared, levels)
    if settling is not None:
        yield settling
    elif (shifted := _shifted(prepared, levels)) is not None:
        yield shifted
    shapes = [response - np.nanmean(response) for response in responses]
    mine = float(np.median([_difference(shapes[-1], other) for other in shapes[:-1]])) / spread
    pairs = [
        _difference(a, b) / spread for place, a in enumerate(shapes[:-1]) for b in shapes[place + 1 : len(repeats)]
    ]
    usual = float(np.median(pairs)) if pairs else 0.0
    if mine > max(UNUSUAL_SHARE, UNUSUAL_RATIO * usual):
        percent, count = 100 * mine, len(repeats)
        if not pairs:
            words = Message(
                "quality.unusual.response",
                "The response differs by {percent:.0f} % from that of the earlier test with the same command at this "
                "site.",
                percent=percent,
                count=count,
            )
        else:
            words = Message(
                "quality.unusual.response",
                "The response differs by {percent:.0f} % from {count} earlier tests with the same command at this "
                "site, which differ from each other by {usual:.0f} %.",
                percent=percent,
                count=count,
                usual=100 * usual,
            )
        yield QualityFinding(
            "unusual",
            "repeat" if mine > UNUSUAL_REPEAT_SHARE else "look",
            words,
            prepared.texts.unusual_advice,
            mine,
        )


def _settling(prepared: PreparedTest, levels: Sequence[float]) -> QualityFinding | None:
    """Yield a finding when the mean depth changes from test to test, as in settling tissue (thesis Fig. 7.4)."""
    surface = prepared.test.surface_position_m
    depth = levels[-1] - surface if np.isfinite(surface) else np.inf
    steps = np.diff(levels)
    last = float(steps[-1])
    least = max(SETTLING_M, SETTLING_SHARE * depth if np.isfinite(depth) else 0.0)
    if abs(last) < least:
        return None
    calmer = len(steps) == 1 or bool(np.sign(steps[-2]) == np.sign(last) and abs(last) <= abs(steps[-2]))
    if not calmer:
        return None
    earlier = marked("the first test at this site") if len(steps) == 1 else marked("the test before")
    return QualityFinding(
        "settling",
        "look",
        Message(
            "quality.settling",
            prepared.texts.settling,
            size=1e3 * abs(last),
            direction=_DEEPER if last > 0 else _LESS_DEEP,
            earlier=earlier,
        ),
        prepared.texts.settling_advice,
        abs(last),
    )


def _shifted(prepared: PreparedTest, levels: Sequence[float]) -> QualityFinding | None:
    """Yield a finding when the mean position differs from all earlier repeats by more than they differ
    from each other.
    """
    before = np.array(levels[:-1])
    off = float(levels[-1] - np.median(before))
    if before.size < 2 or abs(off) <= max(SHIFTED_M, UNUSUAL_RATIO * float(np.ptp(before))):
        return None
    return QualityFinding(
        "unusual",
        "look",
        Message(
            "quality.unusual.position",
            "The mean probe position was {size:.2f} mm {direction} than in {count} earlier tests with the same command "
            "at this site.",
            size=1e3 * abs(off),
            direction=_DEEPER if off > 0 else _LESS_DEEP,
            count=int(before.size),
        ),
        prepared.texts.unusual_advice,
        abs(off),
    )


def _response(test: Test, first: int) -> Array:
    return np.asarray(test.signals["position"][first::_STEP], dtype=np.float64)


def _difference(a: Array, b: Array) -> float:
    return float(np.sqrt(np.nanmean((a - b) ** 2)))


def _against_parameters(prepared: PreparedTest, others: Sequence[Test]) -> Iterator[QualityFinding]:
    """Compare mass, damping and stiffness of quick fits with tests of other commands and similar loads."""
    mine = quick_fit(prepared)
    if mine is None:
        return
    load = _load(prepared)
    fits = []
    for other in others:
        theirs = PreparedTest(other, prepared.device)
        if theirs.mechanical and np.allclose(_load(theirs), load, rtol=0.1, atol=0.2):
            fits.append(quick_fit(theirs))
    known = [fit for fit in fits if fit is not None]
    if len(known) < 2:
        return
    for name, template in _PARAMETERS.items():
        values = np.array([getattr(fit, name) for fit in known])
        middle = float(np.median(values))
        deviation = 1.4826 * float(np.median(np.abs(values - middle)))
        off = abs(getattr(mine, name) - middle)
        if middle > 0.0 and off > max(PARAMETER_SHARE * middle, 5.0 * deviation):
            yield QualityFinding(
                "unusual",
                "look",
                Message(f"quality.unusual.{name}", template, percent=100 * off / middle, count=len(known)),
                prepared.texts.unusual_advice,
                off / middle,
            )


def _load(prepared: PreparedTest) -> Array:
    """Return mean and standard deviation of the force, N, shape (2,)."""
    force = prepared.stimulus("force")
    return np.array([force.mean(), force.std()]) if force.size else np.full(2, np.nan)
