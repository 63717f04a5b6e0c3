"""Telemetry on MAVLink: what a ground station understands unasked, each message at its own rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal

from msgspec import Meta, field
from pymavlink.dialects.v20 import common as dialect

from bridge.geoid import undulation
from bridge.mavlink import progress as values
from bridge.mavlink import telemetry
from bridge.mavlink.picture import Picture
from bridge.options import SinkOptions
from bridge.outputs import ModeChange, Output, Progress, Severity, Text, Transfer, Transmit
from bridge.sinks.base import SinkContext, output_time_ns
from nav.types import Mode

DEFAULT_RATES_HZ: Final[dict[str, float]] = {
    "HEARTBEAT": 1.0,
    "SYS_STATUS": 1.0,
    "SYSTEM_TIME": 1.0,
    "ATTITUDE": 20.0,
    "ATTITUDE_QUATERNION": 20.0,
    "GLOBAL_POSITION_INT": 10.0,
    "LOCAL_POSITION_NED": 10.0,
    "GPS_RAW_INT": 2.0,
    "ESTIMATOR_STATUS": 2.0,
    "ODOMETRY": 10.0,
    "HOME_POSITION": 0.2,
    "GPS_GLOBAL_ORIGIN": 0.0,
}
"""Messages sent and how often; 0 leaves one to be asked for."""

_IDS: Final = {name: int(getattr(dialect, f"MAVLINK_MSG_ID_{name}")) for name in DEFAULT_RATES_HZ}
_VEHICLES: Final = {
    "generic": dialect.MAV_TYPE_GENERIC,
    "ground_rover": dialect.MAV_TYPE_GROUND_ROVER,
    "surface_boat": dialect.MAV_TYPE_SURFACE_BOAT,
    "submarine": dialect.MAV_TYPE_SUBMARINE,
    "fixed_wing": dialect.MAV_TYPE_FIXED_WING,
    "airship": dialect.MAV_TYPE_AIRSHIP,
}
_SEVERITIES: Final = {Mode.FAULT: Severity.CRITICAL, Mode.DEGRADED: Severity.WARNING}
_MAX_RATE_HZ: Final = 200.0
_TEXTS_PER_S: Final = 5
_SECOND_NS: Final = 1_000_000_000


class MavlinkTelemetryOptions(SinkOptions):
    """``[sink.NAME]`` with ``type = "mavlink"``; identifiers are the source's.

    ``rates_hz`` changes the rate of single messages by their MAVLink names.
    """

    vehicle: Literal["generic", "ground_rover", "surface_boat", "submarine", "fixed_wing", "airship"] = (
        "ground_rover"
    )
    rates_hz: dict[str, Annotated[float, Meta(ge=0.0, le=_MAX_RATE_HZ)]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.rates_hz:
            if name not in DEFAULT_RATES_HZ:
                raise ValueError(
                    f"rates_hz: unknown message {name}, expected one of {', '.join(DEFAULT_RATES_HZ)}"
                )


class MavlinkTelemetry:
    """Shows one navigator on one MAVLink link and answers its peer's requests for messages."""

    def __init__(self, options: MavlinkTelemetryOptions, context: SinkContext) -> None:
        if context.peer is None:
            raise ValueError("a mavlink sink needs the peer of its source")
        self._peer = context.peer
        self._peer.telemetry = self
        self._link = context.peer.link
        undulation(0.0, 0.0)  # unpacks the geoid now, not in the loop
        self._vehicle = int(_VEHICLES[options.vehicle])
        self._picture = Picture(options.navigator)
        rates = {**DEFAULT_RATES_HZ, **options.rates_hz}
        self._configured_ns = {_IDS[name]: round(1e9 / rate) if rate else 0 for name, rate in rates.items()}
        self._period_ns = dict(self._configured_ns)
        self._next_ns = dict.fromkeys(self._period_ns, 0)
        self._soonest_ns = 0
        self._stage = ""
        self._progress_second = self._transfer_second = -1
        self._hint = ""
        self._text_id = 0
        self._text_second = 0
        self._texts = 0
        self._held_back = 0

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Texts and an alignment's progress at once, then every message whose time has come."""
        picture = self._picture
        sent: list[Transmit] = []
        for output in outputs:
            t_ns = output_time_ns(output)
            if t_ns is None:
                continue
            picture.update(output, t_ns)
            match output:
                case ModeChange() if output.navigator == picture.navigator:
                    severity = _SEVERITIES.get(output.new, Severity.NOTICE)
                    sent += self._text(severity, f"{output.new.name}: {output.reason}")
                case Progress() if output.navigator == picture.navigator:
                    sent += self._progress(output)
                case Transfer() if output.navigator == picture.navigator:
                    sent += self._transfer(output)
                case Text():
                    sent += self._text(output.severity, output.text)
        if outputs and picture.now_ns >= self._soonest_ns:
            sent += self._due(picture.now_ns)
        return sent + self._peer.drain()

    def _progress(self, progress: Progress) -> list[Transmit]:
        """Once a second what an alignment says of itself, and a text when another one begins."""
        second = progress.t_ns // _SECOND_NS
        if second == self._progress_second:
            return []
        self._progress_second = second
        sent = []
        stage = f"{progress.stage} {progress.method}".strip()
        if stage != self._stage:
            self._stage = stage
            sent += self._text(Severity.INFO, f"{stage} {100.0 * progress.fraction:.0f} %")
        return sent + [self._link.send(message) for message in values.alignment(progress)]

    def _transfer(self, known: Transfer) -> list[Transmit]:
        """Once a second what is known of phi and mounting; a text when another manoeuvre would help."""
        second = known.t_ns // _SECOND_NS
        if second == self._transfer_second:
            return []
        self._transfer_second = second
        sent = []
        if known.hint != self._hint:
            self._hint = known.hint
            if known.hint:
                sent += self._text(Severity.NOTICE, f"{known.matching}: {known.hint} would help")
        return sent + [self._link.send(message) for message in values.transfer(known)]

    def _due(self, now_ns: int) -> list[Transmit]:
        sent = []
        for message_id, period_ns in self._period_ns.items():
            if period_ns and now_ns >= self._next_ns[message_id]:
                # on a grid of engine time, so that a late message does not delay the next
                self._next_ns[message_id] = (now_ns // period_ns + 1) * period_ns
                message = self.build(message_id)
                if message is not None:
                    sent.append(self._link.send(message))
        running = [self._next_ns[message_id] for message_id, period in self._period_ns.items() if period]
        self._soonest_ns = min(running, default=now_ns + 1_000_000_000)
        return sent

    def _text(self, severity: Severity, text: str) -> list[Transmit]:
        """STATUSTEXT packets; of a flood the first few of each second, so that the link stays free."""
        second = self._picture.now_ns // _SECOND_NS
        if second != self._text_second:
            self._text_second, self._texts = second, 0
        if self._texts >= _TEXTS_PER_S:
            self._held_back += 1
            return []
        self._texts += 1
        if self._held_back:
            text = f"({self._held_back} messages left out) {text}"
            self._held_back = 0
        self._text_id = self._text_id % 0xFFFF + 1
        return [self._link.send(message) for message in telemetry.statustexts(severity, text, self._text_id)]

    def build(self, message_id: int) -> Any:
        """A message as it would be sent now; None while there is nothing true to say."""
        if message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            return telemetry.heartbeat(self._picture, self._vehicle)
        if message_id == dialect.MAVLINK_MSG_ID_SYSTEM_TIME:
            return telemetry.system_time(self._picture, self._peer.utc_minus_engine_ns)
        return telemetry.FROM_PICTURE[message_id](self._picture)

    def offers(self, message_id: int) -> bool:
        """Whether the message is one of those this sink sends."""
        return message_id in self._period_ns

    def interval_us(self, message_id: int) -> int:
        """Time between two of them; -1 when switched off."""
        return self._period_ns[message_id] // 1000 or -1

    def set_interval(self, message_id: int, interval_us: int) -> None:
        """Change it: -1 switches the message off, 0 restores the configured rate."""
        if interval_us == 0:
            self._period_ns[message_id] = self._configured_ns[message_id]
        elif interval_us < 0:
            self._period_ns[message_id] = 0
        else:
            self._period_ns[message_id] = max(interval_us * 1000, round(1e9 / _MAX_RATE_HZ))
        self._next_ns[message_id] = 0
        self._soonest_ns = 0
