"""``tissueid stimulus`` for feedback stimuli: the loop is closed on a simulated tissue."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from rich.console import Console

from tissueid.acquisition.stimulus_file import save_stimulus
from tissueid.cli.output import console_control, write_json
from tissueid.cli.stimulus_output import Targets, draw, rows_table
from tissueid.cli.test_summary import out_of_reach
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, grouped
from tissueid.instrument import Limits
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.procedures.simulated_feedback import play_on_tissue
from tissueid.reports.feedback_figures import FeedbackRun
from tissueid.reports.feedback_run import REPORT_NOTE, feedback_run
from tissueid.reports.stimulus_report import feedback_report
from tissueid.sessions import Test
from tissueid.stimuli import FeedbackKind

_TISSUE = f"{IN_PROCESS}baseline?seed=0"


def show_feedback(kind: FeedbackKind, url: str | None, limits: Limits, targets: Targets, out: Console) -> None:
    """Run the stimulus on a simulated tissue, print the result and write the requested files.

    Raises:
        UnusableInputError: a real instrument was named, or samples as text were requested.
        LimitError: the stimulus could exceed the limits of the instrument, or did.
    """
    url = url or _TISSUE
    if targets.csv is not None:
        raise UnusableInputError(f"the feedback stimulus {kind.name} has no samples before its test: leave out --csv")
    with console_control() as control:
        test = play_on_tissue(kind, url, limits, control)
    run = feedback_run(test, url.removeprefix(IN_PROCESS))
    out.print(rows_table(f"Stimulus {kind.name} on {url}", tuple(_rows(test, run))))
    if targets.plot is not None:
        draw(targets.plot, feedback_report(kind, [run], tuple(_rows(test, run))))
    if targets.out is not None:
        save_stimulus(targets.out, kind)
    targets.print_files(out)
    if targets.json is not None:
        write_json(targets.json, _answer(kind, test, run, url))


def _rows(test: Test, run: FeedbackRun) -> Iterator[tuple[str, str]]:
    force, depth = run.force, run.depth
    yield "Length", f"{fixed(force.size / run.sample_rate_hz, 2)} s"
    yield "Range of force", f"{fixed(float(force.min()), 2)} to {fixed(float(force.max()), 2)} N"
    yield "Range of depth", f"{fixed(1e3 * float(depth.min()), 2)} to {fixed(1e3 * float(depth.max()), 2)} mm"
    yield (
        "Desired range of depth",
        f"{fixed(1e3 * float(run.edges[0]), 2)} to {fixed(1e3 * float(run.edges[-1]), 2)} mm",
    )
    if short := out_of_reach(test):
        yield "Reachable depth", short
    yield "Distance of depth from the desired distribution", fixed(run.distance, 3)
    yield "Computing time relative to test time", f"{fixed(100.0 * _note(test, 'generating_share'), 1)} %"
    yield "Late blocks", grouped(_note(test, "late_blocks"))


def _note(test: Test, name: str) -> float:
    value = test.notes.get(name, float("nan"))
    return float(value)


def _answer(kind: FeedbackKind, test: Test, run: FeedbackRun, url: str) -> dict[str, Any]:
    return {
        "description": kind.describe(),
        "device": url,
        "samples": int(run.force.size),
        "sample_rate_hz": run.sample_rate_hz,
        "unit": "N",
        "kolmogorov_distance": run.distance,
        "generating_share": _note(test, "generating_share"),
        "generating_longest_s": _note(test, "generating_longest_s"),
        "late_blocks": _note(test, "late_blocks"),
        "report": json.loads(str(test.notes[REPORT_NOTE])),
        "depth_profile": None if run.profile is None else run.profile.as_rows(),
    }
