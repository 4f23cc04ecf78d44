"""The picture of docs/instrument.md: what a dynamic sweep of the simulated device shows a technician.

Usage: python docs/figures/calibration_pictures.py [--write]

Without ``--write`` nothing is changed; the size is printed.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1] / "tests"), str(HERE.parents[1])]

from support import connect_scenario  # noqa: E402

from firmware_sim.scenario import Scenario  # noqa: E402
from tissueid.acquisition import SessionRecorder  # noqa: E402
from tissueid.calibration.plans import SweepPlan  # noqa: E402
from tissueid.calibration.sweep import Sweep, sweep_tests  # noqa: E402
from tissueid.calibration.sweep_analysis import analyse_sweep, as_calibration  # noqa: E402
from tissueid.reports.calibration_page import sweep_report  # noqa: E402
from tissueid.reports.page import draw_sheet  # noqa: E402
from tissueid.reports.style import plain_image  # noqa: E402

PICTURE = HERE.parent / "images" / "sweep.png"
MOST_BYTES = 150_000
COLOURS = 128
"""As many as lines and letters need; a picture then takes a third of the room."""


def main() -> int:
    """Sweep, draw, and write the picture when --write asks for it; 1 when it is too large."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the picture into docs/images")
    arguments = parser.parse_args()
    picture = _small(_drawn())
    print(f"{PICTURE.name}: {len(picture)} bytes")
    if arguments.write:
        PICTURE.write_bytes(picture)
    return 1 if len(picture) > MOST_BYTES else 0


def _drawn() -> bytes:
    """Parameters by position, force constant by method and Bode diagrams, of one sweep (Chen 2010, Fig. 2.12)."""
    instrument = connect_scenario(Scenario(preset="calibration-spring", coil="finite", seed=1))
    with tempfile.TemporaryDirectory() as folder:
        recorder = SessionRecorder(Path(folder) / "sweep.h5", instrument.device)
        sweep = Sweep(instrument, SweepPlan(), recorder)
        sweep.run()
        session = recorder.finish()
    result = analyse_sweep(sweep_tests(session), session.instrument, remarks=sweep.remarks)
    report = sweep_report(as_calibration(result))
    buffer = io.BytesIO()
    plain_image(draw_sheet(report.headline, report.panels), buffer, "png")
    return buffer.getvalue()


def _small(picture: bytes) -> bytes:
    """The same picture with few colours."""
    buffer = io.BytesIO()
    drawn = Image.open(io.BytesIO(picture)).convert("RGB")
    drawn.quantize(COLOURS, dither=Image.Dither.NONE).save(buffer, "png", optimize=True)
    return buffer.getvalue()


if __name__ == "__main__":
    sys.exit(main())
