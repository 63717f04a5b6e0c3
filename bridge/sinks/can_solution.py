"""The solution on CAN: an epoch of SOL_ frames at a set rate, rejects and health once a second.

What is not known is not sent: a frame whose measured values are not all known and in range is
left out of its epoch. SOL_TIME (mode) and SOL_HEADING (which carries the validity flags) are always
there; an unknown heading is sent as 0 with its validity bit clear. A standard deviation that is unknown
or beyond the signal's range is sent as the largest raw value, "that or more", a smaller one than the signal
can show as its smallest. Until there is a solution, the two constant frames are sent with every health
report, so that the mode can be seen on the bus. SOL_ALIGN says how far an alignment is, as often as that
reports; its estimate is a solution like any other. So do SOL_TRANSFER and SOL_TRANSFER_OBS of one that has a
master. SOL_IMU_HEALTH says which sensors of a redundant unit are not trusted, when that changes and once a
second.

In polar waters heading, velocity and, in the transverse frame, position are shown in the frame that the
configuration chooses (`nav.polar`). Each message whose values depend on the frame says which it is, so that
no reader can mix an old flag with new values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final, Literal

import numpy as np
from msgspec import Meta

from bridge.commands import HINTS, METHODS
from bridge.options import SinkOptions
from bridge.outputs import (
    FixOut,
    Health,
    ModeChange,
    Output,
    Progress,
    Reject,
    SensorsOut,
    SolutionOut,
    Transfer,
    Transmit,
    UnitHealth,
)
from bridge.sinks.base import SinkContext
from bridge.sinks.epoch import EPOCH, EpochValues
from bridge.sinks.packing import Packer
from dbc.codec import MessageCodec
from nav import polar
from nav.polar import Frame
from nav.types import Mode, Solution

_WEEK_NS = 7 * 86400 * 1_000_000_000
_BRIDGE_TIME, _GPS_TIME = 0, 1
_LOSS_MODULUS = 8192
_TOTAL_MODULUS = 1 << 32
_RECENT_LIMIT = 0xFFFF
_RESTARTS_LIMIT = 31
_AGE_LIMIT_S = 0xFFFF
_UNIT_LIMIT = 15

_ALWAYS = ("SOL_TIME", "SOL_HEADING")
_FRAMES: Final = {"geographic": Frame.GEOGRAPHIC, "grid": Frame.GRID, "transverse": Frame.TRANSVERSE}


class CanSolutionOptions(SinkOptions):
    """``[sink.NAME]`` with ``type = "can_solution"``.

    ``rate_hz`` is the rate of epochs; the navigator's own rate bounds it. ``id_offset`` shifts every
    identifier. ``polar`` is the frame shown from ``polar_enter_deg`` of latitude, north or south, until it
    falls below ``polar_leave_deg``; in the grid frame position stays geographic.
    """

    rate_hz: Annotated[float, Meta(gt=0.0, le=1000.0)] = 50.0
    id_offset: Annotated[int, Meta(ge=0, le=0x5F0)] = 0
    polar: Literal["geographic", "grid", "transverse"] = "geographic"
    polar_enter_deg: Annotated[float, Meta(gt=0.0, le=90.0)] = 84.0
    polar_leave_deg: Annotated[float, Meta(ge=0.0, lt=90.0)] = 83.5

    def __post_init__(self) -> None:
        """Raise ValueError unless the frame is left further from the pole than it is entered."""
        if self.polar_leave_deg >= self.polar_enter_deg:
            raise ValueError(
                f"polar_leave_deg: found {self.polar_leave_deg:g}, "
                f"expected less than polar_enter_deg = {self.polar_enter_deg:g}"
            )


class CanSolution:
    """Encodes one navigator's solution through the contract."""

    def __init__(self, options: CanSolutionOptions, context: SinkContext) -> None:
        self._navigator = options.navigator
        self._source = context.source
        self._offset = options.id_offset
        self._period_ns = round(1e9 / options.rate_hz)
        self._frame = Frame.GEOGRAPHIC
        self._polar = _FRAMES[options.polar]
        self._enter, self._leave = (
            math.radians(options.polar_enter_deg),
            math.radians(options.polar_leave_deg),
        )
        messages = context.contract
        self._epoch = [messages[name] for name in EPOCH]
        self._values = EpochValues()
        self._packer = Packer(self._epoch)
        self._keys = [codec.frame_id + self._offset for codec in self._epoch]
        self._rejects, self._health = messages["SOL_REJECTS"], messages["SOL_HEALTH"]
        self._sensors = messages["SOL_IMU_HEALTH"]
        self._units: dict[str, int] = {}
        self._align, self._align_packer = messages["SOL_ALIGN"], Packer([messages["SOL_ALIGN"]])
        self._transfer = [messages["SOL_TRANSFER"], messages["SOL_TRANSFER_OBS"]]
        self._transfer_packer = Packer(self._transfer)
        self._slot: int | None = None
        self._alive = 0
        self._alive_rejects = 0
        self._alive_health = 0
        self._alive_align = 0
        self._alive_sensors = 0
        self._alive_transfer = 0
        self._gps_minus_engine_ns: int | None = None
        self._mode = Mode.STANDBY
        self._solution_since_health = False
        self._totals: dict[Reject, int] = {}

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Frames due after ``outputs``: of several solutions the last one is sent."""
        latest: SolutionOut | None = None
        health: Health | None = None
        progress: Progress | None = None
        sent: list[Transmit] = []
        transfer: Transfer | None = None
        for output in outputs:
            match output:
                case SolutionOut() if output.navigator == self._navigator:
                    latest = output
                case ModeChange() if output.navigator == self._navigator:
                    self._mode = output.new
                case Progress() if output.navigator == self._navigator:
                    progress = output
                case Transfer() if output.navigator == self._navigator:
                    transfer = output
                case FixOut() if output.fix.gps_ns is not None:
                    self._gps_minus_engine_ns = output.fix.gps_ns - output.fix.t_ns
                case SensorsOut() if output.device in self._units:
                    sent.append(self._send_sensors(output.t_ns, output.device, output.health))
                case Health():
                    health = output
        if latest is not None:
            slot = latest.latest_rx_ns // self._period_ns
            if slot != self._slot:
                self._slot = slot
                self._solution_since_health = True
                sent += self._send_epoch(latest.solution)
        if progress is not None:
            sent += self._send_progress(progress)
        if transfer is not None:
            sent += self._send_transfer(transfer)
        if health is not None:
            if not self._solution_since_health:
                sent += self._send_status(health.t_ns)
            self._solution_since_health = False
            sent += self._send_health(health)
        return sent

    def _transmit(self, codec: MessageCodec, alive: int, values: tuple[float | int, ...]) -> Transmit:
        return Transmit(self._source, codec.frame_id + self._offset, codec.encode(alive, *values))

    def _send_epoch(self, solution: Solution) -> list[Transmit]:
        self._frame = polar.switch(solution.lat, self._frame, self._polar, self._enter, self._leave)
        time = self._time_values(solution.t_ns, solution.mode)
        payloads = self._packer.encode(self._alive, self._values.fill(time, solution, self._frame))
        self._alive = (self._alive + 1) % 15
        return self._packed(self._keys, payloads)

    def _packed(self, keys: Sequence[int], payloads: Sequence[bytes | None]) -> list[Transmit]:
        source = self._source
        # left out: a measured value is unknown or out of range
        return [Transmit(source, key, data) for key, data in zip(keys, payloads, strict=True) if data]

    def _send_status(self, t_ns: int) -> list[Transmit]:
        values = {
            "SOL_TIME": self._time_values(t_ns, self._mode),
            "SOL_HEADING": (0.0, 0, int(self._frame)),
        }
        sent = [
            self._transmit(codec, self._alive, values[codec.name])
            for codec in self._epoch
            if codec.name in _ALWAYS
        ]
        self._alive = (self._alive + 1) % 15
        return sent

    def _time_values(self, t_ns: int, mode: Mode) -> tuple[int, ...]:
        base = _BRIDGE_TIME
        if self._gps_minus_engine_ns is not None:
            base = _GPS_TIME
            t_ns += self._gps_minus_engine_ns
        # whole raw steps of 50 us, so that rounding cannot reach the end of the week
        week, in_week = divmod(t_ns // 50_000 * 50_000, _WEEK_NS)
        return int(mode), base, week % 4096, in_week // 1000

    def _send_progress(self, progress: Progress) -> list[Transmit]:
        east, north, up = (math.degrees(limit) for limit in progress.limit)
        values = (
            METHODS.get(progress.method, 0),
            int(progress.behind),
            100.0 * min(max(progress.fraction, 0.0), 1.0),
            min(progress.restarts, _RESTARTS_LIMIT),
            max(east, north),
            up,
        )
        payloads = self._align_packer.encode(self._alive_align, np.array(values))
        self._alive_align = (self._alive_align + 1) % 15
        return self._packed([self._align.frame_id + self._offset], payloads)

    def _send_transfer(self, known: Transfer) -> list[Transmit]:
        left = dict(known.observability)
        values = (
            *(math.degrees(x) for x in known.mounting),
            HINTS.get(known.hint, 0),
            100.0 * known.quality,
            *(math.degrees(x) for x in known.sigma_mounting),
            *(100.0 * min(left.get(f"phi {axis}", 1.0), 1.0) for axis in ("east", "north", "up")),
        )
        payloads = self._transfer_packer.encode(self._alive_transfer, np.array(values))
        self._alive_transfer = (self._alive_transfer + 1) % 15
        return self._packed([codec.frame_id + self._offset for codec in self._transfer], payloads)

    def _send_health(self, health: Health) -> list[Transmit]:
        totals: dict[Reject, int] = dict.fromkeys(Reject, 0)
        missing = 0
        for device in health.devices.values():
            missing += device.missing
            for reason, count in device.rejects.items():
                totals[reason] += count
        totals[Reject.UNKNOWN] += health.unknown_frames
        sent = []
        for reason, total in totals.items():
            recent = min(max(total - self._totals.get(reason, 0), 0), _RECENT_LIMIT)
            values = (int(reason), total % _TOTAL_MODULUS, recent)
            sent.append(self._transmit(self._rejects, self._alive_rejects, values))
            self._alive_rejects = (self._alive_rejects + 1) % 15
        self._totals = totals
        losses = (health.dropped_frames, health.unrecorded_frames, health.unknown_frames, missing)
        wrapped = tuple(count % _LOSS_MODULUS for count in losses)
        sent.append(self._transmit(self._health, self._alive_health, wrapped))
        self._alive_health = (self._alive_health + 1) % 15
        told = {name: device.sensors for name, device in health.devices.items() if device.sensors is not None}
        self._units = {name: min(number, _UNIT_LIMIT) for number, name in enumerate(told)}
        return sent + [self._send_sensors(health.t_ns, name, sensors) for name, sensors in told.items()]

    def _send_sensors(self, now_ns: int, device: str, sensors: UnitHealth) -> Transmit:
        age_s = max(now_ns - sensors.t_ns, 0) // 1_000_000_000
        values = (self._units[device], *sensors.masks, min(age_s, _AGE_LIMIT_S))
        alive, self._alive_sensors = self._alive_sensors, (self._alive_sensors + 1) % 15
        return self._transmit(self._sensors, alive, values)
