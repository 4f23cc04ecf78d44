"""Waveforms from files are played sample for sample, scaled and offset; what is none is refused in one line."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coded import coded

from tissueid.acquisition import waveform_file
from tissueid.acquisition.stimulus_choice import (
    load_stimulus,
    playable_file,
    save_stimulus,
    stimulus_from_file,
    test_kind,
)
from tissueid.acquisition.waveform_file import load_waveform
from tissueid.cli import main
from tissueid.errors import UnusableInputError
from tissueid.procedures.test_plan import TestPlan
from tissueid.sessions import read_session
from tissueid.stimuli import Stimulus, get_stimulus, rebuild, stimulus_names
from tissueid.test_settings import FilePlayback

RATE = 2000.0
WAVE = 2.0 + np.sin(2.0 * np.pi * 5.0 * np.arange(2000) / RATE)


def written(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def npy(values: Any, **options: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, values, **options)
    return file.getvalue()


def column(values: np.ndarray) -> str:
    return "".join(f"{value!r}\n" for value in values.tolist())


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.txt", column(WAVE)),
        ("a.csv", "# made for a test\nforce\n" + column(WAVE)),
        ("a.csv", "Time (s),Force (N)\n" + "".join(f"{k / RATE:.6f},{v!r}\n" for k, v in enumerate(WAVE.tolist()))),
        ("a.csv", "t,F\n" + "".join(f"{k / RATE:.6f},{v!r}\n" for k, v in enumerate(WAVE.tolist()))),
        ("a.csv", "".join(f"{k / RATE:.4f};{v!r}\n".replace(".", ",") for k, v in enumerate(WAVE.tolist()))),
        ("a.tsv", "".join(f"{k / RATE:.4f}\t{v!r}\n" for k, v in enumerate(WAVE.tolist()))),
        ("a.npy", npy(WAVE)),
        ("a.npy", npy(np.column_stack([np.arange(2000) / RATE, WAVE]))),
        ("a.npy", npy(np.asfortranarray(np.column_stack([np.arange(2000) / RATE, WAVE])))),
    ],
)
def test_samples_are_those_of_the_file(tmp_path: Path, name: str, content: str | bytes):
    played = load_waveform(written(tmp_path / name, content), RATE)
    np.testing.assert_allclose(played.values, WAVE, rtol=0, atol=1e-12)
    assert played.description["samples"] == 2000
    assert played.start_value == pytest.approx(2.0)


def test_scale_and_offset_and_the_preload_at_the_first_sample(tmp_path: Path):
    path = written(tmp_path / "a.txt", column(WAVE))
    played = playable_file(path, RATE, FilePlayback(scale=-0.5, offset=6.0))
    assert isinstance(played, Stimulus)
    np.testing.assert_allclose(played.values[1000:], 6.0 - 0.5 * WAVE, atol=1e-12)
    assert played.values[999] == pytest.approx(5.0)
    assert test_kind(played) == "stochastic"
    assert json.loads(json.dumps(played.description))["stimulus"]["scale"] == -0.5


@pytest.mark.parametrize("rate", [500.0, 1000.0, 8000.0, 44100.0])
def test_another_rate_is_resampled(tmp_path: Path, rate: float):
    seconds = 1.0
    time = np.arange(round(seconds * rate)) / rate
    path = written(tmp_path / "a.npy", npy(3.0 + np.sin(2.0 * np.pi * 5.0 * time)))
    played = load_waveform(path, RATE, file_rate_hz=rate)
    assert len(played) == pytest.approx(seconds * RATE, abs=1)
    expected = 3.0 + np.sin(2.0 * np.pi * 5.0 * np.arange(len(played)) / RATE)
    np.testing.assert_allclose(played.values[100:-100], expected[100:-100], atol=0.01)


def test_a_file_of_samples_that_the_command_wrote_is_read_again(tmp_path: Path):
    path = tmp_path / "noise.csv"
    assert main(["stimulus", "noise", "--seconds", "0.5", "--max-force", "8", "--csv", str(path)]) == 0
    built = get_stimulus("noise").from_options({"seconds": 0.5, "force_max_n": 8.0}).build()
    np.testing.assert_array_equal(load_waveform(path, RATE).values, built.values)


REFUSED = {
    "not finite": ("a.txt", "1\nnan\n2\n", {}, "waveform.cell"),
    "infinite": ("a.txt", "1\ninf\n2\n", {}, "waveform.cell"),
    "not finite, npy": ("a.npy", npy(np.array([1.0, np.nan])), {}, "waveform.not_finite"),
    "a gap": ("a.csv", "1,2\n,3\n", {}, "waveform.cell"),
    "words": ("a.csv", "force\n1\ntwo\n", {}, "waveform.cell"),
    "time in ms": ("a.csv", "t (ms),F\n0,1\n1,2\n2,3\n", {}, "waveform.unit"),
    "force in mN": ("a.csv", "force_mN\n1\n2\n", {}, "waveform.unit"),
    "voltage": ("a.csv", "time_s;voltage_V\n0;1\n1;2\n", {}, "waveform.unit"),
    "unknown unit": ("a.csv", "Time [s],Force [units of 2 N]\n0,1\n1,2\n", {}, "waveform.unit"),
    "three columns": ("a.csv", "1,2,3\n4,5,6\n", {}, "waveform.columns"),
    "ragged": ("a.csv", "1,2\n3\n", {}, "waveform.columns"),
    "empty": ("a.csv", "", {}, "waveform.short"),
    "one sample": ("a.csv", "1\n", {}, "waveform.short"),
    "not text": ("a.csv", b"\xff\xfe\x00\x01", {}, "waveform.not_text"),
    "objects": ("a.npy", npy(np.array([{}, 1], dtype=object), allow_pickle=True), {}, "waveform.npy_type"),
    "complex": ("a.npy", npy(np.array([1j, 2.0])), {}, "waveform.npy_type"),
    "cube": ("a.npy", npy(np.zeros((3, 3, 3))), {}, "waveform.npy_shape"),
    "three columns, npy": ("a.npy", npy(np.zeros((9, 3))), {}, "waveform.npy_shape"),
    "cut off": ("a.npy", npy(WAVE)[:-9], {}, "waveform.npy"),
    "claims too much": ("a.npy", npy(WAVE).replace(b"(2000,), ", b"(400000,)"), {}, "waveform.npy"),
    "no shape": ("a.npy", npy(WAVE).replace(b"(2000,)", b"(9e9,) "), {}, "waveform.npy"),
    "no scalar": ("a.npy", npy(np.float64(1.0)), {}, "waveform.npy"),
    "not npy": ("a.npy", "1\n2\n", {}, "waveform.npy"),
    "uneven times": ("a.csv", "0,1\n1,1\n3,1\n", {}, "waveform.times"),
    "falling times": ("a.csv", "2,1\n1,1\n0,1\n", {}, "waveform.times"),
    "two rates": ("a.csv", "0,1\n1,1\n", {"file_rate_hz": 1000.0}, "waveform.two_rates"),
    "slow": ("a.csv", "0,1\n9,1\n", {}, "waveform.rate"),
    "too long at the instrument's rate": ("a.npy", npy(np.zeros(5000)), {"file_rate_hz": 1.0}, "waveform.samples"),
    "huge": ("a.csv", "1\n1e300\n", {}, "waveform.magnitude"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_waveform_is_refused_in_a_line(tmp_path: Path, case: str):
    name, content, options, code = REFUSED[case]
    with pytest.raises(UnusableInputError, check=coded(code)) as caught:
        load_waveform(written(tmp_path / name, content), RATE, **options)
    assert "\n" not in str(caught.value)


def test_files_that_are_too_large_or_not_there_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(UnusableInputError, check=coded("file.missing")):
        load_waveform(tmp_path / "none.csv", RATE)
    with pytest.raises(UnusableInputError, check=coded("file.not_readable")):
        load_waveform(tmp_path, RATE)
    monkeypatch.setattr(waveform_file, "_MAX_BYTES", 100)
    with pytest.raises(UnusableInputError, check=coded("waveform.large")):
        load_waveform(written(tmp_path / "a.txt", column(WAVE)), RATE)
    monkeypatch.undo()
    monkeypatch.setattr(waveform_file, "MAX_SAMPLES", 100)
    with pytest.raises(UnusableInputError, check=coded("waveform.samples")):
        load_waveform(tmp_path / "a.txt", RATE)


def saved(path: Path, kind: str = "noise", **options: Any) -> Path:
    specification = get_stimulus(kind).from_options({"seconds": 0.5, **options})
    save_stimulus(path, specification if kind == "rtig" else specification.build())  # type: ignore[attr-defined]
    return path


def test_a_saved_stimulus_is_scaled_saved_and_scaled_again(tmp_path: Path):
    path = saved(tmp_path / "a.json", force_max_n=8.0, seed=4)
    first = load_stimulus(path)
    assert isinstance(first, Stimulus)
    half = stimulus_from_file(path, RATE, FilePlayback(scale=0.5, offset=1.0))
    assert isinstance(half, Stimulus)
    np.testing.assert_allclose(half.values, 0.5 * first.values + 1.0)
    np.testing.assert_array_equal(rebuild(json.loads(json.dumps(half.description))).values, half.values)
    save_stimulus(tmp_path / "b.json", half)
    again = stimulus_from_file(tmp_path / "b.json", RATE, FilePlayback(scale=2.0))
    assert isinstance(again, Stimulus)
    np.testing.assert_allclose(again.values, first.values + 2.0)
    assert again.description["stimulus"]["type"] == "noise"
    ramp = saved(tmp_path / "ramp.json", "slow_ramp", force_min_n=1.0, force_max_n=4.0)
    scaled = playable_file(ramp, RATE, FilePlayback(scale=2.0))
    assert isinstance(scaled, Stimulus)
    assert scaled.values[999] == pytest.approx(2.0)
    assert test_kind(scaled) == "slow_ramp"


def test_what_cannot_be_scaled_or_saved_is_refused(tmp_path: Path):
    feedback = saved(tmp_path / "rtig.json", "rtig")
    with pytest.raises(UnusableInputError, check=coded("scaled.feedback")):
        stimulus_from_file(feedback, RATE, FilePlayback(scale=2.0))
    with pytest.raises(UnusableInputError, check=coded("stimulus.file_rate")):
        stimulus_from_file(feedback, RATE, FilePlayback(file_rate_hz=1000.0))
    waveform = load_waveform(written(tmp_path / "a.txt", column(WAVE)), RATE)
    with pytest.raises(UnusableInputError, check=coded("stimulus.waveform_saved")):
        save_stimulus(tmp_path / "w.json", waveform)
    with pytest.raises(UnusableInputError, check=coded("stimulus.waveform_samples")):
        rebuild(waveform.description)
    with pytest.raises(UnusableInputError, check=coded("scaled.nested")):
        rebuild({"type": "scaled", "stimulus": {"type": "scaled", "stimulus": {"type": "noise"}}})
    assert not {"waveform", "scaled"} & set(stimulus_names())


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"scale": 2.0}, "plan.file_options"),
        ({"stimulus_file": Path("a.csv"), "scale": float("nan")}, "option.refused"),
        ({"stimulus_file": Path("a.csv"), "offset": 1e9}, "option.refused"),
        ({"stimulus_file": Path("a.csv"), "file_rate_hz": -1.0}, "option.refused"),
        ({"stimulus_file": Path("a.csv"), "max_force_n": 5.0}, "plan.saved_stimulus"),
        ({"stimulus": "waveform"}, "plan.from_file"),
    ],
)
def test_a_plan_is_checked_before_an_instrument_is_opened(options: dict[str, Any], code: str):
    with pytest.raises(UnusableInputError, check=coded(code)):
        TestPlan(url="simulated://spring", site="bench", out=Path("s.h5"), **options).check()


def test_the_command_plays_a_waveform_within_the_limits(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = written(tmp_path / "a.csv", column(WAVE))
    command = ["test", "--device", "simulated://spring?seed=3", "--site", "bench", "--no-calibration"]
    out = tmp_path / "s.h5"
    asked = [*command, "--out", str(out), "--stimulus-file", str(path)]
    assert main([*asked, "--scale", "9"]) == 2
    assert "27" in capsys.readouterr().err
    assert list(tmp_path.glob("*.h5*")) == []
    assert main([*asked, "--scale", "1.5", "--offset", "1"]) == 0
    test = read_session(out).test()
    volts_per_newton = test.signals["command"][1100] / (1.5 * WAVE[100] + 1.0)
    np.testing.assert_allclose(test.signals["command"][1000:], volts_per_newton * (1.5 * WAVE + 1.0), rtol=1e-5)
    assert test.stimulus["stimulus"]["file"] == "a.csv"


def test_the_stimulus_command_checks_a_waveform(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = written(tmp_path / "a.csv", column(WAVE))
    assert main(["stimulus", str(path), "--scale", "2", "--json", "-"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["force_max_n"] == pytest.approx(6.0)
    assert main(["stimulus", str(path), "--scale", "20"]) != 0
    assert main(["stimulus", "noise", "--scale", "2"]) == 2
    assert "--scale" in capsys.readouterr().err
