"""Pickles from other people: what data needs comes out exactly, everything else is refused and never run."""

import builtins
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from twinbench.datasets import safe_pickle


def object_array(items):
    """A one-dimensional array of ``items`` as they are."""
    return np.fromiter(items, object, len(items))


SAMPLE = Path(safe_pickle.__file__).parent / "sample" / "plush_lift"
DTYPES = st.one_of(
    npst.boolean_dtypes(),
    npst.integer_dtypes(endianness="?"),
    npst.unsigned_integer_dtypes(endianness="?"),
    npst.floating_dtypes(endianness="?"),
    npst.complex_number_dtypes(endianness="?"),
    npst.unicode_string_dtypes(endianness="?", min_len=1, max_len=4),
    npst.byte_string_dtypes(endianness="?", min_len=1, max_len=4),
)
ARRAYS = DTYPES.flatmap(lambda d: npst.arrays(d, npst.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)))
SCALARS = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.binary(max_size=5))
TREES = st.recursive(
    st.one_of(SCALARS, ARRAYS, ARRAYS.map(lambda a: a.T), ARRAYS.filter(lambda a: a.size).map(lambda a: a.flat[0])),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(SCALARS, inner, max_size=3),
        st.lists(inner, max_size=3).map(object_array),
    ),
    max_leaves=8,
)


def same(a, b):
    """Equal in type, shape, dtype and bytes (so NaN equals NaN)."""
    if type(a) is not type(b):
        return False
    if isinstance(a, (np.ndarray, np.generic)):
        if a.dtype == object:
            return a.shape == b.shape and all(same(x, y) for x, y in zip(a.flat, b.flat, strict=True))
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return len(a) == len(b) and all(same(x, y) and same(a[x], b[y]) for x, y in zip(a, b, strict=True))
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b or (a != a and b != b)


@pytest.mark.long
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
@given(value=TREES, protocol=st.integers(0, pickle.HIGHEST_PROTOCOL))
def test_data_comes_out_as_it_went_in(tmp_path, value, protocol):
    file = tmp_path / "data.pkl"
    file.write_bytes(pickle.dumps(value, protocol))
    assert same(safe_pickle.load(file), value)


def test_object_arrays_hold_data_and_what_is_shared_stays_shared(tmp_path):
    inner = np.arange(3.0)
    value = {"a": np.array([1, "x", None, [inner]], dtype=object), "b": [inner, inner]}
    (tmp_path / "data.pkl").write_bytes(pickle.dumps(value))
    read = safe_pickle.load(tmp_path / "data.pkl")
    assert same(read, value)
    assert read["b"][0] is read["b"][1]


def test_arrays_of_numpy_1_are_read(tmp_path):
    """numpy 1 wrote the module as numpy.core, numpy 2 as numpy._core; the released files are older than numpy 2."""
    data = pickle.dumps({"x": np.arange(6.0).reshape(2, 3), "y": np.float64(2.5)}, protocol=2)
    (tmp_path / "old.pkl").write_bytes(data.replace(b"numpy._core", b"numpy.core"))
    read = safe_pickle.load(tmp_path / "old.pkl")
    assert read["x"].tolist() == [[0, 1, 2], [3, 4, 5]] and read["y"] == 2.5


class Calls:
    """Pickles as a call of ``function``."""

    def __init__(self, function, *arguments, state=None):
        self.reduced = (function, arguments) if state is None else (function, arguments, state)

    def __reduce__(self):
        return self.reduced


def _attacks(flag):
    write = f"open({str(flag)!r}, 'w').close()"
    return {
        "os.system": Calls(os.system, f"touch {flag}"),
        "eval": Calls(eval, write),
        "exec": Calls(exec, write),
        "subprocess.Popen": Calls(subprocess.Popen, ["touch", str(flag)]),
        "open": Calls(open, str(flag), "w"),
        "getattr": Calls(getattr, "x", "upper"),
        "__import__": Calls(builtins.__import__, "antigravity_that_is_not_there"),
        "numpy.load": Calls(np.load, str(flag)),
        "numpy.fromfile": Calls(np.fromfile, str(flag)),
        "numpy.memmap": Calls(np.memmap, str(flag), "u1", "w+", 0, (4,)),
        "numpy.savetxt": Calls(np.savetxt, str(flag), [1.0]),
        "numpy.ndarray.tofile": Calls(getattr, np.zeros(2), "tofile"),
        "numpy.vectorize": Calls(np.vectorize, len),
        "set": {1, 2},
        "frozenset": frozenset({1}),
        "bytearray": bytearray(b"x"),
        "complex": 1j,
        "range": range(3),
        "a class": Calls,
        "in a list": [1, {"a": (Calls(os.system, f"touch {flag}"),)}],
        "in an object array": np.array([1, Calls(os.system, f"touch {flag}")], dtype=object),
        "structured array": np.zeros(2, dtype=[("a", "f8"), ("b", "O")]),
        "date array": np.zeros(2, dtype="M8[s]"),
        "array subclass": np.zeros(2).view(np.recarray),
        "masked array": np.ma.zeros(2),
        "dtype with metadata": np.zeros(2, np.dtype("f8", metadata={"a": 1})),
    }


@pytest.mark.parametrize("name", sorted(_attacks("x")))
@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_anything_else_is_refused_and_not_run(tmp_path, name, protocol):
    flag = tmp_path / "ran"
    file = tmp_path / "final_data.pkl"
    file.write_bytes(pickle.dumps(_attacks(flag)[name], protocol))
    with pytest.raises(ValueError, match=r"final_data.pkl: refused") as caught:
        safe_pickle.load(file)
    assert not flag.exists()
    assert "\n" not in str(caught.value)


def test_the_refusal_names_what_is_forbidden(tmp_path):
    (tmp_path / "final_data.pkl").write_bytes(pickle.dumps(Calls(os.system, "true")))
    with pytest.raises(ValueError, match=r"final_data.pkl: refused, it calls for (posix|nt)\.system"):
        safe_pickle.load(tmp_path / "final_data.pkl")


def _global(module, name):
    return b"c" + module.encode() + b"\n" + name.encode() + b"\n"


RECONSTRUCT = _global("numpy._core.multiarray", "_reconstruct")
NDARRAY = _global("numpy", "ndarray")
DTYPE = _global("numpy", "dtype")
EMPTY = RECONSTRUCT + b"(" + NDARRAY + b"(I0\ntC\x01btR"  # _reconstruct(ndarray, (0,), b'b')


def _array_state(code, shape, data, version=b"I1\n"):
    """(version, shape, dtype, fortran, data) of an array, with its dtype written by hand."""
    dtype = DTYPE + b"(V" + code + b"\nI00\nI01\ntR(I3\nV<\nNNNI-1\nI-1\nI0\ntb"
    return b"(" + version + shape + dtype + b"I00\n" + data + b"t"


# name: (pickle, what the error says); numpy's and Python's own unpickling would believe most of them
HAND_MADE = {
    "ndarray called directly": (NDARRAY + b"((I1000\nttR.", "builds an array in an unusual way"),
    "array of another class": (
        RECONSTRUCT + b"(" + DTYPE + b"(I0\ntC\x01btR" + _array_state(b"f8", b"(I1\nt", b"C\x08AAAAAAAA") + b"b.",
        "an array of an unusual class",
    ),
    "attribute set on a function": (RECONSTRUCT + b"}Vx\nI1\nsb0N.", "change the state of a Function"),
    "attribute set on ndarray": (NDARRAY + b"}Vx\nI1\nsb0N.", "change the state of a Function"),
    "class made through NEWOBJ": (NDARRAY + b")\x81.", ""),
    "extension registry": (b"\x82\x01.", "EXT1 names an object outside of the file"),
    "persistent id": (b"Pwho\n.", "PERSID names an object outside of the file"),
    "function as data": (RECONSTRUCT + b".", "it holds a Function"),
    "re-encoding": (_global("_codecs", "encode") + b"(Vx\nVrot13\ntR.", "re-encodes text"),
    "made bytes": (_global("builtins", "bytes") + b"(I1000000\ntR.", "builds bytes"),
    "a dotted name": (b"\x80\x04\x8c\x05numpy\x8c\x10ndarray.__init__\x93.", r"calls for numpy\.ndarray\.__init__"),
    "copyreg": (
        _global("copyreg", "_reconstructor") + b"(" + _global("builtins", "object") * 2 + b"NtR.",
        r"calls for copyreg\._reconstructor",
    ),
    "itself": (b"\x80\x02]q\x00h\x00a.", "contains itself"),
    "object dtype as bytes": (EMPTY + _array_state(b"O8", b"(I1\nt", b"C\x08AAAAAAAA") + b"b.", "array of objects is damaged"),
    "more elements than data": (EMPTY + _array_state(b"f8", b"(I1000000\nt", b"C\x08AAAAAAAA") + b"b.", "1 values do not fill"),
    "negative shape": (EMPTY + _array_state(b"f8", b"(I-1\nt", b"C\x08AAAAAAAA") + b"b.", "up to 64 integers >= 0"),
    "unfinished array": (EMPTY + b".", ""),
    "a memo index that fills the memory": (b"\x80\x02Nr\xff\xff\xff\x7f.", "memo index 2147483647 is larger than the file"),
    "a length that fills the memory": (b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x0f.", "1152921504606846975 bytes must follow"),
    "deep nesting": (b"]" * 200_000 + b"a" * 199_999 + b".", "nested more than 100 levels"),
    "nothing": (b"", ""),
    "not a pickle": (b"PK\x03\x04 this is a zip file, or so it says", ""),
    "text": (b"hello world", ""),
    "no STOP": (b"\x80\x04N", ""),
}


@pytest.mark.parametrize("name", HAND_MADE)
def test_hand_made_pickles_end_in_one_clear_error(tmp_path, name):
    file = tmp_path / "calibrate.pkl"
    file.write_bytes(HAND_MADE[name][0])
    with pytest.raises(ValueError, match=r"calibrate.pkl: (refused|not a complete pickle).*" + HAND_MADE[name][1]) as caught:
        safe_pickle.load(file)
    assert len(str(caught.value)) < 500


def test_a_refused_pickle_leaves_nothing_behind_for_the_next(tmp_path):
    (tmp_path / "bad.pkl").write_bytes(HAND_MADE["attribute set on a function"][0])
    (tmp_path / "good.pkl").write_bytes(pickle.dumps(np.arange(3)))
    with pytest.raises(ValueError, match=r"bad.pkl"):
        safe_pickle.load(tmp_path / "bad.pkl")
    assert safe_pickle.load(tmp_path / "good.pkl").tolist() == [0, 1, 2]


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_a_truncated_pickle_is_never_half_read(tmp_path, protocol):
    whole = pickle.dumps({"points": np.arange(12.0).reshape(2, 2, 3), "names": ["a", "b"]}, protocol)
    file = tmp_path / "final_data.pkl"
    for length in range(len(whole)):
        file.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"final_data.pkl"):
            safe_pickle.load(file)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(position=st.integers(0, 10_000), byte=st.integers(0, 255))
def test_a_flipped_byte_gives_data_or_one_clear_error(tmp_path, position, byte):
    whole = bytearray(pickle.dumps({"points": np.arange(12.0).reshape(2, 2, 3), "k": [1, (2.5, "x")]}, 4))
    whole[position % len(whole)] = byte
    file = tmp_path / "final_data.pkl"
    file.write_bytes(whole)
    try:
        safe_pickle.load(file)
    except ValueError as error:
        assert "final_data.pkl" in str(error)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere.pkl: cannot be read"):
        safe_pickle.load(tmp_path / "nowhere.pkl")


def test_opening_a_pickle_imports_nothing(tmp_path):
    """Naming a module in a pickle imports it, unless the name is refused first."""
    file = tmp_path / "final_data.pkl"
    file.write_bytes(_global("wave", "open") + b".")
    sys.modules.pop("wave", None)
    with pytest.raises(ValueError, match=r"wave\.open"):
        safe_pickle.load(file)
    assert "wave" not in sys.modules


# --- budgets -----------------------------------------------------------------------------------------------------------------------------


HONEST = {  # what takes most in Python for what it is in a file, each over the 64 MiB that any file may make
    "pairs of small integers": lambda: [(n % 7, n % 5) for n in range(700_000)],
    "floats": lambda: np.arange(2_100_000.0).tolist(),
    "points in lists": lambda: np.arange(1_200_000.0).reshape(-1, 3).tolist(),
    "short texts": lambda: [f"{n:03d}" for n in range(900_000)],
    "small arrays": lambda: [np.full((4, 4), float(n)) for n in range(60_000)],
    "masks": lambda: {t: {c: {"object": np.full((480, 848), t % 2 == 0)} for c in range(3)} for t in range(70)},
}


@pytest.mark.slow
@pytest.mark.parametrize("protocol", [2, 4])
@pytest.mark.parametrize("name", HONEST)
def test_data_of_any_size_is_within_budget(tmp_path, name, protocol):
    value = HONEST[name]()
    (tmp_path / "data.pkl").write_bytes(pickle.dumps(value, protocol))
    assert same(safe_pickle.load(tmp_path / "data.pkl"), value)


def test_a_budget_is_the_files_size_and_a_floor(tmp_path, monkeypatch):
    """One array in a list n times: with what is shared written out it takes 8 values n + 108 n + 56 bytes."""
    monkeypatch.setattr(safe_pickle, "BUDGET", 100_000)
    file = tmp_path / "data.pkl"
    for n, fits in ((10, True), (100, True), (2000, False)):
        array = np.zeros(100)
        file.write_bytes(pickle.dumps([array] * n, 4))
        budget = 100_000 + safe_pickle.BUDGET_PER_BYTE * file.stat().st_size
        assert (n * (8 * 100 + 108) + 56 <= budget) == fits
        if fits:
            assert len(safe_pickle.load(file)) == n
        else:
            with pytest.raises(ValueError, match=f"data.pkl: refused, it takes more than {budget} bytes with all that it shares"):
                safe_pickle.load(file)


@pytest.mark.parametrize("wrap", [lambda v: [v], lambda v: (v,), lambda v: {"a": v}, lambda v: object_array([v])])
def test_a_hundred_levels_are_read_and_one_more_is_refused(tmp_path, wrap):
    value = None
    for _ in range(100):
        value = wrap(value)
    file = tmp_path / "data.pkl"
    file.write_bytes(pickle.dumps(value, 4))
    assert same(safe_pickle.load(file), value)
    file.write_bytes(pickle.dumps([value], 4))
    with pytest.raises(ValueError, match=r"data.pkl: refused, it is nested more than 100 levels deep"):
        safe_pickle.load(file)


def test_a_file_of_terabytes_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "a.pkl").open("wb") as stream:
        stream.truncate(2**42)  # a hole, which takes no room on the disk
    with pytest.raises(ValueError, match=r"a.pkl: must hold at most 2147483648 bytes, got 4398046511104"):
        safe_pickle.load(tmp_path / "a.pkl")


def test_only_a_file_is_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.pkl")
    (tmp_path / "loop.pkl").symlink_to(tmp_path / "loop.pkl")
    for file in (tmp_path / "pipe.pkl", tmp_path / "loop.pkl", tmp_path):
        with pytest.raises(ValueError, match=f"{file.name}: cannot be read"):
            safe_pickle.load(file)


# --- arrays are arrays before their shape is asked for -----------------------------------------------------------------------------------


def test_an_array_is_an_array_of_numbers():
    array = np.zeros((2, 3))
    assert safe_pickle.array_of(array, "a.pkl", "points") is array
    assert safe_pickle.numbers_of(array, "a.pkl", "points") is array
    for value, got in (
        ([[1.0]], "a list"),
        (np.array(["a"]), "one of type <U1"),
        (np.array([None]), "one of type object"),
        (None, "None"),
    ):
        with pytest.raises(ValueError, match=f"^a.pkl: points must be an array of numbers, got {got}"):
            safe_pickle.array_of(value, "a.pkl", "points")


def test_lists_of_numbers_become_an_array():
    for value in ([[1, 2], (3, 4.5)], [np.arange(2), [True, np.float32(2)]], 3.5):
        assert safe_pickle.numbers_of(value, "a.pkl", "points").tolist() == np.array(value).tolist()
    for value, said in (
        ([[1.0], "x" * 1000], "lists of them, got a str"),
        ([[1.0], {}], "lists of them, got a dict"),
        ([[1.0], None], "lists of them, got None"),
        ([np.array([None])], "lists of them, got one of type object"),
        ([[1.0], [1.0, 2.0]], "lists of equally many numbers"),
        ([10**30], "array of numbers, got one of type object"),
    ):
        with pytest.raises(ValueError, match=f"^a.pkl: points must be .*{said}"):
            safe_pickle.numbers_of(value, "a.pkl", "points")


@pytest.mark.parametrize("file", ["final_data.pkl", "gt_track_3d.pkl", "calibrate.pkl", "mask/processed_masks.pkl"])
def test_lists_in_the_place_of_arrays_are_refused_by_all_who_read_a_case(tmp_path, file):
    """Lists that are shared grow without bounds when numpy asks for their shape; 379 bytes took 4.5 GB."""
    from twinbench.datasets.check import check_case
    from twinbench.datasets.phystwin import read_case
    from twinbench.datasets.phystwin_images import CaseImages

    case = shutil.copytree(SAMPLE, tmp_path / "case")
    shared = [0.0, None]
    for _ in range(10):
        shared = [shared] * 2
    value = pickle.loads((case / file).read_bytes()) if (case / file).exists() else None
    frames = len(pickle.loads((case / "final_data.pkl").read_bytes())["object_points"])
    hostile = {
        "final_data.pkl": lambda: value | {"object_points": shared},
        "gt_track_3d.pkl": lambda: shared,
        "calibrate.pkl": lambda: [shared] * len(value),
        "mask/processed_masks.pkl": lambda: {t: [{"object": shared, "controller": shared}] * 3 for t in range(frames)},
    }
    (case / "mask" / "mask_info_0.json").unlink()  # so that the cleaned masks are looked for
    (case / file).write_bytes(pickle.dumps(hostile[file](), 4))
    least = "warning" if "mask" in file else "error"  # a frame without its image is scored by what needs none
    assert any(f.file.name in file and f.severity == least for f in check_case(case))
    rule = r"must (be an array of numbers|be a \(height, width\) array|have shape \(4, 4\))"
    with pytest.raises(ValueError, match=f"{case / file}: .* {rule}"):
        CaseImages(case, frames).mask(0, 0) if "mask" in file else read_case(case)
