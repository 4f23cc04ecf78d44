"""Summary of the tests that ``tissueid test`` ran: a table for people, keys for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.table import Table

from tissueid.acquisition.quality import quality_of
from tissueid.cli.output import table
from tissueid.formatting import fixed, grouped
from tissueid.identification.live.live_view import LiveView
from tissueid.messages import MISSING
from tissueid.procedures.depth_coverage import DepthRange, depth_range_of, kolmogorov_distance, stimulus_of
from tissueid.procedures.test_run import TestStep
from tissueid.sessions import Test
from tissueid.sessions.quality import verdict_of
from tissueid.test_settings import PROPERTIES


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
    answer |= {name: test.notes.get(name) for name in PROPERTIES}
    answer["verdict"] = verdict_of(test)
    answer["quality"] = None if quality is None else quality.as_dict()["findings"]
    if step is not None:
        answer |= {
            "kolmogorov_distance_predicted": step.predicted,
            "designed_by": step.engine,
            "vaf_held_out_percent": step.vaf_held_out_percent,
        }
    return answer


_SI = {"mass": "mass_kg", "damping": "damping_n_s_per_m", "stiffness": "stiffness_n_per_m"}


def live_answer(view: LiveView | None) -> dict[str, Any] | None:
    """Return the last live estimates of a test for JSON, SI; None without any."""
    if view is None:
        return None
    return {
        "method": view.method,
        "seconds": view.seconds,
        "vaf_percent": view.vaf_percent,
        "parameters": {_SI[name]: {"value": found.value, "std": found.std} for name, found in view.parameters.items()},
    }


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


def _millimetres(answer: dict[str, Any]) -> str:
    return f"{fixed(_thousandfold(answer['depth_min_m']), 2)} to {fixed(_thousandfold(answer['depth_max_m']), 2)}"


def _thousandfold(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


def _percent(value: float | None) -> float | None:
    return None if value is None else 100.0 * value
