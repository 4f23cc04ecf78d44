"""What a test with a feedback stimulus left in its session, as figures take it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.reports.diagnostics import Array
from tissueid.reports.feedback_figures import FeedbackRun
from tissueid.sessions import Test

REPORT_NOTE = "stimulus_report"
"""Name of the note in which a session keeps what the stimulus said came of it, as JSON."""


def feedback_run(test: Test, label: str) -> FeedbackRun:
    """A test as a run; ``label`` is what figures call it.

    Raises:
        UnusableInputError: the stimulus of the test was not one that followed the depth, or left no report.
    """
    try:
        report = json.loads(str(test.notes[REPORT_NOTE]))
    except (KeyError, ValueError) as error:
        raise UnusableInputError(f"test {test.number} holds no report of a stimulus that followed the depth") from error
    record = test.record()
    return reported_run(report, record.input, record.output - test.surface_position_m, test.sample_rate_hz, label)


def reported_run(report: Any, force: Array, depth: Array, sample_rate_hz: float, label: str) -> FeedbackRun:
    """A run of force (n,), N, and depth (n,), m, with what its stimulus reported of it.

    Raises:
        UnusableInputError: the report tells of no bins of depth.
    """
    try:
        edges = np.asarray(report["edges_m"], dtype=np.float64)
        shares = np.asarray(report["desired"], dtype=np.float64)
        profile = _profile(report.get("identification"), edges)
    except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise UnusableInputError("the stimulus did not report on a distribution of depth") from error
    if edges.ndim != 1 or shares.shape != (edges.size - 1,) or not np.all(np.diff(edges) > 0.0):
        raise UnusableInputError("the stimulus did not report on a distribution of depth")
    return FeedbackRun(label, force, depth, sample_rate_hz, edges, shares, profile)


def _profile(found: Mapping[str, Any] | None, edges: Array) -> DepthProfile | None:
    """Mass, damping and stiffness by level of depth; None where nothing was identified."""
    levels = [] if found is None else found["levels"]
    if not levels:
        return None
    columns = {name: np.array([float(level[name]) for level in levels]) for name in levels[0]}
    depth = columns["depth_m"]
    bounds = np.concatenate([edges[:1], 0.5 * (depth[1:] + depth[:-1]), edges[-1:]])
    unknown = np.full(depth.size, np.nan)
    return DepthProfile(
        position=depth,
        low=bounds[:-1],
        high=bounds[1:],
        direction=np.zeros(depth.size, dtype=np.int_),
        mass=columns["mass_kg"],
        mass_std=unknown,
        damping=columns["damping_n_s_per_m"],
        damping_std=unknown,
        stiffness=columns["stiffness_n_per_m"],
        stiffness_std=unknown,
        support=columns["samples"].astype(np.int_),
    )
