"""Pure inertial navigation along a known path with the program's strapdown kernel, and its errors.

Errors are taken in Earth-fixed axes, where nothing is special at a pole.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.studies.figures.exact_increments import GreatCircle, integrals, place
from nav import rotation as rot
from nav.strapdown.azimuth import azimuth_control
from nav.strapdown.control import U_H, U_KH
from nav.strapdown.kernels import X_C, X_H, X_HEAD, X_Q, X_V, integrate

Array = NDArray[np.float64]

PIECE_S: Final = 60.0
"""A state is kept each minute."""
SAMPLES: Final = 2
"""In an update."""
HEIGHT_GAINS: Final = (2.0 / 30.0, 1.0 / 900.0, 0.0)
"""Of the height channel, which is fed with the true height: critically damped, 30 s."""


class Run(NamedTuple):
    """A navigated path: epochs ``t`` (n,) s; Earth-fixed, what was found and its errors.

    ``position`` and ``velocity`` (n, 3), ``C_eb`` (n, 3, 3). Errors (n,): ``horizontal`` m, ``level`` rad,
    ``azimuth`` rad about the true vertical. ``bearing`` (n,) rad: of the body's forward axis in n, clockwise
    from the second axis of n.
    """

    t: Array
    position: Array
    velocity: Array
    C_eb: Array
    horizontal: Array
    level: Array
    azimuth: Array
    bearing: Array


class Flight:
    """A navigator under an azimuth ``law`` that starts with the true state of ``path``.

    ``turn`` rad/s is the rate of a rotating law. n starts as right, forward, up of the path, under the north
    law as east, north, up.
    """

    def __init__(self, path: GreatCircle, law: str, turn: float = 0.0) -> None:
        up, forward = path.start, path.forward
        if law == "north":
            forward = np.array([0.0, 0.0, 1.0]) - up[2] * up
            forward = forward / np.linalg.norm(forward)
        C_en = np.stack((np.cross(forward, up), forward, up), axis=-1)
        zero = np.zeros(1)
        self.path = path
        self.x = np.zeros(X_HEAD)
        self.x[X_Q : X_Q + 4] = rot.quat_from_dcm(C_en.T @ path.attitude(zero)[0])
        self.x[X_V : X_V + 3] = C_en.T @ path.velocity(zero)[0]
        self.x[X_C : X_C + 9] = C_en.ravel()
        self.x[X_H] = path.height
        self.u = azimuth_control(law, turn)
        # the height of a path is constant, and so is what the channel is fed with
        self.u[U_H], self.u[U_KH : U_KH + 3] = path.height, HEIGHT_GAINS

    def navigate(self, samples: Array, dt: float) -> Array:
        """Go through ``samples`` (M, 6) of ``dt`` seconds; returns the state (X_HEAD,) after them."""
        integrate(self.x, samples, dt, SAMPLES, self.u, 1, np.empty((0, X_HEAD)))
        return self.x


def fly(flights: dict[str, Flight], rate_hz: float, hours: float) -> dict[str, Run]:
    """Navigate ``flights`` of one path, all by the same samples at ``rate_hz``."""
    path = next(iter(flights.values())).path
    pieces = round(hours * 3600.0 / PIECE_S)
    out = {name: np.empty((pieces, X_HEAD)) for name in flights}
    for k, samples in enumerate(integrals(path.rates, 1.0 / rate_hz, pieces, round(PIECE_S * rate_hz))):
        for name, flight in flights.items():
            out[name][k] = flight.navigate(samples, 1.0 / rate_hz)
    t = np.linspace(PIECE_S, PIECE_S * pieces, pieces)
    return {name: compare(path, t, states) for name, states in out.items()}


def compare(path: GreatCircle, t: Array, states: Array) -> Run:
    """Errors of the ``states`` (n, X_HEAD) at ``t`` (n,) s."""
    C_en = states[:, X_C : X_C + 9].reshape(-1, 3, 3)
    C_nb = rot.dcm_from_quat(states[:, X_Q : X_Q + 4])
    C_eb = C_en @ C_nb
    up = path.vertical(t)[0]
    position = place(C_en[:, :, 2], states[:, X_H])
    off = position - path.position(t)
    off -= np.sum(off * up, axis=-1, keepdims=True) * up
    angle = small_turn(C_eb, path.attitude(t))
    azimuth = np.sum(angle * up, axis=-1)
    return Run(
        t=t,
        position=position,
        velocity=np.einsum("nij,nj->ni", C_en, states[:, X_V : X_V + 3]),
        C_eb=C_eb,
        horizontal=np.linalg.norm(off, axis=-1),
        level=np.linalg.norm(angle - azimuth[:, None] * up, axis=-1),
        azimuth=azimuth,
        bearing=np.arctan2(C_nb[:, 0, 1], C_nb[:, 1, 1]),
    )


def small_turn(C: Array, C_other: Array) -> Array:
    """Small rotation vector (n, 3), rad, that takes the second attitude to the first, in their outer axes."""
    turned = C @ np.swapaxes(C_other, 1, 2)
    pairs = ((1, 2), (2, 0), (0, 1))
    return np.asarray(0.5 * np.stack([turned[:, j, i] - turned[:, i, j] for i, j in pairs], axis=-1))
