"""A capture as channels that people and viewers read: decoded messages and solutions as JSON with schemas.

Topics are ``/SOURCE/MESSAGE`` for frames, ``/bridge/EVENT`` for the bridge's own, ``/solution/NAVIGATOR``
for every solution, ``/innovations/NAVIGATOR/KIND`` and ``/modes/NAVIGATOR`` for what the navigators said,
the viewer channels of a recording, ``/truth`` and ``/navbridge/health`` where the capture has them. The
frames themselves are not copied: a view does not replay.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Final

import msgspec
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from bridge.config import Config
from bridge.decoding import FrameDecoder
from bridge.engine import Engine
from bridge.errors import CaptureError
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.outputs import Innovation, ModeChange, SolutionOut
from bridge.recording import Capture
from bridge.recording_format import HEALTH, TRUTH
from bridge.recording_viewer import LOCATION, POSE, SCHEMAS, TRANSFORM, Decimator, Encoder
from bridge.solution_csv import COLUMNS, row
from nav.types import S, Solution

_VIEWS: Final = {POSE: "/pose", LOCATION: "/location", TRANSFORM: "/tf"}
_STATES: Final = {
    "gyro_bias_deg_per_h": (S.GYRO_BIAS, math.degrees(3600.0)),
    "sigma_gyro_bias_deg_per_h": (S.SIGMA_GYRO_BIAS, math.degrees(3600.0)),
    "accel_bias_mg": (S.ACCEL_BIAS, 1e3 / 9.80665),
    "sigma_accel_bias_mg": (S.SIGMA_ACCEL_BIAS, 1e3 / 9.80665),
    "rate_deg_s": (S.W, math.degrees(1.0)),
    "force_m_s2": (S.F, 1.0),
}


class View:
    """Writes a decoded view; use as a context. ``counts`` has the messages written by topic."""

    def __init__(self, path: str | Path, utc_offset_ns: int) -> None:
        self._offset_ns = utc_offset_ns
        self._channels: dict[str, int] = {}
        self.counts: Counter[str] = Counter()
        try:
            self._file: IO[bytes] = open(path, "wb")  # noqa: SIM115 - closed by __exit__
        except OSError as error:
            raise CaptureError(f"{path}: cannot write the view: {error.strerror}") from error
        self._mcap = Writer(self._file)
        self._mcap.start(profile="navbridge-view", library="navbridge")

    def __enter__(self) -> View:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._mcap.finish()  # type: ignore[no-untyped-call]
        finally:
            self._file.close()

    def add(
        self,
        topic: str,
        t_ns: int,
        document: Mapping[str, Any] | bytes,
        schema: str,
        text: dict[str, Any] | None,
    ) -> None:
        """Write one object (or its JSON); ``schema`` and ``text`` name and define it when the topic is new.

        Without ``text`` the schema follows from the first object.
        """
        if topic not in self._channels:
            if text is None:
                assert not isinstance(document, bytes)
                text = schema_of(schema, document)
            number = self._mcap.register_schema(schema, SchemaEncoding.JSONSchema, msgspec.json.encode(text))
            self._channels[topic] = self._mcap.register_channel(topic, MessageEncoding.JSON, number)
        data = document if isinstance(document, bytes) else msgspec.json.encode(document)
        utc_ns = max(0, t_ns + self._offset_ns)
        self._mcap.add_message(self._channels[topic], utc_ns, data, utc_ns)
        self.counts[topic] += 1


def schema_of(
    title: str, document: Mapping[str, Any], units: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """JSON schema of an object like ``document``; ``units`` become the descriptions of its members."""
    properties: dict[str, Any] = {}
    for name, value in document.items():
        member = _type_of(value)
        if units and units.get(name):
            member["description"] = units[name]
        properties[name] = member
    return {"title": title, "type": "object", "properties": properties}


def _type_of(value: Any) -> dict[str, Any]:
    if isinstance(value, bool):
        return {"type": "boolean"}
    if isinstance(value, int | float) or value is None:
        return {"type": "number"}
    if isinstance(value, str):
        return {"type": "string"}
    if isinstance(value, list | tuple):
        return {"type": "array", "items": _type_of(value[0]) if value else {}}
    if isinstance(value, Mapping):
        return {"type": "object", "properties": {name: _type_of(item) for name, item in value.items()}}
    return {}


def solution_document(solution: Solution) -> dict[str, Any]:
    """Every part of a solution in people's units; what is not known is null."""
    values = dict(zip(COLUMNS, row(solution), strict=True))
    document: dict[str, Any] = {name: _finite(value) for name, value in values.items()}
    document["flags"] = solution.flags
    for name, (place, factor) in _STATES.items():
        document[name] = [_finite(float(value) * factor) for value in solution.state[place]]
    document["odometer_scale"] = _finite(float(solution.state[S.ODO_SCALE]))
    document["mounting_deg"] = [_finite(math.degrees(value)) for value in solution.state[S.MOUNTING]]
    document["baro_bias_m"] = _finite(float(solution.state[S.BARO_BIAS]))
    return document


def _finite(value: float | int | str) -> float | int | str | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_view(capture: Capture, path: str | Path) -> Counter[str]:
    """Decode ``capture`` into a view at ``path``; returns the number of messages by topic.

    Raises:
        CaptureError: the view cannot be written.
        ConfigError: the configuration in the capture cannot be used.
    """
    config = Config.from_attachments(capture.attachments)
    engine = Engine(config)
    decoder = FrameDecoder(capture.attachments, config)
    decimator, encoder = Decimator(), Encoder(capture.utc_offset_ns)
    sources = capture.sources
    first_navigator = next(iter(config.navigators))
    with View(path, capture.utc_offset_ns) as view:
        for frame in capture.frames():
            _frame(view, frame, decoder, sources)
            for out in engine.feed(frame):
                match out:
                    case SolutionOut(navigator, solution):
                        topic = f"/solution/{navigator}"
                        view.add(
                            topic, solution.t_ns, solution_document(solution), "navbridge.Solution", None
                        )
                        if (shown := decimator.row(navigator, solution)) is not None:
                            for schema, message in encoder.encode(shown):
                                place = _VIEWS[schema]
                                if navigator != first_navigator and schema != TRANSFORM:
                                    place = f"/{navigator}{place}"
                                view.add(place, solution.t_ns, message, schema, SCHEMAS[schema])
                    case Innovation():
                        document = {
                            "kind": out.kind,
                            "residual": out.residual,
                            "sigma": out.sigma,
                            "nis": _finite(out.nis),
                            "accepted": out.accepted,
                        }
                        topic = f"/innovations/{out.navigator}/{out.kind}"
                        view.add(topic, out.t_ns, document, "navbridge.Innovation", None)
                    case ModeChange():
                        document = {"old": out.old.name, "new": out.new.name, "reason": out.reason}
                        view.add(f"/modes/{out.navigator}", out.t_ns, document, "navbridge.ModeChange", None)
        for topic, name in ((TRUTH, "navbridge.Truth"), (HEALTH, "navbridge.Health")):
            for item in capture.documents(topic):
                view.add(topic, int(item["t_ns"]), item, name, None)
        return view.counts


def _frame(view: View, frame: RawFrame, decoder: FrameDecoder, sources: Mapping[int, str]) -> None:
    if frame.source == BRIDGE:
        if frame.key != Event.TICK and frame.key in Event._value2member_map_:
            name = Event(frame.key).name
            try:
                body = msgspec.json.decode(frame.data)
            except msgspec.DecodeError:
                return
            if isinstance(body, dict):
                view.add(f"/bridge/{name}", frame.rx_ns, body, f"navbridge.event.{name}", None)
        return
    decoded = decoder.decode(frame)
    if decoded is None:
        return
    name, values = decoded
    topic = f"/{sources.get(frame.source, frame.source)}/{name}"
    text = None if topic in view.counts else schema_of(name, values, decoder.units(name))
    view.add(topic, frame.rx_ns, values, name, text)
