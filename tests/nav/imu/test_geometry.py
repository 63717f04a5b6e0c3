"""Directions of redundant sensors: angles that the paper prints, and what they tell of space."""

from __future__ import annotations

import numpy as np
import pytest

from nav.imu.geometry import GEOMETRIES, cone, with_skew


@pytest.mark.parametrize("name", GEOMETRIES)
def test_directions_are_unit_vectors_that_span_space(name):
    axes = GEOMETRIES[name]
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, rtol=1e-15)
    assert np.linalg.matrix_rank(axes) == 3


def test_s_is_at_equal_angles_to_the_axes_and_t_is_its_mirror():
    axes = with_skew()
    np.testing.assert_allclose(np.degrees(np.arccos(axes[:3] @ axes[3])), 54.74, atol=5e-3)
    np.testing.assert_array_equal(axes[4], axes[3] * [-1.0, 1.0, 1.0])


def test_the_cone_tells_every_direction_equally_and_may_lose_any_two():
    axes = cone()
    np.testing.assert_allclose(axes.T @ axes, 2.0 * np.eye(3), atol=1e-15)
    for i in range(6):
        for j in range(i):
            assert np.linalg.matrix_rank(np.delete(axes, (i, j), axis=0), tol=0.3) == 3
