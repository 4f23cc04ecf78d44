"""Analogue cards by entry point: the example of docs/examples, and limits that no driver can loosen."""

import sys
import tomllib
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from coded import coded

from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.errors import FirmwareFaultError, InstrumentError, LimitError, LinkLostError
from tissueid.instrument import Limits, find_instruments, open_instrument
from tissueid.instrument.card import CardInstrument
from tissueid.sessions import read_session

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "example-card"
GENTLE = Limits(max_force_n=4.0)


@pytest.fixture
def example(tmp_path, monkeypatch):
    """The example package as an installation leaves it: its module, and its entry points beside it."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = tmp_path / "site" / "tissueid_example_card-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 1.0\n", encoding="utf-8")
    lines = [
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in items.items())
        for group, items in project["entry-points"].items()
    ]
    (info / "entry_points.txt").write_text("".join(lines), encoding="utf-8")
    monkeypatch.syspath_prepend(str(EXAMPLE))
    monkeypatch.syspath_prepend(str(info.parent))
    import example_card

    yield example_card
    sys.modules.pop("example_card", None)


def test_a_test_runs_on_an_installed_card(example, tmp_path):
    out = tmp_path / "s.h5"
    arguments = ["--stimulus", "noise", "--seconds", "1", "--max-force", "4"]
    assert main(["test", "--device", "example://", "--site", "left forearm", "--out", str(out), *arguments]) == 0
    session = read_session(out)
    test = session.test()
    assert (test.status, test.samples) == ("completed", 3000)
    assert session.instrument.serial_number == "CARD-1"
    assert np.ptp(test.signals["position"]) > 2e-4


def test_an_installed_card_is_listed(example):
    (found,) = [item for item in find_instruments(probe=False) if item.url == "example://"]
    assert found.answers is None


def test_a_driver_that_fails_to_open_is_one_line(example, capsys):
    assert main(["test", "--device", "example://7", "--site", "x", "--out", "x.h5"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()[-1:]
    assert "example_card:open_card" in line


def test_an_address_without_a_driver_is_a_port(example):
    with pytest.raises(InstrumentError, check=coded("link.not_opened")):
        open_instrument("another://")


class Recorded:
    """A card of the example that records whether its amplifier was enabled, and has one defect from a call on."""

    def __init__(self, example, change=lambda readings: readings, after=0, pressed=False):
        self.card = example.ExampleCard()
        self.device = self.card.device
        self.change, self.after, self.pressed = change, after, pressed
        self.enabled, self.disabled, self.calls = [], 0, count()

    def exchange(self, command_v, enabled):
        self.enabled += enabled.tolist()
        readings = self.card.exchange(command_v, enabled)
        return self.change(readings) if next(self.calls) > self.after else readings

    def button(self):
        return self.pressed

    def disable(self):
        self.disabled += 1

    def close(self):
        raise RuntimeError("a card that fails to close")


def play(card, volts=6.0, limits=GENTLE, polls=100, **options):
    instrument = CardInstrument(card, "card", **options)
    instrument.load(np.full(1000, volts))
    instrument.arm(limits)
    instrument.start()
    for _ in range(polls):
        instrument.poll(0.1)
    return instrument


def column(name, value):
    place = ("voltage", "current", "position", "temperature").index(name)

    def change(readings):
        readings[:, place] = value
        return readings

    return change


def failing(readings):
    raise OSError("unplugged")


@pytest.mark.parametrize(
    ("change", "error", "code"),
    [
        (column("current", 3.0), LimitError, "limit.force"),
        (column("position", 0.0319), LimitError, "limit.position"),
        (column("position", 0.02), InstrumentError, "sensor.position_jumps"),
        (column("temperature", 90.0), LimitError, "limit.temperature"),
        (column("current", 0.0), InstrumentError, "sensor.no_current"),
        (column("position", np.nan), InstrumentError, "card.readings"),
        (lambda readings: readings[:-1], InstrumentError, "card.readings"),
        (lambda readings: None, InstrumentError, "card.readings"),
        (failing, LinkLostError, "card.failed"),
    ],
)
def test_every_limit_and_failure_releases_the_coil(example, change, error, code):
    card = Recorded(example, change, after=20)
    with pytest.raises(error, check=coded(code)):
        play(card)
    assert any(card.enabled)
    assert card.disabled > 0


def test_after_a_release_the_amplifier_stays_off(example):
    card = Recorded(example, column("current", 3.0), after=20)
    instrument = CardInstrument(card, "card")
    instrument.load(np.full(1000, 6.0))
    instrument.arm(GENTLE)
    instrument.start()
    with pytest.raises(LimitError):
        for _ in range(100):
            instrument.poll(0.1)
    card.enabled.clear()
    instrument.poll(0.1)
    assert not any(card.enabled)


@pytest.mark.parametrize("volts", [40.0, np.nan, np.inf])
def test_a_stimulus_beyond_the_limits_is_refused_before_anything_is_driven(example, volts):
    card = Recorded(example)
    with pytest.raises(LimitError):
        play(card, volts)
    assert not any(card.enabled)


def test_a_pressed_button_prevents_and_ends_a_run(example):
    card = Recorded(example, pressed=True)
    with pytest.raises(FirmwareFaultError):
        play(card)
    assert not any(card.enabled)
    card = Recorded(example)
    instrument = play(card, polls=5)
    assert any(card.enabled)
    card.pressed = True
    with pytest.raises(FirmwareFaultError):
        instrument.poll(0.1)
    assert card.disabled > 0


def test_a_card_that_is_too_slow_is_released(example):
    card = Recorded(example)
    with pytest.raises(LinkLostError, check=coded("card.silent")):
        play(card, clock=count(step=0.3).__next__)
    assert card.disabled > 0


def test_a_run_begins_and_ends_softly_and_is_watched_to_its_end(example):
    card = Recorded(example)
    instrument = CardInstrument(card, "card")
    instrument.load(np.full(1000, 6.0))
    instrument.arm(GENTLE)
    run = instrument.start()
    samples = np.concatenate([instrument.poll(0.1) for _ in range(60)])
    command = samples["command"]
    assert run.first_index == 20
    assert np.abs(np.diff(command)).max() < 0.1
    assert sum(card.enabled) == 1100
    assert not any(card.enabled[-80:])
    instrument.close()


@pytest.mark.parametrize("device", [DeviceDescription(force_constant_n_per_a=float("nan")), None])
def test_impossible_properties_are_refused(example, device):
    card = Recorded(example)
    card.device = device
    with pytest.raises(InstrumentError, check=coded("card.property")):
        CardInstrument(card, "card")
    assert not card.enabled
