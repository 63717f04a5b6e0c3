"""The linear error model of the navigator, phi-angle form, whatever its azimuth law.

Readable definition; `nav.filter.covariance` holds the sparse twin. The true frame n stands at the true
position and is reached from the computed frame c by the shortest turn, so position errors are two level
distances and a height, and nothing is singular at a pole. The azimuth law turns both frames alike: what
the law's rate is computed from (latitude, east velocity) makes no error of its own.

Sources: Groves, 2nd ed., section 14.2; the excerpt on psi-angle and phi-angle models, eqs. (2.2.1) to
(2.2.19); Yan Gongmin 2008, eq. (4-17) for the sign of the gyro error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nav.filter import states as st
from nav.rotation import skew

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def error_dynamics(
    C_nb: Matrix,
    f_b: Vector,
    w_b: Vector,
    v_n: Vector,
    w_ie_n: Vector,
    w_en_n: Vector,
    curvature: tuple[float, float, float],
    gravity_gradient: float,
    f_rest_b: Vector | None = None,
) -> Matrix:
    """F (FULL, FULL) of ``d(dx)/dt = F dx`` for the states of `nav.filter.states`.

    ``C_nb`` (3, 3); ``f_b``, ``w_b`` (3,) specific force and rate in b, corrected; ``v_n`` (3,) m/s;
    ``w_ie_n``, ``w_en_n`` (3,) rad/s; ``curvature`` of `nav.earth.curvature`; ``gravity_gradient``
    2 g / R, 1/s^2; ``f_rest_b`` (3,) the specific force at which the accelerometers' axes make no error.
    """
    kxx, kxy, kyy = curvature
    mean = 0.5 * (kxx + kyy)
    # dtheta = D dp: turn of c with respect to n; also dw_en = D dv at constant place
    D = np.array([[-kxy, -kyy, 0.0], [kxx, kxy, 0.0], [0.0, 0.0, 0.0]])
    up = np.array([0.0, 0.0, 1.0])
    level = np.diag([1.0, 1.0, 0.0])

    # dw_ie = -dtheta x w_ie; dw_en = D dv - (level w_en) dh/R, and a vertical part because the true
    # frame is tied to the computed one
    ie_p = skew(w_ie_n) @ D
    en_p = np.outer(up, up) @ skew(w_en_n) @ D - mean * np.outer(level @ w_en_n, up)
    en_v = D

    F = np.zeros((st.FULL, st.FULL))
    p, v, phi = st.POSITION, st.VELOCITY, st.PHI
    F[p, p] = mean * v_n[2] * level - mean * np.outer(level @ v_n, up) - w_en_n[2] * skew(up)
    F[p, v] = np.eye(3)
    F[v, p] = skew(v_n) @ (2.0 * ie_p + en_p) + gravity_gradient * np.outer(up, up)
    F[v, v] = -skew(2.0 * w_ie_n + w_en_n) + skew(v_n) @ en_v
    F[v, phi] = skew(C_nb @ f_b)
    F[v, st.ACCEL_BIAS] = -C_nb
    force = f_b if f_rest_b is None else f_b - f_rest_b
    F[v, st.ACCEL_AXES] = -np.kron(C_nb, force)
    F[phi, p] = ie_p + en_p
    F[phi, v] = en_v
    F[phi, phi] = -skew(w_ie_n + w_en_n)
    F[phi, st.GYRO_BIAS] = C_nb
    F[phi, st.GYRO_AXES] = np.kron(C_nb, w_b)
    return F
