"""The simulated platform, and what its figure says."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bridge.studies.figures.platform import (
    ACCEL_BIAS,
    ARCMIN,
    DAY,
    GYRO_BIAS,
    KNOT,
    LAWS,
    RATE,
    SWING,
    TABLE_1,
    TORQUER,
    responses,
)
from bridge.studies.figures.platform_bench import Bench, cruise, specific_force_i
from nav.earth import EARTH_RATE, ecef, gravity_g, position_matrix, radii
from nav.platform import Modulation, heading_limit, uniform, zhao


def test_specific_force_is_the_acceleration_of_the_ship_less_gravitation():
    speed, lat0, h = 40.0, 0.9, 2.0

    def place(t):
        """Inertial position: latitude from the meridian arc, by small steps."""
        lat, n = lat0, 2000
        for _ in range(n):
            middle = lat + 0.5 * t / n * speed / radii(math.sin(lat))[0]
            lat += t / n * speed / radii(math.sin(middle))[0]
        return ecef(lat, EARTH_RATE * t, 0.0)

    # fourth-order second difference: rounding 1e-9 m over h^2
    r = [place(k * h) for k in (-2, -1, 0, 1, 2)]
    acceleration = (-r[0] + 16.0 * r[1] - 30.0 * r[2] + 16.0 * r[3] - r[4]) / (12.0 * h * h)
    C_ig = position_matrix(lat0, 0.0)
    centrifugal = EARTH_RATE**2 * np.array([r[2][0], r[2][1], 0.0])
    gravitation = C_ig @ gravity_g(lat0, 0.0) - centrifugal
    np.testing.assert_allclose(specific_force_i(lat0, speed, 0.0), acceleration - gravitation, atol=2e-8)


def test_specific_force_turns_with_the_earth():
    a = np.array(specific_force_i(0.9, 10.0, 0.0))
    b = np.array(specific_force_i(0.9, 10.0, math.pi / 2.0 / EARTH_RATE))
    np.testing.assert_allclose(b, (-a[1], a[0], a[2]), atol=1e-12)


@pytest.mark.parametrize("law", [*LAWS.values(), zhao(-RATE)], ids=[*LAWS, "other sense"])
@pytest.mark.parametrize("speed", [0.0, 5.0 * KNOT])
def test_a_platform_without_errors_shows_none(law, speed):
    run = cruise(Bench(math.radians(80.0), law, speed=speed, dt=1.0), 21600.0)
    # what the kernel leaves of the turn of n in a cycle: w_ie cos L k' g dt^2 / 6, 2e-8 g for the swing
    assert np.abs(run.heading_error).max() < 0.02 * ARCMIN
    travelled = speed * 21600.0 / radii(math.sin(math.radians(80.0)))[0]
    assert run.lat[-1] == pytest.approx(math.radians(80.0) + travelled, abs=1e-6)
    np.testing.assert_allclose(np.linalg.norm(run.x[:, 4:6], axis=1), speed, atol=1e-3)


def test_errors_add():
    bench = Bench(math.radians(75.0), zhao(RATE), dt=4.0)
    each = responses(bench, DAY, torquer=True)
    assert len(each) == 6
    together = cruise(
        replace(bench, gyro_bias=GYRO_BIAS, accel_bias=ACCEL_BIAS, torquer=TORQUER), DAY
    ).heading_error
    # products of errors: a thousandth of a mrad in mrad
    np.testing.assert_allclose(
        each.sum(axis=0), together / ARCMIN, atol=5e-3 * np.abs(together).max() / ARCMIN
    )


def test_servos_turn_gyro_errors_round():
    """A gyro that reads too much about up lets the platform fall behind: headings come out too small."""
    up = Bench(math.radians(60.0), Modulation(), gyro_bias=(0.0, 0.0, GYRO_BIAS[2]))
    error = cruise(up, 1800.0).heading_error
    assert error[-1] == pytest.approx(-GYRO_BIAS[2] * 1800.0, rel=0.02)
    much = replace(up, gyro_bias=(0.0, 0.0, 0.0), law=uniform(10.0 * RATE), torquer=TORQUER)
    turned = 1800.0 * (10.0 * RATE + EARTH_RATE * math.sin(math.radians(60.0)))
    assert cruise(much, 1800.0).heading_error[-1] == pytest.approx(TORQUER * turned, rel=0.05)


def test_an_error_of_the_torquers_comes_back_with_the_swing():
    bench = Bench(math.radians(85.0), SWING, torquer=TORQUER, dt=1.0)
    error = cruise(bench, 6.0 * SWING.frequency**-1 * 2.0 * math.pi).heading_error
    assert np.abs(error).max() < 2.2 * SWING.amplitude * TORQUER


def test_the_figure_has_the_printed_table(computed):
    result = computed("platform")
    rows = {row.name: row for row in result.rows}
    for lat, (conventional, modulated) in TABLE_1.items():
        plain, turned = rows[f"{lat} deg conventional"], rows[f"{lat} deg modulated"]
        assert (plain.published, turned.published) == (conventional, modulated)
        assert plain.ours == pytest.approx(conventional, rel=0.02)
        # the closed form leaves Schuler's oscillation out: up to 3.3 %
        assert plain.exact == pytest.approx(plain.ours, rel=0.035)
        assert plain.exact == pytest.approx(heading_limit(math.radians(lat), GYRO_BIAS) / ARCMIN)
        assert plain.ours / turned.ours >= 3.5
        assert rows[f"{lat} deg swing"].ours < turned.ours
    # independent simulation of the same: gyros alone, eq. (19) as printed
    for lat, value in {55: 0.531, 65: 0.753, 75: 1.240, 85: 4.103}.items():
        assert rows[f"{lat} deg modulated, gyros alone, literal (19)"].ours == pytest.approx(value, rel=2e-3)


def test_the_voyage_gets_there(computed):
    voyage = computed("platform").numbers["voyage"]
    lat = np.array(voyage["lat_deg"])
    assert len(lat) == 20
    assert (lat[0], lat[-1]) == (pytest.approx(46.0, abs=0.1), pytest.approx(84.0, abs=0.2))
    for name in LAWS:
        least, median, most = (np.array(voyage[f"{name} {label}"]) for label in ("least", "median", "most"))
        assert np.all(least <= median)
        assert np.all(median <= most)
        assert median[-1] > median[0]
