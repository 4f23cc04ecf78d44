"""The recommendation: the simplest model that no other beats, and its texts."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from coded import codes, refused, says
from identification import simulated, simulated_dpn
from scipy import signal

from tissueid.analysis import compare, specifications, split_records
from tissueid.identification import Family
from tissueid.identification import recommendation_messages as messages
from tissueid.identification.recommendation import (
    ModelCandidate,
    ModelStanding,
    Recommendation,
    SufficientOption,
    recommend,
    sufficient,
)
from tissueid.identification.recommendation_messages import VafDifference, difference
from tissueid.language import set_language
from tissueid.messages import Message, code_of, translated
from tissueid.records import Record

N = 8000
RATE = 2000.0


def coloured(seed: int, size: float, n: int = N) -> np.ndarray:
    """Noise (n,) of that standard deviation that depends on itself for some ten milliseconds."""
    white = simulated.generator(seed).standard_normal(n + 500)
    found = signal.lfilter([1.0], [1.0, -0.9], white)[500:]
    return size * found / np.std(found)


@pytest.fixture
def held_out() -> Record:
    return Record(coloured(1, 1.0), 0.012 + coloured(2, 1e-3), RATE)


@pytest.fixture
def german() -> Iterator[None]:
    set_language("de")
    yield
    set_language("en")


def candidate(engine: str, family: Family, error: np.ndarray, **changes: object) -> ModelCandidate:
    known = dict(parameters=250.0, vaf_percent=95.0, aicc=-1000.0)
    return ModelCandidate(engine, family, error, **(known | changes))  # type: ignore[arg-type]


def linear_and_kernels(noise: float, linear: float, kernels: float, **changes: object) -> list[ModelCandidate]:
    """Two candidates that share their noise and err besides, each by so much (m)."""
    shared = coloured(3, noise)
    return [
        candidate("lms", Family.LINEAR, shared + coloured(4, linear), **changes),
        candidate("volterra", Family.KERNELS, shared + coloured(5, kernels)),
    ]


def reason_left(found: Recommendation) -> Message:
    """Return why the candidate with the highest score is not the recommended one."""
    [reason] = [text for text in found.reasons if isinstance(text, Message) and "why" in text.values]
    return reason.values["why"]


def why_left(found: Recommendation) -> str:
    return reason_left(found).code


class TestDifference:
    def test_a_lead_in_points_with_its_chance(self, held_out: Record):
        better, worse = coloured(3, 2e-4), coloured(3, 2e-4) + coloured(4, 2e-4)
        found = difference(better, worse, held_out.output, RATE)
        assert found.points == pytest.approx(4.0, abs=1.0)  # of a variance 25 times that of the added error
        assert found.reduction == pytest.approx(0.5, abs=0.1)
        assert found.std_points is not None
        assert found.p_value < 1e-6
        back = difference(worse, better, held_out.output, RATE)
        assert back.points == pytest.approx(-found.points)
        assert back.p_value == pytest.approx(1.0 - found.p_value)

    def test_an_offset_does_not_count(self, held_out: Record):
        error, other = coloured(3, 2e-4), coloured(4, 3e-4)
        plain = difference(error, other, held_out.output, RATE)
        moved = difference(error + 1.0, other, held_out.output, RATE)
        assert moved.points == pytest.approx(plain.points, rel=1e-6)

    def test_only_common_samples_count(self, held_out: Record):
        error, other = coloured(3, 2e-4), coloured(4, 3e-4)
        holed = simulated.changed(error, (np.s_[:3000], np.nan))
        cut = Record(held_out.input[3000:], held_out.output[3000:], RATE)
        whole = difference(holed, other, held_out.output, RATE)
        assert whole.n_samples == N - 3000
        assert whole.points == pytest.approx(difference(error[3000:], other[3000:], cut.output, RATE).points)

    def test_a_model_does_not_differ_from_itself(self, held_out: Record):
        error = coloured(3, 2e-4)
        found = difference(error, error, held_out.output, RATE)
        assert (found.points, found.p_value, found.reduction) == (0.0, None, 0.0)

    def test_few_samples_leave_the_chance_open(self, held_out: Record):
        found = difference(coloured(3, 2e-4)[:20], coloured(4, 4e-4)[:20], held_out.output[:20], RATE)
        assert np.isfinite(found.points)
        assert (found.std_points, found.p_value) == (None, None)

    def test_nothing_in_common_is_not_a_number(self, held_out: Record):
        found = difference(np.full(N, np.nan), coloured(4, 1e-4), held_out.output, RATE)
        assert np.isnan(found.points)
        assert found.p_value is None

    @pytest.mark.soak
    @pytest.mark.parametrize("colour", [0.0, 0.9, 0.98])
    def test_chance_is_what_it_says(self, colour: float):
        """Of two models that err alike one seems better at 5 % one time in twenty."""
        runs, n = 2000, 2000
        rng = simulated.generator(77)

        def noise(size: float) -> np.ndarray:
            return size * np.sqrt(1 - colour**2) * signal.lfilter([1], [1, -colour], rng.standard_normal(n + 500))[500:]

        hits = 0
        for _ in range(runs):
            shared = noise(1.0)
            p_value = difference(shared + noise(0.3), shared + noise(0.3), noise(3.0), RATE).p_value
            hits += p_value is not None and p_value < 0.05
        print(f"colour {colour}: {100 * hits / runs:.1f} % at 5 %")
        assert 0.035 <= hits / runs <= 0.065


class TestChoice:
    def test_a_lead_that_counts_is_followed(self, held_out: Record):
        found = recommend(linear_and_kernels(5e-5, 3e-4, 1e-5), held_out, held_out)
        assert (found.engine, found.family) == ("volterra", Family.KERNELS)
        assert [s.engine for s in found.standings] == ["volterra", "lms"]
        assert found.standings[1].beaten
        assert not found.standings[0].beaten
        [lead] = [text for text in found.reasons if code_of(text) == "recommendation.significant_lead"]
        assert says(lead, "recommendation.significant_lead", name="Volterra", other="LMS")

    def test_a_lead_within_chance_is_not(self, held_out: Record):
        found = recommend(linear_and_kernels(0.0, 3.05e-4, 3e-4), held_out, held_out)
        assert found.family is Family.LINEAR
        if found.standings[0].engine == "volterra":
            assert why_left(found) == "recommendation.within_chance"

    def test_a_lead_too_small_to_matter_is_not(self, held_out: Record):
        """A few per cent less error variance, certain as it is, says nothing of the tissue."""
        found = recommend(linear_and_kernels(3e-4, 3e-5, 0.0), held_out, held_out)
        best = found.standings[0]
        assert best.engine == "volterra"
        assert found.standings[1].behind.p_value < 0.01
        assert found.engine == "lms"
        assert why_left(found) == "recommendation.small_reduction"
        assert reason_left(found).values["percent"] == pytest.approx(2.5, abs=0.05)

    def test_one_that_errs_wildly_at_times_is_not_let_through(self, held_out: Record):
        """The lead on it is not certain, just because it is so wild; but it does worse than one that is beaten."""
        wild = coloured(6, 1e-4)
        wild[3000:3200] += coloured(7, 4e-3)[:200]
        found = recommend(
            [
                candidate("lms", Family.LINEAR, coloured(3, 3e-4)),
                candidate("cascade", Family.STATIC, wild),
                candidate("dpn", Family.PARAMETRIC, coloured(4, 1e-4)),
            ],
            held_out,
            held_out,
        )
        lead = next(s.behind for s in found.standings if s.engine == "cascade")
        assert lead.p_value > 0.05
        assert found.engine == "dpn"

    def test_of_one_family_aicc_decides_what_unseen_samples_do_not(self, held_out: Record):
        both = [
            candidate("one", Family.STATIC, coloured(3, 3.00e-4), aicc=-1000.0),
            candidate("two", Family.STATIC, coloured(4, 3.02e-4), aicc=-2000.0),
        ]
        assert recommend(both, held_out, held_out).engine == "two"

    def test_three_numbers_are_simpler_than_a_response(self, held_out: Record):
        error = coloured(3, 3e-4)
        both = [
            candidate("lms", Family.LINEAR, error, aicc=-2000.0),
            candidate("lms", Family.LINEAR, error + coloured(4, 1e-6), second_order=True),
        ]
        found = recommend(both, held_out, held_out)
        assert found.second_order
        assert "recommendation.second_order_suffices" in codes(found.reasons)

    def test_one_that_was_judged_on_fewer_samples_is_compared_on_those(self, held_out: Record):
        shared = coloured(3, 5e-5)
        partly = simulated.changed(shared, (np.s_[:6000], np.nan))
        found = recommend(
            [
                candidate("lms", Family.LINEAR, shared + coloured(4, 3e-4)),
                candidate("slow", Family.KERNELS, partly),
            ],
            held_out,
            held_out,
        )
        assert found.engine == "slow"
        assert [(s.engine, s.behind.n_samples) for s in found.standings] == [("slow", 2000), ("lms", 2000)]

    def test_nothing_scored_is_refused(self, held_out: Record):
        refused(
            lambda: recommend([candidate("lms", Family.LINEAR, np.full(N, np.nan))], held_out, held_out),
            "recommendation.nothing_held_out",
        )

    def test_the_smallest_value_that_does_as_well_is_sufficient(self, held_out: Record):
        shared = coloured(3, 1e-4)
        trials = [(0.03, shared + coloured(4, 3e-4)), (0.06, shared + coloured(5, 1e-6)), (0.12, shared)]
        assert sufficient(trials, held_out) == 0.06
        refused(lambda: sufficient([(0.1, np.full(N, np.nan))], held_out), "recommendation.no_value")


class TestMessages:
    def recommended(self, held_out: Record, *, fitted: Record | None = None, **changes: object) -> Recommendation:
        return recommend(
            linear_and_kernels(0.0, 3.05e-4, 3e-4, **changes), held_out, fitted or held_out, judged_on="test 2"
        )

    def test_it_is_json(self, held_out: Record):
        found = self.recommended(held_out).with_choice(
            "memory", [(0.03, coloured(3, 3e-4)), (0.06, coloured(3, 3e-4))], held_out
        )
        answer = found.as_dict()
        assert json.loads(json.dumps(answer, allow_nan=False)) == answer
        assert answer["choices"]["memory"]["value"] == 0.03
        assert answer["judged_on"] == "test 2"
        assert says(found.sentences[1], "recommendation.memory", value="0.03")
        assert answer["messages"]["headline"]["code"] == "recommendation.linear"
        assert [one["code"] for one in answer["messages"]["choices"]] == ["recommendation.memory"]

    def test_a_short_part_is_doubted(self, held_out: Record):
        short = Record(held_out.input[:1000], held_out.output[:1000], RATE)
        found = recommend([candidate("lms", Family.LINEAR, coloured(3, 1e-4)[:1000])], short, held_out)
        assert says(found.doubts[0], "recommendation.short", seconds="0.5")

    def test_a_shallow_part_is_doubted(self, held_out: Record):
        deep = Record(held_out.input, 0.012 + 3.0 * (held_out.output - 0.012), RATE)
        assert "recommendation.narrow" in codes(self.recommended(held_out, fitted=deep).doubts)

    def test_a_part_beyond_the_fitted_range_is_doubted(self, held_out: Record):
        shallow = Record(held_out.input, 0.012 + 0.3 * (held_out.output - 0.012), RATE)
        [doubt] = [
            text
            for text in self.recommended(held_out, fitted=shallow).doubts
            if code_of(text) == "recommendation.extrapolation"
        ]
        assert doubt.values["high"].endswith(" mm")

    def test_a_fit_that_does_not_last_is_doubted(self, held_out: Record):
        assert "recommendation.overfit" in codes(self.recommended(held_out, vaf_percent=99.9).doubts)

    def test_disagreement_of_aicc_is_a_doubt(self, held_out: Record):
        doubts = recommend(
            [
                candidate("lms", Family.LINEAR, coloured(3, 3e-4), aicc=-1000.0),
                candidate("volterra", Family.KERNELS, coloured(4, 3e-4), aicc=-3000.0),
            ],
            held_out,
            held_out,
        ).doubts
        assert says(doubts[-1], "recommendation.aicc_disagrees", name="Volterra")

    def test_a_much_better_score_with_the_measured_output_is_a_doubt(self, held_out: Record):
        doubts = recommend(
            [candidate("depth", Family.DEPTH, coloured(3, 4e-4), scheduled_percent=99.0)], held_out, held_out
        ).doubts
        assert says(doubts[-1], "recommendation.scheduled", output="depth", name="Depth", percent=99.0)

    def test_a_score_far_below_the_ceiling_is_a_doubt(self, held_out: Record):
        only = [candidate("lms", Family.LINEAR, coloured(3, 4e-4))]
        found = recommend(only, held_out, held_out, ceiling_percent=99.5)
        assert says(found.doubts[-1], "recommendation.below_ceiling", percent=99.5)
        assert "recommendation.measure_creep" in codes(found.experiments)
        assert "recommendation.measure_repeat" in codes(recommend(only, held_out, held_out).experiments)

    def test_a_lead_within_reach_says_how_long_to_measure(self, held_out: Record):
        """A lead of twice its standard deviation short of a decision needs some seconds more."""
        for share in np.linspace(1.0, 1.2, 40):
            both = [
                candidate("lms", Family.LINEAR, coloured(3, share * 3e-4)),
                candidate("volterra", Family.KERNELS, coloured(4, 3e-4)),
            ]
            found = recommend(both, held_out, held_out)
            p_value = found.standings[1].behind.p_value
            if found.engine == "lms" and p_value is not None and 0.06 < p_value < 0.2:
                assert says(found.experiments[0], "recommendation.measure_longer", seconds="4", name="Volterra")
                return
        pytest.fail("no size of error made a lead that was nearly certain")

    def test_other_signals_are_not_called_depth(self):
        record = Record(coloured(1, 1.0), coloured(2, 1.0), RATE, output_name="current", output_unit="A")
        both = [
            candidate("wiener", Family.STATIC, coloured(3, 0.1)),
            candidate("lms", Family.LINEAR, coloured(4, 0.3)),
        ]
        found = recommend(both, record, record)
        assert says(found.headline, "recommendation.static", output="current")
        assert code_of(found.headline.values["score"]) == "recommendation.score_of_signal"

    def test_a_family_alone_is_not_praised(self, held_out: Record):
        found = recommend([candidate("lms", Family.LINEAR, coloured(3, 3e-4))], held_out, held_out)
        assert says(found.headline, "recommendation.one_family", family="the linear models")

    def test_what_describes_nothing_is_called_so(self, held_out: Record):
        both = [
            candidate("lms", Family.LINEAR, coloured(3, 1.1e-3)),
            candidate("volterra", Family.KERNELS, coloured(4, 1.5e-3)),
        ]
        assert says(recommend(both, held_out, held_out).headline, "recommendation.none", name="LMS")

    def test_hundredths_of_a_point_do_not_make_a_description(self, held_out: Record):
        """Near 100 % a richer model may be better beyond any doubt, and the simpler one says all the same."""
        found = recommend(linear_and_kernels(0.0, 3e-5, 1e-6), held_out, held_out)
        assert found.engine == "lms"
        assert why_left(found) == "recommendation.small_lead"


def recommended(record: Record, names: tuple[str, ...]) -> Recommendation:
    return compare(specifications(names), split_records([record])).recommendation


def test_a_linear_record_needs_a_line():
    found = recommended(simulated.linear_record(5, snr_db=30.0), ("lms", "spectral", "wiener"))
    assert found.family is Family.LINEAR
    assert found.second_order
    assert says(found.headline, "recommendation.linear")


def test_a_wiener_record_needs_a_curve():
    found = recommended(simulated.wiener_record(5), ("lms", "spectral", "wiener"))
    assert (found.engine, found.family) == ("wiener", Family.STATIC)
    assert says(found.headline, "recommendation.static", output="depth", name="Wiener")


@pytest.mark.soak
@pytest.mark.parametrize(
    ("family", "make"),
    [
        (Family.LINEAR, partial(simulated.linear_record, snr_db=40.0)),
        (Family.LINEAR, partial(simulated.linear_record, snr_db=20.0, colour=0.9)),
        (Family.PARAMETRIC, partial(simulated_dpn.record, simulated_dpn.SKIN)),
        (Family.STATIC, simulated.wiener_record),
    ],
)
def test_the_family_of_the_system_is_recommended(family: Family, make: Callable[[int], Record]):
    names = ("lms", "spectral", "wiener", "dpn", "volterra")
    right = sum(recommended(make(100 + seed), names).family is family for seed in range(20))
    print(f"{family}: {right} of 20")
    assert right >= 18


def test_every_text_has_german(german: None):
    said: set[str] = set()
    for basis in every_basis():
        said |= {messages.headline(basis), *messages.reasons(basis), *messages.doubts(basis)}
        said |= set(messages.experiments(basis))
    for option, value in itertools.product(("memory", "partitions", "order", "levels"), (0.1, 4.0)):
        said.add(messages.choice(SufficientOption(option, value, (0.1, 4.0), (80.0, 81.0))))
    assert len({code_of(text) for text in said}) > 25
    english = {"the", "and", "of", "to", "is", "it", "from", "with", "that", "most", "than", "would", "at"}
    assert not [text for text in said if english & set(translated(text).replace(",", "").split())]


def every_basis() -> Iterator[messages.Basis]:
    time = np.linspace(0.0, 30.0, 4000)
    fitted = Record(time, 1e-3 * np.sin(time), 1000.0)
    names = ("position", "force", "acceleration_x")
    unseen = [Record(time, size * np.sin(time), 1000.0, output_name=name) for size in (2e-4, 5e-3) for name in names]
    leads = [VafDifference(points, 2.5, chance, 0.02, 900) for points in (0.05, 1.0) for chance in (0.0001, 0.3, None)]
    short = Record(time[:500], time[:500], 1000.0)
    for family, record, lead in itertools.product(Family, [*unseen, short], leads):
        usual = ModelStanding("wiener", family, False, 80.0, 90.0, None, 12.0, lead, lead, True)
        chosen = replace(usual, engine="lms", vaf_percent=70.0)
        best = replace(usual, engine="volterra", family=Family.OTHER, vaf_percent=75.0, scheduled_percent=99.0)
        below = replace(usual, engine="rls", family=Family.LINEAR, second_order=True)
        yield messages.Basis(chosen, (best, chosen, below), record, fitted, 99.0)
        yield messages.Basis(replace(chosen, aicc=1.0, second_order=True), (best, chosen, below), record, fitted, None)
        yield messages.Basis(replace(chosen, vaf_percent=40.0), (best, chosen), record, fitted, None)
        yield messages.Basis(chosen, (chosen,), record, fitted, None)
