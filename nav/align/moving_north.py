"""What the weighing pass of a moving gyrocompass says, in axes that are east, north and up.

The pass keeps the azimuth of n that it began with. Where north is, it says beside (`Weights.north`), and all
that n has seen is turned by that: attitude and velocity, and the way, about the place where it began.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav.align.handover import Place
from nav.align.moving_block import NAB, POS, RATE, TILT, VEL
from nav.align.moving_weights import Weights
from nav.earth import ecef, position_angles, position_matrix, xyz_to_geodetic
from nav.rotation import dcm_from_quat, quat_from_rotvec, quat_multiply
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V
from nav.types import Vector

_UP = np.array([0.0, 0.0, 1.0])


class Turned(NamedTuple):
    """State ``x`` of the kernel with all that is known of it, its n being what it was.

    ``q_gb`` (4,) is the attitude, ``C_gn`` (3, 3) takes n to east, north, up.
    """

    x: Vector
    q_gb: Vector
    C_gn: Vector


def turned(weights: Weights, origin: Place) -> Turned:
    """With north where it is found to be; the pass began at ``origin``."""
    north = weights.north()
    x = weights.x.copy()
    x[X_V : X_V + 3] += north.error[VEL]
    x[X_Q : X_Q + 4] = quat_multiply(quat_from_rotvec(north.error[TILT]), x[X_Q : X_Q + 4])
    about = dcm_from_quat(quat_from_rotvec(north.angle * position_matrix(*origin[0:2])[:, 2]))
    C_en = about @ x[X_C : X_C + 9].reshape(3, 3)
    x[X_C : X_C + 9] = C_en.ravel()
    turn = quat_from_rotvec(position_angles(C_en)[2] * _UP)
    return Turned(x, quat_multiply(turn, x[X_Q : X_Q + 4]), dcm_from_quat(turn))


def phi_covariance(weights: Weights, C_gn: Vector) -> Vector:
    """Covariance (3, 3) of phi, rad^2."""
    J = np.zeros((3, len(weights.P)))
    J[:, TILT], J[2, RATE] = C_gn, weights.north().by
    return np.asarray(J @ weights.north().P @ J.T)


def place(weights: Weights, found: Turned, origin: Place) -> tuple[Place, Vector]:
    """Where it is by way that the pass made from ``origin``, and the displacement (3,) m east, north, up."""
    north = weights.north()
    C_en = weights.x[X_C : X_C + 9].reshape(3, 3)
    lat, lon, _ = position_angles(C_en)
    began_e = ecef(*origin)
    way_e = ecef(lat, lon, float(weights.x[X_H])) + C_en @ (weights.shift + north.error[POS]) - began_e
    way_e = dcm_from_quat(quat_from_rotvec(north.angle * position_matrix(*origin[0:2])[:, 2])) @ way_e
    x, y, z = began_e + way_e
    C_eg = found.x[X_C : X_C + 9].reshape(3, 3) @ found.C_gn.T
    return xyz_to_geodetic(float(x), float(y), float(z)), C_eg.T @ way_e


def covariance(weights: Weights, found: Turned, way_g: Vector) -> Vector:
    """Covariance (15, 15) of what is handed over, ``way_g`` (3,) m from where the pass began."""
    by, C, v_g = weights.north().by, found.C_gn, found.C_gn @ found.x[X_V : X_V + 3]
    J = np.zeros((15, len(weights.P)))
    for part in (POS, VEL, TILT):
        J[part, part] = C
    J[TILT.stop : NAB.stop, TILT.stop : NAB.stop] = np.eye(NAB.stop - TILT.stop)
    # who takes something else for north turns all of it
    for part, turns in ((POS, np.cross(_UP, way_g)), (VEL, np.cross(_UP, v_g)), (TILT, _UP)):
        J[part, RATE] = np.outer(turns, by)
    return np.asarray(J @ weights.north().P @ J.T)
