"""Messages of instruments in German."""

import errno

import numpy as np
import pytest

from tissueid.app.words import in_words
from tissueid.device import DeviceDescription
from tissueid.errors import LinkLostError, TissueIDError
from tissueid.instrument import Limits, ReplayInstrument, open_instrument
from tissueid.instrument.limits import check_samples
from tissueid.instrument.link import broken_error, open_error
from tissueid.instrument.replies import FAULT_TEXTS, describe_faults, refusal, released_by_faults
from tissueid.language import set_language
from tissueid.messages import translated
from tissueid.wire import Fault, MessageType, Result


@pytest.fixture(autouse=True)
def german():
    set_language("de")
    yield
    set_language("en")


def raised_by(call):
    with pytest.raises(TissueIDError) as caught:
        call()
    return caught.value


def test_every_fault_has_a_german_condition_and_remedy():
    for fault in [item for item in Fault if item] + [Fault.NONE, Fault(1024)]:
        assert translated(describe_faults(fault)) != describe_faults(fault)
    for text in FAULT_TEXTS.values():
        assert translated(text.condition) != text.condition
        assert translated(text.remedy) != text.remedy


def test_an_error_with_a_fault_is_german_as_a_whole():
    assert in_words(released_by_faults(Fault.OVER_FORCE | Fault.BUTTON)) == (
        "Das Gerät gab die Spule frei: die Kraft ging über ihre Grenze: Wählen Sie eine schwächere Anregung; "
        "die Taste wurde gedrückt: Lassen Sie sie los, dann messen Sie noch einmal."
    )


def test_every_refusal_of_the_firmware_is_german():
    for result in [item for item in Result if item is not Result.OK] + [99]:
        for kind in (MessageType.START, MessageType.FOLLOW, MessageType.FINISH):
            error = refusal(kind, result, int(Fault.STARVED))
            assert translated(error.message) != error.message


@pytest.mark.parametrize(
    "error",
    [
        broken_error("COM3", OSError("the other end returned no data")),
        broken_error("COM3", TypeError()),
        open_error("COM3", OSError(errno.EAGAIN, "")),
        open_error("spy://x", ValueError("odd")),
    ],
)
def test_an_error_of_a_link_is_german(error):
    assert translated(error.message).startswith(
        ("die Verbindung zu COM3 brach ab: ", f"{error.message.values['port']} ")
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda: Limits(max_force_n=-1.0),
        lambda: open_instrument(""),
        lambda: open_instrument("simulated://moon"),
        lambda: open_instrument("simulated://forearm?speed=2"),
        lambda: open_instrument("simulated://forearm?seed=x"),
        lambda: ReplayInstrument(DeviceDescription(), {"mood": np.zeros(3)}),
        lambda: ReplayInstrument(DeviceDescription(), {"position": np.zeros(3)}).start(),
    ],
)
def test_an_error_before_a_test_is_german(call):
    error = raised_by(call)
    assert translated(error.message) != error.message


def test_a_lost_link_with_its_watchdog_is_german():
    from support import connect

    instrument = connect()
    instrument.link.to_host = lambda data: b""
    with pytest.raises(LinkLostError) as caught:
        while True:
            instrument.poll(0.05)
    assert in_words(caught.value) == (
        "Loopback schwieg 1 s lang. Prüfen Sie Kabel und Strom, und verbinden Sie neu. Der Watchdog des Geräts gibt "
        "die Spule innerhalb von 0,5 s frei."
    )


def test_a_limit_is_german_with_its_numbers():
    samples = open_instrument("simulated://spring").poll(0.0)
    samples["temperature"] = 81.0
    error = raised_by(lambda: check_samples(samples, DeviceDescription(), Limits(), None))
    assert in_words(error) == "Die Spule hat 81 °C; die Grenze ist 80 °C: Lassen Sie sie abkühlen."
