"""Bodies from recordings: shapes of known kind and size, whole and partly seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from twinbench.datasets.collection import open_collection
from twinbench.datasets.scenario import Observed, Plane
from twinbench.methods.continuum.body import body_of

SAMPLE = Path(__file__).parents[3] / "datasets" / "sample"
NOTHING = np.zeros((0, 3))


def box(size, spacing):
    """(P, 3) points ``spacing`` apart that fill a box on z = 0 up to its faces, and (P,) which are on them."""
    count = np.maximum(np.rint(np.array(size) / spacing), 1).astype(int)
    axes = [np.linspace(0, s, n + 1) for s, n in zip(size, count, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return points, ((points == 0) | (points == np.array(size))).any(1)


def recording(tracked, *, interior=NOTHING, ground=True, frames=None, **given):
    """``tracked`` (N, 3), which moves as ``frames`` (F, N, 3) or stands still, z up."""
    points = np.broadcast_to(tracked, (4, *tracked.shape)) if frames is None else frames
    seen = np.ones(points.shape[:2], bool)
    values = dict(
        name="made",
        points=points,
        visible=seen,
        motion_valid=seen & (np.arange(len(seen)) < len(seen) - 1)[:, None],
        controllers=np.zeros((len(points), 0, 3)),
        interior=interior,
        gravity=np.array([0.0, 0.0, -9.81]),
        ground=Plane(np.array([0.0, 0.0, 1.0])) if ground else None,
    )
    return Observed(**values | given)


def solid(size, spacing, **given):
    points, skin = box(size, spacing)
    return recording(points[skin], interior=points[~skin], **given)


def cloth(bend=0.0, *, side=0.3, spacing=0.01, noise=0.0007, seed=0):
    """(N, 3) a square sheet in waves of ``bend`` [m], with noise."""
    u = np.arange(0, side + 1e-9, spacing)
    x, y = (a.ravel() for a in np.meshgrid(u, u, indexing="ij"))
    points = np.stack([x, y, 0.002 + bend * (1 + np.sin(2 * np.pi * x / 0.08))], 1)
    return points + np.random.default_rng(seed).normal(0, noise, points.shape)


def cord(length=0.6, radius=0.006, spacing=0.004, *, sway=0.05):
    """(N, 3) the skin of a cord that lies in a bow."""
    s, turn = np.meshgrid(np.arange(0, length, spacing), np.arange(8) * 2 * np.pi / 8, indexing="ij")
    s, turn = s.ravel(), turn.ravel()
    return np.stack([s, sway * np.sin(4 * s) + radius * np.cos(turn), radius + radius * np.sin(turn)], 1)


def test_a_box_becomes_itself():
    """100 x 60 x 40 mm: lengths to 1e-4 of the spacing of 1 cm, by which the points are moved aside; the thickness as in its own test."""
    body = body_of(solid((0.1, 0.06, 0.04), 0.01))
    assert body.kind == "solid" and not body.notes and body.evidence["length_over_width"] < 3
    assert body.volume == pytest.approx(2.4e-4, rel=1e-3) and body.area == pytest.approx(0.0248, rel=0.05)  # as below
    assert 0.036 < body.thickness < 0.0402
    # 48 cells of its volume would be 17 mm long: 6 x 4 x 2 whole ones
    assert len(body.grid.cells) == 48 and body.grid.volume.sum() == pytest.approx(body.volume)
    np.testing.assert_allclose(np.sort(body.grid.size), [0.06 / 4, 0.1 / 6, 0.04 / 2], rtol=0.03)
    # samples fill the inside: their middle and spread are the box's
    np.testing.assert_allclose(body.samples.mean(0), [0.05, 0.03, 0.02], atol=5e-4)
    np.testing.assert_allclose(body.samples.std(0), np.array([0.1, 0.06, 0.04]) / np.sqrt(12), rtol=0.02)
    np.testing.assert_array_equal(body.rest, solid((0.1, 0.06, 0.04), 0.01).structure)


def test_the_surface_is_spread_evenly():
    """Each face has its share of the points; they lie on it, and none is nearer to another than three fifths of a cell."""
    from scipy.spatial import cKDTree

    body = body_of(solid((0.1, 0.06, 0.04), 0.01), pitch=0.01)
    points = body.surface
    on = [(np.abs(points[:, k] - end) < 1e-5).mean() for k, size in enumerate((0.1, 0.06, 0.04)) for end in (0, size)]
    share = np.repeat([0.06 * 0.04, 0.1 * 0.04, 0.1 * 0.06], 2) / 0.0248
    np.testing.assert_allclose(on, share, atol=3 * np.sqrt(0.25 / len(points)))  # three standard deviations of a random draw
    near = cKDTree(points).query(points, k=2)[0][:, 1]
    assert near.min() > 0.006 and near.max() < 0.012


@pytest.mark.parametrize(
    ("kind", "made"),
    [
        ("solid", solid((0.3, 0.05, 0.03), 0.007)),
        ("solid", solid((0.2, 0.12, 0.025), 0.007)),
        ("sheet", recording(cloth())),
        ("sheet", recording(cloth(0.015), ground=False)),
        ("rope", recording(cord())),
        ("rope", recording(np.stack([np.linspace(0, 1, 90), np.zeros(90), np.zeros(90)], 1))),
    ],
    ids=["bar", "slab", "flat cloth", "cloth in waves", "cord", "row of markers"],
)
def test_the_kind_is_told_with_its_evidence(kind, made):
    body = body_of(made)
    assert body.kind == kind == body.evidence["told"]
    assert (body.grid is None) == (kind != "solid")
    assert f"{1e3 * body.evidence['length']:.0f} mm long" in body.evidence["words"]


def test_a_sheet_that_folds_is_no_solid_however_it_starts():
    """Bays 16 mm deep between points 1 cm apart look filled to a ball; then the cloth is laid flat, and folded in half."""
    start = cloth(0.008)
    flat, folded = cloth(), cloth()
    folded[:, 0] = 0.15 - np.abs(folded[:, 0] - 0.15)
    frames = np.stack([start, flat, folded])
    assert body_of(recording(start, frames=frames, ground=False)).kind == "sheet"


def test_kinds_can_be_said():
    body = body_of(solid((0.3, 0.05, 0.03), 0.007), kind="rope")
    assert body.kind == "rope" and body.grid is None and "said to be a rope" in body.notes[0] and body.evidence["told"] == "solid"
    thick = body_of(recording(cord(radius=0.0075)), pitch=0.015)  # a rope 15 mm thick still makes a grid
    assert thick.kind == "rope" and len(thick.grid.cells) > 30
    # an octagon in the circle: 8 / 2 sin(45 degrees) r^2 l, ends without caps; bowed by 5 %
    assert thick.volume == pytest.approx(4 * np.sin(np.pi / 4) * 0.0075**2 * 0.6 * 1.01, rel=0.05)


def test_what_lies_on_the_ground_is_completed_down_to_it():
    """The top and the sides of a box are seen: all of it is there, to the noise of the seen points' spacing at the lower edge."""
    points, skin = box((0.12, 0.08, 0.04), 0.008)
    seen = points[skin & (points[:, 2] > 0.012)]
    body = body_of(recording(seen))
    assert body.kind == "solid" and "down to the ground" in body.notes[0]
    assert body.volume == pytest.approx(0.12 * 0.08 * 0.04, rel=0.02)
    assert body.samples[:, 2].min() < 0.01


def test_what_is_in_the_air_is_mirrored_at_its_rim():
    """The upper half of a ball: its mirror image is the ball. The rim is the lowest 5 % of the points' heights: 1.25 mm of 25."""
    i = np.arange(600) + 0.5
    z, turn = 1 - i / 600, np.pi * (1 + 5**0.5) * i
    dome = 0.025 * np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], 1)
    lifted = recording(dome + [0, 0, 0.5])
    assert body_of(lifted).kind == "solid" or "nothing says" in body_of(lifted).notes[0]
    body = body_of(lifted, kind="solid")
    assert "mirror image" in body.notes[0]
    assert body.volume == pytest.approx(4 / 3 * np.pi * 0.025**3, rel=0.15)  # 2 x 1.25 mm of a height of 50, and chords
    turning = np.stack([dome + [0, 0, 0.5], dome @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]) + [0, 0, 0.5]])
    assert body_of(recording(dome + [0, 0, 0.5], frames=turning)).kind == "solid"  # it moves and keeps its shape


def test_a_few_markers_that_stand_off_are_no_part_of_the_body():
    points, _ = box((0.1, 0.03, 0.03), 0.0075)
    off = np.array([[0.1, 0.015, 0.036], [0.1, -0.006, 0.02], [0.1, 0.036, 0.006]])
    body = body_of(recording(off, interior=points))
    assert body.volume == pytest.approx(9e-5, rel=1e-3) and len(body.rest) == 3 + len(points)


def test_square_sections_get_cells_along_their_sides():
    from scipy.spatial.transform import Rotation

    points, _ = box((0.1, 0.03, 0.03), 0.0075)
    turned = Rotation.from_rotvec([0.4, 0.2, 0.7])
    body = body_of(recording(turned.apply(points) + [0, 0, 0.2], ground=False))
    assert (
        len(body.grid.cells) == 32 and np.abs(turned.as_matrix().T @ body.grid.axes.T).max(0).min() > 0.9998
    )  # turned in steps of a degree


@pytest.mark.parametrize(
    ("made", "options", "message"),
    [
        (recording(cloth()), {"kind": "solid"}, "a solid .* mm thick is too thin to grid"),
        (recording(cloth(noise=0.0)), {"pitch": 0.01}, "lie in a plane is too thin to grid"),
        (recording(cloth()), {"pitch": 0.01}, "a sheet .* too thin to grid"),
        (recording(cloth()[:12]), {}, "at least 20 points .* got 12"),
        (solid((0.1, 0.06, 0.04), 0.01), {"kind": "plush"}, "kind must be one of rope, sheet, solid, got 'plush'"),
        (solid((0.1, 0.06, 0.04), 0.01), {"pitch": 0.0}, "pitch must be > 0"),
        (solid((0.1, 0.06, 0.04), 0.01), {"pitch": float("nan")}, "pitch must be > 0"),
        (solid((0.1, 0.06, 0.04), 0.01), {"pitch": 0.5}, "pitch must be smaller"),
        (solid((0.1, 0.06, 0.04), 0.01), {"pitch": 0.001}, "pitch must be larger"),
    ],
)
def test_what_makes_no_body_is_refused(made, options, message):
    with pytest.raises(ValueError, match=message):
        body_of(made, **options)


def test_what_was_not_seen_is_no_body():
    whole = solid((0.1, 0.06, 0.04), 0.01)
    with pytest.raises(ValueError, match=r"at least 20 points .* seen or supplied, got 0 \(scenario made\)"):
        body_of(replace(whole, visible=np.zeros_like(whole.visible), motion_valid=np.zeros_like(whole.visible), interior=NOTHING))


def test_points_that_are_no_numbers_are_refused():
    whole = solid((0.1, 0.06, 0.04), 0.01)
    broken = whole.interior.copy()
    broken[3, 1] = np.nan
    with pytest.raises(ValueError, match="interior"):
        body_of(replace(whole, interior=broken))


def test_the_sample_is_a_solid():
    """The volume of the plush's own mesh, but for its edges: between points 7 mm apart a chord cuts off up to (7 mm / 2)^2 / 2 of them."""
    from twinbench.datasets.synthetic.objects import Plush
    from twinbench.datasets.synthetic.resolved import resolved

    shape = resolved(Plush())
    sides = shape.vertices[shape.tetrahedra[:, 1:]] - shape.vertices[shape.tetrahedra[:, :1]]
    volume, edges = np.linalg.det(sides).sum() / 6, 4 * sum(shape.size)
    collection = open_collection(SAMPLE)
    for name in collection.scenarios:
        body = body_of(collection.load(name).observed())
        assert body.kind == "solid" and len(body.grid.cells) <= 150
        # and as much again, as its sections are round all over
        assert -edges * 0.0035**2 < body.volume - volume < 0.02 * volume
