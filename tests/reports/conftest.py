from __future__ import annotations

from collections.abc import Iterator

import pytest
from reports.in_german import texts_as_svg
from reports.synthetic_sitting import make_session, make_test

from tissueid.analysis import Analysis, analyse_all
from tissueid.reports import page, style
from tissueid.sessions import Session


@pytest.fixture(scope="module", autouse=True)
def _figures_drawn() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "to_svg", style.to_svg)
        yield


@pytest.fixture(scope="session")
def session() -> Session:
    return make_session(make_test(1, seconds=2.5), make_test(2, seconds=2.0, seed=5))


@pytest.fixture(scope="session")
def analyses(session: Session) -> dict[int, dict[str, Analysis]]:
    return {test.number: analyse_all(session, test=test) for test in session.tests}


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made but not drawn, where a test is about words: of each only the texts stand on the page."""
    monkeypatch.setattr(page, "to_svg", texts_as_svg)
