"""Figures that the documents state about the demonstrations are those that the program gives.

A figure is followed by its key and tolerance, in its own unit: ``0.024 <!-- check: study_demo.within.c1 ± 0.006 -->``.
A group of keys is computed once. The demonstrations take minutes: their groups are computed by ``make soak``.
"""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from pages import ROOT
from test_documents import DOCUMENTS

from tissueid.cli import main

MARK = re.compile(r"([-−]?\d+(?:\.\d+)?)[^\d\n|<]{0,12}<!-- check: ([\w.]+) ± ([\d.]+) -->")
ANY_MARK = re.compile(r"<!-- check: (?!reproduced)")
SIX = {
    "zeta": "damping_ratio",
    "omega": "natural_frequency_rad_per_s",
    "mass": "scaled_mass_s2",
    "damping": "scaled_damping_s",
    "c1": "c1_m",
    "c2": "c2_per_n",
}
SIDES = {"left": "left anterior forearm", "right": "right anterior forearm"}
FACTORS = {"gender": ("group", "gender"), "bmi": ("regression", "bmi_kg_per_m2")}
NUMBER = re.compile(r"(?<![\w.,])[-−+]?\d+(?:[ \u202f]\d{3})*(?:\.\d+)?")
REPRODUCED = re.compile(r"<!-- check: reproduced within (\d+) %, without (.*?) -->")
ROUNDING = 0.03
"""Largest relative difference of a number in docs/thesis.md from that of the reproduction, by rounding."""


def study_demo(folder: Path) -> dict[str, float]:
    """Return coefficients of variation, planted effects and the change after the first test of ``study demo``."""
    out = folder / "population"
    answer_file = folder / "population.json"
    assert main(["study", "demo", "--out", str(out), "--json", str(answer_file)]) == 0
    answer = json.loads(answer_file.read_text())
    found = {"left_out": float(len(answer["left_out"]))}
    for short, name in SIX.items():
        found[f"within.{short}"] = answer["parameters"][name]["cv_individual"]
        found[f"between.{short}"] = answer["parameters"][name]["cv_population"]
    rows = answer["comparisons"]
    for short, factor in FACTORS.items():
        for side, site in SIDES.items():
            (row,) = (
                row
                for row in rows
                if ((row["kind"], row["factor"]), row["site"], row["parameter"]) == (factor, site, "scaled_mass_s2")
            )
            found[f"{short}.{side}"] = 1e6 * row["estimate"]
            found[f"{short}.{side}.p"] = row["p"]
    (first,) = (row for row in rows if (row["kind"], row["site"], row["parameter"]) == ("first_test", "all", "c1_m"))
    found["first.c1_mm"] = 1e3 * first["estimate"]
    for name in ("moisturising", "hydrating"):
        (row,) = (
            row
            for row in rows
            if row["kind"] == "condition"
            and row["groups"][1].startswith(name)
            and row["parameter"] == "stiffness_n_per_m"
        )
        found[f"lotion.{name}"] = row["estimate"]
    return found


def planted(_folder: Path) -> dict[str, float]:
    """Return how many of 20 seeds of ``study demo`` show each planted effect, and effects that are not there."""
    from benchmarks.planted_effects import ALPHA, SEEDS, study_of, summary

    rows = [study_of(seed, workers=1) for seed in range(SEEDS)]
    table = summary(rows)
    put_in = table[table["effect"] == "put in"].set_index(["factor", "site"])["found"]
    nothing = table[table["effect"] == "nothing put in"]
    found = {
        f"{short}.{side}": SEEDS * put_in[factor, site]
        for short, (_kind, factor) in FACTORS.items()
        for side, site in SIDES.items()
    }
    for short, factor in (("age", "age_group"), ("ethnicity", "ethnicity")):
        found[f"{short}.percent"] = 100.0 * float(nothing[nothing["factor"] == factor]["of all six"].mean())
        found[f"{short}.any"] = float(sum(row[f"least corrected p {factor}"] < ALPHA for row in rows))
    return found


def demo(folder: Path) -> dict[str, float]:
    """Return the share of the gap that the diagnosis of ``tissueid demo`` closes, percent."""
    out, answer = folder / "demo", folder / "gap.json"
    assert main(["demo", "--out", str(out)]) == 0
    assert main(["gap", "diagnose", str(out / "session.h5"), "--json", str(answer)]) == 0
    found = json.loads(answer.read_text())
    expected = {"added_mass", "contact_loss", "directional_damping", "viscoelasticity"}
    assert set(found["combination"]) == expected
    return {"closed": 100.0 * found["gap"]["closed"]}


_COMPUTED = {"study_demo": study_demo, "planted": planted, "demo": demo}
KEYS = {
    "study_demo": {
        "left_out",
        *(f"{kind}.{short}" for kind in ("within", "between") for short in SIX),
        *(f"{short}.{side}{end}" for short in FACTORS for side in SIDES for end in ("", ".p")),
        "first.c1_mm",
        "lotion.moisturising",
        "lotion.hydrating",
    },
    "planted": {
        *(f"{short}.{side}" for short in FACTORS for side in SIDES),
        *(f"{short}.{end}" for short in ("age", "ethnicity") for end in ("percent", "any")),
    },
    "demo": {"closed"},
}


@cache
def marks() -> list[tuple[str, str, str, float, float]]:
    """Return page, group, key, stated value and tolerance of each marked figure."""
    found = []
    for page in DOCUMENTS:
        for value, key, tolerance in MARK.findall(page.read_text(encoding="utf-8")):
            group, _, name = key.partition(".")
            stated = float(value.replace("−", "-"))
            found.append((str(page.relative_to(ROOT)), group, name, stated, float(tolerance)))
    return found


def test_every_mark_has_a_figure_and_a_known_key():
    counts = sum(len(ANY_MARK.findall(page.read_text(encoding="utf-8"))) for page in DOCUMENTS)
    assert len(marks()) == counts
    assert [(page, group, key) for page, group, key, _, _ in marks() if key not in KEYS.get(group, ())] == []
    assert {group for _, group, _, _, _ in marks()} == set(KEYS)


@pytest.mark.soak
@pytest.mark.parametrize("group", sorted(KEYS))
def test_the_stated_figures_are_those_of_the_program(group, tmp_path):
    found = _COMPUTED[group](tmp_path)
    assert set(found) == KEYS[group]
    wrong = [
        (page, key, stated, found[key], tolerance)
        for page, where, key, stated, tolerance in marks()
        if where == group and not abs(found[key] - stated) <= tolerance
    ]
    assert wrong == []


def numbers(text: str) -> list[float]:
    """Return the numbers of a text."""
    return [float(re.sub(r"[ \u202f]", "", found).replace("−", "-")) for found in NUMBER.findall(text)]


def reproduction() -> dict[str, dict[str, Any]]:
    """Return each figure of docs/measured/reproduction.json by its number."""
    results = json.loads((ROOT / "docs" / "measured" / "reproduction.json").read_text(encoding="utf-8"))
    return {figure["number"]: figure for figure in results["figures"]}


def test_the_table_of_the_thesis_states_the_numbers_of_the_reproduction():
    """Each number in the last column of a row, but those in brackets, is in a figure that the row names."""
    figures, checked, wrong = reproduction(), 0, []
    for line in (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8").splitlines():
        named = re.search(r"`tissueid reproduce ([^`]+?)(?: --out DIR)?`", line)
        cells = line.strip("| ").split(" | ")
        if not line.startswith("| ") or named is None or len(cells) < 5:
            continue
        names = [name.strip("'") for name in re.findall(r"'Table [\d.]+'|[\d.]+", named[1])]
        named_figures = [figures[name] for name in names]
        texts = [f"{row['what']} {row['here']}" for figure in named_figures for row in figure["rows"]]
        texts += [text for figure in named_figures for text in (figure["remark"], *figure["warnings"])]
        known = numbers(" ".join(texts))
        for stated in numbers(re.sub(r"\([^)]*\)|`[^`]*`", "", cells[4])):
            checked += 1
            if not any(abs(stated - value) <= ROUNDING * abs(value) + 1e-9 for value in known):
                wrong.append((cells[0], stated))
    assert wrong == []
    assert checked > 60


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_the_reproduction_repeats_its_page(tmp_path):
    """Another run gives the stored numbers, within the tolerance and except for the figures that the page states."""
    page = (ROOT / "docs" / "reproduction.md").read_text(encoding="utf-8")
    ((percent, left_out),) = REPRODUCED.findall(page)
    assert main(["reproduce", "--out", str(tmp_path / "thesis")]) == 0
    figures = json.loads((tmp_path / "thesis" / "results.json").read_text(encoding="utf-8"))["figures"]
    made = {(one["number"], row["what"]): row["here"] for one in figures for row in one["rows"]}
    wrong, compared = [], 0
    for number, figure in reproduction().items():
        for what, here in ((row["what"], row["here"]) for row in figure["rows"]):
            if number in left_out.split(", ") or re.search(r"\btime\b|\d ?µ?s\b|power", f"{what} {here}"):
                continue
            expected, found = numbers(here), numbers(made[number, what])
            close = [abs(a - b) <= 0.01 * int(percent) * max(abs(a), 1.0) for a, b in zip(expected, found, strict=True)]
            compared += len(close)
            if not all(close):
                wrong.append((number, what, here, made[number, what]))
    assert wrong == []
    assert compared > 150
