"""Sinks: what the engine puts out, encoded for the buses. A new sink is a file here and a line in `SINKS`."""

from __future__ import annotations

from bridge.sinks.base import Entry, Sink, SinkContext
from bridge.sinks.can_solution import CanSolution, CanSolutionOptions
from bridge.sinks.dbc_map import DbcMapSink, DbcMapSinkOptions
from bridge.sinks.mavlink import MavlinkTelemetry, MavlinkTelemetryOptions

__all__ = ["SINKS", "Entry", "Sink", "SinkContext"]

SINKS: dict[str, Entry] = {
    "can_solution": Entry(CanSolutionOptions, CanSolution, "can"),
    "dbc_map": Entry(DbcMapSinkOptions, DbcMapSink, "can"),
    "mavlink": Entry(MavlinkTelemetryOptions, MavlinkTelemetry, "mavlink"),
}
