from dataclasses import dataclass

import numpy as np
import pytest

from tissueid.identification.levenberg_marquardt import Bounds, SecantProblem, minimise


@dataclass(frozen=True, eq=False)
class Place:
    theta: np.ndarray
    residuals: np.ndarray
    cost: float


class Rosenbrock:
    """Residuals 10 (y - x^2) and 1 - x with exact slopes; a third parameter may be without effect."""

    def __init__(self, parameters: int = 2, beyond: float = np.inf) -> None:
        self.parameters, self.beyond = parameters, beyond

    def point(self, theta) -> Place:
        residuals = np.array([10.0 * (theta[1] - theta[0] ** 2), 1.0 - theta[0]])
        return Place(theta, residuals, float(residuals @ residuals))

    def linearised(self, at):
        jacobian = np.zeros((2, self.parameters))
        jacobian[:, :2] = [[-20.0 * at.theta[0], 10.0], [-1.0, 0.0]]
        return jacobian.T @ jacobian, -jacobian.T @ at.residuals

    def attempt(self, at, step):
        return None if abs(at.theta[0] + step[0]) > self.beyond else self.point(at.theta + step)

    def refresh(self, _at):
        return False


def test_a_curved_valley_is_followed_to_its_end():
    problem = Rosenbrock()
    found = minimise(problem, problem.point(np.array([-1.2, 1.0])), most_steps=100, tolerance=1e-12)
    assert found.converged
    assert found.point.theta == pytest.approx([1.0, 1.0], abs=1e-6)
    short = minimise(problem, problem.point(np.array([-1.2, 1.0])), most_steps=3, tolerance=1e-12)
    assert (short.converged, short.steps) == (False, 3)
    assert short.point.cost < problem.point(np.array([-1.2, 1.0])).cost


def test_a_parameter_without_effect_stays_where_it_is():
    problem = Rosenbrock(parameters=3)
    found = minimise(problem, problem.point(np.array([-1.2, 1.0, 7.0])), most_steps=100, tolerance=1e-12)
    assert found.point.theta == pytest.approx([1.0, 1.0, 7.0], abs=1e-6)


def test_steps_that_cannot_be_evaluated_are_shortened():
    problem = Rosenbrock(beyond=1.25)
    found = minimise(problem, problem.point(np.array([-1.2, 1.0])), most_steps=200, tolerance=1e-12)
    assert found.point.theta == pytest.approx([1.0, 1.0], abs=1e-6)


def test_no_step_is_longer_than_its_reach():
    problem = Rosenbrock()
    seen = []
    attempt = problem.attempt
    problem.attempt = lambda at, step: seen.append(np.abs(step)) or attempt(at, step)
    start = problem.point(np.array([-1.2, 1.0]))
    minimise(problem, start, most_steps=5, tolerance=0.0, bounds=Bounds.of_steps(np.array([0.1, 0.3])))
    assert np.all(np.max(seen, axis=0) <= [0.1, 0.3])


def test_slopes_that_are_not_finite_end_the_search_at_the_start():
    problem = Rosenbrock()
    problem.linearised = lambda _at: (np.full((2, 2), np.nan), np.full(2, np.nan))
    start = problem.point(np.array([-1.2, 1.0]))
    found = minimise(problem, start, most_steps=5, tolerance=1e-9)
    assert found.point is start
    assert found.steps == 0


def test_secants_find_the_minimum_within_bounds_with_few_evaluations():
    target = np.array([1.0, 4.0])
    calls = {"residuals": 0, "jacobian": 0}

    def evaluate(at):
        calls["residuals"] += 1
        return np.concatenate([at - target, 0.1 * (at**2 - target**2)]), "extra"

    def derivatives(at, _residuals):
        calls["jacobian"] += 1
        return np.vstack([np.eye(2), np.diag(0.2 * at)])

    bounds = Bounds(np.zeros(2), np.array([2.0, 3.0]), np.full(2, 10.0))
    flat = np.zeros(2), np.full(2, np.inf)
    problem = SecantProblem(evaluate, derivatives, np.full(2, 1e-4), bounds, flat)
    found = minimise(problem, problem.start(np.array([0.5, 0.5])), most_steps=40, tolerance=1e-4, bounds=bounds)
    assert found.converged
    assert found.point.theta == pytest.approx([1.0, 3.0], abs=1e-2)
    assert found.point.extra == "extra"
    assert calls["jacobian"] < calls["residuals"]


def test_a_prior_draws_the_minimum_towards_its_mean():
    bounds = Bounds(np.full(1, -10.0), np.full(1, 10.0), np.full(1, 10.0))
    problem = SecantProblem(
        lambda at: (at - 1.0, None), lambda _at, _r: np.eye(1), np.ones(1), bounds, (np.zeros(1), np.ones(1))
    )
    found = minimise(problem, problem.start(np.array([5.0])), most_steps=50, tolerance=1e-12, bounds=bounds)
    assert found.point.theta == pytest.approx([0.5], abs=1e-6)
