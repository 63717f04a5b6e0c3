"""The codec against cantools, its contract, and the rules of the DBC file itself."""

from __future__ import annotations

import contextlib
import math
import re
import timeit
from pathlib import Path

import cantools.database
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dbc
from dbc.codec import Contract, MessageCodec, SignalInfo, contract, load, parse

DBC_FILE = Path(dbc.__file__).parent / "navbridge.dbc"
ORACLE = cantools.database.load_file(DBC_FILE)
NAMES = list(contract())


def raw_limits(signal: SignalInfo) -> tuple[int, int]:
    return (
        round((signal.minimum - signal.offset) / signal.factor),
        round((signal.maximum - signal.offset) / signal.factor),
    )


@st.composite
def frames(draw: st.DrawFn, codec: MessageCodec) -> tuple[int, dict[str, float]]:
    alive = draw(st.integers(0, codec.alive_modulus - 1))
    values = {}
    for signal in codec.info:
        raw = draw(st.integers(*raw_limits(signal)))
        values[signal.name] = raw * signal.factor + signal.offset
    return alive, values


@pytest.mark.parametrize("name", NAMES)
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_round_trip_and_oracle(name: str, data: st.DataObject) -> None:
    codec = contract()[name]
    alive, values = data.draw(frames(codec))
    frame = codec.encode(alive, *values.values())

    assert codec.crc_ok(frame)
    assert codec.alive(frame) == alive
    decoded = codec.decode(frame)
    assert decoded == tuple(values.values())  # the same raw number scaled by the same expression
    assert codec.in_range(decoded)

    theirs = ORACLE.decode_message(codec.frame_id, frame, decode_choices=False)
    crc = theirs.pop("CRC")
    assert theirs.pop("ALIVE") == alive
    assert theirs == values
    assert ORACLE.encode_message(name, {**theirs, "CRC": crc, "ALIVE": alive}) == frame


@pytest.mark.parametrize("name", NAMES)
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_any_bits_decode_as_the_oracle_does(name: str, data: st.DataObject) -> None:
    codec = contract()[name]
    frame = data.draw(st.binary(min_size=codec.length, max_size=codec.length))
    theirs = ORACLE.decode_message(codec.frame_id, frame, decode_choices=False)
    assert codec.decode(frame) == tuple(theirs[s] for s in codec.signals)
    inside = all(s.minimum <= theirs[s.name] <= s.maximum + 1e-9 * abs(s.maximum) for s in codec.info)
    assert codec.in_range(codec.decode(frame)) == inside


@settings(deadline=None)
@given(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0))
def test_a_value_between_steps_goes_to_the_nearest(lat: float, lon: float) -> None:
    c = contract()
    got_lat, _ = c["GNSS_LAT"].decode(c["GNSS_LAT"].encode(0, lat, 0.0))
    got_lon, _ = c["GNSS_LON"].decode(c["GNSS_LON"].encode(0, lon, 0.0))
    # half a step of 1e-9 deg, and the rounding of a float64 of this size (3e-14)
    assert abs(got_lat - lat) <= 0.5e-9 + 1e-13
    assert abs(got_lon - lon) <= 0.5e-9 + 1e-13


def test_integers_stay_integers() -> None:
    c = contract()
    values = c["IMU_TIME"].decode(c["IMU_TIME"].encode(4, 4, 255, -60, 2**32 - 1))
    assert values == (4, 255, -60, 2**32 - 1)
    assert all(type(v) is int for v in values)
    assert c["ODO"].decode(c["ODO"].encode(0, 1, 0, 1, 7, 6_553_500))[-1] == 6_553_500


@pytest.mark.parametrize("name", NAMES)
def test_one_step_outside_the_range_is_refused(name: str) -> None:
    codec = contract()[name]
    middle = [(s.minimum + s.maximum) / 2 for s in codec.info]
    for i, signal in enumerate(codec.info):
        low, high = raw_limits(signal)
        for raw in (low - 1, high + 1):
            values = [*middle[:i], raw * signal.factor + signal.offset, *middle[i + 1 :]]
            with pytest.raises(ValueError, match=rf"{name}\.{signal.name}: .* is outside"):
                codec.encode(0, *values)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_a_number_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match=r"GNSS_VEL\.VEL_N: .*not a finite number"):
        contract()["GNSS_VEL"].encode(0, 0.0, value, 0.0)


def test_wrong_use_is_refused() -> None:
    codec = contract()["GNSS_VEL"]
    with pytest.raises(ValueError, match="2 values for 3 signals"):
        codec.encode(0, 0.0, 0.0)
    with pytest.raises(ValueError, match="alive counter 15, expected 0 to 14"):
        codec.encode(15, 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="alive counter -1"):
        codec.encode(-1, 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="7 bytes, expected 8"):
        codec.decode(bytes(7))
    with pytest.raises(KeyError, match=r"no message 'GNSS'; the contract has IMU_GYRO"):
        contract()["GNSS"]


@pytest.mark.parametrize("name", NAMES)
def test_a_frame_of_wrong_length_has_no_good_crc(name: str) -> None:
    codec = contract()[name]
    frame = codec.encode(1, *(s.minimum for s in codec.info))
    assert codec.crc_ok(frame)
    for length in {*range(codec.length), codec.length + 1, 64}:
        assert not codec.crc_ok(frame[:length].ljust(length, b"\0"))


@pytest.mark.parametrize("name", NAMES)
def test_a_frame_taken_for_another_message_is_found(name: str) -> None:
    codec = contract()[name]
    frame = codec.encode(1, *(s.minimum for s in codec.info))
    takers = [n for n, c in contract().items() if c.crc_ok(frame)]
    assert takers == [name]


def test_the_contract_of_identifiers() -> None:
    c = contract()
    expected = {
        "IMU_GYRO": 0x100, "IMU_ACCEL": 0x101, "IMU_TIME": 0x102, "IMU_STATUS": 0x103, "IMU_LATCH": 0x104,
        "IMU_GYRO_2": 0x105, "IMU_ACCEL_2": 0x106,
        "IMU_FD": 0x110,
        "ODO": 0x120, "SPEED": 0x121, "BARO": 0x122,
        "TABLE_ANGLES": 0x128, "TABLE_INNER": 0x129,
        "GNSS_TIME": 0x130, "GNSS_LAT": 0x131, "GNSS_LON": 0x132, "GNSS_HEIGHT": 0x133, "GNSS_VEL": 0x134,
        "GNSS_ACC": 0x135, "MASTER_TIME": 0x140, "MASTER_LAT": 0x141, "MASTER_LON": 0x142,
        "MASTER_HEIGHT": 0x143, "MASTER_VEL_H": 0x144, "MASTER_VEL_U": 0x145, "MASTER_LEVEL": 0x146,
        "MASTER_HEADING": 0x147, "MASTER_RATE": 0x148, "MASTER_FORCE": 0x149,
        "COMMAND": 0x180, "COMMAND_ACK": 0x181,
        "SOL_TIME": 0x200, "SOL_LEVEL": 0x201, "SOL_HEADING": 0x202, "SOL_VEL_H": 0x203, "SOL_VEL_U": 0x204,
        "SOL_LAT": 0x205, "SOL_LON": 0x206, "SOL_HEIGHT": 0x207, "SOL_RATE": 0x208, "SOL_FORCE": 0x209,
        "SOL_SIGMA_ATT": 0x20A, "SOL_SIGMA_VEL": 0x20B, "SOL_REJECTS": 0x20C, "SOL_HEALTH": 0x20D,
        "SOL_ALIGN": 0x20E, "SOL_IMU_HEALTH": 0x20F,
        "SOL_TRANSFER": 0x210, "SOL_TRANSFER_OBS": 0x211,
    }  # fmt: skip
    assert {name: codec.frame_id for name, codec in c.items()} == expected
    assert len(c) == len(expected)
    assert {codec.frame_id: codec for codec in c.values()} == dict(c.by_id)
    assert [n for n, codec in c.items() if codec.is_fd] == ["IMU_FD"]
    assert len({codec.data_id for codec in c.values()}) == len(c)


def test_the_file_explains_itself() -> None:
    for message in ORACLE.messages:
        assert message.comment, message.name
        assert message.senders, message.name
        for signal in message.signals:
            assert signal.comment, (message.name, signal.name)
            assert signal.receivers, (message.name, signal.name)
    assert ORACLE.get_message_by_name("GNSS_HEIGHT").get_signal_by_name("FIX_TYPE").choices[6] == "RTK fixed"
    assert ORACLE.get_message_by_name("IMU_GYRO").cycle_time == 5


def test_a_contract_is_stricter_than_dbc(tmp_path: Path) -> None:
    text = DBC_FILE.read_text(encoding="cp1252")

    def refused(change: str, to: str, reason: str) -> None:
        assert change in text
        path = tmp_path / "changed.dbc"
        path.write_text(text.replace(change, to), encoding="cp1252")
        with pytest.raises(ValueError, match=re.escape(str(path)) + ".*" + reason):
            load(path)

    refused('BA_ "E2EProfile" BO_ 288 1;', 'BA_ "E2EProfile" BO_ 288 0;', "ODO: E2EProfile NONE")
    header = ' SG_ ALIVE : 8|4@1+ (1,0) [0|14] "" BRIDGE\n SG_ DIRECTION'
    refused(header, header.replace("ALIVE", "COUNTER"), "ODO: signal ALIVE is at None")
    refused("SG_ TICKS : 16|32@1+", "SG_ TICKS : 23|32@0+", "ODO.TICKS is not a plain little-endian")
    refused("BO_ 288 ODO: 8", "BO_ 288 ODO: x", "")


def test_a_file_that_is_not_there_says_so(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.dbc")


def test_the_packaged_contract_is_the_file() -> None:
    assert isinstance(contract(), Contract)
    assert contract() is contract()
    assert contract().text == DBC_FILE.read_bytes()


def test_check_and_decode_are_faster_than_the_parser_alone() -> None:
    # A ratio within one run, so that the machine drops out; 3.3 when measured.
    codec = contract()["IMU_GYRO"]
    message = ORACLE.get_message_by_name("IMU_GYRO")
    frame = codec.encode(3, 0, 0, 0, 1, -2, 3)
    ours = min(timeit.repeat(lambda: (codec.crc_ok(frame), codec.decode(frame)), number=1000, repeat=9))
    theirs = min(timeit.repeat(lambda: message.decode(frame, decode_choices=False), number=1000, repeat=9))
    assert ours < theirs


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_file_is_a_contract_or_a_value_error(data: st.DataObject) -> None:
    text = bytearray(contract().text)
    begin = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(begin, min(len(text), begin + 200)))
    text[begin:end] = data.draw(st.binary(max_size=20))
    with contextlib.suppress(ValueError):
        assert isinstance(parse(bytes(text), "some.dbc"), Contract)


def test_an_error_names_the_file() -> None:
    with pytest.raises(ValueError, match=r"^some\.dbc: it holds no CAN messages"):
        parse(b'VERSION ""\n', "some.dbc")
