"""Opening checkpoints from other people: dicts, lists, numbers and dense tensors that ``torch.save`` wrote; nothing in the file is run.

What the file's pickle calls for and how large its parts are is looked at before torch reads it, with ``weights_only`` and mapped into
memory: then no tensor takes more than the file does, whatever size it claims.
"""

from __future__ import annotations

import pickletools
import stat
import zipfile
from pathlib import Path

import numpy as np

__all__ = ["load", "tensor_of"]

LARGEST_PICKLE = 1 << 20  # bytes of the part that is no tensor data; a checkpoint of a hundred thousand springs has 3 kB
_STORAGES = ("Double", "Float", "Half", "BFloat16", "Long", "Int", "Short", "Char", "Byte", "Bool")
_ALLOWED = {
    "collections OrderedDict",
    "torch._utils _rebuild_tensor_v2",
    "torch._utils _rebuild_parameter",
    *(f"torch {kind}Storage" for kind in _STORAGES),
}
_OTHER_CALLS = {"INST", "OBJ", "NEWOBJ", "NEWOBJ_EX", "STACK_GLOBAL", "EXT1", "EXT2", "EXT4", "PERSID"}  # beside GLOBAL: torch writes none


def load(path: str | Path) -> dict:
    """The dict in the checkpoint at ``path``, tensors on the CPU and still in the file; see ``tensor_of``.

    Raises ValueError, naming the file, where it cannot be read, is damaged, or holds or asks for anything else.
    """
    path = Path(path)
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise ValueError(f"{path}: cannot be read (not a file)")
        _check(path)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (zipfile.BadZipFile, NotImplementedError, EOFError, RuntimeError) as error:
        raise ValueError(f"{path}: not a complete checkpoint, which is a zip archive ({error})") from None
    import torch

    try:
        found = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except Exception as error:  # a damaged program can fail in any way
        said = " ".join(str(error).split())[:200]
        raise ValueError(f"{path}: not a checkpoint of plain tensors ({type(error).__name__}: {said})") from None
    if not isinstance(found, dict):
        raise ValueError(f"{path}: must hold a dict, got a {type(found).__name__}")
    return found


def _check(path: Path) -> None:
    """Refuse archives that are compressed, hold more than they are large, or whose pickle calls for anything but tensors."""
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        for member in members:
            if member.compress_type != zipfile.ZIP_STORED or member.flag_bits & 1:
                raise ValueError(f"{path}: refused, its part {member.filename!r} is compressed or encrypted, and torch.save does neither")
        if sum(member.file_size for member in members) > size:
            raise ValueError(f"{path}: refused, its parts claim more bytes than the {size} that it has")
        pickles = [member for member in members if member.filename.endswith("/data.pkl")]
        if len(pickles) != 1:
            raise ValueError(f"{path}: must hold one data.pkl, as torch.save writes it, got {len(pickles)}")
        if pickles[0].file_size > LARGEST_PICKLE:
            raise ValueError(f"{path}: its data.pkl must have at most {LARGEST_PICKLE} bytes, got {pickles[0].file_size}")
        orders = [archive.read(member) for member in members if member.filename.endswith("/byteorder")]
        if any(order != b"little" for order in orders):
            raise ValueError(f"{path}: must be little-endian, got {orders[0][:20]!r}")
        program = archive.read(pickles[0])
    try:
        calls = [(opcode.name, argument) for opcode, argument, _ in pickletools.genops(program)]
    except Exception as error:
        raise ValueError(f"{path}: its data.pkl is not a complete pickle ({error})") from None
    for name, argument in calls:
        if name in _OTHER_CALLS or (name == "GLOBAL" and argument not in _ALLOWED):
            asked = ascii(str(argument).replace(" ", "."))[1:-1] if name == "GLOBAL" else f"what its opcode {name} names"
            raise ValueError(f"{path}: refused, it calls for {asked}; a checkpoint may hold only tensors, dicts, lists and numbers")


def tensor_of(value, file: str | Path, name: str, count: int, *, why: str = "") -> np.ndarray:
    """``value`` (count,) float64, which must be a dense tensor of so many finite numbers. ``why`` says where the number comes from.

    Raises ValueError naming the file and, as ``name``, what it holds there.
    """
    import torch

    if type(value) not in (torch.Tensor, torch.nn.Parameter) or value.layout != torch.strided or value.device.type != "cpu":
        raise ValueError(f"{file}: {name} must be a tensor, got a {type(value).__name__}")
    if tuple(value.shape) != (count,):
        raise ValueError(f"{file}: {name} must have shape ({count},){why}, got {tuple(value.shape)}")
    if value.is_complex() or value.is_quantized:
        raise ValueError(f"{file}: {name} must hold real numbers, got {value.dtype}")
    array = value.detach().double().numpy()
    bad = np.flatnonzero(~np.isfinite(array))
    if len(bad):
        raise ValueError(f"{file}: {name} must be finite, got {array[bad[0]]} at index {bad[0]}")
    return array
