"""Finding instruments: serial ports, simulated firmware that is running, and the simulation in this process."""

from __future__ import annotations

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

IN_PROCESS = "simulated://"


@dataclass(frozen=True)
class Found:
    """A place where an instrument is, or may be."""

    url: str
    what: str
    answers: bool | None
    """True: it shook hands. False: something is there that did not. None: not asked."""
    detail: str = ""


def open_instrument(url: str) -> Instrument:
    """Open what a URL names: a serial port, ``socket://host:port``, or ``simulated://TISSUE?seed=N``.

    ``simulated:///PATH/twin.toml?seed=N`` plays a twin that a diagnosis left (``gap accept``).

    Raises:
        InstrumentError, ProtocolVersionError, UnusableInputError: nothing there that can be used.
    """
    if url.startswith(IN_PROCESS):
        # The twin is compiled code, which takes longer to import than all the rest of the instruments.
        from tissueid.instrument.simulated import SimulatedInstrument
        from tissueid.instrument.twin_file import SUFFIX, read_twin

        parts = urlsplit(url)
        query = parse_qs(parts.query)
        if unknown := set(query) - {"seed"}:
            raise UnusableInputError(f"{url} asks for {', '.join(sorted(unknown))}; there is only seed")
        seed = query.get("seed", ["0"])[0]
        if not seed.isdigit():
            raise UnusableInputError(f"the seed in {url} must be a whole number")
        file = unquote(f"{parts.netloc}{parts.path}")
        if file.endswith(SUFFIX):
            return SimulatedInstrument(read_twin(Path(file)), seed=int(seed))
        return SimulatedInstrument(parts.netloc or "forearm", seed=int(seed))
    if not url.strip():
        raise UnusableInputError("say which instrument; 'tissueid devices' lists them")
    return SerialInstrument(SerialLink(url))


def find_instruments(*, probe: bool = True, opener: Callable[[str], Instrument] = open_instrument) -> list[Found]:
    """Everything that looks like an instrument; with ``probe`` each port is asked to shake hands."""
    candidates = [(note["url"], f"simulated firmware, {note['preset']}") for note in _simulated_notes()]
    candidates += [(port.device, port.description or "serial port") for port in list_ports.comports()]
    found = []
    for url, what in candidates:
        if not probe:
            found.append(Found(url, what, None))
            continue
        try:
            instrument = opener(url)
        except TissueIDError as error:
            found.append(Found(url, what, False, str(error)))
            continue
        device = instrument.device
        instrument.close()
        detail = f"{device.model}, {device.serial_number}, firmware {device.firmware_version}"
        found.append(Found(url, what, True, detail))
    found += [Found(f"{IN_PROCESS}{name}", "simulation in this process", True) for name in TISSUES]
    return found


def _simulated_notes() -> list[dict[str, Any]]:
    """What running simulators left of themselves; notes of dead ones are passed over."""
    folder = user_cache_path("tissueid", appauthor=False) / "simulated"
    notes = []
    for path in sorted(folder.glob("*.json")) if folder.is_dir() else []:
        try:
            note = json.loads(path.read_text(encoding="utf-8"))
            if _alive(int(note["pid"])) and isinstance(note["url"], str) and isinstance(note["preset"], str):
                notes.append(note)
        except (OSError, ValueError, KeyError, TypeError):
            continue  # half-written or foreign: not a simulator
    return notes


def _alive(pid: int) -> bool:
    if not Path("/proc").is_dir():
        return True  # cannot tell: the handshake will
    return Path(f"/proc/{pid}").is_dir() and pid != os.getpid()
