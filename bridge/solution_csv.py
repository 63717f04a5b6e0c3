"""Solutions as a table that any program reads."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, TextIO

from bridge.errors import ConfigError
from bridge.outputs import Output, SolutionOut
from nav.types import S, Solution

COLUMNS: Final = (
    "t_ns",
    "lat_deg",
    "lon_deg",
    "height_m",
    "vel_e_m_s",
    "vel_n_m_s",
    "vel_u_m_s",
    "roll_deg",
    "pitch_deg",
    "heading_deg",
    "sigma_e_m",
    "sigma_n_m",
    "sigma_u_m",
    "sigma_vel_e_m_s",
    "sigma_vel_n_m_s",
    "sigma_vel_u_m_s",
    "sigma_roll_deg",
    "sigma_pitch_deg",
    "sigma_heading_deg",
    "mode",
)


class CsvWriter:
    """Writes every solution it is shown; with several navigators a file for each, ``NAME-NAVIGATOR.csv``.

    What is not known yet is ``nan``. Raises ConfigError when a file cannot be written.
    """

    def __init__(self, path: str | Path, navigators: Sequence[str]) -> None:
        path = Path(path)
        self._files: dict[str, TextIO] = {}
        self._tables = {}
        for name in navigators:
            place = path if len(navigators) == 1 else path.with_name(f"{path.stem}-{name}{path.suffix}")
            try:
                file = place.open("w", newline="", encoding="utf-8")
            except OSError as error:
                self.close()
                raise ConfigError(f"{place}: cannot write the table: {error.strerror}") from error
            self._files[name] = file
            self._tables[name] = csv.writer(file, lineterminator="\n")
            self._tables[name].writerow(COLUMNS)

    def consume(self, outputs: Sequence[Output]) -> None:
        """Write the solutions among ``outputs``."""
        for output in outputs:
            if isinstance(output, SolutionOut):
                try:
                    self._tables[output.navigator].writerow(row(output.solution))
                except OSError as error:
                    raise self._wrong(output.navigator, error) from error

    def close(self) -> None:
        """Finish the files."""
        for name, file in self._files.items():
            try:
                file.close()
            except OSError as error:
                raise self._wrong(name, error) from error

    def _wrong(self, navigator: str, error: OSError) -> ConfigError:
        place = self._files[navigator].name
        return ConfigError(f"{place}: cannot write the table: {error.strerror}")


def row(solution: Solution) -> list[float | int | str]:
    """One solution in the order of `COLUMNS`.

    The sigmas of roll and pitch are those of the misalignment about the horizontal projections of the
    forward and the right axis; its components are taken as uncorrelated.
    """
    state = solution.state.tolist()
    attitude = (math.nan,) * 3
    if not math.isnan(state[S.Q.start]):
        attitude = solution.roll, solution.pitch, solution.heading
    heading = attitude[2]
    sigma_e, sigma_n, sigma_u = state[S.SIGMA_PHI]
    sine, cosine = math.sin(heading), math.cos(heading)
    return [
        solution.t_ns,
        math.degrees(state[S.LAT]),
        math.degrees(state[S.LON]),
        state[S.HEIGHT],
        *state[S.V],
        *map(math.degrees, attitude),
        *state[S.SIGMA_P],
        *state[S.SIGMA_V],
        math.degrees(math.hypot(sine * sigma_e, cosine * sigma_n)),
        math.degrees(math.hypot(cosine * sigma_e, sine * sigma_n)),
        math.degrees(sigma_u),
        solution.mode.name,
    ]
