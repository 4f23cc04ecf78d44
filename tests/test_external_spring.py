"""Surface mechanics: the external spring parallel to the tissue is subtracted from all results."""

import json
from dataclasses import replace

import numpy as np
import pytest
from coded import coded, message, shows
from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test, usual_noise
from tissueid.acquisition.live import LiveIdentification
from tissueid.acquisition.surface_detection import place
from tissueid.analysis import analyse, analyse_all
from tissueid.cli import main
from tissueid.errors import UnusableInputError
from tissueid.instrument import SerialInstrument
from tissueid.reports import report_html
from tissueid.sessions import read_session, write_session
from tissueid.test_settings import TestSettings

SPRING = 800.0
RATE = 2000.0


@pytest.fixture(scope="module")
def sliding(tmp_path_factory):
    """A session of one test along the skin: the stroke lies, and the probe slides."""
    path = tmp_path_factory.mktemp("sliding") / "s.h5"
    link = LoopbackLink(Firmware(Bench("sliding-forearm", seed=5, tilt_deg=90.0), seed=5))
    with SerialInstrument(link, clock=link.clock) as instrument:
        recorder = SessionRecorder(path, instrument.device)
        settings = TestSettings(site="forearm", configuration="surface", external_spring_n_per_m=SPRING)
        stimulus = usual_noise(RATE, force_min_n=-4.0, force_max_n=4.0)
        test = GuidedTest(stimulus, settings)
        run_guided_test(instrument, test, recorder, surface_m=place(instrument))
        recorder.write()
    return path


def test_it_is_kept_with_the_test(sliding):
    test = read_session(sliding).test()
    assert test.configuration == "surface"
    assert test.notes["external_spring_n_per_m"] == SPRING
    assert test.notes["probe_name"] == "slider-5x16mm"


@pytest.mark.parametrize("engine", ["lms", "spectral"])
def test_sliding_has_no_stiffness_of_its_own(sliding, engine):
    analysis = analyse(read_session(sliding), engine)
    found = analysis.model.report.parameters["stiffness_n_per_m"]
    assert found.std is not None
    assert abs(found.value) < 3.0 * found.std
    assert abs(found.value) < 0.02 * SPRING
    assert analysis.model.report.parameters["mass_kg"].value == pytest.approx(0.068, rel=0.03)
    assert analysis.model.report.parameters["damping_n_s_per_m"].value == pytest.approx(12.5, rel=0.03)
    assert message(analysis.model.report.findings, "analysis.spring_subtracted").values["spring"] == 800.0


def test_the_profile_loses_it_too(sliding):
    session = read_session(sliding)
    analysis = analyse(session, "depth")
    whole, result = analysis.model.depth_profile(), analysis.depth_profile()
    np.testing.assert_allclose(result.stiffness, whole.stiffness - SPRING)
    np.testing.assert_array_equal(result.mass, whole.mass)
    assert abs(np.nanmedian(result.stiffness)) < 0.1 * SPRING


def test_without_a_spring_nothing_changes(sliding):
    session = read_session(sliding)
    bare = replace(session.test(), notes={})
    plain = analyse(replace(session, tests=(bare,)), "lms")
    result = analyse(session, "lms")
    assert plain.model.report.parameters["stiffness_n_per_m"].value - SPRING == pytest.approx(
        result.model.report.parameters["stiffness_n_per_m"].value
    )
    assert plain.external_spring_n_per_m == 0.0
    assert not any("spring" in line for line in plain.model.report.findings)


def test_other_signals_keep_theirs(sliding):
    analysis = analyse(read_session(sliding), "lms", input_name="command")
    assert analysis.external_spring_n_per_m == 0.0


def test_tests_that_differ_are_not_mixed(sliding):
    session = read_session(sliding)
    first = session.test()
    other = replace(first, number=2, notes={"external_spring_n_per_m": 500.0})
    with pytest.raises(UnusableInputError, check=coded("split.different_springs", one=800.0, other=500.0)):
        analyse(replace(session, tests=(first, other)), "lms", also=(2,))
    other = replace(first, number=2, configuration="indentation")
    with pytest.raises(
        UnusableInputError, check=coded("split.different_configurations", one="surface", other="indentation")
    ):
        analyse(replace(session, tests=(first, other)), "lms", validate=2)


def test_live_numbers_lose_it_too(sliding):
    test = read_session(sliding).test()
    samples = np.zeros(test.samples, [("index", "<u8"), ("current", "<f8"), ("position", "<f8")])
    samples["index"] = np.arange(test.samples)
    samples["current"], samples["position"] = test.signals["current"], test.signals["position"]
    device = read_session(sliding).instrument
    looks = {}
    for spring in (0.0, SPRING):
        live = LiveIdentification(device, preload_s=0.5, separate_process=False, external_spring_n_per_m=spring)
        live.feed(samples)
        live.close()
        looks[spring] = live.latest()
        assert live.latest() is live.latest()
    with_it, without = (looks[spring].parameters["stiffness"] for spring in (0.0, SPRING))
    assert with_it.value - SPRING == pytest.approx(without.value)
    assert abs(without.value) < 0.05 * SPRING
    assert looks[SPRING].course.values[-1, 2] == pytest.approx(looks[0.0].course.values[-1, 2] - SPRING)


def test_a_page_of_it_speaks_of_no_depth(sliding):
    session = read_session(sliding)
    page = report_html(session, {1: analyse_all(session)})
    assert "external spring of 800 N/m" in page
    assert "Recording: Good test" in page
    text = page[page.index("<main>") :]
    captions = [part.split("</figcaption>")[0] for part in text.split("<figcaption>")[1:]]
    assert captions
    assert not any("depth" in caption.lower() for caption in captions)
    assert "below the surface" not in text


def test_commands_say_so(sliding, tmp_path, capsys):
    answer = tmp_path / "a.json"
    assert main(["identify", str(sliding), "--engine", "lms", "--json", str(answer)]) == 0
    assert shows(capsys.readouterr().out, "analysis.spring_subtracted", spring=800.0)
    result = json.loads(answer.read_text())
    assert result["external_spring_n_per_m"] == SPRING
    assert abs(result["parameters"]["stiffness_n_per_m"]["value"]) < 0.02 * SPRING
    assert result["quality_warnings"] == []


def test_a_configuration_is_chosen_on_the_command_line(tmp_path, capsys):
    common = ["test", "--device", "simulated://spring", "--site", "x", "--seconds", "1"]
    out = tmp_path / "s.h5"
    options = ["--configuration", "surface", "--external-spring", "1000", "--max-force", "6"]
    assert main([*common, "--out", str(out), *options]) == 0
    assert read_session(out).test().notes["external_spring_n_per_m"] == 1000.0
    surface = ["--configuration", "surface", "--external-spring", "500", "--depth-range", "1:4"]
    for wrong, code, values in (
        (["--configuration", "surface"], "configuration.no_spring", {}),
        (["--probe", "thumb"], "configuration.unknown_probe", {"name": "thumb"}),
        (surface, "plan.no_depth", {"name": "surface"}),
    ):
        assert main([*common, "--out", str(tmp_path / "t.h5"), *wrong]) == 2
        assert shows(capsys.readouterr().err, code, **values)
    assert not (tmp_path / "t.h5").exists()


def test_a_session_without_these_notes_is_read_as_before(sliding, tmp_path):
    session = read_session(sliding)
    old = replace(session, tests=(replace(session.test(), notes={}, configuration="indentation"),))
    write_session(tmp_path / "old.h5", old)
    assert analyse(read_session(tmp_path / "old.h5"), "lms").external_spring_n_per_m == 0.0
