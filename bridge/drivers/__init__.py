"""Drivers: frames of one device in, samples in SI units and engine time out.

A driver has ``keys``, the (source, key) pairs it subscribes to, ``counters``, and ``feed(frame)``, which
returns the samples that this frame completed. It never raises on a frame: what it turns away it counts.
A new driver is a file here and a line in `DRIVERS`.
"""

from __future__ import annotations

from bridge.drivers.base import Entry

DRIVERS: dict[str, Entry] = {}
