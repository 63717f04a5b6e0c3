"""The packaged flight over the pole, end to end: every frame and message of all sinks is decoded and held to
what it must be: in range, of one frame of reference, and without a jump in Earth-fixed space.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from bridge.assemble import make_sinks
from bridge.cli import main
from bridge.config import Config
from bridge.engine import Engine
from bridge.frame import RawFrame
from bridge.outputs import Transmit
from bridge.sinks import SINKS, SinkContext
from bridge.sinks.can_solution import CanSolutionOptions
from bridge.sinks.epoch import EPOCH
from dbc.codec import contract
from nav import earth, polar
from nav.polar import Frame, View
from nav.types import Mode, SolutionFlag
from virtual_bus.bus import Bench

FRAMES = {"geographic": Frame.GEOGRAPHIC, "grid": Frame.GRID, "transverse": Frame.TRANSVERSE}
ZERO = np.zeros(1)


class Flight(NamedTuple):
    """What was sent on CAN by frame, and on MAVLink, and the bench that knows the truth."""

    bench: Bench
    can: dict[str, list[Transmit]]
    mavlink: list[Any]


@pytest.fixture(scope="module")
def flight() -> Flight:
    bench = Bench("polar_transit", seed=4)
    files = bench.files("virtual", "bench", "udpout:127.0.0.1:14550")
    config = Config.from_files(files)
    engine = Engine(config)
    configured, telemetry = make_sinks(config, engine)
    can = {"transverse": configured}
    for name in ("geographic", "grid"):
        options = CanSolutionOptions(
            type="can_solution", navigator="main", source="bench", rate_hz=10.0, polar=name
        )
        can[name] = SINKS["can_solution"].factory(options, SinkContext(name, 1))
    sent: dict[str, list[Transmit]] = {name: [] for name in can}
    messages, parser = [], dialect.MAVLink(None)
    for seq, frame in enumerate(bench.due(bench.end_ns)):
        outputs = engine.feed(RawFrame(seq, frame.t_ns, 1, frame.frame_id, frame.data))
        if outputs:
            for name, sink in can.items():
                sent[name] += sink.consume(outputs)
            for packet in telemetry.consume(outputs):
                messages += parser.parse_buffer(bytearray(packet.data))
    return Flight(bench, sent, messages)


def epochs(sent: list[Transmit]) -> Iterator[dict[str, dict[str, float]]]:
    """Signals by message of one epoch after the other; every frame is whole and in range."""
    messages = contract()
    epoch: dict[str, dict[str, float]] = {}
    alive = -1
    for frame in sent:
        codec = messages.by_id[frame.key]
        assert codec.crc_ok(frame.data)
        values = codec.decode(frame.data)
        assert codec.in_range(values), (codec.name, values)
        if codec.name not in EPOCH:
            continue
        if codec.name == "SOL_TIME":
            if epoch:
                yield epoch
            epoch, alive = {}, codec.alive(frame.data)
        assert codec.alive(frame.data) == alive
        epoch[codec.name] = dict(zip(codec.signals, values, strict=True))
    yield epoch


class Read(NamedTuple):
    """What a reader of the frames has: time since the start, place, velocity and forward axis in e."""

    t: float
    r_e: np.ndarray
    v_e: np.ndarray
    ahead_e: np.ndarray


def read(epoch: dict[str, dict[str, float]], expected: Frame, start_us: float) -> Read:
    """An epoch in Earth-fixed axes, by its own flags."""
    heading, velocity, lat, lon = (epoch[name] for name in ("SOL_HEADING", "SOL_VEL_H", "SOL_LAT", "SOL_LON"))
    place = Frame.GEOGRAPHIC if expected is Frame.GRID else expected
    assert heading["FRAME"] == velocity["FRAME"] == epoch["SOL_SIGMA_VEL"]["FRAME"] == expected
    assert lat["FRAME"] == lon["FRAME"] == place
    at = View(place, np.array(math.radians(lat["LAT"])), np.array(math.radians(lon["LON"])), ZERO, ZERO, ZERO)
    C = polar.axes_e(at._replace(frame=expected))
    psi, pitch = math.radians(heading["HEADING"]), math.radians(epoch["SOL_LEVEL"]["PITCH"])
    ahead = np.array([math.sin(psi) * math.cos(pitch), math.cos(psi) * math.cos(pitch), math.sin(pitch)])
    v = np.array([velocity["VEL_E"], velocity["VEL_N"], epoch["SOL_VEL_U"]["VEL_U"]])
    r_e = polar.position_e(at, epoch["SOL_HEIGHT"]["HEIGHT"])
    return Read((epoch["SOL_TIME"]["TIME"] - start_us) * 1e-6, r_e, C @ v, C @ ahead)


@pytest.mark.parametrize("name", FRAMES)
def test_every_solution_frame_over_the_pole(flight: Flight, name: str) -> None:
    start_us = flight.bench.scenario.start.gps_tow_s * 1e6
    before: Read | None = None
    rate_hz = 50.0 if name == "transverse" else 10.0
    whole, nearest = 0, math.inf
    for epoch in epochs(flight.can[name]):
        if set(epoch) != set(EPOCH):
            # before there is a position; and never after
            assert before is None
            continue
        whole += 1
        now = read(epoch, FRAMES[name], start_us)
        navigating = epoch["SOL_TIME"]["MODE"] == Mode.NAVIGATE
        assert navigating
        valid = SolutionFlag.POSITION | SolutionFlag.VELOCITY | SolutionFlag.LEVEL | SolutionFlag.HEADING
        assert SolutionFlag(int(epoch["SOL_HEADING"]["FLAGS"])) & valid == valid
        if before is not None:
            dt = now.t - before.t
            assert 0.0 < dt < 2.1 / rate_hz
            # corrections by fixes are decimetres, the first metres; a frame mixed up would be kilometres
            assert np.linalg.norm(now.r_e - before.r_e - 0.5 * dt * (now.v_e + before.v_e)) < 2.0
            # 1.2 g, and turns of 15 deg/s; the first fixes correct velocity and heading too
            assert np.linalg.norm(now.v_e - before.v_e) < 0.3 + 12.0 * dt
            assert np.linalg.norm(now.ahead_e - before.ahead_e) < 0.03 + 0.25 * dt
        nearest = min(nearest, math.hypot(*now.r_e[:2]))
        if whole % 25 == 0:
            truth = flight.bench.truth(round(now.t * 1e9))
            C_eg = earth.position_matrix(truth.lat, truth.lon)
            assert np.linalg.norm(now.r_e - earth.ecef(truth.lat, truth.lon, truth.height)) < 5.0
            assert np.linalg.norm(now.v_e - C_eg @ truth.v_g) < 0.5
        before = now
    # from the alignment's end to the end of the flight, and within metres of the pole
    assert whole > rate_hz * 145.0
    # nine metres, and half the way of an epoch
    assert nearest < 10.0 + 0.5 * 220.0 / rate_hz


def test_every_mavlink_message_over_the_pole(flight: Flight) -> None:
    counted = Counter(message.get_type() for message in flight.mavlink)
    assert "BAD_DATA" not in counted
    assert counted["GLOBAL_POSITION_INT"] > 1450
    before: dict[str, Any] = {}
    origin = None
    for message in flight.mavlink:
        kind = message.get_type()
        for field in message.get_fieldnames():
            value = getattr(message, field)
            # what is not known yet is NaN in these two
            if kind not in ("ODOMETRY", "ESTIMATOR_STATUS") and isinstance(value, float):
                assert math.isfinite(value), (kind, field)
        if kind in ("GLOBAL_POSITION_INT", "GPS_RAW_INT", "HOME_POSITION"):
            lat, lon = (
                (message.latitude, message.longitude)
                if kind == "HOME_POSITION"
                else (message.lat, message.lon)
            )
            assert abs(lat) <= 900_000_000
            assert abs(lon) <= 1_800_000_000
        if kind == "GLOBAL_POSITION_INT":
            assert message.hdg < 36_000
            lat, lon = math.radians(message.lat * 1e-7), math.radians(message.lon * 1e-7)
            r_e = earth.ecef(lat, lon, 0.0)
            v_e = earth.position_matrix(lat, lon) @ [message.vy * 0.01, message.vx * 0.01, -message.vz * 0.01]
            t = message.time_boot_ms * 1e-3
            if kind in before:
                t0, r0, v0 = before[kind]
                # on the ground; 1e-7 deg is 11 mm, cm/s are rounded
                step = r_e - r0 - 0.5 * (t - t0) * (v_e + v0)
                assert np.linalg.norm(step[:2]) < 2.0
                assert np.linalg.norm(v_e - v0) < 3.0
            before[kind] = t, r_e, v_e
        elif kind == "ATTITUDE":
            assert abs(message.yaw) <= math.pi
        elif kind == "GPS_RAW_INT":
            assert message.cog < 36_000
            assert message.vel < 65_535
        elif kind in ("LOCAL_POSITION_NED", "ODOMETRY"):
            r = np.array([message.x, message.y, message.z])
            v = np.array([message.vx, message.vy, message.vz])
            t = message.time_boot_ms * 1e-3 if kind == "LOCAL_POSITION_NED" else message.time_usec * 1e-6
            if kind == "ODOMETRY":
                q = np.array(message.q)
                assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-6)
                assert np.isfinite(message.pose_covariance).all()
                assert np.isfinite(message.velocity_covariance).all()
                v = _rotated(q, v)
            if kind in before:
                t0, r0, v0 = before[kind]
                assert np.linalg.norm(r - r0 - 0.5 * (t - t0) * (v + v0)) < 2.0
                assert np.linalg.norm(v - v0) < 3.0
            elif kind == "LOCAL_POSITION_NED":
                origin = r
            before[kind] = t, r, v
    # it took off towards the pole, 22 km away, and was beyond it; in the local frame that is straight ahead
    assert origin is not None
    assert np.abs(origin).max() < 1.0
    r = before["LOCAL_POSITION_NED"][1]
    assert r[0] > 25_000.0


def test_the_demonstration_ends_with_its_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["demo", "polar_transit", "--seconds", "30", "--speed", "max", "--no-view", "--mavlink", "none"]
    assert main([*words, "--out", str(tmp_path / "polar.mcap")]) == 0
    lines = capsys.readouterr().out.splitlines()
    table = {line.split()[0]: line.split() for line in lines if line.startswith(("horizontal", "heading"))}
    # nine seconds after take-off began, at 60 m/s
    assert float(table["horizontal"][3]) < 3.0
    assert float(table["heading"][3]) < 5.0


def _rotated(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    turned = np.cross(q[1:], v) * 2.0
    return np.asarray(v + q[0] * turned + np.cross(q[1:], turned))
