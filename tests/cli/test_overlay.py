"""``tissueid overlay`` and ``repeats``, as people and scripts meet them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
from reports.page_check import checked
from reports.synthetic_sitting import make_session, make_test
from shell import answer, complaint

from tissueid.cli import main
from tissueid.sessions import write_session

FIT = "short=lms,memory=0.05"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("overlay")
    paths = folder / "one.h5", folder / "two.h5"
    tests = [replace(make_test(n, seconds=2.0, seed=n), site="left arm") for n in (1, 2)]
    write_session(paths[0], make_session(*tests))
    write_session(paths[1], make_session(replace(make_test(1, seconds=2.0, seed=7), site="right arm")))
    return paths


def test_tests_of_several_sessions_in_one_figure(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, numbers, figures = tmp_path / "page.html", tmp_path / "n.csv", tmp_path / "figures"
    outputs = ("--out", page, "--csv", numbers, "--figures", figures, "--json", tmp_path / "fits.json")
    sources = (f"{files[0]}:all", f"other={files[1]}@short")
    assert main([*map(str, ("overlay", *sources, "--fit", FIT, *outputs))]) == 0
    fits = json.loads((tmp_path / "fits.json").read_text())["fits"]
    assert [(one["source"], one["fit"], one["engine"]) for one in fits] == [
        ("left arm", "short", "lms"), ("left arm", "short", "lms"), ("other", "short", "lms"),
    ]  # fmt: skip
    text = " ".join(checked(page.read_text()).text.split())
    assert "Correlations of input and output" in text
    assert {"depth.png", "depth.svg", "correlations.png", "scores.png"} <= {one.name for one in figures.iterdir()}
    rows = list(csv.DictReader(numbers.read_text().splitlines()))
    assert {row["name"] for row in rows if row["plot"] == "Stiffness"} >= {"left arm", "other"}
    assert "left arm" in capsys.readouterr().out


def test_a_site_is_a_text_and_nothing_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sites = ("_<b>$x$</b>", "[red]\x1b[2J" + 900 * "a")
    tests = [replace(make_test(n, seconds=2.0, seed=n), site=site) for n, site in enumerate(sites, 1)]
    path, page = tmp_path / "s.h5", tmp_path / "page.html"
    write_session(path, make_session(*tests))
    assert main(["overlay", f"{path}:all", "--fit", FIT, "--out", str(page)]) == 0
    printed = capsys.readouterr().out
    assert "\x1b[2J" not in printed
    assert "[red]" in printed
    assert 70 * "a" not in printed
    source = page.read_text()
    assert "_<b>" not in source
    assert "_&lt;b&gt;$x$" in source
    checked(source)


def test_a_pattern_and_joined_tests(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    pattern = files[0].parent / "*.h5"
    fits = answer(capsys, "overlay", str(pattern), f"both={files[0]}:1+2", "--fit", FIT)["fits"]
    assert [(one["source"], one["tests"]) for one in fits] == [
        ("left arm", [1]), ("right arm", [1]), ("both", [1, 2]),
    ]  # fmt: skip


def test_repeats_give_mean_and_deviation_by_site(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "repeats.csv"
    found = answer(capsys, "repeats", *files, "--fit", FIT, "--csv", table)["repeats"]
    stiffness = {one["source"]: one for one in found if one["quantity"] == "stiffness_n_per_m"}
    assert {name: one["count"] for name, one in stiffness.items()} == {"left arm": 2, "right arm": 1}
    assert stiffness["right arm"]["std"] is None
    assert stiffness["left arm"]["cv"] == pytest.approx(stiffness["left arm"]["std"] / stiffness["left arm"]["mean"])
    rows = {(row["source"], row["quantity"]): row for row in csv.DictReader(table.read_text().splitlines())}
    assert float(rows["left arm", "stiffness_n_per_m"]["mean"]) == stiffness["left arm"]["mean"]
    assert rows["right arm", "stiffness_n_per_m"]["std"] == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("overlay", "FILE"), "--engines or --fit is required"),
        (("overlay", "FILE", "--fit", "lms", "--fit", "lms,memory=0.02"), "two fits are called 'lms'"),
        (("overlay", "FILE@raw", "--fit", "lms"), "there is no fit 'raw'"),
        (("overlay", "FILE:7", "--fit", "lms"), "no test 7"),
        (("overlay", "FILE", "--fit", "lms", "--sweep", "memory=short"), "a sweep must be"),
        (("overlay", "nowhere.h5", "--fit", "lms"), "nowhere.h5"),
        (("overlay", "FILE", "--fit", "lms,colour=red"), "colour"),
        (("overlay", "FILE", "--fit", "lms", "--out", "FILE"), "other content"),
        (("overlay", "FILE", "--fit", "lms", "--sweep-file", "FILE"), "calibration"),
        (("repeats", "FILE", "--fit", "none"), "none"),
    ],
)
def test_one_line_for_what_cannot_be_done(
    arguments: tuple[str, ...], words: str, files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert words in complaint(capsys, *(text.replace("FILE", str(files[0])) for text in arguments))
