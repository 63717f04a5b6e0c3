"""The solution on CAN, read back with cantools as any CAN tool would."""

from __future__ import annotations

import math
import re
from importlib.resources import files
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.outputs import DeviceHealth, FixOut, Health, ModeChange, Output, Progress, Reject, Transmit
from bridge.sinks import SINKS, SinkContext
from bridge.sinks.can_solution import CanSolution, CanSolutionOptions
from bridge.sinks.epoch import EPOCH
from dbc.codec import contract
from nav import earth, polar
from nav.polar import Frame, View
from nav.types import FixType, GnssFix, Mode, S, Solution, SolutionFlag
from tests.sinks.made import out, solution, unknown

DBC: Any = cantools.database.load_string((files("dbc") / "navbridge.dbc").read_text("cp1252"), "dbc")


def sink(rate_hz: float = 50.0, id_offset: int = 0, **more: Any) -> CanSolution:
    options = CanSolutionOptions(
        type="can_solution", navigator="main", source="can0", rate_hz=rate_hz, id_offset=id_offset, **more
    )
    made = SINKS["can_solution"].factory(options, SinkContext("solution", 3))
    assert isinstance(made, CanSolution)
    return made


def read(sent: list[Transmit]) -> dict[str, dict[str, float]]:
    frames = {}
    for frame in sent:
        message = DBC.get_message_by_frame_id(frame.key)
        assert contract()[message.name].crc_ok(frame.data)
        assert frame.source == 3
        frames[message.name] = message.decode(frame.data, decode_choices=False)
    return frames


def test_epoch_is_read_back_by_cantools() -> None:
    s = solution()
    frames = read(sink().consume([out(s)]))
    assert list(frames) == list(EPOCH)
    assert len({frame["ALIVE"] for frame in frames.values()}) == 1
    # half a raw step of each signal, and the double's rounding
    expected = {
        ("SOL_LEVEL", "ROLL"): (2.0, 5.1e-6),
        ("SOL_LEVEL", "PITCH"): (-3.0, 5.1e-6),
        ("SOL_HEADING", "HEADING"): (200.0, 5.1e-6),
        ("SOL_HEADING", "FLAGS"): (float(s.flags), 0.0),
        ("SOL_VEL_H", "VEL_E"): (3.0, 5.1e-5),
        ("SOL_VEL_H", "VEL_N"): (4.0, 5.1e-5),
        ("SOL_VEL_U", "VEL_U"): (-0.5, 5.1e-5),
        ("SOL_LAT", "LAT"): (48.14, 5.1e-9),
        ("SOL_LAT", "SIGMA_N"): (0.5, 5.1e-3),
        ("SOL_LON", "LON"): (11.58, 5.1e-9),
        ("SOL_LON", "SIGMA_E"): (0.4, 5.1e-3),
        ("SOL_HEIGHT", "HEIGHT"): (600.0, 5.1e-4),
        ("SOL_HEIGHT", "SIGMA_U"): (0.9, 2.6e-3),
        ("SOL_RATE", "W_Z"): (math.degrees(0.03), 2.6e-3),
        ("SOL_FORCE", "F_Z"): (9.81, 1.1e-3),
        ("SOL_SIGMA_ATT", "SIGMA_ROLL"): (0.05, 5.1e-5),
        ("SOL_SIGMA_ATT", "SIGMA_HEADING"): (0.2, 5.1e-4),
        ("SOL_SIGMA_VEL", "SIGMA_VU"): (0.04, 2.6e-4),
        ("SOL_TIME", "MODE"): (float(Mode.NAVIGATE), 0.0),
        ("SOL_TIME", "TIME_BASE"): (0.0, 0.0),
        ("SOL_TIME", "TIME"): (5_000_000.0, 25.1),
    }
    for (message, signal), (value, tolerance) in expected.items():
        assert frames[message][signal] == pytest.approx(value, abs=tolerance), (message, signal)


def test_every_epoch_has_the_next_alive_and_the_rate_is_kept() -> None:
    can = sink(rate_hz=50.0)
    epochs = []
    for tick in range(200):  # two seconds of a 100 Hz navigator
        sent = can.consume([out(solution(10_000_000_000 + tick * 10_000_000))])
        if sent:
            epochs.append(read(sent)["SOL_TIME"]["ALIVE"])
    assert len(epochs) == 100
    assert epochs == [place % 15 for place in range(100)]


@pytest.mark.parametrize("rate_hz", [1.0, 7.0, 30.0, 100.0])
def test_any_rate_is_kept_under_receive_jitter(rate_hz: float) -> None:
    can = sink(rate_hz=rate_hz)
    jitter = np.random.default_rng(1).integers(0, 2_000_000, 1000)
    epochs = 0
    for tick in range(1000):  # ten seconds
        epochs += bool(can.consume([out(solution(tick * 10_000_000), int(jitter[tick]))]))
    assert abs(epochs - 10.0 * rate_hz) <= 1.0 if rate_hz < 100.0 else epochs >= 820


def test_gps_time_when_a_receiver_tells_it() -> None:
    can = sink()
    gps_ns = (2300 * 604800 + 1234) * 1_000_000_000
    none = np.zeros(3)
    fix = GnssFix(
        4_000_000_000, 0.0, 0.0, 0.0, none, None, None, FixType.FIX_3D, "gnss", gps_ns=gps_ns, satellites=9
    )
    sent = can.consume([FixOut(4_000_000_000, "gnss", fix), out(solution(5_000_000_000))])
    time = read(sent)["SOL_TIME"]
    assert (time["TIME_BASE"], time["WEEK"]) == (1, 2300)
    assert time["TIME"] == pytest.approx(1235e6, abs=25.0)


def test_what_is_unknown_is_not_sent() -> None:
    frames = read(sink().consume([out(unknown())]))
    assert set(frames) == {"SOL_TIME", "SOL_HEADING", "SOL_SIGMA_ATT", "SOL_SIGMA_VEL"}
    assert frames["SOL_HEADING"]["FLAGS"] == 0
    assert frames["SOL_SIGMA_VEL"]["SIGMA_VE"] == pytest.approx(32.7675)
    assert frames["SOL_SIGMA_ATT"]["SIGMA_HEADING"] == pytest.approx(262.143)


def test_unknown_heading_clears_its_flag_but_other_frames_go_out() -> None:
    s = solution(flags=int(SolutionFlag.POSITION | SolutionFlag.HEADING))
    s.state[S.Q] = math.nan
    frames = read(sink().consume([out(s)]))
    assert frames["SOL_HEADING"]["FLAGS"] == SolutionFlag.POSITION
    assert "SOL_LEVEL" not in frames
    assert frames["SOL_LAT"]["LAT"] == pytest.approx(48.14, abs=1e-8)


@given(
    numbers=st.lists(
        st.just(math.nan) | st.floats(-1e50, 1e50) | st.floats(-10.0, 10.0),
        min_size=S.SIZE,
        max_size=S.SIZE,
    ),
    flags=st.integers(0, 0xFFFF),
    frame=st.sampled_from(["geographic", "grid", "transverse"]),
)
def test_no_solution_makes_the_sink_raise(numbers: list[float], flags: int, frame: str) -> None:
    sent = sink(polar=frame).consume([out(Solution(7_000_000_000, Mode.DEGRADED, flags, np.array(numbers)))])
    assert {"SOL_TIME", "SOL_HEADING"} <= set(read(sent))


def test_mode_is_visible_before_there_is_a_solution() -> None:
    can = sink()
    outputs: list[Output] = [
        ModeChange(1_000_000_000, "main", Mode.STANDBY, Mode.ALIGN, "started"),
        Health(2_000_000_000, {}, 0, 0, 0),
    ]
    frames = read(can.consume(outputs))
    assert frames["SOL_TIME"]["MODE"] == Mode.ALIGN
    assert frames["SOL_HEADING"]["FLAGS"] == 0


def test_rejects_and_losses_once_a_second() -> None:
    can = sink()
    first = DeviceHealth(missing=2, rejects={Reject.CRC: 4})
    second = DeviceHealth(missing=8191, rejects={Reject.CRC: 1})
    can.consume([Health(1_000_000_000, {"imu": first}, 3, 0, 0)])
    sent = can.consume([Health(2_000_000_000, {"imu": first, "gnss": second}, 10, 5, 6)])
    rejects = {}
    for frame in sent:
        message = DBC.get_message_by_frame_id(frame.key)
        values = message.decode(frame.data, decode_choices=False)
        if message.name == "SOL_REJECTS":
            rejects[Reject(values["REASON"])] = (values["TOTAL"], values["RECENT"])
        elif message.name == "SOL_HEALTH":
            assert (values["DROPPED"], values["UNRECORDED"], values["UNKNOWN"]) == (5, 6, 10)
            assert values["MISSING"] == 1  # 8193 modulo 8192
    assert set(rejects) == set(Reject)
    assert rejects[Reject.CRC] == (5, 1)
    assert rejects[Reject.UNKNOWN] == (10, 7)


def test_an_alignment_says_how_far_it_is_and_what_it_cannot_beat() -> None:
    made = sink()
    sigma, limit = (1e-3, 2e-3, 0.1), (math.radians(0.01), math.radians(0.02), math.radians(3.0))
    progress = Progress(7, "main", "alignment", 0.256, sigma, "gyrocompass", limit, True, 2)
    frame = read(made.consume([progress]))["SOL_ALIGN"]
    names = DBC.get_message_by_name("SOL_ALIGN").get_signal_by_name("METHOD").choices
    assert names[frame["METHOD"]] == "gyrocompass"
    assert (frame["ALIVE"], frame["BEHIND"], frame["REFUSALS"]) == (0, 1, 2)
    assert frame["PROGRESS"] == pytest.approx(25.6)
    assert frame["LIMIT_LEVEL"] == pytest.approx(0.02, abs=5.1e-5)
    assert frame["LIMIT_HEADING"] == pytest.approx(3.0, abs=5.1e-4)
    # what is not known or does not fit is "that or more"
    frame = read(made.consume([Progress(7, "main", "alignment", 1.5, restarts=99)]))["SOL_ALIGN"]
    assert (frame["METHOD"], frame["PROGRESS"], frame["REFUSALS"]) == (0, 100.0, 31)
    assert (frame["LIMIT_LEVEL"], frame["LIMIT_HEADING"]) == (pytest.approx(1.6383), 65.535)
    assert made.consume([Progress(7, "other", "alignment", 0.5)]) == []


def test_identifiers_shift_and_other_navigators_are_left_alone() -> None:
    sent = sink(id_offset=0x40).consume([out(solution())])
    assert sent[0].key == 0x240
    other = out(solution())
    assert sink().consume([type(other)("slave", other.solution, other.latest_rx_ns)]) == []


DEPENDING = ("SOL_HEADING", "SOL_VEL_H", "SOL_LAT", "SOL_LON", "SOL_SIGMA_VEL")


def test_every_message_that_depends_on_the_frame_names_it() -> None:
    # the sigma of a heading is that of a direction, whatever it is counted from
    depends = re.compile(r"HEADING|VEL_[EN]|LAT|LON|SIGMA_(N|E|VE|VN)")
    found = {
        message.name
        for message in DBC.messages
        if message.name.startswith("SOL_")
        and any(depends.fullmatch(signal.name) for signal in message.signals)
    }
    assert found == set(DEPENDING)
    for name in found:
        frame = DBC.get_message_by_name(name).get_signal_by_name("FRAME")
        assert {int(code): str(text) for code, text in frame.choices.items()} == {
            int(each): each.name.capitalize() for each in Frame
        }
    # angles are known to 1.1 mm on the ground, velocities to 0.1 mm/s
    for name, signal in (("SOL_LAT", "LAT"), ("SOL_LON", "LON")):
        step = DBC.get_message_by_name(name).get_signal_by_name(signal).scale
        assert math.radians(step) * earth.SEMI_MAJOR < 2e-3
    assert DBC.get_message_by_name("SOL_VEL_H").get_signal_by_name("VEL_E").scale == 1e-4


@pytest.mark.parametrize(("frame", "code"), [("grid", Frame.GRID), ("transverse", Frame.TRANSVERSE)])
def test_across_the_switch_the_flag_goes_with_the_values(frame: str, code: Frame) -> None:
    """North along a meridian and back: 83 to 85 deg, in and out again, with the same point and directions."""
    can = sink(polar=frame)
    lats = [*np.linspace(83.0, 85.0, 201), *np.linspace(85.0, 83.0, 201)]
    shown = []
    for k, lat_deg in enumerate(lats):
        s = solution(
            (k + 1) * 1_000_000_000,
            lat_deg=float(lat_deg),
            lon_deg=160.0,
            v=(200.0, 150.0, -1.0),
            heading_deg=50.0,
        )
        frames = read(can.consume([out(s)]))
        flags = {name: Frame(int(frames[name]["FRAME"])) for name in DEPENDING}
        now = flags["SOL_HEADING"]
        place = Frame.GEOGRAPHIC if now is Frame.GRID else now
        assert flags["SOL_VEL_H"] == flags["SOL_SIGMA_VEL"] == now
        assert flags["SOL_LAT"] == flags["SOL_LON"] == place
        shown.append(now)
        # what a reader makes of the frames alone
        lat, lon = math.radians(frames["SOL_LAT"]["LAT"]), math.radians(frames["SOL_LON"]["LON"])
        heading, zero = math.radians(frames["SOL_HEADING"]["HEADING"]), np.zeros(1)
        v = (frames["SOL_VEL_H"]["VEL_E"], frames["SOL_VEL_H"]["VEL_N"], frames["SOL_VEL_U"]["VEL_U"])
        at = View(place, np.array(lat), np.array(lon), zero, zero, zero)
        # half a raw step of 1.1 mm in either angle
        there = earth.ecef(s.lat, s.lon, s.height)
        assert np.linalg.norm(polar.position_e(at, s.height) - there) < 1e-3
        if now is Frame.GRID:
            at = at._replace(frame=now)
        C = polar.axes_e(at)
        C_eg = earth.position_matrix(s.lat, s.lon)
        assert np.abs(C @ np.array(v) - C_eg @ s.v_g).max() < 1e-4
        ahead = np.array([math.sin(heading), math.cos(heading), 0.0])
        true = np.array([math.sin(s.heading), math.cos(s.heading), 0.0])
        assert np.abs(C @ ahead - C_eg @ true).max() < 2e-7
    first, last = shown.index(code), len(shown) - 1 - shown[::-1].index(code)
    assert lats[first] == pytest.approx(84.0, abs=0.011)
    assert lats[last] == pytest.approx(83.5, abs=0.011)
    assert set(shown[first : last + 1]) == {code}
    assert set(shown[:first] + shown[last + 1 :]) == {Frame.GEOGRAPHIC}


def test_sigmas_follow_the_frame_of_their_message() -> None:
    # at 90 deg east grid north is true east, and transverse north is true south
    s = solution(lat_deg=88.0, lon_deg=90.0, sigma_p=(0.4, 0.8, 0.9))
    expected = {
        "geographic": (0.8, 0.4, 0.02, 0.03),
        "grid": (0.8, 0.4, 0.03, 0.02),
        "transverse": (0.8, 0.4, 0.02, 0.03),
    }
    for frame, (n, e, ve, vn) in expected.items():
        frames = read(sink(polar=frame).consume([out(s)]))
        assert frames["SOL_LAT"]["SIGMA_N"] == pytest.approx(n, abs=5.1e-3)
        assert frames["SOL_LON"]["SIGMA_E"] == pytest.approx(e, abs=5.1e-3)
        assert frames["SOL_SIGMA_VEL"]["SIGMA_VE"] == pytest.approx(ve, abs=2.6e-4)
        assert frames["SOL_SIGMA_VEL"]["SIGMA_VN"] == pytest.approx(vn, abs=2.6e-4)
    transverse = read(sink(polar="transverse").consume([out(solution(lat_deg=88.0, lon_deg=0.0))]))
    assert transverse["SOL_SIGMA_VEL"]["SIGMA_VE"] == pytest.approx(0.03, abs=2.6e-4)


def test_a_sigma_finer_than_the_signal_is_not_sent_as_none() -> None:
    frames = read(sink().consume([out(solution(sigma_p=(0.001, 0.0, 0.001)))]))
    assert frames["SOL_LON"]["SIGMA_E"] == pytest.approx(0.01)
    assert frames["SOL_LAT"]["SIGMA_N"] == 0.0


def test_at_the_pole_itself() -> None:
    for lon_deg in (-180.0, -7.0, 0.0, 90.0, 180.0):
        for lat_deg in (90.0, -90.0):
            for frame in ("geographic", "grid", "transverse"):
                frames = read(sink(polar=frame).consume([out(solution(lat_deg=lat_deg, lon_deg=lon_deg))]))
                assert set(frames) == set(EPOCH)


def test_limits_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(
        ValueError, match="polar_leave_deg: found 84, expected less than polar_enter_deg = 84"
    ):
        sink(polar="grid", polar_leave_deg=84.0)
