"""What a stranger to the program is told: names that are none, where a report is, what a button does."""

import pytest
from app.benches import WAIT_MS
from coded import coded, shows
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLabel

from tissueid.errors import UnusableInputError
from tissueid.procedures.test_plan import reads_like_name

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture
def shown_result(qtbot, open_window, saved):
    """Opens a window with the result of a saved session."""

    def make(**changes):
        window = open_window(**changes)
        window.open_session(saved)
        qtbot.waitUntil(lambda: window.findings is not None and not window.jobs, timeout=WAIT_MS)
        return window

    return make


@pytest.mark.parametrize(
    "text",
    [
        "John Smith",
        "Smith, John",
        "  Anna   Weber ",
        "J. Smith",
        "John F. Kennedy",
        "JOHN SMITH",
        "Dr. Müller",
        "Frau Weiß",
        "Ludwig van Beethoven",
        "Jean-Luc O’Neill",
        "Łukasz Żak",
        "Ελένη Παπαδοπούλου",
        "Hans.Mueller",
        "Hans_Mueller",
        "J.Smith",
    ],
)
def test_what_reads_like_a_name(text):
    assert reads_like_name(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "P-001",
        "anonymous",
        "John",
        "subject three",
        "Subject 3",
        "AB CD",
        "A B",
        "van de",
        "Dr.",
        "P-001 left",
        "P 001",
        "P_001.a",
        "left_arm",
        "4 5",
    ],
)
def test_what_does_not(text):
    assert not reads_like_name(text)


@pytest.mark.parametrize(
    ("language", "words"),
    [pytest.param("en", "looks like a person's name", marks=pytest.mark.soak), ("de", "Name eines Menschen")],
)
def test_a_name_is_refused_until_a_person_says_that_it_is_a_pseudonym(open_window, language, words):
    form = open_window(language=language).ui.form
    assert form.like_name.isHidden()
    form.subject.setText("John Smith")
    assert form.like_name.isVisible()
    assert words in form.like_name.text()
    assert form.subject.accessibleDescription() == form.like_name.text()
    form.site.setEditText("left calf")
    with pytest.raises(UnusableInputError, check=coded("subject.name")):
        form.plan().check()
    form.is_pseudonym.setChecked(True)
    form.plan().check()
    assert form.plan().subject == "John Smith"
    form.subject.setText("John Smyth")
    assert not form.is_pseudonym.isChecked()
    form.subject.setText("P-001")
    assert form.like_name.isHidden()
    assert form.is_pseudonym.isHidden()
    assert form.subject.accessibleDescription() == ""
    form.plan().check()


@pytest.mark.parametrize(
    ("language", "pdf", "page"),
    [
        pytest.param("en", "No program here shows a PDF", "open it in a browser", marks=pytest.mark.soak),
        ("de", "Kein Programm hier zeigt PDF", "Browser"),
    ],
)
def test_a_report_that_nothing_opens_says_where_it_is(qtbot, shown_result, saved, language, pdf, page):
    asked = []
    window = shown_result(show_file=lambda path: asked.append(path) or False, language=language)
    for button, words in ((window.ui.result.pdf, pdf), (window.ui.report, page)):
        qtbot.mouseClick(button, Qt.MouseButton.LeftButton)
        qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
        assert asked[-1].parent == saved.parent
        assert asked[-1].is_file()
        assert str(asked[-1]) in window.ui.notice.text.text()
        assert words in window.ui.notice.text.text()
    assert [path.suffix for path in asked] == [".pdf", ".html"]


def test_a_report_that_is_there_is_not_written_anew(qtbot, shown_result):
    asked = []
    window = shown_result(show_file=lambda path: asked.append(path.stat().st_mtime_ns) or True)
    for _ in range(2):
        qtbot.mouseClick(window.ui.report, Qt.MouseButton.LeftButton)
        qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
    assert len(asked) == 2
    assert asked[0] == asked[1]


def test_no_abbreviation_without_its_meaning(shown_result):
    window = shown_result()
    result = window.ui.result
    labels = [label for label in result.findChildren(QLabel) if not label.isHidden() and label is not result.reasons]
    assert [label.text() for label in labels if {"VAF", "LMS"} & set(label.text().replace(",", " ").split())] == []
    assert "least squares" in result.reasons.toolTip()
    assert "(VAF)" in window.ui.analysis.vaf.toolTip()
    helped = window.panels.help.reader.toPlainText()
    assert "VAF" in helped
    assert "LMS is a linear model by least squares" in helped


def test_finishing_says_what_becomes_of_the_tests(open_window):
    bar = open_window().ui.gate.repeats
    assert shows(bar.accept.toolTip(), "sitting.finish_tip")
    assert shows(bar.repeat.toolTip(), "sitting.repeat_tip")
