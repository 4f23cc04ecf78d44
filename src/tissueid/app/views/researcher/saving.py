"""Tables and figures of analyses into files that are whole or not there."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import QBuffer, QByteArray, QIODevice, QRect
from PySide6.QtGui import QImage
from PySide6.QtSvg import QSvgGenerator
from PySide6.QtWidgets import QWidget

from tissueid.whole_file import whole_file

_SHARPNESS = 2
"""Pixels of a saved picture for one on the screen."""


def write_table(path: Path, rows: Sequence[Sequence[str]]) -> Path:
    """Write rows as CSV; returns the path.

    Raises:
        OSError: the file cannot be written.
    """
    with whole_file(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)
    return path


def write_bytes(path: Path, data: bytes) -> Path:
    """Write a picture; returns the path.

    Raises:
        OSError: the file cannot be written.
    """
    with whole_file(path) as partial:
        partial.write_bytes(data)
    return path


def picture_of(widget: QWidget, path: Path) -> bytes:
    """A widget as it stands, as SVG or PNG by the path's ending."""
    data = QByteArray()
    buffer = QBuffer(data)
    buffer.open(QIODevice.OpenModeFlag.WriteOnly)
    if path.suffix.lower() == ".svg":
        generator = QSvgGenerator()
        generator.setOutputDevice(buffer)
        generator.setSize(widget.size())
        generator.setViewBox(QRect(0, 0, widget.width(), widget.height()))
        generator.setTitle("TissueID")
        widget.render(generator)
    else:
        image = QImage(widget.size() * _SHARPNESS, QImage.Format.Format_RGB32)
        image.setDevicePixelRatio(_SHARPNESS)
        image.fill(widget.palette().window().color())
        widget.render(image)
        image.save(buffer, "PNG")  # type: ignore[call-overload]
    buffer.close()
    return bytes(data.data())


__all__ = ["picture_of", "write_bytes", "write_table"]
