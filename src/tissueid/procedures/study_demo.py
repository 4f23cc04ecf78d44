"""A simulated population as in the studies of the thesis (Chen 2010, chapter 7), measured, analysed and reported."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from tissueid.atomic_write import private_folder
from tissueid.errors import UnusableInputError
from tissueid.extras import check_packages
from tissueid.gap.workers import executor
from tissueid.instrument import Instrument, SimulatedInstrument
from tissueid.language import marked
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control, CountedProgress
from tissueid.procedures.output_files import json_text, stored_values, write_text
from tissueid.procedures.simulated_population import (
    LOTION_MINUTES,
    LOTION_SITE,
    LOTIONS,
    MATERIAL_TESTS,
    MATERIALS,
    SITES,
    population,
    sample_name,
    subjects_file,
)
from tissueid.procedures.study_plans import SUBJECTS_FILE, StudyReportPlan
from tissueid.procedures.study_report import StudyReport, report_study
from tissueid.procedures.test_plan import TestPlan
from tissueid.procedures.test_run import TestControl, run_test
from tissueid.sessions.file_policy import journal_path

_MEASURING = marked("Measuring the simulated population")
_MARK, _MADE_BY = "population.json", "tissueid study demo"
_OPTIONS = ("subjects", "repeats", "seconds", "seed", "products")
"""Options on which the sessions depend."""
MARGIN = 0.1
"""Relative margin of equivalence of the lotions, chosen."""


class PopulationPlan(Plan):
    """A simulated population and the folder of its study."""

    out: Annotated[Path, Option("--out", metavar="FOLDER", help="new folder of the study")]
    subjects: Annotated[int, Option("--subjects", metavar="N", help="number of subjects"), Field(ge=2, le=200)] = 16
    repeats: Annotated[int, Option("--repeats", metavar="N", help="tests at each site"), Field(ge=2, le=20)] = 5
    seconds: Annotated[
        float, Option("--seconds", metavar="S", help="length of each test without its preload"), Field(ge=1.0, le=30.0)
    ] = 4.0
    seed: Annotated[int, Option("--seed", metavar="N", help="seed of the population"), Field(ge=0, lt=2**31)] = 0
    products: Annotated[bool, Option(help="also measure materials, and two lotions on each subject")] = True
    workers: Annotated[
        int | None,
        Option("--workers", metavar="N", help="number of processes; default: one per processor"),
        Field(ge=1, le=256),
    ] = None


@dataclass(frozen=True)
class Series:
    """Repeated tests of one subject or sample at one site: pseudonym, site, seed of the instrument, and condition."""

    subject: str
    site: str
    seed: int
    condition: str = ""


def run_population(plan: PopulationPlan, control: Control) -> StudyReport:
    """Measure a simulated population by guided tests, analyse the sessions and write the report.

    Raises:
        UnusableInputError: the folder holds anything else or cannot be made, or a package is missing.
        CancelledError: it was cancelled; the finished sessions are kept.
    """
    check_packages("pandas", "pyarrow", "statsmodels", "sklearn")
    measure_population(plan, control)
    report = StudyReportPlan(folder=plan.out, workers=plan.workers, margin=MARGIN, pdf=plan.out / "report.pdf")
    return report_study(report, control)


def measure_population(plan: PopulationPlan, control: Control) -> None:
    """Measure a simulated population by guided tests.

    In the folder of an interrupted population with the same options, only the missing sessions are measured.

    Raises:
        UnusableInputError: the folder holds anything else or cannot be made.
        CancelledError: it was cancelled; the finished sessions are kept.
    """
    _take_folder(plan)
    people = population(plan.subjects, plan.seed)
    write_text(plan.out / SUBJECTS_FILE, subjects_file(people, MATERIALS if plan.products else ()))
    series = [Series(person.pseudonym, site, person.seed(site)) for person in people for site in SITES]
    if plan.products:
        series += [
            Series(person.pseudonym, LOTION_SITE, person.seed(LOTION_SITE) + 10 + number, lotion)
            for person in people
            for number, lotion in enumerate(LOTIONS)
        ]
        series += [Series(sample_name(name), name, number, "") for number, name in enumerate(MATERIALS)]
    series = [one for one in series if not session_path(plan, one).exists()]
    if series:
        done = CountedProgress(control, _MEASURING, len(series))
        with executor(plan.workers) as pool:
            pool.do(functools.partial(measure_series, plan), series, control.check, done)


def measure_series(plan: PopulationPlan, series: Series) -> Path:
    """Run the tests of one series on a simulated instrument; return the session file.

    A series that was interrupted leaves no session file, so that it is measured again.

    Raises:
        UnusableInputError: the session cannot be written.
    """
    variation: float | None = None
    if series.site in MATERIALS:
        tissue, repeats = MATERIALS[series.site], MATERIAL_TESTS
    else:
        person = next(who for who in population(plan.subjects, plan.seed) if who.pseudonym == series.subject)
        # With a variation, the first test compresses the skin lastingly, which the later ones meet (Fig. 7.4).
        tissue, repeats, variation = person.tissue(series.site, series.condition), plan.repeats, 1.0

    def opened(_address: str) -> Instrument:
        return SimulatedInstrument(tissue, seed=series.seed, variation=variation)

    test = TestPlan(
        url="simulated://forearm",
        site=series.site,
        out=session_path(plan, series),
        subject=series.subject,
        repeats=repeats,
        place_again=True,  # the compression of the skin by the first test shows only against its present surface
        seconds=plan.seconds,  # and the stimulus of the guided test, which is one for all subjects (thesis 7.1.1)
        calibration=False,
        condition=series.condition,
        minutes_since_application=LOTION_MINUTES if series.condition else None,
    )
    journal_path(test.out).unlink(missing_ok=True)  # of a process that was ended
    outcome = run_test(test, TestControl(), None, opener=opened)
    if outcome.error is not None:
        test.out.unlink(missing_ok=True)
        raise outcome.error
    if outcome.not_saved is not None:
        raise outcome.not_saved
    return test.out


def session_path(plan: PopulationPlan, series: Series) -> Path:
    """Return the session file of a series."""
    return plan.out / f"{' '.join(filter(None, (series.subject, series.site, series.condition)))}.h5"


def _take_folder(plan: PopulationPlan) -> None:
    """Make the folder and mark it as one of a population with these options.

    Raises:
        UnusableInputError: it is a file, or holds anything but such a population.
    """
    mark = {"made_by": _MADE_BY, "options": plan.model_dump(mode="json", include=set(_OPTIONS))}
    if plan.out.exists() and (not plan.out.is_dir() or any(plan.out.iterdir())):
        found = stored_values(plan.out / _MARK)
        if found.get("made_by") != _MADE_BY:
            raise UnusableInputError(
                "study.folder_used",
                "{folder} exists and is neither empty nor the folder of an earlier 'study demo'",
                folder=str(plan.out),
            )
        if found != mark:
            raise UnusableInputError(
                "study.other_population",
                "{folder} holds a simulated population with other options; give the same ones, or another folder",
                folder=str(plan.out),
            )
        return
    private_folder(plan.out)
    write_text(plan.out / _MARK, json_text(mark))
