"""Random schedules of faults: nothing acknowledged is lost, the coil stays within its limits, nothing hangs."""

import pytest
from faults.schedules import SECONDS, run_schedule, schedule

SHORT_S = 5.0
BLOCK = 10


def check(seed, seconds, folder):
    report = run_schedule(seed, folder, seconds)
    result = "\n".join(f"  {fault.model_dump(exclude_defaults=True)}" for fault in schedule(seed, seconds))
    assert report.problems == [], f"seed {seed}, {seconds:g} s:\n{result}\n" + "\n".join(report.problems)
    return report


@pytest.mark.parametrize("count", [4, pytest.param(10, marks=pytest.mark.soak)])
def test_short_schedules(count, tmp_path):
    reports = []
    for seed in range(count):
        folder = tmp_path / str(seed)
        folder.mkdir()
        reports.append(check(seed, SHORT_S, folder))
    assert sum(report.happened for report in reports) > count
    assert sum(report.completed for report in reports) > count // 2
    assert sum(report.broken_off for report in reports) > count // 2


def test_a_schedule_plays_the_same_way_again(tmp_path):
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
    assert run_schedule(3, tmp_path / "first", 3.0) == run_schedule(3, tmp_path / "second", 3.0)


@pytest.mark.soak
@pytest.mark.parametrize("first", range(0, 500, BLOCK))
def test_five_hundred_schedules_of_half_a_minute(tmp_path, first):
    for seed in range(first, first + BLOCK):
        folder = tmp_path / str(seed)
        folder.mkdir()
        check(seed, SECONDS, folder)
