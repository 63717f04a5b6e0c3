"""Calibration files of more than three gyros and accelerometers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bridge.calibration import CalibrationFile, read_calibration
from bridge.calibration_sensors import RedundantFile, read_unit
from bridge.errors import ConfigError
from tests.drivers.made import CALIBRATION

FIVE = """
[device]
model = "five and four"
serial = 99
[gyro]
scale_arcsec_per_pulse = [0.1, 0.2, 0.3, 0.4, 0.5]
bias_deg_per_h = [1.0, -2.0, 3.0, -4.0, 5.0]
axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8]]
[accel]
scale_m_s_per_pulse = [1e-5, 2e-5, 3e-5, 4e-5]
scale_negative_m_s_per_pulse = [1.1e-5, 2.1e-5, 3.1e-5, 4.1e-5]
axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]
[sigma.gyro]
bias_deg_per_h = [0.1, 0.1, 0.1, 0.1, 0.1]
"""


def test_a_file_of_five_gyros_and_four_accelerometers() -> None:
    file = read_unit(FIVE.encode(), "five.toml")
    assert isinstance(file, RedundantFile)
    assert (file.model, file.serial) == ("five and four", 99)
    arcsec = math.radians(1.0 / 3600.0)
    np.testing.assert_allclose(file.gyros.scale_plus, arcsec * 0.1 * np.arange(1, 6), rtol=1e-14)
    np.testing.assert_array_equal(file.gyros.scale_minus, file.gyros.scale_plus)
    np.testing.assert_allclose(file.gyros.bias[4], 5.0 * arcsec, rtol=1e-14)  # deg/h is arcsec/s
    np.testing.assert_array_equal(file.gyros.axes[3], [0.6, 0.0, 0.8])
    np.testing.assert_array_equal(file.gyros.g_sensitivity, np.zeros((5, 3)))
    np.testing.assert_allclose(file.accels.scale_minus, [1.1e-5, 2.1e-5, 3.1e-5, 4.1e-5], rtol=1e-14)
    np.testing.assert_array_equal(file.accels.bias, np.zeros(4))


def test_three_and_three_are_what_they_were() -> None:
    file = read_unit(CALIBRATION, "cal.toml")
    assert isinstance(file, CalibrationFile)
    np.testing.assert_array_equal(
        file.calibration.table(), read_calibration(CALIBRATION, "cal.toml").calibration.table()
    )


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("0.4, 0.5]", "0.4]", "gyro.bias_deg_per_h: found .*, expected four numbers"),
        (", [0.6, 0.0, 0.8], [0.0, 0.6, 0.8]]", "]", "gyro.axes: found .*, expected five rows of three"),
        ("[0.0, 0.6, 0.8]", "[0.0, 0.6]", r"gyro.axes: found \[0.0, 0.6\], expected five rows of three"),
        ("axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]", "", "accel.axes: fo"),
        ("1e-5, 2e-5, 3e-5, 4e-5]", "1e-5, 2e-5, 3e-5]", "accel.scale_negative_m_s_.*: .*three numbers"),
        ("[sigma.gyro]", "lever_arm_mm = [[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]\n[sigma.gyro]", "arm"),
        ("[0.1, 0.1, 0.1, 0.1, 0.1]", "[0.1, 0.1, 0.1]", "sigma.gyro.bias_deg_per_h: .*five numbers"),
        ("0.4, 0.5]", "0.4, 0.0]", "gyro.scale: found 0.0"),
        ("[0.1, 0.2, 0.3, 0.4, 0.5]", "[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]", "scale_arcsec.*three numbers"),
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_refused(old: str, new: str, says: str) -> None:
    assert old in FIVE
    with pytest.raises(ConfigError, match=says):
        read_unit(FIVE.replace(old, new).encode(), "five.toml")


def test_redundant_gyros_need_redundant_accelerometers() -> None:
    three = FIVE[: FIVE.index("[accel]")] + "[accel]\nscale_m_s_per_pulse = [1e-5, 1e-5, 1e-5]\n"
    with pytest.raises(ConfigError, match=r"accel: found .three sensors., expected four to six"):
        read_unit(three.encode(), "five.toml")


def test_who_takes_three_alone_says_so() -> None:
    with pytest.raises(ConfigError, match=r"gyro: found .5 sensors., expected three here"):
        read_calibration(FIVE.encode(), "five.toml")
