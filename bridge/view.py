"""The live view: what the bridge is doing, on the terminal, drawn by another process.

The loop hands over a small picture a few times a second through a pipe and never waits: what does
not fit is left out. The child draws with rich, or prints plain lines where its output is no terminal.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import Final

import msgspec
import numpy as np

from bridge.evaluate import SolutionTable, TruthTable, errors
from bridge.outputs import (
    FixOut,
    Health,
    ModeChange,
    Output,
    Progress,
    Severity,
    SolutionOut,
    Text,
    Transfer,
    Transmit,
)
from bridge.view_screen import LENGTH, Picture
from nav.types import Mode, S, SolutionFlag

_PERIOD_S: Final = 0.2
_CLOSE_S: Final = 3.0
_MESSAGES: Final = 20  # of one picture; the rest of a flood is counted


class ViewProcess:
    """The drawing process and the pipe to it; without ``start`` every call does nothing."""

    def __init__(self, start: bool = True) -> None:
        self._pipe: int | None = None
        self._child: subprocess.Popen[bytes] | None = None
        self._rest = b""
        if start:
            inlet, self._pipe = os.pipe()
            os.set_blocking(self._pipe, False)
            command = [sys.executable, "-P", "-m", "bridge.view_screen"]
            try:
                self._child = subprocess.Popen(command, stdin=inlet)
            finally:
                os.close(inlet)

    def update(self, picture: Picture) -> bool:
        """Show ``picture``; False when the pipe is full, or nobody draws, and it was left out."""
        self._push()
        if self._pipe is None or self._rest:
            return False
        body = msgspec.msgpack.encode(picture)
        self._rest = LENGTH.pack(len(body)) + body
        self._push()
        return True

    def close(self) -> None:
        """Let the child finish its last picture and end; one that hangs is killed."""
        end = time.monotonic() + _CLOSE_S
        while self._rest and time.monotonic() < end:
            time.sleep(0.01)
            self._push()
        self._hang_up()
        if self._child is not None:
            try:
                self._child.wait(_CLOSE_S)
            except subprocess.TimeoutExpired:
                self._child.kill()
                self._child.wait()
            self._child = None

    def _push(self) -> None:
        while self._rest and self._pipe is not None:
            try:
                self._rest = self._rest[os.write(self._pipe, self._rest) :]
            except BlockingIOError:
                return
            except OSError:  # the child is gone: go on without a view
                self._hang_up()

    def _hang_up(self) -> None:
        if self._pipe is not None:
            with contextlib.suppress(OSError):
                os.close(self._pipe)
        self._pipe, self._rest = None, b""


class ViewSink:
    """Collects one navigator's outputs and shows them five times a second of real time.

    ``truth`` gives a row of truth for an instant, where there is one. As a sink it sends nothing.
    """

    def __init__(
        self,
        view: ViewProcess,
        navigator: str,
        *,
        title: str = "",
        duration_s: float | None = None,
        truth: Callable[[int], TruthTable] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._view = view
        self._navigator = navigator
        self._truth = truth
        self._clock = clock
        self._solution: SolutionOut | None = None
        self._start_ns: int | None = None
        self._due = 0.0
        self._messages: list[tuple[bool, str]] = []
        self._picture: Picture = {"title": title, "duration_s": duration_s, "mode": Mode.STANDBY.name}

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Take in one engine step."""
        for output in outputs:
            self._take(output)
        now = self._clock()
        if now >= self._due:
            self._due = now + _PERIOD_S
            self.show()
        return []

    def _take(self, output: Output) -> None:
        match output:
            case SolutionOut() if output.navigator == self._navigator:
                self._solution = output
                self._time(output.latest_rx_ns)
                self._picture["mode"] = output.solution.mode.name
            case ModeChange() if output.navigator == self._navigator:
                self._picture["mode"] = output.new.name
                self._messages.append((False, f"{output.new.name}: {output.reason}"))
            case Progress() if output.navigator == self._navigator:
                self._picture["stage"] = output.stage
                self._picture["progress"] = output.fraction
            case Transfer() if output.navigator == self._navigator:
                self._picture["transfer"] = _transfer(output)
            case FixOut():
                self._picture["fix"] = output.fix.fix_type.name
            case Health():
                self._time(output.t_ns)
                self._picture.update(_health(output))
            case Text():
                self._messages.append((output.severity <= Severity.WARNING, output.text))

    def _time(self, t_ns: int) -> None:
        if self._start_ns is None:
            self._start_ns = t_ns
        self._picture["t_s"] = (t_ns - self._start_ns) * 1e-9

    def show(self) -> None:
        """Hand over the picture as it is now."""
        messages = self._messages[:_MESSAGES]
        if len(self._messages) > _MESSAGES:
            messages.append((False, f"and {len(self._messages) - _MESSAGES} more messages"))
        picture = dict(self._picture, messages=messages)
        if self._solution is not None:
            picture["solution"] = _solution(self._solution)
            picture["error"] = self._error(self._solution)
        if self._view.update(picture):
            self._messages.clear()

    def _error(self, out: SolutionOut) -> dict[str, float] | None:
        if self._truth is None:
            return None
        found = errors(SolutionTable.from_outputs([out]), self._truth(out.solution.t_ns))
        if len(found.t_ns) == 0:
            return None
        return {
            "horizontal": float(np.hypot(*found.position[0, :2])),
            "height": float(abs(found.position[0, 2])),
            "velocity": float(np.sqrt(np.sum(found.velocity[0] ** 2))),
            "heading": float(np.degrees(abs(found.heading[0]))),
        }


def _health(health: Health) -> Picture:
    return {
        "devices": {
            name: {
                "rate_hz": device.rate_hz,
                "age_ms": device.age_ms,
                "missing": device.missing,
                "bridged": device.bridged,
                "rejects": {reason.name.lower(): count for reason, count in device.rejects.items() if count},
                "sensors": [] if device.sensors is None else device.sensors.words(),
            }
            for name, device in health.devices.items()
        },
        "losses": {
            "dropped": health.dropped_frames,
            "unrecorded": health.unrecorded_frames,
            "unknown": health.unknown_frames,
        },
    }


def _transfer(known: Transfer) -> Picture:
    left = dict(known.observability)
    return {
        "matching": known.matching.replace("_", " "),
        "sigma_mrad": [1e3 * sigma for sigma in known.sigma],
        "mounting_deg": np.degrees(known.mounting).tolist(),
        "sigma_mounting_deg": np.degrees(known.sigma_mounting).tolist(),
        "left": [left.get(f"phi {axis}", 1.0) for axis in ("east", "north", "up")],
        "hint": known.hint,
    }


def _solution(out: SolutionOut) -> Picture:
    solution = out.solution
    state = solution.state
    return {
        "position": [np.degrees(solution.lat).item(), np.degrees(solution.lon).item(), solution.height],
        "sigma_position": state[S.SIGMA_P].tolist(),
        "velocity": state[S.V].tolist(),
        "sigma_velocity": state[S.SIGMA_V].tolist(),
        "attitude": [float(np.degrees(a)) for a in (solution.roll, solution.pitch, solution.heading)],
        "sigma_attitude": np.degrees(state[S.SIGMA_PHI]).tolist(),
        "flags": [flag.name for flag in SolutionFlag if flag and solution.flags & flag],
    }
