"""Importing tables: the drivers give back what the tables say; what is wrong is named."""

from __future__ import annotations

import argparse
import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bridge.config import Config
from bridge.drivers import DRIVERS
from bridge.drivers.base import Context
from bridge.drivers.device_clock import DeviceClock
from bridge.errors import ConfigError
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.importers import IMPORTERS
from bridge.importers.csv import CsvImport, Withheld
from bridge.recording import Capture
from nav.types import FixType, GnssFix, ImuSample, Sample
from tests.recordings import DATA, needs_recording

T0 = 243_261.729

CONFIG = """
[source.can0]
type = "can"
interface = "virtual"
channel = "x"
[device.imu]
driver = "imu_can"
source = "can0"
calibration = "imu.toml"
rate_hz = 100
clock = "gps"
[device.gnss]
driver = "gnss_can"
source = "can0"
clock = "gps"
[device.odometer]
driver = "odometer_can"
source = "can0"
m_per_tick = 0.01
[device.baro]
driver = "baro_can"
source = "can0"
[navigator.main]
devices = ["imu", "gnss", "odometer", "baro"]
"""
CALIBRATION = """
[gyro]
scale_arcsec_per_pulse = [0.1, 0.1, 0.1]
[accel]
scale_m_s_per_pulse = [1e-5, 1e-5, 1e-5]
"""
MAPPING = """
config = "bench.toml"
gps_week = 2374
[imu.imu]
file = "imu.csv"
time = { column = "t", unit = "s" }
gyro = { columns = ["gx", "gy", "gz"], unit = "deg/s" }
accel = { columns = ["ax", "-ay", "az"], unit = "g" }
[gnss.gnss]
file = "gnss.csv"
time = { column = "t", unit = "ms" }
lat = { column = "lat", unit = "deg" }
lon = { column = "lon", unit = "deg" }
height = { column = "h", unit = "m" }
sigma = { columns = ["s", "s", "s"], unit = "m" }
velocity = { columns = ["ve", "vn", "vu"], unit = "km/h" }
sigma_velocity_m_s = [0.05, 0.05, 0.08]
fix_type = { column = "q", values = { 1 = "RTK_FIXED", 2 = "RTK_FLOAT" } }
[odometer.odometer]
file = "imu.csv"
time = { column = "t", unit = "s" }
speed = { column = "v", unit = "m/s" }
[baro.baro]
file = "gnss.csv"
time = { column = "t", unit = "ms" }
pressure = { column = "p", unit = "hPa" }
"""

Folder = Callable[..., Path]


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    """A mapping with its tables; ``change`` edits the text of one file."""

    def make(change: tuple[str, str, str] | None = None, gap: bool = False) -> Path:
        rows = ["t,gx,gy,gz,ax,ay,az,v"]
        for k in range(400):
            if gap and 200 <= k < 203:
                continue
            t = T0 + 0.01 * k + 0.001 * (k % 3)  # actual stamps jitter
            rows.append(f"{t:.4f},{math.sin(k):.5f},{-0.2},{0.3 * k / 400:.5f},0.1,0.02,1.01,{0.02 * k:.4f}")
        fixes = ["t,lat,lon,h,s,ve,vn,vu,q,p"]
        fixes.extend(
            f"{(T0 + 0.02 + 0.25 * k) * 1e3:.3f},40.{k:02d},-105.{k:02d},"
            f"1600.{k},0.01,3.6,{k},0,{1 + k % 2},835.{k}"
            for k in range(16)
        )
        texts = {
            "imu.csv": "\n".join(rows),
            "gnss.csv": "\n".join(fixes),
            "bench.toml": CONFIG,
            "imu.toml": CALIBRATION,
            "map.toml": MAPPING,
        }
        if change:
            name, before, after = change
            assert before in texts[name]
            texts[name] = texts[name].replace(before, after)
        for name, text in texts.items():
            (tmp_path / name).write_text(text)
        return tmp_path

    return make


def drive(config: Config, frames: list[RawFrame]) -> dict[str, list[Sample]]:
    """What each device's driver makes of the frames."""
    clocks: dict[str, DeviceClock] = {}
    samples: dict[str, list[Sample]] = {name: [] for name in config.devices}
    drivers = {}
    for name, options in config.devices.items():
        clock = clocks.setdefault(options.clock or name, DeviceClock())
        context = Context(name, config.source_number(options.source), config.file, config.files, clock)
        drivers[name] = DRIVERS[options.driver].factory(options, context)
    # in the order of arrival, as on the bus: devices on one clock depend on each other
    for frame in frames:
        for name, driver in drivers.items():
            if frame[2:4] in driver.keys:
                samples[name].extend(driver.feed(frame))
    for driver in drivers.values():
        assert not any(driver.counters.rejects)
    return samples


def test_the_drivers_give_back_the_tables(folder: Folder) -> None:
    where = folder()
    job = CsvImport(where / "map.toml", where)
    frames = list(job.frames())
    assert [frame.seq for frame in frames] == list(range(len(frames)))
    assert frames[0].rx_ns == 1_000_000_000
    assert all(a.rx_ns <= b.rx_ns for a, b in itertools.pairwise(frames))
    samples = drive(job.config, frames)

    imu = [s for s in samples["imu"] if isinstance(s, ImuSample)]
    assert len(imu) == 399
    k = np.arange(1, 400)
    t = T0 + 0.01 * k + 0.001 * (k % 3)
    dt = np.diff(np.concatenate([[T0], t]))
    # the driver knows the first interval only by its nominal length
    assert np.array([s.dt for s in imu])[1:] == pytest.approx(dt[1:], abs=1.1e-6)
    rate = np.radians(np.column_stack([np.sin(k), np.full(399, -0.2), 0.3 * k / 400]))
    turned = np.cumsum(rate * dt[:, None], axis=0)
    # half a pulse at each end, and the tables' five digits
    pulse = math.radians(0.1 / 3600)
    sums = np.cumsum([s.dtheta for s in imu], axis=0)
    assert np.abs(sums - turned).max() < pulse + 4.0 * math.radians(0.5e-5)
    force = np.sum([s.dv for s in imu], axis=0) / dt.sum()
    assert force == pytest.approx(np.array([0.1, -0.02, 1.01]) * 9.80665, abs=1e-4)

    fixes = [s for s in samples["gnss"] if isinstance(s, GnssFix)]
    assert len(fixes) == 16
    assert [math.degrees(s.lat) for s in fixes] == pytest.approx([40 + k / 100 for k in range(16)], abs=1e-9)
    assert fixes[5].v_g is not None
    assert fixes[5].v_g == pytest.approx([1.0, 5 / 3.6, 0.0], abs=0.0026)
    assert {s.fix_type for s in fixes} == {FixType.RTK_FIXED, FixType.RTK_FLOAT}
    # one clock: fixes and inertial samples are on one axis, to the microsecond of their counters
    assert (fixes[0].t_ns - imu[0].t_ns) / 1e9 == pytest.approx(0.02 - 0.011, abs=2e-6)

    rolled = sum(s.distance for s in samples["odometer"])  # type: ignore[union-attr]
    assert rolled == pytest.approx(float(np.sum(0.02 * k * dt)), abs=0.01)
    assert len(samples["baro"]) == 16


def test_missing_rows_are_missing_samples(folder: Folder) -> None:
    where = folder(gap=True)
    job = CsvImport(where / "map.toml", where)
    imu = drive(job.config, list(job.frames()))["imu"]
    assert len(imu) == 399  # three of them made up by the driver
    assert [k for k, s in enumerate(imu) if isinstance(s, ImuSample) and s.flags] == [199, 200, 201]


def test_fixes_can_be_withheld(folder: Folder) -> None:
    where = folder()

    def times(withheld: Withheld) -> list[float]:
        job = CsvImport(where / "map.toml", where, withheld)
        fixes = drive(job.config, list(job.frames()))["gnss"]
        return [
            round(((s.gps_ns or 0) / 1e9 - 2374 * 604_800) - T0 - 0.02, 3)
            for s in fixes
            if isinstance(s, GnssFix)
        ]

    everything = [0.25 * k for k in range(16)]
    assert times(Withheld()) == everything
    assert times(Withheld(every=4)) == everything[::4]
    kept = [t for t in everything if not (0.5 <= t < 1.0 or 2.0 <= t < 3.25)]
    assert times(Withheld(1, [(0.5, 0.5), (2.0, 1.25)])) == kept


def test_the_capture_holds_all_it_needs(folder: Folder, tmp_path: Path) -> None:
    where = folder()
    parser = argparse.ArgumentParser()
    IMPORTERS["csv"].add_arguments(parser)
    args = parser.parse_args(
        [str(where / "map.toml"), "--data", str(where), "--gnss-every", "2", "--gnss-outage", "2,1"]
    )
    args.out = str(tmp_path / "out.mcap")
    done = IMPORTERS["csv"].run(args)
    capture = Capture(done.path)
    frames = list(capture.frames())
    assert capture.damage is None
    assert len(frames) == sum(done.frames.values()) + 2
    assert (frames[0].source, frames[0].key) == (BRIDGE, Event.START)
    assert frames[-1].key == Event.STOP
    start = json.loads(frames[0].data)
    # 8 July 2025, 19:34:21.729 GPS time is 18 s less in UTC
    assert start["utc_ns"] / 1e9 == pytest.approx(1_752_003_261.729 - 18.0, abs=1e-3)
    config = Config.from_attachments(capture.attachments)
    fixes = drive(config, frames[1:-1])["gnss"]
    assert len(fixes) == 6  # every second of 16, two of those in the outage


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("map.toml", '"gx"', '"gyro_x"'), 'map.toml: imu.imu.gyro.column: found "gyro_x", expected'),
        (
            ("map.toml", '"deg/s"', '"deg/fortnight"'),
            'map.toml: imu.imu.gyro.unit: found "deg/fortnight", expected',
        ),
        (("map.toml", '"deg/s"', '"m"'), "expected a unit of angular rate"),
        (("map.toml", "[imu.imu]", "[imu.other]"), 'map.toml: imu.other: found "other", expected'),
        (("map.toml", "[odometer.odometer]", "[odometer.baro]"), 'map.toml: odometer.baro: found "baro_can"'),
        (("map.toml", 'file = "imu.csv"', 'file = "none.csv"'), "map.toml: imu.imu.file: cannot read"),
        (("map.toml", "gps_week =", "week ="), "map.toml: week: found an unknown key"),
        (("map.toml", '"RTK_FLOAT"', '"FLOAT"'), 'gnss.gnss.fix_type.values: found "FLOAT"'),
        (("map.toml", "2 = ", "3 = "), 'gnss.csv: line 3: q: found "2"'),
        (("map.toml", "sigma_velocity_m_s = [0.05, 0.05, 0.08]", ""), "exactly one of sigma_velocity"),
        (("map.toml", 'config = "bench.toml"', 'config = "absent.toml"'), "absent.toml: no such file"),
        (("imu.csv", ",-0.2,", ",abc,"), 'imu.csv: line 2: gy: found "abc", expected a number'),
        (("imu.csv", ",-0.2,", ",nan,"), 'imu.csv: line 2: gy: found "nan", expected a number'),
        (("imu.csv", f"{T0 + 0.05 + 0.002:.4f}", f"{T0:.4f}"), "imu.csv: line 7: time does not rise"),
        (("imu.csv", ",-0.2,", ",-200,"), "imu.csv: line 3"),
        (("gnss.csv", ",40.03,", ",140.03,"), "gnss.csv: GNSS_LAT.LAT: 140.03 is outside -90 to 90"),
        (("gnss.csv", ",1600.3,", ",1e9,"), "gnss.csv: GNSS_HEIGHT.HEIGHT: "),
        (("imu.toml", "0.1, 0.1, 0.1", "1e-7, 0.1, 0.1"), "is too fine"),
    ],
)
def test_what_is_wrong_is_named(folder: Folder, change: tuple[str, str, str], expected: str) -> None:
    where = folder(change)
    with pytest.raises(ConfigError) as caught:
        CsvImport(where / "map.toml", where)
    assert expected in str(caught.value)


@pytest.mark.parametrize("text", ["85", "85,0", "85,-1", "a,b"])
def test_an_outage_needs_a_start_and_a_length(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    IMPORTERS["csv"].add_arguments(parser)
    with pytest.raises(SystemExit):
        parser.parse_args(["map.toml", "--gnss-outage", text])
    assert "expected" in capsys.readouterr().err


@needs_recording("drive_mems_rtk")
def test_the_packaged_drive_keeps_every_row() -> None:
    job = CsvImport("drive_mems_rtk", DATA / "drive_mems_rtk")
    samples = drive(job.config, list(job.frames()))
    table = np.loadtxt(DATA / "drive_mems_rtk" / "imu.csv", delimiter=",", skiprows=1)
    assert len(samples["imu"]) == len(table) - 1
    assert len(samples["gnss"]) == 2197
    dt = np.diff(table[:, 0])
    imu = [s for s in samples["imu"] if isinstance(s, ImuSample)]
    turned = np.sum(np.radians(table[1:, 4:]) * dt[:, None], axis=0)
    # the first interval is taken as nominal by the driver, which does not change its increment
    assert np.sum([s.dtheta for s in imu], axis=0) == pytest.approx(turned, abs=math.radians(0.2 / 3600))
    assert not any(s.flags for s in imu)
    # one clock: every sample and fix stands where the tables have it, from the first second on
    fixes = [s for s in samples["gnss"] if isinstance(s, GnssFix)]
    gnss = np.loadtxt(DATA / "drive_mems_rtk" / "gnss.csv", delimiter=",", skiprows=1)
    begin = fixes[0].t_ns
    assert np.array([s.t_ns - begin for s in imu]) / 1e9 == pytest.approx(table[1:, 0] - gnss[0, 0], abs=1e-5)
    assert np.array([s.t_ns - begin for s in fixes]) / 1e9 == pytest.approx(gnss[:, 0] - gnss[0, 0], abs=1e-5)
