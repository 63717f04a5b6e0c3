"""Units of more than three gyros and three accelerometers: counts to increments in b, and who has failed.

Which sensors there are says the calibration file; how noisy they are and how often a test may fail without a
reason says ``[device.NAME.redundant]``. What comes out are ordinary samples; which sensors they are made of
is told by `nav.types.ImuChange` whenever that changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
from msgspec import Meta

from bridge.calibration import UNITS, CalibrationFile, G
from bridge.calibration_sensors import RedundantFile
from bridge.drivers.base import Context
from bridge.drivers.counters import Counters
from bridge.options import NotNegative, Positive
from bridge.outputs import UnitHealth
from bridge.strict import Table, plain
from nav.imu.many import Sensors
from nav.imu.parity import MOST
from nav.imu.redundant import Monitor, Noise, Redundant, RedundantUnit
from nav.imu.redundant_kernel import DETECTED, EXCLUDED
from nav.types import ImuChange, ImuFlag, Vector

MESSAGES: Final = ("IMU_GYRO", "IMU_GYRO_2", "IMU_ACCEL", "IMU_ACCEL_2")
"""Frames of a sample before the one with its time, in the order in which they are sent."""
NO_COUNT: Final = -32768
_ABSENT: Final = (NO_COUNT,) * 6
_FLAGS: Final = 3  # signals of each frame that say whether its counters were at the end of their range
_TWICE: Final = 2
_SATURATED: Final = int(ImuFlag.SATURATED)
_EXCLUDED: Final = int(ImuFlag.EXCLUDED)
_DEG: Final = math.pi / 180.0
_UG: Final = 1e-6 * G
_PPM: Final = 1e-6
_GYRO_BIAS: Final = UNITS["gyro"]["bias"]["deg_per_h"]


class RedundantOptions(Table, kw_only=True):
    """``[device.NAME.redundant]``: what sensors that are in order differ by, one sigma of each.

    Biases, and errors of scale and axis as a share of the motion, are what calibration leaves and time adds.
    ``false_alarms_per_h`` is how many tests of gyros, and of accelerometers, fail without a fault.
    """

    gyro_random_walk_deg_per_sqrt_h: Positive
    gyro_bias_deg_per_h: Positive
    gyro_scale_ppm: NotNegative
    accel_random_walk_ug_per_sqrt_hz: Positive
    accel_bias_ug: Positive
    accel_scale_ppm: NotNegative
    false_alarms_per_h: Annotated[float, Meta(gt=0.0, le=60.0)] = 0.01


def fusion_of(
    file: CalibrationFile | RedundantFile,
    options: RedundantOptions | None,
    whole_cycle: str | None,
    rate_hz: float,
    context: Context,
    counters: Counters,
) -> Fusion | None:
    """The fusion of a redundant unit, None of three gyros and three accelerometers.

    Raises:
        ConfigError: the options are not those of such a unit.
    """
    if isinstance(file, CalibrationFile):
        if options is not None:
            sensors = "a calibration file with more than three gyros and accelerometers"
            raise context.wrong("redundant", plain(options), sensors)
        return None
    if options is None:
        raise context.wrong("redundant", "no table", f"it for {len(file.gyros.axes)} gyros: their noise")
    if whole_cycle is not None:
        raise context.wrong("whole_cycle", whole_cycle, "it of a unit of three gyros alone")
    return Fusion(file, options, rate_hz, context, counters)


class Fusion:
    """What the sensors of one redundant unit come to, sample by sample.

    ``rate_hz`` is the unit's rate. Raises ConfigError where the calibration's axes or the options cannot be.
    """

    def __init__(
        self,
        file: RedundantFile,
        options: RedundantOptions,
        rate_hz: float,
        context: Context,
        counters: Counters,
    ) -> None:
        o = options
        self._counters = counters
        gyro = (o.gyro_random_walk_deg_per_sqrt_h * _DEG / 60.0, o.gyro_bias_deg_per_h * _GYRO_BIAS)
        accel = (o.accel_random_walk_ug_per_sqrt_hz * _UG, o.accel_bias_ug * _UG)
        monitor = Monitor(false_alarms=o.false_alarms_per_h)
        self._over = monitor.windows[-1]
        try:
            self._kinds = (
                _watched(file.gyros, *gyro, o.gyro_scale_ppm * _PPM, rate_hz, monitor),
                _watched(file.accels, *accel, o.accel_scale_ppm * _PPM, rate_hz, monitor),
            )
        except ValueError as error:
            raise context.wrong("redundant", plain(options), f"what tests can be made of: {error}") from error
        self._unit = RedundantUnit(*self._kinds)
        self._name = context.name
        self._sizes = (len(file.gyros.axes), len(file.accels.axes))
        self._biases = (gyro[1], accel[1])
        self._counts = np.zeros(2 * MOST)
        self._saturated = [0, 0]
        self.spans = True
        """Whether the sensors that are left of both kinds span three directions."""
        self._raw = False
        self._strange = 0
        self.health: UnitHealth | None = None
        """Who is not trusted since when, None before the first sample."""
        # compiled here, before a bus is opened: in order, and with a sensor that gives nothing
        for lost in (0.0, math.nan):
            self._counts[0] = self._counts[MOST] = lost
            self._unit.sample(self._counts, 1.0 / rate_hz, np.zeros(3), np.zeros(3))
        for kind in self._kinds:
            kind.state = kind.fresh()
        self._cofactors = self._cofactors_now()

    def counts(self, frames: Sequence[tuple[float, ...]]) -> Vector:
        """Counts (2 `MOST`,) as the fusion wants them, of the values of a sample's `MESSAGES`."""
        counts, strange = self._counts, False
        for kind, size in enumerate(self._sizes):
            first, second = frames[2 * kind], frames[2 * kind + 1]
            given = first[_FLAGS:] + second[_FLAGS:]
            place = MOST * kind
            counts[place : place + size] = given[:size]
            if NO_COUNT in given[:size]:
                counts[place : place + size][counts[place : place + size] == NO_COUNT] = math.nan
            strange |= given[size:] != _ABSENT[size:]
            full = first[:_FLAGS] + second[:_FLAGS]
            self._saturated[kind] = sum(1 << k for k in range(size) if full[k]) if any(full) else 0
        self._strange = self._strange + 1 if strange else 0
        if self._strange == _TWICE:
            gyros, accels = self._sizes
            self._counters.notes.append(
                f"counts of more than the {gyros} gyros and {accels} accelerometers of the calibration: "
                "no such sample is used"
            )
        return counts

    @property
    def strange(self) -> bool:
        """Whether the unit has said twice that it has sensors that the calibration has not."""
        return self._strange >= _TWICE

    def in_counts(self) -> None:
        """Give counts, as many as there are sensors, in the place of increments from now on; watch nobody."""
        self._raw = True

    def fuse(self, counts: Vector, t_ns: int, tau: float) -> tuple[int, ImuChange | None, Vector, Vector]:
        """Flags of ``counts`` over the ``tau`` s until ``t_ns``, what has changed, and the increments.

        These, (3,) rad and (3,) m/s, are NaN where too few sensors are left.
        """
        if self._raw:
            gyros, accels = self._sizes
            flags = _SATURATED if any(self._saturated) else 0
            return flags, None, counts[:gyros].copy(), counts[MOST : MOST + accels].copy()
        # what is in dv counts as felt by accelerometers
        dtheta, dv = np.zeros(3), np.zeros(3)
        status = self._unit.sample(counts, tau, dtheta, dv)
        health = self.health or UnitHealth(t_ns, 0, 0, 0, 0)
        change = None
        if status != (0, 0) or health.gyros_suspect or health.accels_suspect:
            change = self._change(t_ns, status, health)
            if change is not None:
                health = UnitHealth(t_ns, *change[2:6])
        self.health = health
        self.spans = math.isfinite(dtheta[0] + dv[0])
        flags = _EXCLUDED if health.gyros_out or health.accels_out else 0
        if self._saturated[0] & ~health.gyros_out or self._saturated[1] & ~health.accels_out:
            flags |= _SATURATED
        return flags, change, dtheta, dv

    def _change(self, t_ns: int, status: tuple[int, int], before: UnitHealth) -> ImuChange | None:
        out = [(1 << n) - 1 - _mask(kind.active) for kind, n in zip(self._kinds, self._sizes, strict=True)]
        suspect = [_mask(kind.suspects) for kind in self._kinds]
        now = UnitHealth(t_ns, out[0], suspect[0], out[1], suspect[1])
        if now.masks == before.masks and not (status[0] | status[1]) & EXCLUDED:
            return None
        # a sensor that has gone without a test that failed has done nothing wrong before
        tested = np.array([bool(each & DETECTED) for each in status])
        owed = np.where(tested[:, None], self._unit.owed, 0.0)
        cofactors = self._cofactors_now()
        moved = [np.abs(np.diag(new - old)) for new, old in zip(cofactors, self._cofactors, strict=True)]
        self._cofactors = cofactors
        bias = np.array([bias * np.sqrt(part) for bias, part in zip(self._biases, moved, strict=True)])
        kinds = zip(cofactors, self._kinds, strict=True)
        walk = np.array([part * kind.noise.walk**2 for part, kind in kinds])
        return ImuChange(t_ns, self._name, *now.masks, owed, self._over, bias, walk)

    def _cofactors_now(self) -> list[Vector]:
        """Of each kind the covariance (3, 3) of what is fused, a sensor's variance being 1; zero of nothing.

        Of sensors of equal noise the weights are optimal, so what some more of them change the result by has
        the difference of the covariances.
        """
        found = [kind.covariance(1.0) / kind.noise.variance(1.0) for kind in self._kinds]
        return [np.where(np.isfinite(one), one, 0.0) for one in found]


def _watched(
    sensors: Sensors, walk: float, bias: float, scale: float, rate_hz: float, monitor: Monitor
) -> Redundant:
    pulse = float(np.max(np.abs((sensors.scale_plus, sensors.scale_minus))))
    return Redundant(sensors, Noise(walk, pulse, bias, scale), rate_hz, monitor)


def _mask(sensors: Sequence[int]) -> int:
    return sum(1 << k for k in sensors)
