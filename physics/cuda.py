"""Compiling CUDA C++ while the program runs, and launching it with what Warp's own kernels cannot have: clusters and large shared memory.

The compiler (NVRTC) is the one that torch brings along, the driver the one that every CUDA program needs; both are called through their C
interfaces. Compiled programs are kept in Warp's kernel cache.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
from functools import cache
from pathlib import Path
from typing import Any

__all__ = ["Program", "available", "compiled", "known_architectures"]

SHARED_BYTES, CARVEOUT, NON_PORTABLE = 8, 9, 14  # function attributes, numbered as in cuda.h
CLUSTER = 4  # launch attribute


class _Attribute(ctypes.Structure):
    _fields_ = (("id", ctypes.c_int), ("pad", ctypes.c_char * 4), ("value", ctypes.c_uint * 16))


class _Config(ctypes.Structure):
    _fields_ = (
        ("grid", ctypes.c_uint * 3),
        ("block", ctypes.c_uint * 3),
        ("shared", ctypes.c_uint),
        ("stream", ctypes.c_void_p),
        ("attributes", ctypes.POINTER(_Attribute)),
        ("count", ctypes.c_uint),
    )


@cache
def _compiler() -> Any:
    """NVRTC of torch's CUDA version, or None."""
    import torch

    if torch.version.cuda is None:
        return None
    name = f"libnvrtc.so.{torch.version.cuda.split('.')[0]}"
    packages = Path(torch.__file__).parents[1]
    for place in (name, *sorted(map(str, packages.glob(f"nvidia/*/lib/{name}"))), str(packages / "torch" / "lib" / name)):
        try:
            return ctypes.CDLL(place)
        except OSError:
            continue
    return None


@cache
def _driver() -> Any:
    """The CUDA driver, or None."""
    try:
        return ctypes.CDLL("libcuda.so.1")
    except OSError:
        return None


def available(capability: tuple[int, int]) -> bool:
    """Whether programs for devices of this compute capability can be compiled and launched here."""
    return _driver() is not None and _compiler() is not None and 10 * capability[0] + capability[1] in known_architectures(_compiler())


def known_architectures(nvrtc) -> list[int]:
    """Those that the compiler can make machine code for: 90 is compute capability 9.0."""
    count = ctypes.c_int()
    nvrtc.nvrtcGetNumSupportedArchs(ctypes.byref(count))
    found = (ctypes.c_int * count.value)()
    nvrtc.nvrtcGetSupportedArchs(found)
    return list(found)


def compiled(source: str, options: tuple[str, ...], architecture: str, nvrtc=None) -> bytes:
    """Machine code for ``architecture`` ("sm_90") of CUDA C++ ``source``. Raises RuntimeError with the compiler's words."""
    nvrtc = nvrtc or _compiler()
    program, size = ctypes.c_void_p(), ctypes.c_size_t()

    def text(measure, read):
        measure(program, ctypes.byref(size))
        found = ctypes.create_string_buffer(size.value)
        read(program, found)
        return found.raw

    nvrtc.nvrtcCreateProgram(ctypes.byref(program), source.encode(), b"twinbench.cu", 0, None, None)
    words = [o.encode() for o in (f"--gpu-architecture={architecture}", "--std=c++17", "-default-device", *options)]
    failed = nvrtc.nvrtcCompileProgram(program, len(words), (ctypes.c_char_p * len(words))(*words))
    try:
        if failed:
            log = text(nvrtc.nvrtcGetProgramLogSize, nvrtc.nvrtcGetProgramLog).decode(errors="replace")
            raise RuntimeError(f"the CUDA compiler refused a kernel: {log}")
        return text(nvrtc.nvrtcGetCUBINSize, nvrtc.nvrtcGetCUBIN)
    finally:
        nvrtc.nvrtcDestroyProgram(ctypes.byref(program))


@cache
def _cubin(source, options, architecture):
    import warp as wp

    major, minor = ctypes.c_int(), ctypes.c_int()
    _compiler().nvrtcVersion(ctypes.byref(major), ctypes.byref(minor))
    key = repr((source, options, architecture, major.value, minor.value))
    kept = Path(wp.config.kernel_cache_dir) / f"twinbench_{hashlib.sha256(key.encode()).hexdigest()[:32]}.cubin"
    if kept.exists():
        return kept.read_bytes()
    code = compiled(source, options, architecture)
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(f".{os.getpid()}")
        part.write_bytes(code)
        part.replace(kept)
    except OSError:
        pass  # a cache that cannot be written only costs time
    return code


def _check(status, what):
    if status:
        name = ctypes.c_char_p()
        _driver().cuGetErrorString(status, ctypes.byref(name))
        raise RuntimeError(f"{what} failed: {(name.value or b'unknown error').decode()}")


class Program:
    """One kernel of ``source``, on the device that torch has selected when it is made.

    cluster  blocks of a thread block cluster
    shared   bytes of dynamic shared memory a block
    """

    def __init__(self, source: str, kernel: str, *, options: tuple[str, ...], threads: int, cluster: int, shared: int):
        import torch

        torch.cuda.current_stream()  # starts CUDA
        major, minor = torch.cuda.get_device_capability()
        self.threads, self.cluster, self.shared = threads, cluster, shared
        driver, module, self.function = _driver(), ctypes.c_void_p(), ctypes.c_void_p()
        code = _cubin(source, options, f"sm_{major}{minor}")
        _check(driver.cuModuleLoadData(ctypes.byref(module), code), "loading a kernel")
        _check(driver.cuModuleGetFunction(ctypes.byref(self.function), module, kernel.encode()), f"finding kernel {kernel}")
        whole = torch.cuda.get_device_properties().shared_memory_per_multiprocessor
        wishes = {SHARED_BYTES: shared, CARVEOUT: min(100, -(-100 * (shared + 1024) // whole))}
        if cluster > 8:
            wishes[NON_PORTABLE] = 1
        for attribute, value in wishes.items():
            _check(driver.cuFuncSetAttribute(self.function, attribute, value), f"giving kernel {kernel} {shared} bytes of shared memory")

    def _config(self, blocks, stream=None):
        attribute = _Attribute(CLUSTER)
        attribute.value[:3] = (self.cluster, 1, 1)
        one = (ctypes.c_uint * 3)(blocks, 1, 1), (ctypes.c_uint * 3)(self.threads, 1, 1)
        return _Config(*one, self.shared, stream, ctypes.pointer(attribute), int(self.cluster > 1))

    def resident(self) -> int:
        """How many clusters the device holds at once."""
        count = ctypes.c_int()
        if self.cluster == 1:
            _check(
                _driver().cuOccupancyMaxActiveBlocksPerMultiprocessor(
                    ctypes.byref(count), self.function, self.threads, ctypes.c_size_t(self.shared)
                ),
                "asking for a kernel's occupancy",
            )
            import torch

            return count.value * torch.cuda.get_device_properties().multi_processor_count
        config = self._config(self.cluster)
        _check(_driver().cuOccupancyMaxActiveClusters(ctypes.byref(count), self.function, ctypes.byref(config)), "asking for clusters")
        return count.value

    def launch(self, blocks: int, argument: ctypes.Structure) -> None:
        """Start ``blocks`` blocks on torch's current stream, with one structure for all of them to read."""
        import torch

        config = self._config(blocks, torch.cuda.current_stream().cuda_stream)
        pointers = (ctypes.c_void_p * 1)(ctypes.addressof(argument))
        _check(_driver().cuLaunchKernelEx(ctypes.byref(config), self.function, pointers, None), "starting a kernel")
