"""Sweeps held against each other, and figures over dates: the numbers and the words."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from coded import coded, codes, is_german, says

from tissueid.calibration import CalibratedQuantity, Calibration
from tissueid.calibration.comparison import (
    compare_sweeps,
    drift_text,
    linear_region,
    profile_of,
    residuals,
    trend,
)
from tissueid.calibration.status import label_of
from tissueid.errors import UnusableInputError

PLACES = tuple(0.002 * k for k in range(1, 16))


def sweep(days=0, share=1.0, *, std=0.015, noise=0.004, low=0.004, high=0.027, **changes):
    """A sweep so many days after the first of March, whose force constant is 3 N/A by a share, rounded off outwards."""
    shape = [3.0 * share * (1.0 - 40.0 * max(0.0, abs(place - 0.016) - 0.011)) for place in PLACES]
    q = {
        "force_constant_n_per_a": CalibratedQuantity(value=3.0 * share, std=std, unit="N/A"),
        "linear_region_min_m": CalibratedQuantity(value=low, std=5e-5, unit="m"),
        "linear_region_max_m": CalibratedQuantity(value=high, std=5e-5, unit="m"),
        "moving_mass_kg": CalibratedQuantity(value=0.060, unit="kg"),
    }
    tables = {
        "force_constant": {
            "position_m": PLACES,
            "value_n_per_a": tuple(shape),
            "std_n_per_a": tuple(0.01 for _ in PLACES),
        },
        "sweep": {
            "position_m": PLACES[::-1],
            "vaf_percent": tuple(99.0 for _ in PLACES),
            "force_constant_std_n_per_a": tuple(noise * math.sqrt(12) for _ in PLACES),
            "mass_kg": tuple(0.06 + place for place in PLACES[::-1]),
        },
    }
    made = datetime(2026, 3, 1, 9, tzinfo=UTC) + timedelta(days=days)
    fields = {
        "kind": "sweep",
        "model": "indenter",
        "serial_number": "A-1",
        "date": made.strftime("%Y-%m-%dT%H:%M:%SZ"),
        "software": "t",
        "verdict": "passed",
        "conditions": {"spring_stiffness_n_per_m": 1000.0},
        "quantities": q,
        "tables": tables,
    }
    return Calibration(**(fields | changes))


def static(days, value, **changes):
    figures = {"coil_resistance_ohm": CalibratedQuantity(value=value, std=0.003, unit="ohm")}
    return sweep(days, kind="static", quantities=figures, tables=changes.pop("tables", {}), **changes)


@pytest.mark.parametrize(
    ("share", "verdict", "code", "size", "known"),
    [
        (1.0, "noise", "drift.none", None, None),
        (1.002, "noise", "drift.higher", "0.2 %", None),
        (0.988, "uncertainty", "drift.lower", "1.2 %", "1.4 %"),
        (0.97, "beyond", "drift.lower", "3.0 %", "1.4 %"),
    ],
)
def test_a_drift_has_its_significance(share, verdict, code, size, known):
    found = compare_sweeps(sweep(20, share), sweep(0))
    assert found.before.date.startswith("2026-03-01")
    assert says(found.message, code, quantity="Force constant", date="2026-03-01")
    assert is_german(found.message)
    if size:
        assert str(found.message.values["difference"]) == size
        assert found.message.values["significance"].code == f"drift.{verdict}"
    if known:
        assert str(found.message.values["significance"].values["uncertainty"]) == known
    assert found.differences[0].verdict == verdict
    assert found.differences[0].relative == pytest.approx(share - 1.0)
    assert found.profile == pytest.approx(share - 1.0, abs=1e-9)


def test_a_size_that_rounds_to_its_uncertainty_is_told_finer():
    found = compare_sweeps(sweep(0), sweep(9, 1.0145))
    sizes = [found.message.values["difference"], found.message.values["significance"].values["uncertainty"]]
    assert [str(size) for size in sizes] == ["1.45 %", "1.41 %"]
    assert says(found.message, "drift.higher", date="2026-03-01")


def test_the_noise_is_that_of_repeats_where_there_are_some():
    tables = sweep().tables | {"repeats": {"run": (1.0, 2.0), "force_constant_n_per_a": (2.99, 3.01)}}
    found = compare_sweeps(sweep(0, tables=tables), sweep(3, 1.01, tables=tables))
    assert found.differences[0].noise == pytest.approx(0.01 * math.sqrt(2))


def test_ends_of_the_linear_region_are_compared_in_millimetres():
    found = compare_sweeps(sweep(0), sweep(1, low=0.0052, high=0.025))
    ends = {item.name: item for item in found.differences}
    assert math.isnan(ends["linear_region_min_m"].relative)
    assert ends["linear_region_min_m"].absolute == pytest.approx(1.2e-3)
    said = drift_text(ends["linear_region_max_m"], "2026-03-01")
    assert says(said, "drift.lower", quantity=label_of("linear_region_max_m"))
    assert said.values["difference"].value == pytest.approx(2.0)
    assert str(said.values["significance"].values["uncertainty"]) == "0.14 mm"
    assert found.common_m == pytest.approx((0.0052, 0.025))


def test_what_has_no_deviation_is_not_judged():
    heavier = {"moving_mass_kg": CalibratedQuantity(value=0.066, unit="kg")}
    found = compare_sweeps(sweep(0), sweep(1, quantities=sweep().quantities | heavier))
    mass = next(item for item in found.differences if item.name == "moving_mass_kg")
    assert mass.verdict == "unknown"
    said = drift_text(mass, "2026-03-01")
    assert str(said.values["difference"]) == "10.0 %"
    assert said.values["significance"].code == "drift.unknown"


def test_sweeps_that_are_not_of_one_kind_are_compared_with_a_remark():
    other = sweep(1, serial_number="B-2", verdict="failed", conditions={"spring_stiffness_n_per_m": 900.0})
    remarks = compare_sweeps(sweep(0), other).remarks
    assert codes(remarks) == ["drift.instruments", "drift.springs", "drift.failed"]
    assert says(remarks[0], "drift.instruments", one="A-1", other="B-2")
    assert all(map(is_german, remarks))


def test_sweeps_with_nothing_in_common_are_not_compared_along_the_stroke():
    found = compare_sweeps(sweep(0, low=0.004, high=0.01), sweep(1, low=0.02, high=0.027))
    assert found.common_m is None
    assert math.isnan(found.profile)
    bare = compare_sweeps(sweep(0), sweep(1, tables={}, quantities={}))
    assert bare.differences == ()
    assert bare.message.code == "drift.no_force_constant"


def test_only_sweeps_are_compared():
    with pytest.raises(UnusableInputError, check=coded("drift.not_sweeps")):
        compare_sweeps(sweep(0), static(1, 12.0))


def test_profiles_rise_with_the_position_and_leave_out_what_cannot_be():
    mass = profile_of(sweep(), "mass")
    assert np.all(np.diff(mass.position_m) > 0)
    assert mass.value == pytest.approx(0.06 + mass.position_m)
    assert mass.std is None
    assert profile_of(sweep(), "damping") is None
    absurd = {
        "force_constant": {"position_m": PLACES, "value_n_per_a": (1e300, *sweep().tables["sweep"]["mass_kg"][1:])}
    }
    assert profile_of(sweep(tables=absurd), "force_constant").value.size == len(PLACES) - 1
    one = {"force_constant": {"position_m": (0.01,), "value_n_per_a": (3.0,)}}
    assert profile_of(sweep(tables=one), "force_constant") is None
    assert linear_region(sweep(low=0.02, high=0.01)) is None


def test_residuals_are_those_of_tables_that_fit():
    tables = {
        "electrical": {"voltage_v": (1.0, 2.0), "residual_a": (1e-3, -1e-3)},
        "force": {"current_a": (1.0, 2.0)},
        "position": {"position_m": (0.01, 0.02), "residual_m": (1e-6, 1e300)},
    }
    current, position = residuals(static(0, 12.0, tables=tables))
    assert (current.x_unit, current.y_unit) == ("V", "A")
    assert current.y == pytest.approx([1e-3, -1e-3])
    assert position.x.size == 1


def test_a_trend_is_the_slope_over_the_dates():
    found = trend([static(days, 12.0 + 0.3 * days / 365.25) for days in (365, 0, 100, 200)], "coil_resistance_ohm")
    assert found.dates == tuple(sorted(found.dates))
    assert found.per_year.value == pytest.approx(0.3, rel=1e-6)
    assert says(found.message, "trend.rises", slope=pytest.approx(2.46, abs=0.02))
    assert str(found.message.values["std"]) == "0.0 %"
    assert is_german(found.message)


def test_a_trend_wants_three_days():
    found = trend([static(0, 12.0), static(1, 12.1)], "coil_resistance_ohm")
    assert found.per_year is None
    assert says(found.message, "trend.too_few", least=3)
    steady = trend([static(days, 12.0) for days in (0, 10, 20)], "coil_resistance_ohm")
    assert steady.message.code == "trend.none"
    with pytest.raises(UnusableInputError, check=coded("trend.no_quantity", quantity="Force constant")):
        trend([static(0, 12.0)], "force_constant_n_per_a")
