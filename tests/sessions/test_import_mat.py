"""MAT files: vectors, matrices and structures of numbers, in every version; nothing else."""

import contextlib
import pickle
import zlib

import h5py
import numpy as np
import pytest
import scipy.io
from coded import coded
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from outside_data import REAL

from tissueid.errors import UnusableInputError
from tissueid.sessions.imports import Choices, Source, import_test, parse_map

U = np.array([0.5, -1.5, 2.5, 3.5])
Y = np.array([0.001, 0.002, 0.003, 0.005])


def imported(path, *options, rows="", **more):
    more.setdefault("rate_hz", 100.0)
    return import_test(
        Source.parsed(f"{path}{rows}"), parse_map(options or ["input=u:V", "output=y:V"]), Choices(), **more
    )


def saved(tmp_path, content, **options):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, content, **options)
    return path


def saved_73(tmp_path, content, mark=True):
    """As MATLAB writes version 7.3: HDF5 behind 512 bytes of its own, with the sides of a matrix turned round."""
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512 if mark else 0) as file:
        for name, value in content.items():
            dataset = file.create_dataset(name, data=np.atleast_2d(value).T)
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
    if mark:
        with path.open("rb+") as raw:
            raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


@pytest.mark.parametrize("options", [{}, {"do_compression": True}, {"format": "4"}, {"oned_as": "column"}])
def test_vectors(tmp_path, options):
    found = imported(saved(tmp_path, {"u": U, "y": Y}, **options))
    np.testing.assert_array_equal(found.test.signals["input"], U)
    np.testing.assert_array_equal(found.test.signals["output"], Y)
    assert found.test.units == {"input": "V", "output": "V"}
    assert found.format == "mat"


@pytest.mark.parametrize("mark", [True, False])
def test_version_7_3(tmp_path, mark):
    path = saved_73(tmp_path, {"u": U, "y": Y[:, None], "x": np.column_stack([U, Y]), "s/deep/z": 2 * U}, mark)
    np.testing.assert_array_equal(imported(path).test.signals["input"], U)
    np.testing.assert_array_equal(imported(path).test.signals["output"], Y)
    found = imported(path, "input=x(:,1):V", "output=x(:,2):V", rows="@1:3").test.signals
    np.testing.assert_array_equal(found["input"], U[1:3])
    np.testing.assert_array_equal(found["output"], Y[1:3])
    np.testing.assert_array_equal(imported(path, "input=s.deep.z:V", "output=y:V").test.signals["input"], 2 * U)


def test_matrices_and_structures(tmp_path):
    content = {"x": np.column_stack([U, Y]), "wide": np.vstack([U, Y]), "s": {"a": U, "b": {"c": Y}}}
    path = saved(tmp_path, content)
    for first, second in (("x(:,1)", "x(:,2)"), ("wide(1,:)", "wide(2,:)"), ("s.a", "s.b.c")):
        found = imported(path, f"input={first}:V", f"output={second}:V").test.signals
        np.testing.assert_array_equal(found["input"], U)
        np.testing.assert_array_equal(found["output"], Y)
    with pytest.raises(UnusableInputError, check=coded("import.no_unit", column="x(:,1)")):
        imported(path, "input=x(:,1)", "output=x(:,2)")


def test_whole_numbers_and_single_precision(tmp_path):
    found = imported(saved(tmp_path, {"u": np.array([1, -2, 300], np.int16), "y": np.float32([0.5, 0.25, 1.0])}))
    np.testing.assert_array_equal(found.test.signals["input"], [1.0, -2.0, 300.0])
    np.testing.assert_array_equal(found.test.signals["output"], [0.5, 0.25, 1.0])


def test_a_vector_of_times(tmp_path):
    path = saved(tmp_path, {"u": U, "y": Y, "t": np.arange(4) / 250.0})
    assert imported(path, rate_hz=None).test.sample_rate_hz == 250.0


def test_nan_stays(tmp_path):
    gaps = np.where(U > 3, np.nan, U)
    np.testing.assert_array_equal(imported(saved(tmp_path, {"u": gaps, "y": Y})).test.signals["input"], gaps)


@pytest.mark.parametrize(
    ("content", "code", "values"),
    [
        ({"u": U, "y": Y[:3]}, "import.lengths", {"variables": "u 4, y 3"}),
        ({"u": U}, "import.no_column", {"column": "y", "columns": "1 'u'"}),
        ({"u": np.array(["a", "b"], dtype=object)}, "import.mat_nothing", {}),
        ({"u": "text"}, "import.mat_nothing", {}),
        ({"u": U * 1j, "y": U * 1j}, "import.mat_nothing", {}),
        ({"u": np.zeros((2, 2, 2)), "y": Y}, "import.no_column", {"column": "u"}),
        ({"u": np.zeros(0)}, "import.mat_nothing", {}),
    ],
)
def test_variables_that_are_no_signals_are_refused(tmp_path, content, code, values):
    with pytest.raises(UnusableInputError, check=coded(code, **values)):
        imported(saved(tmp_path, content))


def test_objects_in_7_3_are_refused(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("y", data=np.zeros((1, 4)))
        cells = file.create_dataset("u", (1, 4), dtype=h5py.ref_dtype)
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        file["far"] = h5py.ExternalLink("/etc/passwd", "/")
        file.create_dataset("out", (4,), "f8", external=[(str(tmp_path / "b.bin"), 0, 32)])
    with pytest.raises(UnusableInputError, check=coded("import.no_column", columns="1 'y'")):
        imported(path)


@pytest.mark.parametrize(
    "content",
    [b"rubbish" * 100, b"MATLAB 5.0 MAT-file", b"\x89HDF\r\n\x1a\n" + bytes(600), pickle.dumps([1, 2]), bytes(1000)],
)
def test_rubbish_is_one_line(tmp_path, content):
    path = tmp_path / "a.mat"
    path.write_bytes(content)
    with pytest.raises(UnusableInputError) as raised:
        imported(path)
    assert raised.value.code in ("import.mat_damaged", "import.mat_nothing")
    assert "\n" not in str(raised.value)


def test_a_bomb_is_not_set_off(tmp_path):
    path = saved(tmp_path, {"u": U, "y": Y}, do_compression=True)
    inner = (14).to_bytes(4, "little") + (3_000_000_000).to_bytes(4, "little") + bytes(100)
    packed = zlib.compress(inner)
    element = (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed
    path.write_bytes(path.read_bytes() + element)
    with pytest.raises(UnusableInputError, check=coded("import.mat_unpacked")):
        imported(path)


def test_groups_that_hold_each_other_come_to_an_end(tmp_path):
    path = saved_73(tmp_path, {"u": U, "y": Y}, mark=False)
    with h5py.File(path, "a") as file:
        group = file.create_group("z")
        for k in range(60):
            group[f"again{k}"] = group
    np.testing.assert_array_equal(imported(path).test.signals["input"], U)


def test_a_session_is_not_imported(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "tissueid-session"
    with pytest.raises(UnusableInputError, check=coded("import.is_session")):
        imported(path)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), compressed=st.booleans(), new=st.booleans())
def test_any_damage_is_read_or_refused(tmp_path, data, compressed, new):
    content = {"u": U, "y": Y, "s": {"a": U}}
    path = saved_73(tmp_path, {"u": U, "y": Y}) if new else saved(tmp_path, content, do_compression=compressed)
    raw = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(raw[: data.draw(st.integers(len(raw) // 2, len(raw)))])
    with contextlib.suppress(UnusableInputError):
        assert imported(path).test.samples > 0


@pytest.mark.skipif(not (REAL / "SNLS80mV.mat").exists(), reason="needs the real records")
def test_silverbox():
    found = imported(REAL / "SNLS80mV.mat", "input=V1:V", "output=V2:V", rows="@40000:131072", rate_hz=610.3515625)
    truth = scipy.io.loadmat(REAL / "SNLS80mV.mat")
    np.testing.assert_array_equal(found.test.signals["input"], truth["V1"][0, 40000:])
    record = found.test.record()
    assert (record.input_name, record.output_name, record.input_unit, record.output_unit) == (
        "input",
        "output",
        "V",
        "V",
    )
    assert found.notices == ()
