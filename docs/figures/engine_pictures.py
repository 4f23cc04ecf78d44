"""The pictures of docs/engines.md: figures of engines, drawn from a simulated sitting.

Usage: python docs/figures/engine_pictures.py [--write] [--sitting FOLDER]

Without ``--write`` nothing is changed; the sizes are printed. Without ``--sitting`` one is made first.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from pathlib import Path

from tissueid.analysis import compare, specifications, split
from tissueid.cli import main as tissueid
from tissueid.reports import ComparisonReport, comparison_report
from tissueid.reports.style import plain_image
from tissueid.sessions import read_session

IMAGES = Path(__file__).resolve().parents[1] / "images"
MOST_BYTES = 150_000
ENGINES = ("lms", "rls", "als", "wiener", "hammerstein", "volterra", "depth", "direction", "dpn")
PICTURES = {
    "scores": "engines-scores",
    "depth": "engines-depth",
    "volterra-second-kernel": "engines-second-kernel",
    "volterra-processing": "engines-kernel-processing",
    "depth-kernels": "engines-depth-kernels",
    "als-over-time": "engines-als-over-time",
    "dpn-depth-profile": "engines-dpn-curves",
    "hammerstein-blocks": "engines-hammerstein-blocks",
}
"""Key of a figure, and the name of its picture."""


def main() -> int:
    """Draw the pictures, and write those that --write asks for; 1 when one is too large."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the pictures into docs/images")
    parser.add_argument("--sitting", type=Path, help="folder with a session.h5; made when not given")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = arguments.sitting or Path(made) / "sitting"
        if arguments.sitting is None:
            tissueid(["demo", "--out", str(folder)])
        session = read_session(folder / "session.h5")
        report = comparison_report(session, compare(specifications(ENGINES), split(session)))
    return _write(report, arguments.write)


def _write(report: ComparisonReport, write: bool) -> int:
    too_large = 0
    for section in report.sections:
        for drawn in section.pictures:
            if drawn.key not in PICTURES or drawn.figure is None:
                continue
            buffer = io.BytesIO()
            plain_image(drawn.figure, buffer, "png", 84.0)
            target = IMAGES / f"{PICTURES[drawn.key]}.png"
            print(f"{target.name}: {len(buffer.getvalue())} bytes")
            too_large += len(buffer.getvalue()) > MOST_BYTES
            if write:
                target.write_bytes(buffer.getvalue())
    return 1 if too_large else 0


if __name__ == "__main__":
    sys.exit(main())
