"""The accepted result of a sitting: written next to its sessions, read back checked, and withdrawn."""

import json
import os

import pytest
from coded import coded

from tissueid.errors import UnusableInputError
from tissueid.sessions import Test
from tissueid.sessions.accepted_result import (
    LARGEST_BYTES,
    AcceptedResult,
    AcceptedTest,
    AcceptedValue,
    read_result,
    result_of,
    result_path,
    sitting_of,
    withdraw_result,
    write_result,
)

KEY = "0f8fad5b-d9cb-469f-a165-70867728950e"
OTHER = "7c9e6679-7425-40de-944b-e07fc1f90ae7"


def result(**changes):
    tests = (
        AcceptedTest(file="a.h5", number=1, session_id="s-1"),
        AcceptedTest(file="b.h5", number=2, session_id="s-2"),
    )
    values = {"mass_kg": AcceptedValue(mean=0.08, std=0.001, repeatability=0.0028, count=2)}
    return AcceptedResult(**({"sitting": KEY, "tests": tests, "values": values} | changes))


def of_sitting(key):
    return Test(1, "stochastic", {}, 2000.0, notes={} if key is None else {"sitting": key})


def test_what_is_written_is_read_back(tmp_path):
    path = write_result(tmp_path, result())
    assert path == tmp_path / f"sitting-{KEY}.json"
    assert read_result(path) == result(accepted=read_result(path).accepted)
    assert result_of(tmp_path, of_sitting(KEY)).holds("s-2", 2)
    assert not result_of(tmp_path, of_sitting(KEY)).holds("s-2", 1)
    assert result_of(tmp_path, of_sitting(OTHER)) is None
    assert result_of(tmp_path, of_sitting(None)) is None
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    withdraw_result(tmp_path, KEY)
    withdraw_result(tmp_path, KEY)
    assert not path.exists()


def test_the_documented_keys_are_there(tmp_path):
    content = json.loads(write_result(tmp_path, result()).read_text(encoding="utf-8"))
    assert set(content) == {"format", "format_version", "sitting", "accepted", "software", "tests", "values"}
    assert set(content["tests"][0]) == {"file", "number", "session_id"}
    assert content["values"]["mass_kg"] == {"mean": 0.08, "std": 0.001, "repeatability": 0.0028, "count": 2}


@pytest.mark.parametrize("key", ["../../etc/passwd", "", "a" * 36, 5.0, KEY.upper(), KEY + "\n"])
def test_a_key_that_is_none_names_no_file(key):
    assert sitting_of(of_sitting(key)) is None


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{}",
        b"[" * 60_000,
        b"\xff\xfe",
        b" " * (LARGEST_BYTES + 1),
        {"sitting": "../x"},
        {"format_version": "9.0"},
        {"format": "tissueid-session"},
        {"tests": []},
        {"tests": [{"file": "../a.h5", "number": 1, "session_id": ""}]},
        {"values": {"mass_kg": {"mean": "NaN"}}},
        {"values": {"mass_kg": {"mean": 1e300}}},
        {"values": {"mass_kg": {"mean": 1.0, "std": -1.0}}},
        {"values": {"MASS": {"mean": 1.0}}},
        {"tests": [{"file": "a.h5", "number": 1, "session_id": "s"}] * 101},
    ],
    ids=str,
)
def test_what_is_no_result_is_refused(tmp_path, content):
    path = result_path(tmp_path, KEY)
    whole = json.loads(result().model_dump_json())
    path.write_bytes(content if isinstance(content, bytes) else json.dumps(whole | content).encode())
    with pytest.raises(UnusableInputError, check=lambda error: "sitting-" in error.message.values["path"]):
        read_result(path)


def test_what_is_no_file_and_the_result_of_another_sitting_are_refused(tmp_path):
    result_path(tmp_path, KEY).write_text(result(sitting=OTHER).model_dump_json(), encoding="utf-8")
    with pytest.raises(UnusableInputError, check=coded("result.other_sitting")):
        result_of(tmp_path, of_sitting(KEY))
    pipe = result_path(tmp_path, OTHER)
    os.mkfifo(pipe)  # opening it would wait for ever
    with pytest.raises(UnusableInputError, check=coded("result.not_a_file")):
        read_result(pipe)
