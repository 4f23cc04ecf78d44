"""Golden pages: the texts of a report, a page of the window or a long command, compared as a whole with a kept file.

``python tests/golden/renew.py`` writes the kept files again; read the difference (``git diff tests/golden``) before you
commit it. Numbers that are computed, dates and paths are masked, so that a page changes where its words change.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable, Iterator
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSpinBox,
    QBoxLayout,
    QComboBox,
    QGridLayout,
    QGroupBox,
    QLabel,
    QLayout,
    QLineEdit,
    QListView,
    QPlainTextEdit,
    QSplitter,
    QTabBar,
    QTabWidget,
    QTextEdit,
    QWidget,
)

from tissueid.app.plot_canvas import PlotCanvas

PAGES = Path(__file__).with_name("pages")
RENEW = "TISSUEID_RENEW_GOLDEN"
"""Environment variable: write the pages instead of comparing them."""
_MASKS = (
    (r"\b\d{4}-\d\d-\d\d(?:[T_ ]\d\d[-:]\d\d(?:[-:]\d\d)?)?(?:Z|\b)", "DATE"),
    (r"\b\d\d:\d\d(?::\d\d)?\b", "TIME"),
    (r"\([A-Z]{3,4}\)", "(ZONE)"),
    (r"\b[0-9a-f]{8}-[0-9a-f-]{27}\b|\b[0-9a-f]{32,64}\b", "ID"),
    (r"(?:/[\w.-]+)+/([\w.-]+)", r"FOLDER/\1"),
    (r"\b\d+\.\d+\.\d+(?:\.?(?:dev|rc)\w*)?(?:\+[\w.]+)?", "VERSION"),
    (r"(?:\b\d+)?[.,]?\d+(?:e[-+−]?\d+)?", "#"),
    (r"[−-]#", "#"),
)
_APART = {"p", "h1", "h2", "h3", "h4", "tr", "li", "dt", "dd", "figcaption", "caption", "div", "section", "summary"}
_UNREAD = {"style", "script", "svg"}


def check_golden_page(name: str, lines: Iterable[str]) -> None:
    """Compare lines, masked, with the page of this name; renew it by ``python tests/golden/renew.py``."""
    text = "\n".join(_masked(line) for line in lines if line.strip()) + "\n"
    kept = PAGES / f"{name}.txt"
    if os.environ.get(RENEW):
        kept.write_text(text, encoding="utf-8")
    changed = difflib.unified_diff(kept.read_text(encoding="utf-8").splitlines(), text.splitlines(), n=0, lineterm="")
    assert "\n".join(changed) == "", name


def _masked(line: str) -> str:
    line = " ".join(line.split())
    for pattern, mask in _MASKS:
        line = re.sub(pattern, mask, line)
    return line


def lines_of_html(source: str) -> list[str]:
    """Return what a reader sees of an HTML page: one line for each paragraph, row of a table or heading."""
    reader = _Reader()
    reader.feed(source)
    return "".join(reader.texts).splitlines()


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []
        self._unread = 0

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self._unread += tag in _UNREAD
        if tag in _APART:
            self.texts.append("\n")
        elif tag in {"td", "th"}:
            self.texts.append(" | ")

    def handle_endtag(self, tag: str) -> None:
        self._unread -= tag in _UNREAD
        if tag in _APART:
            self.texts.append("\n")

    def handle_data(self, data: str) -> None:
        if not self._unread:
            self.texts.append(" ".join(data.split()).join((" " * data[:1].isspace(), " " * data[-1:].isspace())))


def lines_of_widget(widget: QWidget) -> Iterator[str]:
    """Return the visible texts of a page of the window in the order of its layouts."""
    if not widget.isVisible():
        return
    text = _text_of(widget)
    if text:
        yield from text.splitlines()
    if not isinstance(widget, QAbstractItemView | QComboBox | QAbstractSpinBox | QTextEdit | QPlainTextEdit):
        for child in _children_of(widget):
            yield from lines_of_widget(child)


def _children_of(widget: QWidget) -> list[QWidget]:
    if isinstance(widget, QTabWidget):
        return [widget.tabBar(), *(page for page in [widget.currentWidget()] if page is not None)]
    if isinstance(widget, QSplitter):
        return [widget.widget(place) for place in range(widget.count())]
    children = [child for child in widget.children() if isinstance(child, QWidget) and not child.isWindow()]
    layout = widget.layout()
    laid_out = list(_widgets_in(layout)) if layout is not None else []
    return [*laid_out, *(child for child in children if child not in laid_out)]


def _widgets_in(layout: QLayout) -> Iterator[QWidget]:
    for place in _places_in(layout):
        item = layout.itemAt(place)
        inner, widget = item.layout(), item.widget()
        if inner is not None:
            yield from _widgets_in(inner)
        elif widget is not None:
            yield widget


def _places_in(layout: QLayout) -> Iterable[int]:
    places = range(layout.count())
    if isinstance(layout, QGridLayout):
        return sorted(places, key=lambda place: layout.getItemPosition(place)[:2])
    if isinstance(layout, QBoxLayout) and layout.direction() in {
        QBoxLayout.Direction.RightToLeft,
        QBoxLayout.Direction.BottomToTop,
    }:
        return reversed(places)
    return places


def _text_of(widget: QWidget) -> str:
    """Return the text of a widget; where the user writes or chooses, in brackets."""
    if isinstance(widget, QLabel):
        text = widget.text()
        if "<" in text:
            return unescape(re.sub(r"<[^>]+>", " ", text))
        return text if widget.buddy() is None else _without_key(text)
    if isinstance(widget, QAbstractButton):
        return f"[{_without_key(widget.text())}]" if widget.text() else ""
    if isinstance(widget, QGroupBox):
        return widget.title()
    if isinstance(widget, QComboBox):
        return f"[{widget.currentText()}]"
    if isinstance(widget, QLineEdit | QAbstractSpinBox):
        return f"[{widget.text() or getattr(widget, 'placeholderText', str)()}]"
    if isinstance(widget, QTabBar):
        return " ".join(
            f"[{_without_key(widget.tabText(place))}]" for place in range(widget.count()) if widget.isTabVisible(place)
        )
    if isinstance(widget, QPlainTextEdit | QTextEdit):
        return widget.toPlainText()
    if isinstance(widget, QAbstractItemView):
        return "\n".join(_rows_of(widget))
    if isinstance(widget, PlotCanvas):
        return "\n".join(_lines_of_plots(widget))
    return ""


def _lines_of_plots(canvas: PlotCanvas) -> Iterator[str]:
    """Return title, labels and key of every pair of axes."""
    for axes in canvas.axes:
        yield " | ".join(
            filter(None, [axes.get_title(loc="left"), axes.get_xlabel(), axes.get_ylabel().replace("\n", " ")])
        )
        legend = axes.get_legend()
        if legend is not None:
            yield " ".join(f"■ {text.get_text()}" for text in legend.get_texts())


def _without_key(text: str) -> str:
    return text.replace("&&", "\0").replace("&", "").replace("\0", "&")


def _rows_of(view: QAbstractItemView) -> Iterator[str]:
    model = view.model()
    if model is None:
        return
    columns = range(1 if isinstance(view, QListView) else model.columnCount())
    heading = [model.headerData(column, Qt.Orientation.Horizontal) for column in columns]
    if any(isinstance(text, str) for text in heading):
        yield " | ".join(" ".join(str(text).split()) for text in heading)
    for row in range(model.rowCount()):
        cells = [str(model.data(model.index(row, column)) or "") for column in columns]
        yield " | ".join(" ".join(cell.split()) for cell in cells)
