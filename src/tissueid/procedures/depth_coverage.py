"""Depth of a recorded test against its target: intended range, reached range, distance of the distributions."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.sessions import Test
from tissueid.stimuli.base import GUIDED
from tissueid.stimuli.depth_uniform import distance_from_uniform

DepthRange = tuple[float, float]
"""Least and greatest depth, m."""


def stimulus_of(test: Test) -> dict[str, Any]:
    """Return the description of the stimulus of a test, without its preload."""
    fields = test.stimulus
    while fields.get("type") == GUIDED and isinstance(fields.get("stimulus"), dict):
        fields = fields["stimulus"]
    return fields


def depth_range_of(test: Test, asked: DepthRange | None) -> DepthRange | None:
    """Return the intended depth range of a test, m: as designed, or as requested; None if neither is known."""
    for source in (test.notes, stimulus_of(test)):
        least, most = source.get("depth_min_m"), source.get("depth_max_m")
        if isinstance(least, float) and isinstance(most, float):
            return least, most
    return asked


def out_of_reach(test: Test) -> str:
    """Return which part of the requested depths a test was not designed for as a sentence, or ""."""
    notes = test.notes
    if reachable := _reported(test).get("reachable_m"):
        return _short_of(depth_range_of(test, None), reachable)
    if "depth_asked_min_m" not in notes or "depth_min_m" not in notes:
        return ""
    asked, designed = ((notes[f"{name}_min_m"], notes[f"{name}_max_m"]) for name in ("depth_asked", "depth"))
    if asked == designed:
        return ""
    return Message(
        "test.designed_for",
        "designed for {low:.2f} to {high:.2f} mm of the requested {asked_low:.2f} to {asked_high:.2f} mm: this range "
        "of force does not cover more",
        low=1e3 * float(designed[0]),
        high=1e3 * float(designed[1]),
        asked_low=1e3 * float(asked[0]),
        asked_high=1e3 * float(asked[1]),
    )


def _short_of(asked: DepthRange | None, reachable: Sequence[float]) -> str:
    """Return which part of the requested depths the forces reach as a sentence; "" if they reach all of it."""
    if asked is None:
        return ""
    least, most = max(asked[0], reachable[0]), min(asked[1], reachable[1])
    if most - least >= 0.99 * (asked[1] - asked[0]):
        return ""
    wanted = {"asked_low": 1e3 * asked[0], "asked_high": 1e3 * asked[1]}
    if most <= least:
        return Message(
            "test.reaches_none",
            "this range of force reaches none of the requested {asked_low:.2f} to {asked_high:.2f} mm: choose other "
            "depths",
            **wanted,
        )
    return Message(
        "test.reaches_part",
        "of the requested {asked_low:.2f} to {asked_high:.2f} mm, this range of force reaches {low:.2f} to "
        "{high:.2f} mm",
        low=1e3 * least,
        high=1e3 * most,
        **wanted,
    )


def _reported(test: Test) -> dict[str, Any]:
    """Return the report of a feedback stimulus; empty if there is none."""
    report = test.notes.get("stimulus_report")
    said = json.loads(report) if isinstance(report, str) else {}
    return said if isinstance(said, dict) else {}


def kolmogorov_distance(test: Test, depths: DepthRange | None) -> float | None:
    """Return Kolmogorov's distance of the depth from its target: as reported by the stimulus, or from uniform.

    None if the target is not uniform and the stimulus reports nothing.
    """
    said = _reported(test).get("kolmogorov_distance")
    if isinstance(said, float):
        return said
    described = stimulus_of(test)
    even = "depth_min_m" not in described or described.get("distribution", "uniform") == "uniform"
    if depths is None or not even:
        return None
    try:
        return distance_from_uniform(test.record().output - test.surface_position_m, *depths)
    except UnusableInputError:
        return None
