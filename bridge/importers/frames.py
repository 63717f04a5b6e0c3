"""Columns of numbers as the raw CAN frames that a device would have sent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from dbc.codec import MessageCodec, Value, contract
from nav.types import FixType, Vector

_SAMPLE_US: Final = 1 << 32
_STAMP_US: Final = 6_553_600
_PULSES: Final = 32767
_FORWARD: Final = 1
_REVERSE: Final = 2
_STANDSTILL_M_S: Final = 1e-3


class Sent(NamedTuple):
    """A frame and the time it arrives, ns on the time scale of the tables."""

    t_ns: int
    key: int
    data: bytes


class _Message:
    """A message of the contract, sent by name with a counter of its own."""

    def __init__(self, name: str, id_offset: int) -> None:
        self._codec: MessageCodec = contract()[name]
        self._key = self._codec.frame_id + id_offset

    def frame(self, t_ns: int, count: int, values: Mapping[str, Value]) -> Sent:
        """The frame number ``count``; signals that ``values`` does not name are 0."""
        codec = self._codec
        alive = count % codec.alive_modulus
        return Sent(t_ns, self._key, codec.encode(alive, *[values.get(name, 0) for name in codec.signals]))


class PulseOverflow(ValueError):
    """An increment that does not fit into the 16 bits of a pulse count."""

    def __init__(self, row: int, pulses: float) -> None:
        super().__init__(f"{pulses:.0f} pulses in one sample")
        self.row = row


def pulses(rates: Vector, dt: Vector, plus: Vector, minus: Vector) -> Vector:
    """Whole pulses (n, 3) of rates (n, 3) held for ``dt`` (n,) s, the rest carried to the next sample.

    ``plus`` and ``minus`` (3,) are what one positive and one negative pulse stand for, in the rates'
    unit times seconds. The sum of pulses differs from the integral by less than one at any time.

    Raises:
        PulseOverflow: a count outside 16 bits, with the row it belongs to.
    """
    increments = rates * dt[:, None]
    exact = np.cumsum(increments / np.where(increments < 0.0, minus, plus), axis=0)
    counts: Vector = np.diff(np.rint(exact), axis=0, prepend=0.0)
    over = np.abs(counts).max(axis=1) > _PULSES
    if over.any():
        row = int(np.argmax(over))
        raise PulseOverflow(row, float(np.abs(counts[row]).max()))
    return counts


def imu_frames(
    times_ns: list[int],
    gyro_pulses: Vector,
    accel_pulses: Vector,
    samples: list[int],
    *,
    delay_ns: int,
    id_offset: int,
    temperature_deg_c: float,
) -> Iterator[Sent]:
    """IMU_GYRO, IMU_ACCEL and IMU_TIME of each sample; ``samples`` are its running numbers.

    The counter of device time has the zero of ``times_ns``: units that are synchronised to GNSS count so.
    """
    gyro = _Message("IMU_GYRO", id_offset)
    accel = _Message("IMU_ACCEL", id_offset)
    time = _Message("IMU_TIME", id_offset)
    temperature = round(temperature_deg_c)
    for t_ns, w, f, sample in zip(
        times_ns, gyro_pulses.astype(int).tolist(), accel_pulses.astype(int).tolist(), samples, strict=True
    ):
        rx_ns = t_ns + delay_ns
        yield gyro.frame(rx_ns, sample, {"GYRO_X": w[0], "GYRO_Y": w[1], "GYRO_Z": w[2]})
        yield accel.frame(rx_ns, sample, {"ACCEL_X": f[0], "ACCEL_Y": f[1], "ACCEL_Z": f[2]})
        yield time.frame(
            rx_ns,
            sample,
            {
                "SAMPLE": sample % 256,
                "TEMPERATURE": temperature,
                "TIME": round(t_ns / 1000) % _SAMPLE_US,
            },
        )


class Fixes(NamedTuple):
    """GNSS columns: degrees, metres, metres a second; triples are east, north, up.

    ``times_ns`` count from the beginning of GPS time.
    """

    times_ns: list[int]
    leap_seconds: int
    lat_deg: Vector
    lon_deg: Vector
    height: Vector
    sigma: Vector
    velocity: Vector | None
    sigma_velocity: Vector
    fix_types: list[FixType]
    satellites: int


_WEEK_US: Final = 604_800_000_000


def gnss_frames(fixes: Fixes, keep: list[bool], *, delay_ns: int, id_offset: int) -> Iterator[Sent]:
    """The six frames of each epoch that is kept."""
    time, lat, lon = (_Message(f"GNSS_{name}", id_offset) for name in ("TIME", "LAT", "LON"))
    height, speed, accuracy = (_Message(f"GNSS_{name}", id_offset) for name in ("HEIGHT", "VEL", "ACC"))
    epoch = 0
    for row, t_ns in enumerate(fixes.times_ns):
        if not keep[row]:
            continue
        rx_ns = t_ns + delay_ns
        weeks, tow_us = divmod(round(t_ns / 1000), _WEEK_US)
        sigma = _within(fixes.sigma[row], 16.382)
        yield time.frame(rx_ns, epoch, {"TOW": tow_us, "WEEK": weeks % 4096})
        yield lat.frame(rx_ns, epoch, {"LAT": float(fixes.lat_deg[row]), "SIGMA_N": sigma[1]})
        yield lon.frame(rx_ns, epoch, {"LON": float(fixes.lon_deg[row]), "SIGMA_E": sigma[0]})
        yield height.frame(
            rx_ns,
            epoch,
            {
                "HEIGHT": float(fixes.height[row]),
                "SIGMA_U": sigma[2],
                "FIX_TYPE": int(fixes.fix_types[row]),
                "SATELLITES": fixes.satellites,
            },
        )
        v = (0.0, 0.0, 0.0) if fixes.velocity is None else fixes.velocity[row].tolist()
        yield speed.frame(rx_ns, epoch, {"VEL_E": v[0], "VEL_N": v[1], "VEL_U": v[2]})
        sigma_v = _within(fixes.sigma_velocity[row], 8.191)
        yield accuracy.frame(
            rx_ns,
            epoch,
            {
                "SIGMA_VE": sigma_v[0],
                "SIGMA_VN": sigma_v[1],
                "SIGMA_VU": sigma_v[2],
                "VEL_VALID": int(fixes.velocity is not None),
                "LEAP_SECONDS": fixes.leap_seconds,
            },
        )
        epoch += 1


def _within(sigma: Vector, largest: float) -> list[float]:
    """Standard deviations as the frame can carry them: a receiver saturates at its largest."""
    return [min(float(value), largest) for value in sigma]


def odometer_frames(
    times_ns: list[int], speed: Vector, m_per_tick: float, *, delay_ns: int, id_offset: int
) -> Iterator[Sent]:
    """ODO: cumulative ticks of the speed (n,) m/s held over the interval that ends at each time."""
    odometer = _Message("ODO", id_offset)
    dt = np.diff(np.array(times_ns, dtype=np.int64), prepend=times_ns[0]) / 1e9
    ticks = np.rint(np.cumsum(np.abs(speed) * dt) / m_per_tick).astype(int).tolist()
    for count, (t_ns, total, v) in enumerate(zip(times_ns, ticks, speed.tolist(), strict=True)):
        yield odometer.frame(
            t_ns + delay_ns,
            count,
            {
                "DIRECTION": _REVERSE if v < 0.0 else _FORWARD,
                "STANDSTILL": int(abs(v) < _STANDSTILL_M_S),
                "VALID": 1,
                "TICKS": total % (1 << 32),
                "TIME": t_ns // 100_000 * 100 % _STAMP_US,
            },
        )


def baro_frames(
    times_ns: list[int], pressure: Vector, temperature_deg_c: float, *, delay_ns: int, id_offset: int
) -> Iterator[Sent]:
    """BARO: static pressure (n,) Pa."""
    baro = _Message("BARO", id_offset)
    for count, (t_ns, value) in enumerate(zip(times_ns, pressure.tolist(), strict=True)):
        yield baro.frame(
            t_ns + delay_ns,
            count,
            {
                "VALID": 1,
                "PRESSURE": value,
                "TEMPERATURE": temperature_deg_c,
                "TIME": t_ns // 100_000 * 100 % _STAMP_US,
            },
        )
