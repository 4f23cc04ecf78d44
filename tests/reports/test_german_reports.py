"""Reports in German: nothing that is a text in the English report is left in English."""

import pytest
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.text import Text
from reports.in_german import SAME, in_both, in_each_language, shown

from tissueid.reports.pdf import write_pdf
from tissueid.reports.session_page import report_html


@pytest.fixture
def paper(monkeypatch, tmp_path):
    """Write the PDF of a test and return every text on its pages."""

    def write(session, test, analyses):
        texts = []

        def collect(canvas, _pages):
            texts.extend(found.get_text() for found in canvas.figure.findobj(Text))

        monkeypatch.setattr(FigureCanvasPdf, "print_pdf", collect)
        write_pdf(tmp_path / "report.pdf", session, test, analyses)
        return texts

    return write


def test_the_paper_says_nothing_in_english(session, analyses, paper):
    test = session.test(1)
    device = session.instrument
    known = {session.subject.pseudonym, session.session_id, f"{device.model}, {device.serial_number}"}
    known |= {test.site[:1].upper() + test.site[1:]}
    said = in_each_language(lambda: paper(session, test, analyses[1]))
    assert in_both(said, SAME | known) == set()
    assert {"Person", "Betrag der Nachgiebigkeit", "Impulsantwort", "Verzögerung (ms)"} <= set(said[1])


@pytest.mark.usefixtures("undrawn")
def test_the_page_of_a_test_says_nothing_in_english(session, analyses):
    device = session.instrument
    said = in_each_language(lambda: shown(report_html(session, analyses)))
    site = session.test(1).site
    known = {session.subject.pseudonym, session.session_id, f"{device.model}, {device.serial_number}", site}
    title = site[:1].upper() + site[1:]
    known |= {title, f"{title} – TissueID", session.software, device.model, device.serial_number}
    assert in_both(said, SAME | known) == set()
