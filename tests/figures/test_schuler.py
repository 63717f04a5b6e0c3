"""Errors at rest: what the figure says of the printed tables, and that its runs are what they claim."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from bridge.studies.figures.result import Result
from bridge.studies.figures.schuler import LAT, integral
from bridge.studies.figures.schuler_printed import MISPRINTS
from bridge.studies.figures.schuler_runs import ORDER, Rest, exponential, noisy_velocities
from nav.errors.response import SOURCES, STATES, Sphere, responses, static_dynamics

SPHERE = Sphere(9.8, 6_371_000.0)


def test_nine_cells_are_misprinted_and_the_rest_is_not(computed: Callable[[str], Result]) -> None:
    cells = [row for row in computed("schuler").rows if " of gyro " in row.name or " of accel " in row.name]
    cells = [row for row in cells if not row.name.startswith("neglect")]
    assert len(cells) == 28
    wrong = [row for row in cells if row.why]
    assert len(wrong) == len(MISPRINTS) == 9
    for row in wrong:
        assert row.exact is not None
        if row.published is not None:
            assert abs(row.published - row.exact) > 1e-3 * abs(row.exact)
    assert sum(1 for row in wrong if row.published is None) == 1


@pytest.mark.parametrize("cell", [cell for cell, (form, _) in MISPRINTS.items() if form])
def test_a_misprinted_cell_breaks_the_equations(cell: tuple[str, str]) -> None:
    """What is printed is not what (2-90) integrates to, at any latitude, by a thousandth or more."""
    source, state = SOURCES.index(cell[0]), STATES.index(cell[1])
    form = MISPRINTS[cell][0]
    assert form is not None
    t = np.linspace(600.0, 86_400.0, 60)
    for lat in (0.3, 0.8, 1.2):
        F, G = static_dynamics(lat, SPHERE, coriolis=False)
        truth = integral(F, G[:, source], t, SPHERE)[state]
        assert np.max(np.abs(form(t, lat, SPHERE) - truth)) > 1e-3 * np.max(np.abs(truth))


def test_the_neglect_of_coriolis_is_not_small(computed: Callable[[str], Result]) -> None:
    """Foucault turns the plane of the oscillation: after hours all of it is in the other channel."""
    neglect = computed("schuler").numbers["neglect"]
    assert neglect["accel_east"]["v_east"] > 1.5
    assert neglect["gyro_east"]["v_north"] > 0.9
    # azimuth under a drift of the vertical gyro hardly notices
    assert neglect["gyro_up"]["phi_up"] < 0.01


def test_exponential_and_closed_forms_meet_at_the_equator() -> None:
    """Where 2 w_ie sin L is zero nothing is neglected."""
    F, G = static_dynamics(0.0, SPHERE, coriolis=True)
    t = 3600.0 * np.arange(1, 25)
    closed = responses(t, 0.0, SPHERE)
    for i in range(len(SOURCES)):
        truth = exponential(F, G[:, i], 3600.0, 24).T
        units = np.array([SPHERE.radius * SPHERE.schuler] * 2 + [1.0] * 5)
        size = np.max(np.abs(truth) / units[:, None])
        np.testing.assert_allclose(closed[i] / units[:, None], truth / units[:, None], atol=1e-11 * size)


def test_the_ellipsoid_is_nearly_a_sphere() -> None:
    """The nine states of the ellipsoid against the seven of the sphere: flattening shifts Schuler's phase.

    R_M and R_N differ from their mean by 1 - sin^2 L half e^2 at most: 2e-3 of the frequency in each channel,
    over four hours (18 rad) 4 % of an oscillation.
    """
    rest = Rest(LAT)
    F, G = rest.model()
    S, H = static_dynamics(LAT, rest.sphere, coriolis=True)
    for i in range(len(SOURCES)):
        e = np.zeros(6)
        e[i] = -1.0 if i < 3 else 1.0
        whole = exponential(F, G @ e, 600.0, 24)[:, ORDER]
        sphere = exponential(S, H[:, i], 600.0, 24)
        size = np.max(np.abs(sphere), axis=0)
        assert np.all(np.abs(whole - sphere) <= 0.04 * size)


def test_noise_of_a_short_time_is_a_random_walk() -> None:
    """Sixty seconds: variance q t, by a thousand seeded runs; the same seed gives the same runs."""
    rest = Rest(0.0, rate=1)
    velocities = noisy_velocities(rest, 1e-8, 1000, 60, 60, seed=3)
    sigma = math.sqrt(float(np.mean(velocities**2)))
    # 3.3 sigma of the spread of a thousand; the oscillation takes 0.1 %
    assert sigma == pytest.approx(math.sqrt(60e-8), rel=3.3 / math.sqrt(2000))
    np.testing.assert_array_equal(noisy_velocities(rest, 1e-8, 2, 60, 60, seed=3), velocities[:2])
