"""Algorithms of the thesis as printed give what the engines give; simulated systems are what they say."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.identification.engines.volterra import Volterra
from tissueid.records import Record
from tissueid_lab.thesis import published_algorithms as published
from tissueid_lab.thesis.computing_times import (
    Timing,
    autocorrelation_times,
    lags_for,
    orthonormalisation_times,
    time_plot,
)
from tissueid_lab.thesis.simulated_systems import DpnSystem, WienerSystem, partition_errors


def test_gram_schmidt_and_the_engine_give_the_same_kernels() -> None:
    u, e = np.random.Generator(np.random.PCG64(1)).standard_normal((2, 600))
    y = np.convolve(u, (0.5, 1.0, 0.2))[: u.size]
    y = y - 0.1 * y**2 + 0.01 * e
    u = u - u.mean()
    model = Volterra(memory=0.005, downsample=1, method="exact").fit(Record(u, y, 1000.0))
    found = published.volterra(u, y, 4)
    assert model.kernel1 is not None
    np.testing.assert_allclose(found[1:6], model.kernel1 / 1000.0, rtol=1e-6, atol=1e-9)


def test_autocorrelations_of_all_methods_agree() -> None:
    x = np.random.Generator(np.random.PCG64(2)).standard_normal(300)
    direct = published.direct_autocorrelation(x)
    np.testing.assert_allclose(published.transformed_autocorrelation(x), direct, atol=1e-12)
    swapped = x.copy()
    swapped[[40, 47]] = swapped[[47, 40]]
    for lags in (300, 20):
        np.testing.assert_allclose(
            published.swapped_autocorrelation(x, direct[:lags], 40, 47),
            published.direct_autocorrelation(swapped)[:lags],
            atol=1e-12,
        )


@pytest.mark.parametrize("system", [WienerSystem(), DpnSystem()], ids=("Wiener", "DPN"))
def test_local_stiffness_of_a_simulated_system_is_the_slope_of_its_force(system: WienerSystem | DpnSystem) -> None:
    rest = [float(system.position(np.full(300, force), 500.0)[-1]) for force in (1.99, 2.0, 2.01)]
    slope = 0.02 / (rest[2] - rest[0])
    assert float(system.stiffness(np.array(rest[1:2]))[0]) == pytest.approx(slope, rel=1e-3)


def test_three_rows_remain_for_each_parameter() -> None:
    assert lags_for(2721) == 40  # 41 lags and 903 parameters, as in thesis 4.3
    assert lags_for(1632) == 30


def test_times_are_those_of_the_methods_and_are_drawn() -> None:
    found = (*orthonormalisation_times((3, 4, 5), rows=60), *autocorrelation_times((200, 300, 400)))
    assert all(len(one.seconds) == 3 and min(one.seconds) > 0.0 for one in found)
    assert [one.method for one in found if one.here] == [
        "here, factor", "here, solution with a stored factor", "swap, compiled",
    ]  # fmt: skip
    plot = time_plot(found[:4], "Parameters")
    assert (plot.x.log, plot.y.log, len(plot.curves)) == (True, True, 4)
    assert Timing("square", (1, 2, 4, 8), (9.0, 4.0, 16.0, 64.0)).power == pytest.approx(2.0)


def test_partitions_are_exact_from_500_points_on() -> None:
    (few, enough) = partition_errors((20, 200), (1,), (3,))
    assert np.isnan(few.mean_percent)  # fewer samples than parameters
    assert enough.points == 1000
    assert enough.mean_percent < 5.0
