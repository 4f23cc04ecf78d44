"""Plans of studies: which sessions, which engine, and where the results go."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from tissueid.plan_options import Option
from tissueid.procedures.cluster import ClusterPlan

SUBJECTS_FILE = "subjects.csv"
"""Name of the file with demographic values by subject."""
RESULTS = "results"
"""Folder of a study with its results: one file per session, the tables and the report."""
CURVES_FILE = "curves.parquet"
"""Name of the file in the results with the sampled curves of each test."""
NOT_ANALYSED_FILE = "not_analysed.csv"
"""Name of the file in the results with the reason of each session that could not be analysed."""


class StudyPlan(ClusterPlan):
    """The folder of a study, and the engine whose parameters are compared."""

    folder: Annotated[Path, Option(argument=True, metavar="FOLDER", help="folder of the sessions; subfolders count")]
    sessions: Annotated[
        str | None,
        Option(
            "--sessions",
            metavar="URL",
            help="read the sessions by fsspec, such as s3://bucket/study; FOLDER keeps the subjects, table and report",
        ),
    ] = None
    engine: Annotated[str, Option("--engine", metavar="NAME", help="engine of the parameters")] = "wiener"
    options: Annotated[
        tuple[str, ...],
        Option("--option", metavar="NAME=VALUE", help="another option of the engine; may be repeated"),
    ] = ()
    held_out: Annotated[
        bool, Option("--held-out", help="fit three quarters of each test and score the rest; default: fit whole tests")
    ] = False
    workers: Annotated[
        int | None,
        Option("--workers", metavar="N", help="number of processes; default: one per processor"),
        Field(ge=1, le=256),
    ] = None


class StudyReportPlan(StudyPlan):
    """A study, its comparisons, and the report."""

    report: Annotated[
        Path | None, Option("--out", metavar="FILE", help="HTML page; default: report.html in the results of the study")
    ] = None
    pdf: Annotated[Path | None, Option("--pdf", metavar="FILE", help="write the report as PDF, too")] = None
    factors: Annotated[
        tuple[str, ...],
        Option("--factor", metavar="NAME", help="column with groups of subjects, such as gender; may be repeated"),
    ] = ()
    regressors: Annotated[
        tuple[str, ...],
        Option("--regress", metavar="NAME", help="column with a value of subjects, such as age_years; may be repeated"),
    ] = ()
    only: Annotated[
        tuple[str, ...],
        Option(
            "--only",
            metavar="NAME=VALUE",
            help="only subjects with this value, such as gender=male, age_years=18:28 or site=...; may be repeated",
        ),
    ] = ()
    before: Annotated[
        str,
        Option("--before", metavar="CONDITION", help="condition of the reference; default: without one"),
    ] = ""
    after: Annotated[
        str | None, Option("--after", metavar="CONDITION", help="condition that is compared; default: all others")
    ] = None
    margin: Annotated[
        float | None,
        Option("--margin", metavar="SHARE", help="relative difference that still counts as equivalent, such as 0.1"),
        Field(gt=0.0, le=10.0),
    ] = None
