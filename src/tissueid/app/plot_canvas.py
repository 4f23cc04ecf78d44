"""Widget that shows plots drawn by the renderer of reports, to zoom, pan, read and save.

matplotlib is imported when the first plot is shown, so that the window starts without it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard, cast

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPointF, QSize, Qt
from PySide6.QtGui import QContextMenuEvent, QKeyEvent, QMouseEvent, QPalette, QResizeEvent, QShowEvent, QWheelEvent
from PySide6.QtWidgets import (
    QApplication,
    QFrame,
    QLabel,
    QMenu,
    QScrollArea,
    QSizePolicy,
    QWidget,
)

from tissueid.app import build
from tissueid.app.draw_queue import request_drawing
from tissueid.app.plot_readout import extremes, unit_of_values, values_at
from tissueid.app.theme import Theme, appearance
from tissueid.app.words import sentence
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.units import shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import MouseButton
    from mpl_toolkits.mplot3d import Axes3D

    from tissueid.analysis.curves import Plot
    from tissueid.analysis.curves.plot import Array
    from tissueid.reports.plot_axes import Look
    from tissueid.reports.plot_renderer import DrawnLine

Point = tuple[float, float]
"""A place on a canvas, in pixels of the figure from its lower left corner."""
FILES = {
    ".png": marked("PNG picture (*.png)"),
    ".svg": marked("SVG drawing (*.svg)"),
    ".csv": marked("Comma-separated values (*.csv)"),
}
_CLOSER = 0.8
"""Share of the range that is left by one step of the wheel or one key press."""
_STEP = 0.1
"""Share of the range by which an arrow key moves."""
_TURN = 10.0
"""Angle by which an arrow key turns a surface, degrees."""
_HOW_FLAT = marked("Drag to move, turn the wheel to look closer; a double click shows everything")
_HOW = marked("Drag or use the arrow keys to turn it, the wheel or + and − to come closer; Home turns it back.")
_SETTLED_MS = 50
"""Time without a change of size after which the plots are laid out."""
_WIDTH, _HEIGHT = 7.2, 3.2
"""Size of a saved panel, inches."""


class PlotCanvas(QFrame):
    """A card with plots below each other, or with one surface in space.

    The wheel zooms, where no page has to be scrolled by it or with Ctrl; dragging pans, or turns a surface; a double
    click shows everything. With the focus, arrow keys move or turn, + and - zoom, 0 shows everything. The menu saves.
    """

    def __init__(self, name: str = "", parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self.focus = Qt.FocusPolicy.StrongFocus
        """How the plots take the focus once they are drawn."""
        self.pick: Callable[[Point, bool], bool] | None = None
        """Called for a click at a point, with whether it is a double click; returns whether something lies there."""
        self.tip: Callable[[Point], str] | None = None
        """Returns what is said of a point under the cursor; "" for its coordinates."""
        self.plots: tuple[Plot, ...] = ()
        self._axes: list[Axes] = []
        self._name, self._relief, self._key, self._description = name, False, True, ""
        self._side_by_side = False
        self.canvas: Any = None
        self._long: list[list[DrawnLine]] = []
        self._home: list[tuple[Any, ...]] = []
        self._grabbed: Axes | None = None
        self._laid_out_for = QSize()
        self._stale = self._unsettled = False
        self._relayout = build.timer(self, _SETTLED_MS, self.settle)
        self.missing = build.styled(
            QLabel(),
            role="muted",
            word_wrap=True,
            minimum_width=1,
            text_format=Qt.TextFormat.PlainText,
            alignment=Qt.AlignmentFlag.AlignCenter,
        )
        self.readout = build.styled(
            QLabel(self), role="readout", attribute=Qt.WidgetAttribute.WA_TransparentForMouseEvents, hidden=True
        )
        self.cover = build.styled(
            QLabel(_("Being drawn…"), self),
            alignment=Qt.AlignmentFlag.AlignCenter,
            auto_fill_background=True,
            background_role=QPalette.ColorRole.Base,
            hidden=True,
        )
        self._inside = build.column((self.missing, 1), spacing=0, margins=(6, 4, 6, 4), parent=self)
        build.styled(self, minimum_height=150, name=name)
        appearance.changed.connect(self._again)

    @property
    def axes(self) -> list[Axes]:
        """The axes of the plots, from the top; what waits for its turn to be drawn is drawn first."""
        if self.pending and self.isVisible():
            self.draw_pending()
        return self._axes

    @property
    def pending(self) -> bool:
        """Whether something has to be drawn or laid out before the canvas shows its plots."""
        return self._stale or self._unsettled

    def show_plots(
        self,
        plots: Sequence[Plot],
        *,
        relief: bool = False,
        side_by_side: bool = False,
        key: bool = True,
        description: str = "",
    ) -> None:
        """Draw plots, at once or when the widget is shown.

        Args:
            plots: what to draw, from the top; where all have nothing to draw, the reasons are shown.
            relief: whether the surface of the first plot is drawn in space.
            side_by_side: whether the plots are drawn side by side.
            key: whether named curves get a key.
            description: what a screen reader says of the values; by default the extremes of a surface.
        """
        self.plots, self._relief, self._key, self._description = tuple(plots), relief, key, description
        self._side_by_side = side_by_side
        reasons = dict.fromkeys(sentence(translated(plot.missing)) for plot in plots if plot.missing)
        empty = not plots or all(plot.missing for plot in plots)
        self.missing.setText(" ".join(reasons))
        self.missing.setVisible(empty)
        self.readout.hide()
        notes = dict.fromkeys(translated(plot.note) for plot in plots if plot.note)
        self.setToolTip("\n".join([*notes, _(_HOW) if relief else _(_HOW_FLAT)]))
        if self.canvas is not None:
            self.canvas.setVisible(not empty)
        self._describe()
        self._stale = not empty
        self._axes, self._long, self._home = [], [], []
        if self._stale and self.isVisible():
            request_drawing(self)
        self.cover.setVisible(self._stale)
        self.cover.raise_()

    def say_missing(self, text: str) -> None:
        """Show a text in place of plots."""
        self.show_plots(())
        self.missing.setText(text)

    def take_units(self) -> None:
        """Draw in the active units."""
        self._describe()
        self._again()

    def save(self, path: Path) -> None:
        """Write the plots as PNG, SVG or PDF on white, or their numbers as CSV, by the suffix of ``path``.

        Raises:
            OSError: the file cannot be written.
        """
        from tissueid.analysis.curves.plot import as_csv
        from tissueid.atomic_write import atomic_file

        form = path.suffix.lower().removeprefix(".")
        with atomic_file(path) as partial:
            if form == "csv":
                partial.write_text(as_csv(self.plots), encoding="utf-8", errors="backslashreplace")
            else:
                from tissueid.reports.plot_renderer import draw_grid, draw_relief
                from tissueid.reports.style import drawing, new_figure, plain_image

                figure = drawing(new_figure)(_WIDTH, _HEIGHT * max(1, len(self._rows)))
                if self._relief:
                    drawing(draw_relief)(figure, self.plots[0], units=shown)
                else:
                    drawing(draw_grid)(figure, self._rows, units=shown)
                plain_image(figure, partial, cast(Any, form), 300.0 if form == "png" else 144.0)

    def show_everything(self) -> None:
        """Show the whole range again."""
        for axes, home in zip(self.axes, self._home, strict=True):
            axes.set_xlim(home[0])
            axes.set_ylim(home[1])
            if _in_space(axes):
                axes.view_init(*home[2])
                axes.set_box_aspect(None, zoom=1.0)
        self._follow()

    def zoom(self, factor: float, at: tuple[float, float] | None = None, axes: Axes | None = None) -> None:
        """Show ``factor`` of the range about a point, pixels from the lower left corner, or about the middle."""
        for subplot in self.axes if axes is None else [axes]:
            if _in_space(subplot):
                self._scale /= factor
                subplot.set_box_aspect(None, zoom=self._scale)
                continue
            box = subplot.bbox
            x, y = at or (0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1))
            across = (
                1.0 if axes is None and subplot is not self.axes[-1] and _joined(subplot, self.axes[-1]) else factor
            )
            low = (x - across * (x - box.x0), y - factor * (y - box.y0))
            high = (x + across * (box.x1 - x), y + factor * (box.y1 - y))
            _look_at(subplot, low, high)
        self._follow()

    # -- events -------------------------------------------------------------------------------------------

    def showEvent(self, event: QShowEvent) -> None:  # noqa: N802
        """Draw what was given while hidden."""
        super().showEvent(event)
        if self.pending:
            request_drawing(self)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Lay the plots out for the new size."""
        super().resizeEvent(event)
        self.cover.setGeometry(self.rect().adjusted(2, 2, -2, -2))
        self._relayout.start()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Zoom, pan and read values by the events of the canvas."""
        if watched is self.canvas and isinstance(event, QResizeEvent):
            self._take_size(event)
            return True  # matplotlib would draw for every size that is passed through
        if watched is not self.canvas or not self._axes:
            return super().eventFilter(watched, event)
        if isinstance(event, QWheelEvent):
            return self._wheel(event)
        if isinstance(event, QContextMenuEvent):
            self._open_menu(event)
            return True
        if isinstance(event, QMouseEvent):
            return self._mouse(event)
        if isinstance(event, QKeyEvent) and event.type() == QEvent.Type.KeyPress:
            return self._press(event)
        if event.type() == QEvent.Type.Leave:
            self.readout.hide()
        return super().eventFilter(watched, event)

    def _wheel(self, event: QWheelEvent) -> bool:
        ctrl = bool(event.modifiers() & Qt.KeyboardModifier.ControlModifier)
        focused = self.canvas is not None and self.canvas.hasFocus()
        if not (ctrl or focused or not self._scrolled) or event.angleDelta().y() == 0:
            event.ignore()  # the page scrolls
            return True
        at = self._pixels(event.position())
        axes = self._axes_at(at)
        if axes is not None:
            self.zoom(_CLOSER ** (event.angleDelta().y() / 120.0), at, axes)
        return True

    def _mouse(self, event: QMouseEvent) -> bool:
        at, kind = self._pixels(event.position()), event.type()
        axes = self._axes_at(at)
        if kind == QEvent.Type.MouseButtonDblClick:
            if self.pick is None or not self.pick(at, True):
                self.show_everything()
            return True
        if kind == QEvent.Type.MouseButtonPress and self.pick is not None:
            self.pick(at, False)
        left_button = event.button() == Qt.MouseButton.LeftButton
        if kind == QEvent.Type.MouseButtonPress and left_button and axes is not None and not _in_space(axes):
            self._grabbed = axes
            axes.start_pan(*at, cast("MouseButton", 1))
        elif kind == QEvent.Type.MouseButtonRelease and self._grabbed is not None:
            self._grabbed.end_pan()
            self._grabbed = None
        elif kind == QEvent.Type.MouseMove:
            if self._grabbed is not None:
                self._grabbed.drag_pan(cast("MouseButton", 1), None, *at)
                self._follow()
            self._read(axes, at)
        return False

    def _press(self, event: QKeyEvent) -> bool:
        key = Qt.Key
        moves = {key.Key_Left: (-1, 0), key.Key_Right: (1, 0), key.Key_Down: (0, -1), key.Key_Up: (0, 1)}
        if event.key() in moves:
            self._move(*moves[key(event.key())])
        elif event.key() in (key.Key_Plus, key.Key_Equal):
            self.zoom(_CLOSER)
        elif event.key() == key.Key_Minus:
            self.zoom(1.0 / _CLOSER)
        elif event.key() in (key.Key_0, key.Key_Home):
            self.show_everything()
        else:
            return False
        return True

    def _move(self, right: int, up: int) -> None:
        for axes in self.axes:
            if _in_space(axes):
                axes.view_init(elev=axes.elev - _TURN * up, azim=axes.azim - _TURN * right)
                continue
            box = axes.bbox
            x, y = _STEP * right * box.width, _STEP * up * box.height
            _look_at(axes, (box.x0 + x, box.y0 + y), (box.x1 + x, box.y1 + y))
            if right and _joined(axes, self.axes[-1]):
                break  # the others follow
        self._follow()

    def _read(self, axes: Axes | None, at: tuple[float, float]) -> None:
        """Show the values at the cursor."""
        self.readout.setVisible(axes is not None and not _in_space(axes))
        if axes is None or _in_space(axes):
            return
        x, y = axes.transData.inverted().transform(at)
        said = self.tip(at) if self.tip is not None else ""
        self.readout.setText(said or values_at(self.plots[self.axes.index(axes)], float(x), float(y)))
        self.readout.adjustSize()
        self.readout.move(self.width() - self.readout.width() - 10, 6)
        self.readout.raise_()

    def _open_menu(self, event: QContextMenuEvent) -> None:
        menu = build.styled(QMenu(self), attribute=Qt.WidgetAttribute.WA_DeleteOnClose)
        menu.addAction(_("Show everything"), self.show_everything)
        menu.addAction(_("Save plot…"), self.ask_where_to_save)
        menu.addAction(_("Copy picture"), lambda: QApplication.clipboard().setPixmap(self.grab()))
        menu.popup(event.globalPos())

    def ask_where_to_save(self) -> None:
        """Ask for a file, and save the plots in it."""
        kinds = ";;".join(_(text) for text in FILES.values())
        dialog = build.ask_path(self, _("Save the figure"), None, self._save_to, kinds, save="", default_suffix="png")
        dialog.filterSelected.connect(lambda text: dialog.setDefaultSuffix(text.rpartition("*.")[2].rstrip(")")))

    def _save_to(self, path: Path) -> None:
        if path.suffix.lower() not in FILES:
            path = path.with_name(f"{path.name}.png")
        try:
            self.save(path)
            message = _("Saved in {path}.").format(path=path)
        except OSError as error:
            message = str(error)
        self.readout.setText(message)
        self.readout.adjustSize()
        self.readout.move(10, 6)
        self.readout.show()
        self.readout.raise_()

    # -- drawing ------------------------------------------------------------------------------------------

    @property
    def _rows(self) -> list[list[Plot]]:
        """The plots in rows."""
        return [list(self.plots)] if self._side_by_side else [[plot] for plot in self.plots]

    def draw_pending(self) -> None:
        """Draw what was given since the plots were last drawn, or lay them out for a new size."""
        if self._stale:
            self._draw()
        elif self._unsettled:
            self._lay_out()

    def _draw(self) -> None:
        """Draw everything, and lay it out."""
        from tissueid.reports.plot_renderer import draw_grid, draw_relief
        from tissueid.reports.style import localise_numbers

        canvas = self._make_canvas()
        canvas.setVisible(True)
        self.cover.hide()
        self._inside.activate()  # gives the canvas its size before the plots are laid out
        figure = canvas.figure
        self._stale, self._scale, self._grabbed = False, 1.0, None
        figure.clear()
        figure.set_facecolor(appearance.theme.panel)
        look = _look_of(appearance.theme, self.font().pointSizeF())
        if self._relief:
            self._axes, self._long = [draw_relief(figure, self.plots[0], look, units=shown)], [[]]
        else:
            self._axes, self._long = draw_grid(figure, self._rows, look, units=shown, key=self._key)
        localise_numbers(figure)
        self._lay_out()
        self._home = [
            (axes.get_xlim(), axes.get_ylim(), (axes.elev, axes.azim) if _in_space(axes) else None)
            for axes in self._axes
        ]

    def _make_canvas(self) -> Any:
        if self.canvas is None:
            from matplotlib.backends.backend_qtagg import FigureCanvasQTAgg
            from matplotlib.figure import Figure

            make: Any = FigureCanvasQTAgg  # which has no annotations
            options: Any = {"layout": "none"}  # reports that are drawn in another thread set one for all figures
            self.canvas = make(Figure(dpi=self.logicalDpiX(), **options))
            build.styled(
                self.canvas,
                focus_policy=self.focus,
                mouse_tracking=True,
                size_policy=(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Ignored),
            )
            self.canvas.installEventFilter(self)
            self._inside.addWidget(self.canvas, 1)
            self._describe()
        return self.canvas

    def _take_size(self, event: QResizeEvent) -> None:
        """Give the figure the size of its canvas."""
        size, dots = event.size(), self.canvas.figure.dpi / self.canvas.device_pixel_ratio
        self.canvas.figure.set_size_inches(size.width() / dots, size.height() / dots, forward=False)

    def _again(self) -> None:
        """Draw again what is shown, now or when it is shown."""
        if self.plots and not all(plot.missing for plot in self.plots):
            self._stale = True
            if self.isVisible():
                request_drawing(self)

    def settle(self) -> None:
        """Lay the plots out for a size that has settled."""
        self._unsettled = bool(self._axes) and self.canvas.size() != self._laid_out_for
        if self._unsettled and self.isVisible():
            request_drawing(self)

    def _lay_out(self) -> None:
        """Make room for labels once, not in every frame."""
        from tissueid.reports.plot_axes import lay_out

        canvas = self.canvas
        self._unsettled = False
        if canvas is not None:
            self._laid_out_for = canvas.size()
        if canvas is not None and canvas.width() > 1 and canvas.height() > 1:
            lay_out(canvas.figure)
            canvas.draw()

    def _follow(self) -> None:
        """Draw the visible part of long lines, and the frame."""
        for axes, lines in zip(self.axes, self._long, strict=True):
            for line in lines:
                low, high = sorted(axes.get_xlim())
                line.show(low, high, max(2, int(axes.bbox.width)))
        if self.canvas is not None:
            self.canvas.draw_idle()

    def _describe(self) -> None:
        """Give the canvas its accessible name."""
        names = [self._name] if self._name else [translated(plot.title) for plot in self.plots]
        title = ", ".join(dict.fromkeys(filter(None, names)))
        units = ", ".join(dict.fromkeys(filter(None, (shown(unit_of_values(plot))[0] for plot in self.plots))))
        description = self._description or " ".join(filter(None, (extremes(plot) for plot in self.plots)))
        if self._relief:
            description = f"{description} {_(_HOW)}"
        text = _("Plot: {title}, {unit}") if units else _("Plot: {title}")
        for widget in [self] if self.canvas is None else [self, self.canvas]:
            build.styled(widget, name=text.format(title=title, unit=units), accessible_description=description)

    @property
    def _scrolled(self) -> bool:
        """Whether the widget lies on a page that scrolls."""
        parent = self.parentWidget()
        while parent is not None:
            if isinstance(parent, QScrollArea):
                return True
            parent = parent.parentWidget()
        return False

    def _pixels(self, position: QPointF) -> tuple[float, float]:
        """Return a position on the canvas in the pixels of the figure, from its lower left corner."""
        assert self.canvas is not None
        x, y = self.canvas.mouseEventCoords(position)
        return float(x), float(y)

    def pixels(self, x: Array, y: Array) -> Array:
        """Return where points (n,) of the first plot, in its own units, lie on the canvas: (n, 2), pixels."""
        plot = self.plots[0]
        inside = np.column_stack([shown(plot.x.unit)[1] * x, shown(plot.y.unit)[1] * y])
        return np.asarray(self.axes[0].transData.transform(inside), np.float64)

    def values(self, at: Point) -> Point:
        """Return abscissa and ordinate of a point on the canvas, in the units of the first plot."""
        x, y = self.axes[0].transData.inverted().transform(at)
        return float(x) / shown(self.plots[0].x.unit)[1], float(y) / shown(self.plots[0].y.unit)[1]

    def _axes_at(self, at: tuple[float, float]) -> Axes | None:
        return next((axes for axes in self.axes if axes.bbox.contains(*at)), None)


def _in_space(axes: Axes) -> TypeGuard[Axes3D]:
    return axes.name == "3d"


def _joined(axes: Axes, other: Axes) -> bool:
    return bool(axes.get_shared_x_axes().joined(axes, other))


def _look_at(axes: Axes, low: tuple[float, float], high: tuple[float, float]) -> None:
    """Show what lies between two corners, in pixels of the figure."""
    back = axes.transData.inverted()
    (x0, y0), (x1, y1) = back.transform(low), back.transform(high)
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)


def _look_of(theme: Theme, font_size: float) -> Look:
    """Return the colours of a theme for the renderer."""
    from tissueid.reports.plot_axes import Look

    return Look(theme.text, theme.muted, theme.line, theme.panel, max(7.0, 0.85 * font_size), asdict(theme))
