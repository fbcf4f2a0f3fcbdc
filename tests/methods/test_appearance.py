"""Appearance: the renderer against closed forms and a per-pixel loop, skinning against rigid motions, the fit against the sample."""

import json
from dataclasses import replace
from math import atan2, degrees, exp, log

import numpy as np
import pytest
import torch
from twinbench.datasets.collection import open_collection
from twinbench.datasets.scenario import Camera
from twinbench.methods.appearance import Appearance, Gaussians
from twinbench.methods.appearance.config import AS_PUBLISHED, CORRECTED, PRESETS, Config
from twinbench.methods.appearance.fitting import camera_extent, fit_gaussians, starting_gaussians
from twinbench.methods.appearance.growing import Growing
from twinbench.methods.appearance.harmonics import CONSTANT, basis
from twinbench.methods.appearance.losses import ssim, view_loss
from twinbench.methods.appearance.render import draw, render
from twinbench.methods.appearance.skinning import Skinning, bone_rotations, quaternions, rotated
from twinbench.methods.appearance.splats import Viewpoint, project
from twinbench.methods.appearance.tiles import blend
from twinbench.methods.appearance.views import _widened, frame_zero, starting_points
from twinbench.methods.base import Trajectory
from twinbench.methods.threads import threads_for

# principal point off the centre, unequal focal lengths, skewed pixels, a turned and shifted pose
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
POSE = np.block([[TURN, np.array([[0.1], [-0.2], [0.3]])], [np.zeros((1, 3)), np.ones((1, 1))]])
CAMERA = Camera([[60.0, 1.5, 17.2], [0, 55.0, 9.6], [0, 0, 1]], POSE, 40, 24)
FIELDS = ("positions", "log_scales", "opacities", "harmonics")


def cloud(count=12, *, seed=0, degree=1, camera=CAMERA, opacity=(0.1, 0.95), size=0.03, dtype=torch.float64):
    """Gaussians before ``camera``, some partly outside its image."""
    rng = np.random.default_rng(seed)
    local = rng.uniform([-0.36, -0.24, 1], [0.36, 0.24, 1], (count, 3)) * rng.uniform(0.8, 1.3, (count, 1))
    positions = local @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3]
    scales = np.log(size * np.exp(0.4 * rng.normal(size=count)))
    values = (positions, scales, rng.uniform(*opacity, count), 0.4 * rng.normal(size=(count, (degree + 1) ** 2, 3)))
    return Gaussians(*(torch.tensor(v, dtype=dtype) for v in values))


def plain(positions, scales, opacities, colours, dtype=torch.float64):
    """Gaussians of one colour in all directions."""
    harmonics = (np.asarray(colours, float)[:, None] - 0.5) / CONSTANT
    return Gaussians(*(torch.tensor(np.asarray(v), dtype=dtype) for v in (positions, np.log(scales), opacities, harmonics)))


def per_pixel(gaussians, camera):
    """The same image by a loop over pixels and Gaussians; the projection's Jacobian by central differences of ``Camera.project``."""
    x, log_scales, opacities = (getattr(gaussians, n).numpy() for n in ("positions", "log_scales", "opacities"))
    rays = x - camera.camera_to_world[:3, 3]
    values = basis(torch.tensor(rays / np.linalg.norm(rays, axis=1, keepdims=True)), gaussians.degree).numpy()
    colours = np.maximum(np.einsum("gk,gkc->gc", values, gaussians.harmonics.numpy()) + 0.5, 0)
    centres, depths = camera.project(x)
    h = 1e-6
    jacobians = np.stack([(camera.project(x + h * e)[0] - camera.project(x - h * e)[0]) / (2 * h) for e in np.eye(3)], 2)
    inverse = np.linalg.inv(np.exp(2 * log_scales)[:, None, None] * jacobians @ jacobians.transpose(0, 2, 1) + 0.3 * np.eye(2))
    out = np.zeros((camera.height, camera.width, 5))
    for row in range(camera.height):
        for column in range(camera.width):
            light = 1.0
            for k in np.argsort(depths):
                apart = np.array([column, row]) - centres[k]
                alpha = min(opacities[k] * np.exp(-0.5 * apart @ inverse[k] @ apart), 0.999)
                if alpha < 1 / 255:
                    continue
                if light * (1 - alpha) <= 1e-4:
                    break
                out[row, column] += light * alpha * np.array([*colours[k], depths[k], 1])
                light *= 1 - alpha
    out[..., 3] /= np.maximum(out[..., 4], 1e-10)
    return out[..., [0, 1, 2, 4]], out[..., 3]


def test_one_gaussian_is_its_closed_form():
    # on the axis: alpha(r) = o exp(-r^2 / 2 v), v = (f sigma / z)^2 + 0.3; float64 rounding. Where alpha < 1/255 there is nothing
    f, z, sigma, opacity, colour = 80.0, 0.9, 0.02, 0.7, np.array([0.9, 0.4, 0.1])
    camera = Camera([[f, 0, 15], [0, f, 10], [0, 0, 1]], np.eye(4), 32, 20)
    image, depth = render(plain([[0, 0, z]], [sigma], [opacity], [colour]), camera, depth=True)
    row, column = np.mgrid[:20, :32]
    alpha = opacity * np.exp(-((row - 10) ** 2 + (column - 15) ** 2) / (2 * ((f * sigma / z) ** 2 + 0.3)))
    alpha[alpha < 1 / 255] = 0
    assert np.abs(image[..., 3].numpy() - alpha).max() < 1e-12
    assert np.abs(image[..., :3].numpy() - alpha[..., None] * colour).max() < 1e-12
    assert np.abs(depth.numpy() - np.where(alpha > 0, z, 0)).max() < 1e-12


def test_as_published_all_is_drawn_half_a_pixel_off():
    # published: pixel (row, column) is at (column + 0.5, row + 0.5), while cameras have pixel centres at integers. A Gaussian at u, v
    # between pixels: alpha = o exp(-d V^-1 d / 2) with d = (column + 0.5 - u, row + 0.5 - v)
    f, z, sigma, opacity, (x, y) = 80.0, 0.9, 0.02, 0.7, (0.0123, -0.0071)
    camera = Camera([[f, 0, 15.2], [0, f, 10.4], [0, 0, 1]], np.eye(4), 32, 20)
    u, v = f * x / z + 15.2, f * y / z + 10.4
    row, column = np.mgrid[:20, :32]
    a, b = x / z, y / z
    # perspective makes the circle a slightly slanted ellipse: covariance (f sigma / z)^2 [[1 + a^2, a b], [a b, 1 + b^2]] + 0.3
    covariance = (f * sigma / z) ** 2 * np.array([[1 + a * a, a * b], [a * b, 1 + b * b]]) + 0.3 * np.eye(2)
    for half_pixel, offset in ((True, 0.5), (False, 0.0)):
        apart = np.stack([column + offset - u, row + offset - v], -1)
        alpha = opacity * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", apart, np.linalg.inv(covariance), apart))
        alpha[alpha < 1 / 255] = 0
        image = render(plain([[x, y, z]], [sigma], [opacity], [[1, 1, 1]]), camera, half_pixel=half_pixel)
        assert np.abs(image[..., 3].numpy() - alpha).max() < 1e-12, half_pixel


def test_the_quirk_reaches_the_fit_and_the_pictures(sample, monkeypatch):
    seen = []
    for module in ("fitting.draw", "render.draw"):
        real = draw
        spy = lambda *a, real=real, **k: seen.append(k["half_pixel"]) or real(*a, **k)  # noqa: E731
        monkeypatch.setattr(f"twinbench.methods.appearance.{module}", spy)
    monkeypatch.setitem(PRESETS, "quick", replace(PRESETS["quick"], iterations=2))
    for quirks in (AS_PUBLISHED, CORRECTED):
        made = Appearance.fit(sample.initial(), quirks=quirks)
        made.animate(Trajectory(np.float32(sample.structure)[None], sample.counts)).image(sample.cameras[0], 0)
    assert seen == [True] * 3 + [False] * 3


@pytest.mark.parametrize("opacity", [(0.1, 0.9), (0.9, 1.0)])
def test_any_gaussians_against_a_loop_over_pixels(opacity):
    # 1e-6: central differences of the projection; opaque ones reach the cap on alpha and the stop at a transmittance of 1e-4
    gaussians = cloud(40, degree=3, opacity=opacity, size=0.06)
    image, depth = render(gaussians, CAMERA, depth=True)
    expected, expected_depth = per_pixel(gaussians, CAMERA)
    assert np.abs(image.numpy() - expected).max() < 1e-6
    assert np.abs(depth.numpy() - expected_depth).max() < 1e-6
    assert (expected[..., 3] > 0.5).mean() > 0.3
    if opacity[0] > 0.5:
        assert expected[..., 3].max() > 0.999


def test_the_nearer_covers_the_farther_in_any_order():
    # at their common centre: C = a1 c1 + (1 - a1) a2 c2
    camera = Camera([[50, 0, 8], [0, 50, 8], [0, 0, 1]], np.eye(4), 17, 17)
    both = plain([[0, 0, 1.2], [0, 0, 1.0]], [0.03, 0.03], [0.6, 0.25], [[0, 1, 0], [1, 0, 0]])
    image = render(both, camera)
    assert np.abs(image[8, 8].numpy() - [0.25, 0.75 * 0.6, 0, 1 - 0.75 * 0.4]).max() < 1e-12
    assert torch.equal(image, render(both[torch.tensor([1, 0])], camera))
    many = cloud(60)
    assert torch.equal(render(many, CAMERA), render(many[torch.randperm(60, generator=torch.Generator().manual_seed(1))], CAMERA))


def test_alpha_is_one_minus_what_all_let_through():
    # 1 - prod(1 - a_i), each a_i from an image of that Gaussian alone
    many = cloud(15, opacity=(0.1, 0.5))
    alone = torch.stack([render(many[torch.tensor([k])], CAMERA)[..., 3] for k in range(15)])
    assert (render(many, CAMERA)[..., 3] - (1 - (1 - alone).prod(0))).abs().max() < 1e-12


def test_background_shows_where_nothing_is():
    many = cloud(8)
    black, red = render(many, CAMERA), render(many, CAMERA, background=(1.0, 0, 0))
    assert (red[..., 0] - (black[..., 0] + 1 - black[..., 3])).abs().max() < 1e-15
    assert torch.equal(red[..., 1:], black[..., 1:])


def test_far_beside_the_image_a_splat_is_as_slanted_as_at_the_margin():
    # beyond 0.15 of the image's width past its edge (column 39.5 + 6) the covariance stays: (f sigma / z)^2 (1 + u^2) + 0.3
    camera = Camera([[60.0, 0, 17.2], [0, 55.0, 9.6], [0, 0, 1]], np.eye(4), 40, 24)
    positions = torch.tensor([[3.0, 0, 1]], dtype=torch.float64)
    xx, xy, yy = project(positions, torch.log(positions[:, 2] / 100), Viewpoint.of(camera, positions)).covariances[0].tolist()
    u = (45.5 - 17.2) / 60
    assert (xx, xy, yy) == pytest.approx((0.36 * (1 + u * u) + 0.3, 0, 0.3025 + 0.3), abs=1e-12)


@pytest.mark.long
def test_gradients_against_central_differences():
    # (L(u + h) - L(u - h)) / 2h in float64, every entry: truncation h^2 and rounding 1e-16 / h lie below 1e-6 of the largest. Pairs on
    # the edge of alpha = 1/255 would jump within h; none of them do for this seed
    weights = torch.tensor(np.random.default_rng(3).normal(size=(CAMERA.height, CAMERA.width, 5)))
    values = [getattr(cloud(7, degree=2), n).requires_grad_() for n in FIELDS]

    def loss(*values):
        image, depth = render(Gaussians(*values), CAMERA, depth=True)
        return (image * weights[..., :4]).sum() + (depth * weights[..., 4]).sum()

    h = 1e-7
    for name, value, grad in zip(FIELDS, values, torch.autograd.grad(loss(*values), values), strict=True):
        with torch.no_grad():
            flat, expected = value.view(-1), torch.zeros(value.numel(), dtype=torch.float64)
            for k in range(len(flat)):
                old, sides = flat[k].item(), []
                for new in (old + h, old - h):
                    flat[k] = new
                    sides.append(loss(*values))
                flat[k] = old
                expected[k] = (sides[0] - sides[1]) / (2 * h)
        assert (grad.view(-1) - expected).abs().max() < 1e-6 * grad.abs().max(), name


def test_halved_images_are_the_same_to_value_and_gradient():
    # the same pairs in smaller lists: sums of logarithms start anew, so float64 rounding
    results = []
    for pairs in (1 << 23, 50):
        g = Gaussians(*(getattr(cloud(30), n).requires_grad_() for n in FIELDS))
        splats = project(g.positions, g.log_scales, Viewpoint.of(CAMERA, g.positions))
        image = blend(splats, g.opacities, g.harmonics[:, 0], CAMERA.height, CAMERA.width, pairs=pairs)
        image.square().sum().backward()
        with torch.no_grad():
            again = blend(splats, g.opacities, g.harmonics[:, 0], CAMERA.height, CAMERA.width, pairs=pairs)
        assert torch.equal(image, again)
        results.append((image.detach(), *(getattr(g, n).grad for n in FIELDS)))
    for whole, halved in zip(*results, strict=True):
        assert (whole - halved).abs().max() < 1e-11 * whole.abs().max()


def test_no_gaussian_stops_all_light():
    # however opaque and wide, one lets 0.1 % through, so that what is behind it can still be fitted
    camera = Camera([[80, 0, 15], [0, 80, 10], [0, 0, 1]], np.eye(4), 32, 20)
    assert render(plain([[0, 0, 1]], [0.1], [1.0], [[1, 1, 1]]), camera)[10, 15, 3].item() == pytest.approx(0.999, abs=1e-12)


def test_nothing_before_the_camera_is_a_blank_image():
    behind = plain([POSE[:3, 3] - 0.5 * TURN[:, 2]], [0.1], [0.9], [[1, 1, 1]])
    for gaussians in (behind, behind[torch.tensor([], dtype=torch.long)]):
        image, depth = render(gaussians, CAMERA, depth=True)
        assert image.shape == (24, 40, 4) and not image.any() and not depth.any()


def test_harmonics_are_those_of_scipy():
    from scipy.special import sph_harm_y

    directions = np.random.default_rng(0).normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    theta, phi = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    expected = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(m), theta, phi)
            expected.append(value.real if m == 0 else np.sqrt(2) * (value.imag if m < 0 else value.real))
    assert np.abs(basis(torch.tensor(directions), 3).numpy() - np.stack(expected, 1)).max() < 1e-12


def rotation(seed=0, angle=None):
    """A rotation matrix about a random axis (Rodrigues)."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = rng.uniform(0.5, 2.5) if angle is None else angle
    k = np.cross(np.eye(3), -axis)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


@pytest.mark.parametrize("flat", [1.0, 0.0], ids=["body", "sheet"])
@pytest.mark.parametrize("quirks", [CORRECTED, replace(AS_PUBLISHED, unaligned_quaternions=False)], ids=["corrected", "incremental"])
def test_a_rigid_motion_moves_points_rigidly(quirks, flat):
    # x -> R x + t of all bones is R x + t of every point, exactly: float64 rounding. In a flat sheet neighbours fix a rotation up to a
    # mirroring only
    rng = np.random.default_rng(1)
    bones, points = rng.uniform(0, 0.2, (80, 3)) * [1, 1, flat], rng.uniform(-0.05, 0.25, (30, 3))
    turns, shifts = [np.eye(3), rotation(2), rotation(3)], [np.zeros(3), np.array([0.1, 0, 0.3]), np.array([0, 2.0, 0])]
    skinning = Skinning([bones @ r.T + t for r, t in zip(turns, shifts, strict=True)], points, quirks=quirks)
    for frame in (2, 0, 1):
        pose = skinning.pose(frame)
        assert np.abs(pose.positions.numpy() - (points @ turns[frame].T + shifts[frame])).max() < 1e-12
        turned = rotated(pose.rotations, torch.tensor(points))
        assert np.abs(turned.numpy() - points @ turns[frame].T).max() < 1e-12


def test_a_bone_without_a_rotation_of_its_own_does_not_disturb_others():
    # bones 0 to 16 lie in one point, but for a micrometre, and 17 to 33 on a line, far from the block of bones 34 to 113 that turns by R
    rng = np.random.default_rng(4)
    block, line = rng.uniform(0, 0.2, (80, 3)), np.outer(np.linspace(0, 0.3, 17), [1.0, 0, 0])
    bones = np.concatenate([5 + 1e-6 * rng.normal(size=(17, 3)), line + 9.0, block])
    turn = rotation(5)
    now = bones @ turn.T
    skinning = Skinning([bones, now], block)
    turns = bone_rotations(*skinning.bones, skinning.neighbours)
    assert torch.equal(turns[:17], torch.eye(3, dtype=torch.float64).repeat(17, 1, 1))
    assert (turns[34:] - torch.tensor(turn)).abs().max() < 1e-9
    assert np.abs(skinning.pose(1).positions.numpy() - block @ turn.T).max() < 1e-9
    # on the line: the smallest rotation that takes it to where it is; its axis is across both directions, and it is a rotation
    x = torch.tensor(turn[:, 0])
    for r in turns[17:34]:
        assert (r[:, 0] - x).abs().max() < 1e-9
        assert (r @ r.T - torch.eye(3, dtype=torch.float64)).abs().max() < 1e-9
        assert abs(float(r.trace()) - (1 + 2 * float(x[0]))) < 1e-9  # trace R = 1 + 2 cos(angle)
    published = bone_rotations(*skinning.bones, skinning.neighbours, replace(CORRECTED, shared_rank=True))
    assert torch.equal(published, torch.eye(3, dtype=torch.float64).repeat(114, 1, 1))


def test_as_published_a_single_bone_on_a_line_lends_its_rotation():
    rng = np.random.default_rng(8)
    bones = torch.tensor(np.concatenate([np.outer(np.arange(5), [0, 0.1, 0]), rng.uniform(1, 2, (20, 3))]))
    turn = torch.tensor(rotation(9))
    neighbours = torch.tensor([[1, 2, 3, 4]] + [[5, 6, 7, 8]] * 4 + [[(5 + (k + j) % 20) for j in range(1, 5)] for k in range(20)])
    alone, lent = (bone_rotations(bones, bones @ turn.T, neighbours, replace(CORRECTED, shared_rank=shared)) for shared in (False, True))
    assert (lent - alone[0]).abs().max() == 0 and (alone[5:] - turn).abs().max() < 1e-9 and (alone[0] - turn).abs().max() > 0.01


@pytest.mark.parametrize("width, falls", [(3e-2, ()), (3e-3, ("float32_rank",)), (1e-4, ("float32_rank", "corrected"))])
def test_the_width_up_to_which_neighbours_lie_on_a_line(width, falls):
    # Second over first singular value of sum e' e^T is the square of width over length, here 9e-4, 9e-6 and 1e-8: float32's default
    # (numpy's and torch's matrix_rank: eps times the larger side) loses the rank below 3.6e-7. A turn about the line tells: a bone that
    # has its rank follows it, the smallest rotation of a line does not.
    along = np.linspace(-1, 1, 9)[:, None]
    bones = torch.tensor(along * [0, 0, 1] + width * np.array([[1, 0, 0], [0, 0.9, 0]])[np.arange(9) % 2])
    turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=torch.float64)
    neighbours = torch.arange(9).repeat(9, 1)
    e, now = bones - bones[4], (bones - bones[4]) @ turn.T
    rank = int(torch.linalg.matrix_rank((now.T @ e).float()))
    assert (rank == 1) == (width == 1e-4)
    published = bone_rotations(bones, bones @ turn.T, neighbours, replace(CORRECTED, float32_rank=True))[4]
    corrected = bone_rotations(bones, bones @ turn.T, neighbours)[4]
    assert torch.allclose(published, turn, atol=1e-3) == (rank > 1)
    assert torch.allclose(corrected, turn, atol=1e-3) == (width > 1e-2)


def test_neighbours_within_a_tenth_of_a_millimetre_turn_as_published():
    bones = torch.tensor(1e-6 * np.random.default_rng(3).normal(size=(6, 3)))
    turn = torch.tensor(rotation(2))
    neighbours = torch.tensor([[j for j in range(6) if j != k] for k in range(6)])
    published = bone_rotations(bones, bones @ turn.T, neighbours, replace(CORRECTED, float32_rank=True))
    assert (published - turn).abs().max() < 1e-6
    assert torch.equal(bone_rotations(bones, bones @ turn.T, neighbours), torch.eye(3, dtype=torch.float64).repeat(6, 1, 1))


@pytest.mark.parametrize("seed", range(6))
def test_as_published_a_line_turns_as_the_x_axis_would(seed):
    # R = [l p l x p] [x p x x p]^T with p = x x l / |x x l| and l the left singular vector; all bones get the only one of rank 1
    rng = np.random.default_rng(seed)
    line = rng.normal(size=3)
    old = np.concatenate([np.outer(np.arange(5), line), rng.uniform(9, 10, (20, 3))]).astype(np.float32)
    new = (old @ rotation(seed).T).astype(np.float32)
    neighbours = torch.tensor([[1, 2, 3, 4]] + [[5, 6, 7, 8]] * 4 + [[(5 + (k + j) % 20) for j in range(1, 5)] for k in range(20)])
    now, before = new[1:5] - new[0], old[1:5] - old[0]
    left = np.linalg.svd(now.T @ before)[0][:, 0].astype(float)
    x = np.array([1.0, 0, 0])
    p = np.cross(x, left) / np.linalg.norm(np.cross(x, left))
    expected = np.stack([left, p, np.cross(left, p)], 1) @ np.stack([x, p, np.cross(x, p)], 1).T
    found = bone_rotations(torch.tensor(old).double(), torch.tensor(new).double(), neighbours, AS_PUBLISHED)
    np.testing.assert_allclose(found.numpy(), np.broadcast_to(expected, (25, 3, 3)), atol=2e-5)  # float32 positions of order 10


def test_as_published_a_line_on_the_x_axis_does_not_turn():
    line = torch.tensor(np.outer(np.arange(5.0), [0, 0, 1]))
    to_x = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=torch.float64)
    neighbours = torch.arange(5).repeat(5, 1)
    turns = bone_rotations(line, line @ to_x.T, neighbours, replace(CORRECTED, lines_from_x=True))
    assert torch.equal(turns, torch.eye(3, dtype=torch.float64).repeat(5, 1, 1))


def test_rotations_are_averaged_with_one_sign():
    # two blocks turn by -89 and -91 degrees about x: as quaternions (w, x) near (0.7, -0.7) and (-0.7, 0.7), which cancel unless aligned;
    # a point halfway between them turns by an angle between
    rng = np.random.default_rng(10)
    block = 0.05 * rng.uniform(-1, 1, (17, 3))
    turns = [np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]]) for a in np.radians([-89, -91])]
    shift = np.array([0.1, 0, 0])
    bones = np.concatenate([block - shift, -block + shift])
    now = np.concatenate([block @ turns[0].T - shift, -block @ turns[1].T + shift])
    aligned, unaligned = (
        Skinning([bones, now], np.zeros((1, 3)), quirks=replace(CORRECTED, unaligned_quaternions=quirk)).pose(1).rotations[0]
        for quirk in (False, True)
    )
    assert -91 < degrees(2 * atan2(aligned[1], aligned[0])) < -89
    assert not torch.allclose(aligned, unaligned, atol=0.1) and not torch.allclose(aligned, -unaligned, atol=0.1)


def test_a_line_turned_about_is_half_a_turn():
    line = torch.tensor(np.outer(np.arange(20.0), [0.6, 0.8, 0]))
    turns = Skinning([line, -line], line[:1]).neighbours
    turns = bone_rotations(line, -line, turns)
    assert torch.allclose(torch.einsum("mij,j->mi", turns, line[1]), -line[1].expand(20, 3), atol=1e-12)
    assert torch.allclose(torch.det(turns), torch.ones(20, dtype=torch.float64))


def test_a_lone_bone_only_shifts():
    skinning = Skinning(np.array([[[0, 0, 0]], [[1, 2, 3.0]]]), [[0.5, 0, 0]])
    assert torch.equal(skinning.pose(1).positions, torch.tensor([[1.5, 2, 3]], dtype=torch.float64))


def test_quaternions_turn_as_their_matrices():
    matrices = [rotation(k) for k in range(20)] + [rotation(k, np.pi) for k in range(20)] + [np.diag(s) for s in ((1, -1, -1), (-1, -1, 1))]
    vectors = torch.tensor(np.random.default_rng(0).normal(size=(42, 3)))
    matrices = torch.tensor(np.array(matrices, float))
    assert (rotated(quaternions(matrices), vectors) - torch.einsum("gij,gj->gi", matrices, vectors)).abs().max() < 1e-12


def test_directly_from_frame_zero_nothing_adds_up():
    # bones that shake and come back to where they were: so does a point in the corrected mode, to rounding; step by step it does not
    rng = np.random.default_rng(6)
    bones, points = rng.uniform(0, 0.2, (60, 3)), rng.uniform(0, 0.2, (20, 3))
    shaken = np.stack([bones, *(bones + 0.02 * rng.normal(size=(8, 60, 3))), bones])
    away = {name: Skinning(shaken, points, quirks=q).pose(9).positions.numpy() - points for name, q in
            (("direct", CORRECTED), ("steps", replace(CORRECTED, incremental=True)))}  # fmt: skip
    assert np.abs(away["direct"]).max() < 1e-12
    assert np.abs(away["steps"]).max() > 1e-3


def test_bones_that_are_not_finite_are_refused_with_their_frame():
    bones = np.zeros((4, 5, 3))
    bones[2, 1] = np.nan
    with pytest.raises(ValueError, match="not in frame 2"):
        Skinning(bones, np.zeros((1, 3)))


def test_ssim_is_that_of_scikit_image():
    # its borders are mirrored and ours are zero, so the images are zero near theirs: both then see the same
    from skimage.metrics import structural_similarity

    rng = np.random.default_rng(0)
    a, b = (np.pad(rng.uniform(size=(20, 24, 3)), ((12, 12), (12, 12), (0, 0))) for _ in range(2))
    b = 0.7 * a + 0.3 * b
    settings = dict(gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1.0, channel_axis=2, full=True)
    expected = structural_similarity(a, b, **settings)[1].mean()
    assert abs(float(ssim(torch.tensor(a), torch.tensor(b))) - expected) < 1e-7
    assert float(ssim(torch.tensor(a), torch.tensor(a))) == pytest.approx(1, abs=1e-12)


def seen_block():
    """A view with a red block, part of it under a hand, and its perfect prediction."""
    mask, human = np.zeros((30, 30), bool), np.zeros((30, 30), bool)
    mask[8:22, 8:22], human[18:26, 5:12] = True, True
    color = mask[..., None] * np.array([0.8, 0.2, 0.1])
    seen = {"color": torch.tensor(color), "mask": torch.tensor(mask), "human": torch.tensor(human), "depth": torch.tensor(0.7 * mask)}
    return seen, [seen["color"].clone(), seen["mask"].double()[..., None], seen["depth"].clone()]


def test_the_loss_of_a_perfect_image_is_zero_unless_as_published():
    seen, drawn = seen_block()
    assert float(view_loss(*drawn, seen, Config(), CORRECTED)) == pytest.approx(0, abs=1e-12)
    assert float(view_loss(*drawn, seen, Config(), AS_PUBLISHED)) > 1e-3  # the prediction is blanked under the hand, what is seen is not


def test_pixels_without_depth_count_only_as_published():
    # 16 of 900 pixels of the object have no depth: 1e-3 x 0.7 m x 16 / 900 where that counts as 0 m
    seen, drawn = seen_block()
    seen["depth"][9:13, 14:18] = 0
    assert float(view_loss(*drawn, seen, Config(), CORRECTED)) == pytest.approx(0, abs=1e-12)
    everywhere = float(view_loss(*drawn, seen, Config(), replace(CORRECTED, depth_everywhere=True)))
    seen["depth"] = drawn[2].clone()
    assert everywhere - float(view_loss(*drawn, seen, Config(), replace(CORRECTED, depth_everywhere=True))) == pytest.approx(
        1e-3 * 0.7 * 16 / 900, rel=1e-6
    )


def test_the_structure_of_the_silhouette_counts_unless_as_published():
    # colours as seen, alpha blank: 0.8 mean |mask| alone as published, and more where alpha's SSIM is in it
    seen, (colour, alpha, depth) = seen_block()
    free = (seen["mask"] & ~seen["human"]).double()
    blank = torch.zeros_like(alpha)
    assert float(view_loss(colour, blank, depth, seen, Config(), replace(CORRECTED, colour_silhouette=True))) == pytest.approx(
        0.8 * float(free.mean()), rel=1e-9
    )
    with_structure = 0.8 * free.mean() + 0.2 * (1 - ssim(blank, free[..., None]))
    assert float(view_loss(colour, blank, depth, seen, Config(), CORRECTED)) == pytest.approx(float(with_structure), rel=1e-9)


def test_the_human_region_is_widened_by_a_share_of_the_image(sample):
    # 8 of 848 pixels are 1.5 of 160, rounded 2; as published 8 whatever the width: 1 and 7 more columns and rows than the region spans
    raw = sample.images.human_mask(0, 0)
    scaled, fixed = (frame_zero(sample.observed(), PRESETS["quick"], quirks)[0].human for quirks in (CORRECTED, AS_PUBLISHED))
    for widened, more in ((scaled, 1), (fixed, 7)):
        assert widened.any(0).sum() == raw.any(0).sum() + more and (widened | ~raw).all()


def test_what_is_under_the_hand_gives_no_gradient():
    seen, drawn = seen_block()
    drawn = [(d + 0.1).requires_grad_() for d in drawn]
    view_loss(*drawn, seen, Config(), CORRECTED).backward()
    for d in drawn:
        assert not d.grad[seen["human"]].any()
    # depth 0.1 m off on the free pixels of the object, 1e-3 / m, mean over 900 pixels; gradient 1e-3 / 900 each
    free = seen["mask"] & ~seen["human"]
    assert torch.allclose(drawn[2].grad, free.double() * (1e-3 / 900), atol=1e-18)


def test_gaussians_start_as_wide_as_their_neighbours_are_far():
    # a row of points 1 cm apart: the inner ones have neighbours at 1, 1 and 2 cm, mean square 2 cm^2
    start = starting_gaussians(np.outer(np.arange(7) / 100, [1, 0, 0]), np.full((7, 3), [0.2, 0.5, 0.9]), Config())
    assert start.log_scales[3].item() == pytest.approx(log(np.sqrt(2e-4)), abs=1e-6)
    assert start.degree == 3 and start.opacities.unique().tolist() == [pytest.approx(0.1)]
    assert np.allclose(CONSTANT * start.harmonics[:, 0] + 0.5, [0.2, 0.5, 0.9], atol=1e-6)


def test_one_camera_has_an_extent_too():
    at = [Camera(CAMERA.intrinsics, np.block([[np.eye(3), np.array(c)[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]), 40, 24)
          for c in ([0, 0, 0], [2.0, 0, 0])]  # fmt: skip
    assert camera_extent(at, [[0, 0, 3]]) == pytest.approx(1.1)
    assert camera_extent(at[:1], [[0, 0, 3], [0, 0, 5]]) == pytest.approx(1.1 * 4)


def test_densify_clones_splits_and_prunes():
    # 0 small and pulled at: cloned; 1 large and pulled at: split in two 1.6 times smaller; 2 faint: removed; 3 untouched
    start = plain(np.eye(4, 3), [0.001, 0.1, 0.001, 0.001], [0.5, 0.5, 0.001, 0.5], np.full((4, 3), 0.5), torch.float32)
    start = replace(start, harmonics=torch.cat([start.harmonics, torch.zeros(4, 3, 3)], 1))
    growing = Growing(start, 1.0, Config(degree=1), torch.Generator().manual_seed(0))
    centres = torch.zeros(4, 2, requires_grad=True)
    centres.grad = torch.tensor([[1e-4, 0], [0, 1e-4], [0, 0], [1e-7, 0]])  # times half of 100 px: 5e-3 against 2e-4
    (growing["positions"].sum() + growing["logits"].sum()).backward()
    growing.step(1, centres, 100, 100)
    growing.densify()
    assert len(growing) == 5
    sizes = growing["log_scales"].detach().exp()
    assert sizes.tolist() == pytest.approx([0.001, 0.001, 0.001, 0.1 / 1.6, 0.1 / 1.6], rel=1e-5)
    remembered = growing.adam.state[growing["positions"]]["exp_avg"].abs().sum(1) > 0
    assert remembered.tolist() == [True, True, False, False, False]  # the old 0 and 3; what is new has no past
    growing.reset_opacities()
    assert torch.sigmoid(growing["logits"]).max().item() == pytest.approx(0.01, rel=1e-4)
    centres = torch.zeros(5, 2)
    (growing["positions"].sum() + growing["logits"].sum()).backward()
    growing.step(2, centres, 100, 100)  # and it still can be stepped


@pytest.fixture(scope="module")
def sample():
    return open_collection("sample").scenarios["plush_drag"]()


@pytest.fixture(scope="module")
def fitted(sample):
    """By the schedule of the preset in a third of its steps: what is asked of it below is asked of a shorter fit."""
    shorter = dict(iterations=200, degree_every=33, densify_from=33, densify_every=33, positions_span=200, prune_size_from=60)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "quick", replace(PRESETS["quick"], **shorter))
        return Appearance.fit(sample.observed(), cameras=(1, 2))


def psnr(a, b):
    return -10 * np.log10(((a - b) ** 2).mean())


def views_of(sample):
    return frame_zero(sample.observed(), PRESETS["quick"], CORRECTED)


@pytest.mark.parametrize("camera", [1, 2])
def test_the_fit_looks_like_the_views_it_saw(sample, fitted, camera):
    # outside the human region, against the true silhouette filled with the object's mean colour: what no colour but shape would give.
    # 34 dB there; a fit must be 4 dB better (some 6 dB are reached, 15 by the whole preset) and 38 dB at least
    view = views_of(sample)[camera]
    free = ~view.human
    flat = view.mask[..., None] * view.color[view.mask].mean(axis=0)
    drawn = render(fitted.gaussians, view.camera)[..., :3].numpy()
    reached = psnr(drawn[free], view.color[free])
    assert reached > 38
    assert reached > psnr(flat[free], view.color[free]) + 4


def test_the_fit_looks_right_from_a_camera_that_it_did_not_see(sample, fitted):
    # against the one colour that is closest to the whole image: 5 dB are asked, some 10 dB are reached
    view = views_of(sample)[0]
    free = ~view.human
    drawn = render(fitted.gaussians, view.camera)[..., :3].numpy()
    assert psnr(drawn[free], view.color[free]) > psnr(view.color[free].mean(axis=0), view.color[free]) + 5


def test_large_gaussians_are_pruned_as_published():
    # published, after step 3000: those with opacity < 0.005 or a standard deviation > 0.1 of the extent go. The extent here is 2 m
    opacities, scales = np.array([0.5, 0.004, 0.5, 0.5, 0.004, 0.9]), np.array([0.01, 0.01, 0.19, 0.21, 0.5, 0.3])
    start = plain(np.arange(18.0).reshape(6, 3), scales, opacities, np.full((6, 3), 0.5), torch.float32)
    for prune_large, gone in ((True, (opacities < 0.005) | (scales > 0.1 * 2.0)), (False, opacities < 0.005)):
        growing = Growing(start, 2.0, Config(), torch.Generator())
        growing.densify(prune_large=prune_large)
        np.testing.assert_allclose(growing.gaussians(0).positions.detach().numpy(), start.positions[~torch.tensor(gone)].numpy())


def test_a_gaussian_that_is_split_is_pruned_by_what_it_has_become():
    # 0.3 m of an extent of 2 m is split into two of 0.3 / 1.6 = 0.1875 m, which are below 0.2 m and stay
    growing = Growing(plain([[0, 0, 1]], [0.3], [0.5], [[0.5] * 3], torch.float32), 2.0, Config(), torch.Generator())
    growing._pull, growing._seen = torch.tensor([1.0]), torch.tensor([1.0])
    growing.densify(prune_large=True)
    np.testing.assert_allclose(growing["log_scales"].detach().exp().numpy(), [0.1875, 0.1875], rtol=1e-6)


def test_large_gaussians_are_pruned_only_as_published_and_not_before_step_3000(sample, monkeypatch):
    assert (Config().prune_size, Config().prune_size_from) == (0.1, 3000)
    asked, config = [], replace(PRESETS["quick"], iterations=8, densify_from=1, densify_every=2, prune_size_from=4)
    monkeypatch.setattr(Growing, "densify", lambda self, *, prune_large: asked.append(prune_large))
    views = frame_zero(sample.observed(), config, CORRECTED)
    for quirks, expected in ((AS_PUBLISHED, [False, False, True]), (CORRECTED, [False] * 3)):
        asked.clear()
        fit_gaussians(views, *starting_points(sample.observed(), views), config, quirks)
        assert asked == expected  # after steps 2, 4 and 6


@pytest.mark.parametrize("pixels", [1, 2, 7, 8])
def test_the_human_region_is_widened_as_opencv_does(pixels):
    # published: a dilation by 8 x 8 pixels, whose anchor OpenCV sets at pixel 8 // 2; row by row: p is on where [p - 4, p + 3] holds one
    cv2 = pytest.importorskip("cv2")
    mask = np.random.default_rng(0).random((30, 40)) > 0.99
    expected = cv2.dilate(mask.astype(np.uint8), np.ones((pixels, pixels), np.uint8)).astype(bool)
    before, after = pixels // 2, pixels - pixels // 2
    padded = np.pad(mask, ((before, after), (before, after)))
    by_hand = [[padded[r : r + pixels, c : c + pixels].any() for c in range(40)] for r in range(30)]
    assert np.array_equal(by_hand, expected) and np.array_equal(_widened(mask, pixels), expected)


def test_a_seed_repeats_and_another_does_not(sample):
    config = replace(PRESETS["quick"], iterations=24, densify_from=5, densify_every=10, degree_every=5, reset_every=15)
    views = frame_zero(sample.observed(), config, CORRECTED)
    start = starting_points(sample.observed(), views)
    a, b, c = (fit_gaussians(views, *start, config, CORRECTED, seed=seed) for seed in (1, 1, 2))
    for name in FIELDS:
        assert torch.equal(getattr(a, name), getattr(b, name)), name
    assert len(a) > len(start[0]) and (len(a) != len(c) or not torch.equal(a.positions, c.positions))


def test_small_images_take_one_thread_and_give_the_others_back():
    before = torch.get_num_threads()
    for pixels, within in ((54 * 40, 1), (848 * 480, before)):
        with pytest.raises(KeyError), threads_for(pixels):
            assert torch.get_num_threads() == within
            raise KeyError
        assert torch.get_num_threads() == before


def test_starting_points_project_into_the_masks(sample):
    # a lifted pixel projects back onto its own centre
    views = views_of(sample)
    points, colours = starting_points(replace(sample.observed(), surface=np.zeros((0, 3))), views)
    count = (views[0].mask & (views[0].depth > 0)).sum()
    pixels, depth = views[0].camera.project(points[:count])
    row, column = np.nonzero(views[0].mask & (views[0].depth > 0))
    assert np.abs(pixels - np.stack([column, row], 1)).max() < 1e-9
    assert np.abs(depth - views[0].depth[row, column]).max() < 1e-9
    assert np.array_equal(colours[:count], views[0].color[row, column])
    more = starting_points(sample.observed(), views)[0]
    assert np.array_equal(more[len(points) :], sample.surface)


def test_a_saved_appearance_draws_the_same(sample, fitted, tmp_path):
    fitted.save(tmp_path)
    again = Appearance.load(tmp_path)
    assert again.quirks == fitted.quirks and again.device == fitted.device and Appearance.load(tmp_path, device="cuda").device == "cuda"
    still = Trajectory(np.float32(sample.structure)[None].repeat(2, 0), sample.counts)
    image = fitted.animate(still).image(sample.cameras[0], 1)
    assert np.array_equal(image, again.animate(still).image(sample.cameras[0], 1))
    assert image.shape == (120, 160, 4) and image.dtype == np.float32 and image.min() >= 0 and 0.9 < image[..., 3].max() <= 1
    about = json.loads((tmp_path / "appearance.json").read_text())
    del about["quirks"]["half_pixel"]  # saved before there was such a switch
    (tmp_path / "appearance.json").write_text(json.dumps(about))
    assert Appearance.load(tmp_path).quirks == CORRECTED == fitted.quirks
    for file in ("gaussians.npz", "appearance.json"):
        (tmp_path / file).write_bytes(b"damaged")
        with pytest.raises(ValueError, match=file):
            Appearance.load(tmp_path)


def test_a_camera_that_moves_with_the_body_sees_no_change(sample, fitted):
    # frame 1 is R x + t of frame 0 and so is the camera: the same image where harmonics turn, to float32 rounding. A faint splat may
    # cross alpha = 1/255, which changes a pixel by less than that
    turn, shift = rotation(7), np.array([0.3, -0.1, 0.2])
    frames = np.stack([sample.structure, sample.structure @ turn.T + shift])
    animated = fitted.animate(Trajectory(frames.astype(np.float32), sample.counts), turn_harmonics=True)
    camera = sample.cameras[1]
    motion = np.block([[turn, shift[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    moved = Camera(camera.intrinsics, motion @ camera.camera_to_world, camera.width, camera.height)
    before, after = animated.image(camera, 0), animated.image(moved, 1)
    assert np.abs(before - after).max() < 1 / 255 and np.abs(before - after).mean() < 1e-5
    assert np.abs(before - animated.image(camera, 1)).max() > 0.5
    with pytest.raises(IndexError, match="frames 0 to 1"):
        animated.image(camera, 2)


def test_faint_gaussians_do_not_move_with_the_body(sample, fitted):
    # published: those of opacity <= 0.1 are left out of the animation
    still = Trajectory(np.float32(sample.structure)[None], sample.counts)
    kept = fitted.animate(still).gaussians(0)
    assert len(kept) == int((fitted.gaussians.opacities > 0.1).sum()) and float(kept.opacities.min()) > 0.1


def test_recordings_that_cannot_be_fitted_are_refused_with_the_reason(sample):
    observed = sample.observed()
    for wrong, message in (
        (replace(observed, images=None), "has none .scenario plush_drag"),
        (replace(observed, cameras=()), "calibrated cameras"),
        (replace(observed, images=Blank(observed.images)), "no mask of frame 0"),
        (replace(observed, cameras=[replace(c, width=50) for c in observed.cameras]), "color of camera 0 must have shape .120, 50, 3. as"),
    ):
        with pytest.raises(ValueError, match=message):
            Appearance.fit(wrong)
    with pytest.raises(ValueError, match="cameras must be some of 0 to 2"):
        Appearance.fit(observed, cameras=(3,))
    with pytest.raises(ValueError, match="did you mean 'quick'"):
        Appearance.fit(observed, preset="quik")


class Blank:
    """Images whose masks are empty."""

    def __init__(self, images):
        self.images, self.frame_count = images, images.frame_count

    def __getattr__(self, name):
        return getattr(self.images, name)

    def mask(self, camera, frame):
        return np.zeros_like(self.images.mask(camera, frame))


def test_without_depth_and_human_masks_there_is_still_a_fit(sample):
    class Bare(Blank):
        def mask(self, camera, frame):
            return self.images.mask(camera, frame)

        def depth(self, camera, frame):
            raise ValueError("no depth image")

        human_mask = depth

    observed = replace(sample.observed(), images=Bare(sample.images), cameras=sample.cameras[:1])
    config = replace(PRESETS["quick"], iterations=3)
    views = frame_zero(observed, config, CORRECTED)
    points, colours = starting_points(observed, views)
    assert np.array_equal(points[: sample.counts[0]], sample.points[0]) and not views[0].human.any()
    assert torch.isfinite(fit_gaussians(views, points, colours, config, CORRECTED).positions).all()


def test_unknown_and_missing_renderers_are_named():
    with pytest.raises(ValueError, match="did you mean 'gsplat'"):
        render(cloud(1), CAMERA, renderer="gspalt")
    import importlib.util

    if importlib.util.find_spec("gsplat") is None:
        with pytest.raises(ImportError, match=r"twinbench\[gsplat\]"):
            render(cloud(1), CAMERA, renderer="gsplat")


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match=r"log_scales must have shape \(2,\)"):
        Gaussians(np.zeros((2, 3)), np.zeros(3), np.zeros(2), np.zeros((2, 1, 3)))
    with pytest.raises(ValueError, match="K 1, 4, 9 or 16"):
        Gaussians(np.zeros((2, 3)), np.zeros(2), np.zeros(2), np.zeros((2, 5, 3)))


@pytest.mark.gpu
@pytest.mark.parametrize(("degree", "half_pixel"), [(0, False), (3, False), (3, True)])
def test_gsplat_agrees_with_the_torch_renderer(degree, half_pixel):
    """Values and gradients; gsplat works in float32 with fast exponentials."""
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    pytest.importorskip("gsplat")
    camera = Camera([[300.0, 0, 170.3], [0, 290.0, 100.7], [0, 0, 1]], POSE, 320, 200)
    weights = torch.tensor(np.random.default_rng(3).normal(size=(200, 320, 5)), device="cuda", dtype=torch.float32)
    results = {}
    for renderer in ("torch", "gsplat"):
        made = cloud(2000, degree=degree, camera=camera, size=0.01, dtype=torch.float32)
        g = Gaussians(*(getattr(made, n).cuda().requires_grad_() for n in FIELDS))
        colour, alpha, depth, centres = draw(g, camera, renderer=renderer, half_pixel=half_pixel)
        ((colour * weights[..., :3]).sum() + (alpha * weights[..., 3:4]).sum() + (depth * weights[..., 4]).sum()).backward()
        grads = {n: getattr(g, n).grad for n in FIELDS} | {"centres": centres.grad.reshape(-1, 2)}
        results[renderer] = torch.cat([colour, alpha, depth[..., None]], -1).detach(), grads
    image, expected = results["gsplat"][0], results["torch"][0]
    # a pair on the edge of alpha = 1/255, or the stop at 1e-4, may fall on either side: such pixels differ by up to 1/255, and are few
    apart = (image - expected)[..., :4].abs()
    assert apart.max() < 0.01 and apart.mean() < 1e-5
    for name, grad in results["torch"][1].items():
        other = results["gsplat"][1][name]
        assert (other - grad).norm() < 0.01 * grad.norm(), name


def test_alpha_of_a_tiny_gaussian_is_that_of_the_blur():
    # sigma -> 0: alpha = o exp(-r^2 / 0.6), one pixel off the centre o exp(-1 / 0.6)
    camera = Camera([[80, 0, 15], [0, 80, 10], [0, 0, 1]], np.eye(4), 32, 20)
    image = render(plain([[0, 0, 1]], [1e-9], [0.8], [[1, 1, 1]]), camera)
    assert image[10, 16, 3].item() == pytest.approx(0.8 * exp(-1 / 0.6), abs=1e-12)
