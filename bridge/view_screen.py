"""The process that draws the live view: pictures on standard input, a screen or plain lines out.

It imports little, so that it starts fast beside a busy loop.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import struct
import sys
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import IO, Any, Final

import msgspec
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

Picture = dict[str, Any]

LENGTH: Final = struct.Struct("<I")
"""Before every picture in the pipe: how many bytes of MessagePack follow."""

_PLAIN_PERIOD_S: Final = 1.0
_MESSAGES: Final = 8
WIDE: Final = 100
"""Columns from which values and their errors fit side by side."""
_ALIGNING: Final = ("ALIGN", "CATCH_UP", "TRANSFER")
_COLOURS: Final = {
    "STANDBY": "white",
    "ALIGN": "yellow",
    "CATCH_UP": "yellow",
    "NAVIGATE": "green",
    "TRANSFER": "green",
    "DEGRADED": "dark_orange",
    "FAULT": "red",
}


def _pictures(stream: IO[bytes]) -> Iterator[Picture]:
    buffer = bytearray()
    while data := os.read(stream.fileno(), 65536):
        buffer += data
        while len(buffer) >= LENGTH.size:
            end = LENGTH.size + LENGTH.unpack_from(buffer)[0]
            if len(buffer) < end:
                break
            yield msgspec.msgpack.decode(bytes(buffer[LENGTH.size : end]))
            del buffer[:end]


def _number(value: float, digits: int) -> str:
    return "-" if value != value else f"{value:.{digits}f}"


def render(picture: Picture, messages: Sequence[tuple[bool, str]], width: int = WIDE) -> Panel:
    """The screen for one picture, ``width`` columns wide."""
    mode = picture["mode"]
    parts: list[Any] = [_headline(picture)]
    if mode in _ALIGNING and "progress" in picture:
        bar = Table.grid(padding=(0, 1))
        bar.add_row(picture.get("stage", ""), ProgressBar(total=1.0, completed=picture["progress"], width=40))
        parts.append(bar)
    if solution := picture.get("solution"):
        parts += _solution_tables(solution, picture.get("error"), width >= WIDE)
    if transfer := picture.get("transfer"):
        parts.append(_transfer_table(transfer, mode))
    if devices := picture.get("devices"):
        parts.append(_device_table(devices, picture["losses"], width >= WIDE))
    parts += [Text(text, style="red" if urgent else "dim") for urgent, text in messages]
    return Panel(Group(*parts), title=picture["title"] or "navbridge", border_style=_COLOURS[mode])


def _headline(picture: Picture) -> Text:
    line = Text()
    line.append(f"{picture['mode']:<10}", style=f"bold {_COLOURS[picture['mode']]}")
    line.append(f" {picture.get('t_s', 0.0):8.1f} s")
    if picture.get("duration_s"):
        line.append(f" of {picture['duration_s']:.0f}")
    if "fix" in picture:
        line.append(f"   GNSS {picture['fix']}")
    if solution := picture.get("solution"):
        line.append("   " + " ".join(solution["flags"]).lower(), style="dim")
    return line


def _solution_tables(solution: Picture, error: Mapping[str, float] | None, wide: bool) -> list[Table]:
    """Values, sigmas and errors side by side, or below each other where there is no room."""
    rows = _solution_rows(solution, error or {})
    titles = ("", "", "", "", "1 sigma", "error")
    if wide:
        return [_grid(titles, rows, wide)]
    return [
        _grid(titles[:4], [row[:4] for row in rows], wide),
        _grid((titles[0], *titles[4:]), [(row[0], *row[4:]) for row in rows], wide),
    ]


def _grid(titles: Sequence[str], rows: Sequence[Sequence[str]], wide: bool) -> Table:
    table = Table(box=None, padding=(0, 1, 0, int(wide)), show_header=any(titles))
    for title in titles:
        table.add_column(title, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def _solution_rows(solution: Picture, error: Mapping[str, float]) -> list[tuple[str, ...]]:
    lat, lon, height = solution["position"]
    east, north, up = solution["sigma_position"]

    def off(key: str, digits: int, unit: str) -> str:
        return f"{error[key]:.{digits}f}{unit}" if key in error else ""

    position = (
        "position",
        f"{_number(lat, 7)}°",
        f"{_number(lon, 7)}°",
        f"{_number(height, 2)} m",
        f"{_number(math.hypot(east, north), 2)} / {_number(up, 2)} m",
        f"{off('horizontal', 2, ' /')} {off('height', 2, ' m')}",
    )
    e, n, u = solution["velocity"]
    sigma = math.hypot(*solution["sigma_velocity"])
    velocity = (
        "velocity",
        f"E {_number(e, 3)}",
        f"N {_number(n, 3)}",
        f"U {_number(u, 3)} m/s",
        f"{_number(sigma, 3)} m/s",
        off("velocity", 3, " m/s"),
    )
    roll, pitch, heading = solution["attitude"]
    attitude = (
        "attitude",
        f"roll {_number(roll, 3)}°",
        f"pitch {_number(pitch, 3)}°",
        f"heading {_number(heading, 3)}°",
        f"{_number(solution['sigma_attitude'][2], 3)}°",
        off("heading", 3, "°"),
    )
    return [position, velocity, attitude]


def _transfer_table(transfer: Picture, mode: str) -> Table:
    """What is known relative to the master: last that it was, once it has handed over."""
    sigma, left = transfer["sigma_mrad"], transfer["left"]
    known = [f"{axis} {_number(s, 2)} mrad" for axis, s in zip("ENU", sigma, strict=True)]
    rest = [f"{100.0 * share:.0f} %" for share in left]
    turned = zip(transfer["mounting_deg"], transfer["sigma_mounting_deg"], strict=True)
    mounting = [f"{_number(angle, 3)}±{_number(of, 3)}°" for angle, of in turned]
    rows = [("to master", *known), ("of first", *rest), ("mounting", *mounting)]
    if transfer["hint"] and mode == "TRANSFER":
        rows.append(("would help", transfer["hint"], "", ""))
    return _grid(("",) * 4, rows, False)


def _device_table(devices: Mapping[str, Picture], losses: Mapping[str, int], wide: bool) -> Table:
    table = Table(box=None, padding=(0, 1, 0, int(wide)))
    for name in ("device", "Hz", "age ms", "missing", "bridged"):
        table.add_column(name, justify="left" if name == "device" else "right", no_wrap=True)
    table.add_column("not used")
    for name, device in devices.items():
        rejects = [f"{reason} {count}" for reason, count in device["rejects"].items()]
        table.add_row(
            name,
            f"{device['rate_hz']:.1f}",
            f"{device['age_ms']:.0f}",
            str(device["missing"]),
            str(device["bridged"]),
            ", ".join((*device["sensors"], *rejects)),
        )
    if any(losses.values()):
        lost = ", ".join(f"{name} {count}" for name, count in losses.items() if count)
        table.add_row("bus", "", "", "", "", lost)
    return table


def plain_line(picture: Picture) -> str:
    """One line for a picture, where there is no terminal."""
    parts = [f"{picture.get('t_s', 0.0):8.1f} s  {picture['mode']:<9}"]
    if picture["mode"] in _ALIGNING and "progress" in picture:
        parts.append(f"{picture.get('stage', '')} {100.0 * picture['progress']:.0f} %")
    transfer = picture.get("transfer")
    if transfer and picture["mode"] == "TRANSFER":
        sigma = " ".join(_number(s, 2) for s in transfer["sigma_mrad"])
        hint = f", {transfer['hint']} would help" if transfer["hint"] else ""
        parts.append(f"to master {sigma} mrad{hint}")
    solution = picture.get("solution")
    if solution and "POSITION" in solution["flags"]:
        lat, lon, height = solution["position"]
        parts.append(f"{lat:.6f} {lon:.6f} {height:.1f} m")
        parts.append(f"heading {solution['attitude'][2]:.2f} ± {solution['sigma_attitude'][2]:.2f}")
    if error := picture.get("error"):
        parts.append(f"error {error['horizontal']:.2f} m {error['heading']:.3f} deg")
    return "  ".join(parts)


def _draw(stream: IO[bytes], console: Console) -> None:
    messages: deque[tuple[bool, str]] = deque(maxlen=_MESSAGES)
    with Live(console=console, auto_refresh=False, transient=True) as live:
        for picture in _pictures(stream):
            messages.extend(tuple(message) for message in picture["messages"])
            live.update(render(picture, messages, console.width), refresh=True)


def _print(stream: IO[bytes], out: IO[str]) -> None:
    due = 0.0
    for picture in _pictures(stream):
        lines = [f"         {text}" for _, text in picture["messages"]]
        if time.monotonic() >= due:
            due = time.monotonic() + _PLAIN_PERIOD_S
            lines.append(plain_line(picture))
        if lines:
            print(*lines, sep="\n", file=out, flush=True)


def main() -> None:
    """Draw what comes in on standard input until it ends."""
    # Ctrl-C goes to the whole group; the parent ends us by closing the pipe, after its last picture
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(BrokenPipeError):
        if sys.stdout.isatty():
            _draw(sys.stdin.buffer, Console())
        else:
            _print(sys.stdin.buffer, sys.stdout)


if __name__ == "__main__":
    main()
