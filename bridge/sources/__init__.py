"""Sources: buses and links upstream of the recorder. A new kind is a file here and a line in `SOURCES`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from bridge.sources.base import Notice, Received, Source, SourceContext
from bridge.sources.can import CanBus
from bridge.sources.mavlink import MavlinkLink

__all__ = ["SOURCES", "Notice", "Received", "Source", "SourceContext"]

SOURCES: Final[dict[str, Callable[[Any, SourceContext], Source]]] = {
    "can": CanBus,
    "mavlink": MavlinkLink,
}
