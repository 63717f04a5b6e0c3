"""The solution in somebody else's frames, read back with cantools and by our own driver."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cantools.database
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.config import Config
from bridge.drivers.dbc_map import DbcMap, DbcMapOptions
from bridge.errors import ConfigError
from bridge.frame import CAN_EFF, RawFrame
from bridge.outputs import FixOut, SolutionOut, Transmit
from bridge.sinks import SINKS, SinkContext
from bridge.sinks.dbc_map import QUANTITIES, DbcMapSink, DbcMapSinkOptions, Moment
from bridge.strict import convert, parse
from nav.types import FixType, GnssFix, S, SolutionFlag
from tests.drivers.made import context
from tests.sinks.made import out, solution, unknown

CLUSTER = """VERSION ""
NS_ :
BS_:
BU_: ECU

BO_ 2566869221 Pose: 8 ECU
 SG_ Latitude : 7|32@0- (1E-007,0) [-90|90] "deg" ECU
 SG_ Longitude : 39|32@0- (1E-007,0) [-180|180] "deg" ECU

BO_ 1300 Motion: 8 ECU
 SG_ Heading : 0|16@1+ (0.01,0) [0|359.99] "deg" ECU
 SG_ Turn : 16|16@1- (0.01,0) [-180|180] "deg" ECU
 SG_ SpeedKmh : 32|12@1+ (0.1,0) [0|0] "km/h" ECU
 SG_ Count : 44|4@1+ (1,0) [0|14] "" ECU
 SG_ Valid : 48|1@1+ (1,0) [0|1] "" ECU
 SG_ Sender : 49|3@1+ (1,0) [0|5] "" ECU
 SG_ Sigma : 56|8@1+ (0.1,0) [0|25] "m" ECU

BO_ 1301 Paged: 8 ECU
 SG_ Page M : 0|2@1+ (1,0) [0|3] "" ECU
 SG_ Ms m0 : 8|16@1+ (1,0) [0|59999] "ms" ECU
 SG_ Tow m1 : 8|30@1+ (1,0) [0|0] "ms" ECU
 SG_ Week m1 : 40|10@1+ (1,0) [0|0] "" ECU
 SG_ Filler m1 : 50|8@1+ (1,-40) [-40|215] "degC" ECU

BO_ 1302 Velocity: 8 ECU
 SG_ East : 0|32@1- (1,0) [0|0] "m/s" ECU
 SG_ Down : 32|16@1- (0.01,0) [-300|300] "m/s" ECU

SIG_VALTYPE_ 1302 East : 1;
"""
DB = cantools.database.load_string(CLUSTER, "dbc")
BASE = {"type": "dbc_map", "source": "can0", "navigator": "main", "dbc": "cluster.dbc"}
MESSAGES = """
[messages.Pose]
Latitude = "lat"
Longitude = "lon"
[messages.Motion]
Heading = "heading"
Turn = "heading"
SpeedKmh = "speed"
Count = "counter"
Valid = "position_valid"
Sender = { value = 5 }
Sigma = "sigma_north"
[messages.Velocity]
East = "vel_east"
Down = "-vel_up"
"""


def sink(text: str = MESSAGES, **more: Any) -> DbcMapSink:
    options = convert(
        {**BASE, **more, **parse(text.encode(), "t.toml")}, DbcMapSinkOptions, "t.toml", "sink.out"
    )
    made = SINKS["dbc_map"].factory(options, SinkContext("out", 2, files={"cluster.dbc": CLUSTER.encode()}))
    assert isinstance(made, DbcMapSink)
    return made


def read(frames: list[tuple[int, bytes]]) -> dict[str, dict[str, Any]]:
    decoded = {}
    for key, data in frames:
        message = DB.get_message_by_frame_id(key & 0x1FFF_FFFF)
        assert bool(key & CAN_EFF) == message.is_extended_frame
        decoded[message.name] = message.decode(data, decode_choices=False)
    return decoded


def test_a_solution_is_read_back_by_cantools() -> None:
    s = solution()
    got = read(sink().encode_solution(s))
    assert got["Pose"]["Latitude"] == pytest.approx(math.degrees(s.lat), abs=0.51e-7)
    assert got["Pose"]["Longitude"] == pytest.approx(math.degrees(s.lon), abs=0.51e-7)
    heading = math.degrees(s.heading)
    assert got["Motion"]["Heading"] == pytest.approx(heading, abs=0.0051)
    assert got["Motion"]["Turn"] == pytest.approx((heading + 180.0) % 360.0 - 180.0, abs=0.0051)
    assert got["Motion"]["SpeedKmh"] == pytest.approx(3.6 * math.hypot(s.v_g[0], s.v_g[1]), abs=0.051)
    assert got["Motion"]["Valid"] == bool(s.flags & SolutionFlag.POSITION)
    assert got["Motion"]["Sender"] == 5
    assert got["Motion"]["Sigma"] == pytest.approx(float(s.state[S.SIGMA_P][1]), abs=0.051)
    assert got["Velocity"]["East"] == np.float32(s.v_g[0])
    assert got["Velocity"]["Down"] == pytest.approx(-s.v_g[2], abs=0.0051)


SHARED = sink()


@settings(deadline=None)
@given(st.floats(0.0, 360.0, exclude_max=True))
def test_headings_wrap_as_the_signal_wants(degrees: float) -> None:
    s = solution()
    half = math.radians(-degrees) / 2.0
    s.state[S.Q] = [math.cos(half), 0.0, 0.0, math.sin(half)]
    motion = read(SHARED.encode_solution(s))["Motion"]
    error = (motion["Heading"] - degrees + 180.0) % 360.0 - 180.0
    assert abs(error) <= 0.00501
    assert 0.0 <= motion["Heading"] <= 359.99
    assert abs((motion["Turn"] - degrees + 180.0) % 360.0 - 180.0) <= 0.00501


def test_the_counter_counts_and_wraps_where_its_signal_does() -> None:
    made = sink()
    counts = [read(made.encode_solution(solution()))["Motion"]["Count"] for _ in range(32)]
    assert counts == [i % 15 for i in range(32)]


def test_what_is_unknown_or_does_not_fit_is_not_sent() -> None:
    assert sink().encode_solution(unknown()) == []
    s = solution()
    s.state[S.V.start + 2] = 400.0
    assert set(read(sink().encode_solution(s))) == {"Pose", "Motion"}
    s.state[S.SIGMA_P.start + 1] = 1e6  # a sigma saturates at the declared 25 m
    assert read(sink().encode_solution(s))["Motion"]["Sigma"] == pytest.approx(25.0)


def test_pages_of_a_multiplexed_message_and_times() -> None:
    page_0 = sink('[messages.Paged]\nPage = { value = 0 }\nMs = "time"\n')
    page_1 = sink('[messages.Paged]\nPage = { value = 1 }\nTow = "gps_time_of_week"\nWeek = "gps_week"\n')
    s = solution()
    assert read(page_0.encode_solution(s))["Paged"] == {"Page": 0, "Ms": s.t_ns // 1_000_000 % 60_000}
    assert page_1.encode_solution(s) == []  # nobody knows GPS time yet
    gps_ns = 2300 * 604_800 * 10**9 + 123_456_789 * 1_000_000
    one = np.ones(3)
    fix = GnssFix(s.t_ns, 0.8, 0.2, 0.0, one, None, None, FixType.FIX_3D, "gnss", gps_ns)
    page_1.consume([FixOut(s.t_ns, "gnss", fix)])
    # a signal that nobody maps is sent as raw 0: -40 degC
    assert read(page_1.encode_solution(s))["Paged"] == {
        "Page": 1,
        "Tow": 123_456_789,
        "Week": 2300 % 1024,
        "Filler": -40,
    }


def test_frames_go_out_at_the_rate_and_for_the_navigator_asked_for() -> None:
    made = sink(rate_hz=10.0)
    sent: list[Transmit] = []
    per_step = []
    for i in range(100):  # 100 Hz for one second
        new = made.consume([out(solution(5_000_000_000 + i * 10_000_000))])
        per_step.append(len(new))
        sent += new
    assert [i for i, n in enumerate(per_step) if n] == list(range(0, 100, 10))
    assert {frame.source for frame in sent} == {2}
    assert made.consume([]) == []
    other = SolutionOut("other", solution(9_000_000_000), 9_000_000_000)
    assert made.consume([other]) == []


def test_our_own_driver_reads_it_back() -> None:
    s = solution()
    mapping = """
    [speed]
    speed = "SpeedKmh"
    sigma = { value = 0.1, unit = "m/s" }
    counter = "Count"
    valid = { Valid = 1 }
    """
    table = {"driver": "dbc_map", "source": "can0", "dbc": "cluster.dbc", **parse(mapping.encode(), "t")}
    driver = DbcMap(convert(table, DbcMapOptions, "t"), context(files={"cluster.dbc": CLUSTER.encode()}))
    made = sink()
    speeds = []
    for i in range(20):
        for key, data in made.encode_solution(s):
            if (1, key) in driver.keys:
                speeds += driver.feed(RawFrame(0, i * 20_000_000, 1, key, data))
    assert len(speeds) == 20
    assert speeds[0].speed == pytest.approx(math.hypot(s.v_g[0], s.v_g[1]), abs=0.051 / 3.6)
    assert (driver.counters.missing, driver.counters.duplicates) == (0, 0)


@pytest.mark.parametrize(
    ("text", "key", "says"),
    [
        (MESSAGES.replace("Pose]", "Pos]"), "messages.Pos", 'found "Pos", expected'),
        (MESSAGES.replace("Latitude =", "Lat ="), "messages.Pose.Lat", 'found "Pose.Lat", expected'),
        (MESSAGES.replace('"lat"', '"latitude"'), "messages.Pose.Latitude", 'found "latitude", expected'),
        (
            MESSAGES.replace('"lat"', '"height"'),
            "messages.Pose.Latitude",
            'found "deg", expected a unit of length',
        ),
        (
            MESSAGES.replace('"lat"', '{ quantity = "lat", unit = "m" }'),
            "messages.Pose.Latitude",
            'found "m", expected a unit of angle',
        ),
        ("[messages]", "messages", "expected at least one table messages.NAME"),
        (MESSAGES.replace("value = 5", "value = 6"), "messages.Motion.Sender", "expected a value from"),
    ],
)
def test_mistakes_in_a_mapping_are_named(text: str, key: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        sink(text)
    assert str(caught.value).startswith(f"cluster.dbc: sink.out.{key}: ")
    assert says in str(caught.value)


def test_a_quantity_or_a_value() -> None:
    with pytest.raises(
        ConfigError, match=r"t.toml: sink.out.messages.Motion.Sender: .*both or none of quantity"
    ):
        sink(MESSAGES.replace("value = 5", "scale = 1.0"))


def test_every_quantity_is_a_finite_number_of_a_known_solution() -> None:
    s = solution()
    for name, quantity in QUANTITIES.items():
        assert math.isfinite(quantity.value(Moment(s, 3, 10**18))), name


def test_a_configuration_with_both_ways_travels_in_a_capture(tmp_path: Path) -> None:
    (tmp_path / "cluster.dbc").write_text(CLUSTER)
    (tmp_path / "both.toml").write_text(
        """
[source.can0]
type = "can"
interface = "virtual"
channel = "bench"
[device.log]
driver = "dbc_map"
source = "can0"
dbc = "cluster.dbc"
[device.log.speed]
speed = { signal = "SpeedKmh", scale = 0.5 }
sigma = { value = 0.1, unit = "m/s" }
valid = { Valid = 1, Sender = [4, 5] }
[navigator.main]
devices = ["log"]
[sink.cluster]
type = "dbc_map"
source = "can0"
navigator = "main"
dbc = "cluster.dbc"
[sink.cluster.messages.Pose]
Latitude = "lat"
Longitude = { quantity = "lon", unit = "deg" }
"""
    )
    config = Config.load(tmp_path / "both.toml")
    assert config.files == {"cluster.dbc": CLUSTER.encode()}
    again = Config.from_attachments(config.attachments())
    assert again.devices == config.devices
    assert again.sinks == config.sinks
    assert again.files == config.files
