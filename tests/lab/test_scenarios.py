"""Scenarios of the simulated laboratory: read, refused, and sealed."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from gap_records import DEVICE, scenario

from firmware_sim.laboratory.scenario_generation import draw_scenario, write
from tissueid.errors import UnusableInputError
from tissueid_lab.blind_check.answers import LABELS, alone_sessions, read_scenario, scenario_names, seal, unseal
from tissueid_lab.blind_check.scoring import Label

NAME = "scenario-0001"


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenarios") / "sealed"
    write([scenario("dry_friction")], folder, clean=True)
    return folder


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenarios") / "full"
    write([scenario("", 4, full=True)], folder)
    return folder


@pytest.fixture
def folder(written: Path, tmp_path: Path) -> Path:
    for path in written.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_a_scenario_is_read_as_it_was_recorded(written: Path):
    assert scenario_names(written) == [NAME]
    read, truth = read_scenario(written, NAME), scenario("dry_friction").record()[0]
    assert read.instrument == DEVICE
    assert [test.kind for test in read.tests] == ["stochastic"]
    for name, values in read.tests[0].signals.items():
        assert np.array_equal(values, getattr(truth, name))
    assert read.tests[0].surface_position_m == truth.surface_m
    assert read.tests[0].preload_s == 0.5


def test_a_full_session_has_its_tests_and_repeats(full: Path):
    read = read_scenario(full, NAME)
    assert [test.kind for test in read.tests] == [
        "quiet", "stochastic", "stochastic", "stochastic", "slow_ramp", "spring"
    ]  # fmt: skip
    assert [test.repeat_of for test in read.tests] == [None, None, 2, None, None, None]


def test_clean_companions_have_no_noise(written: Path):
    noisy, clean = read_scenario(written, NAME), read_scenario(written, NAME, "clean")
    bare = read_scenario(written, NAME, "base")
    off = noisy.tests[0].signals["current"] - clean.tests[0].signals["current"]
    assert 0.8e-3 < np.std(off) < 1.1e-3
    assert not np.allclose(clean.tests[0].signals["position"], bare.tests[0].signals["position"], atol=1e-5)


def test_of_a_pair_each_effect_is_recorded_alone_as_well(written: Path, tmp_path: Path):
    assert alone_sessions(written, NAME) == []
    drawn = draw_scenario(7, effects=2)
    write([drawn], tmp_path / "pair", clean=True)
    alone = alone_sessions(tmp_path / "pair", NAME)
    assert len(alone) == 2
    for item, session in zip(drawn.effects, alone, strict=True):
        (recording,) = drawn.record(effects=(item,))
        np.testing.assert_array_equal(session.tests[0].signals["position"], recording.position)


def test_sessions_do_not_contain_the_label(written: Path):
    assert "dry_friction" not in (written / f"{NAME}.json").read_text()


def test_labels_hold_the_true_effects(written: Path, full: Path):
    assert unseal(written)[NAME] == Label(("dry_friction",), ("mechanics",), (True,), False)
    assert unseal(full)[NAME].effects == ()
    assert unseal(full)[NAME].full


def test_the_hash_changes_with_the_labels(folder: Path):
    sealed = seal(folder)
    assert sealed == hashlib.sha256((folder / LABELS).read_bytes()).hexdigest()
    assert seal(folder) == sealed
    labels = (folder / LABELS).read_text()
    (folder / LABELS).write_text(labels.replace("dry_friction", "wet_friction"))
    assert seal(folder) != sealed


def without(folder: Path, suffix: str) -> None:
    (folder / f"{NAME}{suffix}").unlink()


def rubbish(folder: Path) -> None:
    (folder / f"{NAME}.json").write_bytes(b"\xff\x00rubbish")


def a_list(folder: Path) -> None:
    (folder / f"{NAME}.json").write_text("[]")


def edited(folder: Path, **values: object) -> None:
    path = folder / f"{NAME}.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def cut(folder: Path) -> None:
    path = folder / f"{NAME}.f64"
    path.write_bytes(path.read_bytes()[:1000])


@pytest.mark.parametrize(
    "spoil",
    [
        lambda folder: without(folder, ".json"),
        lambda folder: without(folder, ".f64"),
        rubbish,
        a_list,
        cut,
        lambda folder: edited(folder, tests=[{}]),
        lambda folder: edited(folder, tests=3),
        lambda folder: edited(folder, instrument="none"),
    ],
)
def test_rubbish_is_refused(folder: Path, spoil):
    spoil(folder)
    with pytest.raises(UnusableInputError):
        read_scenario(folder, NAME)


@pytest.mark.parametrize("content", ["", "[]", "{", '{"scenario-0001": {}}', '{"scenario-0001": 3}'])
def test_invalid_labels_are_refused(folder: Path, content: str):
    (folder / LABELS).write_text(content)
    with pytest.raises(UnusableInputError):
        unseal(folder)


def test_without_labels_nothing_is_sealed(tmp_path: Path):
    with pytest.raises(UnusableInputError, match="no labels"):
        seal(tmp_path)
    with pytest.raises(UnusableInputError):
        unseal(tmp_path)
    assert scenario_names(tmp_path) == []
