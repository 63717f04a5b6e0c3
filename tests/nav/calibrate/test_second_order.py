"""Squares and products of specific force: what plans show of them, and their estimates."""

import numpy as np
import pytest

from nav.calibrate.coefficients import coefficients
from nav.calibrate.observability import observe, propose
from nav.calibrate.plan import Position
from nav.calibrate.solve import fit
from nav.rotation import dcm_from_euler
from tests.nav.calibrate.making import (
    AXES,
    DEG,
    FACES_12,
    NOISE,
    SKEW,
    G,
    Terms,
    Unit,
    model,
    place,
    positions,
    rotations,
)

SECOND = Terms(second_order=True)
EDGES = [
    Position(f"edge {k}", dcm_from_euler(*np.radians(angles)), 60.0)
    for k, angles in enumerate(
        (
            (0.0, 45.0, 0.0),
            (90.0, -45.0, 0.0),
            (180.0, 0.0, -45.0),
            (270.0, 0.0, 45.0),
            (0.0, 45.0, -90.0),
            (180.0, 45.0, 90.0),
        )
    )
]  # heading, pitch, roll
PLAN = [*positions(FACES_12), *EDGES, *rotations()]


def drawn(seed, axes=AXES):
    """A unit with the terms of the model: of gyros products, of accelerometers those with their own axis."""
    rng = np.random.default_rng(seed)
    unit = Unit.draw(axes, rng)
    n = len(axes)
    off = rng.standard_normal((n, 3, 3)) * 0.3 * DEG / 3600.0 / G**2 * (1.0 - np.eye(3))
    unit.second[:n] = 0.5 * (off + off.swapaxes(1, 2))
    own = rng.standard_normal((n, 3)) * 30e-6 / G
    mixed = axes[:, :, None] * own[:, None, :]
    unit.second[n:] = 0.5 * (mixed + mixed.swapaxes(1, 2))
    return unit, rng


def test_faces_show_no_product_and_no_square_apart_from_asymmetry():
    """A sensor that only feels +g, 0 and -g cannot tell f^2 from |f|."""
    seen = observe(model(AXES, terms=SECOND), [*positions(FACES_12), *rotations()], NOISE)
    unseen = {frozenset(names) for names in seen.unseen}
    gyros = {frozenset((f"gyro {k} product {two}",)) for k in range(3) for two in ("yz", "zx", "xy")}
    own = {frozenset((f"accel {k} square", f"accel {k} asymmetry")) for k in range(3)}
    across = {frozenset((f"accel {k} product toward {x}",)) for k in range(3) for x in "xyz" if x != "xyz"[k]}
    assert unseen == gyros | own | across


def test_the_steps_proposed_show_them():
    steps = [*positions(FACES_12), *rotations()]
    of = model(AXES, terms=SECOND)
    more = propose(of, steps, NOISE, 60.0)
    assert 0 < len(more) <= 6
    assert observe(of, [*steps, *more], NOISE).unseen == ()
    # edges or corners, of course: on a face nothing is new
    for one in more:
        assert np.sort(np.abs(one.C_gb[2]))[1] > 0.5


@pytest.mark.parametrize("axes", [AXES, SKEW], ids=["along", "skewed"])
def test_without_noise_they_come_back(axes):
    """With a perfect table, of which nothing is in the products."""
    where = place(1e-9, 1e-9, 1e-9)
    unit, _ = drawn(11, axes)
    of = model(axes, where, SECOND)
    found = fit(of, unit.count(PLAN, where), NOISE)
    np.testing.assert_allclose(found.theta[:-4], unit.truth(of), rtol=1e-6, atol=1e-11)


@pytest.mark.parametrize("axes", [AXES, SKEW], ids=["along", "skewed"])
def test_the_files_squares_and_products_are_the_same_form(axes):
    where = place(1e-9, 1e-9, 1e-9)
    unit, rng = drawn(12, axes)
    found = fit(model(axes, where, SECOND), unit.count(PLAN, where), NOISE)
    n = len(axes)
    for gyros, part in ((True, slice(0, n)), (False, slice(n, 2 * n))):
        got = coefficients(found, gyros)
        assert ("square" in got.value) != gyros
        along = np.sum(unit.axes[part] * [one.axis for one in found.model.sensors[part]], axis=1)
        for f in G * rng.standard_normal((5, 3)):
            x, y, z = f
            value = got.value["product"] @ [y * z, z * x, x * y]
            if not gyros:
                value = value + got.value["square"] @ (f * f)
            wanted = np.einsum("i,nij,j->n", f, unit.second[part], f) / along
            np.testing.assert_allclose(value, wanted, rtol=1e-4, atol=1e-6 * np.abs(wanted).max())
        if gyros:
            of = found.model
            assert got.sigma["product"][0, 1] == pytest.approx(found.sigma[of.index(0, "product zx")])


def test_errors_are_as_large_as_their_sigmas():
    """20 units with white noise and a table's errors: coverage of the second-order terms alone."""
    where = place()
    white = type(NOISE)(NOISE.gyro_walk, 1e-12, NOISE.accel_walk, 1e-12, NOISE.correlation)
    of = model(AXES, where, SECOND)
    second = [k for k, name in enumerate(of.names) if "square" in name or "product" in name]
    errors, rest = [], []
    for seed in range(20):
        unit, rng = drawn(300 + seed)
        delta = rng.standard_normal(3) * np.array([where.tilt, where.tilt, where.north])
        gravity = float(rng.standard_normal() * where.gravity_sigma)
        found = fit(of, unit.count(PLAN, where, delta, gravity, rng, white), white)
        truth = np.concatenate((unit.truth(of), delta, [gravity]))
        error = (found.theta - truth) / found.sigma
        errors.append(error[second])
        rest.append(np.delete(error, second))
    # 18 terms of 6 sensors: 120 independent samples at the least, 0.9545 +- 0.019 (one sigma), 3.3 of these
    for part in (errors, rest):
        assert np.mean(np.abs(part) < 2.0) > 0.892
        assert np.abs(part).max() < 4.5


def test_a_unit_with_them_does_not_fit_a_model_without():
    """30 ug/g^2 beside half a microgee of noise in a minute: the residuals say so."""
    where = place()
    unit, rng = drawn(5)
    quiet = type(NOISE)(NOISE.gyro_walk, 1e-12, 0.1 * NOISE.accel_walk, 1e-12, NOISE.correlation)
    intervals = unit.count(PLAN, where, rng=rng, noise=quiet)
    assert fit(model(AXES, where), intervals, quiet).inflation > 2.0
    assert fit(model(AXES, where, SECOND), intervals, quiet).inflation == 1.0
