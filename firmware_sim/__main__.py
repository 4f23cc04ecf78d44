"""``tissueid-firmware-sim``: run the simulated instrument as a separate process."""

from __future__ import annotations

import argparse
import errno
import gc
import json
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from platformdirs import user_cache_path

from firmware_sim.coil import coil_profile, profile_values
from firmware_sim.effects import EFFECTS
from firmware_sim.firmware import Firmware
from firmware_sim.presets import preset_names
from firmware_sim.scenario import Scenario, load_scenario
from firmware_sim.server import Port, PseudoTerminal, Server, TcpPort

_EXAMPLE = """a scenario with an effect for a diagnosis to find; format: docs/simulated-instrument.md:
  preset = "left-posterior-forearm"
  [effects.dry_friction]
  level = 0.3
"""


def _port(text: str) -> int:
    number = int(text)
    if not 0 <= number <= 65535:
        raise ValueError
    return number


def _effect(text: str) -> tuple[str, dict[str, float]]:
    name, _, level = text.partition("=")
    if name not in EFFECTS:
        raise argparse.ArgumentTypeError(f"there is no effect {name!r}; there are: {', '.join(EFFECTS)}")
    if not level:
        return name, {"level": EFFECTS[name].typical}
    try:
        return name, {"level": float(level)}
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"the level of {name} must be a number in {EFFECTS[name].unit}, not {level!r}"
        ) from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tissueid-firmware-sim",
        description="Simulated indenter on a serial port or TCP port. Research use only.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--pty", action="store_true", help="serve on a pseudo-terminal (default if available)")
    where.add_argument("--tcp", type=_port, metavar="PORT", help="serve on 127.0.0.1:PORT; 0 selects a free port")
    parser.add_argument("--scenario", type=Path, metavar="FILE", help="TOML file: preset, seed, speed, effects, faults")
    parser.add_argument("--preset", help="tissue under the probe; see --list")
    parser.add_argument("--seed", type=int, help="seed of the sensor noise")
    parser.add_argument("--speed", type=float, help="device seconds per second, 1 is real time")
    parser.add_argument("--rate", type=float, metavar="HZ", help="samples a second, 500 to 10000; 2000 by default")
    parser.add_argument("--serial-number", dest="serial_number")
    parser.add_argument("--model", help="device: desktop (default) or handheld")
    parser.add_argument("--tilt", type=float, metavar="DEG", help="angle between the stroke and straight down")
    parser.add_argument("--coil", help="force constant along the stroke: ideal (default) or finite")
    parser.add_argument("--probe", metavar="NAME", help="round probe: a name, or DIAMETER:CORNER in mm")
    parser.add_argument("--lotion", metavar="NAME", help="lotion on the skin: chanel or vaseline")
    parser.add_argument(
        "--orientation",
        type=float,
        metavar="DEG",
        help="extension: angle to the limb's axis; 90 is horizontal",
    )
    parser.add_argument("--initial-length", type=float, metavar="MM", help="extension: length between the faces")
    parser.add_argument(
        "--normal-preload",
        type=float,
        metavar="N",
        help="sliding: force on the skin, and dry friction in its proportion",
    )
    parser.add_argument(
        "--variation",
        type=float,
        nargs="?",
        const=1.0,
        metavar="SIZE",
        help="let skin vary between placings and tests: 1 (default) as people's skin does, 0 not at all",
    )
    parser.add_argument(
        "--subject", type=int, metavar="N", help="number of the person under the probe; see --variation"
    )
    parser.add_argument(
        "--hide",
        action="append",
        default=[],
        type=_effect,
        metavar="EFFECT[=LEVEL]",
        help="add an effect to the plant, to be found by a diagnosis; repeat for a second one",
    )
    parser.add_argument("--list", action="store_true", help="list the presets and exit")
    parser.add_argument(
        "--local-values",
        type=float,
        metavar="POSITION",
        help="print the true mass, damping and stiffness of the plant at a position in metres, as JSON, and exit",
    )
    parser.add_argument(
        "--coil-profile",
        action="store_true",
        help="print the true force constant of the coil along the stroke and its linear region, as JSON, and exit",
    )
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status."""
    options = _parser().parse_args(arguments)
    if options.list:
        print("\n".join(preset_names()))
        return 0
    try:
        scenario = load_scenario(
            options.scenario,
            preset=options.preset,
            seed=options.seed,
            speed=options.speed,
            serial_number=options.serial_number,
            sample_rate_hz=options.rate,
            model=options.model,
            tilt_deg=options.tilt,
            coil=options.coil,
            probe=options.probe,
            lotion=options.lotion,
            orientation_deg=options.orientation,
            initial_length_m=None if options.initial_length is None else 1e-3 * options.initial_length,
            normal_preload_n=options.normal_preload,
            variation=options.variation,
            subject=options.subject,
            effects=dict(options.hide) or None,
        )
        if options.local_values is not None:
            from firmware_sim.local_values import local_values

            print(json.dumps(local_values(scenario.tissue, options.local_values, scenario.real)))
            return 0
        if options.coil_profile:
            print(json.dumps(_profile(scenario)))
            return 0
        return _serve(scenario, options.tcp)
    except (ValueError, OSError) as error:
        number = error.errno if isinstance(error, OSError) else None
        words = os.strerror(number) if number else str(error)
        port = f" (port {options.tcp})" if number == errno.EADDRINUSE else ""
        print(f"tissueid-firmware-sim: {words}{port}", file=sys.stderr)
        return 2


def _profile(scenario: Scenario) -> dict[str, object]:
    real = scenario.real
    profile = coil_profile(scenario.coil, real.stroke_m)
    return {"coil": scenario.coil} | profile_values(profile, real.force_constant_n_per_a, real.stroke_m)


def _serve(scenario: Scenario, tcp_port: int | None) -> int:
    print("preparing the plant (compiled on first use) ...", file=sys.stderr, flush=True)
    # Objects created by numba are permanent. Each garbage collection over them takes up to 60 ms, which a real device
    # does not have, and delays the start.
    gc.disable()
    try:
        bench = scenario.bench()
        bench.warm_up()
        gc.freeze()
    finally:
        gc.enable()
    firmware = Firmware(bench, scenario.identity(), seed=scenario.seed)
    port: Port
    if tcp_port is None and sys.platform != "win32":
        port = PseudoTerminal()
    else:
        port = TcpPort(tcp_port or 0)
    stopping: list[int] = []
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda number, _frame: stopping.append(number))
    notice = _announce(port.url, scenario)

    def announce(url: str) -> None:
        _announce(url, scenario)
        print(url, flush=True)

    print(port.url, flush=True)
    server = Server(firmware, port, scenario, announce)
    try:
        server.run(until=lambda: bool(stopping))
    finally:
        if server.stopped_s > 0.0:
            print(
                f"this computer was too slow: the device's clock was stopped for {server.stopped_s:.3f} s",
                file=sys.stderr,
            )
        notice.unlink(missing_ok=True)
        port.unplug()
    return 0


def _announce(url: str, scenario: Scenario) -> Path:
    """Write a file for the host's device discovery, in place of the entry of a USB device in the list of ports."""
    folder = user_cache_path("tissueid", appauthor=False) / "simulated"
    folder.mkdir(parents=True, exist_ok=True)
    notice = folder / f"{os.getpid()}.json"
    note = {
        "url": url,
        "pid": os.getpid(),
        "started": _started(),
        "preset": scenario.preset,
        "serial_number": scenario.serial_number,
    }
    notice.write_text(json.dumps(note), encoding="utf-8")
    return notice


def _started() -> int | None:
    """Return the start time of this process in clock ticks since boot, which distinguishes reused process ids; None if
    unknown.
    """
    try:
        return int(Path("/proc/self/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return None


if __name__ == "__main__":
    sys.exit(main())
