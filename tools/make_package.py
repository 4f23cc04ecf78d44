"""Build the wheel and the source distribution, with manual page, completions, icon and desktop entry.

    .venv/bin/python tools/make_package.py               # `make package`: dist/
    .venv/bin/python tools/make_package.py --out FOLDER

Needs no network: hatchling of this environment builds both.
"""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
SHARE = ROOT / "build" / "share"
"""Generated files that ``hatch_build.py`` adds to the wheel, below ``share`` of the environment."""


def problem(package: str, folder: Path, extra: str = "dev") -> str:
    """Return a line that names a missing package or an unwritable folder; "" if both are usable.

    ``extra`` is the extra of ``tissueid`` that has the package.
    """
    if importlib.util.find_spec(package) is None:
        return f"this needs {package}, which is not installed: {sys.executable} -m pip install 'tissueid[{extra}]'"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        return f"{error.filename or folder}: {error.strerror}"
    return ""


def write_generated(share: Path) -> None:
    """Write manual page and completions, made from the argument parsers."""
    from tissueid.cli.command_reference import completion_script, manual_page

    for name, text in {
        "man/man1/tissueid.1": manual_page(),
        "bash-completion/completions/tissueid": completion_script("bash"),
        "zsh/site-functions/_tissueid": completion_script("zsh"),
        "fish/vendor_completions.d/tissueid.fish": completion_script("fish"),
    }.items():
        path = share / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def build(out: Path, *targets: str) -> list[Path]:
    """Build the targets (``wheel``, ``sdist``) and return their files.

    Raises:
        subprocess.CalledProcessError: the build failed; its output says why.
    """
    import tissueid

    options = [word for target in targets for word in ("--target", target)]
    command = [sys.executable, "-m", "hatchling", "build", "--directory", str(out.resolve()), *options]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    endings = {"wheel": "-py3-none-any.whl", "sdist": ".tar.gz"}
    return [out / f"tissueid-{tissueid.__version__}{endings[target]}" for target in targets]


def main() -> int:
    """Build; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="FOLDER")
    out = parser.parse_args().out
    if reason := problem("hatchling", out) or problem("hatchling", SHARE):
        print(f"package: {reason}", file=sys.stderr)
        return 2
    write_generated(SHARE)
    for path in build(out, "sdist", "wheel"):
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
