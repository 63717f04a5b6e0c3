"""Rotations: round trips, group laws and the signs of the naming law."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav import rotation as rot
from nav.types import Mode, S, Solution

ANGLE = st.floats(-3.1, 3.1)
VECTOR = st.tuples(ANGLE, ANGLE, ANGLE).map(np.array)
HEADING = st.floats(0.0, 6.28)
PITCH = st.floats(-1.57, 1.57)


def test_signs_of_heading_pitch_and_roll():
    right, forward, up = np.eye(3)
    # heading 90 degrees: the nose points east
    np.testing.assert_allclose(rot.dcm_from_euler(math.pi / 2, 0, 0) @ forward, [1, 0, 0], atol=1e-15)
    # pitch: the nose goes up
    assert (rot.dcm_from_euler(0, 0.1, 0) @ forward)[2] == pytest.approx(math.sin(0.1))
    # roll: the right side goes down, and the top leans right
    assert (rot.dcm_from_euler(0, 0, 0.1) @ right)[2] == pytest.approx(-math.sin(0.1))
    assert (rot.dcm_from_euler(0, 0, 0.1) @ up)[0] == pytest.approx(math.sin(0.1))


@given(HEADING, PITCH, ANGLE)
def test_euler_round_trip(heading, pitch, roll):
    C = rot.dcm_from_euler(heading, pitch, roll)
    np.testing.assert_allclose(rot.dcm_from_quat(rot.quat_from_euler(heading, pitch, roll)), C, atol=1e-15)
    h, p, r = rot.euler_from_dcm(C)
    assert p == pytest.approx(pitch, abs=1e-12)
    np.testing.assert_allclose(rot.dcm_from_euler(h, p, r), C, atol=2e-12)
    again = rot.euler_from_quat(rot.quat_from_dcm(C))
    np.testing.assert_allclose(rot.dcm_from_euler(*again), C, atol=2e-12)
    assert 0.0 <= h < 2 * math.pi


@given(HEADING, st.floats(-1.5, 1.5), ANGLE)
def test_solution_shows_the_same_angles(heading, pitch, roll):
    state = np.zeros(S.SIZE)
    state[S.Q] = rot.quat_from_euler(heading, pitch, roll)
    s = Solution(0, Mode.NAVIGATE, 0, state)
    assert s.pitch == pytest.approx(pitch, abs=1e-12)
    assert s.roll == pytest.approx(roll, abs=1e-12)
    assert math.remainder(s.heading - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_gimbal_lock_keeps_the_matrix():
    C = rot.dcm_from_euler(0.4, math.pi / 2, 0.7)
    h, p, r = rot.euler_from_dcm(C)
    assert r == 0.0
    np.testing.assert_allclose(rot.dcm_from_euler(h, p, r), C, atol=1e-15)


@given(VECTOR, VECTOR)
def test_products_and_matrices_agree(a, b):
    qa, qb = rot.quat_from_rotvec(a), rot.quat_from_rotvec(b)
    product = rot.quat_multiply(qa, qb)
    np.testing.assert_allclose(rot.multiply(*qa, *qb), product, atol=1e-15)
    np.testing.assert_allclose(
        rot.dcm_from_quat(product), rot.dcm_from_quat(qa) @ rot.dcm_from_quat(qb), atol=2e-15
    )
    np.testing.assert_allclose(rot.quat_rotate(qa, b), rot.dcm_from_quat(qa) @ b, atol=1e-14)
    np.testing.assert_allclose(rot.rotate(*qa, *b), rot.dcm_from_quat(qa) @ b, atol=1e-14)
    np.testing.assert_allclose(rot.skew(a) @ b, np.cross(a, b), atol=1e-14)


@given(VECTOR, st.floats(-12.0, 0.0))
def test_exponential_and_logarithm(axis, exponent):
    r = axis / max(1.0, np.linalg.norm(axis) / 3.0) * 10.0**exponent
    q = rot.quat_from_rotvec(r)
    np.testing.assert_allclose(rot.exponential(*r), q, atol=2e-16)
    np.testing.assert_allclose(rot.rotvec_from_quat(q), r, rtol=1e-12, atol=1e-25)
    np.testing.assert_allclose(rot.logarithm(*q), r, rtol=1e-12, atol=1e-25)
    np.testing.assert_allclose(rot.logarithm(*(-q)), r, rtol=1e-12, atol=1e-25)


@given(VECTOR)
def test_matrix_to_quaternion_and_back(r):
    C = rot.dcm_from_quat(rot.quat_from_rotvec(r))
    q = rot.quat_from_dcm(C)
    assert q[0] >= 0.0
    np.testing.assert_allclose(rot.dcm_from_quat(q), C, atol=3e-15)
    np.testing.assert_allclose(rot.quat_multiply(q, rot.quat_conjugate(q)), [1, 0, 0, 0], atol=1e-15)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns(axis):
    r = np.zeros(3)
    r[axis] = math.pi
    C = rot.dcm_from_quat(rot.quat_from_rotvec(r))
    np.testing.assert_allclose(rot.dcm_from_quat(rot.quat_from_dcm(C)), C, atol=1e-15)
