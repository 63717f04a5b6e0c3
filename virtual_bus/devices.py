"""Virtual devices: sensors with a clock of their own, sending the contract's frames.

A device is an iterator of `BusFrame` in time order. It works a second ahead of the bus, so a fault of a
sensor that is switched on by call holds from the second after.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.codec import MessageCodec, contract
from virtual_bus.axes import euler
from virtual_bus.faults import AliveCounter, BusFrame, Faults, Flood, Reset
from virtual_bus.grades import PPM
from virtual_bus.redundancy import NO_COUNT, PLACES
from virtual_bus.sayings import Sayings
from virtual_bus.sensors import Barometer, Gnss, Imu, Odometer, SpeedLog
from virtual_bus.tables import DeviceTable, GnssTable, ImuTable, MasterTable, OdometerTable, Start

Times = NDArray[np.int64]

FRAME_NS: Final = 130_000
"""Time between the frames of one sample: about that of a full classic frame at 1 Mbit/s."""
US: Final = 1_000
UNIT_100_US: Final = 100_000
SIGMA_POSITION_MAX: Final = 16.382
SIGMA_VELOCITY_MAX: Final = 8.191
LATCH_AGE_MAX_US: Final = 6553.5
NO_FIX: Final = 1
EACH: Final = 3
"""Sensors in a frame."""
MASTER_SIGMA_M: Final = 4095.5
MASTER_SIGMA_UP_M: Final = 819.1


@dataclass(frozen=True, slots=True)
class Block:
    """About a second of one device: host and device time of its samples, the first being the last of
    the block before; ``fresh`` after a power-on."""

    t_ns: Times
    device_ns: Times
    send_ns: Times
    fresh: bool


@dataclass(slots=True)
class Device:
    """What every virtual device has: name, options, duration, faults and a random stream for the bus."""

    name: str
    table: DeviceTable
    rate_hz: float
    clock_ppm: float
    end_ns: int
    faults: Faults
    rng: np.random.Generator
    exponential: bool = False

    def counter(self, modulus: int) -> AliveCounter:
        """An alive counter of this device."""
        return AliveCounter(self.faults, self.name, modulus, self.rng)

    def blocks(self) -> Iterator[Block]:
        """The samples of this device by the second, from power-on to the end."""
        period = 1e9 / self.rate_hz
        host_period = period / (1.0 + self.clock_ppm * PPM)
        count = max(1, round(self.rate_hz))
        on_ns, offset_ns, first, fresh = 0, round(self.table.clock_offset_s * 1e9), 0, True
        done: list[Reset] = []
        last_sent = 0
        while True:
            k = np.arange(first, first + count + 1)
            t_ns = on_ns + np.rint(k * host_period).astype(np.int64)
            stop_ns = self.end_ns
            resets = [r for r in self.faults.of(Reset, self.name) if r not in done]
            reset = min(resets, key=lambda r: r.start_s, default=None)
            if reset is not None:
                stop_ns = min(stop_ns, max(round(reset.start_s * 1e9), int(t_ns[0])))
            keep = int(np.searchsorted(t_ns, stop_ns, side="right"))
            if keep > 1:
                device_ns = offset_ns + np.rint(k[:keep] * period).astype(np.int64)
                send_ns = np.maximum.accumulate(np.maximum(self._send(t_ns[1:keep]), last_sent))
                last_sent = int(send_ns[-1])
                yield Block(t_ns[:keep], device_ns, send_ns, fresh)
                fresh = False
            if keep == count + 1:
                first += count
            elif reset is not None and stop_ns < self.end_ns:
                done.append(reset)
                on_ns, offset_ns, first, fresh = (
                    max(stop_ns, round((reset.start_s + reset.duration_s) * 1e9)),
                    0,
                    0,
                    True,
                )
            else:
                return

    def _send(self, t_ns: Times) -> Times:
        n, jitter = len(t_ns), self.table.jitter_ms * 1e6
        late = (
            np.minimum(self.rng.exponential(jitter, n), 10.0 * jitter)
            if self.exponential
            else jitter * self.rng.random(n)
        )
        return np.asarray(t_ns + np.rint(self.table.latency_ms * 1e6 + late).astype(np.int64))


def imu_frames(device: Device, table: ImuTable, imu: Imu, serial: int) -> Iterator[BusFrame]:
    """IMU_GYRO, IMU_ACCEL, IMU_TIME per sample and IMU_STATUS at 10 Hz, or IMU_FD per sample.

    Before them IMU_LATCH, of gyros that dither; of a redundant unit IMU_GYRO_2 and IMU_ACCEL_2 as well.
    """
    messages = contract()
    latch = messages["IMU_LATCH"]
    time, status = messages["IMU_TIME"], messages["IMU_STATUS"]
    channel = table.channel
    fd = messages["IMU_FD"]
    alive = device.counter(fd.alive_modulus if table.fd else time.alive_modulus)
    status_alive = device.counter(status.alive_modulus)
    latch_alive = device.counter(latch.alive_modulus)
    every = max(1, round(table.rate_hz / 10.0))
    sample = 0
    for block in device.blocks():
        if block.fresh:
            imu.restart()
            alive.restart()
            status_alive.restart()
            latch_alive.restart()
            sample = 0
        counts, saturated = imu.block(block.t_ns)
        rows = zip(
            block.t_ns[1:].tolist(),
            block.send_ns.tolist(),
            (block.device_ns[1:] // US).tolist(),
            counts.tolist(),
            saturated.tolist(),
            imu.warming.at(block.t_ns[1:]).tolist(),
            strict=True,
        )
        ages = imu.arrangement.ages(block.t_ns[1:])
        told = None if ages is None else np.minimum(ages * 1e6, LATCH_AGE_MAX_US).tolist()
        for k, (t, send, us, c, s, temperature) in enumerate(rows):
            sample += 1
            if told is not None:
                data = latch.encode(latch_alive.next(t), sample & 0xF, *told[k])
                yield BusFrame(send, channel, latch.frame_id, data, False)
                send += FRAME_NS
            a = alive.next(t)
            if table.fd:
                data = fd.encode(a, *s, *c, sample & 0xFFFF, us & 0xFFFF_FFFF_FFFF, temperature, 0, 0, serial)
                yield BusFrame(send, channel, fd.frame_id, data, True)
                continue
            for message, flags, some in carried(s, c):
                yield BusFrame(send, channel, message.frame_id, message.encode(a, *flags, *some), False)
                send += FRAME_NS
            data = time.encode(a, 0, sample & 0xFF, round(temperature), us & 0xFFFF_FFFF)
            yield BusFrame(send, channel, time.frame_id, data, False)
            if sample % every == 0:
                data = status.encode(status_alive.next(t), temperature, 0, serial)
                yield BusFrame(send + FRAME_NS, channel, status.frame_id, data, False)


def carried(
    saturated: Sequence[int], counts: Sequence[int]
) -> Iterator[tuple[MessageCodec, Sequence[int], Sequence[int]]]:
    """The frames that carry the counts of a sample: three sensors each, some of them not there."""
    messages = contract()
    n = len(counts) // 2
    for kind, begin in (("IMU_GYRO", 0), ("IMU_ACCEL", n)):
        if n == EACH:
            yield messages[kind], saturated[begin : begin + n], counts[begin : begin + n]
            continue
        flags = [*saturated[begin : begin + n], *[0] * (PLACES - n)]
        filled = [*counts[begin : begin + n], *[NO_COUNT] * (PLACES - n)]
        yield messages[kind], flags[:EACH], filled[:EACH]
        yield messages[f"{kind}_2"], flags[EACH:], filled[EACH:]


def odometer_frames(device: Device, table: OdometerTable, odometer: Odometer) -> Iterator[BusFrame]:
    """ODO frames."""
    message = contract()["ODO"]
    alive = device.counter(message.alive_modulus)
    base = table.ticks
    for block in device.blocks():
        ticks, direction, standstill = odometer.block(block.t_ns)
        if block.fresh:
            alive.restart()
            if block.t_ns[0] > 0:
                base = -int(ticks[0])  # a reset forgets the distance
        rows = zip(
            block.t_ns[1:].tolist(),
            block.send_ns.tolist(),
            _device_time(block),
            ((ticks + base) & 0xFFFF_FFFF).tolist(),
            direction.tolist(),
            standstill.tolist(),
            strict=True,
        )
        for t, send, us, n, way, still in rows:
            data = message.encode(alive.next(t), way, still, 1, n, us)
            yield BusFrame(send, table.channel, message.frame_id, data, False)


def speed_frames(device: Device, sigma: float, log: SpeedLog) -> Iterator[BusFrame]:
    """SPEED frames."""

    def values(block: Block) -> list[tuple[float, ...]]:
        return [(1, v, sigma) for v in log.block(block.t_ns[1:]).tolist()]

    return _plain(device, values, "SPEED")


def baro_frames(device: Device, baro: Barometer) -> Iterator[BusFrame]:
    """BARO frames."""

    def values(block: Block) -> list[tuple[float, ...]]:
        pressure, temperature = baro.block(block.t_ns)
        return [(1, p, c) for p, c in zip(pressure.tolist(), temperature.tolist(), strict=True)]

    return _plain(device, values, "BARO")


def table_frames(device: Device, encoder: Callable[[Times], NDArray[np.float64]]) -> Iterator[BusFrame]:
    """TABLE_ANGLES and TABLE_INNER; ``encoder`` reads the angles (n, 3) deg at times (n,)."""
    angles, inner = contract()["TABLE_ANGLES"], contract()["TABLE_INNER"]
    alive = device.counter(angles.alive_modulus)
    channel = device.table.channel
    for block in device.blocks():
        if block.fresh:
            alive.restart()
        read = encoder(block.t_ns[1:])
        time_us = (block.device_ns[1:] // US % (1 << 27)).tolist()
        rows = zip(block.t_ns[1:].tolist(), block.send_ns.tolist(), time_us, read.tolist(), strict=True)
        for t, send, us, (a, b, c) in rows:
            count = alive.next(t)
            yield BusFrame(send, channel, angles.frame_id, angles.encode(count, 1, a, b), False)
            yield BusFrame(send + FRAME_NS, channel, inner.frame_id, inner.encode(count, c, us), False)


def _plain(
    device: Device, values: Callable[[Block], list[tuple[float, ...]]], name: str
) -> Iterator[BusFrame]:
    """Frames of one message whose last signal is the device's time in units of 100 us."""
    message = contract()[name]
    alive = device.counter(message.alive_modulus)
    for block in device.blocks():
        if block.fresh:
            alive.restart()
        rows = zip(
            block.t_ns[1:].tolist(), block.send_ns.tolist(), _device_time(block), values(block), strict=True
        )
        for t, send, us, row in rows:
            data = message.encode(alive.next(t), *row, us)
            yield BusFrame(send, device.table.channel, message.frame_id, data, False)


def _device_time(block: Block) -> list[int]:
    """Device time in microseconds at the resolution and width of a 16-bit count of 100 us."""
    return list((np.rint(block.device_ns[1:] / UNIT_100_US).astype(np.int64) % 65536 * 100).tolist())


def gnss_frames(device: Device, table: GnssTable, gnss: Gnss, start: Start) -> Iterator[BusFrame]:
    """The six frames of every epoch; in an outage they say that there is no fix."""
    names = ("GNSS_TIME", "GNSS_LAT", "GNSS_LON", "GNSS_HEIGHT", "GNSS_VEL", "GNSS_ACC")
    messages = [contract()[name] for name in names]
    alive = device.counter(messages[0].alive_modulus)
    sigma = np.minimum(gnss.errors.sigma_position(), SIGMA_POSITION_MAX).tolist()
    sigma_v = np.minimum(gnss.errors.sigma_velocity(), SIGMA_VELOCITY_MAX).tolist()
    tow_zero = start.gps_tow_s * 1_000_000_000
    week_ns = 604_800 * 1_000_000_000
    none = [SIGMA_POSITION_MAX] * 3, [SIGMA_VELOCITY_MAX] * 3
    for block in device.blocks():
        if block.fresh:
            alive.restart()
        fixes = gnss.block(block.t_ns[1:])
        lat, lon = np.degrees(fixes.lat).tolist(), np.degrees(fixes.lon).tolist()
        height, v_g = fixes.height.tolist(), fixes.v_g.tolist()
        for k, (t, send) in enumerate(zip(block.t_ns[1:].tolist(), block.send_ns.tolist(), strict=True)):
            if fixes.silent[k]:
                continue
            valid = bool(fixes.fix[k])
            weeks, tow = divmod(tow_zero + t, week_ns)
            (se, sn, su), (ve, vn, vu) = (sigma, sigma_v) if valid else none
            fix, used = (table.fix_type, table.satellites) if valid else (NO_FIX, 0)
            rows: tuple[tuple[float, ...], ...] = (
                (tow // US, (start.gps_week + weeks) % 4096),
                (lat[k] if valid else 0.0, sn),
                (lon[k] if valid else 0.0, se),
                (height[k] if valid else 0.0, su, fix, used),
                tuple(v_g[k]) if valid else (0.0, 0.0, 0.0),
                (ve, vn, vu, valid, start.leap_seconds),
            )
            a = alive.next(t)
            for place, (message, row) in enumerate(zip(messages, rows, strict=True)):
                data = message.encode(a, *row)
                yield BusFrame(send + place * FRAME_NS, table.channel, message.frame_id, data, False)


def master_frames(device: Device, table: MasterTable, sayings: Sayings) -> Iterator[BusFrame]:
    """The frames of every epoch of a master; ten, or eight of one on a platform."""
    names = ("TIME", "LAT", "LON", "HEIGHT", "VEL_H", "VEL_U", "LEVEL", "HEADING", "RATE", "FORCE")
    messages = [contract()[f"MASTER_{name}"] for name in names]
    alive = device.counter(messages[0].alive_modulus)
    position, velocity, height = table.position_m, table.velocity_m_s, table.height_m
    tilt, turn = (math.degrees(1e-3 * x) for x in (table.tilt_mrad, table.heading_mrad))
    for block in device.blocks():
        if block.fresh:
            alive.restart()
        said, valid, silent, ahead_ns = sayings.at(block.t_ns[1:])
        device_us = ((block.device_ns[1:] + ahead_ns) // US).tolist()
        heading, pitch, roll = (np.degrees(x).tolist() for x in euler(said.C_ga))
        lat, lon = np.degrees(said.lat).tolist(), np.degrees(said.lon).tolist()
        v_g, rate, force = said.v_g.tolist(), np.degrees(said.w_ia_a).tolist(), said.f_a.tolist()
        times = zip(block.t_ns[1:].tolist(), block.send_ns.tolist(), strict=True)
        for k, (t, send) in enumerate(times):
            if silent[k]:
                continue
            east, north, up = v_g[k]
            rows: list[tuple[float, ...]] = [
                (valid[k], 1, not table.platform, device_us[k] & 0xFFFF_FFFF_FFFF),
                (lat[k], min(position, MASTER_SIGMA_M)),
                (lon[k], min(position, MASTER_SIGMA_M)),
                (float(said.height[k]), min(height, MASTER_SIGMA_UP_M)),
                (east, north),
                (up, min(velocity, SIGMA_VELOCITY_MAX), min(velocity, SIGMA_VELOCITY_MAX)),
                (roll[k], pitch[k]),
                (heading[k] % 360.0, tilt, turn),
            ]
            if not table.platform:
                rows += [tuple(rate[k]), tuple(force[k])]
            a = alive.next(t)
            for place, (message, row) in enumerate(zip(messages, rows, strict=False)):
                data = message.encode(a, *row)
                yield BusFrame(send + place * FRAME_NS, table.channel, message.frame_id, data, False)


def flood_frames(fault: Flood, channel: str, end_ns: int, rng: np.random.Generator) -> Iterator[BusFrame]:
    """Foreign frames with random payload."""
    count = int(fault.duration_s * fault.rate_hz)
    for k in range(count):
        t = round((fault.start_s + k / fault.rate_hz) * 1e9)
        if t > end_ns:
            return
        yield BusFrame(t, channel, fault.frame_id, rng.bytes(8), False)
