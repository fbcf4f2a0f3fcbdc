"""A mesh brought into place, against scenes whose truth is known by construction."""

import json
import struct

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from twinbench.datasets.capture.build import BuildOptions
from twinbench.datasets.capture.lifting import to_points
from twinbench.datasets.capture.placing import Seen, by_matches, raycast
from twinbench.datasets.capture.prior import Mesh, PriorOptions, place_prior, read_mesh
from twinbench.datasets.capture.shaping import bent, filled
from twinbench.datasets.scenario import Plane
from twinbench.datasets.synthetic.render import look_at

H, W = 120, 160
GROUND = Plane(np.array([0.0, 0.0, -1.0]))


BOXES = (
    (0, 0, 0.06, 0.04, 0.03),
    (0.0605, 0, 0.03, 0.07, 0.06),
    (0, 0.0405, 0.03, 0.03, 0.02),
)  # m: corner, width, depth, height; no face shared


def stairs():
    """A thing that looks different from every side: three boxes side by side on the table (z = 0, up is -z), finely meshed."""
    parts = o3d.geometry.TriangleMesh()
    for x, y, width, depth, height in BOXES:
        parts += o3d.geometry.TriangleMesh.create_box(width, depth, height).translate((x, y, -height))
    parts = parts.subdivide_midpoint(3)
    return Mesh(np.asarray(parts.vertices), np.asarray(parts.triangles))


def outside(points):
    """(P,) m by which points are outside of all boxes."""
    found = []
    for x, y, width, depth, height in BOXES:
        low, high = np.array([x, y, -height]), np.array([x + width, y + depth, 0])
        found.append(np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1))
    return np.min(found, axis=0)


def filmed(mesh, azimuths=(0.4, 2.5, 4.6)):
    """Cameras around ``mesh`` on the table: what each measures, without noise."""
    cameras = [
        look_at([0.4 * np.cos(a), 0.4 * np.sin(a), -0.35], [0.04, 0.03, 0], focal=180, width=W, height=H, principal=(80, 60))
        for a in azimuths
    ]
    masks, depths, clouds = [], [], []
    for camera in cameras:
        rows, columns = np.mgrid[:H, :W]
        pixels = np.stack([columns, rows], -1).astype(float)
        eye = camera.camera_to_world[:3, 3]
        rays = to_points(camera, pixels, np.ones((H, W))) - eye
        both = np.concatenate([np.broadcast_to(eye, rays.shape), rays], -1).astype(np.float32)
        far = raycast(mesh.vertices, mesh.faces).cast_rays(o3d.core.Tensor(both))["t_hit"].numpy().astype(float)
        table = -eye[2] / rays[..., 2]
        masks.append(far < table)
        depths.append(np.minimum(far, table))
        clouds.append(to_points(camera, pixels[masks[-1]], depths[-1][masks[-1]]))
    return cameras, masks, [np.zeros((H, W), bool)] * len(cameras), depths, clouds


@pytest.mark.long
@pytest.mark.parametrize("azimuths", [(0.4, 2.5, 4.6), (0.4,)])
def test_a_mesh_of_other_units_and_axes_is_brought_into_place(azimuths):
    """Pixels of the object are 2.8 mm wide, and with one camera its far side is told by the table and the silhouette alone."""
    true = stairs()
    turn = Rotation.from_euler("xyz", [2.0, -1.1, 0.7]).as_matrix()
    mesh = Mesh(25 * true.vertices @ turn.T + [3, -2, 1], true.faces)
    cameras, masks, hidden, depths, clouds = filmed(true, azimuths)
    tracked = np.concatenate(clouds)[::7]
    prior = place_prior(mesh, cameras, masks, hidden, depths, clouds, tracked, GROUND)
    off = np.linalg.norm(prior.placed.apply(mesh.vertices) - true.vertices, axis=1)
    assert off.mean() < (0.001 if len(azimuths) == 3 else 0.004) and abs(25 * prior.placed.scale - 1) < 0.03
    assert prior.final <= prior.rigid < 0.001
    assert len(prior.hull.interior) > 50 and outside(prior.hull.interior).max() < 0.005 and prior.carved < 0.1


def matched(seed, wrong):
    """Largest error [m] of points placed by 24 exact matches, of which so many are ``wrong`` by a fifth of a metre."""
    rng = np.random.default_rng(seed)
    camera = look_at([0.3, 0.2, -0.5], [0, 0, 0], focal=300, width=W, height=H, principal=(80, 60))
    pixels = np.stack([rng.permutation(np.arange(20, 140, 4))[:24], rng.permutation(np.arange(10, 110, 4))[:24]], 1).astype(float)
    z = rng.uniform(0.5, 0.65, 24)
    world, depth = to_points(camera, pixels, z), np.zeros((H, W))
    depth[pixels[:, 1].astype(int), pixels[:, 0].astype(int)] = z
    turn, scale, shift = Rotation.random(random_state=rng).as_matrix(), rng.uniform(0.01, 50), rng.normal(size=3)
    own = scale * world @ turn.T + shift
    own[:wrong] += scale * 0.2
    placed = by_matches(pixels, own, camera, depth, 50.0)
    return np.abs(placed.apply(own[wrong:]) - world[wrong:]).max()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_matches_give_pose_and_scale(seed):
    """PnP of exact pixels is exact up to the scale about the camera's centre, which exact depth gives."""
    assert matched(seed, 0) < 1e-5


def test_wrong_matches_are_left_out():
    """RANSAC draws at random, and a wrong point may lie on its own ray, where the picture does not show it: nine of ten are exact."""
    assert np.mean([matched(seed, 3) < 1e-5 for seed in range(60)]) > 0.9


def test_matches_that_cannot_be_trusted_are_refused():
    cameras, _, _, depths, clouds = filmed(stairs())
    points, pixels = clouds[0][::10], cameras[0].project(clouds[0][::10])[0]
    with pytest.raises(ValueError, match=r"at least 6 pixels .* got \(5, 2\)"):
        by_matches(pixels[:5], points[:5], cameras[0], depths[0], 50.0)
    with pytest.raises(ValueError, match="must lie where depth was measured"):
        by_matches(pixels, points, cameras[0], 0 * depths[0], 50.0)
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="matches of the mesh must"):
        by_matches(pixels, rng.permutation(points), cameras[0], depths[0], 50.0)


def test_another_object_is_refused():
    ball = o3d.geometry.TriangleMesh.create_sphere(1.0, resolution=10)
    cameras, masks, hidden, depths, clouds = filmed(stairs())
    clouds = [cloud + np.random.default_rng(k).normal(0, 0.05, cloud.shape) for k, cloud in enumerate(clouds)]
    with pytest.raises(ValueError, match=r"must come within 15 mm of what was measured .* is it this object"):
        mesh = Mesh(np.asarray(ball.vertices), np.asarray(ball.triangles))
        place_prior(mesh, cameras, masks, hidden, depths, clouds, clouds[0][::9], GROUND, PriorOptions(elevations=1, azimuths=2, rolls=1))


def test_a_sheet_follows_a_bump_that_was_measured():
    """A flat sheet 20 mm above the table; measured is one with a smooth bump of 8 mm, seen from straight above."""
    u, v = np.meshgrid(np.linspace(-0.05, 0.05, 21), np.linspace(-0.05, 0.05, 21))
    flat = np.stack([u, v, np.full_like(u, -0.02)], -1).reshape(-1, 3)
    n = np.arange(441).reshape(21, 21)
    a, b, c, d = (x.ravel() for x in (n[:-1, :-1], n[:-1, 1:], n[1:, :-1], n[1:, 1:]))
    mesh = Mesh(flat, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))
    x = np.stack(np.meshgrid(np.linspace(-0.06, 0.06, 121), np.linspace(-0.06, 0.06, 121)), -1).reshape(-1, 2)
    bump = lambda p: -0.02 - 0.008 * np.exp(-(p**2).sum(1) / 0.03**2)  # noqa: E731
    camera = look_at([0.0001, 0, -0.6], [0, 0, 0], focal=200, width=W, height=H, principal=(80, 60))
    moved = bent(mesh, [camera], [np.concatenate([x, bump(x)[:, None]], 1)], GROUND, near=0.02, blocked=1e-4, rounds=1)
    before, after = (np.abs(m.vertices[:, 2] - bump(m.vertices[:, :2])) for m in (mesh, moved))
    assert before.max() > 0.007 and after.max() < 0.001  # targets are 1 mm apart


def test_nothing_that_rays_go_through_stays():
    """A mesh twice as high as what was measured: its upper half is in front of the measured depth of three cameras."""
    true = stairs()
    cameras, masks, hidden, depths, clouds = filmed(true)
    seen = Seen.of(cameras, masks, hidden, depths, clouds, GROUND, 0.004)
    high = Mesh(true.vertices * [1, 1, 2], true.faces)
    hull, carved = filled(high, seen, np.zeros((0, 3)), surface=1024, attempts=10_000, spacing=0.005)
    low, _ = filled(true, seen, np.zeros((0, 3)), surface=1024, attempts=10_000, spacing=0.005)
    assert carved > 0.3 and hull.interior[:, 2].min() > -0.075 and abs(len(hull.interior) / len(low.interior) - 1) < 0.5
    for points in (hull.surface, hull.interior):
        cells = np.floor((points - high.vertices.min(0)) / 0.005).astype(int)
        assert len(np.unique(cells, axis=0)) == len(points)


def glb(vertices, faces):
    """Binary glTF 2.0: a header, a chunk of JSON and one of data, each padded to 4 bytes; open3d's own are not read by others."""
    data = vertices.astype("<f4").tobytes() + faces.astype("<u4").tobytes()
    split = 12 * len(vertices)
    views = [{"buffer": 0, "byteLength": split}, {"buffer": 0, "byteOffset": split, "byteLength": len(data) - split}]
    place = {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"}
    place |= {"min": vertices.min(0).tolist(), "max": vertices.max(0).tolist()}
    index = {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"}
    about = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(data)}], "bufferViews": views, "accessors": [place, index]}
    about |= {
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    text = json.dumps(about | {"scene": 0}).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb"])
def test_meshes_are_read_and_simplified(tmp_path, suffix):
    ball = o3d.geometry.TriangleMesh.create_sphere(2.0, resolution=60)
    ball.compute_triangle_normals()  # STL wants them
    file = tmp_path / f"ball{suffix}"
    if suffix == ".glb":
        file.write_bytes(glb(np.asarray(ball.vertices), np.asarray(ball.triangles)))
    else:
        assert o3d.io.write_triangle_mesh(str(file), ball)
    mesh = read_mesh(file, vertices=500)
    assert 400 < len(mesh.vertices) < 700 and mesh.faces.max() == len(mesh.vertices) - 1
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 2).max() < 0.05


def test_what_is_no_mesh_is_named(tmp_path):
    (tmp_path / "a.txt").write_text("x")
    (tmp_path / "b.ply").write_text("ply\n")
    for name, said in (("a.txt", "must be one of"), ("b.ply", "must be a mesh with faces"), ("c.ply", "c.ply")):
        with pytest.raises((ValueError, OSError), match=said):
            read_mesh(tmp_path / name)
        with pytest.raises((ValueError, OSError), match=said):
            BuildOptions(prior=str(tmp_path / name))
