"""A simulated population as in the studies of the thesis (Chen 2010, 7.1.1), measured, analysed and reported."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from tissueid.atomic_write import private_folder
from tissueid.errors import UnusableInputError
from tissueid.extras import check_packages
from tissueid.gap.workers import executor
from tissueid.instrument import Instrument, SimulatedInstrument
from tissueid.instrument.tissues import TISSUES
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.procedures.control import Control, CountedProgress
from tissueid.procedures.output_files import write_text
from tissueid.procedures.plan_options import Option, Plan
from tissueid.procedures.study_plans import SUBJECTS_FILE, StudyReportPlan
from tissueid.procedures.study_report import StudyReport, report_study
from tissueid.procedures.test_plan import TestPlan
from tissueid.procedures.test_run import TestControl, run_test

SITES: Mapping[str, str] = {
    "right posterior forearm": "forearm",
    "right anterior forearm": "anterior-forearm",
    "left posterior forearm": "forearm",
    "left anterior forearm": "anterior-forearm",
}
"""Sites in the order of the thesis, and their simulated tissues."""
_MEASURING = marked("Measuring the simulated population")
HEAVIER_MALE = 1.15
"""Mass of the tissue at the anterior sites of males relative to females, chosen (Fig. 7.5)."""
HEAVIER_PER_BMI = 0.03
"""Relative change of the mass at the anterior sites for 1 kg/m² of body mass index, chosen (Fig. 7.6)."""
MEAN_BMI = 23.0


class PopulationPlan(Plan):
    """A simulated population and the folder of its study."""

    out: Annotated[Path, Option("--out", metavar="FOLDER", help="new folder of the study")]
    subjects: Annotated[int, Option("--subjects", metavar="N", help="number of subjects"), Field(ge=2, le=200)] = 16
    repeats: Annotated[int, Option("--repeats", metavar="N", help="tests at each site"), Field(ge=2, le=20)] = 5
    seconds: Annotated[
        float, Option("--seconds", metavar="S", help="length of each test without its preload"), Field(ge=1.0, le=30.0)
    ] = 4.0
    seed: Annotated[int, Option("--seed", metavar="N", help="seed of the population"), Field(ge=0, lt=2**31)] = 0
    workers: Annotated[
        int | None,
        Option("--workers", metavar="N", help="number of processes; default: one per processor"),
        Field(ge=1, le=256),
    ] = None


@dataclass(frozen=True)
class Person:
    """Demographic values of one simulated subject. ``number`` is the person of ``SimulatedTissue.of_subject``."""

    pseudonym: str
    number: int
    gender: str
    age_years: float
    height_m: float
    weight_kg: float
    handedness: str

    @property
    def bmi(self) -> float:
        """Body mass index, kg/m²."""
        return self.weight_kg / self.height_m**2

    def mass_factor(self, site: str) -> float:
        """Return the relative mass of the tissue at a site, with the effects of gender and body mass index."""
        if "anterior" not in site:
            return 1.0
        return (HEAVIER_MALE if self.gender == "male" else 1.0) * float(np.exp(HEAVIER_PER_BMI * (self.bmi - MEAN_BMI)))


def population(count: int, seed: int) -> list[Person]:
    """Draw subjects as in the thesis: 18 to 36 years, both genders equally often."""
    random = np.random.default_rng([seed, 7])
    people = []
    for number in range(count):
        male = number % 2 == 1
        height = random.normal(1.77 if male else 1.64, 0.065)
        bmi = float(np.clip(random.normal(MEAN_BMI, 2.8), 17.5, 33.0))
        people.append(
            Person(
                f"P-{number + 1:03d}",
                1000 * seed + number,
                "male" if male else "female",
                float(random.integers(18, 37)),
                round(float(height), 3),
                round(bmi * float(height) ** 2, 1),
                "left" if random.random() < 0.1 else "right",
            )
        )
    return people


def run_population(plan: PopulationPlan, control: Control) -> StudyReport:
    """Measure a simulated population by guided tests, analyse the sessions and write the report.

    Raises:
        UnusableInputError: the folder is not empty or cannot be made, or a package is missing.
        CancelledError: it was cancelled; the finished sessions are kept.
    """
    check_packages("pandas", "pyarrow", "statsmodels", "sklearn")
    if plan.out.exists() and (not plan.out.is_dir() or any(plan.out.iterdir())):
        raise UnusableInputError(
            Message("study.folder_used", "{folder} exists and is not an empty folder", folder=str(plan.out))
        )
    private_folder(plan.out)
    people = population(plan.subjects, plan.seed)
    write_text(plan.out / SUBJECTS_FILE, _as_csv(people))
    sittings = [(person, site) for person in people for site in SITES]
    done = CountedProgress(control, _MEASURING, len(sittings))
    with executor(plan.workers) as pool:
        pool.do(functools.partial(measure_site, plan), sittings, control.check, done)
    return report_study(StudyReportPlan(folder=plan.out, workers=plan.workers), control)


def measure_site(plan: PopulationPlan, sitting: tuple[Person, str]) -> Path:
    """Run the tests of one subject at one site on a simulated instrument; return the session file.

    Raises:
        UnusableInputError: the session cannot be written.
    """
    person, site = sitting
    place = list(SITES).index(site)
    tissue = TISSUES[SITES[site]].of_subject(person.number).heavier(person.mass_factor(site)).varied(1.0)
    seed = 100 * person.number + place

    def opened(_address: str) -> Instrument:
        return SimulatedInstrument(tissue, seed=seed)

    test = TestPlan(
        url=f"simulated://{SITES[site]}",
        site=site,
        out=plan.out / f"{person.pseudonym} {site}.h5",
        subject=person.pseudonym,
        repeats=plan.repeats,
        seconds=plan.seconds,
        seed=plan.seed,
        calibration=False,
    )
    outcome = run_test(test, TestControl(), None, opener=opened)
    if outcome.error is not None:
        raise outcome.error
    if outcome.not_saved is not None:
        raise outcome.not_saved
    return test.out


def _as_csv(people: list[Person]) -> str:
    head = "subject,age_years,weight_kg,height_m,gender,handedness"
    rows = [
        f"{who.pseudonym},{who.age_years:g},{who.weight_kg:g},{who.height_m:g},{who.gender},{who.handedness}"
        for who in people
    ]
    return "\n".join([head, *rows]) + "\n"
