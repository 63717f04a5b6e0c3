"""The textbook's two steps: closed forms of rotations and of the eight positions."""

from __future__ import annotations

import numpy as np

from nav.calibrate.intervals import resting, turning
from nav.calibrate.plan import faces, planned
from nav.calibrate.start import drifts, forces, rates, start
from nav.earth import EARTH_RATE
from tests.nav.calibrate.making import (
    ARCSEC,
    AXES,
    DEG,
    LAT,
    TABLE_2_12,
    G,
    Unit,
    model,
    place,
    positions,
    rotations,
)

N, U = EARTH_RATE * np.cos(LAT), EARTH_RATE * np.sin(LAT)

# "Inertial navigation", Table 2-12 with W and X of (2-184) as they follow from it: row 3 of W and row 4 are
# two rows, row 6 of X has -g on z
W_8 = [
    [-N, U, 0.0],
    [N, U, 0.0],
    [U, 0.0, -N],
    [-U, 0.0, N],
    [N, 0.0, U],
    [-N, 0.0, -U],
    [N, -U, 0.0],
    [-N, -U, 0.0],
]
F_8 = [[0, 1, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1], [0, -1, 0], [0, -1, 0]]


def symmetric(seed: int) -> Unit:
    return Unit.draw(AXES, np.random.default_rng(seed), asymmetry=0.0)


def test_the_eight_positions_show_what_the_table_says():
    where = place()
    for interval, w, f in zip(planned(positions(TABLE_2_12, 1.0)), W_8, F_8, strict=True):
        np.testing.assert_allclose(interval.attitude @ where.w_g, w, rtol=0, atol=1e-19)
        np.testing.assert_allclose(interval.attitude @ where.f_g, where.gravity * np.array(f), atol=1e-15)


def test_rates_are_the_closed_form_of_pairs_of_whole_turns():
    """(2-175) to (2-183) with the indices of (2-28): half the difference over a turn, of each gyro."""
    unit, where = symmetric(1), place()
    intervals = unit.count(rotations(), where)
    turn = 2.0 * np.pi
    for gyro in range(3):
        counts = [one.plus[gyro] - one.minus[gyro] for one in intervals]
        closed = [(counts[2 * k] - counts[2 * k + 1]) / (2.0 * turn) for k in range(3)]
        # drifts by g differ from axis to axis, which the common bias of the least squares cannot follow: a
        # part of 1e-5 of the rate, seen through the Earth's, 4e-4 of the rate
        np.testing.assert_allclose(
            rates(intervals, gyro, where.w_g), closed, rtol=0, atol=1e-8 * closed[gyro]
        )
        # and that is scale times axis
        np.testing.assert_allclose(closed, unit.axes[gyro] / unit.plus[gyro], rtol=1e-12, atol=1e-6)


def test_drifts_and_forces_are_the_normal_equations_of_the_table():
    """(2-186) and (2-189) written out: (X'X)^-1 X'Y."""
    unit, where = symmetric(2), place()
    intervals = unit.count(positions(TABLE_2_12), where)
    X = np.column_stack((np.ones(8), where.gravity * np.array(F_8)))
    normal = np.linalg.inv(X.T @ X) @ X.T
    for k in range(3):
        counts = np.array([one.plus[k] - one.minus[k] for one in intervals]) / 60.0
        per_rad = unit.axes[k] / unit.plus[k]
        unit_rate = counts / np.linalg.norm(per_rad)
        Y = unit_rate - np.array(W_8) @ per_rad / np.linalg.norm(per_rad)
        got = drifts(intervals, k, per_rad, where.w_g, where.f_g, True)
        np.testing.assert_allclose(got, normal @ Y, rtol=1e-9, atol=1e-16)
        counts = np.array([one.plus[3 + k] - one.minus[3 + k] for one in intervals]) / 60.0
        per_m_s, zero = forces(intervals, 3 + k, where.f_g)
        np.testing.assert_allclose([zero, *per_m_s], normal @ counts, rtol=1e-9)


def test_the_printed_row_six_would_be_silently_wrong():
    """With -g on y in row 6 the matrix still has full rank: nothing but the numbers would say so."""
    X = np.column_stack((np.ones(8), G * np.array(F_8)))
    printed = X.copy()
    printed[5] = [1.0, 0.0, -G, 0.0]
    assert np.linalg.matrix_rank(printed) == np.linalg.matrix_rank(X) == 4
    truth = np.array([0.01, 1e-3, -2e-3, 1.0])
    wrong = np.linalg.lstsq(printed, X @ truth)[0]
    assert np.abs(wrong - truth).max() > 0.1


def test_start_is_exact_without_asymmetry_noise_and_table_errors():
    unit, where = symmetric(3), place()
    of = model(AXES, where)
    got = start(of, unit.count([*positions(TABLE_2_12), *rotations()], where))
    # as above, and for g sensitivities and biases (rad/s) far below
    np.testing.assert_allclose(got[:-4], unit.truth(of), rtol=0, atol=1e-8)


def test_a_rest_and_a_turn_integrate_the_attitude():
    C = faces("SUW")
    attitude, squares = resting(C, 3.0)
    np.testing.assert_array_equal(attitude, 3.0 * C.T)
    np.testing.assert_array_equal(squares, np.diag([0.0, 3.0, 0.0]))
    # two whole turns at constant rate: across the axis nothing is left, along it everything
    angle, dt = np.linspace(0.0, 1.0, 721), np.full(720, 0.05)
    attitude, squares = turning(C, 4.0 * np.pi * AXES[1], angle, dt)
    np.testing.assert_allclose(attitude, 36.0 * np.outer(AXES[1], AXES[1]) @ C.T, atol=1e-12)
    np.testing.assert_allclose(squares, np.diag([0.0, 36.0, 0.0]), atol=1e-12)
    # about a level axis up goes round: half its square to each side
    squares = turning(C, 4.0 * np.pi * AXES[0], angle, dt)[1]
    np.testing.assert_allclose(squares, np.diag([0.0, 18.0, 18.0]), atol=1e-12)
    # a quarter: closed form of the mean of cosine and sine; 720 steps of a midpoint rule are 2e-7 off
    attitude, squares = turning(np.eye(3), 0.5 * np.pi * AXES[2], angle, dt)
    mean = 2.0 / np.pi * 36.0
    np.testing.assert_allclose(attitude, [[mean, mean, 0.0], [-mean, mean, 0.0], [0.0, 0.0, 36.0]], atol=1e-4)
    np.testing.assert_allclose(squares, np.diag([0.0, 0.0, 36.0]), atol=1e-12)
    # and of up in the plane, u = (0, cos a, -sin a): means of cos^2, sin^2 and sin cos over a quarter
    squares = turning(faces("EUS"), 0.5 * np.pi * AXES[0], angle, dt)[1]
    mixed = -36.0 / np.pi
    np.testing.assert_allclose(squares, [[0.0, 0.0, 0.0], [0.0, 18.0, mixed], [0.0, mixed, 18.0]], atol=1e-4)
    assert 90.0 * DEG / ARCSEC == 324000.0
