"""Polar views: definitions by closed forms, round trips, one point and direction in every frame."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nav import earth, polar
from nav.polar import Frame

TURN = 2.0 * math.pi
POLE = math.pi / 2
# a latitude of a quarter turn is rounded by 1e-16 rad; unit vectors from sines and cosines by a few more
ANGLE = 1e-14

lats = st.floats(-POLE, POLE) | st.sampled_from([POLE, -POLE, 0.0]) | st.floats(POLE - 1e-6, POLE)
lons = st.floats(-math.pi, math.pi) | st.sampled_from([0.0, POLE, -POLE, math.pi, -math.pi])
headings = st.floats(0.0, TURN, exclude_max=True)
frames = st.sampled_from(Frame)
V = (30.0, -40.0, 1.5)


def directions(seen: polar.View) -> np.ndarray:
    """Forward axis and velocity in Earth-fixed axes, by what the view says alone."""
    C = polar.axes_e(seen)
    forward = np.array([math.sin(seen.heading), math.cos(seen.heading), 0.0])
    return np.stack((C @ forward, C @ seen.v))


def level_enough(lat: float, lon: float) -> bool:
    """Whether grid and transverse directions have a meaning: not within metres of a transverse pole."""
    return math.hypot(math.cos(lon), math.sin(lat) * math.sin(lon)) > 1e-6


@given(lat=lats, lon=lons)
def test_transverse_angles_by_the_formulas_and_back(lat: float, lon: float) -> None:
    lat_t, lon_t = polar.to_transverse(lat, lon)
    assert math.sin(lat_t) == pytest.approx(math.cos(lat) * math.sin(lon), abs=ANGLE)
    assert math.cos(lat_t) * math.cos(lon_t) == pytest.approx(math.sin(lat), abs=ANGLE)
    assert math.cos(lat_t) * math.sin(lon_t) == pytest.approx(math.cos(lat) * math.cos(lon), abs=ANGLE)
    assert abs(lat_t) <= POLE
    assert abs(lon_t) <= math.pi
    back = polar.from_transverse(lat_t, lon_t)
    there = earth.ecef(lat, lon, 100.0)
    # 6.4e6 m times some 1e-16 rad
    assert np.abs(earth.ecef(*back, 100.0) - there).max() < 1e-8


@given(lat=lats, lon=lons, heading=headings, frame=frames)
@example(lat=POLE, lon=1.0, heading=2.0, frame=Frame.TRANSVERSE)
@example(lat=-POLE, lon=-3.0, heading=0.0, frame=Frame.GRID)
@example(lat=0.0, lon=POLE, heading=4.0, frame=Frame.TRANSVERSE)
@example(lat=0.0, lon=-POLE, heading=4.0, frame=Frame.TRANSVERSE)
def test_a_view_is_the_same_point_and_direction(lat: float, lon: float, heading: float, frame: Frame) -> None:
    plain = polar.view(Frame.GEOGRAPHIC, lat, lon, heading, V)
    assert (float(plain.lat), float(plain.lon)) == (lat, lon)
    assert plain.v == pytest.approx(V, abs=1e-12)
    seen = polar.view(frame, lat, lon, heading, V)
    assert 0.0 <= seen.heading < TURN
    height = 200.0
    assert np.abs(polar.position_e(seen, height) - earth.ecef(lat, lon, height)).max() < 1e-8
    if frame is not Frame.GRID or level_enough(lat, lon):
        # the grid angle near its limit of meaning is worth 1e-16 over 1e-6
        assert np.abs(directions(seen) - directions(plain)).max() < 50.0 * (
            1e-9 if frame is Frame.GRID else ANGLE
        )
    back = polar.geographic(seen)
    assert np.abs(polar.position_e(back, height) - earth.ecef(lat, lon, height)).max() < 1e-8
    if frame is not Frame.GRID or level_enough(lat, lon):
        assert np.abs(directions(back) - directions(plain)).max() < 50.0 * (
            1e-9 if frame is Frame.GRID else ANGLE
        )


@given(lat=st.floats(-1.5, 1.5), lon=st.floats(-3.1, 3.1), heading=headings, frame=frames)
def test_back_gives_the_very_numbers_where_they_are_unique(
    lat: float, lon: float, heading: float, frame: Frame
) -> None:
    if not level_enough(lat, lon):
        return
    back = polar.geographic(polar.view(frame, lat, lon, heading, V))
    assert back.lat == pytest.approx(lat, abs=1e-13)
    assert back.lon == pytest.approx(lon, abs=1e-13)
    assert math.remainder(float(back.heading) - heading, TURN) == pytest.approx(0.0, abs=1e-9)
    assert back.v == pytest.approx(V, abs=1e-7)


@given(lat=lats, lon=lons, heading=headings, wander=st.floats(-math.pi, math.pi), frame=frames)
def test_from_the_position_matrix_as_from_the_angles(
    lat: float, lon: float, heading: float, wander: float, frame: Frame
) -> None:
    if not level_enough(lat, lon):
        return
    C_en = earth.position_matrix(lat, lon, wander)
    # north is the wander angle to the right of n's y axis
    c, s = math.cos(wander), math.sin(wander)
    v_n = (c * V[0] + s * V[1], -s * V[0] + c * V[1], V[2])
    direct = polar.view(frame, lat, lon, heading, V)
    seen = polar.view_n(frame, C_en, heading + wander, v_n)
    assert np.abs(polar.position_e(seen, 0.0) - polar.position_e(direct, 0.0)).max() < 1e-8
    assert np.abs(directions(seen) - directions(direct)).max() < 1e-7


def test_grid_north_is_parallel_to_the_greenwich_plane() -> None:
    # the polar charts' rule: at 30 deg west, grid north is 30 deg west of true north, in the south opposite
    pole = math.radians(89.999999)
    west = math.radians(-30.0)
    assert polar.grid_angle(pole, west) == pytest.approx(west, abs=1e-6)
    assert polar.grid_angle(-pole, west) == pytest.approx(-west, abs=1e-6)
    assert polar.grid_angle(1.2, 0.0) == 0.0
    for lat, lon in ((0.3, 0.7), (1.5, -2.6), (-0.9, 2.0), (-1.4, -0.4)):
        sigma = float(polar.grid_angle(lat, lon))
        d = math.sqrt(1.0 - (math.cos(lat) * math.sin(lon)) ** 2)
        assert math.sin(sigma) == pytest.approx(math.sin(lon) * math.sin(lat) / d, abs=ANGLE)
        assert math.cos(sigma) == pytest.approx(math.cos(lon) / d, abs=ANGLE)
        east, north, up = polar.axes_e(polar.view(Frame.GRID, lat, lon, 0.0, V)).T
        assert north[1] == pytest.approx(0.0, abs=ANGLE)  # no part across the Greenwich plane
        assert east[1] > 0.0
        assert np.cross(east, north) == pytest.approx(up, abs=ANGLE)
        # the published form: heading less sigma
        seen = polar.view(Frame.GRID, lat, lon, 1.0, V)
        assert math.remainder(float(seen.heading) - (1.0 - sigma), TURN) == pytest.approx(0.0, abs=ANGLE)
        assert float(seen.turn) == pytest.approx(sigma, abs=ANGLE)


@given(lat=lats, lon=lons, heading=headings)
def test_transverse_north_is_grid_east(lat: float, lon: float, heading: float) -> None:
    if not level_enough(lat, lon):
        return
    grid, transverse = (polar.view(f, lat, lon, heading, V) for f in (Frame.GRID, Frame.TRANSVERSE))
    quarter = float(grid.heading) - float(transverse.heading) - POLE
    assert math.remainder(quarter, TURN) == pytest.approx(0.0, abs=1e-9)
    # transverse east is grid south
    assert (transverse.v[1], -transverse.v[0]) == pytest.approx(tuple(grid.v[:2]), abs=1e-7)


def test_at_the_pole_every_longitude_tells_the_same() -> None:
    # flying towards 90 deg east over the pole, said with any longitude
    for lon in np.linspace(-math.pi, math.pi, 25):
        # at the pole south is towards the longitude that was chosen, and east of south is to the left
        heading = math.pi - (POLE - lon)
        v_g = 100.0 * np.array([math.sin(heading), math.cos(heading), 0.0])
        seen = polar.view(Frame.TRANSVERSE, POLE, lon, heading, v_g)
        assert seen.lat == pytest.approx(0.0, abs=1e-16)
        assert seen.lon == pytest.approx(0.0, abs=1e-16)
        assert math.remainder(float(seen.heading), TURN) == pytest.approx(0.0, abs=ANGLE)
        assert seen.v == pytest.approx([0.0, 100.0, 0.0], abs=1e-12)
        grid = polar.view(Frame.GRID, POLE, lon, heading, v_g)
        assert grid.heading == pytest.approx(POLE, abs=ANGLE)
        assert grid.v == pytest.approx([100.0, 0.0, 0.0], abs=1e-12)


def test_over_the_pole_nothing_jumps() -> None:
    """Along a straight line that passes the pole at three metres, looking ahead."""
    lon0, radius = 0.5, 6.4e6
    along = np.linspace(-50.0, 50.0, 2001)
    n = np.stack((-along / radius, np.full(along.shape, 3.0 / radius), np.ones(along.shape)), axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    c, s = math.cos(lon0), math.sin(lon0)
    n = n @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    lat, lon = np.arctan2(n[:, 2], np.hypot(n[:, 0], n[:, 1])), np.arctan2(n[:, 1], n[:, 0])
    forward_e = np.array([-c, -s, 0.0])
    C_eg = polar.axes_e(polar.view(Frame.GEOGRAPHIC, lat, lon, np.zeros(len(lat)), np.zeros((len(lat), 3))))
    forward_g = np.einsum("nij,i->nj", C_eg, forward_e)
    heading = np.arctan2(forward_g[:, 0], forward_g[:, 1])
    # the geographic heading does half a turn in some metres
    assert np.ptp(np.unwrap(heading)) > 2.9
    for frame in (Frame.GRID, Frame.TRANSVERSE):
        seen = polar.view(frame, lat, lon, heading, 200.0 * forward_g)
        # 100 m of the Earth's curvature is 1.6e-5 rad
        assert np.ptp(np.unwrap(seen.heading)) < 2e-5
        assert np.ptp(seen.v, axis=0).max() < 200.0 * 2e-5
    assert np.abs(np.diff(seen.lat)).max() < 0.06 / radius
    assert np.abs(np.diff(seen.lon)).max() < 0.06 / radius


def test_all_four_quadrants_of_the_transverse_graticule() -> None:
    seen = {
        lon: (math.degrees(t[0]), math.degrees(t[1]))
        for lon in (45, 135, -135, -45)
        for t in [polar.to_transverse(math.radians(80.0), math.radians(lon))]
    }
    assert seen[45][0] > 0.0 < seen[45][1]
    assert seen[135][0] > 0.0 > seen[135][1]
    assert seen[-135][0] < 0.0 > seen[-135][1]
    assert seen[-45][0] < 0.0 < seen[-45][1]
    # around the south pole transverse longitude is near a half turn
    assert abs(math.degrees(polar.to_transverse(math.radians(-80.0), 0.8)[1])) > 90.0


def test_sigmas_turn_with_the_axes() -> None:
    assert polar.turn_sigma(3.0, 4.0, 0.0) == (3.0, 4.0)
    assert polar.turn_sigma(3.0, 4.0, POLE) == pytest.approx((4.0, 3.0))
    east, north = polar.turn_sigma(3.0, 4.0, 0.7)
    assert east**2 + north**2 == pytest.approx(25.0)
    # by the covariance matrix
    s, c = math.sin(0.7), math.cos(0.7)
    T = np.array([[c, -s], [s, c]])
    assert np.sqrt(np.diag(T @ np.diag([9.0, 16.0]) @ T.T)) == pytest.approx((east, north))


def test_the_switch_has_hysteresis_in_both_hemispheres() -> None:
    enter, leave = math.radians(84.0), math.radians(83.5)
    for sign in (1.0, -1.0):
        now, shown = Frame.GEOGRAPHIC, []
        for lat_deg in (83.0, 83.9, 84.0, 83.9, 83.5, 83.4, 83.7, 84.0, 90.0, 83.49):
            now = polar.switch(sign * math.radians(lat_deg), now, Frame.TRANSVERSE, enter, leave)
            shown.append(int(now))
        assert shown == [0, 0, 2, 2, 2, 0, 0, 2, 2, 0]
    for now in Frame:
        assert polar.switch(math.nan, now, Frame.GRID, enter, leave) is now
