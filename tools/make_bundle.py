"""Build a desktop bundle: a folder with Python, all packages and a launcher, which runs where it is unpacked.

    .venv/bin/python tools/make_bundle.py                # `make bundle`: dist/tissueid-VERSION-PLATFORM.tar.gz
    .venv/bin/python tools/make_bundle.py --folder       # leave the folder, without an archive

Needs no network: the interpreter and the pinned packages are copied from this environment, TissueID from a new wheel.
The bundle runs on systems with the C library of this one or a newer one.
"""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import sysconfig
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from make_package import ROOT, build, problem, write_generated

EXTRAS = ("app", "study", "cluster")
_LEFT_OUT = shutil.ignore_patterns(
    "__pycache__", "site-packages", "dist-packages", "test", "tests", "idlelib", "tkinter", "turtledemo", "ensurepip",
    "lib2to3", "config-*", "*.a",
)  # fmt: skip
_NOT_USED = re.compile(
    r"(?:^|/)tests/|\.pyi$|^pyarrow/(?:include|src)/|^PySide6/(?:include|typesystems|glue|doc|Qt/(?:qml|libexec|metatypes))/"
    r"|^PySide6/(?:assistant|designer|linguist|lrelease|lupdate|qml\w*|svgtoqml)$"
)
"""Files of packages that no program of the bundle opens: tests, type stubs, tools and headers for developers."""
LAUNCHER = """#!/bin/sh
# Start TissueID with the Python and the packages of this folder.
here=$(CDPATH= cd -- "$(dirname -- "$(readlink -f -- "$0")")/.." && pwd -P)
LD_LIBRARY_PATH="$here/python/lib${{LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}}"
export LD_LIBRARY_PATH
exec "$here/python/bin/python3" -I -m {module} "$@"
"""


def copy_python(target: Path) -> Path:
    """Copy the interpreter and its library; return the folder for packages."""
    base = Path(sys.base_prefix)
    standard = Path(sysconfig.get_path("stdlib", vars={"installed_base": str(base), "base": str(base)}))
    library = target / "lib" / standard.name
    shutil.copytree(standard, library, ignore=_LEFT_OUT)
    (target / "bin").mkdir()
    shutil.copy2(Path(getattr(sys, "_base_executable", sys.executable)).resolve(), target / "bin" / "python3")
    if sysconfig.get_config_var("Py_ENABLE_SHARED"):
        name = str(sysconfig.get_config_var("INSTSONAME"))
        shutil.copy2(Path(str(sysconfig.get_config_var("LIBDIR"))) / name, target / "lib" / name)
    packages = library / "site-packages"
    packages.mkdir()
    return packages


def needed(name: str, extras: tuple[str, ...] = ()) -> Iterator[Distribution]:
    """Yield the installed distributions that a distribution needs, recursively and without repeats.

    Raises:
        PackageNotFoundError: one is not installed.
    """
    from packaging.requirements import Requirement

    seen: set[str] = set()
    open_names: list[tuple[str, tuple[str, ...]]] = [(name, extras)]
    while open_names:
        current, wanted = open_names.pop()
        for text in distribution(current).requires or ():
            requirement = Requirement(text)
            marker = requirement.marker
            if marker is not None and not any(marker.evaluate({"extra": extra}) for extra in (*wanted, "")):
                continue
            found = distribution(requirement.name)
            if found.name not in seen:
                seen.add(found.name)
                open_names.append((found.name, tuple(requirement.extras)))
                yield found


def copy_distribution(found: Distribution, packages: Path) -> None:
    """Copy the files of a distribution, without its console scripts and compiled files."""
    for file in found.files or ():
        inside = ".." not in file.parts and "__pycache__" not in file.parts and not file.is_absolute()
        if inside and not _NOT_USED.search(file.as_posix()):
            target = packages / file
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(str(file.locate()), target)


def make(folder: Path, scratch: Path) -> None:
    """Make the bundle in a new folder."""
    packages = copy_python(folder / "python")
    for found in needed("tissueid", EXTRAS):
        copy_distribution(found, packages)
    (wheel,) = build(scratch, "wheel")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    for data in packages.glob("tissueid-*.data"):
        shutil.rmtree(data)
    share = folder / "share"
    write_generated(share)
    for path, place in (
        (ROOT / "packaging" / "tissueid.desktop", share / "applications"),
        (ROOT / "src" / "tissueid" / "app" / "tissueid.svg", share / "icons" / "hicolor" / "scalable" / "apps"),
        (ROOT / "LICENSE", folder),
        (ROOT / "packaging" / "install.sh", folder),
    ):
        place.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, place / path.name)
    (folder / "bin").mkdir()
    for name, module in (("tissueid", "tissueid"), ("tissueid-firmware-sim", "firmware_sim")):
        launcher = folder / "bin" / name
        launcher.write_text(LAUNCHER.format(module=module), encoding="utf-8")
        launcher.chmod(0o755)


def main() -> int:
    """Build; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="FOLDER")
    parser.add_argument("--folder", action="store_true", help="leave the folder, without an archive")
    options = parser.parse_args()
    if sys.platform == "win32":
        print("bundle: the launcher is a shell script; on Windows use pip install 'tissueid[app]'", file=sys.stderr)
        return 2
    if reason := problem("hatchling", options.out) or problem("packaging", options.out):
        print(f"bundle: {reason}", file=sys.stderr)
        return 2
    import tissueid

    name = f"tissueid-{tissueid.__version__}-{sysconfig.get_platform()}"
    with tempfile.TemporaryDirectory(prefix="tissueid-bundle-", dir=options.out) as scratch:
        folder = Path(scratch) / name
        try:
            make(folder, Path(scratch))
        except PackageNotFoundError as error:
            print(
                f"bundle: this needs {error.name}, which is not installed: "
                f"{sys.executable} -m pip install 'tissueid[{','.join(EXTRAS)}]'",
                file=sys.stderr,
            )
            return 2
        if options.folder:
            target = options.out / name
            shutil.rmtree(target, ignore_errors=True)
            folder.rename(target)
        else:
            target = options.out / f"{name}.tar.gz"
            partial = Path(scratch) / target.name
            with tarfile.open(partial, "w:gz", compresslevel=4) as archive:
                archive.add(folder, name)
            partial.replace(target)
    print(f"{target}: {_size(target) / 1e6:.0f} MB")
    return 0


def _size(path: Path) -> int:
    files = [path] if path.is_file() else [item for item in path.rglob("*") if item.is_file()]
    return sum(item.stat().st_size for item in files)


if __name__ == "__main__":
    sys.exit(main())
