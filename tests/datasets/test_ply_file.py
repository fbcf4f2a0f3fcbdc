"""Vertices of .ply files, and the Gaussians that PhysTwin's authors keep in them: bytes made by hand, one error for what is wrong."""

import re

import numpy as np
import pytest
import released_files
import torch
from twinbench.datasets.ply_file import read_vertices, write_vertices
from twinbench.methods.appearance.gaussians import Gaussians
from twinbench.methods.appearance.published import read_gaussians, write_gaussians

ASCII = b"ply\nformat ascii 1.0\ncomment by hand\nelement vertex 2\nproperty float x\nproperty uchar red\nend_header\n0.5 7\n-2e-3 255\n"
BINARY = (
    b"ply\r\nformat binary_little_endian 1.0\r\nelement vertex 2\r\nproperty float32 x\r\nproperty uint8 red\r\nend_header\r\n"
    b"\x00\x00\x00?\x07\x00\x00\x00\xc0\xff"  # 0.5 and -2 in IEEE 754
)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "point_cloud.ply"


def test_both_formats(file):
    for data, x in ((ASCII, [0.5, -2e-3]), (BINARY, [0.5, -2.0])):
        file.write_bytes(data)
        found = read_vertices(file)
        assert list(found) == ["x", "red"] and found["x"].tolist() == x and found["red"].tolist() == [7, 255]


@pytest.mark.parametrize(
    ("data", "old", "new", "said"),
    [
        (ASCII, b"ply\n", b"plx\n", "not a .ply file"),
        (ASCII, b"end_header", b"end_headed", "not a .ply file"),
        (ASCII, b"ascii", b"binary_big_endian", "got the line 'format binary_big_endian 1.0'"),
        (ASCII, b"property uchar red", b"property list uchar int red", "got the line 'property list uchar int red'"),
        (ASCII, b"property uchar red", b"property uchar x", "got the line 'property uchar x'"),
        (ASCII, b"property uchar red", b"property float128 red", "got the line 'property float128 red'"),
        (ASCII, b"property uchar red", b"element face 3", "got the line 'element face 3'"),
        (ASCII, b"vertex 2", b"vertex -2", "got the line 'element vertex -2'"),
        (ASCII, b"format ascii 1.0\n", b"", "its header lacks a format"),
        (ASCII, b"element vertex 2\nproperty float x\nproperty uchar red\n", b"", "its header lacks vertices"),
        (ASCII, b"vertex 2", b"vertex 3", "3 vertices of 2 numbers are 6 numbers, got 4"),
        (ASCII, b"vertex 2", b"vertex 999999999999999999", "do not fit into"),
        (ASCII, b"255", b"many", "its vertices must be numbers"),
        (ASCII, b"0.5", b"nan", "x must be finite, got nan at vertex 0"),
        (ASCII, b"-2e-3", b"1e999", "x must be finite, got inf at vertex 1"),
        (BINARY, b"\xff", b"", "2 vertices of 5 bytes take 10 bytes, got 9"),
        (BINARY, b"\xff", b"\xff\x00", "2 vertices of 5 bytes take 10 bytes, got 11"),
        (BINARY, b"vertex 2", b"vertex 999999999999999999", "take 4999999999999999995 bytes, got 10"),
        (BINARY, b"\x00\x00\x00?", b"\x00\x00\xc0\x7f", "x must be finite, got nan at vertex 0"),
    ],
)
def test_what_is_wrong_is_said(data, old, new, said, file):
    assert data.count(old) >= 1
    file.write_bytes(data.replace(old, new, 1))
    with pytest.raises(ValueError, match=f"point_cloud.ply: .*{re.escape(said)}"):
        read_vertices(file)


def test_a_file_that_is_not_there(file):
    with pytest.raises(ValueError, match=r"point_cloud\.ply: cannot be read"):
        read_vertices(file)


def test_columns_of_one_length_are_written(file):
    write_vertices(file, {"x": [1.0, 2.0], "y": np.zeros(2)})
    assert read_vertices(file)["x"].tolist() == [1, 2]
    with pytest.raises(ValueError, match=r"y must have shape \(2,\), got \(3,\)"):
        write_vertices(file, {"x": [1.0, 2.0], "y": np.zeros(3)})


# ---------------------------------------------------------------- Gaussians


def test_gaussians_as_they_are_published(file):
    cloud = released_files.gaussians(20, 0)
    file.write_bytes(released_files.point_cloud(cloud))
    found = read_gaussians(file)
    np.testing.assert_array_equal(found.positions, np.stack([cloud[name] for name in "xyz"], 1))
    np.testing.assert_array_equal(found.log_scales, cloud["scale_0"])
    np.testing.assert_allclose(found.opacities, 1 / (1 + np.exp(-cloud["opacity"])), rtol=1e-6)  # the inverse of the logit
    assert found.rotations is None and found.degree == 3  # round, and its harmonics are read in the world
    for k, colour in ((0, 0), (1, 0), (15, 0), (1, 1), (9, 2)):  # colour by colour: f_rest_0..14 are red's
        name = f"f_dc_{colour}" if k == 0 else f"f_rest_{15 * colour + k - 1}"
        np.testing.assert_array_equal(found.harmonics[:, k, colour], cloud[name])


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_written_gaussians_come_back(degree, file):
    random = torch.Generator().manual_seed(0)
    shapes = ((7, 3), (7,), (7,), (7, (degree + 1) ** 2, 3))
    ours = Gaussians(*(torch.rand(shape, generator=random) for shape in shapes))
    write_gaussians(ours, file)
    found = read_gaussians(file)
    for name in ("positions", "log_scales", "opacities", "harmonics"):
        torch.testing.assert_close(getattr(found, name), getattr(ours, name), rtol=1e-5, atol=1e-6)
    names = list(read_vertices(file))
    assert names == [name for name in released_files.gaussians(1, 0) if name in names]  # in the published order


def test_certain_gaussians_can_be_written(file):
    ours = Gaussians(torch.zeros(2, 3), torch.zeros(2), torch.tensor([0.0, 1.0]), torch.zeros(2, 1, 3))
    write_gaussians(ours, file)
    np.testing.assert_allclose(read_gaussians(file).opacities, [0, 1], atol=2e-6)
    with pytest.raises(ValueError, match="whose harmonics are turned cannot be written"):
        write_gaussians(Gaussians(*(v for v in (ours.positions, ours.log_scales, ours.opacities, ours.harmonics)), torch.ones(2, 4)), file)


def without(*names):
    return lambda cloud: [cloud.pop(name) for name in names]


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (without("opacity", "rot_3"), "lacks the properties opacity, rot_3 of Gaussians; it has x, y, z"),
        (without("scale_0"), "lacks the properties scale_0"),
        (without("f_rest_44"), "f_rest_0 and following must be 0, 9, 24, 45 properties in a row, got 44"),
        (lambda cloud: cloud.update(f_rest_45=cloud.pop("f_rest_3")), "properties in a row, got 45"),
        (lambda cloud: cloud.update(scale_1=cloud["scale_0"], scale_2=cloud["scale_0"] + 1), "as large in all directions, got log scales"),
        (
            lambda cloud: cloud.update({f"rot_{i}": np.zeros(5, np.float32) for i in range(4)}),
            "a quaternion other than 0, got 0 at vertex 0",
        ),
        (lambda cloud: cloud["opacity"].__setitem__(3, np.nan), "opacity must be finite, got nan at vertex 3"),
    ],
)
def test_gaussians_that_are_none_are_refused(spoil, said, file):
    cloud = released_files.gaussians(5, 0)
    spoil(cloud)
    file.write_bytes(released_files.point_cloud(cloud))
    with pytest.raises(ValueError, match=f"point_cloud.ply: .*{re.escape(said)}"):
        read_gaussians(file)
