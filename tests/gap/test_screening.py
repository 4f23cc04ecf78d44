"""Signatures of candidates on the residual of a baseline of a laboratory record."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_records import observed

from tissueid.gap.fit_tasks import Screen, Signature, best_aligned, cosine, effects_of
from tissueid.gap.fitting import fit
from tissueid.gap.parameters import starts_of
from tissueid.twin.catalogue import all_effects, effect

CANDIDATES = ("dry_friction", "directional_damping", "sensor_lag", "eddy_currents", "quadratic_drag")


@cache
def screen(name: str) -> Screen:
    return Screen(fit(observed(name)))


@pytest.mark.parametrize("name", ["dry_friction", "directional_damping"])
def test_the_right_effect_is_best_aligned(name):
    found = best_aligned([item for one in CANDIDATES for item in screen(name).signatures(effect(one))])
    assert found[0].effect == name
    assert {item.effect for item in found} == set(CANDIDATES)
    assert [item.alignment for item in found] == sorted((item.alignment for item in found), reverse=True)
    assert found[0].alignment > 0.9
    assert all(0.0 <= item.alignment <= 1.0 + 1e-9 for item in found)


def test_every_start_has_a_signature():
    chosen = effect("directional_damping")
    found = screen("dry_friction").signatures(chosen)
    assert {item.start for item in found} >= set(chosen.starts)


def test_surviving_signatures_are_orthogonal_to_a_refit():
    before = fit(observed("dry_friction"))
    asked = Screen(before)
    moved = before.jacobian @ np.random.default_rng(0).normal(size=before.theta.size)
    assert np.linalg.norm(asked.surviving(moved)) < 1e-6 * np.linalg.norm(moved)
    left = asked.surviving(before.residuals)
    assert asked.surviving(left) == pytest.approx(left, abs=1e-8 * np.linalg.norm(left))


def test_cosines():
    one, other = np.array([1.0, 0.0]), np.array([-1.0, 1.0])
    assert cosine(one, other) == pytest.approx(np.sqrt(0.5))
    assert cosine(one, 0.0 * other) == 0.0


def test_a_second_start_is_tried_where_it_is_nearly_as_good():
    def one(name: str, alignment: float) -> Signature:
        return Signature(name, (alignment,), alignment)

    found = best_aligned([one("a", 0.1), one("b", 0.5), one("a", 0.7), one("b", 0.45)])
    assert [(item.effect, item.alignment) for item in found] == [("a", 0.7), ("b", 0.5), ("b", 0.45)]


def test_a_resonance_between_the_declared_starts_is_found_on_the_grid():
    hidden = replace(effect("mount_resonance"), starts=((190.0, 0.05, 20.0, 2.5, 0.05, 0.0),))
    grid = screen("mount_resonance").signatures(hidden)
    away, near, on_frame = grid
    assert {near.start, on_frame.start} < set(hidden.scan)
    assert (near.start[5], on_frame.start[5]) == (0.0, 1.0)
    assert near.alignment > 3.0 * away.alignment


def test_starts_from_the_record_beyond_the_bounds_are_left_out():
    fitted = fit(observed("dry_friction"))
    inside, beyond = (0.014, 5.0, 1.25, 10.0, 1.0), (-0.03, 5.0, 1.25, 10.0, -1.0)
    one = replace(effect("end_stop"), starts_from=lambda signals, rate: (inside, beyond))
    assert starts_of(fitted.parameters.dataset, one, fitted.predictions) == (*one.starts, inside)


def test_effects_have_the_bounds_of_the_instrument():
    dataset = observed("dry_friction")
    assert effects_of(dataset) == all_effects()
    device = replace(dataset.instrument, force_constant_n_per_a=12.0, stroke_m=0.048)
    found = effects_of(replace(dataset, instrument=device))
    assert found["reluctance_force"].parameters[0].high == 16.0 * effect("reluctance_force").parameters[0].high
    assert found["end_stop"].parameters[0].high == 1.5 * effect("end_stop").parameters[0].high
    assert found["latency"] is effect("latency")
