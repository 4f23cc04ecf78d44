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

SOURCES = Path(__file__).parent
CORE = SOURCES / "core"
BOARDS = SOURCES / "boards"

WARNINGS = (
    *("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wdouble-promotion"),
    *("-Wstrict-prototypes", "-Wmissing-prototypes", "-Wvla", "-ffp-contract=off"),
)
SANITIZERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


class MissingToolError(RuntimeError):
    """A compiler is not installed; the message names it."""


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
QEMU = Target(
    "qemu",
    ("arm-none-eabi-gcc",),
    ("-O2", "-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16", "-ffunction-sections"),
    ("-nostartfiles", "-Wl,--gc-sections", "-T{board}/mps2.ld", "--specs=nano.specs", "--specs=nosys.specs", "-lm"),
    ("posix/plant.c",),
)
"""Cortex-M7 of QEMU's mps2-an500: the core as it is cross-compiled for a microcontroller."""

TARGETS: tuple[Target, ...] = (POSIX, QEMU)


def compiler_of(target: Target) -> str:
    """Return the compiler of a target.

    Raises:
        MissingToolError: none is installed.
    """
    for name in target.compilers:
        if found := shutil.which(name):
            return found
    raise MissingToolError(f"{target.name}: not built, install one of {', '.join(target.compilers)}")


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
    includes = [f"-I{CORE}", f"-I{board}", *(f"-I{(BOARDS / name).parent}" for name in target.extra)]
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


def qemu_command(program: Path, port: int) -> list[str]:
    """Return the command that runs the QEMU target with its UART on a TCP port of this computer.

    Raises:
        MissingToolError: QEMU is not installed.
    """
    emulator = shutil.which("qemu-system-arm")
    if emulator is None:
        raise MissingToolError("qemu: not run, install qemu-system-arm")
    serial = f"tcp:127.0.0.1:{port},server,nowait"
    return [emulator, "-M", "mps2-an500", "-nographic", "-monitor", "none", "-serial", serial, "-kernel", str(program)]


def build_posix(**arguments: object) -> Path:
    """Build the POSIX board; arguments and errors as :func:`build`."""
    return build(POSIX, **arguments)  # type: ignore[arg-type]


def main() -> int:
    """Build what the installed tools allow, and say in one line each what is missing; return the exit status."""
    status = 0
    for target in TARGETS:
        try:
            print(f"{target.name}: {build(target)}")
        except MissingToolError as error:
            print(error)
        except RuntimeError as error:
            print(f"{target.name}: refused by the compiler\n{error}", file=sys.stderr)
            status = 1
    if shutil.which("cppcheck"):
        checks = "--enable=warning,style,performance,portability"
        command = ["cppcheck", "-q", checks, "--error-exitcode=1", f"-I{CORE}", f"-I{BOARDS / 'posix'}"]
        found = subprocess.run([*command, str(CORE), str(BOARDS / "posix")], check=False)
        print(f"static analysis: {'clean' if found.returncode == 0 else 'findings, see above'}")
        status = status or found.returncode
    else:
        print("static analysis: not run, install cppcheck")
    return status


if __name__ == "__main__":
    sys.exit(main())
