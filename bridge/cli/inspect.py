"""``navbridge inspect``: what is in a capture, and what looks wrong in it."""

from __future__ import annotations

import argparse
import json
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bridge.inspection import Report, inspect
from bridge.recording import Capture


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "inspect",
        help="what is in a capture, and what looks wrong in it",
        description="Show rates and gaps per message and device, rejects, bus load and latency of a capture, "
        "and findings: units, signs and axes that cannot be right, sigmas of zero, losses. A capture that "
        "was cut off is inspected up to the cut.",
    )
    parser.add_argument("capture", metavar="CAPTURE", help="capture file (.mcap)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def run(args: argparse.Namespace) -> int:
    """Print the report; findings do not change the exit status."""
    report = inspect(Capture(args.capture))
    if args.json:
        print(json.dumps(report.as_document(), indent=2))
    else:
        show(report, Console())
    return 0


def show(report: Report, console: Console) -> None:
    """Print the report for a person."""
    console.print(
        f"[bold]{escape(report.file)}[/bold]: {report.seconds:.1f} s, {report.frames} frames, "
        f"{escape(report.written_by)}" + (f", {escape(report.origin)}" if report.origin else "")
    )
    if report.damage:
        console.print(f"[yellow]damaged: {escape(report.damage)}[/yellow]")
    elif not report.complete:
        console.print("[yellow]the run did not end in order[/yellow]")
    if report.events:
        console.print("events: " + ", ".join(f"{name} {count}" for name, count in report.events.items()))
    if report.refused:
        parts = ", ".join(f"{count} {reason}" for reason, count in report.refused.items())
        console.print(f"refused at the border: {escape(parts)}")
    for table in (_streams(report), _devices(report), _buses(report), _latency(report)):
        if table.row_count:
            console.print()
            console.print(table)
    console.print()
    if not report.findings:
        console.print("nothing looks wrong")
    for finding in report.findings:
        console.print(
            f"[yellow]! {escape(finding.device or 'capture')}[/yellow]: {escape(finding.text)}",
            soft_wrap=True,
        )


def _table(title: str, left: tuple[str, ...], right: tuple[str, ...]) -> Table:
    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0)
    )
    for name in left:
        table.add_column(name, no_wrap=True)
    for name in right:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _streams(report: Report) -> Table:
    table = _table("messages", ("source", "key", "message"), ("frames", "Hz", "gaps", "max ms"))
    for row in report.streams:
        table.add_row(
            row.source,
            row.key,
            row.name or "[dim]unknown[/dim]",
            str(row.frames),
            f"{row.rate_hz:.4g}",
            str(row.gaps),
            f"{row.longest_gap_ms:.1f}",
        )
    return table


def _devices(report: Report) -> Table:
    right = ("samples", "Hz", "gaps", "max ms", "missing", "bridged", "twice")
    table = _table("devices", ("device",), right)
    table.add_column("rejects", min_width=7, overflow="fold")
    for row in report.devices:
        rate = f"{row.rate_hz:.4g}" + (f" of {row.expected_hz:g}" if row.expected_hz else "")
        rejects = ", ".join(f"{name.lower()} {count}" for name, count in row.rejects.items())
        table.add_row(
            row.device,
            str(row.samples),
            rate,
            str(row.gaps),
            f"{row.longest_gap_ms:.1f}",
            str(row.missing),
            str(row.bridged),
            str(row.duplicates),
            "; ".join([rejects, *row.notes]) if row.notes else rejects,
        )
    return table


def _buses(report: Report) -> Table:
    table = _table("buses", ("source",), ("bit/s", "frames", "load", "load with worst stuffing"))
    for row in report.buses:
        table.add_row(
            row.source, str(row.bitrate), str(row.frames), f"{row.load:.1%}", f"{row.load_worst:.1%}"
        )
    return table


def _latency(report: Report) -> Table:
    table = _table(
        "latency of frames that led to something sent, us", ("stage",), ("frames", "p50", "p99", "largest")
    )
    for stage, values in report.latency_us.items():
        table.add_row(
            stage.replace("_", " "),
            f"{values['count']:.0f}",
            *(f"{values[k]:.0f}" for k in ("p50_us", "p99_us", "max_us")),
        )
    return table
