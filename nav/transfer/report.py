"""What a transfer alignment tells while it runs, and of which it hands over the last."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav import rotation as rot
from nav.align.types import TransferConfig
from nav.earth import position_angles
from nav.events import TransferProgress
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V
from nav.transfer.covariance import turned_about_up
from nav.transfer.kernels import S_DT, S_FB, S_WB
from nav.transfer.matching import Matching
from nav.transfer.slave import Slave
from nav.transfer.states import MOUNTING, NAMES, PHI, POSITION, VELOCITY, place
from nav.types import MasterState

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class Report(NamedTuple):
    """The slave at its newest sample.

    Position (rad, rad, m), ``v_g`` (3,) m/s, ``q_gb`` (4,), ``w_b`` (3,) rad/s and ``f_b`` (3,) m/s^2 over
    the last sample; ``x`` (X_SIZE,) the nominal state. ``P`` (SIZE, SIZE): covariance of the states of
    `nav.transfer.states` in east, north, up, against the truth: the master's own errors are in it, which
    ``relative``, the same else, and `progress` leave out.
    """

    progress: TransferProgress
    lat: float
    lon: float
    height: float
    v_g: Vector
    q_gb: Vector
    w_b: Vector
    f_b: Vector
    x: Vector
    P: Matrix
    relative: Matrix


def ratios(P: Matrix, first: Vector, matching: Matching) -> tuple[tuple[str, float], ...]:
    """Of each estimated state that was not known exactly at first, its name and sigma over the first one."""
    sigma = np.sqrt(np.diag(P))
    told = np.flatnonzero((matching.mask > 0.0) & (first > 0.0)).tolist()
    return tuple(zip((NAMES[k] for k in told), (sigma[told] / first[told]).tolist(), strict=True))


def report(
    slave: Slave,
    matching: Matching,
    transfer: TransferConfig,
    master: MasterState,
    seen: tuple[tuple[str, float], ...],
    quality: float,
) -> Report:
    """The slave's live state; ``master`` is the last message in use, for its own errors."""
    x = slave.live
    lat, lon, wander = position_angles(x[X_C : X_C + 9].reshape(3, 3))
    q_gn = rot.quat_from_rotvec(np.array([0.0, 0.0, wander]))
    C_gn = rot.dcm_from_quat(q_gn)
    P = turned_about_up(slave.P, wander)
    sigma = np.sqrt(np.diag(P))
    east, north, up = sigma[PHI].tolist()
    mx, my, mz = x[place(MOUNTING)].tolist()
    sx, sy, sz = sigma[MOUNTING].tolist()
    progress = TransferProgress(
        slave.newest_ns,
        matching.name,
        (east, north, up),
        (mx, my, mz),
        (sx, sy, sz),
        seen,
        hint(matching, sigma[PHI] / transfer.sigma),
        quality,
    )
    relative = P.copy()
    for part, own in (
        (POSITION, master.sigma_position),
        (VELOCITY, master.sigma_velocity),
        (PHI, master.sigma_phi),
    ):
        if own is not None:
            P[part, part] += np.diag(np.square(own))
    sums = slave.live_sums
    w_b, f_b = sums[S_WB : S_WB + 3] / sums[S_DT], sums[S_FB : S_FB + 3] / sums[S_DT]
    v_g, q_gb = C_gn @ x[X_V : X_V + 3], rot.quat_multiply(q_gn, x[X_Q : X_Q + 4])
    return Report(progress, lat, lon, float(x[X_H]), v_g, q_gb, w_b, f_b, x.copy(), P, relative)


def hint(matching: Matching, short: Vector) -> str:
    """The manoeuvre that shows the angle that is furthest from what is asked for; ``short`` (3,): how far."""
    worst = int(np.argmax(short))
    if not matching.estimated or short[worst] <= 1.0:
        return ""
    return matching.heading if worst == 2 else matching.level
