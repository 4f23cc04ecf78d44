"""A saved stimulus comes back sample for sample, and what is not one is refused in a line."""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coded import coded

from tissueid.acquisition.stimulus_choice import load_stimulus, save_stimulus
from tissueid.errors import UnusableInputError
from tissueid.stimuli import Stimulus, get_stimulus, with_preload

NOISE = {"seconds": 0.5, "force_min_n": 0.5, "force_max_n": 7.5, "seed": 9}
PRELOAD = "stimulus.preload_description"
SHORT: dict[str, dict[str, Any]] = {
    "noise": NOISE | {"distribution": "uniform"},
    "interchange": {"seconds": 0.5, "spectrum": "band", "lags": 50, "tolerance": 0.01},
    "multisine": {"period_s": 0.25, "periods": 2, "notches": [[40.0, 60.0]]},
    "designed": {"seconds": 0.5},
}


def saved(tmp_path: Path, **changes: Any) -> Path:
    """A file with a change: a value of None takes the entry out."""
    path = tmp_path / "stimulus.json"
    save_stimulus(path, get_stimulus("noise").from_options(NOISE).build())
    content = json.loads(path.read_text())
    content |= changes
    path.write_text(json.dumps({name: value for name, value in content.items() if value is not None}))
    return path


@pytest.mark.parametrize("kind", SHORT)
def test_every_kind_comes_back_sample_for_sample(tmp_path: Path, kind: str):
    path = tmp_path / "stimulus.json"
    built = get_stimulus(kind).from_options(SHORT[kind]).build()
    save_stimulus(path, built)
    again = load_stimulus(path)
    assert isinstance(again, Stimulus)
    np.testing.assert_array_equal(again.values, built.values)
    assert (again.description, again.seed, again.unit) == (built.description, built.seed, built.unit)


def test_a_preload_and_volts_come_back_too(tmp_path: Path):
    kind = get_stimulus("noise").from_options({"seconds": 0.5, "voltage_min_v": 2.0, "voltage_max_v": 12.0})
    built = with_preload(kind.build(), preload_s=0.2)
    path = tmp_path / "stimulus.json"
    save_stimulus(path, built)
    again = load_stimulus(path)
    assert isinstance(again, Stimulus)
    np.testing.assert_array_equal(again.values, built.values)
    assert (again.preload_s, again.unit) == (0.2, "V")


def test_what_is_generated_while_a_test_runs_comes_back_as_its_specification(tmp_path: Path):
    kind = get_stimulus("rtig").from_options({"seconds": 2.0, "depth_max_m": 0.003, "seed": 5})
    path = tmp_path / "stimulus.json"
    save_stimulus(path, kind)
    assert load_stimulus(path) == kind
    assert json.loads(path.read_text())["sha256"] is None


def test_the_file_says_what_it_is_and_holds_no_samples(tmp_path: Path):
    built = get_stimulus("noise").from_options(NOISE).build()
    path = tmp_path / "stimulus.json"
    save_stimulus(path, built)
    content = json.loads(path.read_text())
    assert (content["format"], content["format_version"]) == ("tissueid-stimulus", "1.0")
    assert (content["samples"], content["sample_rate_hz"], content["unit"]) == (1000, 2000.0, "N")
    assert content["sha256"] == hashlib.sha256(b"".join(v.tobytes() for v in built.values.astype("<f8"))).hexdigest()
    assert path.stat().st_size < 4000
    assert [file.name for file in tmp_path.iterdir()] == ["stimulus.json"]


def test_nothing_is_ever_written_over(tmp_path: Path):
    path = saved(tmp_path)
    before = path.read_bytes()
    with pytest.raises(UnusableInputError, check=coded("stimulus.exists", path=str(path))):
        save_stimulus(path, get_stimulus("noise").from_options(NOISE).build())
    assert path.read_bytes() == before
    with pytest.raises(UnusableInputError, check=coded("file.no_folder")):
        save_stimulus(tmp_path / "no" / "a.json", get_stimulus("noise").from_options(NOISE).build())
    with pytest.raises(UnusableInputError, check=coded("file.is_folder")):
        save_stimulus(tmp_path, get_stimulus("noise").from_options(NOISE).build())


def described(**options: Any) -> dict[str, Any]:
    return {"type": "noise"} | NOISE | options


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"format": "picture"}, "stimulus.not_one"),
        ({"format_version": "2.0"}, "stimulus.version"),
        ({"format_version": 1}, "stimulus.version"),
        ({"description": None}, "stimulus.no_description"),
        ({"description": [1, 2]}, "stimulus.no_description"),
        ({"description": {}}, "stimulus.no_type"),
        ({"description": {"type": "whistle"}}, "no stimulus 'whistle'"),
        ({"description": described(colour="red")}, "option 'colour'"),
        ({"description": described(seconds=1e9)}, "option 'seconds'"),
        ({"description": described(seconds=600.0, sample_rate=1e6)}, "stimulus.samples"),
        ({"description": described(cutoff_hz=5000.0)}, "spectrum.nyquist"),
        ({"description": {"type": "multisine", "period_samples": 2**20, "periods": 500}}, "stimulus.samples|may last"),
        (
            {"description": {"type": "guided", "preload_s": "x", "stimulus": described()}},
            PRELOAD,
        ),
        ({"description": {"type": "guided", "preload_s": 0.5, "stimulus": [1]}}, PRELOAD),
        (
            {"description": {"type": "guided", "preload_s": 1e9, "stimulus": described()}},
            "the preload must last .* up to 60 s",
        ),
        ({"description": {"type": "guided", "preload_s": 10**400, "stimulus": described()}}, "the preload must last"),
        ({"description": {"type": "guided", "preload_s": 0.5, "stimulus": {"type": "rtig"}}}, "stimulus.own_preload"),
        ({"description": described(cutoff_hz=1e-4)}, "spectrum.low_cutoff"),
        (
            {"description": {"type": "guided", "preload_s": 0.5, "stimulus": {"type": "guided"}}},
            PRELOAD,
        ),
        ({"description": described(seed=10)}, "stimulus.differs"),
        ({"sha256": "0" * 64}, "stimulus.differs"),
        ({"sha256": None}, "stimulus.differs"),
        ({"samples": 999}, "stimulus.figures"),
        ({"unit": "V"}, "stimulus.figures"),
    ],
)
def test_an_invalid_file_is_refused_in_one_line(tmp_path: Path, changes: dict[str, Any], said: str):
    with pytest.raises(UnusableInputError) as raised:
        load_stimulus(saved(tmp_path, **changes))
    assert raised.value.code == said or re.search(said, str(raised.value))
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 1000


@pytest.mark.parametrize(
    "data",
    [b"", b"rubbish", b"\x89HDF\r\n\x1a\n", b"[1, 2]", b'{"format": "tissueid-stimulus"', b"[" * 50_000, b"1" * 5000],
)
def test_rubbish_is_refused(tmp_path: Path, data: bytes):
    path = tmp_path / "stimulus.json"
    path.write_bytes(data)
    with pytest.raises(UnusableInputError) as raised:
        load_stimulus(path)
    assert raised.value.code in ("stimulus.damaged", "stimulus.not_one")


def test_a_huge_file_a_missing_one_and_a_folder_are_refused(tmp_path: Path):
    path = tmp_path / "stimulus.json"
    with path.open("wb") as file:
        file.truncate(10**9)
    with pytest.raises(UnusableInputError, check=coded("stimulus.too_large", most=4)):
        load_stimulus(path)
    with pytest.raises(UnusableInputError, check=coded("file.missing", path=str(tmp_path / "none.json"))):
        load_stimulus(tmp_path / "none.json")
    with pytest.raises(UnusableInputError, check=coded("file.not_readable", path=str(tmp_path))):
        load_stimulus(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_a_pipe_is_not_waited_for(tmp_path: Path):
    os.mkfifo(tmp_path / "s.json")
    with pytest.raises(UnusableInputError, check=coded("file.not_readable")):
        load_stimulus(tmp_path / "s.json")
