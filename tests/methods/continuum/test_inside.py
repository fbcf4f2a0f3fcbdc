"""What points enclose: known volumes, areas and thicknesses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.methods.continuum.inside import inside_of


def lattice(size, count):
    """(P, 3) evenly spaced points that fill a box of ``size`` up to its faces."""
    axes = [np.linspace(0, s, n + 1) for s, n in zip(size, count, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def sphere(radius, count):
    """(count, 3) points spread over a sphere (Fibonacci)."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    return radius * np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], 1)


@pytest.mark.parametrize("turn", [(0, 0, 0), (0.3, -0.7, 1.1)])
def test_a_box_of_points_has_its_volume_area_and_thickness(turn):
    # points are moved by 1e-4 of their spacing of 1 cm, so lengths are exact to some 1e-5 of the box
    box = Rotation.from_rotvec(turn).apply(lattice((0.1, 0.06, 0.04), (10, 6, 4)))
    inside = inside_of(box, 0.01)
    assert inside.volume == pytest.approx(0.1 * 0.06 * 0.04, rel=1e-3)
    # flat tetrahedra between points of one plane lie on the skin and may count twice: only exact lattices have them
    assert inside.area == pytest.approx(2 * (0.1 * 0.06 + 0.1 * 0.04 + 0.06 * 0.04), rel=0.05)
    # the largest spheres are 4 cm wide and leave the corners; the one found is off the middle by up to half the mean distance of the points
    assert 0.036 < inside.thickness <= 0.0402
    # points 5 mm apart stand for 1 / 8 cm^3 each
    assert len(inside.lattice(0.005, Rotation.from_rotvec(turn).as_matrix().T)) == pytest.approx(240 * 8, rel=0.02)


def test_a_skin_alone_encloses_its_ball():
    # a polyhedron with corners on a sphere and edges of 1.1 spacings at most lies within s^2 / (6 R) of it on average
    radius, count = 0.05, 800
    points = sphere(radius, count)
    spacing = np.sqrt(4 * np.pi * radius**2 / count)
    inside = inside_of(points, spacing)
    whole = 4 / 3 * np.pi * radius**3
    assert whole * (1 - 3 * spacing**2 / (6 * radius**2)) < inside.volume < whole
    assert inside.thickness == pytest.approx(2 * radius, rel=0.05)


def test_a_bay_wider_than_the_ball_stays_empty():
    # a U of three beams 2 cm thick: the bay is 4 cm wide, 4 spacings
    whole = lattice((0.08, 0.02, 0.06), (8, 2, 6))
    kept = (whole[:, 0] < 0.0201) | (whole[:, 0] > 0.0599) | (whole[:, 2] < 0.0201)
    inside = inside_of(whole[kept], 0.01)
    # inner corners are rounded by the ball: less than its square along each of the two
    assert 0 <= inside.volume / (0.02 * (0.08 * 0.02 + 2 * 0.02 * 0.04)) - 1 < 2 * 0.02 * inside.radius**2 / (0.02 * 0.0032)


def test_what_has_no_inside_is_refused():
    flat = lattice((0.1, 0.1, 0.0), (10, 10, 0))
    with pytest.raises(ValueError, match="lie in a plane"):
        inside_of(flat, 0.01)
    with pytest.raises(ValueError, match=r"at least 5 points .* got 4"):
        inside_of(np.eye(4)[:, :3], 0.01)
    with pytest.raises(ValueError, match="must be finite"):
        inside_of(np.where(flat == 0.1, np.nan, flat), 0.01)
    with pytest.raises(ValueError, match=r"spacing .* > 0"):
        inside_of(lattice((0.1, 0.1, 0.1), (3, 3, 3)), 0.0)
