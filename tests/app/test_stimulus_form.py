"""Every stimulus that the command line plays can be chosen in the window, with the same result."""

import json

import numpy as np
import pytest
from app.benches import WAIT_MS
from app.test_window import idle, press
from coded import begins

from tissueid.app.stimulus_form import FROM_FILE, MULTISTEP, StimulusForm
from tissueid.cli import main
from tissueid.instrument import SimulatedInstrument
from tissueid.procedures.test_plan import LARGE_CLIPPED, LARGE_N
from tissueid.sessions import read_session
from tissueid.stimuli import get_stimulus, stimulus_names


@pytest.fixture
def form(fresh_window):
    fresh_window.ui.form.site.setEditText("material sample")
    return fresh_window.ui.form


def run(qtbot, window):
    """Run the test of the form to its end, and read its session."""
    form = window.ui.form
    path = form.folder / "made.h5"
    form.take_chosen_path(path)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert path.exists(), window.ui.notice.text.text()
    return read_session(path)


def test_every_kind_is_offered_and_its_usual_options_make_a_plan(form):
    form.stimulus.offer_all()
    box = form.stimulus.kind
    offered = {box.itemData(place) for place in range(box.count())}
    assert offered == {*stimulus_names(), MULTISTEP, FROM_FILE}
    assert all(get_stimulus(name).title for name in stimulus_names())
    for name in stimulus_names():
        form.stimulus.fill(name)
        plan = form.plan()
        plan.check()
        assert plan.specification(2000.0).name == name
        assert form.summary.text()


def test_fields_of_other_kinds_are_hidden(form):
    form.fold.setChecked(True)
    assert form.stimulus.controls["distribution"].isVisible()
    form.stimulus.fill("quiet")
    assert "distribution" not in form.stimulus.controls
    assert not form.options["max_force_n"].isVisible()
    form.stimulus.fill(FROM_FILE)
    assert form.stimulus.file.isVisible()
    assert not form.options["seconds"].isVisible()


@pytest.mark.parametrize("kind", ["interchange", "rtig"])
def test_a_test_of_the_form_plays_what_the_command_line_plays(qtbot, open_window, tmp_path, kind):
    window = open_window(opener=lambda _: SimulatedInstrument("spring", seed=3))
    form = window.ui.form
    form.site.setEditText("bench")
    form.stimulus.fill(kind)
    form.fill({"seconds": 1.5})
    form.fill({"seed": 7})
    made = run(qtbot, window)
    command = ["test", "--device", "simulated://spring?seed=3", "--site", "bench", "--out", str(tmp_path / "cli.h5")]
    low, high = form.options["min_force_n"].value(), form.options["max_force_n"].value()
    options = ["--stimulus", kind, "--seconds", "1.5", "--seed", "7", "--min-force", str(low), "--max-force", str(high)]
    assert main([*command, *options, "--no-calibration"]) == 0
    known = read_session(tmp_path / "cli.h5")
    ours, theirs = made.test(), known.test()
    assert ours.kind == theirs.kind
    assert ours.samples == theirs.samples
    assert np.array_equal(ours.signals["command"], theirs.signals["command"])


def test_a_saved_stimulus_a_stop_rule_and_steps(qtbot, open_window, tmp_path):
    window = open_window(opener=lambda _: SimulatedInstrument("spring", seed=3))
    form = window.ui.form
    form.site.setEditText("bench")
    saved = tmp_path / "ramp.json"
    assert (
        main(["stimulus", "slow_ramp", "--seconds", "2", "--min-force", "0.5", "--max-force", "6", "--out", str(saved)])
        == 0
    )
    assert json.loads(saved.read_text())["format"] == "tissueid-stimulus"
    form.stimulus.fill(FROM_FILE)
    form.stimulus.file.setText(str(saved))
    assert run(qtbot, window).test().kind == "slow_ramp"

    (tmp_path / "made.h5").unlink()
    form.stimulus.fill("noise")
    form.fill({"seconds": 6.0})
    form.stimulus.stop_when.setText("stiffness=0.2")
    stopped = run(qtbot, window).test()
    assert stopped.status == "completed"
    assert stopped.samples < 5.5 * 2000

    (tmp_path / "made.h5").unlink()
    form.stimulus.fill(MULTISTEP, {"steps": 2, "depth_min_m": 1e-3, "depth_max_m": 3e-3, "target": 0.001})
    form.fill({"seconds": 1.5})
    steps = run(qtbot, window)
    assert [test.notes["multistep"] for test in steps.tests] == [1.0, 2.0]


def test_what_is_under_the_probe_is_the_kind_of_the_test(qtbot, open_window):
    window = open_window(opener=lambda _: SimulatedInstrument("spring", seed=3))
    form = window.ui.form
    form.fill({"site": "bench", "under_probe": "spring", "seconds": 0.5})
    assert run(qtbot, window).test().kind == "spring"
    form.stimulus.fill(MULTISTEP)
    assert form.options["kind"].isHidden()
    assert form.plan().kind is None


def test_in_free_air_no_surface_is_sought(qtbot, open_window, tmp_path):
    window = open_window(opener=lambda _: SimulatedInstrument("spring", seed=3))
    form = window.ui.form
    form.fill({"site": "bench", "under_probe": "free_air", "seconds": 0.5})
    press(qtbot, window.ui.start)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert begins(window.ui.notice.text.text(), "placing.not_level")
    assert not list(tmp_path.glob("*.h5"))


def test_filling_a_kind_restores_its_usual_options(form):
    form.stimulus.fill("step_hold", {"rise_s": 0.5})
    form.stimulus.fill("step_hold")
    assert dict(form.plan().options)["rise_s"] == 0.01


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (FROM_FILE, lambda form: None),
        ("noise", lambda form: form.stimulus.stop_when.setText("colour=0.1")),
        (MULTISTEP, lambda form: form.stimulus.controls["depth_min_m"].set_value(0.02)),
    ],
)
def test_what_cannot_be_played_is_said_before_an_instrument_is_touched(qtbot, window, bench, kind, change):
    form = window.ui.form
    form.site.setEditText("material sample")
    form.stimulus.fill(kind)
    change(form)
    press(qtbot, window.ui.start)
    assert not window.busy
    assert window.ui.notice.isVisible()
    assert bench.opened == []


def enabled(form, name):
    place = form.preset.findData(name)
    return form.preset.model().item(place).isEnabled()


def choose(form, name):
    form.preset.setCurrentIndex(form.preset.findData(name))
    form.preset.activated.emit(form.preset.currentIndex())


def test_presets_fill_the_form_and_other_settings_are_ones_own(form):
    assert form.preset.currentData() == "standard"
    assert form.plan().options == ()
    choose(form, "thesis")
    plan = form.plan()
    plan.check()
    assert (plan.min_force_n, plan.max_force_n, plan.seconds, plan.lower_force) == (*LARGE_N, 4.0, False)
    assert dict(plan.options) == {"clipped": LARGE_CLIPPED}
    assert form.preset.currentData() == "thesis"
    form.fill({"seconds": 6.0})
    assert form.preset.currentData() == ""
    choose(form, "depths")
    assert form.preset.currentData() == "depths"
    assert form.stimulus.depths.isVisible()
    form.stimulus.controls["depth_max_m"].set_value(0.003)
    plan = form.plan()
    assert plan.stimulus == "rtig"
    assert plan.specification(2000.0).depth_max_m == 0.003
    choose(form, "standard")
    assert (form.options["min_force_n"].value(), form.options["max_force_n"].value()) == (0.5, 10.5)
    assert form.plan().lower_force
    assert not form.stimulus.depths.isVisible()


def test_the_thesis_test_is_offered_where_the_force_allows_it(form):
    assert enabled(form, "thesis")
    assert form.not_offered.isHidden()
    form.tell_force(form.instrument.url, 7.8)
    assert not enabled(form, "thesis")
    assert form.not_offered.isVisible()
    assert enabled(form, "standard")
    assert form.preset.currentData() == "standard"


def test_noise_shows_the_options_that_apply(form):
    form.fold.setChecked(True)
    options = form.stimulus.controls
    assert options["cutoff_hz"].isVisible()
    assert not options["natural_hz"].isVisible()
    options["spectrum"].set_value("second_order")
    form.stimulus.update_shown()
    assert options["natural_hz"].isVisible()
    assert not options["cutoff_hz"].isVisible()
    assert dict(form.plan().options) == {"spectrum": "second_order"}
    form.fill({"distribution": "quantiles"})
    assert options["quantiles"].isVisible()
    assert not options["clipped"].isVisible()


def test_forces_below_zero_stay_within_the_limits(form):
    form.fill({"min_force_n": -50.0})
    assert form.options["min_force_n"].value() == -12.0
    form.tell_force(form.instrument.url, 7.8)
    assert form.options["min_force_n"].value() == -7.8


def test_a_waveform_scaled_and_repeated(qtbot, open_window, tmp_path):
    window = open_window(opener=lambda _: SimulatedInstrument("spring", seed=3))
    form = window.ui.form
    form.site.setEditText("bench")
    saved = tmp_path / "wave.csv"
    wave = 2.0 + np.sin(np.arange(1000) / 50.0)
    np.savetxt(saved, wave)
    form.stimulus.fill(FROM_FILE, {"scale": 2.0, "offset": 1.0})
    form.stimulus.file.setText(str(saved))
    form.fold.setChecked(True)
    assert form.stimulus.controls["file_rate_hz"].isVisible()
    form.fill({"repeats": 2})
    assert form.options["rest_s"].isVisible()
    session = run(qtbot, window)
    assert [test.repeat_of for test in session.tests] == [None, 1]
    command = session.test().signals["command"][1000:]
    np.testing.assert_allclose(command / command[0], (2.0 * wave + 1.0) / (2.0 * wave[0] + 1.0), rtol=1e-5)
    form.stimulus.file.setText("saved.json")
    assert not form.stimulus.controls["file_rate_hz"].isVisible()


def test_a_localized_test_shows_its_levels(qtbot, open_window):
    window = open_window(opener=lambda _: SimulatedInstrument("baseline", seed=3))
    window.ui.form.site.setEditText("bench")
    window.ui.form.stimulus.fill("stepped_noise", {"levels": 3, "level_s": 0.6})
    run(qtbot, window)
    assert "localized" in window.findings.analyses
    assert len(window.findings.plots.impulse.curves) == 5


def test_a_stop_rule_is_typed_in_words_and_percent(qtbot):
    form = StimulusForm()
    qtbot.addWidget(form)
    for typed, expected in (
        ("stiffness 2 %", ("stiffness=0.02",)),
        ("Stiffness 2,5%; mass = 3 %", ("stiffness=0.025", "mass=0.03")),
        ("stiffness=0.2, mass=0.1", ("stiffness=0.2", "mass=0.1")),
        ("fast", ("fast",)),
        ("", ()),
    ):
        form.stop_when.setText(typed)
        assert form.values()["stop_when"] == expected
