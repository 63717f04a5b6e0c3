"""Reading the columns of a CSV file as numbers in one unit, with errors that name file, line and column."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bridge.errors import ConfigError
from bridge.importers.mapping import Choice, Column, Columns
from bridge.strict import unknown, wrong
from dbc.units import UNITS, si_factor
from nav.types import Vector


class CsvTable:
    """A CSV file with a header line, held as text until a column is asked for in a unit."""

    def __init__(self, path: Path, mapping: str, key: str) -> None:
        self._path, self._mapping, self._key = path, mapping, key
        try:
            with path.open(newline="", encoding="utf-8-sig") as stream:
                rows = list(csv.reader(stream))
        except OSError as error:
            raise ConfigError(f"{mapping}: {key}.file: cannot read {path}: {error.strerror}") from error
        except (UnicodeDecodeError, csv.Error) as error:
            raise ConfigError(f"{path}: not a CSV file in UTF-8: {error}") from error
        rows = [row for row in rows if row]
        if len(rows) < 2:
            raise ConfigError(f"{path}: expected a header and at least one row, found {len(rows)} lines")
        self._header, self._rows = [name.strip() for name in rows[0]], rows[1:]

    def __len__(self) -> int:
        return len(self._rows)

    def numbers(self, key: str, column: Column, quantity: str) -> Vector:
        """The column (n,) in SI units; ``quantity`` is one of `dbc.units.UNITS`.

        Raises:
            ConfigError: an unknown column or unit, a cell that is not a finite number.
        """
        return self._floats(key, column.column) * self._factor(key, column.unit, quantity)

    def triples(self, key: str, columns: Columns, quantity: str) -> Vector:
        """Three columns (n, 3) in SI units."""
        parts = [self._floats(key, name) for name in columns.columns]
        return np.column_stack(parts) * self._factor(key, columns.unit, quantity)

    def times_ns(self, key: str, column: Column) -> list[int]:
        """The column as integer nanoseconds; it must rise from row to row."""
        seconds = self._floats(key, column.column)
        factor = self._factor(key, column.unit, "time")
        # the product in nanoseconds is exact to far below one for any time of the week
        times = [round(float(value) * (factor * 1e9)) for value in seconds]
        for place, (before, after) in enumerate(itertools.pairwise(times)):
            if after <= before:
                raise ConfigError(
                    f"{self._path}: line {place + 3}: time does not rise "
                    f"({before / 1e9:.6f} s, then {after / 1e9:.6f} s)"
                )
        return times

    def codes(self, key: str, choice: Choice) -> list[str]:
        """The column's codes translated by the choice's table."""
        place = self._place(key, choice.column)
        texts = [row[place].strip() if place < len(row) else "" for row in self._rows]
        for line, text in enumerate(texts, start=2):
            if text not in choice.values:
                raise unknown(f"{self._path}: line {line}", choice.column, text, choice.values)
        return [choice.values[text] for text in texts]

    def _floats(self, key: str, name: str) -> Vector:
        sign = -1.0 if name.startswith("-") else 1.0
        place = self._place(key, name.removeprefix("-"))
        values = np.empty(len(self._rows))
        for row, cells in enumerate(self._rows):
            try:
                value = float(cells[place])
            except (ValueError, IndexError):
                value = math.nan
            if not math.isfinite(value):
                found = cells[place] if place < len(cells) else ""
                column = self._header[place]
                raise ConfigError(
                    f'{self._path}: line {row + 2}: {column}: found "{found}", expected a number'
                )
            values[row] = value
        return values * sign

    def _place(self, key: str, name: str) -> int:
        if name not in self._header:
            raise unknown(self._mapping, f"{self._key}.{key}.column", name, self._header)
        return self._header.index(name)

    def _factor(self, key: str, unit: str, quantity: str) -> float:
        try:
            return si_factor(unit, quantity)
        except ValueError as error:
            expected = f"a unit of {quantity}: {', '.join(UNITS[quantity])}"
            raise wrong(self._mapping, f"{self._key}.{key}.unit", unit, expected) from error


def kept(times_ns: Sequence[int], every: int, outages_s: Sequence[tuple[float, float]]) -> list[bool]:
    """Which rows stay: every ``every``-th from the first, none inside (start, length) after the first."""
    first = times_ns[0]
    return [
        place % every == 0
        and not any(start <= (t_ns - first) / 1e9 < start + length for start, length in outages_s)
        for place, t_ns in enumerate(times_ns)
    ]
