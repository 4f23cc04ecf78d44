"""Reading of the feedback report that a test stores in its session."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tissueid.analysis.curves.feedback import FeedbackRun
from tissueid.analysis.curves.plot import Array
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.messages import Message
from tissueid.sessions import Test

REPORT_NOTE = "stimulus_report"
"""Name of the note of a test that contains the report of its feedback stimulus as JSON."""
NO_DISTRIBUTION = Message("report.no_distribution", "the report of the stimulus contains no distribution of depth")


def feedback_run(test: Test, label: str) -> FeedbackRun:
    """Return a test as a run; ``label`` names it in figures.

    Raises:
        UnusableInputError: the test has no report of a feedback stimulus.
    """
    try:
        report = json.loads(str(test.notes[REPORT_NOTE]))
    except (KeyError, ValueError) as error:
        raise UnusableInputError(
            "report.no_feedback", "test {number} has no report of a feedback stimulus", number=test.number
        ) from error
    record = test.record()
    return run_from_report(report, record.input, record.output - test.surface_position_m, test.sample_rate_hz, label)


def run_from_report(report: Any, force: Array, depth: Array, sample_rate_hz: float, label: str) -> FeedbackRun:
    """Return a run of force (n,), N, and depth (n,), m, with the report of its stimulus.

    Raises:
        UnusableInputError: the report has no distribution of depth.
    """
    try:
        edges = np.asarray(report["edges_m"], dtype=np.float64)
        shares = np.asarray(report["desired"], dtype=np.float64)
        identified = report.get("identification")
        profile = _profile(identified, edges)
        block_s, memory_s = float(report.get("block_s", 0.0)), float((identified or {}).get("memory_s", 0.0))
    except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise UnusableInputError(NO_DISTRIBUTION) from error
    if not (math.isfinite(block_s) and math.isfinite(memory_s)):
        raise UnusableInputError(NO_DISTRIBUTION)
    if edges.ndim != 1 or shares.shape != (edges.size - 1,) or not np.all(np.diff(edges) > 0.0):
        raise UnusableInputError(NO_DISTRIBUTION)
    return FeedbackRun(label, force, depth, sample_rate_hz, edges, shares, profile, block_s, memory_s)


def _profile(found: Mapping[str, Any] | None, edges: Array) -> DepthProfile | None:
    """Return mass, damping and stiffness by depth level; None where nothing was identified."""
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
