"""The page of several tests in one figure, in both languages."""

from __future__ import annotations

from dataclasses import replace

import pytest
from reports import in_german as language
from reports.page_check import checked
from reports.synthetic_sitting import make_session, make_test

from tissueid.analysis.overlay import NamedFit, Overlay, TestSource, overlay
from tissueid.identification import get_engine
from tissueid.reports import page as blocks
from tissueid.reports.overlay_page import overlay_report

FITS = {
    "lms": {"memory": 0.05},
    "wiener": {"memory": 0.05},
    "volterra": {"method": "exact", "memory": 0.02, "downsample": 4},
    "depth": {"partitions": 2, "memory": 0.02, "correct": False},
}


@pytest.fixture(scope="module")
def found() -> Overlay:
    session = make_session(make_test(1, seconds=2.0), make_test(2, seconds=2.0, seed=5))
    fits = [NamedFit(name, get_engine(name).from_options(options)) for name, options in FITS.items()]
    return overlay([TestSource(name, session, (number,)) for name, number in (("aa", 1), ("bb", 2))], fits)


@pytest.fixture
def texts_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are texts, which are not drawn."""
    monkeypatch.setattr(blocks, "to_svg", language.texts_as_svg)


@pytest.mark.usefixtures("texts_alone")
def test_the_page_has_every_figure_and_table(found: Overlay) -> None:
    page = checked(overlay_report(found).html())
    assert {
        "depth", "scores", "bode-by-depth", "impulse-by-depth", "responses", "nonlinearity", "correlations",
        "first-kernels", "second-kernels", "partitions",
    } <= set(page.ids)  # fmt: skip
    text = " ".join(page.text.split())
    assert "Mean and standard deviation over tests" in text
    assert "aa, volterra" in text
    assert overlay_report(found, keys=("scores",)).pictures[0].key == "scores"


@pytest.mark.usefixtures("texts_alone")
def test_the_page_says_nothing_in_english(found: Overlay) -> None:
    texts = language.in_german(lambda: language.shown(overlay_report(found).html()))
    assert language.english_in(texts, ("aa", "bb", "lms", "wiener", "volterra", "depth", "memory")) == []


def test_six_fits_by_depth_are_drawn_in_blocks_of_equal_width(found: Overlay) -> None:
    entries = [replace(one, source=name) for one in found.entries if one.fit.label == "depth" for name in "abc"]
    drawn = overlay_report(replace(found, entries=tuple(entries)), keys=("partitions", "bode-by-depth"))
    for made in drawn.pictures:
        assert made.figure is not None
        panels = [axes for axes in made.figure.axes if axes.get_label() != "<colorbar>"]
        assert min(axes.get_position().width for axes in panels) > 0.15  # a warning of the layout is an error here
