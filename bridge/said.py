"""What a navigator says of itself, in the words of the outputs."""

from __future__ import annotations

from bridge.outputs import Innovation, ModeChange, Output, Progress, Transfer
from nav import events


def said(navigator: str, event: events.NavEvent) -> Output | None:
    """The output for an event of a navigator; None for what is no output of its own."""
    match event:
        case events.Innovation():
            return Innovation(
                event.t_ns, navigator, event.kind, event.residual, event.sigma, event.nis, event.accepted
            )
        case events.ModeChange():
            return ModeChange(event.t_ns, navigator, event.old, event.new, event.reason)
        case events.AlignmentProgress():
            return Progress(
                event.t_ns,
                navigator,
                "alignment",
                event.progress,
                event.sigma,
                event.method,
                event.limit,
                event.behind,
                event.restarts,
            )
        case events.TransferProgress():
            return Transfer(
                event.t_ns,
                navigator,
                event.matching,
                event.sigma,
                event.mounting,
                event.sigma_mounting,
                event.observability,
                event.hint,
                event.quality,
            )
    return None
