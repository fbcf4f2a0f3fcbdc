"""How far apart points lie, of points whose distances are known."""

import numpy as np
import pytest
from twinbench.datasets.spacing import spacing


def test_the_median_way_to_the_nearest_neighbour():
    # on a line at 0, 1, 3, 6: ways to the nearest are 1, 1, 2, 3
    assert spacing(np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [6, 0, 0]])) == pytest.approx(1.5)
    assert spacing(np.zeros((1, 3))) == 0.0 and spacing(np.zeros((0, 3)), alone=0.01) == 0.01
