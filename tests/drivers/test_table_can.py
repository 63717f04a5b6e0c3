"""Frames of a turntable's encoders, and what is wrong with some of them."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.drivers.base import Context
from bridge.drivers.device_clock import DeviceClock
from bridge.drivers.table_can import TableCan, TableCanOptions
from bridge.frame import RawFrame
from bridge.outputs import Reject
from dbc.codec import contract

ANGLES, INNER = contract()["TABLE_ANGLES"], contract()["TABLE_INNER"]
START_NS = 5_000_000_000


def driver(**options: int) -> TableCan:
    table = TableCanOptions(driver="table_can", source="can0", **options)
    return TableCan(table, Context("table", 1, "test.toml", {}, DeviceClock()))


def pair(k: int, angles=(10.0, 20.0, 30.0), valid: int = 1, offset: int = 0, us: int | None = None):
    """Both frames of reading number ``k``, 20 ms apart."""
    rx_ns = START_NS + 20_000_000 * k
    outer, middle, inner = angles
    time_us = (134_210_000 + 20_000 * k) % (1 << 27) if us is None else us
    alive = k % 15
    return (
        RawFrame(2 * k, rx_ns, 1, ANGLES.frame_id + offset, ANGLES.encode(alive, valid, outer, middle)),
        RawFrame(2 * k + 1, rx_ns, 1, INNER.frame_id + offset, INNER.encode(alive, inner, time_us)),
    )


def feed(table: TableCan, *frames: RawFrame):
    return [sample for frame in frames for sample in table.feed(frame)]


def test_two_frames_are_a_sample_and_its_time_goes_on_when_it_wraps() -> None:
    table = driver(id_offset=0x40)
    made = feed(
        table, *(frame for k in range(4) for frame in pair(k, (0.00002, 359.99998, 90.0), offset=0x40))
    )
    assert [one.t_ns for one in made] == [START_NS + 20_000_000 * k for k in range(4)]
    # the steps of the bus are 0.072 arcsec
    np.testing.assert_allclose(np.degrees(made[0].angles), [0.00002, 359.99998, 90.0], rtol=0, atol=1e-9)
    assert made[0].device == "table"
    assert table.counters.samples == 4


@pytest.mark.parametrize(
    ("frames", "reason", "left"),
    [
        ([pair(0)[0], pair(1)[1]], Reject.INCOMPLETE, 0),
        ([*pair(0), *pair(1, valid=0)], Reject.INVALID, 1),
        ([*pair(0), *pair(1, us=134_210_000)], Reject.STALE, 1),
        ([*pair(0), pair(1)[0], pair(1)[1]._replace(data=bytes(8))], Reject.CRC, 1),
        ([pair(0)[0]._replace(data=b"123"), pair(0)[1]], Reject.LENGTH, 0),
        ([*pair(0), *pair(15, (11.0, 20.0, 30.0))], Reject.COUNTER, 1),
    ],
    ids=["halves", "invalid", "old", "damaged", "short", "stuck"],
)
def test_bad_frames_are_counted(frames: list[RawFrame], reason: Reject, left: int) -> None:
    table = driver()
    assert len(feed(table, *frames)) == left
    assert table.counters.rejects[reason] >= 1


def test_what_is_sent_twice_is_taken_once_and_what_is_lost_is_counted() -> None:
    table = driver()
    made = feed(table, *pair(0), *pair(0), *pair(3))
    assert len(made) == 2
    assert table.counters.duplicates == 2
    assert table.counters.missing == 2
