"""The height channel: gains, stability, and what the kernel makes of them."""

import math

import numpy as np
import pytest

from nav import earth
from nav.strapdown.control import control
from nav.strapdown.height import GRADIENT, height_dynamics, height_gains
from nav.strapdown.kernels import X_A_H, X_C, X_H, X_HEAD, X_Q, X_V, integrate

DT = 0.05


def test_default_gains_are_the_published_ones():
    k1, k2, k3 = height_gains(2, 30.0)
    # textbook chapter "Inertial navigation", below eq. (2-64): 0.06666 and 0.00111
    assert k1 == pytest.approx(0.0667, abs=5e-5)
    assert k2 == pytest.approx(0.00111, abs=5e-6)
    assert k3 == 0.0


@pytest.mark.parametrize("time_constant", [3.0, 30.0, 200.0])
def test_second_order_is_stable_and_just_damped(time_constant):
    gains = height_gains(2, time_constant)
    poles = np.linalg.eigvals(height_dynamics(gains)[:2, :2])
    assert poles.real.max() < 0.0
    natural = math.sqrt(gains[1] - GRADIENT)
    damping = gains[0] / 2.0 / natural
    assert damping == pytest.approx(1.0 / math.sqrt(1.0 - GRADIENT * time_constant**2))
    if time_constant == 30.0:
        assert damping == pytest.approx(1.0014, abs=5e-5)
    assert np.prod(poles).real == pytest.approx(natural**2)
    # without feedback it runs away
    assert np.linalg.eigvals(height_dynamics((0.0, 0.0, 0.0))).real.max() == pytest.approx(GRADIENT**0.5)


@pytest.mark.parametrize("time_constant", [3.0, 30.0, 200.0])
def test_third_order_has_three_equal_poles(time_constant):
    matrix = height_dynamics(height_gains(3, time_constant))
    np.testing.assert_allclose(np.poly(matrix), np.poly(np.full(3, -1.0 / time_constant)), rtol=1e-9)


@pytest.mark.parametrize(("order", "time"), [(1, 30.0), (4, 30.0), (2, 0.0), (2, 600.0), (3, -1.0)])
def test_what_is_refused(order, time):
    with pytest.raises(ValueError, match="expected"):
        height_gains(order, time)


def at_rest(seconds, order, bias=0.0, start=0.0, every=20):
    """Rows of a standing vehicle whose vertical accelerometer is off by ``bias``, external height 0."""
    x = np.zeros(X_HEAD)
    x[X_Q], x[X_H] = 1.0, start
    x[X_C : X_C + 9] = earth.position_matrix(0.0, 0.0).ravel()
    force = np.array([0.0, 0.0, earth.normal_gravity(0.0, 0.0) + bias])
    sample = np.concatenate([earth.earth_rate_g(0.0), force]) * DT
    out = np.zeros((round(seconds / DT / 2) // every, X_HEAD))
    u = control(height_gains=height_gains(order, 30.0))
    integrate(x, np.tile(sample, (round(seconds / DT), 1)), DT, 2, u, every, out)
    return out


@pytest.mark.parametrize("order", [2, 3])
def test_an_initial_error_decays_as_the_poles_say(order):
    out = at_rest(300.0, order, start=10.0)
    values, vectors = np.linalg.eig(height_dynamics(height_gains(order, 30.0 + 1e-5)))
    t = 2.0 * np.arange(1, len(out) + 1)
    modes = np.linalg.solve(vectors, [10.0, 0.0, 0.0])
    expected = (vectors[0] * modes * np.exp(np.outer(t, values))).sum(axis=1).real
    # poles that nearly coincide: the eigenvectors lose half of their digits
    np.testing.assert_allclose(out[:, X_H], expected, atol=2e-3)


def test_a_bias_leaves_an_offset_at_second_order_only():
    k1, k2, _ = height_gains(2, 30.0)
    second, third = at_rest(900.0, 2, bias=1e-3)[-1], at_rest(900.0, 3, bias=1e-3)[-1]
    assert second[X_H] == pytest.approx(1e-3 / (k2 - GRADIENT), rel=1e-3)
    assert second[X_V + 2] == pytest.approx(k1 * second[X_H], rel=1e-3)
    # the metre that it rose and fell has set the level channels swinging, Coriolis brings a little back
    assert abs(third[X_H]) < 1e-5
    assert third[X_A_H] == pytest.approx(1e-3, rel=1e-4)
