"""The joint solution: exact without noise for sensors on any axes, honest with it."""

from __future__ import annotations

import numpy as np
import pytest

from nav.calibrate.checks import moved
from nav.calibrate.coefficients import coefficients
from nav.calibrate.intervals import covariance
from nav.calibrate.model import Terms
from nav.calibrate.plan import Position, planned
from nav.calibrate.solve import fit
from nav.imu.geometry import cone
from tests.nav.calibrate.making import (
    ARCSEC,
    AXES,
    FACES_12,
    NOISE,
    ORTHOGONAL_AND_SKEW,
    TABLE_2_12,
    G,
    Unit,
    model,
    place,
    positions,
    rotations,
)

EDGE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]]) / np.sqrt([[1.0], [2.0], [2.0]])


def edges() -> list[Position]:
    """Attitudes with an edge of the unit up, which sensors on the space diagonals need."""
    return [
        Position(f"edge {k}", EDGE @ np.roll(AXES, k, axis=0) * (1.0 if k < 3 else -1.0), 60.0)
        for k in range(3)
    ]


@pytest.mark.parametrize(
    ("axes", "steps"),
    [
        (AXES, [*positions(TABLE_2_12), *rotations()]),
        (AXES, [*positions(FACES_12), *rotations()]),
        (ORTHOGONAL_AND_SKEW, [*positions(FACES_12), *edges(), *rotations()]),
        (cone(), [*positions(FACES_12), *edges(), *rotations()]),
    ],
    ids=["three, eight positions", "three, twelve", "five", "cone of six"],
)
def test_every_coefficient_and_the_table_come_back(axes, steps):
    rng = np.random.default_rng(5)
    where = place()
    unit = Unit.draw(axes, rng)
    delta = np.array([15.0, -25.0, 40.0]) * ARCSEC
    of = model(axes, where)
    found = fit(of, unit.count(steps, where, delta), NOISE)
    assert found.steps <= 4
    truth = np.concatenate((unit.truth(of), delta, [0.0]))
    # the priors pull the table's errors towards zero by what the plan shows of them, which is part of the
    # sigma and must be well inside it
    error = (found.theta - truth) / found.sigma
    assert np.abs(error).max() < 2.0
    assert found.chi2 < 10.0
    assert found.inflation == 1.0


def test_with_a_perfect_table_it_is_exact():
    """What is left is rounding: 1e8 pulses in double and the priors of 1e-9."""
    where = place(1e-9, 1e-9, 1e-9)
    unit = Unit.draw(AXES, np.random.default_rng(6))
    of = model(AXES, where)
    found = fit(of, unit.count([*positions(FACES_12), *rotations()], where), NOISE)
    np.testing.assert_allclose(found.theta[:-4], unit.truth(of), rtol=1e-7, atol=1e-11)


def test_errors_are_as_large_as_their_sigmas():
    """20 units with white noise: pooled coverage of two sigmas, and chi-square against its degrees."""
    steps = [*positions(FACES_12), *rotations()]
    where = place()
    white = type(NOISE)(NOISE.gyro_walk, 1e-12, NOISE.accel_walk, 1e-12, NOISE.correlation)
    errors, chi2 = [], []
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        unit = Unit.draw(AXES, rng)
        delta = rng.standard_normal(3) * np.array([where.tilt, where.tilt, where.north])
        gravity = float(rng.standard_normal() * where.gravity_sigma)
        of = model(AXES, where)
        found = fit(of, unit.count(steps, where, delta, gravity, rng, white), white)
        truth = np.concatenate((unit.truth(of), delta, [gravity]))
        errors.append((found.theta - truth) / found.sigma)
        chi2.append(found.chi2 / found.freedom)
    # 20 units of 6 sensors: 120 independent samples at the least, 0.9545 +- 0.019 (one sigma), 3.3 of these
    inside = np.mean(np.abs(errors) < 2.0)
    assert inside > 0.892
    assert np.abs(errors).max() < 4.5
    # pulses are not rounded here but the covariance allows for it: a few percent below 1; the mean of 20
    # with 51 degrees of freedom each scatters by 0.045
    assert 0.8 < np.mean(chi2) < 1.15


def test_residuals_beyond_the_noise_widen_the_sigmas():
    steps = [*positions(FACES_12), *rotations()]
    where = place()
    rng = np.random.default_rng(7)
    unit = Unit.draw(AXES, rng)
    loud = type(NOISE)(4 * NOISE.gyro_walk, 1e-12, 4 * NOISE.accel_walk, 1e-12, NOISE.correlation)
    quiet = type(NOISE)(NOISE.gyro_walk, 1e-12, NOISE.accel_walk, 1e-12, NOISE.correlation)
    of = model(AXES, where)
    intervals = unit.count(steps, where, rng=rng, noise=loud)
    found = fit(of, intervals, quiet)
    # four times the noise, less what rounding was allowed for
    assert 2.5 < found.inflation < 5.0
    assert moved(found, intervals, quiet) is None


@pytest.mark.parametrize("terms", [Terms(False, True), Terms(True, False), Terms(False, False)])
def test_terms_that_are_not_there_are_not_estimated(terms):
    where = place()
    unit = Unit.draw(AXES, np.random.default_rng(8), asymmetry=0.0 if not terms.asymmetry else 1e-4)
    unit.g[:] *= terms.g_sensitivity
    of = model(AXES, where, terms)
    found = fit(of, unit.count([*positions(TABLE_2_12), *rotations()], where), NOISE)
    np.testing.assert_allclose(
        found.theta[:-4] / found.sigma[:-4], unit.truth(of) / found.sigma[:-4], atol=0.1
    )
    value = coefficients(found, True).value
    assert np.array_equal(value["scale"], value["scale_negative"]) != terms.asymmetry
    assert bool(np.any(value["g_sensitivity"])) == terms.g_sensitivity


def test_coefficients_are_those_of_the_compensation():
    where = place(1e-9, 1e-9, 1e-9)
    unit = Unit.draw(AXES, np.random.default_rng(9))
    found = fit(model(AXES, where), unit.count([*positions(FACES_12), *rotations()], where), NOISE)
    for gyros, part in ((True, slice(0, 3)), (False, slice(3, 6))):
        got = coefficients(found, gyros)
        along = np.diag(unit.axes[part])
        np.testing.assert_allclose(got.value["scale"], unit.plus[part] / along, rtol=1e-9)
        np.testing.assert_allclose(got.value["scale_negative"], unit.minus[part] / along, rtol=1e-9)
        np.testing.assert_allclose(got.value["axes"], unit.axes[part] / along[:, None], atol=1e-9)
        np.testing.assert_allclose(got.value["bias"], unit.bias[part] / along, rtol=1e-6)
        # the scale upwards is that of the model less half its asymmetry: sigma by the same combination
        k = 0 if gyros else 3
        of = found.model
        row = np.zeros(of.size)
        row[of.index(k, "scale")], row[of.index(k, "asymmetry")] = 1.0, -0.5
        sigma = of.sensors[k].scale * np.sqrt(row @ found.covariance @ row)
        assert got.sigma["scale"][0] == pytest.approx(sigma, rel=1e-9)
        assert np.all(np.diag(got.sigma["axes"]) == 0.0)


def test_a_table_that_was_moved_is_found():
    steps = [*positions(FACES_12), *rotations()]
    where = place()
    rng = np.random.default_rng(10)
    unit = Unit.draw(AXES, rng)
    of = model(AXES, where)
    before = unit.count(steps, where, rng=rng)
    after = unit.count(steps, where, np.array([200.0, 100.0, 0.0]) * ARCSEC, rng=rng)
    changed = [*before[:5], *after[5:]]
    said = moved(fit(of, changed, NOISE), changed, NOISE)
    assert said is not None
    assert said.startswith(
        "the table was moved before NUE" if FACES_12[5] == "NUE" else "the table was moved"
    )
    assert FACES_12[5] in said
    alone = [*before[:5], after[5], *before[6:]]
    said = moved(fit(of, alone, NOISE), alone, NOISE)
    assert said is not None
    assert said.startswith(f"the table does not stand in {FACES_12[5]} where the plan has it: by [")
    assert moved(fit(of, before, NOISE), before, NOISE) is None


def test_covariance_of_sums_is_that_of_the_process():
    """Against the double integral of exp(-|t - s| / tau) by brute force."""
    steps = planned(positions(("ENU", "NWU", "WSU"), 50.0))
    walk, sigma, tau, pulse = 2e-3, 3e-3, 120.0, 1e-2
    t = (np.arange(3000) + 0.5) * 0.05
    kernel = sigma**2 * np.exp(-np.abs(t[:, None] - t[None, :]) / tau) * 0.05**2
    brute = kernel.reshape(3, 1000, 3, 1000).sum(axis=(1, 3))
    brute += np.eye(3) * (walk**2 * 50.0 + pulse**2 / 6.0)
    got = covariance(steps, walk, sigma, tau, pulse)
    # the midpoint rule is off by (0.05 / 120)^2 and by the kernel's edge on the diagonal
    np.testing.assert_allclose(got, brute, rtol=1e-6)
    assert 1e-6 * G > 0.0
