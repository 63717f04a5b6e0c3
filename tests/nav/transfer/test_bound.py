"""The bound against closed forms and against what the filters reach; and what can be known at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav import rotation as rot
from nav.align.types import TransferConfig
from nav.earth import curvature, position_matrix
from nav.strapdown.mechanize import frame_rates
from nav.transfer import matching, model
from nav.transfer.bound import bound, whole
from nav.transfer.stage import Transfer
from nav.transfer.states import ACCEL_BIAS, GYRO_BIAS, MOUNTING, PHI, SIZE, VELOCITY, X_REST, X_SIZE
from nav.types import MasterState
from tests.nav.transfer.making import Set, config, dynamics, fly, s_turns, shown, straight


def ideal(s):
    """That flight without an error."""
    zero = dict.fromkeys(("mounting", "gyro_bias", "accel_bias", "arw", "vrw"), 0.0)
    noise = dict.fromkeys(("sigma_v", "sigma_att", "sigma_pos", "sigma_rate"), 0.0)
    return fly(replace(s, flexure=None, **zero, **noise)).samples


def sigmas(s, which, told):
    """Of phi (3,), rad, as the filter of a matching says it at its reports on that flight, by their times."""
    state, said = Transfer(told, which), {}
    for sample in ideal(s):
        if isinstance(sample, MasterState):
            state.message(sample)
            continue
        assert state.inertial(sample) is None
        if state.status.transfer is not None:
            said[sample.t_ns] = np.array(state.status.transfer.progress.sigma)
    return said


def test_level_in_straight_flight() -> None:
    """Tilt and accelerometer bias are one: sigma is bias / g about both axes; heading is as built."""
    s = Set(profile=straight, seconds=5.0)
    _, sigma = bound(config(s), matching.VELOCITY_5, ideal(s))
    # the mounting of 8.7 mrad adds 0.7 % of information, the pitch of 0.03 rad 0.1 %
    assert sigma[-1, PHI][:2] == pytest.approx(s.accel_bias / 9.8, rel=0.02)
    assert sigma[-1, PHI][2] == pytest.approx(s.mounting, rel=0.03)


def test_a_filter_of_all_states_reaches_it() -> None:
    """The 16-state filter under wing rock is within 1.1 of the bound; its own sigma is never below it."""
    s = Set(seconds=5.5)
    times, sigma = bound(config(s), matching.ATTITUDE_16, ideal(s))
    reached = sigmas(s, matching.ATTITUDE_16, config(s))
    assert set(reached) == set(times.tolist())
    for t, least in zip(times.tolist(), sigma[:, PHI], strict=True):
        assert np.all(reached[t] > 0.999 * least)
    assert np.all(reached[int(times[-1])] < 1.1 * sigma[-1, PHI])


def test_velocity_shows_the_level_to_who_estimates_the_sensors_too() -> None:
    """S-turns part tilts from accelerometers: eleven states reach the bound, five stay above it.

    The master's vertical velocity wanders, so that there is nothing in it for the bound to take. Mounting
    and scale, which the eleven leave out too, are worth less than a hundredth. Five states leave the
    accelerometers' 1 mg where it is.
    """
    s = Set(profile=s_turns(period=60.0, amplitude=0.4), seconds=60.0, imu_hz=20.0, master_hz=1.0)
    told = config(s, vertical_walk=0.05)
    times, sigma = bound(told, matching.VELOCITY_11, ideal(s))
    least, end = sigma[-1, PHI], int(times[-1])
    assert np.all(sigmas(s, matching.VELOCITY_11, told)[end] < 1.02 * least)
    assert np.all(sigmas(s, matching.VELOCITY_5, told)[end] > 1.3 * least)


def observed(which, attitudes):
    """Rank of the observability of velocity, phi, biases (and mounting), over straight legs with these rolls.

    Each leg's dynamics are constant; a leg adds the rows of its own, as errors stay between them.
    """
    keep = [*range(SIZE)[VELOCITY], *range(SIZE)[PHI], *range(SIZE)[GYRO_BIAS], *range(SIZE)[ACCEL_BIAS]]
    if any(which.attitude):
        keep += range(SIZE)[MOUNTING]
    scale = 500.0  # s, so that rates of the Earth count
    unit = np.ones(SIZE)
    unit[VELOCITY], unit[GYRO_BIAS], unit[ACCEL_BIAS] = 9.8 * scale, 1.0 / scale, 9.8
    transfer = TransferConfig(latency=0.0)
    blocks = []
    for roll in attitudes:
        q = rot.quat_from_euler(0.4, 0.03, roll)
        C = rot.dcm_from_quat(q)
        x = np.zeros(X_SIZE)
        x[0:4], x[4:7], x[16] = q, (60.0, 190.0, 0.0), 3000.0
        x[7:16] = position_matrix(0.6, 0.3).ravel()
        x[X_REST : X_REST + 3] = C.T @ [0.0, 0.0, 9.8]
        frame = frame_rates(x[13:16], 3000.0, x[4:7])
        k = curvature(*x[13:16].tolist(), 3000.0)
        F = dynamics(C, C.T @ [0.0, 0.0, 9.8], np.zeros(3), x[4:7], frame, k, x[X_REST : X_REST + 3])
        m = MasterState(0, 0.6, 0.3, 3000.0, x[4:7], q, None, None, *(np.ones(3),) * 3, True, "")
        kinds = [model.velocity_rows] + ([model.attitude_rows] if any(which.attitude) else [])
        H = [shown(kind, x, np.zeros(3), m, transfer)[1] for kind in kinds]
        rows = np.concatenate(H)[:, keep] * unit[keep]
        rows[:3] /= unit[VELOCITY.start]
        A = (F[np.ix_(keep, keep)] * unit[keep] / unit[keep][:, None]) * scale
        power = rows
        for _ in range(len(keep)):
            blocks.append(power / max(1.0, float(np.abs(power).max())))
            power = power @ A
    values = np.linalg.svd(np.concatenate(blocks), compute_uv=False)
    return int(np.sum(values > 1e-9 * values[0])), len(keep)


@pytest.mark.parametrize(
    ("which", "rolls", "rank"),
    [
        # the two tilts hide in the accelerometers, heading in the east gyro: 9 of 12, as on a standing base
        (matching.VELOCITY_5, [0.0], (9, 12)),
        # attitude adds three rows and three states: what hides takes the mounting along
        (matching.ATTITUDE_16, [0.0], (12, 15)),
        # roll turns mounting and accelerometers against the vertical: everything shows
        (matching.ATTITUDE_16, [0.0, 0.5], (15, 15)),
    ],
)
def test_what_can_be_known(which, rolls, rank) -> None:
    assert observed(which, rolls) == rank


def test_whole() -> None:
    """Takes the same rows, and leaves nothing to be copied or considered."""
    one = whole(matching.POSITION_10)
    assert np.all(one.mask == 1.0)
    assert one.position == (1, 1, 1)
    assert one.velocity == (0, 0, 1)
    assert one.attitude == (0, 0, 0)
