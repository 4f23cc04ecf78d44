"""What the pictures of the window are taken with: a clock that is set, places without a machine's name, a camera."""

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

IMAGES = Path(__file__).parents[1] / "docs" / "images"
COLOURS = 256
LONGEST_S = 120.0
"""How long the window may take for anything."""
TODAY = datetime(2026, 1, 15, 10, 30, tzinfo=UTC)


class SetClock(datetime):
    """A ``datetime`` whose ``now`` is set by hand, so that every date in a picture is the same the next time."""

    moment = TODAY

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> Self:
        """The moment that is set; without a time zone as a local clock in UTC would tell it."""
        at = cls.moment if tz is not None else cls.moment.replace(tzinfo=None)
        return cls.fromisoformat(at.isoformat())


def set_clock(days: float = 0.0, minutes: float = 0.0) -> None:
    """Set the clock to some days and minutes after the day of the pictures."""
    SetClock.moment = TODAY + timedelta(days=days, minutes=minutes)


def use_set_clock() -> None:
    """Let every module of the program that has been imported look at the clock that is set."""
    for name, module in list(sys.modules.items()):
        if name.startswith("tissueid.") and getattr(module, "datetime", None) is datetime:
            module.datetime = SetClock  # type: ignore[attr-defined]


def live_in(folder: Path) -> None:
    """Work below a folder, by relative names: pictures then show no place of the machine that made them."""
    os.chdir(folder)
    os.environ["TZ"] = "UTC"
    time.tzset()
    for name in ("CONFIG", "DATA", "STATE", "CACHE"):
        os.environ[f"XDG_{name}_HOME"] = str(Path.cwd() / name.lower())
    os.environ["LOGNAME"] = "operator"
    os.environ["TISSUEID_ANALYSES"] = "data/analyses.jsonl"
    numbers = random.Random(1)
    uuid.uuid4 = lambda: uuid.UUID(int=numbers.getrandbits(128), version=4)


def until(done: Callable[[], bool], what: str) -> None:
    """Let the window go on until something is so.

    Raises:
        SystemExit: it never was; says what was waited for.
    """
    deadline = time.monotonic() + LONGEST_S
    while not done():
        if time.monotonic() > deadline:
            sys.stderr.write(f"make_screenshots: waited {LONGEST_S:g} s for {what}, in vain\n")
            sys.stderr.flush()
            os._exit(1)  # the test that is held for its picture would keep the program from ending
        let_pass(20)


def let_pass(milliseconds: int) -> None:
    """Let the window go on for a while."""
    loop = QEventLoop()
    QTimer.singleShot(milliseconds, loop.quit)
    loop.exec()


def take(widget: QWidget, name: str) -> None:
    """Take a picture of a widget into ``docs/images``."""
    focus = QApplication.focusWidget()
    if focus is not None:
        focus.clearFocus()  # a cursor would blink in one picture and not in the next
    check_for_defects()
    let_pass(250)  # let a frame and a change of palette come through
    path = IMAGES / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    widget.grab().save(str(path))
    with Image.open(path) as image:
        _with_fewer_colours(image.convert("RGB")).save(path, optimize=True)
    sys.stdout.write(f"{path.name}: {path.stat().st_size // 1024} kB\n")


def _with_fewer_colours(image: Image.Image) -> Image.Image:
    """The commonest colours as they are, and every other one as the nearest that is kept.

    Half of those that are kept stand for the rare ones, each counted once: a small red dot stays red.
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
    """End here where the window met something that it did not expect.

    Raises:
        SystemExit: with what it was.
    """
    defect = Path("state/tissueid/log/last-defect.txt")
    if defect.exists():
        sys.stderr.write(defect.read_text(encoding="utf-8"))
        sys.stderr.flush()
        os._exit(1)
