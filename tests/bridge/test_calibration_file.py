"""Calibration files: second-order terms and temperature, there and back, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from bridge.calibration import UNITS, read_calibration
from bridge.errors import ConfigError

G = 9.80665
DEG_PER_H = math.radians(1.0) / 3600.0
PLAIN = """
[gyro]
scale_arcsec_per_pulse = [1, 1, 1]
[accel]
scale_m_s_per_pulse = [1e-4, 1e-4, 1e-4]
"""
MATRIX = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]
RANGE = "[temperature]\nreference_deg_c = 20\nrange_deg_c = [-40, 60]\n"


def with_lines(gyro: str = "", accel: str = "", more: str = "") -> bytes:
    text = PLAIN.replace("[gyro]", f"[gyro]\n{gyro}").replace("[accel]", f"[accel]\n{accel}")
    return (text + more).encode()


def test_units_of_the_second_order() -> None:
    text = with_lines(
        f"square_deg_per_h_per_g2 = {MATRIX}\nproduct_deg_per_s_per_g2 = {MATRIX}",
        f"square_ug_per_g2 = {MATRIX}\nproduct_mg_per_g2 = {(1e-3 * np.array(MATRIX)).tolist()}",
    )
    c = read_calibration(text, "c.toml").calibration
    matrix = np.array(MATRIX)
    np.testing.assert_allclose(c.gyro_square, matrix * DEG_PER_H / G**2, rtol=1e-14)
    np.testing.assert_allclose(c.gyro_product, matrix * math.radians(1.0) / G**2, rtol=1e-14)
    np.testing.assert_allclose(c.accel_square, matrix * 1e-6 * G / G**2, rtol=1e-14)
    np.testing.assert_allclose(c.accel_product, matrix * 1e-6 * G / G**2, rtol=1e-14)
    assert c.thermal is None


def test_units_of_temperature() -> None:
    rows = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
    text = with_lines(
        f"scale_temperature_ppm_per_deg_c = {rows}\nbias_temperature_deg_per_h_per_deg_c = {rows}",
        "bias_temperature_ug_per_deg_c = [[1], [2], [3]]",
        RANGE,
    )
    t = read_calibration(text, "c.toml").calibration.thermal
    assert t is not None
    assert (t.reference, t.lowest, t.highest) == (20.0, -40.0, 60.0)
    np.testing.assert_allclose(t.gyro_scale, 1e-6 * np.array(rows))
    np.testing.assert_allclose(t.gyro_bias, DEG_PER_H * np.array(rows))
    assert t.accel_scale.shape == (3, 0)
    np.testing.assert_allclose(t.accel_bias, 1e-6 * G * np.array([[1.0], [2.0], [3.0]]))


numbers = st.floats(-0.05, 0.05)  # in mg/g^2, too, they can be inverted


@given(data=st.data())
def test_there_and_back(data: st.DataObject) -> None:
    """Every new quantity in any of its units: what is read is the number times the unit."""
    document: dict[str, Any] = {
        "gyro": {"scale_arcsec_per_pulse": [1.0] * 3},
        "accel": {"scale_m_s_per_pulse": [1.0] * 3},
    }
    expected: dict[str, np.ndarray] = {}
    thermal = False
    for sensor in ("gyro", "accel"):
        for quantity in ("square", "product", "scale_temperature", "bias_temperature"):
            if not data.draw(st.booleans()):
                continue
            unit, factor = data.draw(st.sampled_from(sorted(UNITS[sensor][quantity].items())))
            polynomial = quantity.endswith("temperature")
            columns = data.draw(st.integers(1, 6)) if polynomial else 3
            row = st.lists(numbers, min_size=columns, max_size=columns)
            rows = data.draw(st.lists(row, min_size=3, max_size=3))
            thermal |= polynomial
            document[sensor][f"{quantity}_{unit}"] = rows
            expected[f"{sensor}_{quantity}"] = np.array(rows) * factor
    if thermal:  # so narrow that no polynomial reaches far
        document["temperature"] = {"reference_deg_c": 21.0, "range_deg_c": [20.5, 21.5]}
    c = read_calibration(tomli_w.dumps(document).encode(), "c.toml").calibration
    for name, value in expected.items():
        if name.endswith("temperature"):
            assert c.thermal is not None
            got = getattr(c.thermal, name.removesuffix("_temperature"))
        else:
            got = getattr(c, name)
        np.testing.assert_array_equal(got, value)


BIAS = "bias_temperature_deg_per_h_per_deg_c = "


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (with_lines(BIAS + "[[1], [1], [1]]"), ["c.toml: temperature: found no table"]),
        (with_lines(more=RANGE), ["c.toml: temperature", "polynomials, as gyro.bias_temperature"]),
        (with_lines(BIAS + "[[1], [1, 2], [1]]", more=RANGE), ["gyro.bias_temperature", "of equal length"]),
        (with_lines(BIAS + "[[], [], []]", more=RANGE), ["gyro.bias_temperature", "1 to 6 numbers"]),
        (with_lines(BIAS + "[[1], [1]]", more=RANGE), ["gyro.bias_temperature", "three rows"]),
        (with_lines(BIAS + "[1, 1, 1]", more=RANGE), ["gyro.bias_temperature", "three rows"]),
        (with_lines(BIAS + "[[true], [1], [1]]", more=RANGE), ["gyro.bias_temperature", "found true"]),
        (with_lines(BIAS + f"{[[1] * 7] * 3}", more=RANGE), ["gyro.bias_temperature", "1 to 6 numbers"]),
        (
            with_lines(BIAS + "[[1], [1], [1]]", more=RANGE.replace("20", "80")),
            ["reference temperature", "-40 to 60 degC", "80"],
        ),
        (
            with_lines(BIAS + "[[1], [1], [1]]", more=RANGE.replace("reference_deg_c", "reference_k")),
            ["temperature.reference_k", "unknown key"],
        ),
        (
            with_lines("scale_temperature_ppm_per_deg_c = [[2e4], [1], [1]]", more=RANGE),
            ["gyro_scale: it may become zero"],
        ),
        (with_lines("square_ug_per_g2 = [[1]]"), ["gyro.square_ug_per_g2", "unknown key or unit"]),
        (with_lines(accel="product_ug_per_g2 = [1, 2, 3]"), ["accel.product_ug_per_g2", "three rows"]),
        (
            with_lines(accel="square_mg_per_g2 = [[9, 0, 0], [0, 9, 0], [0, 0, 9]]"),
            ["accel_square, accel_product: too large"],
        ),
        (
            with_lines(BIAS + "[[1], [1], [1]]", more=f"{RANGE}[sigma.gyro]\n{BIAS}[[1, 2], [1, 2], [1, 2]]"),
            ["sigma.gyro.bias_temperature", "as many numbers as in gyro.bias_temperature"],
        ),
    ],
)
def test_what_is_wrong_is_said(text: bytes, says: list[str]) -> None:
    with pytest.raises(ConfigError) as error:
        read_calibration(text, "c.toml")
    assert str(error.value).startswith("c.toml: ")
    for part in says:
        assert part in str(error.value), str(error.value)
