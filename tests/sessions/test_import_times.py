"""The clock of a record from elsewhere: steady, with holes, irregular, or none."""

import numpy as np
import pytest
from coded import coded, says
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.errors import UnusableInputError
from tissueid.messages import code_of
from tissueid.sessions.imports import Choices, Source, import_test, parse_map
from tissueid.sessions.imports.sample_clock import clock_of

MAP = ["force=force:N", "position=position:m"]


def imported(path, *options, **more):
    return import_test(Source.parsed(str(path)), parse_map(options or MAP), Choices(), **more)


def written(tmp_path, times, unit="s"):
    path = tmp_path / "a.csv"
    rows = [f"{t!r},{np.sin(k)},{0.001 * k}" for k, t in enumerate(np.asarray(times).tolist())]
    path.write_text(f"time ({unit}),force,position\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("rate", [1.0, 50.0, 100.0, 333.0, 610.3515625, 1000.0, 1024.0, 2000.0, 44100.0])
@pytest.mark.parametrize("start", [0.0, 12.345, 86400.0])
def test_a_steady_clock_has_its_rate(rate, start):
    clock = clock_of(start + np.arange(5000) / rate)
    assert clock.rate_hz == pytest.approx(rate, rel=1e-9)
    assert clock.samples == 5000
    if rate != 610.3515625:
        assert clock.rate_hz == rate


def test_rounded_times_are_a_steady_clock():
    clock = clock_of(np.round(np.arange(4000) / 600.0, 4))
    assert clock.rate_hz == pytest.approx(600.0, rel=1e-4)
    assert says(clock.notices[0], "import.jitter")


def test_missing_rows_are_left_empty_and_told(tmp_path):
    times = np.delete(np.arange(20) / 100.0, [5, 6, 12])
    found = imported(written(tmp_path, times))
    assert found.test.samples == 20
    assert np.flatnonzero(np.isnan(found.test.signals["force"])).tolist() == [5, 6, 12]
    notice = next(notice for notice in found.notices if code_of(notice) == "import.samples_missing")
    assert says(notice, "import.samples_missing", missing=3)
    assert says(notice.values["where"], "import.after_rows", row=4, others=1)


@settings(max_examples=60)
@given(data=st.data(), rate=st.sampled_from([10.0, 99.7, 2000.0]), n=st.integers(20, 200))
def test_any_few_missing_rows_are_found(data, rate, n):
    gone = data.draw(st.sets(st.integers(1, n - 2), max_size=n // 4))
    kept = np.array([k for k in range(n) if k not in gone])
    clock = clock_of(kept / rate)
    assert clock.rate_hz == pytest.approx(rate)
    assert clock.places.tolist() == kept.tolist()


@pytest.mark.parametrize(
    ("times", "code", "values"),
    [
        (
            [0.0, 0.01, 0.024, 0.03, 0.04],
            "import.irregular",
            {"most": pytest.approx(0.014)},
        ),
        ([0.0, 0.01, 0.01, 0.02], "import.time_stands_still", {"row": 2}),
        ([0.0, 0.01, 0.02, 0.0, 0.01], "import.time_runs_backwards", {"row": 3}),
        ([0.0, 0.01, float("nan"), 0.03], "import.time_missing", {"row": 2}),
        ([0.0, 0.01, 0.02, 500.0], "import.missing", {"missing": 49997, "samples": 50001}),
        ([0.0, 0.01, 0.02, 1e12], "import.gaps", {}),
        (np.cumsum(np.linspace(0.01, 0.0105, 2000)), "import.irregular", {}),
    ],
)
def test_no_clock(tmp_path, times, code, values):
    with pytest.raises(UnusableInputError, check=coded(code, **values)):
        imported(written(tmp_path, times))


def test_irregular_times_are_resampled_when_asked(tmp_path):
    rng = np.random.default_rng(1)
    times = np.sort(rng.uniform(0, 2, 400))
    times = np.delete(times, np.flatnonzero((times > 0.5) & (times < 0.7)))
    path = tmp_path / "a.csv"
    path.write_text("t,force,position\n" + "\n".join(f"{t!r},{2 * t!r},{0.001 * t!r}" for t in times.tolist()))
    found = imported(path, resample_hz=100.0)
    grid = times[0] + np.arange(found.test.samples) / 100.0
    force = found.test.signals["force"]
    np.testing.assert_allclose(force[np.isfinite(force)], 2 * grid[np.isfinite(force)], atol=1e-12)
    assert np.isnan(force[(grid > 0.52) & (grid < 0.68)]).all()
    assert {"import.resampled", "import.gaps_empty"} <= {code_of(notice) for notice in found.notices}


def test_resampling_makes_nothing_of_what_is_missing(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,force,position\n0,1,1\n1,,2\n2,3,3\n3,4,4\n")
    force = imported(path, resample_hz=2.0).test.signals["force"]
    np.testing.assert_array_equal(force, [1, np.nan, np.nan, np.nan, 3, 3.5, 4])


def test_times_without_end_are_not_resampled(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time,a,b\n0,1,2\n1e300,2,1\n1.2e308,1,2\n")
    with pytest.raises(UnusableInputError, check=coded("import.resampled_size")):
        imported(path, "time=time:s", "input=a:V", "output=b:V", resample_hz=1e9)


def test_units_of_time(tmp_path):
    assert imported(written(tmp_path, [0, 2, 4, 6], unit="ms")).test.sample_rate_hz == 500.0
    assert imported(written(tmp_path, [0, 2, 4, 6], unit="us")).test.sample_rate_hz == 500_000.0


def test_milliseconds_given_as_seconds_are_doubted(tmp_path):
    found = imported(written(tmp_path, [0, 2, 4, 6]))
    notice = next(notice for notice in found.notices if code_of(notice) == "import.rate_implausible")
    assert says(notice, "import.rate_implausible", rate=0.5)


def test_rate_in_place_of_times(tmp_path):
    path = written(tmp_path, [0.0, 0.01, 0.024, 0.03, 0.04])
    assert imported(path, rate_hz=100.0).test.samples == 5
    with pytest.raises(UnusableInputError, check=coded("import.rate_and_time")):
        imported(path, *MAP, "time=time:s", rate_hz=100.0)


def test_without_times_or_rate(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("force,position\n1,2\n3,4\n")
    with pytest.raises(UnusableInputError, check=coded("import.no_time")):
        imported(path)
    with pytest.raises(UnusableInputError, match="--resample needs times"):
        imported(path, rate_hz=10.0, resample_hz=5.0)
