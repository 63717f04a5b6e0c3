"""Alignment from any azimuth: one filter on the circle fails, a bank does not, and knows how good it is."""

import dataclasses
import math

import numpy as np
import pytest

from nav.align import ALIGNMENTS
from nav.align.large import LARGE
from nav.align.large_bank import MEMBERS, SIZE, Noise, levelled, mean, start, step
from nav.align.types import Alignment
from nav.errors.large import misalignment
from nav.filter.ukf import symmetric_points
from nav.rotation import quat_from_dcm, rotvec_from_quat
from nav.types import ImuFlag, OdoSample
from tests.nav.align import making
from tests.nav.align.making import DEG_PER_H, HEIGHT, LAT, LON, G, align, standing

PLACE = LAT, LON, HEIGHT
DT = 0.25
BOTH, FIRST = ALIGNMENTS["large_angle"], Alignment(frozenset(), (LARGE,))
GRADE = dataclasses.replace(making.GRADE, fine_s=120.0)
# tactical: 0.5 deg/h is 2.3 deg of heading, and a tilt that grows by it is seen in a minute
POOR = dataclasses.replace(
    GRADE,
    gyro_bias=0.5 * DEG_PER_H,
    accel_bias=5e-4 * G,
    angle_random_walk=math.radians(0.02) / 60.0,
    velocity_random_walk=5e-5 * G,
)


def at_rest(seed, config, seconds, dt=DT):
    return standing(seed, config, seconds, dt=dt, sway=config.sway)


def by_bank(seed, angles_deg, members=MEMBERS):
    """phi (3,) after 90 s, from an attitude misaligned by Euler angles (3,) deg."""
    C, _, _, samples = at_rest(seed, GRADE, 91.0, 1.0)
    noise = Noise(GRADE.gyro_bias, GRADE.angle_random_walk, GRADE.velocity_random_walk, GRADE.sway)
    begin_at = levelled(misalignment(np.radians(angles_deg)) @ C, samples[0].dv)
    bank = start(PLACE, begin_at, math.radians(1.0), noise, symmetric_points(SIZE), members)
    for sample in samples[1:]:
        bank, _, _ = step(bank, sample.dtheta, sample.dv, 1.0)
    return rotvec_from_quat(quat_from_dcm(C @ mean(bank).C.T))


@pytest.mark.parametrize("angles_deg", [(30.0, 10.0, 170.0), (0.3, 0.1, 170.0), (0.3, 0.1, 1.7)])
def test_the_three_cases_of_the_report(angles_deg):
    found = np.array([by_bank(seed, angles_deg) for seed in range(8)])
    # azimuth is the curvature of velocity: sway sqrt(720/n^5)/(g w_N) is 0.10 deg after n = 90 blocks;
    # constant errors add 0.04 deg. Level: the accelerometers' 5e-5
    assert np.max(np.abs(found[:, 2])) < math.radians(4.0 * 0.11)
    assert np.max(np.abs(found[:, :2])) < 4.0 * 5e-5


def test_one_filter_for_the_whole_circle_goes_astray():
    found = np.array([by_bank(seed, (0.3, 0.1, 170.0), members=1) for seed in range(8)])
    assert np.sum(np.abs(found[:, 2]) > math.radians(10.0)) >= 4


@pytest.mark.parametrize("config", [GRADE, POOR])
def test_the_large_stage_knows_its_covariance(config):
    total, count = 0.0, 8
    for seed in range(count):
        C, eps, nabla, samples = at_rest(seed, config, 90.0)
        init, _, refusals, *_ = align(FIRST, samples, config)
        assert not refusals
        total += making.nees(C, eps, nabla, init)
    # chi-square of 72: 0.9998 of it
    assert 36.0 < total < 124.0


def test_both_stages_reach_the_limit():
    ratios = []
    for seed in range(8):
        C, _, _, samples = at_rest(seed, GRADE, 185.0)
        init, _, refusals, *_ = align(BOTH, samples, GRADE)
        assert not refusals
        ratios.append(making.misalignment(C, init) / np.sqrt(np.diag(init.P_phi)))
        # 0.007 deg/h is 0.034 deg here, sway of 3 mm/s over 180 s 0.02
        assert math.sqrt(init.P_phi[2, 2]) < math.radians(0.06)
    assert np.max(np.abs(ratios)) < 4.0
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.6


def test_error_free_sensors_give_the_attitude_in_any_orientation():
    perfect = dataclasses.replace(GRADE, gyro_bias=1e-9, accel_bias=1e-6, coarse_s=40.0, fine_s=60.0)
    ideal = dataclasses.replace(
        perfect, gyro_bias=0.0, accel_bias=0.0, angle_random_walk=0.0, velocity_random_walk=0.0
    )
    for attitude in [(0.3, 0.1, -0.2), (3.0, -1.2, 2.5), (5.5, 0.0, math.pi / 2)]:
        C, _, _, samples = standing(0, ideal, 125.0, attitude, DT)
        init, _, refusals, *_ = align(BOTH, samples, perfect)
        assert not refusals
        # the bank's members agree to what 40 s of a filter that expects sway tell them, second orders of it
        assert np.max(np.abs(making.misalignment(C, init))) < 2e-4


def test_refusals_name_their_cause():
    *_, samples = at_rest(1, GRADE, 200.0)

    def first(samples, config=GRADE):
        return align(FIRST, samples, config).refusals[0]

    def instead(k, sample):
        return [*samples[:k], sample, *samples[k + 1 :]]

    push = np.array([0.1, 0.0, 0.0])
    pushed = [s._replace(dv=s.dv + push) if k in (120, 121) else s for k, s in enumerate(samples)]
    assert "pushed" in first(pushed)
    wild = samples[120]._replace(dv=samples[120].dv + 2.0 * push)
    assert "right accelerometer is wild" in first(instead(120, wild))
    assert "missing" in first(instead(50, samples[50]._replace(flags=ImuFlag.GAP)))
    assert "rolls" in first(instead(40, OdoSample(samples[39].t_ns, 0.1, 0.5, False, "odometer")))
    far_off = dataclasses.replace(GRADE, position=(math.radians(20.0), LON, HEIGHT))
    assert "latitude" in first(samples, far_off)
    blind = dataclasses.replace(GRADE, gyro_bias=20.0 * DEG_PER_H)
    assert "cannot find heading" in first(samples, blind)
    nowhere = dataclasses.replace(GRADE, position=None)
    assert "no position" in first(samples, nowhere)
    swaying = dataclasses.replace(GRADE, sway=0.3)
    assert "with a sway of" in first(samples, swaying)
    dead = [s._replace(dv=0.0 * s.dv) for s in samples]
    assert "an accelerometer is stuck" in first(dead)
