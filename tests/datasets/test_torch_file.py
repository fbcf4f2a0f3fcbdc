"""Checkpoints from other people: what torch.save wrote of plain tensors comes out, whatever else is in a file is refused with one error."""

import collections
import pathlib
import pickle
import struct
import zipfile

import numpy as np
import pytest
import torch
from twinbench.datasets import torch_file


def changed(file, edit, **kinds):
    """``file`` with each part passed through ``edit(name, bytes)``; None drops it."""
    with zipfile.ZipFile(file) as archive:
        parts = {name: edit(name, archive.read(name)) for name in archive.namelist()}
    with zipfile.ZipFile(file, "w", **kinds) as archive:
        for name, data in parts.items():
            if data is not None:
                archive.writestr(name, data)


def program(file, data):
    """``file`` with another pickle in it."""
    changed(file, lambda name, old: data if name.endswith("data.pkl") else old)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "best_1.pth"
    torch.save({"a": torch.arange(300.0), "n": 7}, path)
    return path


def test_tensors_numbers_dicts_and_lists_come_out(tmp_path):
    leaf = torch.nn.Parameter(torch.linspace(0, 1, 5, dtype=torch.float64))
    state = {
        "w": leaf,
        "half": torch.ones(3).half(),
        "steps": torch.tensor([4]),
        "view": torch.arange(10.0)[::3],
        "n": 3,
        "x": [1.5, "a", None],
    }
    torch.save({**state, "inner": collections.OrderedDict(b=torch.zeros(2))}, tmp_path / "f.pth")
    found = torch_file.load(tmp_path / "f.pth")
    assert (found["n"], found["x"]) == (3, [1.5, "a", None]) and list(found["inner"]) == ["b"]
    for key, expected in {"w": np.linspace(0, 1, 5), "half": np.ones(3), "steps": [4], "view": [0, 3, 6, 9]}.items():
        np.testing.assert_array_equal(torch_file.tensor_of(found[key], "f.pth", key, len(expected)), expected)


def test_tensors_of_a_graphics_card_come_out_on_the_cpu(file):
    # as the published checkpoints were saved: each storage says where it was
    with zipfile.ZipFile(file) as archive:
        found = archive.read(next(name for name in archive.namelist() if name.endswith("data.pkl")))
    here, there = (b"X" + struct.pack("<I", len(name)) + name for name in (b"cpu", b"cuda:0"))
    assert found.count(here) == 1
    program(file, found.replace(here, there))
    np.testing.assert_array_equal(torch_file.tensor_of(torch_file.load(file)["a"], file, "a", 300), np.arange(300.0))


def test_what_cannot_be_opened(file, tmp_path):
    for path, said in ((tmp_path / "none.pth", "No such file"), (tmp_path, "not a file")):
        with pytest.raises(ValueError, match=rf"{path.name}: cannot be read \({said}"):
            torch_file.load(path)
    whole = file.read_bytes()
    for part in (b"", whole[:10], whole[: len(whole) // 2], whole[:-1], pickle.dumps({"a": 1})):
        file.write_bytes(part)
        with pytest.raises(ValueError, match=r"best_1\.pth: not a complete checkpoint"):
            torch_file.load(file)
    torch.save([torch.ones(2)], file)
    with pytest.raises(ValueError, match="must hold a dict, got a list"):
        torch_file.load(file)


@pytest.mark.parametrize(
    ("value", "called"),
    [
        (pathlib.PurePosixPath("/x"), r"pathlib\.PurePosixPath"),
        (np.float64(3.0), r"numpy\._?core\.multiarray\.scalar"),
        (np.ones(2), r"numpy\._?core\.multiarray\._reconstruct"),
        (torch.eye(3).to_sparse(), r"torch\._utils\._rebuild_sparse_tensor"),
        (torch.device("cpu"), r"torch\.device"),
        (bytearray(3), r"\w+\.bytearray"),
        (torch.nn.Linear(2, 2), r"torch\.nn\.modules\.linear\.Linear"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_no_plain_tensor_is_refused_by_name(value, called, tmp_path):
    torch.save({"a": value}, tmp_path / "f.pth")
    with pytest.raises(ValueError, match=rf"f\.pth: refused, it calls for {called}; a checkpoint may hold only tensors"):
        torch_file.load(tmp_path / "f.pth")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"\x80\x02cos\nsystem\nX\x04\x00\x00\x00true\x85R.", r"calls for os\.system"),
        (b"\x80\x02cbuiltins\nbytearray\nM\x10\x27\x85R.", r"calls for builtins\.bytearray"),
        (b"\x80\x04\x8c\x02os\x8c\x06system\x93.", "calls for what its opcode STACK_GLOBAL names"),
        (b"\x80\x02(X\x04\x00\x00\x00trueios\nsystem\n.", "calls for what its opcode INST names"),
        (b"\x80\x02}X\xff\xff\xff\x7fab.", "not a complete pickle"),
        (b"\x80\x02}", "not a complete pickle"),
        (b"\x80\x02.", "not a checkpoint of plain tensors"),
        (b"\x80\x02}Q.", "not a checkpoint of plain tensors"),
    ],
)
def test_hostile_programs_are_refused(data, said, file):
    program(file, data)
    with pytest.raises(ValueError, match=rf"best_1\.pth: .*{said}"):
        torch_file.load(file)


def test_hostile_archives_are_refused(file):
    whole = file.read_bytes()
    for edit, kinds, said in (
        (lambda name, data: data, {"compression": zipfile.ZIP_DEFLATED}, "is compressed or encrypted"),
        (lambda name, data: None if name.endswith("data.pkl") else data, {}, "must hold one data.pkl"),
        (lambda name, data: b"big" if name.endswith("byteorder") else data, {}, "must be little-endian, got b'big'"),
        (lambda name, data: data + bytes(1 << 20) if name.endswith("data.pkl") else data, {}, "must have at most 1048576 bytes"),
    ):
        file.write_bytes(whole)
        changed(file, edit, **kinds)
        with pytest.raises(ValueError, match=said):
            torch_file.load(file)


@pytest.mark.parametrize("claimed", [301, 10**6, 2**31 - 1])
def test_a_size_that_the_file_does_not_have_takes_no_memory(claimed, file):
    # 300 floats that are said to be many more: storage and shape both
    small, large = b"M" + struct.pack("<H", 300), b"J" + struct.pack("<i", claimed)
    with zipfile.ZipFile(file) as archive:
        found = archive.read(next(name for name in archive.namelist() if name.endswith("data.pkl")))
    assert found.count(small) == 2
    program(file, found.replace(small, large))
    with pytest.raises(ValueError, match=r"best_1\.pth: ") as caught:
        torch_file.tensor_of(torch_file.load(file)["a"], file, "a", 300)
    assert "not a checkpoint of plain tensors" in str(caught.value) or "must have shape (300,)" in str(caught.value)


def test_a_view_of_one_number_as_many_is_not_written_out(tmp_path):
    torch.save({"a": torch.ones(1).expand(10**11)}, tmp_path / "f.pth")  # 400 GB
    with pytest.raises(ValueError, match=r"f\.pth: a must have shape \(5,\) for five reasons, got \(100000000000,\)"):
        torch_file.tensor_of(torch_file.load(tmp_path / "f.pth")["a"], "f.pth", "a", 5, why=" for five reasons")


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ([1.0, 2.0], "a must be a tensor, got a list"),
        (torch.ones(3), r"a must have shape \(2,\), got \(3,\)"),
        (torch.tensor([1.0, float("inf")]), "a must be finite, got inf at index 1"),
    ],
)
def test_tensors_that_are_none_of_so_many_numbers(value, said):
    with pytest.raises(ValueError, match=f"^f: {said}$"):
        torch_file.tensor_of(value, "f", "a", 2)
