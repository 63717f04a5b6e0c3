"""Temperature: what the driver makes of counts at the one that the unit told last."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bridge.drivers.imu_can import ImuCan, ImuCanOptions
from bridge.frame import RawFrame
from nav.types import ImuSample
from tests.drivers.made import ARCSEC, CALIBRATION, can, context, flipped
from virtual_bus.bus import Bench
from virtual_bus.configuration import calibration_toml
from virtual_bus.grades import DEG_PER_H, GRADES, UG

PERIOD_US = 5000
TAU = PERIOD_US * 1e-6
WARM = (
    CALIBRATION.replace(
        b"[accel]",
        b"scale_temperature_ppm_per_deg_c = [[100], [0], [0]]\n"
        b"bias_temperature_deg_per_h_per_deg_c = [[0, 0], [2, 0.1], [0, 0]]\n[accel]\n"
        b"bias_temperature_ug_per_deg_c = [[0], [0], [50]]",
    )
    + b"[temperature]\nreference_deg_c = 25\nrange_deg_c = [-20, 65]\n"
)


def driver(calibration: bytes = WARM, rate_hz: float = 200.0) -> ImuCan:
    options = {"driver": "imu_can", "source": "can0", "calibration": "cal.toml", "rate_hz": rate_hz}
    return ImuCan(ImuCanOptions(**options), context("imu", {"cal.toml": calibration}))  # type: ignore[arg-type]


def three(k: int) -> list[RawFrame]:
    rx = 10**9 + k * PERIOD_US * 1000
    return [
        can("IMU_GYRO", k % 15, 0, 0, 0, 1000, 1000, 1000, rx_ns=rx),
        can("IMU_ACCEL", k % 15, 0, 0, 0, 1, 2, 490, rx_ns=rx + 1000),
        can("IMU_TIME", k % 15, 0, k % 256, 25, k * PERIOD_US, rx_ns=rx + 2000),
    ]


def status(k: int, temperature: float, serial: int = 77) -> RawFrame:
    return can("IMU_STATUS", k % 15, temperature, 0, serial, rx_ns=10**9 + k * PERIOD_US * 1000 + 3000)


def one_fd(k: int, temperature: float) -> RawFrame:
    values = (0,) * 6 + (1000, 1000, 1000, 1, 2, 490, k, k * PERIOD_US, temperature, 0, 0, 77)
    return can("IMU_FD", k % 256, *values, rx_ns=10**9 + k * PERIOD_US * 1000)


def fed(imu: ImuCan, frames: list[RawFrame]) -> list[ImuSample]:
    return [one for frame in frames for one in imu.feed(frame) if isinstance(one, ImuSample)]


def check(sample: ImuSample, d: float) -> None:
    """By hand, ``d`` degC above the reference."""
    drift = (2.0 * d + 0.1 * d * d) * ARCSEC * TAU  # deg/h is arcsec/s
    turned = [1000 * ARCSEC * (1.0 + 1e-4 * d), 1000 * ARCSEC - drift, 1000 * ARCSEC]
    np.testing.assert_allclose(sample.dtheta, turned, rtol=1e-12)
    pushed = [1e-4, 2e-4, 0.049 - 50e-6 * 9.80665 * d * TAU]
    np.testing.assert_allclose(sample.dv, pushed, rtol=1e-12)


# a resolution of 0.05 degC, in which these are whole; beyond the range what holds at its end
@pytest.mark.parametrize(
    ("told", "d"), [(25.0, 0.0), (35.0, 10.0), (-20.0, -45.0), (-55.0, -45.0), (144.0, 40.0)]
)
def test_coefficients_are_those_at_the_temperature_told(told: float, d: float) -> None:
    imu = driver()
    before = fed(imu, [*three(1), *three(2)])
    for sample in before:
        check(sample, 0.0)
    for sample in fed(imu, [status(2, told), *three(3), *three(4)]):
        check(sample, d)


def test_the_one_told_with_a_sample_is_its_own() -> None:
    imu = driver()
    for sample, d in zip(fed(imu, [one_fd(k, 20.0 + k) for k in range(1, 9)]), range(-4, 4), strict=True):
        check(sample, float(d))


def test_a_damaged_status_changes_nothing() -> None:
    imu = driver()
    fed(imu, [*three(1), status(1, 35.0), *three(2), flipped(status(2, 60.0))])
    check(fed(imu, three(3))[0], 10.0)


def test_a_unit_without_polynomials_does_not_ask() -> None:
    warm, cold = driver(CALIBRATION), driver(CALIBRATION)
    one = fed(warm, [*three(1), status(1, 60.0), *three(2)])
    two = fed(cold, [*three(1), status(1, -20.0), *three(2)])
    for a, b in zip(one, two, strict=True):
        assert a.dtheta.tobytes() == b.dtheta.tobytes()
        assert a.dv.tobytes() == b.dv.tobytes()


SCENARIO = """
title = "a unit of tuned gyros warms up"
grade = "dtg"
[start]
lat_deg = 45.0
lon_deg = 8.0
[[manoeuvre]]
kind = "static"
duration_s = 40.0
[imu]
rate_hz = 100.0
fd = {fd}
temperature_deg_c = [-20.0, 50.0]
warm_up_s = 15.0
"""


@pytest.mark.parametrize("fd", [False, True])
def test_a_unit_that_warms_up_on_the_bus(tmp_path: Path, fd: bool) -> None:
    """At rest, with a sheet that is right: what the driver says against gravity and the Earth's rate."""
    path = tmp_path / "warm.toml"
    path.write_text(SCENARIO.format(fd=str(fd).lower()))
    bench = Bench(path, seed=4)
    true = bench.imu_errors
    sheet = replace(true, calibrated_gyro=true.gyro, calibrated_accel=true.accel)
    text = calibration_toml(sheet, GRADES["dtg"]).encode()
    frozen = text.replace(b"range_deg_c = [-45.0, 70.0]", b"range_deg_c = [25.0, 25.0]")
    frames = [
        RawFrame(k, frame.t_ns, 1, frame.frame_id, frame.data)
        for k, frame in enumerate(bench.due(bench.end_ns))
        if 0x100 <= frame.frame_id <= 0x110
    ]
    turned, pushed = bench.trajectory.increments(np.array([0, 40_000_000_000]))
    error = []
    for calibration in (text, frozen):
        samples = fed(driver(calibration, 100.0), frames)
        seconds = sum(sample.dt for sample in samples)
        rate = sum(sample.dtheta for sample in samples) / seconds - turned[0] / 40.0
        force = sum(sample.dv for sample in samples) / seconds - pushed[0] / 40.0
        error.append((np.abs(rate).max() / DEG_PER_H, np.abs(force).max() / UG))
    # at 4 sigma random walk of 40 s and instability: 0.1 and 0.03 deg/h, 1.6 and 15 ug; of accelerometers
    # asymmetry, 5 ug, and the clock, 3 ug; a status 0.1 s old at most while it warms by 70 degC in 40 s,
    # which is 0.1 degC of 100 ppm and 40 ug
    assert error[0][0] < 0.4
    assert error[0][1] < 4.0 * np.linalg.norm([1.6, 15.0, 5.0, 3.0, 10.0, 4.0])
    # and what it would be at the reference
    assert error[1][0] > 3.0 * error[0][0]
    assert error[1][1] > 10.0 * error[0][1]
