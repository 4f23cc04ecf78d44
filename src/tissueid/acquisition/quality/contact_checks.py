"""Quality checks of the contact: loss of contact, shifted reference, knocks, orientation, settling of the tissue."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy import linalg, stats

from tissueid.acquisition.quality.prepared_test import Array, PreparedTest, longest_run
from tissueid.configuration import is_attached
from tissueid.device import angle_deg
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.sessions.quality import QualityFinding
from tissueid.stimuli.base import RISE_S

LOST_FORCE_N = 0.10
"""Contact force, N, below which contact counts as lost; it is estimated to about 0.05 N."""
LOST_S = 0.002
"""Minimum duration, s, of a loss of contact that counts: filtering a fast force produces shorter ones."""
LOST_SHARE, LOST_REPEAT_SHARE = 0.001, 0.05
"""Shares of time without contact above which a test is doubtful or should be repeated."""
SURFACE_KNOWN_TO_M = 0.3e-3
"""Error of the surface position found at placing, m."""

MOVED_M, MOVED_REPEAT_M = 0.15e-3, 0.5e-3
"""Shifts of the reference, m, above which a test is doubtful or should be repeated."""
MOVED_SHARE = 0.10
"""Minimum shift that is reported, relative to the standard deviation of the position."""
_BLOCK_S = 0.05
"""Length of the blocks, s, whose means are tested for a shift."""
_POWERS = (1, 2, 3)
"""Powers of the force in the static model of the block means."""
_MIN_BLOCKS = 24
"""Minimum number of blocks for the detection of a shift."""
_MAX_BLOCKS = 2000
"""Maximum number of blocks; long tests use longer blocks, because memory grows with the square of their number."""

_AFTER_RISE_S = 0.07
"""Time after the rise of the preload that is excluded, s."""
_HELD_BLOCK_S = 0.02
"""Length of the blocks, s, during the held preload."""
_MIN_HELD_BLOCKS, _MAX_HELD_BLOCKS = 10, 150
"""Minimum and maximum number of blocks of the held preload."""
_FINEST_M = 1e-9
"""Lower bound of the noise of a block mean, m, for noiseless records."""
_HELD_WITHIN = 0.2
"""Relative change of the force above which the load is not treated as held (old record, other kind of test)."""

SHOCK_M_S2 = 3.0
"""Sideways acceleration, m/s^2, from which a knock is reported."""
TURNED_DEG = 10.0
"""Change of orientation, degrees, that is reported."""
SURFACE_CHANGED_M = 1.0e-3
"""Change of the surface position since the earlier tests, m, that is reported."""

CREEP_SHARE, CREEP_M = 0.03, 0.03e-3
"""Creep at the end of the preload that is reported: relative to the depth, and m."""
_CREEP_S = 0.15
"""Length, s, of the two intervals at the end of the preload that are compared."""


def check_contact(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report loss of contact: no contact force, or a probe above the detected surface."""
    test, texts = prepared.test, prepared.texts
    if not prepared.mechanical or test.configuration != "indentation" or test.kind == "free_air":
        return
    if is_attached(test.notes):
        return
    gone = prepared.valid & (prepared.contact_force < LOST_FORCE_N)
    if test.kind == "spring" and gone.any() and float(prepared.contact_force[gone].mean()) < -LOST_FORCE_N:
        return  # the spring is fixed to the probe, and can pull as well as push
    certain = longest_run(gone) >= max(1, round(LOST_S * prepared.rate))
    share = float(gone.sum() / prepared.valid.sum()) if certain else 0.0
    above = 0.0
    if np.isfinite(test.surface_position_m):
        position = prepared.stimulus("position")
        above = float(np.mean(position < test.surface_position_m - SURFACE_KNOWN_TO_M))
    worst = max(share, above)
    if worst <= LOST_SHARE:
        return
    template = texts.no_contact_force if share >= above else texts.above
    yield QualityFinding(
        "probe_lifted",
        "repeat" if worst > LOST_REPEAT_SHARE else "look",
        Message("quality.probe_lifted", template, percent=100.0 * worst),
        texts.contact_advice,
        worst,
    )


def check_reference(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a shifted reference: a shift of the position that neither force nor creep explains."""
    if not prepared.mechanical or prepared.test.kind in ("free_air", "quiet"):
        return
    shifts = [shift for shift in (baseline_shift(prepared), preload_shift(prepared)) if shift is not None]
    if not shifts:
        return
    shift, at_s, sudden = max(shifts, key=lambda item: abs(item[0]))
    texts, size = prepared.texts, 1e3 * abs(shift)
    if sudden:
        message = Message("quality.reference_moved.jump", texts.position_jump, size=size, seconds=at_s)
    else:
        message = Message("quality.reference_moved.drift", texts.position_drift, size=size)
    yield QualityFinding(
        "reference_moved",
        "repeat" if abs(shift) > MOVED_REPEAT_M else "look",
        message,
        texts.reference_advice,
        abs(shift),
    )


def baseline_shift(prepared: PreparedTest) -> tuple[float, float, bool] | None:
    """Return the shift of the position, m, its time, s from the start, and whether it was sudden; None without a shift.

    Block means of the position (50 ms, longer in tests of over 100 s) are regressed on those of the powers of the force
    (static curve; of pushing and pulling separately, where a test does both) and on the logarithm of time (creep). A
    significant step or ramp in the residual is the shift.
    """
    samples = prepared.test.samples - prepared.first
    length = max(1, round(_BLOCK_S * prepared.rate), math.ceil(samples / _MAX_BLOCKS))
    count = samples // length
    if count < _MIN_BLOCKS:
        return None
    part = slice(prepared.first, prepared.first + count * length)
    whole = prepared.valid[part].reshape(count, length).mean(axis=1) > 0.5
    if whole.sum() < _MIN_BLOCKS:
        return None
    force = prepared.force[part]
    spread = float(force.std()) or 1.0
    if force.min() < -LOST_FORCE_N and force.max() > LOST_FORCE_N:  # pulling is a branch of its own
        branches = [np.maximum(force, 0.0) / spread, np.minimum(force, 0.0) / spread]
    else:
        branches = [(force - float(force.mean())) / spread]
    blocks = [(branch**power).reshape(count, length).mean(axis=1) for branch in branches for power in _POWERS]
    moving = (prepared.velocity[part] ** 2).reshape(count, length).mean(axis=1)
    seconds = (np.arange(count) + 0.5) * length / prepared.rate
    creep = np.log(seconds + max(prepared.test.preload_s, _BLOCK_S))
    position = prepared.position[part].reshape(count, length).mean(axis=1)
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
    if sudden:
        shift = size
    else:
        # In a few seconds a ramp and the creep (last column of ``common``) are nearly collinear: a breath gives both
        # large and opposite amplitudes. The drift is therefore at most the range of the motion that both describe.
        ramp = size * (at - at[0])
        creep = common[:, -1] * float(np.linalg.lstsq(common, y - ramp, rcond=None)[0][-1])
        shift = float(np.sign(size) * min(np.ptp(ramp), np.ptp(ramp + creep)))
    least = max(MOVED_M, MOVED_SHARE * float(np.std(prepared.position[part])))
    # Bonferroni correction: one test per block. Good tests are twenty times below this threshold.
    certain = gain[best] / noise > float(stats.f.isf(1e-4 / y.size, 1, freedom))
    if abs(shift) < least or not certain:
        return None
    place_s = prepared.test.preload_s + float(at[3:-3][best] if sudden else at[0])
    return shift, place_s, sudden


def preload_shift(prepared: PreparedTest) -> tuple[float, float, bool] | None:
    """Return a jump during the held preload: size, m, time, s from the start, True; None without a jump.

    Under a constant load the position follows the logarithm of time (creep). A significant step between two blocks of
    20 ms that exceeds the rest of the motion is a shift. A drift cannot be distinguished from creep here.
    """
    first = round((RISE_S + _AFTER_RISE_S) * prepared.rate)
    length = max(round(_HELD_BLOCK_S * prepared.rate), (prepared.first - first) // _MAX_HELD_BLOCKS, 1)
    count = (prepared.first - first) // length
    if count < _MIN_HELD_BLOCKS:
        return None
    part = slice(prepared.first - count * length, prepared.first)
    force = prepared.force[part].reshape(count, length).mean(axis=1)
    if not prepared.received[part].reshape(count, length).any(axis=1).all():
        return None
    if np.ptp(force) > _HELD_WITHIN * abs(float(force.mean())):
        return None
    y = prepared.position[part].reshape(count, length).mean(axis=1)
    at = (part.start + (np.arange(count) + 0.5) * length) / prepared.rate
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
    return shift, float(at[best + 1]) + 0.5 * length / prepared.rate, True


def check_disturbance(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a knock measured by the accelerometer, and a rotation of the instrument since it was placed."""
    across, along = prepared.signal("acceleration_y"), prepared.signal("acceleration_x")
    if across is None or along is None or np.nanstd(across) == 0.0:
        return
    sideways = across - np.nanmedian(across)
    peak = float(np.nanmax(np.abs(sideways)))
    usual = 1.4826 * float(np.nanmedian(np.abs(sideways)))
    if peak > max(SHOCK_M_S2, 12.0 * usual):
        when = float(np.nanargmax(np.abs(sideways)) / prepared.rate)
        yield QualityFinding(
            "shock",
            "look",
            Message(
                "quality.shock",
                "The instrument was knocked {seconds:.1f} s into the test ({peak:.1f} m/s² sideways).",
                seconds=when,
                peak=peak,
            ),
            prepared.texts.knock_advice,
            peak,
        )
    placed = [prepared.test.notes.get(f"gravity_{name}_stroke_m_s2") for name in ("along", "across")]
    if not all(isinstance(value, float) for value in placed):
        return
    last = slice(-max(1, across.size // 4), None)  # of the received samples
    now = float(along[np.isfinite(along)][last].mean()), float(across[np.isfinite(across)][last].mean())
    turned = angle_deg(now, (float(placed[0] or 0.0), float(placed[1] or 0.0)))
    if turned > TURNED_DEG:
        yield QualityFinding(
            "orientation_changed",
            "repeat",
            Message(
                "quality.orientation_changed",
                "The instrument was turned by {degrees:.0f}° since it was placed.",
                degrees=turned,
            ),
            prepared.texts.orientation_advice,
            turned,
        )


def check_settling(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report tissue that was still creeping at the end of the preload."""
    test = prepared.test
    position, window = prepared.signal("position"), round(_CREEP_S * prepared.rate)
    if position is None or test.kind != "stochastic" or test.configuration != "indentation":
        return
    if prepared.first < 2 * window:
        if test.samples < round(test.preload_s * prepared.rate):
            return  # ended within its preload, which ``ended`` reports
        yield QualityFinding(
            "preload_short",
            "note",
            Message(
                "quality.preload_short",
                "The mean load was held for {seconds:.2f} s before the test: too short to see whether the tissue had "
                "settled.",
                seconds=test.preload_s,
            ),
            marked("Hold the preload for 0.5 s or longer."),
            test.preload_s,
        )
        return
    last = position[prepared.first - window : prepared.first]
    before = position[prepared.first - 2 * window : prepared.first - window]
    if np.isnan(last).mean() > 0.2 or np.isnan(before).mean() > 0.2:
        return
    creep = abs(float(np.nanmean(last) - np.nanmean(before)))
    depth = float(np.nanmean(last) - test.surface_position_m) if np.isfinite(test.surface_position_m) else np.nan
    share = creep / depth if depth > 0.2e-3 else 0.0
    if creep > CREEP_M and (share > CREEP_SHARE or not np.isfinite(depth)):
        yield QualityFinding(
            "preload_short",
            "look",
            Message(
                "quality.not_settled",
                "The tissue had not settled when the test began: it crept by {size:.2f} mm in the last {seconds:g} s "
                "of the preload.",
                size=1e3 * creep,
                seconds=_CREEP_S,
            ),
            marked("Hold the preload longer, or repeat the test immediately and discard this one."),
            creep,
        )


def check_surface(prepared: PreparedTest, earlier: Array) -> Iterator[QualityFinding]:
    """Report a surface that differs from the positions ``earlier``, m, in the earlier tests at this site."""
    surface = prepared.test.surface_position_m
    if not np.isfinite(surface) or not earlier.size:
        return
    change = float(surface - np.median(earlier))
    texts = prepared.texts
    if abs(change) > SURFACE_CHANGED_M:
        yield QualityFinding(
            "surface_changed",
            "look",
            Message("quality.surface_changed", texts.deeper if change > 0 else texts.higher, size=1e3 * abs(change)),
            texts.surface_advice,
            abs(change),
        )
