"""Height of the geoid above the WGS-84 ellipsoid, for the worlds that speak of mean sea level.

The model is EGM96 to degree and order 360 (Lemoine et al., "The Development of the Joint NASA
GSFC and NIMA Geopotential Model EGM96", NASA/TP-1998-206861), a work of the United States
government and in the public domain, on the 15' grid that NIMA published with it. The grid was taken
from ``egm96_15.gtx`` of the PROJ datum grids (Debian package proj-data 9.1.1), rounded to a
centimetre and stored as differences along and across rows, which xz packs into half a megabyte.

Between the nodes a bicubic convolution is used (R. Keys, "Cubic Convolution Interpolation for Digital
Image Processing", IEEE Trans. ASSP 29, 1981): within 2 cm of NIMA's own evaluations of the
model at their published test points. The model itself is good to 0.5 to 1 m against the real geoid.
"""

from __future__ import annotations

import lzma
import math
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

_ROWS, _COLUMNS = 721, 1440  # from the south pole northwards, from 180 degrees west eastwards
_PER_DEG = 4


@lru_cache(maxsize=1)
def _grid_cm() -> NDArray[np.int32]:
    packed = files("bridge").joinpath("geoid_egm96.xz").read_bytes()
    steps = np.frombuffer(lzma.decompress(packed), "<i2").reshape(_ROWS, _COLUMNS)
    grid: NDArray[np.int32] = steps.astype(np.int32).cumsum(axis=0).cumsum(axis=1).astype(np.int32)
    return grid


def _node(row: int, column: int) -> float:
    """Undulation in centimetres; beyond a pole the meridian goes on, half a turn away."""
    if row < 0:
        row, column = -row, column + _COLUMNS // 2
    elif row >= _ROWS:
        row, column = 2 * (_ROWS - 1) - row, column + _COLUMNS // 2
    return float(_grid_cm()[row, column % _COLUMNS])


def _weights(x: float) -> tuple[float, float, float, float]:
    """Cubic convolution weights (a = -1/2) of the nodes at -1, 0, 1, 2 for a point at x in [0, 1]."""
    return (
        ((-0.5 * x + 1.0) * x - 0.5) * x,
        (1.5 * x - 2.5) * x * x + 1.0,
        ((-1.5 * x + 2.0) * x + 0.5) * x,
        (0.5 * x - 0.5) * x * x,
    )


def undulation(lat: float, lon: float) -> float:
    """Height of the geoid above the ellipsoid (m) at geodetic ``lat``, ``lon`` (rad).

    A height above mean sea level is the ellipsoidal height minus this. NaN gives NaN. Raises
    ValueError for a latitude beyond a pole.

    Source: EGM96 15' grid, see the module's docstring.
    """
    if math.isnan(lat) or math.isnan(lon):
        return math.nan
    y = (math.degrees(lat) + 90.0) * _PER_DEG
    if not -1e-6 <= y <= _ROWS - 1 + 1e-6:
        raise ValueError(f"latitude {lat!r} rad is beyond a pole")
    x = ((math.degrees(lon) + 180.0) % 360.0) * _PER_DEG
    row = min(max(int(y), 0), _ROWS - 2)
    column = int(x)
    across = _weights(x - column)
    total = 0.0
    for i, weight in enumerate(_weights(y - row)):
        line = 0.0
        for j in range(4):
            line += across[j] * _node(row - 1 + i, column - 1 + j)
        total += weight * line
    return total * 0.01
