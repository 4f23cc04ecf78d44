"""Finding instruments: serial ports, simulated firmware that is running, and the simulation in this process."""

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
from tissueid.instrument.driver import SerialInstrument
from tissueid.instrument.interface import Instrument
from tissueid.instrument.link import SerialLink
from tissueid.instrument.tissues import TISSUES
from tissueid.instrument.twin_list import SUFFIX
from tissueid.wording import clean

IN_PROCESS = "simulated://"
DEFAULT_TISSUE = "forearm"
_SEED_DIGITS = 18
_STARTED = 19
"""Place of a process' start among the fields that follow its name (proc(5))."""
_SHOWN = 80
"""Characters of an address that a message repeats."""


@dataclass(frozen=True)
class Found:
    """A place where an instrument is, or may be."""

    url: str
    what: str
    answers: bool | None
    """True: it shook hands. False: something is there that did not. None: not asked."""
    detail: str = ""
    name: str = ""
    """What to call it where people choose: model and serial number of what answered, else what seems to be there."""


def open_instrument(url: str) -> Instrument:
    """Open what a URL names: a serial port, ``socket://host:port``, or ``simulated://TISSUE?seed=N``.

    A simulated tissue is the same in every test with a seed, and differs from test to test without.
    ``simulated:///PATH/twin.toml?seed=N`` plays a twin that a diagnosis left (``gap accept``).

    Raises:
        InstrumentError, ProtocolVersionError, UnusableInputError: nothing there that can be used.
    """
    if url.startswith(IN_PROCESS):
        return _simulation(url)
    if not url.strip():
        raise UnusableInputError("say which instrument; 'tissueid devices' lists them")
    return SerialInstrument(SerialLink(url))


def _simulation(url: str) -> Instrument:
    """The simulation in this process that a URL names.

    Raises:
        UnusableInputError: it names none, or asks for something else than a seed.
    """
    # The twin is compiled code, which takes longer to import than all the rest of the instruments.
    from tissueid.instrument.simulated import SimulatedInstrument
    from tissueid.instrument.twin_file import read_twin

    shown = clean(url)[:_SHOWN]
    try:
        parts = urlsplit(url)
        query = parse_qs(parts.query, keep_blank_values=True)
    except ValueError as error:
        raise UnusableInputError(f"{shown} is no address: write simulated://TISSUE?seed=N") from error
    if unknown := set(query) - {"seed"}:
        raise UnusableInputError(f"{shown} asks for {clean(', '.join(sorted(unknown)))[:_SHOWN]}; there is only seed")
    given = query.get("seed", [None])[-1]
    if given is not None and not (given.isascii() and given.isdigit() and len(given) <= _SEED_DIGITS):
        raise UnusableInputError(f"the seed in {shown} must be a whole number of {_SEED_DIGITS} digits at most")
    seed = None if given is None else int(given)
    file = unquote(f"{parts.netloc}{parts.path}")
    if file.endswith(SUFFIX):
        return SimulatedInstrument(read_twin(Path(file)), seed=seed)
    if parts.path.strip("/") or parts.fragment:
        raise UnusableInputError(
            f"{shown} is neither a tissue nor a twin: write simulated://TISSUE ({', '.join(TISSUES)}), or "
            f"simulated:///PATH/NAME{SUFFIX}"
        )
    return SimulatedInstrument(parts.netloc or DEFAULT_TISSUE, seed=seed)


def find_instruments(*, probe: bool = True, opener: Callable[[str], Instrument] = open_instrument) -> list[Found]:
    """Everything that looks like an instrument; with ``probe`` each port is asked to shake hands."""
    candidates = [
        (note["url"], f"simulated firmware, {note['preset']}", f"simulated firmware, {note['serial_number']}")
        for note in _simulated_notes()
    ]
    for port in list_ports.comports():
        what = port.description or "serial port"
        candidates.append((port.device, what, what if what != "n/a" else "serial port"))
    found = []
    for url, what, name in candidates:
        if not probe:
            found.append(Found(url, what, None, name=name))
            continue
        try:
            instrument = opener(url)
        except TissueIDError as error:
            found.append(Found(url, what, False, str(error), name))
            continue
        device = instrument.device
        instrument.close()
        name = f"{device.model}, {device.serial_number}"
        found.append(Found(url, what, True, f"{name}, firmware {device.firmware_version}", name))
    what = "simulation in this process"
    found += [Found(f"{IN_PROCESS}{name}", what, True, name=f"simulation, {name}") for name in TISSUES]
    return found


def _simulated_notes() -> list[dict[str, Any]]:
    """What running simulators left of themselves; the notes of those that are dead are removed."""
    folder = user_cache_path("tissueid", appauthor=False) / "simulated"
    notes = []
    for path in sorted(folder.glob("*.json")) if folder.is_dir() else []:
        try:
            note = json.loads(path.read_text(encoding="utf-8"))
            pid = int(note["pid"])
            if not all(isinstance(note[name], str) for name in ("url", "preset", "serial_number")):
                continue
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            continue  # half-written or foreign: not a simulator
        if not _alive(pid, note.get("started")):
            with contextlib.suppress(OSError):
                path.unlink()
        elif pid != os.getpid():
            notes.append(note)
    return notes


def _alive(pid: int, started: object) -> bool:
    """Whether the process of that number is the one that began at that moment, in ticks since the computer did."""
    if not Path("/proc/self/stat").exists():
        return True  # cannot tell: the handshake will
    try:
        # The second field is the program's name in brackets, which may hold anything.
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        return started == int(fields[_STARTED])
    except (OSError, ValueError, IndexError):
        return False
