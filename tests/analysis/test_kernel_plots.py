"""Kernels over two lags, or over lag and depth, as they are drawn in reports and in the window."""

from types import SimpleNamespace

import numpy as np
import pytest

from tissueid.analysis.curves.kernels import kernels_by_depth, magnitude_by_depth, second_order_kernel
from tissueid.errors import UnusableInputError
from tissueid.records import Record

LAGS = 40
RATE = 1000.0
RECORD = Record(np.zeros(50), np.zeros(50), RATE)


def partitioned(rows, edges):
    lag_s = np.arange(rows.shape[1]) / RATE
    return SimpleNamespace(
        partitions=SimpleNamespace(depths=len(rows)),
        lag_s=lag_s,
        operating_kernels=rows,
        breakpoints_m=np.array(edges),
    )


def test_second_order_kernel_is_shown_in_the_units_of_output_and_input():
    kernel = np.arange(9.0).reshape(3, 3)
    plot = second_order_kernel(SimpleNamespace(kernel2=kernel, lag_s=np.array([0.0, 1e-3, 2e-3]), order=2), RECORD)
    surface = plot.surface
    np.testing.assert_allclose(surface.values, 1e3 * kernel)
    np.testing.assert_allclose(surface.x, [0.0, 1.0, 2.0])
    assert (surface.unit, plot.x.unit, plot.y.unit) == ("mm/(N²·s²)", "ms", "ms")


@pytest.mark.parametrize(("kernel", "code"), [(None, "report.no_second_kernel"), (np.eye(2), "report.few_lags")])
def test_a_kernel_that_is_missing_or_too_short_is_refused(kernel, code):
    with pytest.raises(UnusableInputError) as refused:
        second_order_kernel(SimpleNamespace(kernel2=kernel, lag_s=np.zeros(2), order=1), RECORD)
    assert refused.value.message.code == code


def test_kernels_against_depth_lie_between_the_limits_of_their_partitions():
    rows = 1e-3 * np.array([[1.0], [2.0]]) * np.exp(-np.arange(LAGS) / 5.0)
    model = partitioned(rows, [0.010, 0.012, 0.016])
    plot = kernels_by_depth(model, RECORD)
    np.testing.assert_allclose(plot.surface.edges, [10.0, 12.0, 16.0])
    np.testing.assert_allclose(plot.surface.y, [11.0, 14.0])
    np.testing.assert_allclose(plot.surface.values, 1e3 * rows)
    assert (plot.surface.unit, plot.y.unit, plot.y.reverse) == ("mm/(N·s)", "mm", True)
    with pytest.raises(UnusableInputError):
        kernels_by_depth(partitioned(rows[:1], [0.010, 0.012]), RECORD)


def test_magnitude_at_zero_frequency_is_the_area_of_the_kernel_and_ends_where_nothing_is_left():
    time = np.arange(400) / RATE
    rows = np.array([[1e-3], [2e-3]]) * np.sin(2.0 * np.pi * 20.0 * time) * np.exp(-time / 0.02)
    found = magnitude_by_depth(partitioned(rows, [0.010, 0.012, 0.016]), RECORD).surface
    np.testing.assert_allclose(found.values[:, 0], 1e3 * np.abs(rows.sum(axis=1)) / RATE)
    assert found.x[0] == 0.0
    assert 10.0 < found.x[np.argmax(found.values[0])] < 30.0
    assert found.values[:, -1].max() < 0.05 * found.values.max()
    assert found.x[-1] < 500.0
