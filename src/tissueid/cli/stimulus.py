"""``tissueid stimulus``: list kinds, design a stimulus, or check a saved one."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from tissueid.acquisition.stimulus_choice import PRELOAD_S
from tissueid.acquisition.stimulus_file import checksum, load_stimulus, save_stimulus
from tissueid.analysis.design import Design
from tissueid.cli.output import ConsoleControl, human_output, message_json, progress_bars, write_json
from tissueid.cli.stimulus_options import (
    CommonOptions,
    kinds_answer,
    kinds_table,
    options_answer,
    options_table,
)
from tissueid.cli.stimulus_output import CSV_HEAD, Targets, draw, rows_table
from tissueid.device import DeviceDescription
from tissueid.errors import LimitError, UnusableInputError
from tissueid.instrument import PROFILES, Limits
from tissueid.procedures.instrument_queries import described_device
from tissueid.procedures.output_files import write_text
from tissueid.procedures.plan_options import name_and_value
from tissueid.procedures.stimulus_design import design_stimulus
from tissueid.procedures.test_plan import specified
from tissueid.stimuli import FeedbackKind, OpenLoopKind, Stimulus, StimulusKind, get_stimulus, to_voltage
from tissueid.stimuli.interchange import InterchangeResult
from tissueid.stimuli.stimulus_check import StimulusCheck, assess_stimulus


def run_stimulus(
    what: str | None,
    common: CommonOptions,
    options: Sequence[str],
    list_options: bool,
    targets: Targets,
    url: str | None,
    limits_name: str,
) -> None:
    """List kinds or options; or design or read a stimulus, check it, print it and write the requested files."""
    if limits_name not in PROFILES:
        raise UnusableInputError(f"--limits must be {' or '.join(PROFILES)}, got {limits_name!r}")
    targets.check()
    out = human_output(targets.json)
    if not out.is_terminal:
        out.width = 120
    if what is None or list_options:
        _refuse_extras(common, options, targets)
        _list(what, targets.json, out)
        return
    limits = PROFILES[limits_name]
    if _is_file(what):
        if options or common.given():
            raise UnusableInputError(f"{what} is a saved stimulus and contains its options: leave out other options")
        chosen: Stimulus | StimulusKind = load_stimulus(Path(what))
    else:
        given = common.given()
        if {"force_min_n", "force_max_n"} & given.keys() and {"voltage_min_v", "voltage_max_v"} & given.keys():
            raise UnusableInputError("give the range either as force or as voltage")
        chosen = specified(get_stimulus(what), [name_and_value(option) for option in options], given)
    if isinstance(chosen, FeedbackKind):
        from tissueid.cli.stimulus_feedback import show_feedback

        show_feedback(chosen, url, limits, targets, out)
    elif isinstance(chosen, Stimulus):
        show_open_loop(chosen, None, described_device(url), limits, targets, out)
    elif isinstance(chosen, OpenLoopKind):
        device = described_device(url)
        with progress_bars() as show:
            built, search = design_stimulus(chosen, ConsoleControl(show))
        show_open_loop(built, search, device, limits, targets, out)
    else:
        raise UnusableInputError(f"the stimulus {what!r} can be neither built nor generated")


def _is_file(what: str) -> bool:
    return what.lower().endswith(".json") or "/" in what or Path(what).is_file()


def _refuse_extras(common: CommonOptions, options: Sequence[str], targets: Targets) -> None:
    if options or common.given() or targets.out or targets.csv or targets.plot:
        raise UnusableInputError("name a stimulus; 'tissueid stimulus' lists all")


def _list(kind: str | None, json_file: Path | None, out: Console) -> None:
    if kind is None:
        out.print(kinds_table())
        out.print("'tissueid stimulus KIND --options' lists the options of a kind.", style="dim")
        answer: Any = kinds_answer()
    else:
        out.print(options_table(get_stimulus(kind)))
        out.print("Lists are JSON, such as --option 'notches=[[45, 55]]'.", style="dim")
        answer = options_answer(get_stimulus(kind))
    if json_file is not None:
        write_json(json_file, answer)


def show_open_loop(
    stimulus: Stimulus,
    search: InterchangeResult | None,
    device: DeviceDescription,
    limits: Limits,
    targets: Targets,
    out: Console,
) -> None:
    """Check a stimulus, print it and write the requested files.

    Raises:
        LimitError: the instrument would refuse the stimulus.
    """
    found = assess_stimulus(
        stimulus,
        device,
        max_force_n=limits.max_force_n,
        max_seconds=limits.max_seconds - (0.0 if stimulus.preload_s else PRELOAD_S),
        max_temperature_c=limits.max_temperature_c,
    )
    for concern in found.concerns:
        if concern.severity == "refused":
            said = concern.words.rstrip(".")
            raise LimitError(f"the instrument would refuse this stimulus: {said[:1].lower()}{said[1:]}")
    design = Design(stimulus, device, found, search)
    out.print(rows_table(f"Stimulus {design.specification.name}", design.rows()))
    for concern in found.concerns:
        out.print(f"{concern.severity}: {concern.words}", markup=False)
    if targets.plot is not None:
        from tissueid.reports.stimulus_report import stimulus_report

        draw(targets.plot, stimulus_report(design))
    if targets.csv is not None:
        write_text(targets.csv, _csv(stimulus, device))
    if targets.out is not None:
        save_stimulus(targets.out, stimulus)
    targets.print_files(out)
    if targets.json is not None:
        write_json(targets.json, _answer(stimulus, found) | design.answer())


def _csv(stimulus: Stimulus, device: DeviceDescription) -> str:
    """Return time, value and command of every sample as CSV, with numbers at full precision."""
    command = to_voltage(stimulus.values, device, stimulus.unit)
    quantity = "force_n" if stimulus.unit == "N" else "voltage_v"
    text = io.StringIO()
    text.write(f"{CSV_HEAD}{quantity},command_v\n")
    time_s = np.arange(len(stimulus)) / stimulus.sample_rate_hz
    for row in zip(time_s.tolist(), stimulus.values.tolist(), command.tolist(), strict=True):
        text.write(f"{row[0]:.9g},{row[1]!r},{row[2]!r}\n")
    return text.getvalue()


def _answer(stimulus: Stimulus, found: StimulusCheck) -> dict[str, Any]:
    return {
        "description": stimulus.description,
        "samples": len(stimulus),
        "sample_rate_hz": stimulus.sample_rate_hz,
        "unit": stimulus.unit,
        "sha256": checksum(stimulus),
        "seconds": found.seconds,
        "force_min_n": found.force_min_n,
        "force_max_n": found.force_max_n,
        "voltage_min_v": found.voltage_min_v,
        "voltage_max_v": found.voltage_max_v,
        "force_mean_n": found.force_mean_n,
        "force_std_n": found.force_std_n,
        "crest_factor": found.crest_factor,
        "power_95_hz": found.power_95_hz,
        "power_99_hz": found.power_99_hz,
        "steepest_edge_n_per_s": found.steepest_edge_n_per_s,
        "edge_ratio": found.edge_ratio,
        "rms_current_a": found.rms_current_a,
        "peak_current_a": found.peak_current_a,
        "heating_expected_k": found.heating.expected_k,
        "heating_least_k": found.heating.least_k,
        "heating_most_k": found.heating.most_k,
        "heating_bound_k": found.heating.bound_k,
        "concerns": [
            {"severity": concern.severity, "words": concern.words, "message": message_json(concern.words)}
            for concern in found.concerns
        ],
    }
