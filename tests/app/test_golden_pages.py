"""The pages Measure and Research, read as a whole. Renew them by ``python tests/golden/renew.py``."""

import pytest
from app.benches import WAIT_MS
from app.test_window import idle
from golden.golden_page import check_golden_page, lines_of_widget

from tissueid.language import set_language


@pytest.mark.parametrize(
    ("language", "role"), [pytest.param("en", "clinician", marks=pytest.mark.soak), ("de", "researcher")]
)
def test_the_page_measure_reads_as_its_golden_page(qtbot, open_window, saved, language, role):
    """Renew the pages by ``python tests/golden/renew.py``."""
    try:
        window = open_window(language=language, role=role, first_page="measure")
        qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
        before = list(lines_of_widget(window.ui.pages.currentWidget()))
        window.open_session(saved)
        qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)
        check_golden_page(f"window-measure-{language}", [*before, *lines_of_widget(window.centralWidget())])
    finally:
        set_language("en")
