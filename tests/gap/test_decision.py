"""Decisions from scores, on candidates made by hand."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest

from tissueid.gap.decision import (
    Candidate,
    ChannelError,
    Grounds,
    Tried,
    can_stand_for,
    confirmed,
    cost,
    decide,
    explains,
    is_gap,
    is_needed,
    probabilities,
    shows_in_the_check_alone,
)
from tissueid.gap.diagnosis import needs_strict_fit
from tissueid.gap.thresholds import THRESHOLDS
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import STAGES


def candidate(score: float, *orders: int) -> Candidate:
    """Return a candidate with a score and the parameters of its effects; no effect for 0."""
    effects = [SimpleNamespace(name="any", order=order) for order in orders or (1,) if order]
    fitted = SimpleNamespace(parameters=SimpleNamespace(effects=effects), theta=np.zeros(sum(orders)))
    left = ChannelError(1, "position", float(np.exp(2.0 * score)), 1.0, 10.0, 1000)
    return Candidate(tuple(item.name for item in effects), fitted, (left,), (left,))  # type: ignore[arg-type]


def test_every_coordinate_costs():
    assert cost(candidate(1.0, 2)) - cost(candidate(1.0, 1)) == pytest.approx(THRESHOLDS.complexity)


def test_the_number_of_penalised_coordinates_is_limited():
    most = THRESHOLDS.most_counted
    assert cost(candidate(1.0, most + 3)) == pytest.approx(cost(candidate(1.0, most)))
    assert cost(candidate(1.0, most, 3)) - cost(candidate(1.0, most, 2)) == pytest.approx(THRESHOLDS.complexity)


def tried(score: float, closed: float, *effects: str, strict: bool = False) -> Tried:
    """Return a fitted candidate whose cost is its score."""
    return Tried(effects or ("dry_friction",), score, score, closed, strict)


def test_no_gap_where_little_is_left():
    assert not is_gap(0.0)
    assert not is_gap(0.9 * THRESHOLDS.least_score)
    assert is_gap(1.1 * THRESHOLDS.least_score)


def test_a_rare_event_can_show_in_the_check_only():
    quiet, loud = candidate(0.05, 0), candidate(1.0, 0)
    assert not shows_in_the_check_alone(quiet)
    assert shows_in_the_check_alone(replace(quiet, checked_by=loud.checked_by))


def test_a_candidate_at_the_floor_explains_the_gap():
    assert explains(3.0, tried(0.05, 0.99))
    assert explains(3.0, tried(1.0, 0.9))


@pytest.mark.parametrize(("left", "closed"), [(2.5, 0.9), (1.0, 0.3), (2.9, 0.1), (1.0, float("nan"))])
def test_a_candidate_that_leaves_much_explains_nothing(left, closed):
    assert not explains(3.0, tried(left, closed))


def test_a_large_gain_explains_whatever_share_of_the_score_is_left():
    gain = THRESHOLDS.explained_gain
    assert explains(15.0, tried(15.0 - 1.01 * gain, 0.6))
    assert not explains(15.0, tried(15.0 - 0.99 * gain, 0.6))
    assert not explains(15.0, tried(15.0 - 2.0 * gain, 0.4))
    assert not explains(15.0, tried(15.0 - 2.0 * gain, 0.9, strict=True))
    assert probabilities(15.0, [15.0 - 2.0 * gain])[0] > 0.9 > 0.5 > probabilities(15.0, [15.0 - 0.5 * gain])[0]


@pytest.mark.parametrize(
    ("left", "closed", "holds"),
    [(0.2, 0.9, True), (1.5, 0.6, True), (0.2, 0.1, True), (0.9, 0.1, False), (1.5, -2.0, False), (1.5, np.nan, True)],
)
def test_the_check_confirms_an_explanation_by_score_or_closed_share(left, closed, holds):
    assert confirmed(2.0, left, closed) is holds


def test_a_strict_fit_leaves_less():
    assert explains(3.0, tried(1.0, 0.9))
    assert not explains(3.0, tried(1.0, 0.9, strict=True))
    assert explains(3.0, tried(0.9 * 3.0 * THRESHOLDS.clear_share, 0.9, strict=True))
    assert explains(0.3, tried(0.9 * THRESHOLDS.at_the_floor, 0.9, strict=True))
    assert probabilities(3.0, [1.0])[0] > 0.9 > 0.1 > probabilities(3.0, [1.0], clearly=True)[0]


def decided(*items: Tried) -> frozenset[str]:
    return decide(Grounds(3.0, items))


def test_a_set_is_named_with_the_members_that_are_needed():
    one, both = tried(2.0, 0.5, "amplifier_clipping"), tried(0.05, 0.99, "amplifier_clipping", "dry_friction")
    other = tried(1.5, 0.6, "dry_friction")
    assert decided(one, other, both) == {"amplifier_clipping", "dry_friction"}
    idle = tried(0.04, 0.99, "amplifier_clipping", "dry_friction", "mains_hum")
    assert decided(one, other, both, idle) == {"amplifier_clipping", "dry_friction"}


def test_a_single_effect_is_named_where_the_set_is_hardly_better():
    assert decided(tried(0.3, 0.89, "mains_hum"), tried(0.1, 0.95, "amplifier_clipping", "dry_friction")) == {
        "mains_hum"
    }


@pytest.mark.parametrize(
    ("one", "other", "stands"),
    [
        ("eddy_currents", "force_constant_position", True),
        ("cogging", "tissue_stiffening", True),
        ("tissue_stiffening", "cogging", True),
        ("eddy_currents", "dry_friction", False),
        ("viscoelasticity", "tissue_hysteresis", True),
        ("sensor_nonlinearity", "latency", True),
        ("latency", "sensor_nonlinearity", False),
        ("mains_hum", "amplifier_clipping", False),
    ],
)
def test_effects_of_a_stage_and_those_that_are_mistaken_for_each_other_can_stand_for(one, other, stands):
    assert can_stand_for(effect(one), effect(other)) is stands


@pytest.mark.parametrize(("other", "named"), [("force_constant_position", False), ("dry_friction", True)])
def test_an_effect_next_to_one_that_nearly_closes_the_gap_can_stand_for_its_form(other, named):
    alone, both = tried(1.0, 0.98, "eddy_currents"), tried(0.05, 0.999, "eddy_currents", other)
    assert is_needed(alone, both) is named
    little = tried(2.0, THRESHOLDS.structural - 0.1, "eddy_currents")
    assert is_needed(little, both)


@pytest.mark.parametrize(
    ("others", "added", "named"),
    [
        (("mount_resonance", "directional_damping"), "added_mass", True),
        (("mount_resonance",), "added_mass", False),
        (("directional_damping",), "viscoelasticity", True),
        (("added_mass", "directional_damping"), "mount_resonance", False),
    ],
)
def test_an_effect_of_living_tissue_next_to_another_stands_for_no_form(others, added, named):
    assert is_needed(tried(2.6, 0.94, *others), tried(0.15, 0.999, *others, added)) is named


@pytest.mark.parametrize(("other", "named"), [("viscoelasticity", True), ("dry_friction", False)])
def test_effects_of_living_tissue_are_expected_and_need_not_leave_little(other, named):
    alone, both = tried(2.0, 0.6, "amplifier_clipping"), tried(1.5, 0.7, "amplifier_clipping", other)
    assert is_needed(alone, both) is named


@pytest.mark.parametrize(("left", "found", "named"), [(3.6, 0.11, True), (3.6, 0.3, False), (1.5, 0.11, False)])
def test_a_member_that_brings_a_large_remainder_to_the_floor_stands_for_no_form(left, found, named):
    others = ("amplifier_clipping", "directional_damping")
    assert is_needed(tried(left, 0.93, *others), tried(found, 0.999, *others, "quadratic_drag")) is named


def test_members_together_stand_for_a_form_only_if_each_can():
    alone = tried(1.9, 0.95, "amplifier_clipping")
    assert is_needed(alone, tried(0.3, 0.99, "amplifier_clipping", "amplifier_drift", "dry_friction"))
    assert not is_needed(alone, tried(0.3, 0.99, "amplifier_clipping", "amplifier_drift"))


def test_grounds_come_back_from_json():
    grounds = Grounds(3.0, (tried(0.05, 0.99, "amplifier_clipping"),))
    again = Grounds.from_dict(json.loads(json.dumps(asdict(grounds))))
    assert decide(again) == decide(grounds) == {"amplifier_clipping"}


@pytest.mark.parametrize(
    ("effects", "shares", "asked"),
    [
        (("cogging",), {"mechanics": 1.0}, True),
        (("dry_friction",), {"mechanics": 1.0}, False),
        (("cogging", "dry_friction"), {"mechanics": 1.0}, False),
        (("preconditioning",), {"coil": 1.0}, True),
        (("preconditioning",), {"coil": 0.4, "tissue": 0.6}, False),
        (("preconditioning",), {"mechanics": 1.0}, False),
        (("preconditioning", "flux_saturation"), {"coil": 1.0}, False),
        (("sensor_lag",), {"coil": 1.0}, True),
        (("sensor_backlash",), {"coil": 1.0}, False),
        (("preconditioning",), {}, False),
    ],
)
def test_exact_laws_and_contradicting_evidence_need_a_strict_fit(effects, shares, asked):
    places = SimpleNamespace(shares=dict.fromkeys(STAGES, 0.0) | shares)
    assert needs_strict_fit(SimpleNamespace(effects=("mains_hum", *effects)), places, ("mains_hum",)) is asked  # type: ignore[arg-type]


def test_probabilities_leave_room_for_an_unlisted_effect():
    sure = probabilities(3.0, [0.01, 2.01])
    assert sure[0] > 0.99
    assert sum(sure) <= 1.0
    assert sure == sorted(sure, reverse=True)
    assert sum(probabilities(3.0, [2.91, 2.96])) < 0.1
    assert probabilities(3.0, []) == []


def test_equal_candidates_are_equally_likely_and_the_simpler_is_likelier():
    one, other = probabilities(3.0, [cost(candidate(0.1)), cost(candidate(0.1))])
    assert one == pytest.approx(other)
    simple, complicated = probabilities(3.0, [cost(candidate(0.1, 1)), cost(candidate(0.1, 5))])
    assert simple > complicated


@pytest.mark.parametrize(
    ("without", "found", "needed"),
    [
        ((2.0, 0.5), (0.1, 0.99), True),
        ((2.0, 0.5), (1.9, 0.99), False),
        ((0.1, 0.5), (0.0, 0.99), False),
        # A small gain suffices where it removes the rest, but not where it is chance.
        ((0.5, 0.97), (0.1, 0.99), True),
        ((0.3, 0.97), (0.05, 0.99), False),
        # The form of the effect can be wrong where a pair hardly lowers the gap, but not where the score falls by half.
        ((2.0, 0.9), (1.0, 0.95), False),
        ((2.0, 0.9), (0.85, 0.95), True),
        ((2.0, float("nan")), (0.1, float("nan")), False),
    ],
)
def test_a_member_of_a_set_must_be_needed(without, found, needed):
    alone, both = tried(*without, "amplifier_clipping"), tried(*found, "amplifier_clipping", "dry_friction")
    assert is_needed(alone, both) is needed
