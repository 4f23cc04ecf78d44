"""What both online engines do during a test: batches, gaps and looks."""

from __future__ import annotations

import numpy as np
import pytest
from identification import simulated

from tissueid.identification.engines.als import Als
from tissueid.identification.engines.rls import Rls
from tissueid.identification.online_identifier import OnlineEngine

EACH = pytest.mark.parametrize("engine", [Rls(memory=0.03), Rls(memory=0.03, forgetting=0.99), Als(memory=0.03)])
STATE = ("impulse_response", "covariance", "average_response")
"""What an identifier knows; some of it only with one of the engines."""


@EACH
def test_batch_is_update_after_update_to_the_last_bit_and_gaps_teach_nothing(engine: OnlineEngine):
    record = simulated.broadband(63, n=900, noise=0.2)
    u = simulated.changed(record.input, (400, np.nan))
    y = simulated.changed(record.output, (np.s_[500:503], np.nan))
    one, many = engine.start(1000.0), engine.start(1000.0)
    one_by_one = np.array([one.update(a, b) for a, b in zip(u.tolist(), y.tolist(), strict=True)])
    parts = np.concatenate([many.batch(u[:7], y[:7]), many.batch(u[7:650], y[7:650]), many.batch(u[650:], y[650:])])
    np.testing.assert_array_equal(one_by_one, parts)
    for name in STATE:
        np.testing.assert_array_equal(getattr(one, name, 0.0), getattr(many, name, 0.0))
    for ours, theirs in zip(one.trajectory, many.trajectory, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    unknown = np.flatnonzero(np.isnan(one_by_one))
    np.testing.assert_array_equal(unknown, [*range(29), *range(400, 430), 500, 501, 502])
    before = many.impulse_response
    many.batch(np.array([np.nan, 1.0, 2.0]), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(many.impulse_response, before)


@pytest.mark.parametrize(
    ("engine", "least_percent"),
    [(Rls(memory=0.03), 99.0), (Rls(memory=0.03, forgetting=0.99), 97.0), (Als(memory=0.03), 98.0)],
)
def test_a_look_changes_nothing(engine: OnlineEngine, least_percent: float):
    record = simulated.broadband(89, n=3000, noise=0.05)
    looked_at, left_alone = engine.start(1000.0), engine.start(1000.0)
    errors = []
    for n, (u, y) in enumerate(zip(record.input.tolist(), record.output.tolist(), strict=True)):
        errors.append(looked_at.update(u, y))
        if n % 900 == 899:
            model = looked_at.model()
            for seen in (looked_at.impulse_response, looked_at.trajectory[0], model.impulse_response, model.trajectory):
                seen[:] = 0.0
    np.testing.assert_array_equal(errors, left_alone.batch(record.input, record.output))
    assert looked_at.samples == record.input.size
    assert looked_at.model().report.vaf_percent > least_percent
