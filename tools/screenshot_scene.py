"""Environment of the screenshots: fixed clock, relative folders, event processing, and capture of images."""

from __future__ import annotations

import os
import random
import sys
import time
import uuid
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path
from typing import Self

import numpy as np
from PIL import Image
from PySide6.QtCore import QEventLoop, QTimer
from PySide6.QtWidgets import QApplication, QWidget

from tissueid.app.plot_canvas import PlotCanvas

IMAGES = Path(__file__).parents[1] / "docs" / "images"
COLOURS = 256
LONGEST_S = 120.0
"""Timeout for every condition, s."""
TODAY = datetime(2026, 1, 15, 10, 30, tzinfo=UTC)


class SetClock(datetime):
    """``datetime`` with a fixed ``now``, so that the dates in the pictures are the same in every run."""

    moment = TODAY

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> Self:
        """Return the set time; without a time zone as the local time of a clock in UTC."""
        at = cls.moment if tz is not None else cls.moment.replace(tzinfo=None)
        return cls.fromisoformat(at.isoformat())


def set_clock(days: float = 0.0, minutes: float = 0.0) -> None:
    """Set the clock to some days and minutes after the day of the pictures."""
    SetClock.moment = TODAY + timedelta(days=days, minutes=minutes)


def use_set_clock() -> None:
    """Replace ``datetime`` by the fixed clock in all imported modules of the program."""
    for name, module in list(sys.modules.items()):
        if name.startswith("tissueid.") and getattr(module, "datetime", None) is datetime:
            module.datetime = SetClock  # type: ignore[attr-defined]


def use_relative_folders(folder: Path) -> None:
    """Use relative paths below a folder, so that pictures contain no paths of this machine."""
    os.chdir(folder)
    os.environ["TZ"] = "UTC"
    time.tzset()
    for name in ("CONFIG", "DATA", "STATE", "CACHE"):
        os.environ[f"XDG_{name}_HOME"] = str(Path.cwd() / name.lower())
    os.environ["LOGNAME"] = "operator"
    os.environ["TISSUEID_ANALYSES"] = "data/analyses.jsonl"
    numbers = random.Random(1)
    uuid.uuid4 = lambda: uuid.UUID(int=numbers.getrandbits(128), version=4)


def wait_until(done: Callable[[], bool], what: str) -> None:
    """Process events until a condition is true.

    Raises:
        SystemExit: the condition stayed false; the message names it.
    """
    deadline = time.monotonic() + LONGEST_S
    while not done():
        if time.monotonic() > deadline:
            sys.stderr.write(f"make_screenshots: waited {LONGEST_S:g} s for {what}, in vain\n")
            sys.stderr.flush()
            os._exit(1)  # the paused test would keep the program from exiting
        process_events_for(20)


def process_events_for(milliseconds: int) -> None:
    """Process events for a time."""
    loop = QEventLoop()
    QTimer.singleShot(milliseconds, loop.quit)
    loop.exec()


def take(widget: QWidget, name: str) -> None:
    """Save a picture of a widget in ``docs/images``."""
    focus = QApplication.focusWidget()
    if focus is not None:
        focus.clearFocus()  # a blinking cursor would differ between runs
    check_for_defects()
    process_events_for(250)  # process a frame and a change of palette
    canvases = widget.findChildren(PlotCanvas)
    wait_until(lambda: not any(one.isVisible() and one.pending for one in canvases), "plots to be drawn")
    path = IMAGES / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    widget.grab().save(str(path))
    with Image.open(path) as image:
        _with_fewer_colours(image.convert("RGB")).save(path, optimize=True)
    sys.stdout.write(f"{path.name}: {path.stat().st_size // 1024} kB\n")


def _with_fewer_colours(image: Image.Image) -> Image.Image:
    """Reduce an image to a palette: common colours are kept, all others become the nearest palette colour.

    Half of the palette is chosen among rare colours, each counted once, so that a small red dot stays red.
    """
    pixels = np.asarray(image).reshape(-1, 3)
    colours, place, count = np.unique(pixels, axis=0, return_inverse=True, return_counts=True)
    common = colours[np.argsort(-count, kind="stable")[: COLOURS // 2]]
    rare = Image.fromarray(colours[None]).quantize(COLOURS // 2, method=Image.Quantize.MEDIANCUT)
    kept = np.concatenate([common, np.array(rare.getpalette(), np.uint8).reshape(-1, 3)])[:COLOURS]
    distances = ((colours[:, None].astype(int) - kept[None].astype(int)) ** 2).sum(axis=2)
    few = Image.fromarray(distances.argmin(axis=1)[place.ravel()].astype(np.uint8).reshape(image.height, image.width))
    few.putpalette(kept.ravel().tolist())
    return few


def check_for_defects() -> None:
    """Exit if the window reported an unexpected error.

    Raises:
        SystemExit: with the error.
    """
    defect = Path("state/tissueid/log/last-defect.txt")
    if defect.exists():
        sys.stderr.write(defect.read_text(encoding="utf-8"))
        sys.stderr.flush()
        os._exit(1)
