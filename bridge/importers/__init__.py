"""Importers: other people's recordings as captures of raw frames.

An importer is a name, a line of help, a function that declares its arguments and one that runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple

from bridge.importers import candump, csv
from bridge.importers.capture import Imported

__all__ = ["IMPORTERS", "Imported", "Importer"]


class Importer(NamedTuple):
    """One line of `IMPORTERS`."""

    help: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], Imported]


IMPORTERS: dict[str, Importer] = {
    "csv": Importer(csv.HELP, csv.add_arguments, csv.run),
    "candump": Importer(candump.HELP, candump.add_arguments, candump.run),
}
