"""What a command asks of an instrument without a test."""

from __future__ import annotations

from tissueid.device import DeviceDescription
from tissueid.instrument import open_instrument


def described_device(url: str | None) -> DeviceDescription:
    """Return the device of a URL; None is the desktop device of the thesis.

    Raises:
        InstrumentError: there is no such instrument, or it does not answer.
    """
    if url is None:
        return DeviceDescription()
    instrument = open_instrument(url)
    try:
        return instrument.device
    finally:
        instrument.close()
