"""Where the sensors of a unit sit and when they are read, if not in one point and at one instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_bus.dither import Dither, Times
from virtual_bus.grades import ImuErrors
from virtual_bus.truth import Trajectory

Array = NDArray[np.float64]

# Gauss's rule of three points on [0, 1]: exact for the centripetal force of a rate that is a parabola
_PLACES = 0.5 + np.array([-0.5, 0.0, 0.5]) * np.sqrt(0.6)
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """``dithers`` of three gyros that are latched at whole cycles; ``arms`` (3, 3) m of three accelerometers.

    None: gyros that are read at the instants, accelerometers that sit in the origin. Row i of the arms is
    the place of accelerometer i in the unit's axes.
    """

    dithers: tuple[Dither, Dither, Dither] | None = None
    arms: Array | None = None

    def outputs(self, trajectory: Trajectory, errors: ImuErrors, t_ns: Times) -> tuple[Array, Array]:
        """What six sensors without bias put out between the times ``t_ns`` (n,), rad and m/s, (n-1, 6).

        The second are the seconds that each took for it, (n-1, 6) or (n-1, 1).
        """
        dtheta, dv = trajectory.increments(t_ns)
        gyro, accel = errors.gyro, errors.accel
        spans = np.diff(t_ns)[:, None] * 1e-9
        out_accel = dv @ accel.axes.T
        if self.arms is not None:
            out_accel += self._excess(trajectory, accel.axes, t_ns)
        if self.dithers is None:
            return np.concatenate(
                (dtheta @ gyro.axes.T + dv @ gyro.g_sensitivity.T, out_accel), axis=1
            ), spans
        spans = np.repeat(spans, 6, axis=1)
        out_gyro = np.empty((len(t_ns) - 1, 3))
        for i, dither in enumerate(self.dithers):
            latched = np.maximum(dither.latched(t_ns), 0)
            turned, pushed = trajectory.increments(latched)
            out_gyro[:, i] = turned @ gyro.axes[i] + pushed @ gyro.g_sensitivity[i]
            spans[:, i] = np.diff(latched) * 1e-9
        return np.concatenate((out_gyro, out_accel), axis=1), spans

    def ages(self, t_ns: Times) -> Array | None:
        """How long before ``t_ns`` (n,) each gyro was latched, (n, 3) s; None where none dithers."""
        if self.dithers is None:
            return None
        return np.stack([dither.age(t_ns) for dither in self.dithers], axis=1)

    def _excess(self, trajectory: Trajectory, axes: Array, t_ns: Times) -> Array:
        """What the arms add to the accelerometers' outputs, (n-1, 3) m/s."""
        assert self.arms is not None
        C_vb = trajectory.vehicle.C_vb
        ends = trajectory.motion(t_ns).w_iv_v @ C_vb
        spans = np.diff(t_ns)
        inside = t_ns[:-1, None] + np.rint(spans[:, None] * _PLACES).astype(np.int64)
        rate = (trajectory.motion(inside.ravel()).w_iv_v @ C_vb).reshape(-1, 3, 3)
        change = np.diff(ends, axis=0)
        out = np.empty((len(spans), 3))
        for i, (axis, arm) in enumerate(zip(axes, self.arms, strict=True)):
            inwards = np.cross(rate, np.cross(rate, arm)) @ axis
            out[:, i] = np.cross(change, arm) @ axis + spans * 1e-9 * (inwards @ _WEIGHTS)
        return out
