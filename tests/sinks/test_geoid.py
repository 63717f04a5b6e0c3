"""The geoid model against values published for EGM96 and against its own symmetries."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.geoid import undulation

# NIMA's test points for its interpolation of the 15' EGM96 grid (file OUTPUT.DAT beside INTPT.F):
# latitude, longitude (deg), undulation (m); then Mount Everest as MathWorks' egm96geoid gives it.
PUBLISHED = [
    (38.6281550, 269.7791550, -31.628),
    (-14.6212170, 305.0211140, -2.969),
    (46.8743190, 102.4487290, -43.575),
    (-23.6174460, 133.8747120, 15.871),
    (38.6254730, 359.9995000, 50.066),
    (-0.4667440, 0.0023000, 17.329),
    (27.988056, 86.925278, -28.7444),
]


@pytest.mark.parametrize(("lat_deg", "lon_deg", "expected"), PUBLISHED)
def test_published_undulations(lat_deg: float, lon_deg: float, expected: float) -> None:
    # 2 cm: 0.5 cm of rounding in the grid, and a cubic of another kind than NIMA's spline
    assert undulation(math.radians(lat_deg), math.radians(lon_deg)) == pytest.approx(expected, abs=0.02)


def test_poles_are_one_value_from_every_side() -> None:
    for pole, expected in ((math.pi / 2, 13.61), (-math.pi / 2, -29.53)):
        around = [undulation(pole, math.radians(lon)) for lon in range(-180, 181, 15)]
        assert max(around) - min(around) < 0.05  # the rows next to the pole differ by centimetres
        assert around[0] == pytest.approx(expected, abs=0.05)


@given(lat=st.floats(-1.5707, 1.5707), lon=st.floats(-3.14159, 3.14159))
def test_periodic_and_within_the_earths_extremes(lat: float, lon: float) -> None:
    value = undulation(lat, lon)
    assert -107.2 < value < 85.6  # the extremes of EGM96: south of India, New Guinea
    # the geoid slopes less than 1e-3, so the 1e-9 m of angle rounding in a turn is far below 1e-6
    assert undulation(lat, lon + 2.0 * math.pi) == pytest.approx(value, abs=1e-6)


@given(lat=st.floats(-1.57, 1.57), lon=st.floats(-3.2, 3.2), step=st.floats(-1e-6, 1e-6))
def test_continuous(lat: float, lon: float, step: float) -> None:
    # 1e-6 rad is 6 m; the slope of the 15' geoid stays below 1 m/km
    assert undulation(lat + step, lon + step) == pytest.approx(undulation(lat, lon), abs=0.02)


def test_unknown_position_gives_nan_and_nonsense_raises() -> None:
    assert math.isnan(undulation(math.nan, 0.0))
    with pytest.raises(ValueError, match="pole"):
        undulation(2.0, 0.0)
