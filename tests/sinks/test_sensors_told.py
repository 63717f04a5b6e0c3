"""Faulty axes of a redundant unit: on CAN, as MAVLink status, in the live view and at the end of a run."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from bridge.live import Outcome
from bridge.outputs import DeviceHealth, Health, Severity, Transmit, UnitHealth, sensors_changed
from bridge.report import outcome_lines
from bridge.view import ViewSink
from nav.types import ImuChange
from tests.sinks.test_can_solution import read, sink
from tests.sinks.test_mavlink_telemetry import GroundStation, by_name, telemetry
from tests.sinks.test_view import Shown, drawn

SECOND = 1_000_000_000
NONE = np.zeros((2, 3))


def change(t_ns: int, *masks: int, device: str = "imu") -> ImuChange:
    return ImuChange(t_ns, device, *masks, NONE, 10.0, NONE, NONE)


def health(t_ns: int, **units: UnitHealth | None) -> Health:
    return Health(t_ns, {name: DeviceHealth(sensors=unit) for name, unit in units.items()}, 0, 0, 0)


def frames(sent: list[Transmit]) -> list[dict[str, float]]:
    return [found["SOL_IMU_HEALTH"] for f in sent if "SOL_IMU_HEALTH" in (found := read([f]))]


@pytest.mark.parametrize(
    ("masks", "words"),
    [
        ((0, 0, 0, 0), []),
        ((0b001000, 0, 0, 0), ["gyro 4 out"]),
        ((0b100001, 0b000110, 0, 0), ["gyros 1 and 6 out", "gyros 2 or 3 suspect"]),
        ((0, 0, 0, 0b11010), ["accelerometers 2, 4 or 5 suspect"]),
        ((0, 0, 0b10, 0), ["accelerometer 2 out"]),
    ],
)
def test_masks_in_words(masks: tuple[int, int, int, int], words: list[str]) -> None:
    assert UnitHealth(0, *masks).words() == words
    _, text = sensors_changed(5, change(4, *masks))
    assert text.text == ("imu: " + ", ".join(words) if words else "imu: all sensors in use")
    assert text.severity is (Severity.WARNING if words else Severity.NOTICE)


def test_the_bus_hears_of_a_change_at_once_and_once_a_second() -> None:
    can = sink()
    fine = UnitHealth(SECOND, 0, 0, 0, 0)
    (first,) = frames(can.consume([health(2 * SECOND, gnss=None, imu=fine)]))
    zero = {"GYROS_OUT": 0, "GYROS_SUSPECT": 0, "ACCELS_OUT": 0, "ACCELS_SUSPECT": 0}
    assert first == {"CRC": first["CRC"], "ALIVE": 0, "UNIT": 0, **zero, "AGE": 1}
    out = sensors_changed(2 * SECOND + 5_000_000, change(2 * SECOND + 4_000_000, 8, 0, 0, 0b011000))
    (at_once,) = frames(can.consume(out))
    assert at_once == {
        "CRC": at_once["CRC"], "ALIVE": 1, "UNIT": 0, **zero, "GYROS_OUT": 8, "ACCELS_SUSPECT": 24, "AGE": 0,
    }  # fmt: skip
    (later,) = frames(can.consume([health(70_000 * SECOND, imu=out[0].health)]))
    assert (later["ALIVE"], later["GYROS_OUT"], later["AGE"]) == (2, 8, 65535)


def test_units_are_counted_and_others_have_none() -> None:
    can = sink()
    assert frames(can.consume([health(SECOND, imu=None, gnss=None)])) == []
    assert frames(can.consume(sensors_changed(SECOND, change(SECOND, 1, 0, 0, 0)))) == []
    both = {"left": UnitHealth(0, 0, 0, 0, 0), "right": UnitHealth(0, 0, 0, 0, 0)}
    assert [f["UNIT"] for f in frames(can.consume([health(2 * SECOND, gnss=None, **both)]))] == [0, 1]
    sent = can.consume(sensors_changed(3 * SECOND, change(3 * SECOND, 0, 0, 2, 0, device="right")))
    assert [(f["UNIT"], f["ACCELS_OUT"]) for f in frames(sent)] == [(1, 2)]


def test_a_ground_station_hears_it() -> None:
    mavlink, station = telemetry(), GroundStation()
    messages = station.read(mavlink.consume(sensors_changed(SECOND, change(SECOND, 8, 0, 0, 0))))
    assert [(m.severity, m.text) for m in messages if m.get_type() == "STATUSTEXT"] == [
        (4, "imu: gyro 4 out")
    ]
    gyros, accels = dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO2, dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL2
    for unit, present, healthy in (
        (None, 0, 0),
        (UnitHealth(0, 0, 0, 0, 0), gyros | accels, gyros | accels),
        (UnitHealth(0, 8, 0, 0, 0), gyros | accels, accels),
        (UnitHealth(0, 0, 0, 0, 24), gyros | accels, gyros),
    ):
        status = by_name(GroundStation().read(telemetry().consume([health(2 * SECOND, imu=unit)])))[
            "SYS_STATUS"
        ]
        assert status.onboard_control_sensors_present & (gyros | accels) == present
        assert status.onboard_control_sensors_health & (gyros | accels) == healthy


def test_the_view_shows_it() -> None:
    shown = Shown()
    ViewSink(shown, "main").consume([health(SECOND, imu=UnitHealth(0, 8, 0, 0, 0), gnss=None)])
    assert "gyro 4 out" in drawn(shown.pictures[-1])


def test_the_end_of_a_run_tells_it() -> None:
    outcome = Outcome(
        "over", 9, 1.0, "abc", {}, {}, {"received_to_sent": {"count": 0}}, ("imu: gyro 4 out after 80.01 s",)
    )
    assert "imu: gyro 4 out after 80.01 s" in list(outcome_lines(outcome, 0))
