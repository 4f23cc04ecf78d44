"""``tissueid import`` and ``tissueid export``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tissueid.cli.audit_records import audit_note
from tissueid.cli.output import check_json, human_output, messages_json, progress_bars, table, write_json
from tissueid.configuration import CONFIGURATIONS
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean, number
from tissueid.procedures.output_files import check_different
from tissueid.sessions import KINDS, Test, read_session
from tissueid.sessions.imports import (
    Choices,
    Imported,
    Source,
    check_new_session,
    export_session,
    import_session,
    instrument_figures,
    parse_map,
)

_T = TypeVar("_T")


@dataclass(frozen=True)
class ImportPlan:
    """Options of an import. Options of tests are given once for all tests, or once for each."""

    files: tuple[str, ...]
    out: Path
    mapping: tuple[str, ...]
    rate_hz: float | None
    resample_hz: float | None
    kinds: tuple[str, ...]
    sites: tuple[str, ...]
    configurations: tuple[str, ...]
    preloads_s: tuple[float, ...]
    surfaces_m: tuple[float, ...]
    subject: str | None
    instrument: tuple[str, ...]
    json_file: Path | None

    def choices(self) -> list[Choices]:
        """Return the options of every test.

        Raises:
            UnusableInputError: their number is wrong, or a value is not valid.
        """
        for word, known in (
            *((k, KINDS) for k in self.kinds),
            *((c, tuple(CONFIGURATIONS)) for c in self.configurations),
        ):
            if word not in known:
                raise UnusableInputError(f"{word!r} is not known: choose one of {', '.join(known)}")
        for text in (*self.sites, *self.instrument, self.subject or ""):
            if not text.isprintable():
                raise UnusableInputError(f"{clean(text)!r} contains characters that cannot be printed")
        for seconds in self.preloads_s:
            if not 0.0 <= seconds < math.inf:
                raise UnusableInputError(f"--preload must be 0 s or more, got {seconds:g}")
        for metres in self.surfaces_m:
            if not math.isfinite(metres):
                raise UnusableInputError(f"--surface must be a position in m, got {metres:g}")
        columns = (
            self._each("--kind", self.kinds),
            self._each("--site", self.sites),
            self._each("--configuration", self.configurations),
            self._each("--preload", self.preloads_s),
            self._each("--surface", self.surfaces_m),
        )
        return [Choices(*row) for row in zip(*columns, strict=True)]

    def _each(self, option: str, values: Sequence[_T]) -> list[_T | None]:
        tests = len(self.files)
        if len(values) not in (0, 1, tests):
            raise UnusableInputError(
                f"{option} is given {len(values)} times: give it once, or once for each of the {tests} tests"
            )
        return [None] * tests if not values else [values[k if len(values) > 1 else 0] for k in range(tests)]


def run_import(plan: ImportPlan) -> None:
    """Read and check all files, write the session, and print a summary with warnings."""
    check_json(plan.json_file)
    check_different(plan.out, plan.json_file)
    check_new_session(plan.out)
    for option, rate in (("--rate", plan.rate_hz), ("--resample", plan.resample_hz)):
        if rate is not None and not 1e-6 <= rate <= 1e9:
            raise UnusableInputError(f"{option} must be a rate in Hz above 0, got {rate:g}")
    wanted = parse_map(plan.mapping) if plan.mapping else None
    figures = instrument_figures(plan.instrument)
    choices = plan.choices()
    with progress_bars() as progress:
        made = import_session(
            [Source.parsed(file) for file in plan.files],
            wanted,
            choices,
            plan.out,
            figures=figures,
            pseudonym=plan.subject,
            rate_hz=plan.rate_hz,
            resample_hz=plan.resample_hz,
            progress=progress,
        )
    session, imported, notices = made.session, made.tests, made.notices
    audit_note(
        "researcher",
        "session.imported",
        subject=session.session_id,
        new={"tests": len(session.tests), "samples": sum(test.samples for test in session.tests)},
    )
    tests = [_answer(item, test) for item, test in zip(imported, session.tests, strict=True)]
    _print_result(plan, tests, notices)
    if plan.json_file is not None:
        answer: dict[str, Any] = {
            "session": str(plan.out),
            "session_id": session.session_id,
            "tests": tests,
            "notices": list(notices),
        }
        answer["notice_messages"] = messages_json(notices)
        write_json(plan.json_file, answer)


def _answer(item: Imported, test: Test) -> dict[str, Any]:
    """Return the summary of one test for JSON."""
    signals = {}
    for column in item.columns:
        values = test.signals[column.role]
        some = bool(np.isfinite(values).any())
        signals[column.role] = {
            "column": column.header,
            "unit": column.unit.symbol,
            "si_unit": column.unit.si,
            "missing": int(np.isnan(values).sum()),
            "minimum": float(np.nanmin(values)) if some else None,
            "maximum": float(np.nanmax(values)) if some else None,
        }
    return {
        "test": test.number,
        "file": str(item.source.path),
        "format": item.format,
        "rows": [item.rows.start, item.rows.stop],
        "kind": test.kind,
        "site": test.site,
        "samples": test.samples,
        "sample_rate_hz": test.sample_rate_hz,
        "signals": signals,
        "notices": list(item.notices),
        "notice_messages": messages_json(item.notices),
    }


def _print_result(plan: ImportPlan, tests: Sequence[dict[str, Any]], notices: Sequence[str]) -> None:
    out = human_output(plan.json_file)
    if not out.is_terminal:
        out.width = 120
    rows = table(
        str(plan.out), "test", "kind", "samples", "rate Hz", "signal", "column", "unit", "from", "to", "missing"
    )
    for test in tests:
        first = [str(test["test"]), test["kind"], str(test["samples"]), number(test["sample_rate_hz"], 6)]
        for name, signal in test["signals"].items():
            ends = (number(signal["minimum"]), number(signal["maximum"]), str(signal["missing"]))
            rows.add_row(*first, name, clean(signal["column"]), signal["si_unit"], *ends)
            first = [""] * 4
    out.print(rows)
    for test in tests:
        for notice in test["notices"]:
            out.print(f"test {test['test']}: {notice}", markup=False, soft_wrap=True)
    for notice in notices:
        out.print(notice, markup=False, soft_wrap=True)


def run_export(path: Path, folder: Path, kind: str, json_file: Path | None) -> None:
    """Export a session and print the names of the files."""
    check_json(json_file)
    check_different(folder, json_file)
    session = read_session(path)
    with progress_bars() as progress:
        files = export_session(session, folder, kind, lambda share: progress("exporting", share))
    audit_note(
        "researcher", "session.exported", subject=session.session_id, new={"tests": len(session.tests), "format": kind}
    )
    out = human_output(json_file)
    out.print(f"{folder} contains {len(session.tests)} test(s), each with its attributes in JSON:", markup=False)
    for test, name in zip(session.tests, files[::2], strict=True):
        out.print(f"  {name}: {test.kind}, {test.samples} samples", markup=False)
    if json_file is not None:
        answer = {"folder": str(folder), "format": kind, "session_id": session.session_id, "files": files}
        write_json(json_file, answer)
