"""Analytic alignment: the means of a standstill, and what they are worth."""

import dataclasses
import math

import numpy as np
import pytest

from nav.align.static import limits, triad
from nav.earth import earth_rate_g, gravity_g
from nav.rotation import dcm_from_euler, dcm_from_quat, quat_from_dcm, quat_from_rotvec, rotvec_from_quat
from tests.nav.align import making
from tests.nav.align.making import GRADE, HEIGHT, LAT, QUICK, misalignment, moved, standing


def test_the_triad_is_equation_2_113_made_orthonormal():
    rng = np.random.default_rng(1)
    C_gb = dcm_from_euler(1.0, 0.2, -0.1)
    g, w = gravity_g(LAT, HEIGHT), earth_rate_g(LAT)
    gravity = C_gb.T @ g + 1e-4 * rng.standard_normal(3)
    rate = C_gb.T @ w + 1e-9 * rng.standard_normal(3)
    size, north = float(np.linalg.norm(g)), float(w[1])
    rows = np.stack([
        np.cross(gravity, rate) / (size * north),
        gravity * math.tan(LAT) / size + rate / north,
        -gravity / size,
    ])  # fmt: skip
    C = triad(-gravity, rate, LAT, HEIGHT)
    # as printed it is off the nearest rotation by errors of the first order; the level agrees up to the bend
    # of the plumb line with height, 3e-7
    np.testing.assert_allclose(C[2], rows[2] / np.linalg.norm(rows[2]), atol=1e-6)
    np.testing.assert_allclose(C, rows, atol=1e-4)
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-14)


def test_a_minute_is_worth_what_it_says():
    seeds = 8
    phi, nees = np.zeros((seeds, 3)), np.zeros(seeds)
    for seed in range(seeds):
        C_gb, eps, nabla, samples = standing(seed, GRADE, 62.0)
        init, status, refusals, *_ = making.align("analytic", samples, GRADE)
        assert not refusals
        assert init.t_ns == round(60e9)
        np.testing.assert_allclose(status.estimate, init.q_gb)
        np.testing.assert_allclose(status.covariance, init.P_phi, rtol=1e-9)
        phi[seed] = misalignment(C_gb, init)
        nees[seed] = making.nees(C_gb, eps, nabla, init)
    np.testing.assert_allclose(status.limit, limits(GRADE, LAT, HEIGHT, 60.0, settles=False))
    # 8 seeds: the mean square of one component is below 2.2 of its variance with 97.5 %
    assert np.all(np.mean(phi**2, axis=0) < 2.2 * status.limit**2)
    # nothing but eq. (2-104) limits it
    assert np.all(np.sqrt(np.diag(status.covariance)) < 1.05 * status.limit)
    # mean of 8 chi-square values of 9 degrees of freedom: 99 % within 9 -+ 3.9
    assert abs(np.mean(nees) - 9.0) < 3.9


def tilted(degrees, back):
    """Samples and C_gb of a vehicle that is tilted in 0.8 s half way through, and perhaps back again."""
    C_gb, _, _, samples = standing(3, GRADE, 62.0)
    axis, total, out = C_gb.T @ np.array([1.0, 0.0, 0.0]), 0.0, []
    for sample in samples:
        t = sample.t_ns * 1e-9 - 30.1
        sign = 1.0 if 0.0 < t < 0.8 else (-1.0 if back and 1.0 < t < 1.8 else 0.0)
        step = sign * math.radians(degrees) / 4.0
        undo = dcm_from_quat(quat_from_rotvec(-(total + 0.5 * step) * axis))
        total += step
        out.append(sample._replace(dtheta=undo @ sample.dtheta + step * axis, dv=undo @ sample.dv))
    return out, C_gb @ dcm_from_quat(quat_from_rotvec(total * axis))


@pytest.mark.parametrize("back", [False, True])
def test_a_tilt_too_small_to_be_refused_is_in_the_covariance(back):
    """0.004 deg in a second are 250 times the gyros' noise, but less than wind and engine do."""
    samples, C_gb = tilted(0.004, back)
    init, _, refusals, *_ = making.align("analytic", samples, GRADE)
    assert not refusals
    phi = misalignment(C_gb, init)
    assert phi @ np.linalg.solve(init.P_phi, phi) < 16.3  # 99.9 %
    # the line through a step A in its middle has a slope of 1.5 A/T, 1.7 deg of heading; sigma is about that
    sigma = math.degrees(math.sqrt(init.P_phi[2, 2]))
    assert sigma < 0.5 if back else 0.8 < sigma < 3.4


def test_a_larger_tilt_leaves_no_azimuth_and_is_refused():
    samples, _ = tilted(0.04, False)
    _, _, refusals, *_ = making.align("analytic", samples, GRADE)
    assert "the vehicle turned a little" in refusals[0]


@pytest.mark.parametrize(
    ("words", "config", "change"),
    [
        ("pushed", QUICK, lambda s, t: s._replace(dv=s.dv + (0.04 if t < 0.5 else 0.0))),
        ("turned by", QUICK, lambda s, t: s._replace(dtheta=s.dtheta + (2e-3 if t < 0.5 else 0.0))),
        ("latitude", dataclasses.replace(QUICK, position=(0.9, 1.9, HEIGHT)), lambda s, t: s),
        ("align in motion", dataclasses.replace(QUICK, gyro_bias=5e-5), lambda s, t: s),
    ],
)  # fmt: skip
def test_it_refuses_with_the_cause(words, config, change):
    _, _, _, samples = standing(4, QUICK, 24.0)
    refusals = making.align("analytic", moved(samples, 10.0, change), config).refusals
    assert words in refusals[0]


@pytest.mark.parametrize("name", ["analytic", "static"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_stuck_accelerometer_is_named(name, axis):
    _, _, _, samples = standing(5, QUICK, 62.0)
    frozen = samples[60].dv[axis]

    def change(sample, t):
        dv = sample.dv.copy()
        dv[axis] = frozen
        return sample._replace(dv=dv)

    refusals = making.align(name, moved(samples, 12.0, change), QUICK).refusals
    assert f"the {('right', 'forward', 'up')[axis]} accelerometer is stuck" in refusals[0]


def test_ideal_sensors_on_a_level_vehicle_are_not_stuck():
    force, rate = -gravity_g(LAT, HEIGHT), earth_rate_g(LAT)
    _, _, _, samples = standing(6, QUICK, 24.0)
    still = [s._replace(dtheta=rate * s.dt, dv=force * s.dt) for s in samples]
    init, _, refusals, *_ = making.align("analytic", still, QUICK)
    assert not refusals
    assert np.max(np.abs(rotvec_from_quat(init.q_gb))) < 1e-9
    np.testing.assert_allclose(quat_from_dcm(np.eye(3)), init.q_gb, atol=1e-9)
