"""Counts of perfect or noisy sensors in the intervals of a plan, written apart from the code under test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nav.calibrate.intervals import Interval, Place, place_at
from nav.calibrate.model import LETTERS, Model, Terms, sensor
from nav.calibrate.plan import Position, Rotation, Step, faces, planned
from nav.calibrate.solve import Noise
from nav.imu.geometry import with_skew

DEG = np.pi / 180.0
ARCSEC = DEG / 3600.0
G = 9.80665
LAT = 34.25 * DEG
NOISE = Noise(0.01 * DEG / 60.0, 0.03 * DEG / 3600.0, 40e-6 * G, 20e-6 * G, 1800.0)
TABLE_2_12 = ("SUW", "NUE", "UWS", "DWN", "NWU", "SWD", "NDW", "SDE")
FACES_12 = ("UNW", "USE", "DNE", "DSW", "NUE", "SUW", "NDW", "SDE", "NWU", "SEU", "NED", "SWD")
AXES = np.eye(3)
ORTHOGONAL_AND_SKEW = with_skew()
SKEW = ORTHOGONAL_AND_SKEW[3:]


def rotations(rate_deg: float = 10.0, turns: int = 1) -> list[Step]:
    return [
        Rotation("+-"[sign < 0] + LETTERS[k], faces(start), AXES[k], sign * rate_deg * DEG, turns)
        for k, start in enumerate(("UEN", "NUE", "ENU"))
        for sign in (1, -1)
    ]


def positions(letters: Sequence[str], seconds: float = 60.0) -> list[Step]:
    return [Position(one, faces(one), seconds) for one in letters]


def place(tilt: float = 20 * ARCSEC, north: float = 60 * ARCSEC, gravity: float = 50e-6 * G) -> Place:
    return place_at(LAT, 400.0, None, (tilt, north, gravity))


def model(axes: np.ndarray, where: Place | None = None, terms: Terms | None = None) -> Model:
    """Gyros and accelerometers on the same axes."""
    sensors = [
        sensor(f"{kind} {k}", kind == "gyro", axis, scale, terms or Terms())
        for kind, scale in (("gyro", 0.1 * ARCSEC), ("accel", 2e-5))
        for k, axis in enumerate(axes)
    ]
    return Model(tuple(sensors), where or place())


@dataclass
class Unit:
    """Sensors as they are: axes (n, 3) with all gyros first, pulses up and down, bias, g sensitivity.

    ``second`` (n, 3, 3): f . second @ f is added to what a sensor puts out; symmetric.
    """

    gyros: int
    axes: np.ndarray
    plus: np.ndarray
    minus: np.ndarray
    bias: np.ndarray
    g: np.ndarray
    second: np.ndarray

    @classmethod
    def draw(cls, axes: np.ndarray, rng: np.random.Generator, asymmetry: float = 100e-6) -> Unit:
        n = len(axes)
        both = np.vstack((axes, axes))
        pulse = np.repeat((0.1 * ARCSEC, 2e-5), n) * (1.0 + 3e-4 * rng.standard_normal(2 * n))
        uneven = asymmetry * rng.standard_normal(2 * n)
        g = np.zeros((2 * n, 3))
        g[:n] = 0.5 * DEG / 3600.0 / G * rng.standard_normal((n, 3))
        return cls(
            n,
            both + 4e-4 * rng.standard_normal((2 * n, 3)),
            pulse * (1.0 - 0.5 * uneven),
            pulse * (1.0 + 0.5 * uneven),
            np.repeat((1.0 * DEG / 3600.0, 2e-3 * G), n) * rng.standard_normal(2 * n),
            g,
            np.zeros((2 * n, 3, 3)),
        )

    def count(
        self,
        steps: Sequence[Step],
        where: Place,
        delta: np.ndarray | None = None,
        gravity: float = 0.0,
        rng: np.random.Generator | None = None,
        noise: Noise = NOISE,
    ) -> list[Interval]:
        """Pulses, not whole, over the plan's intervals with a table turned by ``delta`` (3,) rad."""
        delta = np.zeros(3) if delta is None else delta
        angle = np.linalg.norm(delta)
        K = np.cross(np.eye(3), delta / angle) if angle else np.zeros((3, 3))
        C = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K  # exp(delta x)
        found = []
        for interval in planned(steps):
            M = interval.attitude
            W = interval.turned + M @ C.T @ where.w_g
            F = M @ C.T @ where.f_g * (1.0 + gravity)
            shown = np.vstack((np.tile(W, (self.gyros, 1)), np.tile(F, (len(self.axes) - self.gyros, 1))))
            out = np.sum(self.axes * shown, axis=1) + self.bias * interval.seconds + self.g @ F
            out = out + self.second_order(interval, C, where.gravity * (1.0 + gravity))
            if rng is not None:
                walk = np.where(np.arange(len(out)) < self.gyros, noise.gyro_walk, noise.accel_walk)
                out = out + walk * np.sqrt(interval.seconds) * rng.standard_normal(len(out))
            found.append(
                replace(
                    interval,
                    plus=np.maximum(out, 0.0) / self.plus,
                    minus=np.maximum(-out, 0.0) / self.minus,
                )
            )
        return found

    def second_order(self, interval: Interval, C: np.ndarray, gravity: float) -> np.ndarray:
        """Integral of f . second @ f; of a turn by the mean over its circle."""
        if interval.rotation:
            axis = interval.turned / np.linalg.norm(interval.turned)
            up = interval.attitude[:, 2] / interval.seconds
            aside = 0.5 * (1.0 - up @ up) * (np.eye(3) - np.outer(axis, axis))
            mean = np.outer(up, up) + aside
        else:
            up = interval.attitude @ C.T[:, 2] / interval.seconds
            mean = np.outer(up, up)
        return gravity**2 * interval.seconds * np.einsum("nij,ij->n", self.second, mean)

    def truth(self, of: Model) -> np.ndarray:
        """The unknowns of a model, without the table's."""
        values: list[float] = []
        for k, one in enumerate(of.sensors):
            # a model's axis has the length at which its part along the nominal one is 1
            along = float(self.axes[k] @ one.axis)
            plus, minus = self.plus[k] / along, self.minus[k] / along
            values.append(0.5 * (plus + minus) / one.scale - 1.0)
            if "asymmetry" in one.terms:
                values.append((minus - plus) / one.scale)
            values += [float(self.axes[k] @ one.across[:, side]) / along for side in (0, 1)]
            values.append(self.bias[k] / along)
            if "g sensitivity x" in one.terms:
                values += (self.g[k] / along).tolist()
            Q, u, (v, w) = self.second[k] / along, one.axis, one.across.T
            if "product yz" in one.terms:
                values += [2.0 * float(Q[i, j]) for i, j in ((1, 2), (2, 0), (0, 1))]
            elif "square" in one.terms:
                values += [float(u @ Q @ u), 2.0 * float(u @ Q @ v), 2.0 * float(u @ Q @ w)]
        return np.array(values)
