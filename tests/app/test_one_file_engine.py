"""An engine in one file of another package, with no other edit: command line, window, comparison and report."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from plugged import plugged_in
from reports.synthetic_sitting import make_session

from tissueid.analysis import compare, specifications, split
from tissueid.app.views.researcher.batch import summary_of
from tissueid.app.views.researcher.engine_form import EngineForm
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.cli import main
from tissueid.identification import registry
from tissueid.sessions import Session, write_session

NAME, LABEL, TITLE = "static_slope", "Static slope", "A straight line between force and depth."
DECLARATION = f'''"""A straight line between force and depth, with neither memory nor mass, damping and stiffness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import Field

from tissueid.identification import FittedCurve, Engine, FitReport, LineFigure, Model, engine, vaf_percent
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Estimate


@dataclass(frozen=True, eq=False)
class SlopeModel(Model):
    """The line: output = offset + slope * input."""

    slope: float
    offset: float

    def simulate(self, u):
        """Return the line at each input."""
        return self.offset + self.slope * np.asarray(u, dtype=np.float64)


def _line(model):
    force = np.linspace(0.0, 2.0, 50)
    return (FittedCurve(force, model.simulate(force), marked("fitted line")),)


@engine
class StaticSlope(Engine):
    """Static slope engine."""

    name: ClassVar[str] = "{NAME}"
    label: ClassVar[str] = marked("{LABEL}")
    title: ClassVar[str] = marked("{TITLE}")
    figures: ClassVar[tuple[LineFigure, ...]] = (
        LineFigure(
            "slope",
            marked("Static slope of the tissue"),
            marked("Depth against force: a straight line."),
            marked("The slope is the static compliance."),
            marked("Force (N)"),
            marked("Depth (m)"),
            _line,
        ),
    )

    shrinkage: float = Field(
        0.0, ge=0.0, le=1.0, title=marked("Shrinkage"), description=marked("Share by which the slope is reduced")
    )

    def fit(self, record, fit_part=None):
        """Fit the line by least squares."""
        part = record[fit_part or slice(None)]
        used = np.isfinite(part.input) & np.isfinite(part.output)
        slope, offset = np.polyfit(part.input[used], part.output[used], 1)
        slope *= 1.0 - self.shrinkage
        report = FitReport(
            engine=self.name,
            options=self.options(),
            n_samples=int(used.sum()),
            n_parameters=2,
            vaf_percent=vaf_percent(part.output, offset + slope * part.input),
            parameters={{"slope_m_per_n": Estimate(float(slope), None)}},
            findings=(Message("static_slope.slope", "the slope is {{slope:.3g}} m/N", slope=float(slope)),),
        )
        return SlopeModel(report, record.sample_rate_hz, 1, float(slope), float(offset))
'''


@pytest.fixture(scope="module", autouse=True)
def _installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Install the engine by an entry point, as another package does."""
    path = tmp_path_factory.mktemp("package") / f"{NAME}.py"
    path.write_text(DECLARATION, encoding="utf-8")

    def load() -> type:
        spec = importlib.util.spec_from_file_location(NAME, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(__import__("sys").modules, NAME, module)
            spec.loader.exec_module(module)
        return module.StaticSlope

    plugin = SimpleNamespace(name=NAME, value=f"{NAME}:StaticSlope", load=load)
    with plugged_in("tissueid.engines", [plugin], registry.engines):
        yield


@pytest.fixture(scope="module")
def session() -> Session:
    return make_session()


@pytest.fixture(scope="module")
def saved(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("session") / "session.h5"
    write_session(path, session)
    return path


def test_it_is_listed_with_its_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "engines.json"
    assert main(["engines", "--json", str(out)]) == 0
    assert NAME in capsys.readouterr().out
    (found,) = [item for item in json.loads(out.read_text()) if item["engine"] == NAME]
    assert (found["label"], found["title"], found["family"]) == (LABEL, TITLE, "other")
    assert found["options"]["shrinkage"]["default"] == 0.0
    assert main(["engines", NAME]) == 0
    assert "shrinkage" in capsys.readouterr().out


def test_it_is_identified_with(saved: Path, tmp_path: Path):
    out = tmp_path / "answer.json"
    options = ["--engine", NAME, "--option", "shrinkage=0.1", "--json", str(out)]
    assert main(["identify", str(saved), *options]) == 0
    answer = json.loads(out.read_text())
    assert answer["options"] == {"shrinkage": 0.1}
    assert set(answer["parameters"]) == {"slope_m_per_n"}
    assert answer["messages"]["findings"][0]["code"] == "static_slope.slope"


def test_it_is_compared_and_shown_on_the_page_with_its_figure(saved: Path, tmp_path: Path):
    out, page = tmp_path / "answer.json", tmp_path / "compare.html"
    arguments = ["--engines", f"{NAME},lms", "--json", str(out), "--out", str(page)]
    assert main(["compare", str(saved), *arguments]) == 0
    answer = json.loads(out.read_text())
    assert [row["engine"] for row in answer["engines"]] == [NAME, "lms"]
    assert all(row["refused"] is None for row in answer["engines"])
    assert answer["recommendation"]["engine"] == "lms"
    html = page.read_text(encoding="utf-8")
    assert LABEL in html
    assert "Static slope of the tissue" in html
    assert "The slope is the static compliance." in html
    assert "the slope is" in html.lower()


def test_it_is_in_the_report_of_a_test(saved: Path, tmp_path: Path):
    out = tmp_path / "report.html"
    assert main(["report", str(saved), "--engines", f"{NAME},lms", "--out", str(out)]) == 0
    html = out.read_text(encoding="utf-8")
    assert LABEL in html
    assert "Static slope of the tissue" in html


def test_the_window_offers_it_with_its_options_and_shows_its_place_in_a_comparison(qtbot, session: Session):
    form = EngineForm()
    qtbot.addWidget(form)
    assert form.engine.findData(NAME) >= 0
    form.choose(NAME)
    assert form.engine.currentText() == LABEL
    assert form.about.text() == TITLE
    (field,) = form._fields.values()
    assert (field.name, field.label) == ("shrinkage", "Shrinkage")
    found = compare(specifications((NAME, "lms")), split(session))
    verdict = summary_of(found, (SelectedTest(Path("session.h5"), session.tests[0].number, "forearm", "P1", "test 1"),))
    assert any(row[0] == LABEL for row in verdict.rows)
