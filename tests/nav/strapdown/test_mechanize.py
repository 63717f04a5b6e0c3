"""The navigation update: its twin, and motions whose answer is known in closed form."""

import math

import numpy as np
import pytest

from nav import earth
from nav import rotation as rot
from nav.strapdown.azimuth import AZIMUTH_LAWS, azimuth_control
from nav.strapdown.control import U_SIZE, control
from nav.strapdown.kernels import (
    M_SIZE,
    X_A_H,
    X_C,
    X_H,
    X_HEAD,
    X_Q,
    X_V,
    increments,
    integrate,
    strapdown,
)
from nav.strapdown.mechanize import NavState, frame_rates, update
from tests.nav.truth import Drive


def pack(state):
    return np.concatenate(
        [state.q_nb, state.v_n, state.C_en.ravel(), [state.height, state.height_correction]]
    )


NO_CONTROL = np.zeros(U_SIZE)


def two(x, d, dt, mid):
    """One undamped wander update of two samples ``d`` (12,)."""
    inc = np.zeros(6)
    increments(d, 2, inc)
    strapdown(x, inc, dt, NO_CONTROL, mid)


def run(x, dtheta, dv, dt, n=2, u=NO_CONTROL):
    """Kernel over samples (count, 3), ``n`` at a time; ``dt`` of one sample."""
    integrate(x, np.hstack([dtheta, dv]), dt, n, u, 1, np.zeros((0, X_HEAD)))
    return x


PLACES = {
    "middle": (0.8, 0.3, 0.5, 500.0),
    "high": (-0.2, -3.0, 0.0, 20000.0),
    "pole": (math.pi / 2, 0.0, 1.0, 0.0),
    "near": (-1.5707, 2.0, 2.0, -100.0),
}
CONTROLS = {
    "none": {},
    "turned": {"w_c": (1e-3, -2e-3, 5e-4)},
    "damped": {"velocity": (190.0, -110.0, 1.0), "velocity_gains": (0.3, 0.1)},
    "height": {"height": 450.0, "height_gains": (0.1, 3e-3, 1e-4)},
}


@pytest.mark.parametrize("law", AZIMUTH_LAWS)
@pytest.mark.parametrize("n", range(1, 7))
@pytest.mark.parametrize("fed", CONTROLS)
def test_kernel_is_the_twin(law, n, fed):
    rng = np.random.default_rng(3)
    u = azimuth_control(law, 2e-3 if AZIMUTH_LAWS[law].turns else 0.0) + control(**CONTROLS[fed])
    for name, place in PLACES.items():
        if law == "north" and name in {"pole", "near"}:
            continue
        q = rot.quat_from_rotvec(rng.normal(size=3))
        s = NavState(q, np.array([200.0, -120.0, 5.0]), earth.position_matrix(*place[:3]), place[3], 1e-3)
        x, mid, inc = pack(s), np.zeros(M_SIZE), np.zeros(6)
        for _ in range(25):
            a, v = rng.normal(size=(n, 3)) * 0.02, rng.normal(size=(n, 3)) * 0.2
            increments(np.concatenate([a.ravel(), v.ravel()]), n, inc)
            strapdown(x, inc, 0.01, u, mid)
            s = update(s, a, v, 0.01, u)
            y = pack(s)
            assert np.all(np.abs(x - y) <= 1e-12 * np.maximum(1.0, np.abs(y)))
        frame = frame_rates(s.C_en[2], s.height, s.v_n, u)
        np.testing.assert_allclose(mid[15:18], frame.w_en_n, rtol=0.02, atol=1e-7)


def test_no_control_is_the_default():
    rng = np.random.default_rng(4)
    a, v = rng.normal(size=(2, 3)) * 0.02, rng.normal(size=(2, 3)) * 0.2
    s = NavState(np.array([1.0, 0, 0, 0]), np.ones(3), earth.position_matrix(0.3, 0.2), 10.0)
    np.testing.assert_array_equal(pack(update(s, a, v, 0.01)), pack(update(s, a, v, 0.01, NO_CONTROL)))


def test_rows_are_stored_as_asked():
    drive = Drive()
    lat, lon, h, v_g, C_gb = drive.geodetic(0.0)
    start = pack(NavState(rot.quat_from_dcm(C_gb), v_g, earth.position_matrix(lat, lon), h))
    samples = np.hstack(drive.increments(100, 0.005))
    x, out = start.copy(), np.full((8, X_HEAD), np.nan)
    # 33 updates of three samples; one sample is left
    assert integrate(x, samples, 0.005, 3, NO_CONTROL, 5, out) == 6
    assert np.isfinite(out[:6]).all()
    assert np.isnan(out[6:]).all()
    y = start.copy()
    integrate(y, samples[:90], 0.005, 3, NO_CONTROL, 1, np.zeros((0, X_HEAD)))
    np.testing.assert_array_equal(out[5], y)
    assert x[X_A_H] == 0.0


def test_rest_stays_at_rest():
    """A perfect IMU at rest for an hour: what is left is rounding, amplified by the unstable height."""
    lat, h = 0.7, 200.0
    C_gb = rot.dcm_from_euler(0.4, 0.1, -0.2)
    s = NavState(rot.quat_from_dcm(C_gb), np.zeros(3), earth.position_matrix(lat, 0.1), h)
    x, mid = pack(s), np.zeros(M_SIZE)
    dt = 0.02
    dtheta = C_gb.T @ earth.earth_rate_g(lat) * dt
    dv = -C_gb.T @ earth.gravity_g(lat, h) * dt
    d = np.concatenate([dtheta, dtheta, dv, dv])
    for _ in range(3600 * 25):
        two(x, d, 2 * dt, mid)
    # the vertical channel grows as cosh(sqrt(2 g/R) t), 400 in an hour; 1e-9 m/s^2 of g rounding, second
    # order in the update for the constant turn of b
    assert np.linalg.norm(x[X_V : X_V + 2]) < 1e-6
    assert abs(x[X_V + 2]) < 1e-4
    lat1, lon1, _ = earth.position_angles(x[X_C : X_C + 9].reshape(3, 3))
    assert abs(lat1 - lat) * 6.4e6 < 1e-3
    assert abs(lon1 - 0.1) * 6.4e6 < 1e-3


def test_accelerometer_bias_swings_with_schuler_period():
    """East bias B at rest, height held: v_E = B/w_s sin(w_s t), over a quarter of a period.

    Single-channel closed form (Titterton and Weston, 2nd ed., section 12.3); Earth rate couples it at the
    ratio of 24 h to 84 min, so 3 % are left to the tolerance.
    """
    lat, h, bias = 0.0, 0.0, 1e-3
    s = NavState(np.array([1.0, 0, 0, 0]), np.zeros(3), earth.position_matrix(lat, 0.0), h)
    x, mid = pack(s), np.zeros(M_SIZE)
    dt = 0.5
    g = earth.normal_gravity(0.0, 0.0)
    w_s = math.sqrt(g / earth.radii(0.0)[1])
    dtheta = earth.earth_rate_g(lat) * dt
    dv = np.array([bias, 0.0, g]) * dt
    d = np.concatenate([dtheta, dtheta, dv, dv])
    for k in range(1, round(2 * math.pi / w_s / (2 * dt)) + 1):
        two(x, d, 2 * dt, mid)
        x[X_H], x[X_V + 2] = 0.0, 0.0
        if k % 200 == 0:
            t = k * 2 * dt
            assert x[X_V] == pytest.approx(bias / w_s * math.sin(w_s * t), abs=0.03 * bias / w_s)


def test_free_fall_is_a_keplerian_radial_arc():
    """No forces and no rotation, at the pole: the fall obeys energy conservation of normal gravity."""
    s = NavState(np.array([1.0, 0, 0, 0]), np.zeros(3), earth.position_matrix(math.pi / 2, 0.0), 10_000.0)
    x, mid = pack(s), np.zeros(M_SIZE)
    for _ in range(1000):
        two(x, np.zeros(12), 0.01, mid)
    u, w = np.polynomial.legendre.leggauss(8)
    top, bottom = 10_000.0, float(x[X_H])
    h = bottom + (u + 1) * (top - bottom) / 2
    energy = np.sum(w * [earth.normal_gravity(1.0, a) for a in h]) * (top - bottom) / 2
    # g changes by 3e-6 per update; the midpoint rule leaves its square
    assert 0.5 * x[X_V + 2] ** 2 == pytest.approx(energy, rel=1e-9)
    # the Earth turns beneath: the local level keeps its inertial attitude apart from Earth rate
    assert 2 * math.atan2(x[X_Q + 3], x[X_Q]) == pytest.approx(-earth.EARTH_RATE * 10.0, rel=1e-9)


def level_flight(lat, lon, heading, speed, height, seconds, dt):
    """Constant velocity in the wander frame: what an ideal platform would feel, fed through the kernel."""
    s = NavState(
        np.array([1.0, 0, 0, 0]),
        np.array([speed * math.sin(heading), speed * math.cos(heading), 0.0]),
        earth.position_matrix(lat, lon),
        height,
    )
    x, mid = pack(s), np.zeros(M_SIZE)
    v = s.v_n.copy()
    for _ in range(round(seconds / (2 * dt))):
        C = x[X_C : X_C + 9].reshape(3, 3)
        f = frame_rates(C[2], height, v)
        w = (f.w_ie_n + f.w_en_n) * dt
        a = (np.cross(2 * f.w_ie_n + f.w_en_n, v) - f.gravity_n) * dt
        # b keeps to n, so its increments are those of n
        two(x, np.concatenate([w, w, a, a]), 2 * dt, mid)
    return x


def test_flight_along_a_meridian_over_the_pole():
    """1000 s at 300 m/s over the North Pole, along one meridian: the arc is that of the ellipse."""
    lat0 = math.radians(89.0)
    x = level_flight(lat0, 0.5, 0.0, 300.0, 0.0, 1000.0, 0.05)
    lat, lon, _ = earth.position_angles(x[X_C : X_C + 9].reshape(3, 3))
    # past the pole the longitude is opposite; rates fed half an update late tilt by (5e-5)^2 * 0.05 rad/s,
    # 0.2 m after 1000 s
    assert abs(math.remainder(lon - 0.5 - math.pi, 2 * math.pi)) * math.cos(lat) * 6.4e6 < 0.5
    u, w = np.polynomial.legendre.leggauss(20)
    arc = 0.0
    for a in (lat0, lat):
        nodes = a + (u + 1) * (math.pi / 2 - a) / 2
        arc += np.sum(w * [earth.radii(math.sin(b))[0] for b in nodes]) * (math.pi / 2 - a) / 2
    assert arc == pytest.approx(300_000.0, abs=2.0)
    np.testing.assert_allclose(x[X_V : X_V + 3], [0.0, 300.0, 0.0], atol=0.01)


def test_level_flight_follows_the_geodesic():
    """Constant velocity in the wander frame is a geodesic: Clairaut's relation holds."""
    lat0, heading = 0.5, 1.0
    x = level_flight(lat0, 0.0, heading, 250.0, 0.0, 3600.0, 0.1)
    C = x[X_C : X_C + 9].reshape(3, 3)
    lat, _, wander = earth.position_angles(C)
    v = x[X_V : X_V + 2]
    azimuth = math.atan2(v[0], v[1]) - wander

    def clairaut(b, a):
        return earth.radii(math.sin(b))[1] * math.cos(b) * math.sin(a)

    assert abs(lat - lat0) > 0.03
    # first-order feeding as above: 2e-6 of the direction
    assert clairaut(lat, azimuth) == pytest.approx(clairaut(lat0, heading), rel=5e-6)


def test_a_drive_ends_where_it_ends():
    """Two minutes of a figure of eight with rolling and pitching, exact increments at 200 Hz."""
    drive = Drive()
    dt, seconds = 0.005, 120
    lat, lon, h, v_g, C_gb = drive.geodetic(0.0)
    x = pack(NavState(rot.quat_from_dcm(C_gb), v_g, earth.position_matrix(lat, lon), h))
    run(x, *drive.increments(round(seconds / dt), dt), dt)
    lat, lon, h, v_g, C_gb = drive.geodetic(float(seconds))
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    lat1, lon1, wander = earth.position_angles(C_en)
    C_gn = earth.position_matrix(lat1, lon1).T @ C_en
    # sculling of third order: 1e-7 m/s^2 over two minutes
    assert (
        np.linalg.norm(
            np.array(earth.geodetic_to_xyz(lat1, lon1, x[X_H])) - drive.position(np.array(seconds))
        )
        < 5e-3
    )
    np.testing.assert_allclose(C_gn @ x[X_V : X_V + 3], v_g, atol=1e-4)
    np.testing.assert_allclose(C_gn @ rot.dcm_from_quat(x[X_Q : X_Q + 4]), C_gb, atol=1e-8)
    assert abs(wander) < 1e-3
