"""Polynomials in temperature: their estimates from several soaks, and what too few of them show."""

from dataclasses import replace

import numpy as np
import pytest

from nav.calibrate.coefficients import coefficients
from nav.calibrate.model import Model
from nav.calibrate.observability import observe, propose
from nav.calibrate.solve import fit
from tests.nav.calibrate.making import (
    AXES,
    DEG,
    FACES_12,
    NOISE,
    G,
    Terms,
    Unit,
    model,
    place,
    positions,
    rotations,
)

REFERENCE = 20.0
STEPS = [*positions(FACES_12), *rotations()]


def of(order, where=None):
    made = model(AXES, where, Terms(temperature_order=order))
    return Model(made.sensors, made.place, REFERENCE)


def at(steps, *soaks):
    return [replace(step, temperature=soak) for soak in soaks for step in steps]


def drawn(seed):
    """A unit, and how its scales (6, 2) and biases (6, 2) go with temperature."""
    rng = np.random.default_rng(seed)
    scale = rng.standard_normal((6, 2)) * [1e-4, 2e-6]
    bias = rng.standard_normal((6, 2)) * [1.0, 0.02] * np.repeat((0.05 * DEG / 3600.0, 3e-5 * G), 3)[:, None]
    return Unit.draw(AXES, rng), scale, bias, rng


def counted(unit, scale, bias, soaks, where, rng=None, noise=NOISE):
    """Intervals of all steps at each of the ``soaks``."""
    found = []
    for soak in soaks:
        d = (soak - REFERENCE) ** np.arange(1.0, 3.0)
        size = 1.0 + scale @ d
        warm = replace(unit, plus=unit.plus * size, minus=unit.minus * size, bias=unit.bias + bias @ d)
        found += [
            replace(one, temperature=soak, begin=one.begin + 1e6 * len(found))
            for one in warm.count(STEPS, where, rng=rng, noise=noise)
        ]
    return found


def truth(unit, scale, bias, plain, order=2):
    """The unknowns of a model: those of each sensor without temperature, and then with it."""
    own, values, k = unit.truth(plain), [], 0
    for place_of, one in enumerate(plain.sensors):
        along = float(unit.axes[place_of] @ one.axis)
        values += [*own[k : k + len(one.terms)], *scale[place_of, :order], *bias[place_of, :order] / along]
        k += len(one.terms)
    return np.array(values)


def test_without_noise_they_come_back():
    where = place(1e-9, 1e-9, 1e-9)
    unit, scale, bias, _ = drawn(1)
    found = fit(of(2, where), counted(unit, scale, bias, (-20.0, 15.0, 60.0), where), NOISE)
    wanted = truth(unit, scale, bias, model(AXES, where))
    # the bias' powers in rad/s are tiny: of sigmas, then
    np.testing.assert_allclose(found.theta[:-4] / found.sigma[:-4], wanted / found.sigma[:-4], atol=1e-4)
    for gyros, part in ((True, slice(0, 3)), (False, slice(3, 6))):
        got = coefficients(found, gyros)
        np.testing.assert_allclose(got.value["scale_temperature"], scale[part], rtol=1e-6)
        along = np.diag(unit.axes[part])[:, None]
        np.testing.assert_allclose(got.value["bias_temperature"], bias[part] / along, rtol=1e-3)
        assert got.sigma["bias_temperature"].shape == (3, 2)


def test_errors_are_as_large_as_their_sigmas():
    """20 units with white noise: coverage of the temperature's terms alone."""
    where = place()
    white = type(NOISE)(NOISE.gyro_walk, 1e-12, NOISE.accel_walk, 1e-12, NOISE.correlation)
    fitted = of(2, where)
    terms = [k for k, name in enumerate(fitted.names) if "temperature" in name]
    errors = []
    for seed in range(20):
        unit, scale, bias, rng = drawn(500 + seed)
        found = fit(fitted, counted(unit, scale, bias, (-20.0, 20.0, 60.0), where, rng, white), white)
        error = (found.theta[:-4] - truth(unit, scale, bias, model(AXES, where))) / found.sigma[:-4]
        errors.append(error[terms])
        assert found.steps <= 4
    # 24 terms of 6 sensors: 120 independent samples at the least, 0.9545 +- 0.019 (one sigma), 3.3 of these
    assert np.mean(np.abs(errors) < 2.0) > 0.892
    assert np.abs(errors).max() < 4.5


@pytest.mark.parametrize("soaks", [(20.0,), (-10.0, 20.0)])
def test_too_few_temperatures_do_not_show_them(soaks):
    """k temperatures, one of them the reference, show k - 1 powers."""
    fitted = of(len(soaks))
    steps = at(STEPS, *soaks)
    unseen = [name for names in observe(fitted, steps, NOISE).unseen for name in names]
    last = [name for name in fitted.names if name.endswith(f"temperature {len(soaks)}")]
    assert set(last) <= set(unseen)
    assert len(observe(fitted, steps, NOISE).unseen) == len(last)
    assert observe(of(len(soaks) - 1), steps, NOISE).unseen == ()
    # no other attitude helps
    assert propose(fitted, steps, NOISE, 60.0) == []


def test_what_another_attitude_shows_is_proposed_for_all_temperatures():
    """z is never up: at one temperature alone its attitude would not tell scale from temperature."""
    steps = at([*positions(FACES_12[:8]), *rotations()], -10.0, 50.0)
    more = propose(of(1), steps, NOISE, 60.0)
    assert more
    assert observe(of(1), [*steps, *at(more, -10.0, 50.0)], NOISE).unseen == ()
    assert observe(of(1), [*steps, *at(more, 50.0)], NOISE).unseen != ()
