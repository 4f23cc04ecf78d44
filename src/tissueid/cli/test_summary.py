"""Summary of the tests that ``tissueid test`` ran: a table for people, keys for JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from rich.table import Table

from tissueid.acquisition.quality import quality_of
from tissueid.cli.output import table
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, grouped
from tissueid.messages import MISSING, Message
from tissueid.procedures.test_run import TestStep
from tissueid.sessions import Test
from tissueid.stimuli.base import GUIDED
from tissueid.stimuli.depth_uniform import distance_from_uniform

DepthRange = tuple[float, float]


def answer_of(test: Test, asked: DepthRange | None, step: TestStep | None) -> dict[str, Any]:
    """Return one test for JSON; values that do not apply to its kind of stimulus are None."""
    depths = depth_range_of(test, asked)
    answer: dict[str, Any] = {
        "test": test.number,
        "status": test.status,
        "samples": test.samples,
        "stimulus": stimulus_of(test).get("type"),
        "depth_min_m": None if depths is None else depths[0],
        "depth_max_m": None if depths is None else depths[1],
        "kolmogorov_distance": kolmogorov_distance(test, depths),
    }
    for note in ("late_blocks", "held_samples"):
        count = test.notes.get(note)
        answer[note] = int(count) if isinstance(count, float) else None
    for note in ("generating_share", "generating_longest_s", "ended_early_s", "reason"):
        answer[note] = test.notes.get(note)
    quality = quality_of(test)
    answer["configuration"] = test.configuration
    answer["verdict"] = None if quality is None else quality.verdict
    answer["quality"] = None if quality is None else quality.as_dict()["findings"]
    if step is not None:
        answer |= {
            "kolmogorov_distance_predicted": step.predicted,
            "designed_by": step.engine,
            "vaf_held_out_percent": step.vaf_held_out_percent,
        }
    return answer


def tests_table(tests: Sequence[Test], asked: DepthRange | None) -> Table:
    """Return a table with one row per test, without empty columns."""
    answers = [answer_of(test, asked, None) for test in tests]
    columns = {
        "samples": [grouped(a["samples"]) for a in answers],
        "depth mm": [_millimetres(a) for a in answers],
        "distance from target": [fixed(a["kolmogorov_distance"], 3) for a in answers],
        "computing %": [fixed(_percent(a["generating_share"]), 1) for a in answers],
        "late blocks": [grouped(a["late_blocks"]) for a in answers],
        "held samples": [grouped(a["held_samples"]) for a in answers],
        "quality": [a["verdict"] or MISSING for a in answers],
    }
    needs = {
        "depth mm": "depth_min_m",
        "distance from target": "kolmogorov_distance",
        "computing %": "generating_share",
        "late blocks": "late_blocks",
        "held samples": "held_samples",
        "quality": "verdict",
    }
    shown = [name for name in columns if name not in needs or any(a[needs[name]] is not None for a in answers)]
    rows = table("Tests", "test", "stimulus", "status", *shown)
    for k, answer in enumerate(answers):
        rows.add_row(
            str(answer["test"]), str(answer["stimulus"]), answer["status"], *(columns[name][k] for name in shown)
        )
    return rows


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


def _millimetres(answer: dict[str, Any]) -> str:
    return f"{fixed(_thousandfold(answer['depth_min_m']), 2)} to {fixed(_thousandfold(answer['depth_max_m']), 2)}"


def _thousandfold(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


def _percent(value: float | None) -> float | None:
    return None if value is None else 100.0 * value
