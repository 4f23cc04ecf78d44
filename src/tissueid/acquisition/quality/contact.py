"""Did the probe stay on the tissue, did the tissue and the instrument stay where they were, had the tissue settled."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy import linalg, stats

from tissueid.acquisition.quality.evidence import Array, Evidence, longest
from tissueid.device import angle_deg
from tissueid.sessions.quality import QualityFinding
from tissueid.stimuli.base import RISE_S
from tissueid.wording import fixed

LOST_FORCE_N = 0.10
"""Contact force below which nothing holds probe and tissue together; estimated to some 0.05 N."""
LOST_S = 0.002
"""A shorter loss is what filtering makes of a fast force."""
LOST_SHARE, LOST_REPEAT_SHARE = 0.001, 0.05
SURFACE_KNOWN_TO_M = 0.3e-3
"""How far the surface found at placing may be off."""

MOVED_M, MOVED_REPEAT_M = 0.15e-3, 0.5e-3
MOVED_SHARE = 0.10
"""Of the spread of the position: what moves less does not count, whatever it is."""
_BLOCK_S = 0.05
_POWERS = (1, 2, 3)
_FEWEST_BLOCKS = 24
_MOST_BLOCKS = 2000
"""Longer tests have longer blocks: the search takes memory in proportion to the square of their number."""

_AFTER_RISE_S = 0.07
"""What follows the rise of the preload at once belongs to it."""
_HELD_BLOCK_S = 0.02
_FEWEST_HELD_BLOCKS, _MOST_HELD_BLOCKS = 10, 150
_FINEST_M = 1e-9
_HELD_WITHIN = 0.2
"""A load that changes by more is not held: an old record, or another kind of test."""

SHOCK_M_S2 = 3.0
TURNED_DEG = 10.0
SURFACE_CHANGED_M = 1.0e-3

CREEP_SHARE, CREEP_M = 0.03, 0.03e-3
_CREEP_S = 0.15


def lifted(evidence: Evidence) -> Iterator[QualityFinding]:
    """Contact lost: nothing presses the probe onto the tissue, or it stands above the surface that was found."""
    test, setting = evidence.test, evidence.setting
    if not evidence.mechanical or test.configuration != "indentation" or test.kind == "free_air":
        return
    if test.kind == "spring" and _pulled(evidence):
        return
    share = _share_without_force(evidence)
    above = 0.0
    if np.isfinite(test.surface_position_m):
        position = evidence.stimulus("position")
        above = float(np.mean(position < test.surface_position_m - SURFACE_KNOWN_TO_M))
    worst = max(share, above)
    if worst <= LOST_SHARE:
        return
    how = f"nothing pressed it onto the {setting.pressed}" if share >= above else "it stood above the surface"
    yield QualityFinding(
        "probe_lifted",
        "repeat" if worst > LOST_REPEAT_SHARE else "look",
        f"The probe left the {setting.left} for {_percent(worst)} of the test: {how}.",
        setting.to_press,
        worst,
    )


def _pulled(evidence: Evidence) -> bool:
    """Whether a spring is fixed to the probe: where it does not press it pulls, which nothing that lifted off does."""
    gone = evidence.known & (evidence.contact_force < LOST_FORCE_N)
    return bool(gone.any() and float(evidence.contact_force[gone].mean()) < -LOST_FORCE_N)


def _share_without_force(evidence: Evidence) -> float:
    """Share of the stimulus in which the contact force is gone for long enough to be believed."""
    gone = evidence.known & (evidence.contact_force < LOST_FORCE_N)
    least = max(1, round(LOST_S * evidence.rate))
    if longest(gone) < least:
        return 0.0
    return float(gone.sum() / evidence.known.sum())


def moved(evidence: Evidence) -> Iterator[QualityFinding]:
    """The reference surface moved: the position's baseline shifts by what neither force nor creep accounts for."""
    if not evidence.mechanical or evidence.test.kind in ("free_air", "quiet"):
        return
    found = [shift for shift in (baseline_shift(evidence), preload_shift(evidence)) if shift is not None]
    if not found:
        return
    shift, at_s, sudden = max(found, key=lambda item: abs(item[0]))
    how = f"jumped by {_mm(shift)} mm at {fixed(at_s, 1)} s" if sudden else f"drifted by {_mm(shift)} mm"
    yield QualityFinding(
        "reference_moved",
        "repeat" if abs(shift) > MOVED_REPEAT_M else "look",
        f"The {evidence.setting.shifted} moved: the position {how} beyond what force and creep account for.",
        evidence.setting.to_hold,
        abs(shift),
    )


def baseline_shift(evidence: Evidence) -> tuple[float, float, bool] | None:
    """The shift, m, when it was, s from the start of the test, and whether it was sudden; None for none.

    Means over blocks of 50 ms, or more in a test of over 100 s, follow the means of the powers of the force, whatever
    the static curve, and the logarithm of time, as creep does. What a step or a ramp accounts for beyond them is
    movement.
    """
    samples = evidence.test.samples - evidence.first
    length = max(1, round(_BLOCK_S * evidence.rate), math.ceil(samples / _MOST_BLOCKS))
    count = samples // length
    if count < _FEWEST_BLOCKS:
        return None
    part = slice(evidence.first, evidence.first + count * length)
    whole = evidence.known[part].reshape(count, length).mean(axis=1) > 0.5
    if whole.sum() < _FEWEST_BLOCKS:
        return None
    force = evidence.force[part]
    level, spread = float(force.mean()), float(force.std()) or 1.0
    scaled = (force - level) / spread
    blocks = [(scaled**power).reshape(count, length).mean(axis=1) for power in _POWERS]
    moving = (evidence.velocity[part] ** 2).reshape(count, length).mean(axis=1)
    seconds = (np.arange(count) + 0.5) * length / evidence.rate
    creep = np.log(seconds + max(evidence.test.preload_s, _BLOCK_S))
    position = evidence.position[part].reshape(count, length).mean(axis=1)
    common = np.column_stack([np.ones(count), *blocks, moving / (moving.mean() or 1.0), creep])[whole]
    y, at = position[whole], seconds[whole]
    q = linalg.qr(common, mode="economic")[0]
    rest = y - q @ (q.T @ y)
    steps = (at[:, None] > at[None, 3:-3]).astype(np.float64)  # (blocks, places)
    candidates = np.column_stack([steps, at])
    candidates -= q @ (q.T @ candidates)
    norm = np.einsum("ij,ij->j", candidates, candidates)
    usable = norm > 0.02 * y.size / 4
    if not usable.any():
        return None
    gain = np.where(usable, (rest @ candidates) ** 2 / np.where(usable, norm, 1.0), 0.0)
    best = int(np.argmax(gain))
    freedom = y.size - common.shape[1] - 1
    noise = (rest @ rest - gain[best]) / freedom
    size = float(rest @ candidates[:, best] / norm[best])
    sudden = best < steps.shape[1]
    shift = size if sudden else size * float(at[-1] - at[0])
    least = max(MOVED_M, MOVED_SHARE * float(np.std(evidence.position[part])))
    # As many places were tried as there are blocks. Good tests stay twenty times below this.
    certain = gain[best] / noise > float(stats.f.isf(1e-4 / y.size, 1, freedom))
    if abs(shift) < least or not certain:
        return None
    place_s = evidence.test.preload_s + float(at[3:-3][best] if sudden else at[0])
    return shift, place_s, sudden


def preload_shift(evidence: Evidence) -> tuple[float, float, bool] | None:
    """A jump while the preload was held: its size, m, when it was, s from the start of the test, True; None for none.

    Under a load that does not change the position follows the logarithm of time, as creep does. A step between two
    blocks of 20 ms that exceeds all else that the position does meanwhile is movement; a drift cannot be told from
    creep here.
    """
    first = round((RISE_S + _AFTER_RISE_S) * evidence.rate)
    length = max(round(_HELD_BLOCK_S * evidence.rate), (evidence.first - first) // _MOST_HELD_BLOCKS, 1)
    count = (evidence.first - first) // length
    if count < _FEWEST_HELD_BLOCKS:
        return None
    part = slice(evidence.first - count * length, evidence.first)
    force = evidence.force[part].reshape(count, length).mean(axis=1)
    if not evidence.received[part].reshape(count, length).any(axis=1).all():
        return None
    if np.ptp(force) > _HELD_WITHIN * abs(float(force.mean())):
        return None
    y = evidence.position[part].reshape(count, length).mean(axis=1)
    at = (part.start + (np.arange(count) + 0.5) * length) / evidence.rate
    q = linalg.qr(np.column_stack([np.ones(count), np.log(at), force]), mode="economic")[0]
    rest = y - q @ (q.T @ y)
    steps = (at[:, None] > at[None, 1:-2]).astype(np.float64)
    steps -= q @ (q.T @ steps)
    norm = np.einsum("ij,ij->j", steps, steps)
    gain = (rest @ steps) ** 2 / norm
    best = int(np.argmax(gain))
    freedom = count - q.shape[1] - 1
    shift = float(rest @ steps[:, best] / norm[best])
    noise = max((rest @ rest - gain[best]) / freedom, _FINEST_M**2)
    certain = gain[best] / noise > float(stats.f.isf(1e-4 / count, 1, freedom))
    if not certain or abs(shift) < max(MOVED_M, abs(float(y[-1] - y[0]) - shift)):
        return None
    return shift, float(at[best + 1]) + 0.5 * length / evidence.rate, True


def shaken(evidence: Evidence) -> Iterator[QualityFinding]:
    """A knock that the accelerometer felt, or an instrument that was turned since it was placed."""
    across, along = evidence.signal("acceleration_y"), evidence.signal("acceleration_x")
    if across is None or along is None or np.nanstd(across) == 0.0:
        return
    sideways = across - np.nanmedian(across)
    peak = float(np.nanmax(np.abs(sideways)))
    usual = 1.4826 * float(np.nanmedian(np.abs(sideways)))
    if peak > max(SHOCK_M_S2, 12.0 * usual):
        when = float(np.nanargmax(np.abs(sideways)) / evidence.rate)
        yield QualityFinding(
            "shock",
            "look",
            f"The instrument was knocked {fixed(when, 1)} s into the test: it felt {fixed(peak, 1)} m/s² sideways.",
            evidence.setting.to_bear_a_knock,
            peak,
        )
    placed = [evidence.test.notes.get(f"gravity_{name}_stroke_m_s2") for name in ("along", "across")]
    if not all(isinstance(value, float) for value in placed):
        return
    last = slice(-max(1, across.size // 4), None)  # of what was received
    now = float(along[np.isfinite(along)][last].mean()), float(across[np.isfinite(across)][last].mean())
    turned = angle_deg(now, (float(placed[0] or 0.0), float(placed[1] or 0.0)))
    if turned > TURNED_DEG:
        yield QualityFinding(
            "orientation_changed",
            "repeat",
            f"The instrument was turned by {fixed(turned, 0)}° since it was placed.",
            evidence.setting.to_turn_back,
            turned,
        )


def unsettled(evidence: Evidence) -> Iterator[QualityFinding]:
    """The tissue still gave way at the end of the preload."""
    test = evidence.test
    position, window = evidence.signal("position"), round(_CREEP_S * evidence.rate)
    if position is None or test.kind != "stochastic" or test.configuration != "indentation":
        return
    if evidence.first < 2 * window:
        if test.samples < round(test.preload_s * evidence.rate):
            return  # it ended within its preload, and how long that was held is told
        yield QualityFinding(
            "preload_short",
            "note",
            f"The mean load was held for {fixed(test.preload_s, 2)} s before the test: too short to see whether the "
            "tissue had settled.",
            "Hold the preload for 0.5 s or longer.",
            test.preload_s,
        )
        return
    last = position[evidence.first - window : evidence.first]
    before = position[evidence.first - 2 * window : evidence.first - window]
    if np.isnan(last).mean() > 0.2 or np.isnan(before).mean() > 0.2:
        return
    creep = abs(float(np.nanmean(last) - np.nanmean(before)))
    depth = float(np.nanmean(last) - test.surface_position_m) if np.isfinite(test.surface_position_m) else np.nan
    share = creep / depth if depth > 0.2e-3 else 0.0
    if creep > CREEP_M and (share > CREEP_SHARE or not np.isfinite(depth)):
        yield QualityFinding(
            "preload_short",
            "look",
            f"The tissue had not settled when the test began: it still gave way by {_mm(creep)} mm in the last "
            f"{_CREEP_S:g} s of the preload.",
            "Hold the preload longer, or run the test again at once and discard this one.",
            creep,
        )


def surface_changed(evidence: Evidence, earlier: Array) -> Iterator[QualityFinding]:
    """The surface was found elsewhere than in the tests before at this site; ``earlier`` are theirs, m."""
    surface = evidence.test.surface_position_m
    if not np.isfinite(surface) or not earlier.size:
        return
    change = float(surface - np.median(earlier))
    thing, way = evidence.setting.lies, "deeper" if change > 0 else "higher"
    if abs(change) > SURFACE_CHANGED_M:
        yield QualityFinding(
            "surface_changed",
            "look",
            f"The {thing} lies {_mm(abs(change))} mm {way} than in the tests before at this site: the instrument was "
            "moved.",
            evidence.setting.to_place_alike,
            abs(change),
        )


def _mm(metres: float) -> str:
    return fixed(1e3 * abs(metres), 2)


def _percent(share: float) -> str:
    return f"{fixed(100.0 * share, 1)} %"
