"""``tissueid reproduce``: a quick run from the cable to the page, failing tests, bad input, benchmarks of the field."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from outside_data import REAL
from reports.page_check import checked
from reports.synthetic_sitting import make_session, make_test

import tissueid.instrument
from firmware_sim.presets import preset_names
from tissueid.cli import main
from tissueid.errors import CancelledError, InstrumentError
from tissueid.messages import Message
from tissueid.procedures import demo
from tissueid.procedures.control import Control
from tissueid.procedures.overlay import named_fits
from tissueid.sessions import write_session
from tissueid_lab.thesis import field_benchmarks, reproduction
from tissueid_lab.thesis import figures as thesis_figures
from tissueid_lab.thesis.field_benchmarks import SILVERBOX, WIENER_HAMMERSTEIN, run_benchmark
from tissueid_lab.thesis.figures import FIGURES, QUICK_TESTS, REMARKS
from tissueid_lab.thesis.recipe import Recording


def complaint(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main([*map(str, arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
    return captured.err.strip().splitlines()[-1]


NUMBERS = ("3.4", "3.5", "4.9", "5.4", "6.2")
"""A figure of each chapter with few tests; the others are run by ``make soak``."""


def reproduced(out: Path, *numbers: str) -> list[dict[str, Any]]:
    """Make figures in a quick run, check that none is missing, and return them."""
    assert main(["reproduce", *numbers, "--quick", "--out", str(out), "--json", str(out.with_suffix(".json"))]) == 0
    figures = json.loads((out / "results.json").read_text())["figures"]
    assert {one["number"]: one["why_missing"] for one in figures if one["why_missing"]} == {}
    assert all(one["rows"] for one in figures)
    assert all("nan" not in row["here"] for one in figures for row in one["rows"])
    return figures


@pytest.mark.timeout(600)
def test_a_quick_reproduction(tmp_path: Path) -> None:
    out = tmp_path / "thesis"
    figures = reproduced(out, *NUMBERS)
    assert [one["number"] for one in figures] == list(NUMBERS)
    page = " ".join(checked((out / "report.html").read_text()).text.split())
    assert REMARKS["3.4"] in page
    assert "| VAF, nonparametric | 75.79 % |" in (out / "reproduction.md").read_text()
    scores = {row["what"]: row["here"] for one in figures for row in one["rows"]}
    assert float(scores["VAF, nonparametric"].split()[0]) == pytest.approx(75.0, abs=5.0)
    assert float(scores["damping ratio"]) < 1.0


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_the_figures_that_a_quick_run_chooses(tmp_path: Path) -> None:
    out = tmp_path / "thesis"
    figures = reproduced(out)
    assert len(figures) > 25
    assert {path.stem.removesuffix("-quick") for path in (out / "sessions").glob("*.h5")} == QUICK_TESTS


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_every_figure_in_a_quick_run(tmp_path: Path) -> None:
    numbers = tuple(one.number for one in FIGURES)
    plan = reproduction.ReproductionPlan(numbers=numbers, quick=True, out=tmp_path / "thesis")
    made = {one.figure.number: one for one in reproduction.run_reproduction(plan, Control())}
    assert {number for number, one in made.items() if one.why or not one.rows} == set()
    drawn = {number: one.report for number, one in made.items() if one.report is not None and one.report.pictures}
    assert {number for number, report in drawn.items() if report.csv().count("\n") < 2} == set()


def test_without_numbers_a_quick_run_makes_the_figures_of_a_few_tests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: list[str] = []

    def record(recordings: list[Recording], _folder: Path, _control: Control) -> dict[str, str]:
        played.extend(one.name.removesuffix("-quick") for one in recordings)
        return {one.name: "silent" for one in recordings}

    monkeypatch.setattr(reproduction, "_record", record)
    monkeypatch.setattr(thesis_figures, "FIGURES", [one for one in FIGURES if one.sources])
    made = reproduction.run_reproduction(reproduction.ReproductionPlan(quick=True, out=tmp_path / "out"), Control())
    assert len(made) > 15
    assert set(played) == QUICK_TESTS


def test_remarks_are_of_figures() -> None:
    assert set(REMARKS) <= {one.number for one in FIGURES}
    assert all(str(text).endswith(".") for text in REMARKS.values())


@pytest.mark.parametrize("figure", [one for one in FIGURES if one.fits], ids=lambda figure: figure.number)
def test_every_recipe_has_fits_and_tissues_that_exist(figure):
    assert len(named_fits((), figure.fits)) == len(figure.fits)
    assert {source.recording.preset for source in figure.sources} <= set(preset_names())
    labels = {fit.label for fit in named_fits((), figure.fits)}
    assert {fit for source in figure.sources for fit in source.fits} <= labels


def test_reproduce_lists_its_figures(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "--json", "-"]) == 0
    assert [one["number"] for one in json.loads(capsys.readouterr().out)["figures"]] == [f.number for f in FIGURES]


def test_a_reproduced_figure_is_complete_and_its_folder_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def record(recordings: object, folder: Path, _control: object) -> dict[str, str]:
        for one in recordings:  # type: ignore[attr-defined]
            write_session(folder / f"{one.name}.h5", make_session(make_test(1, seconds=2.0)))
        return {}

    monkeypatch.setattr(reproduction, "_record", record)
    out = tmp_path / "thesis"
    assert main(["reproduce", "3.4", "--out", str(out)]) == 0
    assert "1 at lag zero" in capsys.readouterr().out
    assert (out / "figures" / "3.4" / "correlations.png").stat().st_size > 10_000
    assert (out / "figures" / "3.4" / "numbers.csv").read_text().startswith("plot,name,x")
    assert json.loads((out / "results.json").read_text())["figures"][0]["number"] == "3.4"
    checked((out / "report.html").read_text())
    (out / "results.json").write_text("{}")
    assert "other results" in complaint(capsys, "reproduce", "3.4", "--out", out)


def test_recipes_are_consistent() -> None:
    names: dict[str, object] = {}
    for figure in FIGURES:
        for source in figure.sources:
            assert names.setdefault(source.recording.name, source.recording) == source.recording  # one file, one test
        assert figure.study is not None or (figure.sources and (figure.fits or figure.recorded is not None))


@pytest.fixture
def cable(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Replace the simulated instrument; return the speeds at which it is started."""
    speeds: list[float] = []

    class Idle:
        def close(self) -> None:
            pass

    @contextmanager
    def process(_preset: str, _seed: int, *, speed: float, coil: str, rate_hz: float) -> Iterator[str]:
        assert (coil, rate_hz) == ("ideal", 2000.0)
        speeds.append(speed)
        yield "nowhere"

    monkeypatch.setattr(demo, "firmware_process", process)
    monkeypatch.setattr(tissueid.instrument, "open_instrument", lambda _url: Idle())
    return speeds


def test_a_failed_test_is_repeated_more_slowly(
    tmp_path: Path, cable: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    def play(_instrument: object, one: Recording, path: Path, _control: Control) -> None:
        if one.name == "never" or len(cable) == 1:
            raise InstrumentError(Message("test.silent", "silent"))
        write_session(path, make_session(make_test(1, seconds=1.0)))

    monkeypatch.setattr(reproduction, "_play", play)
    recordings = [Recording("second", "linear-demo"), Recording("never", "linear-demo")]
    assert reproduction._record(recordings, tmp_path, Control()) == {"never": "silent"}
    assert cable == [4.0, 2.0, 4.0, 2.0, pytest.approx(4.0 / 3.0)]
    assert [path.name for path in tmp_path.glob("*.h5")] == ["second.h5"]


def test_quick_tests_of_one_tissue_share_an_instrument(
    tmp_path: Path, cable: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    def play(_instrument: object, _one: Recording, path: Path, _control: Control) -> None:
        write_session(path, make_session(make_test(1, seconds=1.0)))

    monkeypatch.setattr(reproduction, "_play", play)
    tests = [Recording(name, preset).shortened() for name, preset in (("a", "x"), ("b", "y"), ("c", "x"))]
    assert reproduction._record(tests, tmp_path, Control()) == {}
    assert len(cable) == 2


def test_a_cancelled_run_keeps_its_sessions_and_writes_nothing_else(
    tmp_path: Path, cable: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopped(Control):
        def cancelled(self) -> bool:
            return any((tmp_path / "out" / "sessions").glob("*.h5"))

    def play(_instrument: object, _one: Recording, path: Path, _control: Control) -> None:
        write_session(path, make_session(make_test(1, seconds=1.0)))

    monkeypatch.setattr(reproduction, "_play", play)
    plan = reproduction.ReproductionPlan(numbers=("3.11",), out=tmp_path / "out")
    with pytest.raises(CancelledError):
        reproduction.run_reproduction(plan, Stopped())
    assert [path.name for path in (tmp_path / "out" / "sessions").glob("*.h5")] == ["linear-demo-full.h5"]
    assert not (tmp_path / "out" / "results.json").exists()
    assert len(cable) == 1


def test_one_line_for_a_folder_or_file_that_cannot_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "there is no recipe for 9.9" in complaint(capsys, "reproduce", "9.9", "--out", "x")
    assert "--out is required" in complaint(capsys, "reproduce", "3.4")
    assert "cannot write" in complaint(capsys, "reproduce", "3.4", "--out", "/proc/tissueid")
    file = tmp_path / "file.csv"
    file.write_text("u,y\n1,2\n2,3\n")
    assert "is not a folder" in complaint(capsys, "reproduce", "3.4", "--out", file)
    other = tmp_path / "other"
    other.mkdir()
    (other / "report.html").write_text("mine")
    assert "contains other results" in complaint(capsys, "reproduce", "3.4", "--out", other)
    assert (other / "report.html").read_text() == "mine"
    assert "V1" in complaint(capsys, "reproduce", "--silverbox", file, "--out", tmp_path / "out")
    assert "no such file" in complaint(
        capsys, "reproduce", "--silverbox", tmp_path / "no.mat", "--out", tmp_path / "out"
    )
    words = complaint(capsys, "reproduce", "--wiener-hammerstein", file, "--out", tmp_path / "out")
    assert "2 samples" in words
    assert "188000" in words
    assert not (tmp_path / "out" / "results.json").exists()


def test_a_benchmark_is_scored_on_its_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.Generator(np.random.PCG64(1))
    u = random.standard_normal(3000)
    y = np.convolve(u, np.exp(-np.arange(30) / 6.0))[: u.size] + 0.01 * random.standard_normal(u.size)
    path = tmp_path / "record.csv"
    np.savetxt(path, np.column_stack([u, y]), delimiter=",", header="u,y", comments="")
    small = field_benchmarks.FieldBenchmark(
        "small", "title", ("input=u:V", "output=y:V"), 1000.0, 3000, (0, 2000), {"rest": (2000, 3000)},
        (("lms", {"memory": 0.05}),), {("lms", "rest"): "10 mV"},
    )  # fmt: skip
    figure = run_benchmark(small, path, Control())
    assert [(row.thesis, row.here.split()[1]) for row in figure.rows] == [("10 mV", "mV")]
    assert 10.0 <= float(figure.rows[0].here.split()[0]) < 15.0  # the noise, and the error of the fit


@pytest.mark.parametrize(
    ("benchmark_", "name", "part", "linear_mv"),
    [(SILVERBOX, "SNLS80mV.mat", "multisine", 6.96), (WIENER_HAMMERSTEIN, "wiener_hammerstein.csv", "test", 43.4)],
    ids=("silverbox", "wiener-hammerstein"),
)
def test_linear_errors_are_those_published(
    benchmark_: field_benchmarks.FieldBenchmark, name: str, part: str, linear_mv: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not (REAL / name).exists():
        pytest.skip("needs the real records")
    from dataclasses import replace

    linear = replace(benchmark_, engines=benchmark_.engines[:1], tests={part: benchmark_.tests[part]})
    (row,) = run_benchmark(linear, REAL / name, Control()).rows
    assert float(row.here.split()[0]) == pytest.approx(linear_mv, rel=0.02)
