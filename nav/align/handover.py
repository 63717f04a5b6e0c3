"""Handing over: what every alignment knows at its end, in the form that navigation starts from."""

from __future__ import annotations

import numpy as np

from nav.align.types import NavInit
from nav.earth import ecef, position_quat, xyz_to_geodetic
from nav.rotation import quat_rotate, skew
from nav.types import Vector

Place = tuple[float, float, float]
"""Latitude and longitude (rad), height (m)."""


def hand_over(
    t_ns: int,
    place: Place,
    v_g: Vector,
    q_gb: Vector,
    biases: Vector,
    P: Vector,
    C_vb: Vector | None,
    sigma_mounting: Vector | None,
) -> NavInit:
    """The state at ``t_ns``, standard deviations taken from ``P`` (15, 15) as `NavInit` has it.

    ``v_g`` (3,) m/s, ``q_gb`` (4,), ``biases`` (6,) of gyros (rad/s) and accelerometers (m/s^2) in b.
    """
    P = 0.5 * (P + P.T)
    sigma = np.sqrt(np.diag(P))
    return NavInit(
        t_ns=t_ns,
        lat=place[0],
        lon=place[1],
        height=place[2],
        v_g=v_g,
        q_gb=q_gb,
        P_phi=P[6:9, 6:9].copy(),
        sigma_v=sigma[3:6],
        sigma_p=sigma[0:3],
        gyro_bias=biases[0:3].copy(),
        accel_bias=biases[3:6].copy(),
        sigma_gyro_bias=sigma[9:12],
        sigma_accel_bias=sigma[12:15],
        C_vb=C_vb,
        sigma_mounting=sigma_mounting,
        P=P,
    )


def under_antenna(P: Vector, l_g: Vector) -> Vector:
    """Covariance (15, 15) of an IMU whose place is `imu_place` of an antenna's, as `NavInit` has it.

    ``P`` (15, 15) has the antenna's place. A wrong attitude turns the lever arm ``l_g`` (3,) m, so that place
    and attitude err together: phi x l is added to what is computed.
    """
    T = np.eye(15)
    T[0:3, 6:9] = skew(l_g)  # errors of place are true minus estimate
    return np.asarray(T @ P @ T.T)


def imu_place(antenna: Place, l_g: Vector) -> Place:
    """Place of the IMU under an antenna's, by the lever arm (3,) m east, north, up from one to the other."""
    lat, lon, height = antenna
    r_e = ecef(lat, lon, height) - quat_rotate(position_quat(lat, lon), l_g)
    return xyz_to_geodetic(float(r_e[0]), float(r_e[1]), float(r_e[2]))
