"""A table that tells its angles: attitudes and rotations are those told, and what they lack is counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation as Oracle

from nav.calibrate.encoder import Encoder, attitudes
from nav.calibrate.intervals import Interval, resting, turning, unsure
from nav.calibrate.plan import Position, faces
from nav.calibrate.segments import Disagreement, segment
from tests.nav.calibrate.making import ARCSEC, AXES, DEG
from tests.nav.calibrate.test_segments import NOMINAL, RATE, STEPS, WHERE, course, stream


@pytest.mark.parametrize("axes", ["zxy", "xyz", "zyz"])
def test_angles_about_carried_axes(axes):
    angles = np.random.default_rng(1).uniform(-np.pi, np.pi, (20, 3))
    want = Oracle.from_euler(axes.upper(), angles).as_matrix()  # capitals: about carried axes
    np.testing.assert_allclose(attitudes(angles, axes), want, rtol=0, atol=1e-14)


def test_turns_are_counted_and_their_ends_are_as_told():
    angle = np.linspace(0.0, 2.5 * 2.0 * np.pi, 400)
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    start = faces("NWU")
    C = start @ Oracle.from_rotvec(np.outer(angle, axis)).as_matrix()
    encoder = Encoder(np.arange(400.0), C)
    end = C[-1] @ Oracle.from_rotvec([0.0, 0.0, 1e-3]).as_matrix()
    found = encoder.turned(C[0], 0.5, 398.5, end)
    # the last step is of 0.04 rad, half of which times 1e-3 is what turns do not commute by
    np.testing.assert_allclose(found, 5.0 * np.pi * axis + [0.0, 0.0, 1e-3], rtol=0, atol=3e-5)
    np.testing.assert_allclose(encoder.attitude(3.0, 3.5), C[3], atol=1e-12)
    assert encoder.attitude(500.0, 600.0) is None


def wrong_by(steps, seed, size):
    """The steps as a table carries them out that stops beside where it should."""
    rng = np.random.default_rng(seed)
    off = [Oracle.from_rotvec(size * rng.standard_normal(3)).as_matrix() for _ in range(4)]
    made, last = [], None
    for step in steps:
        if last is None or not np.array_equal(last[0], step.C_gb):
            last = (step.C_gb, step.C_gb @ (off.pop() if off else np.eye(3)))
        made.append(replace(step, C_gb=last[1]))
    return made


def told(steps):
    """Samples of steps with the table's readings at every other of them."""
    whole = stream(steps)
    C = course(steps)[1::2]
    return replace(whole, encoder=Encoder((1.0 + 2.0 * np.arange(len(C))) / RATE, C))


def test_attitudes_and_turns_are_those_told():
    """A table off by 0.1 deg: what the counts show is what it told, to rounding, and not what was planned."""
    done = wrong_by(STEPS, 2, 0.1 * DEG)
    intervals = segment([told(done)], STEPS, NOMINAL, [1.0])
    for one, step, was in zip(intervals, STEPS, done, strict=True):
        counted = NOMINAL.scale * (one.plus - one.minus)
        if isinstance(step, Position):
            shown = one.attitude @ WHERE.f_g
            np.testing.assert_allclose(counted[3:], shown, rtol=0, atol=1e-7 * one.seconds)
        else:
            # half a sample of the Earth's rate, and the part of a step in which the turn begins or ends
            shown = one.turned + one.attitude @ WHERE.w_g
            np.testing.assert_allclose(counted[:3], shown, rtol=0, atol=0.3 * ARCSEC)
            np.testing.assert_allclose(one.turned, was.turned, rtol=0, atol=1e-9)
    plain = segment([replace(told(done), encoder=None)], STEPS, NOMINAL, [1.0])
    off = [
        np.abs(NOMINAL.scale[3:] * (one.plus - one.minus)[3:] - one.attitude @ WHERE.f_g).max() / one.seconds
        for one in plain[:4]
    ]
    assert max(off) > 0.05 * DEG * 9.8


def test_a_plan_that_the_encoder_denies_is_refused_by_step():
    done = [
        replace(STEPS[0]),
        Position("x", STEPS[1].C_gb @ Oracle.from_rotvec([0.0, 0.07, 0.0]).as_matrix(), 12.0),
    ]
    done += STEPS[2:]
    with pytest.raises(Disagreement) as error:
        segment([told(done)], STEPS, NOMINAL, [1.0])
    assert str(error.value) == (
        "step 2 (NUE): the table's encoder tells an attitude, about NUE, 4.0 deg from the plan's"
    )


def test_an_encoder_that_tells_another_turn_is_refused():
    whole = told(STEPS)
    assert whole.encoder is not None
    still = whole.encoder.C_gb.copy()
    # it stands still while the unit turns: the readings after the fourth position stay what they are there
    since = int(np.searchsorted(whole.encoder.time, 70.0))
    still[since:] = np.where(np.abs(still[since:] - STEPS[4].C_gb).max() < 2.1, STEPS[4].C_gb, still[since:])
    with pytest.raises(
        Disagreement, match=r"step 5 \(\+x\): the plan turns by \[360, 0, 0\] .* the table's encoder"
    ):
        segment([replace(whole, encoder=Encoder(whole.encoder.time, still))], STEPS, NOMINAL, [1.0])


def test_a_rest_without_a_reading_is_named():
    whole = told(STEPS)
    assert whole.encoder is not None
    late = whole.encoder.time > 20.0
    encoder = Encoder(whole.encoder.time[late], whole.encoder.C_gb[late])
    with pytest.raises(Disagreement, match=r"step 1 \(ENU\): no angle of the table in it \(made\)"):
        segment([replace(whole, encoder=encoder)], STEPS, NOMINAL, [1.0])


def test_what_is_not_known_of_the_table_is_as_drawn():
    """Against 4000 tables that rest and turn wrong: their sums have that covariance."""
    attitude, turn, seconds = 3e-4, 1e-4, 20.0
    C, axis = faces("SUW"), np.array([0.6, 0.0, 0.8])
    rest = Interval("r", False, 0.0, seconds, np.zeros(3), *resting(C, seconds))
    angle = np.linspace(0.0, 1.0, 50)
    spins = [
        Interval("s", True, 0.0, seconds, sign * 2.0 * np.pi * AXES[0], *turning(
            C, sign * 2.0 * np.pi * AXES[0], angle, np.full(49, seconds / 49)))
        for sign in (1.0, -1.0)
    ]  # fmt: skip
    rng = np.random.default_rng(3)
    accel, gyro = [], []
    f_b = C.T @ [0.0, 0.0, 9.80665]
    for _ in range(4000):
        e = attitude * rng.standard_normal(3)
        accel.append(axis @ np.cross(f_b, e) * seconds)
        gyro.append([axis @ (np.cross(s.turned, e) + turn * rng.standard_normal() * AXES[0]) for s in spins])
    np.testing.assert_allclose(
        unsure([rest], axis, False, attitude, turn), np.var(accel), rtol=4.0 * np.sqrt(2.0 / 4000)
    )
    want = np.cov(np.array(gyro).T)
    found = unsure(spins, axis, True, attitude, turn)
    np.testing.assert_allclose(found, want, rtol=0, atol=5.0 * np.sqrt(2.0 / 4000) * want[0, 0])
    assert found[0, 1] < -0.5 * found[0, 0]
