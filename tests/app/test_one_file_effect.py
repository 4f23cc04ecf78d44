"""An effect in one file, with no other edit: listed, simulated, named by a diagnosis, in the window and the report."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tissueid.app.views.gap.diagnosis_result import page_content_of
from tissueid.app.views.gap.result_page import DiagnosisPage
from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.gap.answer import as_answer
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.preparation import prepare
from tissueid.gap.workers import SerialExecutor
from tissueid.reports.gap_page import gap_html
from tissueid.sessions import Session, Test
from tissueid.twin import effects
from tissueid.twin.catalogue import all_effects, effect
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.player import Player
from tissueid.twin.simulation import ActiveEffect, Start, simulate
from tissueid_lab.blind_check.answers import with_labels
from tissueid_lab.blind_check.scoring import SINGLE, Label, score_of

NAME, TITLE = "magnetic_notch", "The probe is pulled to one position"
DECLARATION = f'''"""A magnet next to the stroke pulls the probe to one position."""

from __future__ import annotations

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the force of a well in the potential."""
    along = (b[bus.POSITION] - p[1]) / 3e-4
    b[bus.FORCE] -= p[0] * along / (1.0 + along * along) ** 2


EFFECT = Effect(
    name="{NAME}",
    stage="mechanics",
    title="{TITLE}",
    equation="F = -F0 u / (1 + u^2)^2, u = (x - x0) / 0.3 mm; vanishes with F0 = 0",
    signature="a force towards one position, the same in every test",
    source="this test",
    parameters=(
        Parameter("force_n", "N", 0.0, 1e-3, 50.0, True, meaning="depth of the well"),
        Parameter("place_m", "m", None, 0.005, 0.02, meaning="position of the well"),
    ),
    starts=((1.0, 0.0135), (1.0, 0.0125)),
    mistaken_for=("dry_friction",),
    places=(bus.MECHANICS,),
    hook=hook,
    in_laboratory=False,
    remedy="Remove the magnet.",
)
'''
RATE, SURFACE = 2000.0, 0.010
VALUES = np.array([1.0, 0.0129])


@pytest.fixture(scope="module", autouse=True)
def _in_the_library(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("effects")
    (folder / f"{NAME}.py").write_text(DECLARATION, encoding="utf-8")
    effects.__path__.append(str(folder))
    all_effects.cache_clear()
    yield
    effects.__path__.remove(str(folder))
    all_effects.cache_clear()


@pytest.fixture(scope="module")
def session() -> Session:
    random = np.random.default_rng(5)
    command = 14.0 + 14.0 * np.convolve(random.uniform(-1, 1, 4000), np.ones(5) / 5, "same")
    acting = [ActiveEffect(effect(NAME), VALUES)]
    read = simulate(
        command, RATE, InstrumentParameters(weight_n=0.0), Tissue(SURFACE), Start(14.0 / 12.0, SURFACE), acting
    ).readings
    noise = random.standard_normal((3, command.size))
    signals = {
        "command": command,
        "voltage": read.voltage + 2e-3 * noise[0],
        "current": read.current + 1e-3 * noise[1],
        "position": read.position + 2e-6 * noise[2],
    }
    return Session(DeviceDescription(), tests=(Test(1, "stochastic", signals, RATE, surface_position_m=SURFACE),))


def test_it_is_listed_at_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "effects.json"
    assert main(["gap", "effects", "--json", str(out)]) == 0
    assert NAME in capsys.readouterr().out
    (found,) = [item for item in json.loads(out.read_text()) if item["effect"] == NAME]
    assert (found["stage"], found["title"], found["remedy"]) == ("mechanics", TITLE, "Remove the magnet.")
    assert [item["name"] for item in found["parameters"]] == ["force_n", "place_m"]


def test_it_is_simulated_at_once_and_in_pieces(session: Session):
    command = session.tests[0].signals["command"][:600]
    start, acting = Start(14.0 / 12.0, SURFACE), [ActiveEffect(effect(NAME), VALUES)]
    plain = simulate(command, RATE, InstrumentParameters(), Tissue(SURFACE), start).readings.position
    with_it = simulate(command, RATE, InstrumentParameters(), Tissue(SURFACE), start, acting).readings.position
    assert np.std(with_it - plain) > 0.05 * np.std(plain)
    player = Player(InstrumentParameters(), Tissue(SURFACE), start, acting, sample_rate_hz=RATE)
    pieces = np.concatenate([player.play(command[:250])[2], player.play(command[250:])[2]])
    assert np.std(pieces - with_it) < 0.02 * np.std(with_it - plain)


def test_a_diagnosis_names_it_and_page_report_and_score_show_it(qtbot, session: Session):
    found = diagnose(prepare(session), SerialExecutor(), candidates=[NAME, "dry_friction"])
    assert (found.verdict, found.combination) == ("effect", (NAME,))
    assert found.at_fault == ("mechanics",)
    parameters = found.ranking[0].parameters
    assert parameters["place_m"] == pytest.approx(VALUES[1], abs=1e-4)
    story = page_content_of(found, session)
    page = DiagnosisPage()
    qtbot.addWidget(page)
    page.show_story(story)
    assert TITLE in page.headline.text()
    assert "Remove the magnet." in story.todo
    assert [row.meaning for row in story.ranking[0].figures] == ["depth of the well", "position of the well"]
    assert TITLE in gap_html(found)
    label = Label((NAME,), ("mechanics",), (True,), False)
    score = score_of(with_labels({"one": as_answer(found)}, {"one": label}), SINGLE)
    assert next(rate.share for rate in score.rates if rate.what == "top-1") == 1.0
