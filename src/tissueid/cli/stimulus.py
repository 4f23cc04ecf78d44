"""``tissueid stimulus``: list kinds, design a stimulus, or check a saved one."""

from __future__ import annotations

import json
import re
import types
from collections.abc import Iterable
from typing import Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from rich.table import Table

from tissueid.acquisition.stimulus_choice import checksum
from tissueid.analysis.stimulus_design import StimulusDesign
from tissueid.cli.output import Output, table
from tissueid.messages import stored
from tissueid.plan_options import bounds_of
from tissueid.procedures.output_files import check_different
from tissueid.procedures.stimulus_design import FeedbackTrial, StimulusPlan, run_stimulus
from tissueid.reports.stimulus_page import REPORT_NOTE
from tissueid.stimuli import FeedbackKind, StimulusKind, get_stimulus, stimulus_names

_SOURCE = re.compile(r"\s*\([^()]*\d{4}[^()]*\)")
_WORDS = {float: "number", int: "whole number", bool: "true or false", str: "text", tuple: "list"}


def summary(kind: type[StimulusKind]) -> str:
    """Return the first line of the description of a kind, without sources."""
    lines = (kind.__doc__ or "").strip().splitlines()
    return _SOURCE.sub("", lines[0]).rstrip(".") if lines else ""


def default_of(field: FieldInfo) -> str:
    """Return the default of an option as text."""
    if field.default is PydanticUndefined:
        return "required"
    if field.default is None or field.default == ():
        return "none"
    return f"{field.default:g}" if isinstance(field.default, float) else str(field.default).lower()


def allowed(field: FieldInfo) -> str:
    """Return the choices of an option, or its type with bounds, as text."""
    choices, kinds = _choices(field.annotation)
    if choices:
        return ", ".join(choices)
    bounds, shown = bounds_of(field), [" or ".join(kinds)]
    if bounds.least is not None:
        shown.append(f"over {_short(bounds.least)}" if bounds.least_open else f"{_short(bounds.least)} or more")
    if bounds.most is not None:
        shown.append(f"{'under' if bounds.most_open else 'up to'} {_short(bounds.most)}")
    return ", ".join(shown)


def _short(value: float) -> str:
    if isinstance(value, int) and value == 2**63 - 1:
        return "2⁶³ − 1"
    return f"{value:g}"


def _choices(annotation: Any) -> tuple[list[str], list[str]]:
    """Return the choices of a literal type, and the names of other types."""
    origin = get_origin(annotation)
    if origin is Literal:
        return [str(choice) for choice in get_args(annotation)], []
    if origin in (Union, types.UnionType):
        parts = [_choices(part) for part in get_args(annotation) if part is not type(None)]
        return [choice for choices, _ in parts for choice in choices], [kind for _, kinds in parts for kind in kinds]
    plain = origin if isinstance(origin, type) else annotation
    return [], [_WORDS.get(plain, "value")]


def print_stimulus(plan: StimulusPlan, out: Output) -> None:
    """List kinds or options; or design or read a stimulus, check it, print it and write the requested files.

    Raises:
        UnusableInputError: the kind, an option, the device or a file cannot be used.
        LimitError: the instrument would refuse the stimulus.
    """
    check_different(*plan.outputs, out.json_file)
    out.widen(120)
    if plan.lists:
        plan.check()
        answer = _list(plan.what, out)
    else:
        made = out.run(run_stimulus, plan)
        if isinstance(made, FeedbackTrial):
            out.print(_table(f"Stimulus {made.kind.name} on {made.url}", made.rows()))
            answer = _trial_answer(made)
        else:
            answer = _print_design(made, out)
        out.print_files(saved=plan.out, samples=plan.csv, plot=plan.plot)
    out.write_json(answer)


def _list(kind: str | None, out: Output) -> Any:
    """Print all kinds, or the options of one; return them for JSON."""
    if kind is None:
        kinds = {name: get_stimulus(name) for name in stimulus_names()}
        answer = [
            {
                "kind": name,
                "what": summary(model),
                "generated_while_the_test_runs": issubclass(model, FeedbackKind),
                "options": list(model.model_fields),
            }
            for name, model in kinds.items()
        ]
        rows = [
            (name, f"{'during' if issubclass(model, FeedbackKind) else 'before'} the test", summary(model))
            for name, model in kinds.items()
        ]
        out.print(table("Kinds of stimulus", "kind", "generated", "description", rows=rows, left_aligned=True))
        out.print("'tissueid stimulus KIND --options' lists the options of a kind.", style="dim")
        return answer
    chosen = get_stimulus(kind)
    fields = chosen.model_fields.items()
    options = [(name, default_of(field), allowed(field), field.description or "") for name, field in fields]
    columns = ("option", "default", "values", "description")
    out.print(table(f"Options of the stimulus {chosen.name}", *columns, rows=options, left_aligned=True))
    out.print("Lists are JSON, such as --option 'notches=[[45, 55]]'.", style="dim")
    return chosen.model_json_schema()


def _print_design(design: StimulusDesign, out: Output) -> dict[str, Any]:
    """Print a stimulus and its check; return them for JSON."""
    out.print(_table(f"Stimulus {design.specification.name}", design.rows()))
    out.print_lines(f"{concern.severity}: {concern.message}" for concern in design.appraisal.concerns)
    stimulus, appraisal = design.stimulus, design.appraisal
    return {
        "description": stimulus.description,
        "samples": len(stimulus),
        "sample_rate_hz": stimulus.sample_rate_hz,
        "unit": stimulus.unit,
        "sha256": checksum(stimulus),
        "seconds": appraisal.seconds,
        "force_min_n": appraisal.force_min_n,
        "force_max_n": appraisal.force_max_n,
        "voltage_min_v": appraisal.voltage_min_v,
        "voltage_max_v": appraisal.voltage_max_v,
        "force_mean_n": appraisal.force_mean_n,
        "force_std_n": appraisal.force_std_n,
        "crest_factor": appraisal.crest_factor,
        "power_95_hz": appraisal.power_95_hz,
        "power_99_hz": appraisal.power_99_hz,
        "steepest_edge_n_per_s": appraisal.steepest_edge_n_per_s,
        "edge_ratio": appraisal.edge_ratio,
        "rms_current_a": appraisal.rms_current_a,
        "peak_current_a": appraisal.peak_current_a,
        "heating_expected_k": appraisal.heating.expected_k,
        "heating_least_k": appraisal.heating.least_k,
        "heating_most_k": appraisal.heating.most_k,
        "heating_bound_k": appraisal.heating.bound_k,
        "concerns": [
            {"severity": concern.severity, "words": concern.message, "message": stored(concern.message)}
            for concern in appraisal.concerns
        ],
    } | design.answer()


def _table(title: str, rows: Iterable[tuple[str, str]]) -> Table:
    return table(title, "quantity", "value", rows=rows, left_aligned=True)


def _trial_answer(trial: FeedbackTrial) -> dict[str, Any]:
    test, run = trial.test, trial.run
    return {
        "description": trial.kind.describe(),
        "device": trial.url,
        "samples": int(run.force.size),
        "sample_rate_hz": run.sample_rate_hz,
        "unit": "N",
        "kolmogorov_distance": run.distance,
        "generating_share": trial.note("generating_share"),
        "generating_longest_s": trial.note("generating_longest_s"),
        "late_blocks": trial.note("late_blocks"),
        "report": json.loads(str(test.notes[REPORT_NOTE])),
        "depth_profile": None if run.profile is None else run.profile.as_rows(),
    }
