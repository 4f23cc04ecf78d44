"""Build of the reference firmware with the compilers that are installed; ``make firmware`` runs it.

Objects are kept by the content of what they are compiled from, so that a second build takes no time.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from platformdirs import user_cache_path

from firmware_sim.reference.bounds import TIMINGS, BoundError, bounds_of, words
from firmware_sim.reference.tools import MissingToolError, tool

SOURCES = Path(__file__).parent
CORE = SOURCES / "core"
BOARDS = SOURCES / "boards"

WARNINGS = (
    *("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wdouble-promotion"),
    *("-Wstrict-prototypes", "-Wmissing-prototypes", "-Wvla", "-ffp-contract=off"),
)
SANITIZERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


@dataclass(frozen=True)
class Target:
    """A board: its folder, the compilers that can build it (the first found is used), and their options."""

    name: str
    compilers: tuple[str, ...]
    options: tuple[str, ...]
    link_options: tuple[str, ...]
    extra: tuple[str, ...] = ()
    """Files of other boards, relative to ``boards``."""


POSIX = Target("posix", ("cc", "gcc", "clang"), ("-O2",), ("-lm",))
_CORTEX_M7 = (
    *("-O2", "-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16", "-ffunction-sections"),
    "-Wstack-usage=1024",
)
_BARE = ("-nostartfiles", "-Wl,--gc-sections", "--specs=nano.specs", "--specs=nosys.specs", "-lm")

QEMU = Target(
    "qemu",
    ("arm-none-eabi-gcc",),
    _CORTEX_M7,
    (*_BARE, "-T{board}/mps2.ld"),
    ("posix/plant.c", "cortex-m/start.c"),
)
"""Cortex-M7 of QEMU's mps2-an500: the core as it is cross-compiled for a microcontroller."""

STM32 = Target(
    "stm32h743",
    ("arm-none-eabi-gcc",),
    (*_CORTEX_M7, "-DSTIMULUS_CAPACITY=180000u", "-DTRANSMIT_BYTES=32768u"),
    (*_BARE, "-T{board}/stm32h743.ld"),
    ("cortex-m/start.c",),
)
"""Template for a physical board: NUCLEO-H743ZI2, a Cortex-M7 with a double-precision unit."""

TARGETS: tuple[Target, ...] = (POSIX, QEMU, STM32)


def compiler_of(target: Target) -> str:
    """Return the compiler of a target.

    Raises:
        MissingToolError: none is installed.
    """
    return tool(f"{target.name}: not built", *target.compilers)


def build(
    target: Target,
    *,
    options: Sequence[str] = (),
    replaced: Mapping[str, str] | None = None,
    folder: Path | None = None,
) -> Path:
    """Build a target and return the program.

    Args:
        target: the board.
        options: further options of the compiler, such as ``SANITIZERS``.
        replaced: text of files of the core in place of the stored one, by name.
        folder: for objects and program; default: a cache of this user.

    Raises:
        MissingToolError: no compiler is installed.
        RuntimeError: the compiler refuses a file; the message is its output.
    """
    compiler = compiler_of(target)
    kept = folder or user_cache_path("tissueid", appauthor=False) / "reference-firmware"
    kept.mkdir(parents=True, exist_ok=True)
    board = BOARDS / target.name
    includes = [f"-I{CORE}", f"-I{BOARDS}", f"-I{board}", *(f"-I{(BOARDS / name).parent}" for name in target.extra)]
    flags = [*WARNINGS, *target.options, *options]
    headers = b"".join(path.read_bytes() for path in sorted(SOURCES.glob("**/*.h")))
    common = hashlib.sha256(headers + repr((compiler, flags, includes)).encode())
    files = [*sorted(CORE.glob("*.c")), *sorted(board.glob("*.[cS]")), *(BOARDS / name for name in target.extra)]
    objects = []
    for path in files:
        text = (replaced or {}).get(path.name, path.read_text(encoding="utf-8"))
        objects.append(_object(compiler, [*flags, *includes], path, text, common, kept))
    whole = hashlib.sha256(repr((compiler, objects, options, target.link_options)).encode())
    scripts = "".join(path.read_text(encoding="utf-8") for path in sorted(board.glob("*.ld")))
    whole.update(scripts.encode())
    program = kept / f"reference-{target.name}-{whole.hexdigest()[:16]}"
    if not program.exists():
        link = [option.format(board=board) for option in target.link_options]
        _run([compiler, *target.options, *options, *map(str, objects), *link], program)
    return program


def _object(compiler: str, flags: list[str], path: Path, text: str, common: hashlib._Hash, kept: Path) -> Path:
    digest = common.copy()
    digest.update(text.encode())
    result = kept / f"{path.stem}-{digest.hexdigest()[:16]}.o"
    if not result.exists():
        with tempfile.TemporaryDirectory() as scratch:
            source = Path(scratch) / path.name
            source.write_text(text, encoding="utf-8")
            _run([compiler, *flags, "-c", str(source)], result)
    return result


def _run(command: list[str], result: Path) -> None:
    """Run a compiler whose output appears in its place only when it is complete."""
    partial = result.with_name(f"{result.name}.{os.getpid()}")
    found = subprocess.run([*command, "-o", str(partial)], capture_output=True, text=True, check=False)
    if found.returncode:
        partial.unlink(missing_ok=True)
        raise RuntimeError(found.stderr)
    partial.replace(result)


def build_posix(**arguments: object) -> Path:
    """Build the POSIX board; arguments and errors as :func:`build`."""
    return build(POSIX, **arguments)  # type: ignore[arg-type]


def main() -> int:
    """Build what the installed tools allow, and say in one line each what is missing; return the exit status."""
    status = 0
    for target in TARGETS:
        try:
            print(f"{target.name}: {(program := build(target))}")
            if target.name in TIMINGS:
                print(f"{target.name}: {words(bounds_of(program, TIMINGS[target.name]))}")
        except MissingToolError as error:
            print(error)
        except BoundError as error:
            print(f"{target.name}: no bound: {error}", file=sys.stderr)
            status = 1
        except RuntimeError as error:
            print(f"{target.name}: refused by the compiler\n{error}", file=sys.stderr)
            status = 1
    return status or static_analysis()


def static_analysis() -> int:
    """Let cppcheck look for defects, print one line about it, and return its exit status, 0 without it."""
    if not shutil.which("cppcheck"):
        print("static analysis: not run, install cppcheck")
        return 0
    checks = "--enable=warning,style,performance,portability"
    folders = (CORE, *sorted(path for path in BOARDS.iterdir() if path.is_dir()))
    status = 0
    for folder in folders:  # each board has its own registers.h
        includes = [f"-I{CORE}", f"-I{BOARDS}", f"-I{BOARDS / 'posix'}", f"-I{BOARDS / 'cortex-m'}"]
        command = ["cppcheck", "-q", checks, "--inline-suppr", "--error-exitcode=1", *includes, str(folder)]
        status = subprocess.run(command, check=False).returncode or status
    print(f"static analysis: {'findings, see above' if status else 'clean'}")
    return status


if __name__ == "__main__":
    sys.exit(main())
