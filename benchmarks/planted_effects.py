"""Whether ``study demo`` finds the effects that are put into its population, over many seeds.

``python -m benchmarks.planted_effects`` measures and analyses one population of 16 subjects for each seed and prints
how often each effect has p < 0.05, next to comparisons with nothing put in. ``--json FILE`` keeps the rows; a run with
the same file continues. Two tests at each site instead of five: the effects are tested on the means of the subjects,
which depend little on the number of tests.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from tissueid.procedures.control import Control
from tissueid.procedures.study_demo import PopulationPlan, measure_population
from tissueid.procedures.study_plans import StudyPlan
from tissueid.procedures.study_run import run_study
from tissueid.studies.group_comparison import one_way, regressions, subject_means
from tissueid.studies.repeatability import ALL_SITES, first_test, variation
from tissueid.studies.usable_tests import THESIS_SIX, usable_tests

ALPHA = 0.05
SEEDS = 20
REPEATS = 2
MASS = "scaled_mass_s2"
PLANTED = (
    ("gender", "left anterior forearm"),
    ("gender", "right anterior forearm"),
    ("bmi_kg_per_m2", "left anterior forearm"),
    ("bmi_kg_per_m2", "right anterior forearm"),
)
"""Factors and sites at which the scaled mass depends on them."""
NOTHING = (
    ("gender", "left posterior forearm"),
    ("gender", "right posterior forearm"),
    ("bmi_kg_per_m2", "left posterior forearm"),
    ("bmi_kg_per_m2", "right posterior forearm"),
    *(
        (factor, f"{side} {face} forearm")
        for factor in ("age_years", "age_group", "ethnicity")
        for side in ("left", "right")
        for face in ("anterior", "posterior")
    ),
)
"""Factors and sites at which no parameter depends on them."""


def study_of(seed: int, *, subjects: int = 16, repeats: int = REPEATS, workers: int | None = None) -> dict[str, Any]:
    """Measure and analyse one population; return p-values and coefficients by name."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "population"
        plan = PopulationPlan(out=place, subjects=subjects, repeats=repeats, seed=seed, products=False, workers=workers)
        measure_population(plan, Control())
        used = usable_tests(run_study(StudyPlan(folder=place, workers=workers), Control()).table).used
    return {"seed": seed, "tests": len(used)} | figures_of(used)


def figures_of(used: pd.DataFrame) -> dict[str, Any]:
    """Return p-values by factor, site and parameter, coefficients of variation, and the change after the first test."""
    means = subject_means(used, THESIS_SIX)
    tables = [one_way(means, name, THESIS_SIX) for name in ("gender", "age_group", "ethnicity")]
    tables += [regressions(means, name, THESIS_SIX) for name in ("bmi_kg_per_m2", "age_years")]
    found = {
        f"p {row['factor']} {row['site']} {row['parameter']}": row["p_value"]
        for rows in tables
        for row in rows.to_dict("records")
    }
    corrected = {
        f"least corrected p {name}": float(rows["p_corrected"].min())
        for name, rows in zip(("gender", "age_group", "ethnicity", "bmi_kg_per_m2", "age_years"), tables, strict=True)
    }
    spread = variation(used, THESIS_SIX).groupby("parameter")[["individual_cv", "population_cv"]].mean()
    cvs = {f"{kind} {name}": float(row[kind]) for name, row in spread.iterrows() for kind in spread}
    later = first_test(used, ["c1_m"]).set_index("site").loc[ALL_SITES]
    return found | corrected | cvs | {"c1_later_m": float(later["difference"]), "p c1_later": float(later["p_value"])}


def summary(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """Return how often each comparison of the scaled mass, and any of the six parameters, has p < 0.05."""
    table = pd.DataFrame(rows)
    lines = []
    for kind, pairs in (("put in", PLANTED), ("nothing put in", NOTHING)):
        for factor, site in pairs:
            six = table[[f"p {factor} {site} {name}" for name in THESIS_SIX]] < ALPHA
            lines.append(
                {
                    "effect": kind,
                    "factor": factor,
                    "site": site,
                    "found": float((table[f"p {factor} {site} {MASS}"] < ALPHA).mean()),
                    "of all six": float(six.to_numpy().mean()),
                }
            )
    return pd.DataFrame(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the seeds and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="number of seeds")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--json", type=Path, help="rows by seed; a run with the same file continues")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(arguments)
    rows = json.loads(options.json.read_text()) if options.json and options.json.exists() else []
    for seed in range(options.first, options.first + options.seeds):
        if seed in {row["seed"] for row in rows}:
            continue
        rows.append(study_of(seed, workers=options.workers))
        print(f"seed {seed}: {rows[-1]['tests']} tests", flush=True)
        if options.json:
            options.json.write_text(json.dumps(rows))
    table = pd.DataFrame(rows)
    print(summary(rows).to_string(index=False, float_format=lambda value: f"{value:.2f}"))
    for name in ("gender", "bmi_kg_per_m2", "age_group", "age_years", "ethnicity"):
        share = float((table[f"least corrected p {name}"] < ALPHA).mean())
        print(f"any corrected p-value below {ALPHA:g}: {name} in {share:.2f} of the seeds")
    for name in THESIS_SIX:
        within, between = (table[f"{kind} {name}"].mean() for kind in ("individual_cv", "population_cv"))
        print(f"{name}: within {within:.3f}, between {between:.3f}")
    print(
        f"C1 of later tests less the first: {1e3 * table['c1_later_m'].mean():+.2f} mm, negative in "
        f"{float((table['c1_later_m'] < 0).mean()):.2f}, p < 0.05 in {float((table['p c1_later'] < ALPHA).mean()):.2f}"
    )


if __name__ == "__main__":
    main()
