from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import pytest
from coded import made
from identification import simulated_stepped
from matplotlib.figure import Figure
from reports.in_german import english_in, in_german, texts_of
from reports.synthetic_sitting import make_session, make_test

from tissueid.analysis import Analysis, fit_split, split, split_records
from tissueid.analysis.curves.plot import depth_roles
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine, FitReport, Model
from tissueid.identification.registry import engine_names, get_engine
from tissueid.messages import Message, code_of
from tissueid.records import Record, joined
from tissueid.reports import page
from tissueid.reports.figures.registry import Declared, FigureSubject, all_figures, figure, figures_of
from tissueid.reports.page import Picture
from tissueid.reports.plot_axes import PAGE
from tissueid.reports.style import DEPTHS, DIVERGING, to_svg
from tissueid.reports.tables import parameter_table, score_table, settings_tables

SMALL: dict[str, dict[str, object]] = {
    "als": {"memory": 0.04, "levels": 3},
    "cascade": {"memory": 0.04, "structure": "nln", "degree": 3},
    "depth": {"memory": 0.03, "partitions": 3, "correct": False},
    "direction": {"memory": 0.03, "partitions": 2, "correct": False},
    "dpn": {"max_degree": 1, "spare_degree": 0},
    "hammerstein": {"memory": 0.04, "degree": 3},
    "lms": {"memory": 0.04},
    "localized": {"memory": 0.06},
    "rls": {"memory": 0.04},
    "spectral": {"window": 0.25, "memory": 0.04},
    "volterra": {"memory": 0.02, "order": 2},
    "wiener": {"memory": 0.04},
}
"""Options that keep every engine quick on a few seconds of record."""


def analysed(name: str, record: Record, **options: object) -> Analysis:
    return fit_split(get_engine(name).from_options(SMALL.get(name, {}) | options), split_records([record]))


def stepped() -> Record:
    force = simulated_stepped.staircase(7, levels=4, continuous=900)
    return Record(force, simulated_stepped.wiener(force), simulated_stepped.RATE)


@pytest.fixture(scope="module")
def record() -> Record:
    return make_test(seconds=6.0).record()


@pytest.fixture(scope="module")
def subjects(record: Record) -> dict[str, FigureSubject[Model]]:
    found = {}
    for name in engine_names():
        analysis = analysed(name, stepped() if name == "localized" else record)
        found[name] = FigureSubject(name, analysis.model, analysis, 0.010)
    return found


def ours() -> list[Declared]:
    return [one for one in all_figures() if one.model.__module__.startswith("tissueid.")]


def drawn(subject: FigureSubject[Model], key: str) -> tuple[Figure | None, str]:
    one = next(one for one in figures_of(subject) if one.key == key)
    picture = one.picture(subject)
    return picture.figure, picture.caption or picture.missing


@pytest.fixture(scope="module")
def german_pictures(subjects: dict[str, FigureSubject[Model]]) -> list[tuple[FigureSubject[Model], Declared, Picture]]:
    """All figures of all engines, made once; in German, so that texts can be checked too."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return in_german(
            lambda: [
                (subject, one, one.picture(subject)) for subject in subjects.values() for one in figures_of(subject)
            ]
        )


def test_every_engine_draws_all_its_figures(
    german_pictures: list[tuple[FigureSubject[Model], Declared, Picture]],
) -> None:
    untried = set(ours())
    for subject, one, picture in german_pictures:
        assert picture.figure is not None, (subject.name, one.key, picture.missing)
        assert len(picture.caption) > 40
        assert "nan" not in picture.caption.split()
        assert len(picture.alt) > 20
        shown = [axes for axes in picture.figure.axes if axes.get_visible() and axes.axison]
        assert any(axes.get_xlabel() for axes in shown), (subject.name, one.key)
        assert any(axes.get_ylabel() for axes in shown), (subject.name, one.key)
        untried.discard(one)
    assert {(one.model.__name__, one.key) for one in untried} == {("VolterraModel", "third-kernel")}


def test_figures_of_every_engine_say_nothing_in_english(
    german_pictures: list[tuple[FigureSubject[Model], Declared, Picture]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "to_svg", lambda _figure, _key, alt: alt)
    texts = in_german(lambda: [text for _, _, picture in german_pictures for text in texts_of(picture)])
    assert english_in(texts) == []


def test_settings_and_scores_of_every_engine_say_nothing_in_english(subjects: dict[str, FigureSubject[Model]]) -> None:
    analyses = {name: subject.analysis for name, subject in subjects.items()}
    session = make_session()
    tables = in_german(
        lambda: [
            *settings_tables(session, session.test(1), analyses),
            score_table(analyses),
            parameter_table(analyses),
        ]
    )
    texts = [
        text for table in tables for row in (table.head, *table.rows) for text in (*row, table.caption, table.note)
    ]
    device, test = session.instrument, session.test(1)
    data = (device.model, device.serial_number, session.session_id, session.subject.pseudonym, test.site)
    assert english_in(texts, data) == []


def test_figures_become_svg_in_the_colours_of_the_page(subjects: dict[str, FigureSubject[Model]]) -> None:
    alternative = "what it shows"
    for name, key in (("volterra", "second-kernel"), ("depth", "kernels"), ("hammerstein", "blocks")):
        figure_, _ = drawn(subjects[name], key)
        assert figure_ is not None
        source = to_svg(figure_, "k", alternative)
        assert f'aria-label="{alternative}"' in source
        assert "var(--fig-ink)" in source
    assert "var(--fig-depth-9)" in source or "var(--fig-series-1)" in source


def test_third_order_kernel_is_drawn_as_slices(record: Record) -> None:
    analysis = analysed("volterra", record, order=3, memory=0.006, downsample=1, method="exact")
    figure_, caption = drawn(FigureSubject("volterra", analysis.model, analysis), "third-kernel")
    assert figure_ is not None
    assert len(caption) > 40
    figure_, _ = drawn(FigureSubject("volterra", analysis.model, analysis), "contributions")
    assert figure_ is not None
    assert [axes.get_title(loc="left") for axes in figure_.axes][-1] == made("volterra.third_order")


@pytest.mark.parametrize(
    ("name", "options", "key", "reason"),
    [
        ("volterra", {"order": 0}, "first-kernel", "report.no_kernels"),
        ("volterra", {"order": 1}, "second-kernel", "report.no_second_kernel"),
        ("hammerstein", {"iterations": 1}, "iterations", "report.single_pass"),
        ("depth", {"partitions": 1}, "kernel-image", "report.no_image"),
        ("als", {"levels": 1}, "by-depth", "report.no_depth_levels"),
    ],
)
def test_figures_that_cannot_be_drawn_say_why(
    record: Record, name: str, options: dict[str, object], key: str, reason: str
) -> None:
    analysis = analysed(name, record, **options)
    figure_, said = drawn(FigureSubject(name, analysis.model, analysis), key)
    assert figure_ is None
    assert isinstance(said, Message)
    assert said.code == "report.left_out"
    assert code_of(said.values["reason"]) == reason


def test_gaps_and_joined_records_are_drawn(record: Record) -> None:
    holed = Record(record.input.copy(), record.output.copy(), record.sample_rate_hz)
    for first in (300, 900, 2200):
        holed.input[first : first + 20] = np.nan
        holed.output[first : first + 20] = np.nan
    analysis = analysed("depth", joined([holed, record]))
    subject = FigureSubject("depth", analysis.model, analysis)
    missing = {one.key: one.picture(subject).missing for one in figures_of(subject) if one.key != "residual-tests"}
    assert not any(missing.values()), missing


@dataclass(frozen=True, eq=False)
class _Still(Model):
    def simulate(self, u: Array) -> Array:
        return np.where(np.isfinite(u), 1e-3 * u, np.nan)


class _StillEngine(Engine):
    name = "still"

    def fit(self, record: Record, fit_part: slice | None = None) -> Model:
        return _Still(FitReport("still", {}, len(record), 1, 0.0), record.sample_rate_hz, 1)


def test_an_engine_without_figures_gets_the_general_ones(record: Record) -> None:
    analysis = fit_split(_StillEngine(), split_records([record]))
    subject = FigureSubject("still", analysis.model, analysis)
    keys = [one.key for one in figures_of(subject)]
    assert keys == ["prediction", "scatter", "horizon", "residual-tests"]
    for key in keys[:2]:
        assert drawn(subject, key)[0] is not None


def test_a_figure_declared_twice_is_refused() -> None:
    def other(subject: FigureSubject[_Still]) -> tuple[Figure, str]:
        raise UnusableInputError("never drawn")

    declare = figure(_Still, "same", "Same", "nothing", group="linear", applies=lambda _subject: False)
    assert declare(other) is other
    with pytest.raises(ValueError, match="two figures of _Still are called 'same'"):
        figure(_Still, "same", "Same", "nothing", group="linear")(lambda subject: other(subject))


def test_images_are_clear_at_zero_and_even_about_it() -> None:
    below, at, above = (np.array(DIVERGING(value)) for value in (0.25, 0.5, 0.75))
    assert at[3] == pytest.approx(0.0, abs=0.01)
    assert below[3] == pytest.approx(above[3], abs=0.01)
    assert below[2] > below[0]
    assert above[0] > above[2]


def test_colours_go_from_shallow_to_deep() -> None:
    assert [PAGE.colour(role) for role in depth_roles(9)] == list(DEPTHS)
    assert [PAGE.colour(role) for role in depth_roles(1)] == [DEPTHS[-1]]
    assert PAGE.colour(depth_roles(3)[0]) == DEPTHS[0]


def test_keys_and_headings_fit_a_page() -> None:
    for one in ours():
        assert one.key == one.key.lower().replace(" ", "-")
        assert 5 < len(one.heading) < 60
        assert one.alt.endswith(".")


def test_split_of_a_session_can_be_drawn() -> None:
    session = make_session(make_test(seconds=1.5))
    analysis = fit_split(get_engine("lms").from_options({"memory": 0.03}), split(session))
    assert drawn(FigureSubject("lms", analysis.model, analysis), "impulse")[0] is not None
