"""The paths of the polar figure, checked in inertial axes, and what is navigated along them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from bridge.studies.figures.exact_increments import GreatCircle, direction, integrals
from bridge.studies.figures.flights import Flight, fly
from bridge.studies.figures.polar import BESIDE, EQUATOR, OVER, UP_TO_60, at_rest, cruise
from bridge.studies.figures.result import Result
from nav.earth import geodetic_to_xyz, normal_gravity
from nav.rotation import dcm_from_quat, quat_from_rotvec

OMEGA = 7.292115e-5
POLE_S = math.radians(100.0) / OVER.rate


def inertial(t: np.ndarray) -> np.ndarray:
    """C_ie (n, 3, 3): the Earth has turned about its axis."""
    return dcm_from_quat(quat_from_rotvec(OMEGA * t[:, None] * np.array([0.0, 0.0, 1.0])))


@pytest.mark.parametrize("path", [OVER, BESIDE, UP_TO_60, EQUATOR, at_rest(89.9999, -70.0)])
@pytest.mark.parametrize("t", [0.0, 20_000.0, POLE_S, 80_000.0])
def test_rates_are_derivatives_in_inertial_axes(path: GreatCircle, t: float) -> None:
    step = 1.0
    times = t + step * np.arange(-2.0, 3.0)
    C_ie = inertial(times)
    r_i = np.einsum("nij,nj->ni", C_ie, path.position(times))
    # five-point second difference: r is good to 2e-9 m, the next term is r w^6 h^4 / 90 < 1e-17 m/s^2
    accel = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) @ r_i / (12.0 * step**2)
    C_ib = C_ie @ path.attitude(times)
    up, r_e = path.vertical(times)[0][2], path.position(times)[2]
    # normal gravity less the centrifugal acceleration is gravitation; plumb lines bend by 8.08e-9 h sin 2L
    g = normal_gravity(up[2], path.height)
    north = np.array([0.0, 0.0, 1.0]) - up[2] * up
    gravity_e = -g * up - 8.08e-9 * path.height * 2.0 * up[2] * north
    gravitation_e = gravity_e - OMEGA**2 * r_e * np.array([1.0, 1.0, 0.0])
    rates = path.rates(times[2:3])[0]
    assert C_ib[2] @ rates[3:] == pytest.approx(accel - C_ie[2] @ gravitation_e, abs=2e-8)
    turn = C_ib[1].T @ C_ib[3]
    # over two seconds; the third power of the angle is 1e-11
    rate = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 4.0
    assert rates[:3] == pytest.approx(rate, abs=1e-11)


def test_increments_are_integrals() -> None:
    """Against sines integrated by hand, and additive whatever the pieces."""

    def rates(t: np.ndarray) -> np.ndarray:
        return np.sin(np.outer(t, [1.0, 2.0, 3.0, 0.5, 0.25, 0.0]))

    found = np.concatenate(list(integrals(rates, 0.1, 4, 10)))
    t = 0.1 * np.arange(41)[:, None]
    w = np.array([1.0, 2.0, 3.0, 0.5, 0.25])
    assert found[:, :5] == pytest.approx(np.diff(-np.cos(t * w) / w, axis=0), abs=1e-14)
    assert np.all(found[:, 5] == 0.0)
    assert np.concatenate(list(integrals(rates, 0.1, 8, 5))) == pytest.approx(found, abs=1e-14)


def test_paths_lead_where_they_are_said_to() -> None:
    day = np.linspace(0.0, 86_400.0, 8641)
    lat = {
        name: np.degrees(np.arcsin(path.vertical(day)[0][:, 2]))
        for name, path in (("over", OVER), ("beside", BESIDE), ("60", UP_TO_60), ("equator", EQUATOR))
    }
    assert lat["over"][0] == pytest.approx(-10.0)
    assert OVER.vertical(np.array([POLE_S]))[0][0, 2] == pytest.approx(1.0, abs=1e-15)
    assert np.abs(OVER.vertical(day)[0][:, 1]).max() < 1e-15, "the date line, then Greenwich"
    assert (lat["over"][-1], lat["60"].max()) == (pytest.approx(-4.1, abs=0.2), pytest.approx(60.0, abs=1e-4))
    near = np.linspace(POLE_S - 100.0, POLE_S + 100.0, 20_001)
    off = np.hypot(*BESIDE.position(near)[:, :2].T).min()
    assert off == pytest.approx(1000.0, rel=0.01)
    assert np.abs(lat["equator"]).max() < 1e-12
    speed = np.linalg.norm(OVER.velocity(day), axis=-1) * 3.6
    assert speed.mean() == pytest.approx(900.0, abs=1.0)
    assert speed.min() > 890.0
    assert speed.max() < 910.0


def test_a_place_is_exact_at_multiples_of_90_degrees() -> None:
    east, north, up = direction(90.0, 180.0)
    assert up.tolist() == [0.0, 0.0, 1.0]
    assert (east.tolist(), north.tolist()) == ([0.0, -1.0, 0.0], [1.0, 0.0, 0.0])
    lat, lon, height = 0.6, -2.0, 500.0
    axes = direction(math.degrees(lat), math.degrees(lon))
    path = GreatCircle(axes[2], axes[1], 0.0, height, np.eye(3))
    assert path.position(np.zeros(1))[0] == pytest.approx(geodetic_to_xyz(lat, lon, height), abs=1e-8)


def test_a_wrong_sample_shows() -> None:
    """A gyro that counts 0.01 deg/h too much costs kilometres in six hours, not millimetres."""
    path = cruise(40.0, 0.0, 0.0)
    bias = np.array([math.radians(0.01) / 3600.0, 0.0, 0.0, 0.0, 0.0, 0.0])

    class Biased(GreatCircle):
        def rates(self, t: np.ndarray) -> np.ndarray:
            return super().rates(t) + bias

    wrong = Biased(path.start, path.forward, path.rate, path.height, path.C_tb)
    found = fly({"wander": Flight(wrong, "wander")}, 10.0, 6.0)["wander"]
    assert 2_000.0 < found.horizontal.max() < 20_000.0


def test_every_law_is_shown_over_the_pole(computed: Callable[[str], Result]) -> None:
    rows = {row.name: row for row in computed("polar").rows}
    for law in ("wander", "free", "rotating"):
        assert rows[f"over the pole, {law}: horizontal"].ours < 10.0
    for place in ("at 45 deg", "at the north pole", "on equator and date line"):
        assert rows[f"rest {place}, three laws"].ours < 1.0
    # nothing is lost at the pole: not more than ten times the error of mid latitudes, all of it rounding
    over, middle = (
        rows["over the pole, wander: horizontal"].ours,
        rows["up to 60 deg, wander: horizontal"].ours,
    )
    assert over < 10.0 * max(middle, 1e-4)
    assert 85.0 < rows["north law refuses at"].ours < 85.15
    # the law that is refused loses metres where it is let through, and nothing before
    assert rows["1 km beside the pole, north"].ours > 1.0
    assert rows["up to 60 deg, north: horizontal"].ours < 0.01
