"""From samples to the plan's intervals: found where they are, and refused by name where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav.calibrate.plan import Position, faces
from nav.calibrate.segments import SETTLE_S, Disagreement, segment
from nav.calibrate.stream import Nominal, Stream
from tests.nav.calibrate.making import ARCSEC, AXES, DEG, place, positions, rotations

RATE = 20.0
REST_S = 6.0
STEPS = [*positions(("ENU", "NUE", "UEN", "WNU"[::1].replace("WNU", "NWU")), 12.0), *rotations(40.0, 1)]
NOMINAL = Nominal(3, np.vstack((AXES, AXES)), np.repeat((0.1 * ARCSEC, 2e-5), 3), np.zeros(6))
WHERE = place()


def course(steps):
    """Attitudes C_gb (k + 1, 3, 3) of a table that turns at 40 deg/s between rests, 20 times a second."""
    held = [steps[0].C_gb]

    def hold(seconds):
        held.extend([held[-1]] * round(seconds * RATE))

    def turn(axis, angle):
        count = max(1, round(abs(angle) / (40.0 * DEG) * RATE))
        start, K = held[-1], np.cross(np.eye(3), axis)
        for k in range(1, count + 1):
            a = angle * k / count
            held.append(start @ (np.eye(3) + np.sin(a) * K + (1.0 - np.cos(a)) * K @ K))

    for step in steps:
        R = held[-1].T @ step.C_gb
        angle = np.arccos(np.clip(0.5 * (np.trace(R) - 1.0), -1.0, 1.0))
        if angle > 1e-6:
            values, vectors = np.linalg.eig(R)
            axis = np.real(vectors[:, np.argmin(np.abs(values - 1.0))])
            skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
            turn(axis * (np.sign(axis @ skew) or 1.0), angle)
            held[-1] = step.C_gb
        if isinstance(step, Position):
            hold(step.seconds)
        else:
            hold(REST_S)
            turn(step.axis, float(step.turned @ step.axis))
            held[-1] = step.C_gb
            hold(REST_S)
    return np.array(held)


def stream(steps, name="made"):
    """Counts, not whole, of perfect sensors."""
    C = course(steps)
    R = np.einsum("kji,kjl->kil", C[:-1], C[1:])
    angle = np.arccos(np.clip(0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    skew = np.stack((R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]), axis=1)
    factor = np.where(angle > 1e-9, angle / (2.0 * np.maximum(np.sin(angle), 1e-12)), 0.5)
    dtheta = factor[:, None] * skew + np.einsum("kji,j->ki", C[:-1], WHERE.w_g) / RATE
    dv = np.einsum("kji,j->ki", C[:-1], WHERE.f_g) / RATE
    counts = np.concatenate((dtheta, dv), axis=1) / NOMINAL.scale
    return Stream(name, 0.0, np.full(len(counts), 1.0 / RATE), counts, {})


WHOLE = stream(STEPS)


def found(one, steps=STEPS):
    streams = one if isinstance(one, list) else [one]
    return segment(streams, steps, NOMINAL, [1.0] * len(streams))


def test_every_step_is_found_with_its_counts():
    intervals = found(WHOLE)
    assert [one.name for one in intervals] == [step.name for step in STEPS]
    for interval, step in zip(intervals, STEPS, strict=True):
        shown = np.concatenate(
            (step_turned(step) + interval.attitude @ WHERE.w_g, interval.attitude @ WHERE.f_g)
        )
        counted = NOMINAL.scale * (interval.plus - interval.minus)
        if isinstance(step, Position):
            assert interval.seconds == pytest.approx(step.seconds - 2.0 * SETTLE_S, abs=0.5)
            np.testing.assert_allclose(counted, shown, rtol=0, atol=1e-9 * interval.seconds)
        else:
            # gyros: whole turns, and the Earth's rate as it turns with the unit: half a sample of 50 ms of it
            assert interval.seconds == pytest.approx(9.0 + 2.0 * SETTLE_S, abs=0.3)
            np.testing.assert_allclose(counted[:3], shown[:3], rtol=0, atol=0.1 * ARCSEC)


def step_turned(step):
    return np.zeros(3) if isinstance(step, Position) else step.turned


def test_captures_may_be_one_for_each_part():
    parts = [stream(STEPS[:2], "a"), stream(STEPS[2:6], "b"), stream(STEPS[6:], "c")]
    whole = found(WHOLE)
    for one, two in zip(whole, found(parts), strict=True):
        np.testing.assert_allclose(two.plus / two.seconds, one.plus / one.seconds, rtol=1e-2, atol=2.0)


def test_a_bias_does_not_hide_the_rests():
    rate = np.array([0.6, -0.5, 0.4, 0.0, 0.0, 0.0]) * DEG / RATE
    biased = replace(WHOLE, counts=WHOLE.counts + rate / NOMINAL.scale)
    assert len(found(biased)) == len(STEPS)


def refused(one, steps=STEPS):
    with pytest.raises(Disagreement) as error:
        found(one, steps)
    return str(error.value)


def test_a_missing_position_is_named():
    said = refused(stream([*STEPS[:1], *STEPS[2:]]))
    assert said == "step 2 (NUE): missing: the capture goes on with step 3 (UEN)"
    assert refused(stream(STEPS[:3])) == "step 4 (NWU): missing: the capture ends before it"
    assert refused(stream(STEPS[:-1])).startswith("step 10 (-z): missing: the capture ends")


def test_another_attitude_than_planned_is_named():
    other = [*STEPS[:2], Position("x", faces("DES"), 12.0), *STEPS[3:]]
    assert refused(stream(other)).startswith(
        "step 3 (UEN): up is 180 deg from where the plan has it: along [-1"
    )
    heading = [*STEPS[:3], Position("x", faces("ENU"), 12.0), *STEPS[4:]]
    assert refused(stream(heading)) == (
        "step 4 (NWU): the unit was turned, to about ENU, which is 90 deg from the plan's attitude"
    )


def test_a_rotation_that_went_another_way_is_named():
    other = [*STEPS[:4], replace(STEPS[4], rate=-STEPS[4].rate), *STEPS[5:]]
    said = refused(stream(other))
    assert said.startswith(
        "step 5 (+x): the plan turns by [360, 0, 0] deg about x, y, z, the capture by [-360"
    )


def test_a_short_rest_is_named():
    short = [*STEPS[:1], replace(STEPS[1], seconds=7.0), *STEPS[2:]]
    assert refused(stream(short)) == "step 2 (NUE): rested 7 s, the plan says 12 s"


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ([1, 0, 2, 3, 4, 5], "the gyros' axes are swapped: the plan's x is the capture's y, the plan's y is"),
        (
            [0, 1, 2, 5, 4, 3],
            "the accelerometers' axes are swapped: the plan's x is the capture's z, the plan's z",
        ),
        (
            [1, 2, 0, 4, 5, 3],
            "the unit is mounted with other axes than the plan's: the plan's x is the capture's z",
        ),
    ],
)
def test_swapped_axes_are_told_from_wrong_positions(columns, said):
    assert refused(replace(WHOLE, counts=WHOLE.counts[:, columns])).startswith(said)


def test_a_turned_round_accelerometer_is_told():
    signs = np.array([1.0, 1.0, 1.0, 1.0, -1.0, 1.0])
    said = refused(replace(WHOLE, counts=WHOLE.counts * signs))
    assert said == "the accelerometers' axes are swapped: the plan's y is the capture's -y"


def test_bad_samples_are_refused_where_they_are_used_and_only_there():
    places = np.zeros(len(WHOLE.dt), dtype=bool)
    places[100:103] = True  # 5 s into the first rest
    said = refused(replace(WHOLE, bad={"saturated counts": places}))
    assert said == "ENU: saturated counts in 3 samples (made)"
    places[:] = False
    places[round(13.0 * RATE)] = True  # on the way to the second
    assert len(found(replace(WHOLE, bad={"saturated counts": places}))) == len(STEPS)


def test_nothing_that_rests_is_no_plan():
    moving = np.zeros((400, 6))
    moving[:, 0] = np.linspace(3000.0, 9000.0, 400)
    assert refused(Stream("m", 0.0, np.full(400, 0.05), moving, {})).endswith(
        "the capture has no rest at all"
    )
