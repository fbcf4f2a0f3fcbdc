"""Pickles composed by a grammar, and mutated real ones, opened in a process with little memory and time: data or one clear error."""

import pickle
import struct
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

if not sys.platform.startswith("linux"):
    pytest.skip("memory and time are limited as Linux does it", allow_module_level=True)

from pickle_ward import Ward

MEMORY = 200 << 20  # bytes: the 64 MiB that any file may make, copies of it under way, and what is not yet given back
SECONDS = 8  # of processor time: the slowest of small files fills its 64 MiB in steps of a few bytes


@pytest.fixture(scope="module")
def ward(tmp_path_factory):
    found = Ward(tmp_path_factory.mktemp("ward"))
    yield found
    found.close()


def holds(ward, data):
    """What came of ``data``, which is data or a ValueError that names the file, in bounded memory and time, and set nothing off."""
    told = ward.open(data)
    assert told["came"] in ("value", "ValueError"), told
    assert "ward.pkl: " in told["message"] or told["came"] == "value", told
    assert "MemoryError" not in told["message"] and "Unable to allocate" not in told["message"], told
    assert len(told["message"]) < 600 and "\n" not in told["message"], told
    assert told["set_off"] == [] and told["memory"] < MEMORY and told["seconds"] < SECONDS, told
    return told


# --- the grammar -------------------------------------------------------------------------------------------------------------------------


def text(value):
    data = value.encode("utf-8", "surrogatepass")
    return b"X" + struct.pack("<I", len(data)) + data


def integer(value):
    size = value.bit_length() // 8 + 1
    return b"\x8a" + bytes([size]) + value.to_bytes(size, "little", signed=True)


def function(module, name):
    return f"c{module}\n{name}\n".encode()


FUNCTIONS = [
    function(f"{package}.{module}", name)
    for package in ("numpy.core", "numpy._core")
    for module, name in (("multiarray", "_reconstruct"), ("multiarray", "scalar"), ("numeric", "_frombuffer"))
] + [function("numpy", "ndarray"), function("numpy", "dtype"), function("_codecs", "encode"), function("builtins", "bytes")]
FORBIDDEN = [
    function("os", "system"),
    function("builtins", "eval"),
    function("builtins", "bytearray"),
    function("numpy", "zeros"),
    function("numpy", "fromfile"),
    function("copyreg", "_reconstructor"),
    function("numpy", "ndarray.tofile"),
    function("collections", "OrderedDict"),
]
CODES = [
    "f8",
    "f4",
    "i4",
    "u1",
    "b1",
    "O8",
    "O",
    "U3",
    "S2",
    "c16",
    "U0",
    "S0",
    "S999999999",
    "U999999999",
    "M8[s]",
    "V8",
    "f3",
    ",f8",
    "f8,f8",
]
SIZES = st.one_of(st.integers(0, 4), st.sampled_from([-1, 64, 2**16, 2**31, 2**40, 2**63, 2**64, 2**1000]))


def packed(parts):
    return b"(" + b"".join(parts) + b"t"


def dtype(code, order, rest):
    return function("numpy", "dtype") + packed([text(code), b"\x89", b"\x88"]) + b"R" + packed([b"K\x03", text(order), *rest]) + b"b"


NOTHING = [b"N"] * 3 + [b"J\xff\xff\xff\xff"] * 2 + [b"K\x00"]
VALUES = st.deferred(lambda: st.one_of(LEAVES, st.one_of(CONTAINERS, ARRAYS, SHARED)))
LEAVES = st.one_of(
    st.sampled_from([b"N", b"\x88", b"\x89", b")", b"]", b"}", b"I01\n", b"Fnan\n", b"L1L\n", b"G" + bytes(8), *FUNCTIONS, *FORBIDDEN]),
    SIZES.map(integer),
    st.sampled_from(["", "a", "latin1", "C", "F", "K", "<", ">", "|", "\ud800", "object", *CODES]).map(text),
    st.integers(0, 40).map(lambda n: b"C" + bytes([n]) + bytes(range(n))),
    st.integers(0, 40).map(lambda n: b"\x96" + struct.pack("<Q", n) + bytes(n)),
    st.integers(0, 12).map(lambda n: b"h" + bytes([n])),
    st.tuples(st.sampled_from("ILFgpSVPcj"), st.text("019-+.eLx'\\ué", max_size=12)).map(lambda t: f"{t[0]}{t[1]}\n".encode("latin1")),
)
DTYPES = st.builds(dtype, st.sampled_from(CODES), st.sampled_from("<>|=x"), st.one_of(st.just(NOTHING), st.lists(VALUES, max_size=6)))
SHAPES = st.one_of(st.lists(SIZES.map(integer), max_size=4).map(packed), VALUES)
ARRAYS = st.one_of(
    st.builds(  # _frombuffer
        lambda f, buffer, kind, shape, order: f + packed([buffer, kind, shape, order]) + b"R",
        st.sampled_from(FUNCTIONS),
        VALUES,
        DTYPES,
        SHAPES,
        st.sampled_from(["C", "F", "K"]).map(text) | VALUES,
    ),
    st.builds(  # _reconstruct and its state
        lambda f, kind, state: f + packed([kind, b"K\x00\x85", b"C\x01b"]) + b"R" + packed(state) + b"b",
        st.sampled_from(FUNCTIONS),
        st.sampled_from(FUNCTIONS),
        st.tuples(st.just(b"K\x01"), SHAPES, DTYPES | VALUES, st.sampled_from([b"\x88", b"\x89"]), VALUES),
    ),
    st.tuples(DTYPES, VALUES).map(lambda t: FUNCTIONS[1] + packed(t) + b"R"),  # scalar
    DTYPES,
)
CONTAINERS = st.one_of(
    st.builds(lambda parts, end: b"(" + b"".join(parts) + end, st.lists(VALUES, max_size=4), st.sampled_from([b"t", b"l", b"d"])),
    st.builds(
        lambda target, parts, end: target + b"(" + b"".join(parts) + end,
        VALUES,
        st.lists(VALUES, max_size=4),
        st.sampled_from([b"e", b"u"]),
    ),
    st.builds(
        lambda target, parts, end: target + b"".join(parts) + end,
        VALUES,
        st.lists(VALUES, max_size=3),
        st.sampled_from(list(b"asbR\x85\x86\x87\x81")).map(lambda c: bytes([c])),
    ),
)
SHARED = st.one_of(
    st.builds(lambda value, n: value + b"q" + bytes([n]), VALUES, st.integers(0, 12)),
    VALUES.map(lambda v: v + b"\x94"),
    st.builds(
        lambda v, step, n: v + step * n,
        VALUES,
        st.sampled_from([b"\x85", b"2\x86", b"2", b"\x94", b"h\x00", b"(h\x00h\x00t\x94", b"h\x00a", b"]", b"(", b"N", b"0"]),
        st.sampled_from([2, 40, 60, 101, 3000, 40_000]),
    ),
)
PROGRAMS = st.builds(
    lambda start, parts, end: start + b"".join(parts) + end,
    st.sampled_from([b"", b"\x80\x02", b"\x80\x04", b"\x80\x05\x95" + struct.pack("<Q", 30), b"\x80\xff"]),
    st.lists(st.one_of(VALUES, VALUES, VALUES, st.binary(max_size=6)), min_size=1, max_size=4),
    st.sampled_from([b".", b".", b".", b"l.", b"t.", b"", b"..", b"0."]),
)
REAL = [
    pickle.dumps(value, protocol)
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1)
    for value in (
        {"points": np.arange(12.0).reshape(2, 2, 3), "seen": np.ones((2, 2), bool), "n": [1, (2.5, "x", b"y", None)]},
        [np.eye(4), np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.arange(3, dtype=">i2"), np.array(["ab", "c"]), np.float32(2)],
        np.array([1, "x", None, [np.zeros(2)]], dtype=object),
        {0: {0: {"object": np.zeros((4, 5), bool), "controller": np.zeros((4, 5), bool)}}, 1: {}},
    )
]


@st.composite
def mutated(draw):
    """A real pickle with bytes changed, left out, repeated or taken from another."""
    data = bytearray(draw(st.sampled_from(REAL)))
    for _ in range(draw(st.integers(1, 4))):
        a, b = sorted((draw(st.integers(0, len(data))), draw(st.integers(0, len(data)))))
        kind = draw(st.sampled_from(["flip", "byte", "cut", "end", "repeat", "splice", "insert"]))
        if kind in ("flip", "byte") and a < len(data):
            data[a] = data[a] ^ 1 << draw(st.integers(0, 7)) if kind == "flip" else draw(st.integers(0, 255))
        elif kind == "cut":
            del data[a : min(b, a + 9)]
        elif kind == "end":
            del data[b:]
        elif kind == "repeat":
            data[b:b] = data[a:b] * draw(st.sampled_from([1, 2, 50]))
        elif kind == "splice":
            data[a:b] = draw(st.sampled_from(REAL))[a:b]
        elif kind == "insert":
            data[a:a] = draw(VALUES)
    return bytes(data[:400_000])


ANY = st.one_of(PROGRAMS, mutated())
QUIET = dict(deadline=None, suppress_health_check=list(HealthCheck))


@pytest.mark.long
@settings(max_examples=200, **QUIET)
@given(ANY)
def test_any_program_gives_data_or_one_clear_error(ward, data):
    holds(ward, data)


@pytest.mark.slow
@settings(max_examples=10_000, **QUIET)
@given(ANY)
def test_ten_thousand_programs_give_data_or_one_clear_error(ward, data):
    holds(ward, data)
