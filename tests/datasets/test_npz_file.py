"""Reading .npz files of other people: what numpy wrote comes back, and nothing else takes memory, runs or passes."""

import io
import os
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from twinbench.datasets.npz_file import read_arrays

ANY = {"positions": ("frames", "particles", 3), "counts": (3,)}
quick = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


def sound(**changes):
    return {"positions": np.zeros((4, 5, 3), np.float32), "counts": np.array([2, 2, 1])} | changes


def members(file, **contents):
    """A zip archive of these bytes by name, as numpy's files are."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(f"{name}.npy", content)
    return file


def array_bytes(shape="(4, 5, 3)", descr="'<f4'", data=b"", *, order="False"):
    """An .npy file with a header of one's own, as the format is documented (numpy.lib.format)."""
    header = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}".encode()
    header += b" " * (-(10 + len(header) + 1) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


COUNTS = io.BytesIO()
np.save(COUNTS, np.array([2, 2, 1]))
COUNTS = COUNTS.getvalue()


@quick
@given(
    st.sampled_from(["<f4", ">f4", "<f8", ">f8", "<i8", "|b1"]).flatmap(
        lambda kind: arrays.arrays(kind, arrays.array_shapes(min_dims=2, max_dims=2, max_side=6).map(lambda s: (*s, 3)))
    ),
    st.booleans(),
    st.sampled_from(["C", "F"]),
)
def test_what_numpy_wrote_comes_back_in_native_byte_order(tmp_path, values, packed, order):
    file = tmp_path / "a.npz"
    (np.savez_compressed if packed else np.savez)(file, positions=np.asarray(values, order=order), counts=[1, 2, 3])
    found = read_arrays(file, ANY)["positions"]
    np.testing.assert_array_equal(found, values)
    assert found.dtype.isnative and found.flags.c_contiguous and found.dtype.kind == values.dtype.kind


@quick
@given(st.data())
def test_a_damaged_file_is_refused_by_name_or_reads_as_written(tmp_path, data):
    file = tmp_path / "a.npz"
    np.savez_compressed(file, **sound())
    whole = bytearray(file.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    file.write_bytes(bytes(whole[: data.draw(st.integers(0, len(whole)))]) if data.draw(st.booleans()) else bytes(whole))
    try:
        found = read_arrays(file, ANY)
    except ValueError as error:
        assert str(error).startswith(f"{file}: ") and "\n" not in str(error)
    else:  # what was hit is looked at by nobody, as a date; the checksum of each array is verified
        np.testing.assert_array_equal(found["positions"], sound()["positions"])


@quick
@given(st.binary(max_size=300))
def test_bytes_that_are_no_archive_are_refused(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.npz: "):
        read_arrays(tmp_path / "a.npz", ANY)


class Runs:
    """Whoever unpickles it leaves a file behind."""

    def __reduce__(self):
        return open, ("opened", "w")


def test_an_array_of_objects_is_refused_and_nothing_is_unpickled(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez(tmp_path / "a.npz", **sound(positions=np.array([[[Runs()] * 3]], object)))
    with pytest.raises(ValueError, match="positions must hold numbers, got Python objects: these would be a pickle"):
        read_arrays(tmp_path / "a.npz", ANY)
    assert not (tmp_path / "opened").exists()


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (array_bytes("(1000, 1000000, 3)"), r"positions must take at most \d+ bytes, got 12000000000"),
        (array_bytes("(4, 5, 3)", data=b"\0" * 239), "must take 240 bytes, as its shape and type say, got fewer"),
        (array_bytes("(4, 5, 3)", data=b"\0" * 241), "must take 240 bytes, as its shape and type say, got more"),
        (array_bytes("(4, 5)"), r"must have shape \(frames, particles, 3\), got \(4, 5\)"),
        (array_bytes("(-4, -5, 3)", data=b"\0" * 240), "lengths >= 0"),
        (array_bytes("(4, 5, 3)", "'<c8'", b"\0" * 480), "must hold numbers, got dtype"),
        (array_bytes("(4, 5, 3)", "[('a', '<f4')]", b"\0" * 240), "must hold numbers, got dtype"),
        (array_bytes("(4, 5, 3)", "'<M8[s]'", b"\0" * 480), "must hold numbers, got dtype"),
        (array_bytes("(4, 5, __import__('os'))"), "not an array that numpy wrote"),
        (array_bytes("(" * 3000), "not an array that numpy wrote"),
        (array_bytes("(4, 5, 3)" + " " * 20000), "not an array that numpy wrote"),
        (b"", "not an array that numpy wrote|not a complete"),
        (b"\x93NUMPY\x03\x00" + b"\0" * 100, "not an array that numpy wrote"),
    ],
)
def test_an_array_that_is_not_what_it_should_be_is_refused(tmp_path, content, rule):
    file = members(tmp_path / "a.npz", positions=content, counts=COUNTS)
    with pytest.raises(ValueError, match=rule) as caught:
        read_arrays(file, ANY)
    assert str(caught.value).startswith(f"{file}: ") and "\n" not in str(caught.value)


@quick
@given(st.dictionaries(st.sampled_from("abc"), arrays.arrays(np.float32, arrays.array_shapes(min_dims=0)), min_size=1))
def test_without_names_all_arrays_are_read_of_any_shape(tmp_path, values):
    np.savez(tmp_path / "a.npz", **values)
    found = read_arrays(tmp_path / "a.npz")
    assert list(found) == list(values) and all(np.array_equal(found[name], values[name], equal_nan=True) for name in values)
    np.save(tmp_path / "one.npy", (first := next(iter(values.values()))))
    np.testing.assert_array_equal(read_arrays(tmp_path / "one.npy")["one"], first)


@pytest.mark.parametrize("name", ["points.npz", "points.npy"])
def test_an_array_that_claims_terabytes_is_refused_by_file_array_and_size(tmp_path, name):
    header = array_bytes("(1000, 1000000000, 3)", data=bytes(240))
    file = members(tmp_path / name, points=header) if name.endswith("z") else tmp_path / name
    if name.endswith("y"):
        file.write_bytes(header)
    with pytest.raises(ValueError, match=r"points.np.: points must take at most 1073741824 bytes, got 12000000000000$"):
        read_arrays(file)


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path):
    # 60 MB of zeros in 60 kB: the header says how much they would take, and nothing after it is read
    file = members(tmp_path / "a.npz", positions=array_bytes("(10, 500000, 3)", data=bytes(60_000_000)), counts=COUNTS)
    assert file.stat().st_size < 100_000
    tracemalloc.start()
    with pytest.raises(ValueError, match="must take at most 10000000 bytes, got 60000000"):
        read_arrays(file, ANY, limit=10_000_000)
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()


def test_members_are_those_that_are_asked_for_each_once(tmp_path):
    cases = {
        "must hold positions, counts and nothing else, got 'evil.npy'": {"evil": b""},
        "counts missing": {"positions": array_bytes(data=b"\0" * 240)},
        "must hold positions, counts and nothing else, got '../positions.npy'": {"../positions": b""},
    }
    for rule, contents in cases.items():
        with pytest.raises(ValueError, match=rule):
            read_arrays(members(tmp_path / "a.npz", **contents), ANY)
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("counts.npy", COUNTS)
        archive.writestr("counts.npy", COUNTS)
    with pytest.raises(ValueError, match="counts must be given once, got it twice"):
        read_arrays(tmp_path / "b.npz", ANY)


def test_a_list_of_very_many_members_is_not_read(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for k in range(2000):
            archive.writestr(f"{k}.npy", b"")
    with pytest.raises(ValueError, match="must list at most 65536 bytes of members"):
        read_arrays(tmp_path / "a.npz", ANY)


def test_only_regular_files_are_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.npz")
    for name, rule in {"pipe.npz": "must be a regular file, got a named pipe", ".": "got a folder", "none.npz": "missing"}.items():
        with pytest.raises(ValueError, match=rule):
            read_arrays(tmp_path / name, ANY)
