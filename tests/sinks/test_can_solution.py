"""The solution on CAN, read back with cantools as any CAN tool would."""

from __future__ import annotations

import math
from importlib.resources import files
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.outputs import DeviceHealth, FixOut, Health, ModeChange, Output, Reject, Transmit
from bridge.sinks import SINKS, SinkContext
from bridge.sinks.can_solution import EPOCH, CanSolution, CanSolutionOptions
from dbc.codec import contract
from nav.types import FixType, GnssFix, Mode, S, Solution, SolutionFlag
from tests.sinks.made import out, solution, unknown

DBC: Any = cantools.database.load_string((files("dbc") / "navbridge.dbc").read_text("cp1252"), "dbc")


def sink(rate_hz: float = 50.0, id_offset: int = 0) -> CanSolution:
    options = CanSolutionOptions(
        type="can_solution", navigator="main", source="can0", rate_hz=rate_hz, id_offset=id_offset
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
        ("SOL_LAT", "SIGMA_N"): (0.5, 2.6e-3),
        ("SOL_LON", "LON"): (11.58, 5.1e-9),
        ("SOL_LON", "SIGMA_E"): (0.4, 2.6e-3),
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
    assert frames["SOL_SIGMA_VEL"]["SIGMA_VE"] == pytest.approx(65.5355)
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
)
def test_no_solution_makes_the_sink_raise(numbers: list[float], flags: int) -> None:
    sent = sink().consume([out(Solution(7_000_000_000, Mode.DEGRADED, flags, np.array(numbers)))])
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


def test_identifiers_shift_and_other_navigators_are_left_alone() -> None:
    sent = sink(id_offset=0x40).consume([out(solution())])
    assert sent[0].key == 0x240
    other = out(solution())
    assert sink().consume([type(other)("slave", other.solution, other.latest_rx_ns)]) == []
