"""Monte Carlo: errors of the aided filter against the covariance that it claims."""

import math

import numpy as np
import pytest

from nav import earth
from nav import rotation as rot
from nav.events import Innovation
from nav.filter import states as st
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V
from nav.types import OdoSample
from tests.nav.truth import Drive, fix, hand_over, play, rolled, samples

DT, SECONDS, SEEDS = 0.02, 40, 16
ARW, VRW = 2e-4, 2e-3
SIGMAS = np.array([1.0] * 3 + [0.1] * 3 + [0.01, 0.01, 0.03] + [1e-3] * 3 + [0.03] * 3)
SCALE, MOUNTING = 1e-3, 0.02
LEVER = np.array([0.3, -0.5, 1.0])


def run(seed, wheel, place=(0.8, 0.2), fixes_hz=4.0, tick=0.0):
    """One drive about ``place`` (rad); a wheel counts ticks of ``tick`` m, or any distance where that is 0.

    Returns error and covariance of all states that were disturbed, and the NIS by kind.
    """
    rng = np.random.default_rng(seed)
    drive = Drive(*place, C_vb=rot.dcm_from_euler(0.5, 0.1, -0.1), nod=0.0)
    error = rng.normal(size=15) * SIGMAS
    axes_g, axes_a = rng.normal(size=(3, 3)) * SCALE, rng.normal(size=(3, 3)) * SCALE
    mu, odo_scale = rng.normal(size=2) * MOUNTING, rng.normal() * 0.01
    dtheta, dv = drive.increments(round(SECONDS / DT), DT)
    # biases are zero in truth, those of the accelerometers at rest; the hand-over believes something else
    lat, _, height, _, C_gb = drive.geodetic(0.0)
    rest = -C_gb.T @ earth.gravity_g(lat, height) * DT
    dtheta = dtheta + dtheta @ axes_g.T + ARW * math.sqrt(DT) * rng.normal(size=dtheta.shape)
    dv = dv + (dv - rest) @ axes_a.T + VRW * math.sqrt(DT) * rng.normal(size=dv.shape)
    guess = rot.dcm_from_quat(rot.quat_from_rotvec([-mu[0], 0.0, -mu[1]])) @ drive.C_vb
    config = NavigatorConfig(
        ImuErrors(
            ARW, VRW, 1e-3, 0.03, gyro_scale=SCALE, accel_scale=SCALE, gyro_axes=SCALE, accel_axes=SCALE
        ),
        C_vb=guess,
        sigma_mounting=MOUNTING,
        gnss_lever_arm=LEVER,
        odometer=wheel,
        odometer_sigma=0.01 if tick else 0.1,
        odometer_quantum=tick,
        non_holonomic=0.05 if wheel else None,
        slip=0.0,
        zero_velocity=None,
        mounting_walk=0.0,
        odometer_scale_walk=0.0,
    )
    navigator = Navigator(config)
    navigator.begin(hand_over(drive, error=error, sigmas=SIGMAS))
    epochs = np.arange(1, round(fixes_hz * SECONDS)) / fixes_hz + 0.0033
    aids = [(t, fix(drive, t, LEVER, rng=rng)) for t in epochs]
    total, count = tick * rng.random(), 0
    if wheel:
        for t in 0.2 * np.arange(1, 5 * SECONDS) + 0.0021:
            d = (rolled(drive, t - 0.2, t) + 0.2 * config.odometer_sigma * rng.normal()) / (1.0 + odo_scale)
            if tick:
                total += d
                d = (math.floor(total / tick) - count) * tick
                count = math.floor(total / tick)
            aids.append((t, OdoSample(round(t * 1e9), 0.2, d, False, "odo")))
    _, events = play(navigator, samples(dtheta, dv, DT), aids)

    live = navigator._timeline.live
    x, P = live.x, live.P
    t = navigator._timeline.t_ns * 1e-9
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    lat, lon, _ = earth.position_angles(C_en)
    r_e = np.array(earth.geodetic_to_xyz(lat, lon, x[X_H]))
    C_nb = C_en.T @ drive.C_eb(np.array(t))
    turned = rot.quat_from_dcm(rot.dcm_from_quat(x[X_Q : X_Q + 4]) @ C_nb.T)
    mounted = rot.quat_from_dcm(rot.dcm_from_quat(x[st.X_QV : st.X_QV + 4]) @ drive.C_vb.T)
    e = np.zeros(st.FULL)
    e[st.POSITION] = C_en.T @ (r_e - drive.position(np.array(t)))
    e[st.VELOCITY] = x[X_V : X_V + 3] - C_en.T @ drive.velocity_e(np.array(t))
    e[st.PHI] = -rot.rotvec_from_quat(turned)
    e[st.GYRO_BIAS] = x[st.X_BG : st.X_BG + 3]
    e[st.ACCEL_BIAS] = x[st.X_BA : st.X_BA + 3]
    e[15] = x[st.X_KO] - odo_scale
    e[st.MOUNTING] = -rot.rotvec_from_quat(mounted)[[0, 2]]
    e[st.GYRO_AXES] = x[st.X_MG : st.X_MG + 9] - axes_g.ravel()
    e[st.ACCEL_AXES] = x[st.X_MA : st.X_MA + 9] - axes_a.ravel()
    keep = [*range(18 if wheel else 15), *range(st.BASIC, st.FULL)]
    nis = {}
    for i in events:
        if isinstance(i, Innovation):
            nis.setdefault(i.kind, []).append(i.nis)
    return e[keep], P[np.ix_(keep, keep)], nis


def band(dof):
    """Two-sided 99.9 % band of a chi-square over its degrees of freedom (Wilson and Hilferty)."""
    a = 2.0 / (9.0 * dof)
    return (1 - a - 3.29 * math.sqrt(a)) ** 3, (1 - a + 3.29 * math.sqrt(a)) ** 3


GROUPS = {
    "all": slice(None),
    "position": slice(0, 3),
    "velocity": slice(3, 6),
    "phi": slice(6, 9),
    "gyro bias": slice(9, 12),
    "accel bias": slice(12, 15),
}


@pytest.mark.parametrize(("wheel", "tick"), [(False, 0.0), (True, 0.0), (True, 0.3)])
def test_errors_are_what_the_covariance_says(wheel, tick):
    """A tick of 0.3 m is 1.5 m/s over an interval; what one count leaves out is in the next."""
    runs = [run(seed, wheel, tick=tick) for seed in range(SEEDS)]
    for name, part in GROUPS.items():
        total, dof = 0.0, 0
        for e, P, _ in runs:
            total += e[part] @ np.linalg.solve(P[part, part], e[part])
            dof += len(e[part])
        low, high = band(dof)
        # wheels of this truth never slip: the constraint is better than it claims, errors may be smaller
        assert (0.5 if wheel else 1.0) * low < total / dof < high, (name, total / dof)
    for kind, rows in {"gnss_position": 3, "gnss_velocity": 3, "odometer": 1}.items():
        nis = np.concatenate([r[2].get(kind, []) for r in runs])
        if len(nis):
            low, high = band(rows * len(nis))
            assert low < np.mean(nis) / rows < high, (kind, np.mean(nis) / rows)


def claimed(runs):
    """Rms sigmas over runs, of both level axes together: how n stands about the vertical is no matter."""
    variance = np.mean([np.diag(P) for _, P, _ in runs], axis=0)
    for level in (slice(0, 2), slice(3, 5), slice(6, 8)):
        variance[level] = np.mean(variance[level])
    return np.sqrt(variance)


@pytest.fixture(scope="module")
def at_mid_latitude():
    return claimed([run(seed, False, fixes_hz=1.0) for seed in range(8)])


@pytest.mark.parametrize(
    "place",
    [(np.pi / 2, 0.0), (-np.pi / 2, 1.0), (1.0, np.pi), (0.0, 0.0)],
    ids=["north pole", "south pole", "date line", "equator"],
)
def test_no_place_on_earth_is_special(place, at_mid_latitude):
    """The eight begins at the pole or on the line and comes back to it a second before the end."""
    runs = [run(seed, False, place, fixes_hz=1.0) for seed in range(8)]
    for name, part in GROUPS.items():
        nees = [e[part] @ np.linalg.solve(P[part, part], e[part]) for e, P, _ in runs]
        dof = len(runs) * len(runs[0][0][part])
        low, high = band(dof)
        assert low < np.sum(nees) / dof < high, (name, np.sum(nees) / dof)
    for kind in ("gnss_position", "gnss_velocity"):
        nis = np.concatenate([r[2][kind] for r in runs])
        low, high = band(3 * len(nis))
        assert low < np.mean(nis) / 3 < high, (kind, np.mean(nis) / 3)
    # as well known as anywhere: only gravity, Coriolis force and Earth rate differ
    np.testing.assert_allclose(claimed(runs), at_mid_latitude, rtol=0.02)
