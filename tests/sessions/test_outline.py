"""What a session says before its signals are read, and one test of it alone."""

import h5py
import numpy as np
import pytest
from coded import coded

from tissueid.device import DeviceDescription
from tissueid.errors import SessionFormatError
from tissueid.sessions import Session, Subject, Test, read_outline, read_test, write_session


@pytest.fixture
def path(tmp_path):
    rng = np.random.default_rng(4)
    tests = tuple(
        Test(
            number, "stochastic", {"force": rng.normal(size=size), "position": rng.normal(size=size)}, 2000.0, site="x"
        )
        for number, size in ((1, 400), (3, 1000))
    )
    path = tmp_path / "s.h5"
    write_session(path, Session(DeviceDescription(), Subject("P-1"), tests, created="2026-01-01T00:00:00Z"))
    return path


def test_an_outline_has_all_but_the_signals(path):
    outline = read_outline(path)
    assert (outline.head.subject.pseudonym, outline.head.created) == ("P-1", "2026-01-01T00:00:00Z")
    assert [(test.test.number, test.test.site, test.samples, test.seconds) for test in outline.tests] == [
        (1, "x", 400, 0.2),
        (3, "x", 1000, 0.5),
    ]
    assert set(outline.tests[0].signals) == {"time", "force", "position"}
    assert outline.tests[0].test.signals == {}


def test_one_test_is_read_alone(path):
    assert read_test(path, 3).samples == 1000
    with pytest.raises(SessionFormatError, check=coded("session.no_test_number", number=2)):
        read_test(path, 2)


def test_an_outline_is_as_suspicious_as_reading(path, tmp_path):
    with pytest.raises(SessionFormatError, check=coded("file.missing")):
        read_outline(tmp_path / "none.h5")
    with h5py.File(path, "r+") as file:
        del file["tests/0001/signals/force"]
        file["tests/0001/signals/force"] = np.zeros(7)
    with pytest.raises(SessionFormatError, check=coded("session.lengths")):
        read_outline(path)
    with h5py.File(path, "w") as file:
        file.attrs["x"] = 1
    with pytest.raises(SessionFormatError, check=coded("session.not_one")):
        read_outline(path)


def test_an_outline_refuses_what_is_too_large_to_be_read(path):
    with h5py.File(path, "r+") as file:
        signals = file["tests/0001/signals"]
        for name in list(signals):
            del signals[name]
            signals.create_dataset(name, shape=(9_000_000,), chunks=(100_000,), dtype="f8")
    with pytest.raises(SessionFormatError, check=coded("session.too_many_numbers", numbers=27_003_000, most=5_000_000)):
        read_outline(path)
