"""What plans do not show is named, and what is proposed shows it."""

from __future__ import annotations

import numpy as np
import pytest

from nav.calibrate.model import NUISANCE
from nav.calibrate.observability import observe, propose
from nav.calibrate.plan import Position, Rotation, faces, letters_of
from nav.calibrate.solve import fit
from nav.imu.geometry import cone
from tests.nav.calibrate.making import (
    AXES,
    FACES_12,
    NOISE,
    ORTHOGONAL_AND_SKEW,
    SKEW,
    TABLE_2_12,
    Unit,
    model,
    place,
    positions,
    rotations,
)


@pytest.mark.parametrize("letters", [TABLE_2_12, FACES_12])
def test_three_axes_are_seen_by_the_usual_plans(letters):
    seen = observe(model(AXES), [*positions(letters), *rotations()], NOISE)
    assert seen.unseen == ()
    assert np.all(np.isfinite(seen.sigma))


def test_promised_sigmas_are_those_of_the_fit():
    steps = [*positions(FACES_12), *rotations()]
    where = place()
    of = model(AXES, where)
    unit = Unit.draw(AXES, np.random.default_rng(1))
    found = fit(of, unit.count(steps, where), NOISE)
    # the unit differs from the nominal one by a part in a thousand, and its counts split by their signs
    np.testing.assert_allclose(observe(of, steps, NOISE).sigma, found.sigma, rtol=0.05)


def test_without_rotations_the_gyros_scales_are_missing():
    """The Earth's rate shows them all the same, a thousand times worse: the plan is refused for asymmetry."""
    seen = observe(model(AXES), positions(FACES_12), NOISE)
    rotated = observe(model(AXES), [*positions(FACES_12), *rotations()], NOISE)
    scale = seen.names.index("gyro 0 scale")
    assert seen.sigma[scale] > 1000.0 * rotated.sigma[scale]


def test_rotations_one_way_do_not_show_the_asymmetry_of_gyros():
    one_way = [step for step in rotations() if isinstance(step, Rotation) and step.rate > 0.0]
    seen = observe(model(AXES), one_way, NOISE)
    named = {name for names in seen.unseen for name in names}
    assert {f"gyro {k} asymmetry" for k in range(3)} <= named
    assert any("accel" in name for name in named)


def test_one_axis_without_rotation_is_named():
    kept = [step for step in rotations() if abs(step.turned[2]) < 1e-9]
    flat = [step for step in positions(FACES_12) if letters_of(step.C_gb)[2] not in "UD"]
    seen = observe(model(AXES), [*flat, *kept], NOISE)
    named = [name for names in seen.unseen for name in names]
    assert any(name.startswith("accel 2") for name in named)
    assert not any(name.startswith(("accel 0", "accel 1")) and name.endswith("bias") for name in named)


def test_face_positions_do_not_separate_asymmetry_and_bias_on_the_space_diagonals():
    """FIGURES of the redundant unit: rank 2 of (K+, K-, bias) on S and T, whatever the number of faces."""
    steps = [*positions(FACES_12), *rotations()]
    of = model(ORTHOGONAL_AND_SKEW)
    seen = observe(of, steps, NOISE)
    assert sorted(sorted(names) for names in seen.unseen) == [
        ["accel 3 asymmetry", "accel 3 bias"],
        ["accel 4 asymmetry", "accel 4 bias"],
    ]
    # the same by hand: with |E| equal in every position the three columns of K+, K-, bias have rank 2
    for axis in SKEW:
        reading = np.array([faces(letters).T[:, 2] @ axis for letters in FACES_12])
        design = np.column_stack((np.maximum(reading, 0), np.minimum(reading, 0), np.ones(12)))
        assert np.linalg.matrix_rank(design) == 2


def test_face_positions_are_enough_on_the_cone():
    """Its sensors are 54.74 deg from x, and from y and z by other angles."""
    of = model(cone())
    steps = [*positions(FACES_12), *rotations()]
    assert observe(of, steps, NOISE).unseen == ()
    assert propose(of, steps, NOISE, 60.0) == []


@pytest.mark.parametrize("axes", [ORTHOGONAL_AND_SKEW, SKEW], ids=["five", "two"])
def test_what_is_proposed_shows_everything(axes):
    steps = [*positions(FACES_12), *rotations()]
    of = model(axes)
    more = propose(of, steps, NOISE, 60.0)
    assert 1 <= len(more) <= 4
    assert all(isinstance(step, Position) and letters_of(step.C_gb) is None for step in more)
    assert observe(of, [*steps, *more], NOISE).unseen == ()
    # and with them every coefficient comes back
    where = place()
    unit = Unit.draw(axes, np.random.default_rng(2))
    found = fit(of, unit.count([*steps, *more], where), NOISE)
    error = (found.theta[: -len(NUISANCE)] - unit.truth(of)) / found.sigma[: -len(NUISANCE)]
    assert np.abs(error).max() < 0.5


def test_nothing_is_proposed_where_nothing_is_missing():
    assert propose(model(AXES), [*positions(TABLE_2_12), *rotations()], NOISE, 60.0) == []


def test_from_nothing_a_whole_plan_is_proposed():
    of = model(AXES)
    plan = propose(of, positions(("ENU",)), NOISE, 60.0)
    assert any(isinstance(step, Rotation) for step in plan)
    assert observe(of, [*positions(("ENU",)), *plan], NOISE).unseen == ()
