"""Inertial units on CAN: pulse counts, in classic frames or one CAN FD frame, to increments in SI."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Final

import numpy as np
from msgspec import Meta

from bridge.calibration import CalibrationFile
from bridge.calibration_sensors import read_unit
from bridge.drivers.base import Context
from bridge.drivers.can_frames import intact, repeated
from bridge.drivers.counters import Counters
from bridge.drivers.device_clock import ClockPort
from bridge.drivers.imu_assembly import FRAME_BYTES, assemble, layout
from bridge.drivers.imu_corrections import latches, size_effect, warmth
from bridge.drivers.imu_parts import Parts
from bridge.drivers.imu_redundant import MESSAGES, RedundantOptions, fusion_of
from bridge.frame import RawFrame
from bridge.options import DeviceOptions, Positive
from bridge.outputs import Reject
from nav.imu.pulses import compensate
from nav.types import ImuChange, ImuFlag, ImuSample, Vector

_FAULT_OR_TEST: Final = 0b011  # bits of STATUS
_PLAUSIBLE: Final = 5.0  # an interval beyond this many times the nominal one, either way, is not one
_SATURATED: Final = int(ImuFlag.SATURATED)
_FAULT: Final = int(ImuFlag.DEVICE_FAULT)
_BRIDGED: Final = int(ImuFlag.BRIDGED)
_GAP: Final = int(ImuFlag.GAP)

# frames of a sample that wait for the others: none, the first, two; or the sample is done frame by frame
_NONE, _GYRO, _BOTH, _SINGLY = range(4)


class ImuCanOptions(DeviceOptions, kw_only=True):
    """``[device.NAME]`` with ``driver = "imu_can"``.

    ``latency_ms`` is from the end of a sample to the arrival of its first frame. ``bridge_samples`` is
    the longest gap that is filled from its neighbours; ``id_offset`` shifts every identifier, for
    several units on one bus. ``whole_cycle``, for gyros that dither and say when they were latched, is how
    their counts are corrected: a name of `nav.imu.whole_cycle.METHODS`. ``redundant`` is for a unit whose
    calibration file has more than three gyros and accelerometers: five classic frames a sample.
    """

    files: ClassVar[tuple[str, ...]] = ("calibration",)

    calibration: str
    rate_hz: Positive
    bridge_samples: Annotated[int, Meta(ge=0, le=100)] = 5
    id_offset: Annotated[int, Meta(ge=0, le=0x5FF)] = 0
    whole_cycle: str | None = None
    redundant: RedundantOptions | None = None


Made = Sequence[ImuSample | ImuChange]
"""What comes of a frame."""


class _Stream:
    """One kind of sample: the width of its counter and its clock port."""

    __slots__ = ("modulus", "port")

    def __init__(self, sample_bits: int, port: ClockPort) -> None:
        self.modulus = 1 << sample_bits
        self.port = port


class ImuCan:
    """Ties the frames of a sample by ALIVE, finds what is missing by SAMPLE and device time,
    compensates.

    Gyros, accelerometers and time that come in this order are kept back until they are three, and go
    through one kernel. Whatever else comes, or comes in another way, is taken frame by frame, which gives
    the same samples and counts.
    """

    def __init__(self, options: ImuCanOptions, context: Context) -> None:
        file = read_unit(context.files[options.calibration], options.calibration)
        three = file.calibration if isinstance(file, CalibrationFile) else None
        self._counters = Counters()
        self._name = context.name
        self._table = np.empty(0) if three is None else three.table()
        self.fusion = fusion_of(
            file, options.redundant, options.whole_cycle, options.rate_hz, context, self._counters
        )
        self._serial = file.serial
        self._stranger: int | None = None  # what a unit said that the calibration is not for
        self._foreign = False
        self._period_ns = 1e9 / options.rate_hz
        self._bridge = options.bridge_samples
        self._latches = latches(options.whole_cycle, options.id_offset, context, self._counters)
        self._size = None if three is None else size_effect(three)
        self._warmth = None if three is None else warmth(three, self._table)

        names = ("IMU_GYRO", "IMU_ACCEL") if self.fusion is None else MESSAGES
        codecs = [context.message(name) for name in names]
        self._parts = Parts(codecs, options.id_offset, self._counters)
        self._time_codec, self._status_codec = context.message("IMU_TIME"), context.message("IMU_STATUS")
        self._fd_codec = context.message("IMU_FD")
        offset = options.id_offset
        self._gyro_key, self._accel_key = self._parts.keys[0], self._parts.keys[-1]
        self._time_key = self._time_codec.frame_id + offset
        self._fd_key = self._fd_codec.frame_id + offset if self.fusion is None else -1
        self._status_key = self._status_codec.frame_id + offset
        keys = (*self._parts.keys, self._time_key, self._fd_key, self._status_key)
        self._latch_key = -1 if self._latches is None else self._latches.key
        self.keys = [(context.source, key) for key in (*keys, self._latch_key) if key >= 0]

        self._classic = _Stream(8, context.port(2**32 * 1000, options.latency_ms))
        self._fd = _Stream(16, context.port(2**48 * 1000, options.latency_ms))

        # the usual case: what is kept back, and what the kernel reads and writes
        self._layout = None if three is None else layout((*codecs, self._time_codec))
        self._kept = _SINGLY if self._layout is None else _NONE
        self._wire = bytearray(3 * FRAME_BYTES)
        self._wire_view = np.frombuffer(self._wire, dtype=np.uint8)
        self._counts = np.zeros(6)
        self._last_us = 0
        self._kept_gyro = self._kept_accel = b""

        self._time_data = self._fd_data = b""
        # the last sample given out
        self._last: ImuSample | None = None
        self._last_sample = 0
        self._gap = False
        # compiled here, before a bus is opened
        if three is not None:
            compensate(self._table, self._counts, 1.0 / options.rate_hz, np.empty(3), np.empty(3))
        if self._layout is not None:
            self._assemble(np.empty(3), np.empty(3))

    @property
    def counters(self) -> Counters:
        """What it counts; frames that are kept back are looked at first."""
        self._release()
        return self._counters

    def feed(self, frame: RawFrame) -> Made:
        """The sample that ``frame`` completes, after those made up for a short gap before it."""
        _, rx_ns, _, key, data = frame
        self._counters.frames += 1
        kept = self._kept
        if key == self._gyro_key:
            if kept == _NONE and len(data) == FRAME_BYTES:
                self._kept = _GYRO
                self._kept_gyro = data
                return ()
        elif key == self._accel_key:
            if kept == _GYRO and len(data) == FRAME_BYTES:
                self._kept = _BOTH
                self._kept_accel = data
                return ()
        elif key == self._time_key:
            if kept == _BOTH and len(data) == FRAME_BYTES:
                samples = self._whole(data, rx_ns)
                if samples is not None:
                    return samples
        elif key == self._status_key:
            return self._feed_status(data)
        elif self._latches is not None and key == self._latch_key:
            return self._latches.feed(data)
        self._release()
        samples = self._single(key, data, rx_ns)
        if self._layout is not None:
            self._kept = _SINGLY if self._parts.waiting else _NONE
        return samples

    def _whole(self, data: bytes, rx_ns: int) -> Made | None:
        """The sample of the frames kept back and ``data``; None where it is not a usual one."""
        gyro, accel = self._kept_gyro, self._kept_accel
        self._wire[:] = gyro + accel + data
        dtheta, dv = np.empty(3), np.empty(3)
        alive, saturated, status, sample, time_us, tau = self._assemble(dtheta, dv)
        if alive < 0 or alive == self._parts.done:
            return None
        self._kept = _NONE
        self._parts.ended(alive, gyro, accel)
        self._time_data = data
        flags = _SATURATED if saturated else 0
        head, made = (status, sample, time_us), (tau, dtheta, dv)
        return self._sample(self._classic, head, self._counts, flags, rx_ns, made)

    def _assemble(self, dtheta: Vector, dv: Vector) -> tuple[int, int, int, int, int, float]:
        assert self._layout is not None
        return assemble(self._wire_view, self._layout, self._table, self._last_us, self._counts, dtheta, dv)

    def _release(self) -> None:
        """Take what is kept back frame by frame."""
        kept = self._kept
        if kept in (_GYRO, _BOTH):
            self._kept = _SINGLY
            self._single(self._gyro_key, self._kept_gyro, 0)
            if kept == _BOTH:
                self._single(self._accel_key, self._kept_accel, 0)

    def _single(self, key: int, data: bytes, rx_ns: int) -> Made:
        """One frame by itself."""
        counters, parts = self._counters, self._parts
        if key in parts:
            return parts.take(key, data)
        if key == self._fd_key:
            return self._feed_fd(data, rx_ns)
        codec = self._time_codec
        if not intact(codec, data, counters):
            return ()
        alive = codec.alive(data)
        if alive == parts.done:
            return repeated(data, self._time_data, counters)
        self._time_data = data
        values = parts.end(alive)
        if values is None:
            return counters.reject(Reject.INCOMPLETE)
        status, sample, _, time_us = codec.decode(data)
        head = (int(status), int(sample), int(time_us))
        if self.fusion is not None:
            return self._sample(self._classic, head, self.fusion.counts(values), 0, rx_ns)
        flags = _SATURATED if any(any(part[:3]) for part in values) else 0
        counts = np.array([count for part in values for count in part[3:]], dtype=np.float64)
        return self._sample(self._classic, head, counts, flags, rx_ns)

    def _feed_fd(self, data: bytes, rx_ns: int) -> Made:
        codec = self._fd_codec
        if not intact(codec, data, self._counters):
            return ()
        alive = codec.alive(data)
        if alive == self._parts.done:
            return repeated(data, self._fd_data, self._counters)
        self._parts.ended(alive)
        self._fd_data = data
        values = codec.decode(data)
        flags = _SATURATED if any(values[:6]) else 0
        sample, time_us, temperature, status, _, serial = values[12:]
        self._check_serial(int(serial))
        if self._warmth is not None:
            self._warmth.told(temperature)
        counts = np.array(values[6:12], dtype=np.float64)
        return self._sample(self._fd, (int(status), int(sample), int(time_us)), counts, flags, rx_ns)

    def _feed_status(self, data: bytes) -> tuple[()]:
        codec = self._status_codec
        if intact(codec, data, self._counters):
            temperature, _, serial = codec.decode(data)
            self._check_serial(int(serial))
            if self._warmth is not None:
                self._warmth.told(temperature)
        return ()

    def _check_serial(self, serial: int) -> None:
        """A unit that says twice that it is another one is not heard any more."""
        if serial == self._serial or self._serial is None or self._foreign:
            self._stranger = None
            return
        if serial == self._stranger:
            self._foreign = True
            self._counters.notes.append(
                f"serial number {serial}, but the calibration is for {self._serial}: no sample is used"
            )
        self._stranger = serial

    def _sample(
        self,
        stream: _Stream,
        head: tuple[int, int, int],
        counts: Vector,
        flags: int,
        rx_ns: int,
        made: tuple[float, Vector, Vector] | None = None,
    ) -> Made:
        """The sample of ``counts`` (6,) with those made up before it; ``head`` is STATUS, SAMPLE, TIME.

        ``made`` is an interval with the increments over it, which are taken where it is the right one.
        """
        counters = self._counters
        if self._foreign or (self.fusion is not None and self.fusion.strange):
            return counters.reject(Reject.FOREIGN)
        status, sample, time_us = head
        self._last_us = time_us
        last = self._last
        t_ns = stream.port.stamp(time_us * 1000, rx_ns)
        elapsed = stream.port.elapsed_ns
        interval = self._period_ns
        steps = 1
        if last is None:
            pass
        elif elapsed is None:
            flags |= _GAP
        elif elapsed <= 0:
            self._gap = True
            return counters.reject(Reject.STALE)
        else:
            step = (sample - self._last_sample) % stream.modulus
            if step == 1 and elapsed < _PLAUSIBLE * interval:
                interval = float(elapsed)
            else:
                found = self._steps(step, stream.modulus, elapsed, t_ns - last.t_ns)
                if found == 0:
                    return counters.reject(Reject.COUNTER)
                steps = found
                if 1.0 < elapsed * _PLAUSIBLE / (steps * interval) < _PLAUSIBLE * _PLAUSIBLE:
                    interval = elapsed / steps
                else:  # the device's time jumped: the increments are good, the interval is the nominal one
                    counters.reject(Reject.RANGE)
                    self._gap = True
        if self._gap:
            flags |= _GAP
            self._gap = False
        if status & _FAULT_OR_TEST:
            flags |= _FAULT

        dt = interval * 1e-9
        if steps > 1 or flags & _GAP:
            self._restart()
        if self._latches is not None:
            self._latches.correct(sample, dt, counts)
            made = None
        if made is None:
            made = (0.0, np.empty(3), np.empty(3))
        tau, dtheta, dv = made
        out: list[ImuSample | ImuChange] = []
        if self.fusion is not None:
            more, change, dtheta, dv = self.fusion.fuse(counts, t_ns, dt)
            flags |= more
            counters.sensors = self.fusion.health
            if change is not None:
                out.append(change)
            if not self.fusion.spans:
                counters.reject(Reject.INVALID)
                return out
        elif dt != tau:
            compensate(self._table, counts, dt, dtheta, dv)
        if flags & _SATURATED:
            counters.reject(Reject.SATURATED)
        if self._size is not None:
            self._size.take_off(dtheta, dv, dt)

        if steps > 1 and last is not None:
            counters.missing += steps - 1
            if steps - 1 <= self._bridge and not flags & _GAP and t_ns - last.t_ns >= steps:
                out += self._between(last, t_ns, dt, dtheta, dv, steps)
            else:
                flags |= _GAP
        new = ImuSample(t_ns, dt, dtheta, dv, self._name, flags)
        out.append(new)
        self._last = new
        self._last_sample = sample
        counters.samples += 1
        counters.last_ns = t_ns
        return out

    def _restart(self) -> None:
        """The counts of samples before this one are lost."""
        if self._latches is not None:
            self._latches.restart()
        if self._size is not None:
            self._size.restart()

    def _steps(self, step: int, modulus: int, elapsed: int, engine_ns: int) -> int:
        """How many samples the device has taken since the last one; 0: its counter stands still."""
        # a device time that jumped says nothing about how many are missing
        by_time = max(1, round(min(elapsed, engine_ns + _PLAUSIBLE * self._period_ns) / self._period_ns))
        if by_time % modulus == step:
            return by_time
        if by_time <= modulus // 2:
            if step == 0:
                return 0
            if step <= modulus // 2 and elapsed < step * _PLAUSIBLE * self._period_ns:
                return step
        if step != 1:
            self._counters.reject(Reject.COUNTER)  # the counter jumped; time says how much is missing
        return by_time

    def _between(
        self, last: ImuSample, t_ns: int, dt: float, dtheta: np.ndarray, dv: np.ndarray, steps: int
    ) -> list[ImuSample]:
        """Samples on the straight line from the one before a gap to the one after it."""
        self._counters.bridged += steps - 1
        made = []
        for i in range(1, steps):
            weight = i / steps
            made.append(
                ImuSample(
                    last.t_ns + (t_ns - last.t_ns) * i // steps,
                    dt,
                    last.dtheta + (dtheta - last.dtheta) * weight,
                    last.dv + (dv - last.dv) * weight,
                    self._name,
                    _BRIDGED,
                )
            )
        return made
