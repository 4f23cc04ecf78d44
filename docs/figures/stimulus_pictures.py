"""The pictures of docs/stimuli.md: those that commands draw, and real-time input generation on the thesis' systems.

Usage: python docs/figures/stimulus_pictures.py [--write] [--only NAME]

Without ``--write`` nothing is changed; the sizes are printed.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1] / "tests" / "stimuli")]

import simulated_plants  # noqa: E402

from tissueid.cli import main as tissueid  # noqa: E402
from tissueid.reports.page import draw_sheet  # noqa: E402
from tissueid.reports.stimulus_page import feedback_panels, run_from_report  # noqa: E402
from tissueid.reports.style import plain_image  # noqa: E402
from tissueid.stimuli.kinds.rtig import Rtig  # noqa: E402

IMAGES = HERE.parent / "images"
MOST_BYTES = 150_000
COLOURS = 64
"""As many as lines and letters need; a picture then takes a third of the room."""

COMMANDS = {
    "stimuli-noise": "noise --min-force 0.5 --max-force 10.5",
    "stimuli-interchange": "interchange --seconds 5 --option spectrum=band",
    "stimuli-multisine": "multisine --option notches=[[45,55]]",
    "stimuli-designed": "designed",
    "stimuli-rtig": "rtig",
}
"""Name of a picture, and the ``tissueid stimulus`` that draws it with ``--plot``."""

SYSTEMS = {"stimuli-rtig-plain": False, "stimuli-rtig-identified": True}
"""Name of a picture of the three systems of C.4.2, and whether they were identified on the way."""


def main() -> int:
    """Draw the pictures, and write those that --write asks for; 1 when one is too large."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the pictures into docs/images")
    parser.add_argument("--only", choices=[*COMMANDS, *SYSTEMS], help="draw one picture")
    arguments = parser.parse_args()
    too_large = 0
    for name in [arguments.only] if arguments.only else [*COMMANDS, *SYSTEMS]:
        picture = _small(_commanded(COMMANDS[name]) if name in COMMANDS else _systems(SYSTEMS[name]))
        print(f"{name}.png: {len(picture)} bytes")
        too_large += len(picture) > MOST_BYTES
        if arguments.write:
            (IMAGES / f"{name}.png").write_bytes(picture)
    return 1 if too_large else 0


def _commanded(command: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plot.png"
        if tissueid(["stimulus", *command.split(), "--plot", str(path)]):
            raise SystemExit(f"tissueid stimulus {command} failed")
        return path.read_bytes()


def _systems(identify: bool) -> bytes:
    """The linear, the Wiener and the depth-dependent system side by side (Chen 2010, Figs. 6.7, 6.8, 6.10 to 6.12)."""
    low, high = simulated_plants.DEPTH_M
    least, most = simulated_plants.FORCE_N
    kind = Rtig(depth_min_m=low, depth_max_m=high, force_min_n=least, force_max_n=most, identify=identify)
    runs = []
    for name, plant in simulated_plants.PLANTS.items():
        found = simulated_plants.closed_loop(kind, plant())
        runs.append(run_from_report(found.source.report(), found.force, found.depth, kind.sample_rate, name))
    panels = list(feedback_panels(runs))
    title = f"Real-time input generation {'with' if identify else 'without'} identification"
    buffer = io.BytesIO()
    plain_image(draw_sheet(title, panels if identify else panels[:2]), buffer, "png")
    return buffer.getvalue()


def _small(picture: bytes) -> bytes:
    """The same picture with few colours."""
    buffer = io.BytesIO()
    drawn = Image.open(io.BytesIO(picture)).convert("RGB")
    drawn.quantize(COLOURS, dither=Image.Dither.NONE).save(buffer, "png", optimize=True)
    return buffer.getvalue()


if __name__ == "__main__":
    sys.exit(main())
