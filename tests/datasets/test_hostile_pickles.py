"""Pickles written to run something, to fill the memory, or to take for ever: each is refused, having set nothing off, in little memory."""

import pickle
import re
import struct
import sys

import numpy as np
import pytest

if not sys.platform.startswith("linux"):
    pytest.skip("memory and time are limited as Linux does it", allow_module_level=True)

from pickle_ward import Ward
from twinbench.datasets import safe_pickle

_NAMES = """
os.system os.popen os.execv os.spawnv os.remove os.putenv os.listdir os.fork posix.system nt.system pty.spawn platform.popen
subprocess.Popen subprocess.run subprocess.check_output subprocess.getoutput asyncio.create_subprocess_shell multiprocessing.Process
builtins.eval builtins.exec builtins.compile builtins.open builtins.getattr builtins.setattr builtins.__import__ builtins.input
builtins.breakpoint builtins.print builtins.map builtins.type builtins.object builtins.bytearray builtins.globals builtins.set
__builtin__.eval __builtin__.apply importlib.import_module runpy.run_path runpy.run_module code.interact pdb.run timeit.timeit
pickle.loads _pickle.loads marshal.loads types.FunctionType types.CodeType types.SimpleNamespace functools.partial functools.reduce
operator.attrgetter operator.methodcaller operator.itemgetter copyreg._reconstructor copyreg.__newobj__ copyreg.add_extension
ctypes.CDLL socket.create_connection urllib.request.urlopen webbrowser.open http.client.HTTPConnection shutil.rmtree tempfile.mkdtemp
pathlib.Path pathlib.Path.write_text logging.config.listen site.addsitedir sys.exit sys.setrecursionlimit sys.modules gc.get_objects
collections.OrderedDict collections.defaultdict datetime.datetime decimal.Decimal uuid.UUID numpy.load numpy.save numpy.fromfile
numpy.memmap numpy.savetxt numpy.zeros numpy.vectorize numpy.ndarray.tofile numpy.f2py.main numpy.testing._private.utils.runstring
numpy.ma.core._mareconstruct numpy.random._pickle.__bit_generator_ctor numpy.recarray numpy.dtype.__setstate__
numpy._core.multiarray.fromfile numpy._core.multiarray.frombuffer numpy._core.records.fromrecords torch._utils._rebuild_tensor_v2
torch.storage._load_from_bytes torch.load cloudpickle.cloudpickle._make_function twinbench.datasets.safe_pickle.load
twinbench.datasets.pickle_arrays.Pending twinbench.datasets.pickle_arrays.Function
"""
CALLABLES = _NAMES.split()

OPCODES = {
    "INST": b"(Vtrue\nios\nsystem\n.",
    "OBJ": b"(cos\nsystem\nVtrue\no.",
    "OBJ of an array": b"(cnumpy\nndarray\nK\x02o.",
    "NEWOBJ": b"cnumpy\nndarray\nK\x02\x85\x81.",
    "NEWOBJ_EX": b"cnumpy\nndarray\nK\x02\x85}\x92.",
    "EXT1": b"\x82\x01.",
    "EXT2": b"\x83\x01\x00.",
    "EXT4": b"\x84\x01\x00\x00\x00.",
    "PERSID": b"Pwho\n.",
    "BINPERSID": b"Vwho\nQ.",
    "NEXT_BUFFER": b"\x80\x05\x97.",
    "READONLY_BUFFER": b"\x80\x05\x96\x01\x00\x00\x00\x00\x00\x00\x00a\x98.",
    "EMPTY_SET": b"\x8f.",
    "ADDITEMS": b"](K\x01\x90.",
    "FROZENSET": b"(K\x01\x91.",
    "state of ndarray": b"cnumpy\nndarray\n}Vtofile\nI1\nsb.",
    "state of dtype": b"cnumpy\ndtype\n(V__reduce__\nI1\ntb.",
    "slots of a function": b"c_codecs\nencode\n(N}Vcall\ncnumpy\nndarray\nstb.",
    "state of a dict": b"}}V__class__\nI1\nsb.",
    "state of a list": b"](I1\ntb.",
    "state twice": b"cnumpy\ndtype\n(Vf8\nI00\nI01\ntR2(I3\nV<\nNNNtb02(I3\nV<\nNNNtb.",
    "call of what was called": b"cnumpy\ndtype\n(Vf8\nI00\nI01\ntR(tR.",
    "a protocol of tomorrow": b"\x80\x06N.",
    "a dotted name on the stack": b"\x80\x04\x8c\x05numpy\x8c\x14ndarray.__subclasses__\x93.",
    "a name that is no text": b"\x80\x04]]\x93.",
    "a name with a terminal's escape": b"\x80\x04\x8c\x02os\x8c\x07\x1b]0;x\x07\n\x93.",
    "a name of a deep tuple": b"\x80\x04)" + b"\x85" * 100_000 + b"2\x93.",
    "re-encoding as code": b"c_codecs\nencode\n(Vx\nVunicode_escape\ntR.",
    "the state of a structured array": pickle.dumps(np.zeros(2, [("a", "f8")])),
    "objects in fields": pickle.dumps(np.zeros(2, [("a", "O")])),
    "a bool that is 2": pickle.dumps(np.ones(8, bool), 4).replace(b"\x01" * 8, b"\x02" * 8),
    "a character beyond Unicode": pickle.dumps(np.array(["abcd"]), 4).replace(b"d\x00\x00\x00", b"d\x00\x00\xff"),
}


@pytest.fixture(scope="module")
def ward(tmp_path_factory):
    found = Ward(tmp_path_factory.mktemp("ward"))
    yield found
    found.close()


def refused(ward, data):
    """The error that ``data`` ends in."""
    told = ward.open(data)
    assert told["came"] == "ValueError" and told["message"].isprintable(), told
    assert told["set_off"] == [], told
    return told


@pytest.mark.parametrize("name", CALLABLES)
def test_no_callable_is_found(ward, name):
    """By both spellings of a name, and by Python's own unpickler's rule that a dot in it means an attribute."""
    module, _, attribute = name.rpartition(".")
    told = refused(ward, f"c{module}\n{attribute}\n(Vtrue\ntR.".encode())
    assert f"refused, it calls for {name};" in told["message"]
    first, _, dotted = name.partition(".")
    names = b"".join(b"\x8c" + bytes([len(part)]) + part.encode() for part in (first, dotted))
    assert f"refused, it calls for {name};" in refused(ward, b"\x80\x04" + names + b"\x93\x8c\x04true\x85R.")["message"]


@pytest.mark.parametrize("name", OPCODES)
def test_no_opcode_makes_more_than_data(ward, name):
    refused(ward, OPCODES[name])


# --- bombs -------------------------------------------------------------------------------------------------------------------------------

FROMBUFFER = b"cnumpy._core.numeric\n_frombuffer\nq\x10"
F8 = b"cnumpy\ndtype\n(X\x02\x00\x00\x00f8\x89\x88tR(K\x03X\x01\x00\x00\x00<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tbq\x11"
C = b"X\x01\x00\x00\x00Cq\x12"
BILLION = b"J\x00\xca\x9a\x3b"


def text(n):
    return b"X" + struct.pack("<I", n) + b"a" * n


# name: (pickle, what the error says)
BOMBS = {
    "a deep tuple as a key": (b"})" + b"\x85" * 300_000 + b"Ns.", "a key of a dict must be .* got a tuple"),
    "a wide tuple as a key": (b"\x80\x02})" + b"2\x86" * 45 + b"Ns.", "a key of a dict must be .* got a tuple"),
    "a list as a key": (b"}]Ns.", "a key of a dict must be .* got a list"),
    "a number of numpy's as a key": (pickle.dumps({np.float64(1): 0}), "a key of a dict must be .* got a float64"),
    "a buffer that is a number": (FROMBUFFER + b"(" + BILLION + F8 + BILLION + b"\x85" + C + b"tR.", "are not bytes"),
    "a buffer used 12,000 times": (
        b"(B"
        + struct.pack("<I", 65536)
        + bytes(65536)
        + b"q\x00"
        + FROMBUFFER
        + F8
        + C
        + b"h\x10(h\x00h\x11M\x00\x20\x85h\x12tR" * 12_000
        + b"l.",
        "it makes takes more than 71039136 bytes, too much for a file of 245642",
    ),
    "shared tuples": (b")" + b"2\x86" * 45 + b".", "more than 67110[0-9]{3} bytes with all that it shares"),
    "shared lists": (b"]q\x00" + b"".join(b"0](" + b"h%c" % n * 10 + b"eq%c" % (n + 1) for n in range(15)) + b".", "all that it shares"),
    "a shared array": (
        FROMBUFFER
        + b"(B"
        + struct.pack("<I", 80_000)
        + bytes(80_000)
        + F8
        + b"M\x10\x27\x85"
        + C
        + b"tRq\x00"
        + b"0("
        + b"h\x00" * 20_000
        + b"l.",
        "all that it shares",
    ),
    "deep lists": (b"]" * 100_000 + b"a" * 99_999 + b".", "nested more than 100 levels"),
    "deep tuples": (b")" + b"\x85" * 300_000 + b".", "nested more than 100 levels"),
    "depth by sharing": (
        b")q\x00" + b"".join(b"0h%c" % n + b"\x85" * 60 + b"q%c" % (n + 1) for n in range(9)) + b"0(h\x00h\x01h\x02h\x03h\x09l.",
        "100 levels",
    ),
    "a list in itself": (b"]q\x00h\x00a.", "contains itself"),
    "a dict in itself": (b"}q\x00Vx\nh\x00s.", "contains itself"),
    "marks, lists and dicts of one byte each": (b"(]}" * 450_000 + b".", "it makes takes more than"),
    "keys of one hash": (  # multiples of the prime that Python's hash of numbers is taken by
        b"}(" + b"".join(b"\x8a\x0b" + (n * (2**61 - 1)).to_bytes(11, "little") + b"N" for n in range(1, 40_000)) + b"u.",
        "it makes takes more than",
    ),
    "two long keys compared for ever": (
        b"}q\x00" + text(1_000_000) + b"q\x01" + text(1_000_000) + b"q\x02" + b"h\x00h\x01Nsh\x00h\x02Ns00" * 100_000 + b".",
        "it makes takes more than",
    ),
    "a text encoded for ever": (
        b"c_codecs\nencode\nq\x00" + text(1_000_000) + b"q\x01Vlatin1\nq\x02(" + b"h\x00h\x01h\x02\x86R0" * 100_000 + b".",
        "it makes takes more than",
    ),
    "an empty array as wide as the sky": (
        FROMBUFFER + b"(C\x00" + F8 + b"K\x00\x8a\x05\x00\x00\x00\x00\x10\x86" + C + b"tR.",
        "it makes takes more than",
    ),
    "no values of a gigabyte each": (
        FROMBUFFER + b"(C\x00" + F8.replace(b"\x02\x00\x00\x00f8", b"\x0a\x00\x00\x00S999999999") + b"K\x00\x85" + C + b"tR.",
        "it makes takes more than",
    ),
    "a shape of 100,000 axes": (
        FROMBUFFER + b"(C\x00" + F8 + b"(" + (b"\x8a\x7f" + b"\x01" * 127) + b"2" * 100_000 + b"t" + C + b"tR.",
        "up to 64 integers",
    ),
    "a shape of deep tuples": (FROMBUFFER + b"(C\x00" + F8 + b")" + b"2\x86" * 45 + C + b"tR.", "up to 64 integers"),
    "an integer of 5 MB": (b"\x8b" + struct.pack("<i", 5_000_000) + b"\x7f" * 5_000_000 + b".", "an integer of 5000000 bytes"),
    "a negative length": (b"\x8b\xff\xff\xff\xff.", "-1 bytes must follow"),
    "a million digits": (b"I" + b"9" * 1_000_000 + b"\n.", "a number of 1000000 digits"),
    "a million digits, long": (b"L" + b"9" * 1_000_000 + b"L\n.", "a number of 1000001 digits"),
    "a million digits, float": (b"F" + b"9" * 1_000_000 + b"\n.", "a number of 1000000 digits"),
    "a memo index of 4 billion": (b"Nr\xff\xff\xff\xff.", "memo index 4294967295 is larger"),
    "a memo index in digits": (b"Np" + b"9" * 40 + b"\n.", "memo index 9{40} is larger"),
    "a negative memo index": (b"Nq\x00g-1\n.", "nothing is remembered as -1"),
    "a length of 2^60 bytes": (b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x0f.", "1152921504606846975 bytes must follow"),
    "a frame of 2^64 bytes": (b"\x80\x04\x95" + b"\xff" * 8 + b"N.", "18446744073709551615 bytes must follow"),
    "two objects": (b"NN.", "STOP"),
    "a mark left over": (b"(N.", "STOP"),
    "an empty stack": (b"0.", "POP"),
    "more than the stack holds": (b"N\x87.", "TUPLE3"),
    "what lies under the mark": (b"N(\x85.", "TUPLE1"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_no_bomb_goes_off(ward, name):
    """Memory: the 64 MiB that any file may make and 16 bytes for each of its own, and as much again for copies that are under way."""
    data, said = BOMBS[name]
    told = refused(ward, data)
    assert told["memory"] < 2 * (safe_pickle.BUDGET + safe_pickle.BUDGET_PER_BYTE * len(data)) and told["seconds"] < 8
    assert re.search(said, told["message"]), told
