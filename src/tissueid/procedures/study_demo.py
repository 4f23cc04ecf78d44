"""Subjects, materials and lotions of the simulated population: what is put in, and not known to the analysis."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from tissueid.atomic_write import private_folder
from tissueid.errors import UnusableInputError
from tissueid.extras import check_packages
from tissueid.gap.workers import executor
from tissueid.instrument import Instrument, SimulatedInstrument
from tissueid.instrument.tissues import TISSUES, SimulatedTissue, Variation
from tissueid.language import marked
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control, CountedProgress
from tissueid.procedures.output_files import json_text, stored_values, write_text
from tissueid.procedures.study_plans import SUBJECTS_FILE, StudyReportPlan
from tissueid.procedures.study_run import StudyReport, report_study
from tissueid.procedures.test_plan import TestPlan
from tissueid.sessions.file_policy import journal_path
from tissueid.twin.chain_parameters import Tissue

SITES: Mapping[str, str] = {
    "right posterior forearm": "forearm",
    "right anterior forearm": "anterior-forearm",
    "left posterior forearm": "forearm",
    "left anterior forearm": "anterior-forearm",
}
"""Sites in the order of the thesis, and their simulated tissues."""
HEAVIER_MALE: Mapping[str, float] = {"left anterior forearm": 1.6, "right anterior forearm": 1.5}
"""Mass of the tissue of males relative to females. Tissue is 0.4 of the moving mass, so the scaled mass rises by 24 and
20 %: the thesis finds both sites with p < 0.01 (Table 7.3a), and 16 subjects find these in most studies.
"""
HEAVIER_PER_BMI = 0.08
"""Relative change of the tissue's mass at the anterior sites for 1 kg/m² of body mass index, chosen (Fig. 7.6) so that
16 subjects find it in most studies. With 0.03 they found it in one of five.
"""
MEAN_BMI = 23.0
ETHNICITIES = ("Caucasian", "Asian", "African American", "Hispanic")
"""Groups of thesis 7.1.1, equally often and without an effect."""
PEOPLE = Variation(0.4, 0.08, 0.04, 0.1, 0.4)
"""Variation between subjects, in addition to the effects of gender and body mass index, for Table 7.2 at four sites.
That of ``TISSUES`` counts on the noise of single tests for C2; here C2 varies with the difference of damping by
direction, which bends the curve.
"""
LOTIONS: Mapping[str, float] = {"moisturising lotion": 0.9, "hydrating lotion": 1.05}
"""Stiffness of the skin at constant force under each lotion relative to that without: down for one, slightly up for
the other, mass and damping alike (thesis 7.4). Factors chosen: the thesis prints none.
"""
LOTION_SITE, LOTION_MINUTES = "right anterior forearm", 60.0
_LIKE = Variation(stiffness=0.02, stiffness_growth=0.02, damping=0.02, mass=0.02, surface_m=0.1e-3)
"""Variation between tests of one sample, chosen."""
MATERIALS: Mapping[str, SimulatedTissue] = {
    "acrylamide 10 %": SimulatedTissue(Tissue(0.010, 0.010, 2.5, 20.0, 1300.0, 40.0), variation=_LIKE),
    "acrylamide 20 %": SimulatedTissue(Tissue(0.010, 0.010, 2.5, 20.0, 2300.0, 40.0), variation=_LIKE),
    "acrylamide 30 %": SimulatedTissue(Tissue(0.010, 0.010, 2.5, 20.0, 3500.0, 40.0), variation=_LIKE),
    "Buna-N": SimulatedTissue(Tissue(0.010, 0.012, 40.0, 0.0, 6000.0, 30.0), variation=_LIKE),
    "latex": SimulatedTissue(Tissue(0.010, 0.003, 6.0, 0.0, 800.0, 40.0), variation=_LIKE),
}
"""Samples in the order of thesis 7.2: stiffness of acrylamide rises with its concentration, mass and damping hardly;
Buna is stiff and damped; latex is soft. Figures chosen: the thesis prints none.
"""
MATERIAL_TESTS = 10
"""Tests of each sample (thesis 7.2)."""


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
    ethnicity: str

    @property
    def bmi(self) -> float:
        """Body mass index, kg/m²."""
        return self.weight_kg / self.height_m**2

    def seed(self, site: str) -> int:
        """Return the seed of the instrument at a site."""
        return 100 * self.number + list(SITES).index(site)

    def tissue(self, site: str, condition: str = "") -> SimulatedTissue:
        """Return the tissue at a site, under a lotion or without one; the instrument varies it from test to test."""
        kind = replace(TISSUES[SITES[site]], between_subjects=PEOPLE)
        simulated = kind.of_subject(self.number).heavier(self.mass_factor(site))
        factor, skin = LOTIONS.get(condition, 1.0), simulated.tissue
        stretched = replace(  # depth at constant force divided by the factor
            skin,
            stiffness_n_per_m=factor * skin.stiffness_n_per_m,
            stiffness_growth_per_m=factor * skin.stiffness_growth_per_m,
        )
        return replace(simulated, tissue=stretched)

    def mass_factor(self, site: str) -> float:
        """Return the relative mass of the tissue at a site, with the effects of gender and body mass index."""
        if "anterior" not in site:
            return 1.0
        return (HEAVIER_MALE[site] if self.gender == "male" else 1.0) * float(
            np.exp(HEAVIER_PER_BMI * (self.bmi - MEAN_BMI))
        )


def population(count: int, seed: int) -> list[Person]:
    """Draw subjects as in the thesis: 18 to 36 years, both genders equally often."""
    random = np.random.default_rng([seed, 7])
    origins = np.random.default_rng([seed, 8]).permutation(np.resize(ETHNICITIES, count))
    persons = []
    for number in range(count):
        male = number % 2 == 1
        height = random.normal(1.77 if male else 1.64, 0.065)
        bmi = float(np.clip(random.normal(MEAN_BMI, 2.8), 17.5, 33.0))
        persons.append(
            Person(
                f"P-{number + 1:03d}",
                1000 * seed + number,
                "male" if male else "female",
                float(random.integers(18, 37)),
                round(float(height), 3),
                round(bmi * float(height) ** 2, 1),
                "left" if random.random() < 0.1 else "right",
                str(origins[number]),
            )
        )
    return persons


def sample_name(material: str) -> str:
    """Return the pseudonym of the sample of a material."""
    return f"M-{list(MATERIALS).index(material) + 1}"


def subjects_file(persons: Sequence[Person], materials: Iterable[str] = ()) -> str:
    """Return the demographic values of people, and the materials of samples, as CSV."""
    head = "subject,age_years,weight_kg,height_m,gender,handedness,ethnicity,material"
    rows = [
        f"{who.pseudonym},{who.age_years:g},{who.weight_kg:g},{who.height_m:g},{who.gender},{who.handedness},{who.ethnicity},"
        for who in persons
    ]
    rows += [f"{sample_name(name)},,,,,,,{name}" for name in materials]
    return "\n".join([head, *rows]) + "\n"


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
    persons = population(plan.subjects, plan.seed)
    write_text(plan.out / SUBJECTS_FILE, subjects_file(persons, MATERIALS if plan.products else ()))
    series = [Series(person.pseudonym, site, person.seed(site)) for person in persons for site in SITES]
    if plan.products:
        series += [
            Series(person.pseudonym, LOTION_SITE, person.seed(LOTION_SITE) + 10 + number, lotion)
            for person in persons
            for number, lotion in enumerate(LOTIONS)
        ]
        series += [Series(sample_name(name), name, number, "") for number, name in enumerate(MATERIALS)]
    series = [item for item in series if not session_path(plan, item).exists()]
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
    from tissueid.procedures.test_run import TestControl, run_test  # takes long to import

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
    outcome.saved()
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
        existing = stored_values(plan.out / _MARK)
        if existing.get("made_by") != _MADE_BY:
            raise UnusableInputError(
                "study.folder_used",
                "{folder} exists and is neither empty nor the folder of an earlier 'study demo'",
                folder=str(plan.out),
            )
        if existing != mark:
            raise UnusableInputError(
                "study.other_population",
                "{folder} holds a simulated population with other options; give the same ones, or another folder",
                folder=str(plan.out),
            )
        return
    private_folder(plan.out)
    write_text(plan.out / _MARK, json_text(mark))
