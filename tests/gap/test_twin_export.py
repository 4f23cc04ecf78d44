"""Named twins: written by a diagnosis, read with checks, simulated, and used by the next diagnosis."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
import tomli_w
from coded import coded, holding
from gap_records import with_friction

from tissueid.errors import UnusableInputError
from tissueid.gap import diagnosis
from tissueid.gap.decision import floor, score_candidate
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.fitting import fit
from tissueid.gap.twin_export import against_twin, check_same_instrument, twin_file_of, with_prior_twin
from tissueid.gap.workers import SerialExecutor
from tissueid.instrument import open_instrument
from tissueid.instrument.twin_file import device_of, read_twin, write_twin
from tissueid.instrument.twin_list import MOST_BYTES
from tissueid.messages import code_of
from tissueid.twin.catalogue import effect

NOW = datetime(2026, 3, 1, 9, 30, tzinfo=UTC)


@pytest.fixture(scope="module")
def observed():
    return with_friction(3000, weight_n=0.2, resistance_ohm=12.2)


@pytest.fixture(scope="module")
def accepted(observed):
    return score_candidate(fit(observed, [effect("dry_friction")]))


@pytest.fixture
def content(accepted):
    return twin_file_of(accepted, "arm", session_id="s", verdict="effect", closed=0.98, now=NOW)


def test_a_twin_comes_back_as_it_was_written(content, tmp_path):
    path = tmp_path / "arm.toml"
    write_twin(path, content)
    back = read_twin(path)
    assert back == content
    assert back.twin.effects == ("dry_friction",)
    assert back.created == "2026-03-01T09:30:00Z"


def test_a_twin_of_an_earlier_version_keeps_its_creeping_loops(content, tmp_path):
    (friction,) = content.effects
    assert friction.title == effect("dry_friction").title
    earlier = {name: value for name, value in friction.parameters.items() if name != "spread"} | {"bristle_share": 0.5}
    path = tmp_path / "arm.toml"
    write_twin(path, content.model_copy(update={"effects": (friction.model_copy(update={"parameters": earlier}),)}))
    (acting,) = read_twin(path).twin.acting
    values = dict(zip((item.name for item in acting.effect.parameters), acting.values, strict=True))
    assert (values["bristle_share"], values["spread"]) == (0.5, 1.0)
    assert values["coulomb_n"] == friction.parameters["coulomb_n"]


def test_it_holds_the_figures_with_their_uncertainty(content):
    assert content.instrument["resistance_ohm"] == pytest.approx(12.2, rel=0.003)
    assert 0.0 < content.stds["resistance_ohm"] < 0.1
    friction = content.effects[0]
    assert friction.parameters["coulomb_n"] == pytest.approx(0.25, rel=0.2)
    assert 0.0 < friction.stds["coulomb_n"] < 0.25


def test_the_next_version_says_what_it_improves(accepted, content):
    again = twin_file_of(accepted, "arm", before=content, now=NOW)
    assert again.version == 2
    assert again.source.improves == "arm, version 1"
    assert twin_file_of(accepted, "leg", before=content, now=NOW).version == 1


def test_a_saved_twin_provides_starting_values(observed, accepted, content):
    begun = with_prior_twin(observed, content.twin)
    quick = fit(begun, [effect("dry_friction")], most_steps=3)
    assert quick.cost < 1.05 * accepted.fit.cost
    assert quick.value("resistance_ohm") == pytest.approx(np.log(12.2 / 12.0), abs=0.003)


def test_what_the_instrument_is_known_to_be_is_kept_and_what_changes_with_the_temperature_is_refitted(
    observed, content
):
    priors = with_prior_twin(observed, content.twin).priors
    assert priors["moving_mass_kg"].std == pytest.approx(content.stds["moving_mass_kg"] / 0.06, rel=0.1)
    assert priors["resistance_ohm"].std == pytest.approx(0.02, rel=0.01)
    assert priors["tissue_stiffness_n_per_m"].std is None


def test_what_a_twin_leaves_unmodelled_is_part_of_the_floor_of_later_sessions(observed, accepted):
    bare = score_candidate(fit(observed))
    content = twin_file_of(bare, "bare")
    spread = observed.tests[0].spreads["position"]
    parts = [next(item for item in part if item.channel == "position") for part in (bare.chosen_by, bare.checked_by)]
    left = max(item.square - item.noise**2 for item in parts)
    assert content.unmodelled["position"] == pytest.approx(np.sqrt(left) / spread)
    assert content.unmodelled["position"] > 10.0 * twin_file_of(accepted, "arm").unmodelled["position"]
    later, known = against_twin(observed, content)
    assert known == ()
    again = score_candidate(fit(later))
    assert bare.score > 1.0
    assert again.score < 0.1
    assert floor(again.checked_by) > 5.0 * floor(bare.checked_by)
    improved = twin_file_of(again, "bare")
    assert improved.unmodelled["position"] == pytest.approx(content.unmodelled["position"], rel=0.1)


def test_a_gap_in_the_check_alone_is_none_against_a_twin(observed, content, monkeypatch):
    monkeypatch.setattr(diagnosis, "shows_in_the_check_alone", lambda _: True)
    later, known = against_twin(observed, content)
    found = diagnose(later, SerialExecutor(), accepted=known, candidates=["latency"])
    assert found.verdict == "no_gap"
    assert [code_of(remark) for remark in found.remarks] == ["gap.only_in_check"]


def test_a_twin_of_another_instrument_is_refused(observed, content):
    device = observed.instrument
    check_same_instrument(replace(device, serial_number="A1"), content)
    ours = content.model_copy(update={"source": content.source.model_copy(update={"serial_number": "B2"})})
    check_same_instrument(device, ours)
    check_same_instrument(replace(device, serial_number="TWIN-1"), ours)
    with pytest.raises(UnusableInputError, check=coded("gap.other_serial", ours="A1", theirs="B2")):
        check_same_instrument(replace(device, serial_number="A1"), ours)
    for other in ({"stroke_m": 0.02}, {"moving_mass_kg": 0.08}, {"amplifier_limit_v": 24.0}):
        with pytest.raises(UnusableInputError, check=coded("gap.other_instrument", name=next(iter(other)))):
            against_twin(replace(observed, instrument=replace(device, **other)), content)


def test_a_saved_twin_can_be_simulated(content, tmp_path):
    path = tmp_path / "arm.toml"
    write_twin(path, content)
    instrument = open_instrument(f"simulated://{path}?seed=3")
    try:
        samples = instrument.poll(0.0)
        assert np.isfinite(samples["position"]).all()
        assert instrument.device.coil_resistance_ohm == pytest.approx(12.2, rel=0.003)
        assert "arm, version 1" in instrument.device.model
    finally:
        instrument.close()


def test_its_simulation_reports_its_filter(content):
    filtered = content.model_copy(update={"instrument": content.instrument | {"filter_time_s": 8e-5}})
    assert device_of(filtered).filter_time_s == pytest.approx(8e-5)
    assert device_of(content).filter_time_s == content.instrument["filter_time_s"] == 0.0


def _with(content, *path, value):
    plain = content.model_dump(mode="python", exclude_none=True)
    inner = plain
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return plain


@pytest.mark.parametrize(
    ("path", "value", "code"),
    [
        (("format",), "tissueid-calibration", "twin.format"),
        (("instrument", "resistance_ohm"), -1.0, "twin.out_of_range"),
        (("instrument", "resistance_ohm"), float("nan"), "option.finite"),
        *((("instrument", "filter_time_s"), seconds, "twin.out_of_range") for seconds in (-1.0, 5e-324, 10.0)),
        (("tissue", "stiffness_n_per_m"), 1e9, "twin.out_of_range"),
        (("tissue", "hair_m"), 1.0, "twin.unknown"),
        (("sample_rate_hz",), 1.0, "twin.too_stiff"),
        (("effects", 0, "name"), "witchcraft", "twin.unknown_effect"),
        (("effects", 0, "parameters", "coulomb_n"), 1e6, "twin.out_of_range"),
        (("effects", 0, "parameters", "secret"), 1.0, "twin.field"),
        (("name",), "../../etc/passwd", "twin.field"),
        (("version",), 0, "option.least"),
        (("extra",), 1, "option.extra"),
    ],
)
def test_an_invalid_twin_file_is_refused(content, tmp_path, path, value, code):
    file = tmp_path / "odd.toml"
    file.write_text(tomli_w.dumps(_with(content, *path, value=value)), encoding="utf-8")
    with pytest.raises(UnusableInputError, check=holding(code)) as refused:
        read_twin(file)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("data", [b"\xff\xfe\x00", b"a = [", b"x" * (MOST_BYTES + 1), b""])
def test_rubbish_is_not_a_twin(tmp_path, data):
    file = tmp_path / "rubbish.toml"
    file.write_bytes(data)
    with pytest.raises(
        UnusableInputError, check=lambda error: error.code in ("twin.no_toml", "twin.format", "twin.too_large")
    ):
        read_twin(file)


def test_other_files_are_not_overwritten(content, tmp_path):
    file = tmp_path / "notes.toml"
    file.write_text("a = 1\n")
    with pytest.raises(UnusableInputError, check=coded("twin.exists", path=str(file))):
        write_twin(file, content)
    assert file.read_text() == "a = 1\n"
