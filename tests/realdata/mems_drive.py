"""The recorded drive of a consumer IMU through the program, scored by fixes that were withheld from it.

    python -m tests.realdata.mems_drive [--without-velocity] [--start SECONDS ...]

prints the figures: with every fourth fix only, and with ten outages of 15 s, one every 45 s, the first at
each of the starts. The recordings are found as `tests.recordings` says.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bridge.cli import main as navbridge
from bridge.config import Config
from bridge.engine import Engine
from bridge.evaluate import SolutionTable
from bridge.importers.csv import PACKAGED
from bridge.outputs import ModeChange, Output, SolutionOut
from bridge.recording import Capture
from bridge.replay import replay
from nav.earth import radii
from nav.types import S
from tests.recordings import DATA

Array = NDArray[np.float64]

FOLDER: Final = DATA / "drive_mems_rtk"
MAPPING: Final = "drive_mems_rtk"
STARTS: Final = (60, 70, 85, 95, 100, 105)
OUTAGES, EVERY_S, LENGTH_S = 10, 45.0, 15.0
SETTLED_S: Final = 60.0  # after the first motion
EVERY_FIX: Final = 4  # of 4 Hz

_WEEK_NS: Final = 604_800 * 10**9
_GPS_EPOCH_NS: Final = (315_964_800 - 18) * 10**9  # in UTC, with the leap seconds of the drive


@dataclass(frozen=True)
class Fixes:
    """The table of fixes in rad and SI units: ``t`` (n,) s since the first, ``tow_ns`` (n,) of the week."""

    t: Array
    tow_ns: NDArray[np.int64]
    lat: Array
    lon: Array
    height: Array
    sigma: Array  # (n, 3) east, north, up
    velocity: Array  # (n, 3)

    @property
    def first_motion(self) -> float:
        """Seconds from the first fix to the first that moves."""
        return float(self.t[np.argmax(np.hypot(self.velocity[:, 0], self.velocity[:, 1]) > 0.5)])


def fixes() -> Fixes:
    """All fixes of the drive, those withheld and the others."""
    table = np.genfromtxt(FOLDER / "gnss.csv", delimiter=",", names=True)
    t = table["t_gps_s_of_week"]
    return Fixes(
        t - t[0],
        np.rint(t * 1e6).astype(np.int64) * 1000,
        np.radians(table["lat_deg"]),
        np.radians(table["lon_deg"]),
        table["height_m"],
        np.stack([table[f"std_{axis}_m"] for axis in "enu"], axis=1),
        np.stack([table[f"vel_{axis}_m_s"] for axis in "enu"], axis=1),
    )


@dataclass(frozen=True)
class Drive:
    """One run: ``table`` holds the solutions while navigating, ``tow_ns`` (n,) their time of the GPS week."""

    table: SolutionTable
    tow_ns: NDArray[np.int64]
    modes: list[ModeChange]
    aligned_s: float  # after the first fix
    engine: Engine

    def errors(self, truth: Fixes, which: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Errors of the solution at those fixes that ``which`` (n,) marks, and their sigmas (m, 3) m, ENU."""
        moved = SolutionTable(self.tow_ns, self.table.mode, self.table.flags, self.table.state)
        at, usable = moved.at(truth.tow_ns[which])
        assert usable.all()  # no fix that is asked for lies in a gap
        lat, lon, height = truth.lat[which], truth.lon[which], truth.height[which]
        r_m, r_n = np.array([radii(float(s)) for s in np.sin(lat)]).T
        state = at.state
        east = (state[:, S.LON] - lon) * (r_n + height) * np.cos(lat)
        north = (state[:, S.LAT] - lat) * (r_m + height)
        error = np.stack([east, north, state[:, S.HEIGHT] - height], axis=1)
        return error, np.hypot(state[:, S.SIGMA_P], truth.sigma[which])


def drive(folder: Path, *options: str, velocity: bool = True) -> Drive:
    """Import with these ``options`` of ``navbridge import csv``, replay, and collect; works in ``folder``."""
    capture_file, mapping = folder / "drive.mcap", MAPPING
    if not velocity:
        mapping = str(_without_velocity(folder))
    command = ["import", "csv", mapping, "--data", str(FOLDER), "--out", str(capture_file), *options]
    with contextlib.redirect_stdout(io.StringIO()) as said:
        status = navbridge(command)
    if status != 0:
        raise RuntimeError(f"navbridge {' '.join(command)}: exit status {status}: {said.getvalue()}")
    capture = Capture(capture_file)
    engine = Engine(Config.from_attachments(capture.attachments))
    solutions: list[SolutionOut] = []
    modes: list[ModeChange] = []

    def keep(outputs: Sequence[Output]) -> None:
        solutions.extend(item for item in outputs if isinstance(item, SolutionOut))
        modes.extend(item for item in outputs if isinstance(item, ModeChange))

    replay(capture, engine, keep)
    table = SolutionTable.from_outputs(solutions).navigating()
    tow_ns = (table.t_ns + capture.utc_offset_ns - _GPS_EPOCH_NS) % _WEEK_NS
    aligned = (int(tow_ns[0]) - int(fixes().tow_ns[0])) * 1e-9
    return Drive(table, tow_ns, modes, aligned, engine)


def _without_velocity(folder: Path) -> Path:
    """The packaged mapping without the columns of velocity."""
    text = (PACKAGED / f"{MAPPING}.toml").read_text(encoding="utf-8")
    text = re.sub(r"^(velocity|sigma_velocity\w*) = .*\n", "", text, flags=re.MULTILINE)
    text = re.sub(
        r'^config = "(.*)"', lambda found: f'config = "{PACKAGED / found[1]}"', text, flags=re.MULTILINE
    )
    path = folder / "without_velocity.toml"
    path.write_text(text, encoding="utf-8")
    return path


@dataclass(frozen=True)
class Score:
    """Errors (n, 3) m at withheld fixes with their sigmas, and the worst horizontal error of each stretch."""

    error: Array
    sigma: Array
    worst: Array
    drive: Drive

    @property
    def horizontal(self) -> float:
        """RMS of the horizontal error, m."""
        return float(np.sqrt(np.mean(np.sum(self.error[:, :2] ** 2, axis=1))))

    @property
    def up(self) -> float:
        """RMS of the height error, m."""
        return float(np.sqrt(np.mean(self.error[:, 2] ** 2)))

    @property
    def worst_rms(self) -> float:
        """RMS over the stretches of the worst horizontal error, m."""
        return float(np.sqrt(np.mean(self.worst**2)))

    @property
    def normalised(self) -> float:
        """RMS of horizontal error over sigma, per axis."""
        return float(np.sqrt(np.mean((self.error[:, :2] / self.sigma[:, :2]) ** 2)))

    @property
    def inside(self) -> float:
        """Share of the horizontal errors inside three sigma (probability 0.9973 of two axes)."""
        return float(np.mean(np.sum((self.error[:, :2] / self.sigma[:, :2]) ** 2, axis=1) < 11.83))


def every_fourth_fix(folder: Path, velocity: bool = True) -> Score:
    """1 Hz of the 4 Hz fixes, judged by the others from a minute after the first motion."""
    found = drive(folder, "--gnss-every", str(EVERY_FIX), velocity=velocity)
    truth = fixes()
    late = truth.t > truth.first_motion + SETTLED_S
    which = late & (np.arange(len(truth.t)) % EVERY_FIX != 0) & (truth.tow_ns <= found.tow_ns[-1])
    error, sigma = found.errors(truth, which)
    return Score(error, sigma, np.array([np.hypot(error[:, 0], error[:, 1]).max()]), found)


def outages(folder: Path, start: float, velocity: bool = True) -> Score:
    """Ten outages, the first ``start`` seconds after the first fix, judged by the fixes withheld."""
    begins = [start + EVERY_S * k for k in range(OUTAGES)]
    options = [f"--gnss-outage={begin:g},{LENGTH_S:g}" for begin in begins]
    found = drive(folder, *options, velocity=velocity)
    truth = fixes()
    pairs = [found.errors(truth, (begin <= truth.t) & (truth.t < begin + LENGTH_S)) for begin in begins]
    worst = np.array([np.hypot(error[:, 0], error[:, 1]).max() for error, _ in pairs])
    return Score(np.concatenate([e for e, _ in pairs]), np.concatenate([s for _, s in pairs]), worst, found)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(prog="python -m tests.realdata.mems_drive", description=__doc__)
    parser.add_argument("--without-velocity", action="store_true", help="give it positions only")
    parser.add_argument("--start", type=float, nargs="+", default=list(STARTS), metavar="SECONDS")
    args = parser.parse_args(arguments)
    if not FOLDER.is_dir():
        print(f"no recording in {FOLDER}; NAVBRIDGE_DATA names the folder of recordings", file=sys.stderr)
        return 2
    velocity = not args.without_velocity
    with tempfile.TemporaryDirectory() as place:
        score = every_fourth_fix(Path(place), velocity)
        print(f"aligned {score.drive.aligned_s:.1f} s after the first fix, heading and mounting found")
        print(
            f"every fourth fix: horizontal {score.horizontal:.3f} m RMS, {score.worst[0]:.2f} m at worst, "
            f"height {score.up:.3f} m RMS, error/sigma {score.normalised:.2f}",
            flush=True,
        )
        for start in args.start:
            score = outages(Path(place), start, velocity)
            each = " ".join(f"{worst:.1f}" for worst in score.worst)
            print(
                f"outages of 15 s from {start:g} s: worst horizontal {score.worst_rms:.2f} m RMS ({each}), "
                f"error/sigma {score.normalised:.2f}, {100.0 * score.inside:.1f} % inside 3 sigma",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
