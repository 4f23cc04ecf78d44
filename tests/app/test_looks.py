"""What can be seen, reached and read: names for screen readers, mnemonics, tab order, palettes, units, sizes."""

import re

import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QAbstractButton, QAbstractSpinBox, QApplication, QComboBox, QLabel, QLineEdit

from tissueid.app.plotting import LogAxis, PlotCard
from tissueid.app.theme import DARK, LIGHT, appearance, theme_of

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

CONTROLS = (QAbstractButton, QAbstractSpinBox, QComboBox, QLineEdit)


@pytest.fixture
def window(fresh_window):
    return fresh_window


def controls(window):
    """Everything that can be operated, without the inner parts of spin boxes, lists and tab bars."""
    inside = (QComboBox, QAbstractSpinBox)
    every = [widget for kind in CONTROLS for widget in window.findChildren(kind)]
    own = [widget for widget in every if not isinstance(widget.parentWidget(), inside)]
    return [widget for widget in own if widget.focusPolicy() != Qt.FocusPolicy.NoFocus]


def test_every_control_has_a_name(window):
    nameless = [
        widget
        for widget in controls(window)
        if not widget.accessibleName() and not (isinstance(widget, QAbstractButton) and widget.text())
    ]
    # The button of a notice has a text once there is something to offer.
    assert [widget for widget in nameless if widget is not window.ui.notice.offer] == []
    for plot in (*(card.plot for card in window.ui.signals.cards), *window.ui.result.cards):
        assert plot.accessibleName().startswith("Plot: ")


@pytest.mark.parametrize("page", ["start", "measure", "research", "gap", "instrument", "studies"])
def test_no_two_mnemonics_on_a_page_are_the_same(window, page):
    window.pages.show(page)
    window.ui.notice.say("something", offer="Re&cover")
    others = [view for name, view in window.ui.views.items() if name != page]
    parts = [item for kind in (QLabel, QAbstractButton) for item in window.findChildren(kind)]
    texts = [part.text() for part in parts if not any(view.isAncestorOf(part) for view in others)]
    if page == "measure":
        texts += [window.ui.pages.tabText(number) for number in range(window.ui.pages.count())]
    letters = [found.group(1).lower() for text in texts if "<" not in text and (found := re.search(r"&(\w)", text))]
    assert len(letters) >= (15 if page == "measure" else 4)
    assert sorted(letters) == sorted(set(letters))


def test_the_tab_key_visits_everything_from_top_to_bottom(qtbot, window):
    ui = window.ui
    ui.form.fold.setChecked(True)
    ui.form.instrument.choice.setFocus()
    visited = [window.focusWidget()]
    for _ in range(40):
        qtbot.keyClick(window.focusWidget(), Qt.Key.Key_Tab)
        if window.focusWidget() is visited[0]:
            break
        visited.append(window.focusWidget())
    form = ui.form
    expected = [form.instrument.choice, form.instrument.refresh, form.site, form.map, form.subject, form.product]
    expected += [*form.set_up.fields[:3], form.limits, form.preset, form.fold]
    options = [field for field in form.stimulus.option_fields(depths=False) if field.isVisible() and field.isEnabled()]
    expected += [form.stimulus.kind, form.stimulus.stop_when, form.stimulus.live_method, *options]
    expected += [
        *(field.controls[0] for name, field in form.options.items() if name != "rest_s"),
        form.path,
        form.browse,
    ]
    expected += [ui.guidance.lamp.watch]
    expected += [ui.start, ui.stop, ui.role.choice, ui.open, ui.pages.tabBar()]
    assert visited == [*expected, ui.rail.buttons["measure"], *ui.rail.feet]


def test_a_key_that_is_held_down_presses_once(qtbot, window):
    pressed = []
    window.ui.stop.clicked.connect(lambda: pressed.append(1))
    from PySide6.QtCore import QEvent
    from PySide6.QtGui import QKeyEvent

    for repeat in (False, True, True):
        event = QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_Return, Qt.KeyboardModifier.NoModifier, "\r", repeat)
        QApplication.sendEvent(window.ui.stop, event)
    assert pressed == [1]


def palette_with(window_colour, text_colour):
    palette = QPalette(QColor(window_colour), QColor(window_colour))
    palette.setColor(QPalette.ColorRole.WindowText, QColor(text_colour))
    return palette


def test_the_window_follows_the_palette(qtbot, window, qapp):
    plot = window.ui.signals.force.plot
    before = qapp.palette()
    try:
        for theme, palette in ((DARK, palette_with("#202020", "#f0f0f0")), (LIGHT, palette_with("#f0f0f0", "#101010"))):
            qapp.setPalette(palette)
            qtbot.waitUntil(lambda theme=theme: plot.backgroundBrush().color().name() == theme.panel)
            assert theme.stop in window.styleSheet()
            assert window.ui.form.subject.palette().color(QPalette.ColorRole.Text).name() == theme.text
            assert window.ui.form.subject.palette().color(QPalette.ColorRole.Base).name() == theme.field
    finally:
        qapp.setPalette(before)


def contrast(first, second):
    """Contrast ratio of WCAG 2.1."""

    def luminance(name):
        parts = [value / 255 for value in QColor(name).getRgb()[:3]]
        linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    lighter, darker = sorted((luminance(first), luminance(second)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_text_and_curves_can_be_told_from_what_lies_behind_them(theme):
    for text in (theme.text, theme.muted, theme.good, theme.check, theme.poor):
        assert contrast(text, theme.panel) >= 4.5
        assert contrast(text, theme.window) >= 4.5
    for curve in (theme.measured, theme.model, theme.amber):
        assert contrast(curve, theme.panel) >= 3.0
    assert contrast("#ffffff", theme.stop) >= 4.5
    assert contrast(theme.accent_text, theme.accent) >= 3.0  # large and bold


def test_a_dark_palette_is_known_by_its_lightness():
    assert theme_of(palette_with("#000000", "#ffffff")) is DARK
    assert theme_of(palette_with("#ffffff", "#000000")) is LIGHT


def test_axes_keep_the_unit_of_their_label(qtbot):
    card = PlotCard("Unseen motion", "Time (s)", "mm")
    qtbot.addWidget(card)
    card.show()
    for theme in (LIGHT, DARK, LIGHT):
        appearance.use(theme)
        card.plot.setXRange(0.0, 0.4)
        card.plot.setYRange(0.0, 2e-6)
        for side in ("bottom", "left"):
            assert card.plot.getAxis(side).autoSIPrefixScale == 1.0
    assert "(x" not in card.plot.getAxis("bottom").labelString()


@pytest.mark.parametrize(
    ("low", "high", "size", "labels"),
    [
        (0.0, 2.0, 400, ["1", "2", "5", "10", "20", "50", "100"]),
        (-3.0, 0.0, 100, ["0.001", "0.01", "0.1", "1"]),
        (0.4, 0.6, 300, []),
    ],
)
def test_a_logarithmic_axis_is_labelled_with_plain_numbers(qapp, low, high, size, labels):
    axis = LogAxis("bottom")
    ((spacing, values),) = axis.tickValues(low, high, size)
    assert axis.tickStrings(values, 1.0, spacing) == labels


def test_it_fits_a_small_screen(window, qapp):
    assert window.minimumSizeHint().width() <= 1280
    assert window.minimumSize().height() <= 660
    window.resize(1280, 660)
    qapp.processEvents()
    for button in (window.ui.start, window.ui.stop):
        bottom = button.mapTo(window, button.rect().bottomRight())
        assert bottom.y() < 660
