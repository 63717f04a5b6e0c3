"""What every entry of DRIVERS and ALIGNMENTS promises; a new entry is held to it once it is registered."""

from __future__ import annotations

import inspect
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.config import ATTACHMENT, Config
from bridge.drivers import DRIVERS
from bridge.drivers.base import Context, Driver
from bridge.drivers.device_clock import DeviceClock
from bridge.engine import Engine
from bridge.frame import RawFrame
from bridge.options import SOURCE_OPTIONS, DeviceOptions
from bridge.outputs import DeviceHealth
from bridge.strict import convert
from nav.align import ALIGNMENTS
from nav.types import (
    BaroSample,
    GnssFix,
    ImuSample,
    MasterState,
    OdoSample,
    SpeedSample,
    TableSample,
)
from tests.drivers.made import CALIBRATION

KINDS = {
    "imu": ImuSample,
    "odometer": OdoSample,
    "speed": SpeedSample,
    "gnss": GnssFix,
    "baro": BaroSample,
    "master": MasterState,
    "table": TableSample,
}

DBC = b"""VERSION ""
NS_ :
BS_:
BU_: UNIT
BO_ 768 RATES: 8 UNIT
 SG_ WX : 0|16@1- (0.01,0) [-300|300] "deg/s" UNIT
 SG_ WY : 16|16@1- (0.01,0) [-300|300] "deg/s" UNIT
 SG_ WZ : 32|16@1- (0.01,0) [-300|300] "deg/s" UNIT
BO_ 769 FORCES: 8 UNIT
 SG_ FX : 0|16@1- (0.001,0) [-30|30] "m/s^2" UNIT
 SG_ FY : 16|16@1- (0.001,0) [-30|30] "m/s^2" UNIT
 SG_ FZ : 32|16@1- (0.001,0) [-30|30] "m/s^2" UNIT
"""

LEAST: dict[str, dict[str, Any]] = {
    "imu_can": {"calibration": "cal.toml", "rate_hz": 200.0},
    "odometer_can": {"m_per_tick": 0.1},
    "sensors_mavlink": {"messages": ["HIGHRES_IMU", "GPS_INPUT", "WHEEL_DISTANCE"], "rate_hz": 100.0},
    "master_mavlink": {"system_id": 1},
    "dbc_map": {
        "dbc": "unit.dbc",
        "imu": {
            "rate_hz": 100.0,
            "gyro": {"x": "WX", "y": "WY", "z": "WZ"},
            "accel": {"x": "FX", "y": "FY", "z": "FZ"},
        },
    },
}
"""Keys that a driver cannot do without."""

FILES = {"cal.toml": CALIBRATION, "unit.dbc": DBC}


def options_of(name: str) -> DeviceOptions:
    table = {"driver": name, "source": "s", **LEAST.get(name, {})}
    return convert(table, DRIVERS[name].options, "test.toml", "device.d")


def made(name: str) -> Driver:
    return DRIVERS[name].factory(options_of(name), Context("d", 1, "test.toml", FILES, DeviceClock()))


@pytest.mark.parametrize("name", DRIVERS)
def test_a_driver_can_be_made_and_says_what_it_is(name: str) -> None:
    entry, driver = DRIVERS[name], made(name)
    assert issubclass(entry.options, DeviceOptions)
    assert entry.source_type in SOURCE_OPTIONS
    assert entry.provides(options_of(name)) <= set(KINDS)
    assert entry.provides(options_of(name))
    assert driver.keys
    assert all(source == 1 for source, _ in driver.keys)
    assert len(set(driver.keys)) == len(driver.keys)
    health = driver.counters.health(0)
    assert isinstance(health, DeviceHealth)
    assert (health.frames, health.samples, health.rejects) == (0, 0, {})
    assert inspect.getdoc(entry.options)


@pytest.mark.parametrize("name", DRIVERS)
def test_options_end_in_their_units(name: str) -> None:
    """A number with a unit says it in its key; those without are counts, ratios and identifiers."""
    plain = {"id_offset", "bridge_samples", "system_id", "component_id", "sensor_id", "wheels"}
    units = ("_ms", "_hz", "_m", "_m_s", "_per_tick", "_per_count", "_s", "_us", "_deg")
    for field in msgspec.structs.fields(DRIVERS[name].options):
        text = str(field.type)
        if ("float" in text or "int" in text) and "Map" not in text and field.name not in plain:
            assert field.name.endswith(units), field.name


@pytest.mark.parametrize("name", DRIVERS)
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_garbage_never_raises_and_is_counted(name: str, data: st.DataObject) -> None:
    driver = made(name)
    keys = [key for _, key in driver.keys]
    lengths = st.one_of(st.binary(min_size=8, max_size=8), st.binary(max_size=300))
    times = st.one_of(st.integers(10**12, 10**12 + 10**10), st.integers(-(2**63), 2**63 - 1))
    frames = data.draw(
        st.lists(
            st.builds(RawFrame, st.just(0), times, st.just(1), st.sampled_from(keys), lengths), max_size=60
        )
    )
    last: dict[type, int] = {}
    kinds = tuple(KINDS[kind] for kind in DRIVERS[name].provides(options_of(name)))
    samples = 0
    for frame in frames:
        for sample in driver.feed(frame):
            samples += 1
            assert isinstance(sample, kinds)
            assert sample.device == "d"
            assert sample.t_ns > last.get(type(sample), -(2**64))
            last[type(sample)] = sample.t_ns
    health = driver.counters.health(10**12)
    assert health.frames == len(frames)
    assert health.samples + health.bridged >= samples


@pytest.mark.parametrize("name", ALIGNMENTS)
def test_an_alignment_is_in_reach_of_a_configuration(name: str) -> None:
    config = Config.load("bench")
    files = config.attachments()
    text = files[ATTACHMENT].decode().replace('alignment = "static"', f'alignment = "{name}"')
    table = "[navigator.main.align]\n"
    assert table in text
    text = text.replace(table, f"{table}known_heading_deg = 40.0\n")
    engine = Engine(Config.from_attachments({**files, ATTACHMENT: text.encode()}))
    assert ALIGNMENTS[name].needs <= {*KINDS, "heading"}
    assert ALIGNMENTS[name].stages
    assert engine.digests().keys() == {"main"}
