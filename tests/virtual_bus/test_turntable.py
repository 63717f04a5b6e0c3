"""The turntable's truth: whole turns are whole, rests feel the Earth alone, errors are those drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from virtual_bus.bus import Bench
from virtual_bus.ellipsoid import OMEGA
from virtual_bus.sensors import generator
from virtual_bus.tables import EncoderTable
from virtual_bus.turntable import Encoder, Hold, Spin, TableErrors, TableTruth, turntable

LAT = np.radians(34.25)
GRAVITY = 9.79547
W_G = OMEGA * np.array([0.0, np.cos(LAT), np.sin(LAT)])
ENU, UEN = np.eye(3), np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
X = np.array([1.0, 0.0, 0.0])
MOVES = (Hold(ENU, 4.0), Hold(UEN, 4.0), Spin(X, np.radians(40.0), -4.0 * np.pi), Hold(UEN, 4.0))


def truth(C_gt=None):
    return TableTruth(MOVES, LAT, 400.0, GRAVITY, C_gt)


def ns(*seconds):
    return np.array([round(1e9 * t) for t in seconds], np.int64)


def test_a_rest_feels_the_earth():
    dtheta, dv = truth().increments(ns(0.0, 1.0, 3.5))
    np.testing.assert_allclose(dtheta, np.outer([1.0, 2.5], W_G), rtol=0, atol=1e-18)
    np.testing.assert_allclose(dv, np.outer([1.0, 2.5], [0.0, 0.0, GRAVITY]), rtol=1e-14, atol=1e-14)


def test_it_turns_to_the_next_position_and_rests_there():
    table = truth()
    # from east-north-up to up-east-north is a third of a turn about a space diagonal: 120 deg at 20 deg/s
    begin = 4.0 + 7.0
    dtheta, dv = table.increments(ns(begin, begin + 4.0))
    np.testing.assert_allclose(dtheta[0], 4.0 * W_G @ UEN, rtol=0, atol=1e-14)
    np.testing.assert_allclose(dv[0], [4.0 * GRAVITY, 0.0, 0.0], rtol=0, atol=1e-9)


def test_two_turns_are_two_turns():
    table = truth()
    begin, seconds = 4.0 + 7.0 + 4.0, 720.0 / 40.0 + 1.0
    t = np.linspace(begin, begin + seconds, 2000)
    dtheta, dv = table.increments(ns(*t))
    total = dtheta.sum(axis=0)
    # the axis points up; across it the Earth's rate turns with the unit and only the ramps leave something
    assert total[0] == pytest.approx(-4.0 * np.pi + seconds * W_G[2], abs=1e-12)
    assert np.abs(total[1:]).max() < 2.0 * OMEGA
    np.testing.assert_allclose(dv.sum(axis=0), [seconds * GRAVITY, 0.0, 0.0], rtol=0, atol=1e-8)
    state = table.state(round(1e9 * (begin + 0.5 * seconds)))
    assert state.w_ib_b[0] == pytest.approx(-np.radians(40.0) + W_G[2], abs=1e-12)


def test_increments_are_the_integrals_of_the_motion():
    table = truth()
    t = np.linspace(3.0, 20.0, 1701)
    dtheta, dv = table.increments(ns(*t))
    middle = table.motion(ns(*(0.5 * (t[1:] + t[:-1]))))
    # the midpoint rule over 10 ms: a third derivative of the ramps' angle of up to 50 rad/s^3 times dt^3 / 24
    np.testing.assert_allclose(dtheta, 0.01 * middle.w_iv_v, rtol=0, atol=3e-6)
    np.testing.assert_allclose(dv, 0.01 * middle.f_v, rtol=0, atol=3e-6 * GRAVITY)


def test_the_tables_errors_turn_what_is_felt():
    tilt = 1e-3
    C_gt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(tilt), -np.sin(tilt)], [0.0, np.sin(tilt), np.cos(tilt)]])
    _, dv = truth(C_gt).increments(ns(0.0, 1.0))
    # turned about east by a positive angle north is up, so gravity's reaction is seen to the north
    np.testing.assert_allclose(dv[0], GRAVITY * np.array([0.0, np.sin(tilt), np.cos(tilt)]), atol=1e-13)


def test_the_scenario_draws_them_with_the_seed():
    errors = TableErrors(1e-4, 3e-4, 5e-4)
    table = turntable("t", "fog", MOVES, 34.25, 400.0, GRAVITY, errors, 50.0)
    drawn = [table.drawn(generator(seed, "vehicle/mounting")) for seed in range(200)]
    delta, gravity = np.array([d for d, _ in drawn]), np.array([g for _, g in drawn])
    # standard deviations of 200 are good to 5 %
    np.testing.assert_allclose(delta.std(axis=0), [1e-4, 1e-4, 3e-4], rtol=0.2)
    assert gravity.std() == pytest.approx(5e-4, rel=0.2)
    bench = Bench(table, seed=7)
    assert bench.seconds == pytest.approx(4.0 + 7.0 + 4.0 + 19.0 + 4.0)
    expected = drawn[7][0]
    f = bench.truth(0).f_b
    np.testing.assert_allclose(f[:2], gravity[7] * np.array([-expected[1], expected[0]]), rtol=1e-3)


def test_encoders_tell_the_attitude_on_the_table_but_for_their_error():
    """Carried axes z, x, y make the attitude again, whether the table stands level or not."""
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
    table = truth(tilt)
    t = ns(2.0, 6.0, 13.0, 20.0, 33.0)
    true = tilt.T @ table.motion(t).C_gv
    for sigma_arcsec, worst in ((0.0, 0.07), (5.0, 3.0 * np.sqrt(2.0) * 5.0)):
        encoder = Encoder(table, EncoderTable(sigma_arcsec=sigma_arcsec), np.random.default_rng(1))
        read = np.radians(encoder.read(t))
        assert np.all((read >= 0.0) & (read < 2.0 * np.pi))
        made = Rotation.from_euler("ZXY", read).as_matrix()
        off = Rotation.from_matrix(np.einsum("kji,kjl->kil", true, made)).magnitude()
        # steps of 0.072 arcsec, half of one about each of three axes
        assert np.degrees(off.max()) * 3600.0 < worst
        assert (off.max() > 1e-5) == (sigma_arcsec > 0.0)


def test_a_table_that_stops_beside_where_it_should_turns_about_an_axis_beside_it():
    sigma = 2e-3
    errors = TableErrors(position=sigma)
    table = turntable("t", "fog", MOVES, 34.25, 400.0, GRAVITY, errors, 50.0)
    off, turned, apart = [], [], []
    for seed in range(60):
        made = table.trajectory(table.seconds(), generator(seed, "vehicle/mounting"))
        rests = made.motion(ns(2.0, 13.5, 36.5)).C_gv
        off.append(Rotation.from_matrix(rests[1].T @ UEN).as_rotvec())
        spin = made.motion(ns(24.0)).w_iv_v[0] + W_G @ -made.motion(ns(24.0)).C_gv[0]
        apart.append(np.cross(X, spin / -np.linalg.norm(spin)))
        turned.append(Rotation.from_matrix(rests[1].T @ rests[2]).as_rotvec() @ X)
    # standard deviations of 60 are good to 9 %, of 180 to 5 %
    assert np.std(off) == pytest.approx(sigma, rel=0.2)
    assert np.std(turned) == pytest.approx(sigma, rel=0.35)
    # the axis is where the unit was put beside it
    np.testing.assert_allclose(np.array(apart)[:, 1:], np.array(off)[:, 1:], rtol=0, atol=2e-5)
