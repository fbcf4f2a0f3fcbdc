"""A process of its own in which pickles are opened, with little memory and time, that tells what came of each and what it set off."""

import json
import resource
import select
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

MEMORY = 512 << 20  # bytes of address space beyond what the interpreter has: a pickle that asks for more is caught asking
SECONDS = 10  # of processor time for one pickle
PATIENCE = 120  # s, for a machine that is busy


class Ward:
    """Opens pickles one after another in one process; where that dies, the next pickle gets a new one."""

    def __init__(self, folder: Path):
        self.file, self.process = Path(folder) / "ward.pkl", None

    def open(self, data: bytes) -> dict:
        """What came of the pickle ``data``.

        came     "value", the name of an exception, or "died" with the exit status
        message  of the exception
        set_off  audit events of the interpreter: imports, code, processes, files other than the pickle
        memory   bytes by which the process has grown at its peak, this pickle or one before
        seconds  processor time
        """
        if self.process is None:
            self.process = subprocess.Popen([sys.executable, __file__, self.file], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        try:
            self.process.stdin.write(struct.pack("<I", len(data)) + data)
            self.process.stdin.flush()
            answers, _, _ = select.select([self.process.stdout], [], [], PATIENCE)
            line = self.process.stdout.readline() if answers else b""
        except BrokenPipeError:
            line = b""
        if line:
            return json.loads(line)
        return {"came": f"died, {self.close()}", "message": "", "set_off": [], "memory": 0, "seconds": 0}

    def close(self):
        """End the process; its exit status, None where it had to be killed or there is none."""
        if self.process is None:
            return None
        process, self.process = self.process, None
        process.stdin.close()
        try:
            return process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            return None
        finally:
            process.stdout.close()
            process.wait()


def _check(value):
    """Fails where ``value`` is not what the reader promises: known types, plain keys, at most 100 levels of nesting."""
    import numpy as np

    level, depth = [value], 0
    while level:  # level by level, each thing once in each
        inner = {}
        for item in level:
            if type(item) in (str, bytes, int, float, bool, type(None)) or isinstance(item, np.generic):
                continue
            if type(item) is np.ndarray and item.dtype != object:
                continue
            assert type(item) in (dict, list, tuple, np.ndarray), type(item)
            assert type(item) is not dict or all(type(k) in (str, bytes, int, float, bool, type(None)) for k in item)
            parts = item.values() if type(item) is dict else item.flat if type(item) is np.ndarray else item
            inner |= {id(part): part for part in parts}
        level, depth = list(inner.values()), depth + 1
    assert depth <= 101  # 100 levels of containers, and what the last ones hold


def _serve(file):
    from twinbench.datasets import safe_pickle

    set_off, watching = [], False

    def hook(event, arguments):
        if watching and event != "builtins.id" and not (event == "open" and str(arguments[0]) == file):
            set_off.append(f"{event} {arguments!r:.100}")

    def attempt():
        value = safe_pickle.load(file)
        for function in (safe_pickle.array_of, safe_pickle.numbers_of):
            with suppress(ValueError):
                function(value, file, "the content")
        return value

    for first in (b"Vx\n.", b"S'x'\n.", b"]]a."):  # what the reader itself imports at need: codecs, numpy's parts
        Path(file).write_bytes(first)
        with suppress(ValueError):
            attempt()
    sys.addaudithook(hook)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    while head := sys.stdin.buffer.read(4):
        Path(file).write_bytes(sys.stdin.buffer.read(struct.unpack("<I", head)[0]))
        begun = time.process_time()
        resource.setrlimit(resource.RLIMIT_CPU, (int(begun) + 1 + SECONDS, resource.RLIM_INFINITY))
        set_off.clear()
        came, message, value = "value", "", None
        watching = True
        try:
            value = attempt()
        except BaseException as error:
            came, message = type(error).__name__, str(error)
        watching = False
        seconds = time.process_time() - begun
        _check(value)
        memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - usage) << 10
        del value
        print(json.dumps({"came": came, "message": message, "set_off": set_off, "memory": memory, "seconds": seconds}), flush=True)


if __name__ == "__main__":
    _serve(sys.argv[1])
