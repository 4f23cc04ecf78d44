"""Discovery of instruments: serial ports, running simulated firmware, and simulations in this process."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from platformdirs import user_cache_path
from serial.tools import list_ports

from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.formatting import clean
from tissueid.instrument.card import card_schemes, open_card
from tissueid.instrument.driver import SerialInstrument
from tissueid.instrument.interface import Instrument
from tissueid.instrument.link import SerialLink
from tissueid.instrument.tissues import TISSUES
from tissueid.instrument.twin_list import SUFFIX
from tissueid.language import marked
from tissueid.messages import Action, Message, Verbatim, joined

IN_PROCESS = "simulated://"
DEFAULT_TISSUE = "forearm"
_SEED_DIGITS = 18
_LARGEST_VARIATION = 3.0
"""Largest size of the variation between tests, relative to that of skin."""
_START_FIELD = 19
"""Index of the start time among the fields after the process name (proc(5))."""
_SHOWN = 80
"""Maximum number of characters of an address in a message."""
_SIMULATION = Message("discovery.simulation", "simulation in this process")


@dataclass(frozen=True)
class FoundInstrument:
    """Address with a known or possible instrument."""

    url: str
    what: str
    """Kind of instrument or port."""
    answers: bool | None
    """True: the handshake succeeded. False: it failed. None: not tried."""
    detail: str = ""
    """Model, serial number and firmware of an instrument that answered, or the reason why it did not."""
    name: str = ""
    """Name for lists: model and serial number of an instrument that answered, else the kind of port."""


def open_instrument(url: str) -> Instrument:
    """Open the instrument at an address: a serial port, ``socket://host:port``, ``simulated://TISSUE?seed=N``, or the
    scheme of an installed driver (:mod:`tissueid.instrument.card`).

    With a seed, a simulated instrument always gives the same measurements. ``simulated:///PATH/twin.toml?seed=N``
    simulates a named twin (``gap accept``). ``subject=N`` is another person's skin, and ``variation=SIZE`` scales the
    variation between tests and adds the lasting compression by the first test.

    Raises:
        InstrumentError, ProtocolVersionError, UnusableInputError: there is no usable instrument at the address.
    """
    if url.startswith(IN_PROCESS):
        return _simulation(url)
    if not url.strip():
        raise UnusableInputError(
            "discovery.no_address",
            "the address of the instrument is empty: {choose}",
            choose=Action("instrument.list", "tissueid devices", marked("choose one in the list of instruments")),
        )
    return open_card(url) or SerialInstrument(SerialLink(url))


def _simulation(url: str) -> Instrument:
    """Open the simulation at an address.

    Raises:
        UnusableInputError: the tissue or a parameter is unknown.
    """
    # Imported here: the compiled code of the twin takes longer to import than all other instruments.
    from tissueid.instrument.simulated import SimulatedInstrument
    from tissueid.instrument.twin_file import read_twin

    shown = clean(url)[:_SHOWN]
    try:
        parts = urlsplit(url)
        query = parse_qs(parts.query, keep_blank_values=True)
    except ValueError as error:
        raise UnusableInputError(
            "simulation.address", "{address} is not an address: write simulated://TISSUE?seed=N", address=shown
        ) from error
    if unknown := set(query) - {"seed", "subject", "variation"}:
        raise UnusableInputError(
            "simulation.parameter",
            "{address} has the unknown parameter {names}; known: seed, subject, variation",
            address=shown,
            names=clean(", ".join(sorted(unknown)))[:_SHOWN],
        )
    seed, subject = _whole_number(query, "seed", shown), _whole_number(query, "subject", shown)
    variation = _variation(query, shown)
    file = unquote(f"{parts.netloc}{parts.path}")
    if file.endswith(SUFFIX):
        return SimulatedInstrument(read_twin(Path(file)), seed=seed, subject=subject, variation=variation)
    if parts.path.strip("/") or parts.fragment:
        raise UnusableInputError(
            "simulation.path",
            "{address} is neither a tissue nor a twin: write simulated://TISSUE ({known}), or "
            "simulated:///PATH/NAME{suffix}",
            address=shown,
            known=joined(map(Verbatim, TISSUES)),
            suffix=SUFFIX,
        )
    return SimulatedInstrument(parts.netloc or DEFAULT_TISSUE, seed=seed, subject=subject, variation=variation)


def _whole_number(query: dict[str, list[str]], name: str, shown: str) -> int | None:
    """Return a parameter of an address, or None without it.

    Raises:
        UnusableInputError: it is not a whole number, or too long.
    """
    given = query.get(name, [None])[-1]
    if given is None:
        return None
    if not (given.isascii() and given.isdigit() and len(given) <= _SEED_DIGITS):
        raise UnusableInputError(
            "simulation.seed",
            "the {name} in {address} must be a whole number of at most {digits} digits",
            name=Verbatim(name),
            address=shown,
            digits=_SEED_DIGITS,
        )
    return int(given)


def _variation(query: dict[str, list[str]], shown: str) -> float | None:
    """Return the size of the variation between tests, or None without it.

    Raises:
        UnusableInputError: it is not between 0 and 3.
    """
    given = query.get("variation", [None])[-1]
    if given is None:
        return None
    try:
        size = float(given)
    except ValueError:
        size = -1.0
    if not 0.0 <= size <= _LARGEST_VARIATION:
        raise UnusableInputError(
            "simulation.variation",
            "the variation in {address} must be a number from 0 to {most:g}",
            address=shown,
            most=_LARGEST_VARIATION,
        )
    return size


def find_instruments(
    *, probe: bool = True, opener: Callable[[str], Instrument] = open_instrument
) -> list[FoundInstrument]:
    """Return all addresses where an instrument is or may be. With ``probe``, try the handshake on each port."""
    candidates: list[tuple[str, str, str]] = [
        (
            note["url"],
            Message("discovery.firmware", "simulated firmware, {name}", name=Verbatim(note["preset"])),
            Message("discovery.firmware", "simulated firmware, {name}", name=Verbatim(note["serial_number"])),
        )
        for note in _running_simulators()
    ]
    for port in list_ports.comports():
        described = port.description and port.description != "n/a"
        what: str = Verbatim(port.description) if described else Message("discovery.port", "serial port")
        candidates.append((port.device, what, what))
    instruments = []
    for url, what, name in candidates:
        if not probe:
            instruments.append(FoundInstrument(url, what, None, name=name))
            continue
        try:
            instrument = opener(url)
        except TissueIDError as error:
            instruments.append(FoundInstrument(url, what, False, error.message, name))
            continue
        device = instrument.device
        instrument.close()
        name = Verbatim(f"{device.model}, {device.serial_number}")
        detail = Message("discovery.answered", "{name}, firmware {version}", name=name, version=device.firmware_version)
        instruments.append(FoundInstrument(url, what, True, detail, name))
    for scheme, driver in sorted(card_schemes().items()):
        what = Message("discovery.card", "driver {name}", name=Verbatim(driver.value))
        instruments.append(FoundInstrument(f"{scheme}://", what, None, name=what))
    for tissue in TISSUES:
        name = Message("discovery.simulated_tissue", "simulation, {tissue}", tissue=Verbatim(tissue))
        instruments.append(FoundInstrument(f"{IN_PROCESS}{tissue}", _SIMULATION, True, name=name))
    return instruments


def _running_simulators() -> list[dict[str, Any]]:
    """Return the notes of running simulators, and remove the notes of those that ended."""
    folder = user_cache_path("tissueid", appauthor=False) / "simulated"
    notes = []
    for path in sorted(folder.glob("*.json")) if folder.is_dir() else []:
        try:
            note = json.loads(path.read_text(encoding="utf-8"))
            pid = int(note["pid"])
            if not all(isinstance(note[name], str) for name in ("url", "preset", "serial_number")):
                continue
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            continue  # incomplete, or not the note of a simulator
        if not _alive(pid, note.get("started")):
            with contextlib.suppress(OSError):
                path.unlink()
        elif pid != os.getpid():
            notes.append(note)
    return notes


def _alive(pid: int, started: object) -> bool:
    """Return whether process ``pid`` runs and started at ``started``, in ticks after the start of the computer."""
    if not Path("/proc/self/stat").exists():
        return True  # unknown: the handshake decides
    try:
        # The second field is the name of the program in brackets, with any characters.
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        return started == int(fields[_START_FIELD])
    except (OSError, ValueError, IndexError):
        return False
