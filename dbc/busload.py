"""How long frames are on the wire and how much of a bus a set of them takes.

Classic frames: Davis, Burns, Bril and Lukkien 2007, "Controller Area Network (CAN) schedulability
analysis: refuted, revisited and revised", eq. (1): the longest frame of s data bytes has
g + 8 s + 13 + floor((g + 8 s - 1) / 4) bits, g = 34 (11-bit identifier) or 54 (29-bit) being the
bits exposed to stuffing besides the data, 13 those that are not (with the 3 bits between frames).

CAN FD frames: ISO 11898-1:2015, 10.4 and 10.5: stuffing ends with the data field; the CRC field is
the 4-bit stuff count and a CRC of 17 bits (up to 16 data bytes) or 21, with a fixed stuff bit in
front and after every fourth bit. From the bit after BRS to the CRC delimiter it runs at the data
bit rate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from dbc.codec import MessageCodec, contract

FD_LENGTHS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Data lengths that a CAN FD frame can have, bytes."""

IMU_CLASSIC: Final = ("IMU_GYRO", "IMU_ACCEL", "IMU_TIME")
IMU_MORE: Final = ("IMU_LATCH", "IMU_GYRO_2", "IMU_ACCEL_2")
"""What some units send with every sample besides."""
IMU_FD: Final = ("IMU_FD",)

_CLASSIC_TAIL: Final = 13  # CRC delimiter, ACK and its delimiter, 7 end of frame, 3 between frames
_FD_TAIL: Final = 12  # as above, the CRC delimiter being at the data bit rate
_FD_HEAD: Final = 17  # start, 11 identifier, RRS, IDE, FDF, res, BRS
_FD_HEAD_EXTENDED: Final = 36  # start, 11, SRR, IDE, 18, RRS, FDF, res, BRS
_FD_CONTROL: Final = 5  # ESI, DLC


class FrameBits(NamedTuple):
    """Bits of one frame at the arbitration bit rate and at the data bit rate, gap between frames included."""

    arbitration: int
    data: int

    def seconds(self, bitrate: float, data_bitrate: float) -> float:
        """Time on the wire, s; the bit rates are in bit/s."""
        return self.arbitration / bitrate + self.data / data_bitrate


def classic_bits(length: int, *, extended: bool = False, stuffed: bool) -> FrameBits:
    """Return the length of a classic frame of ``length`` bytes, ``stuffed`` as badly as can be or not at all.

    Raises ValueError when no such frame exists.
    """
    if not 0 <= length <= 8:
        raise ValueError(f"a classic CAN frame has 0 to 8 bytes, not {length}")
    exposed = (54 if extended else 34) + 8 * length
    return FrameBits(exposed + _CLASSIC_TAIL + (_most_stuff_bits(exposed) if stuffed else 0), 0)


def fd_bits(length: int, *, extended: bool = False, stuffed: bool) -> FrameBits:
    """Return the length of a CAN FD frame with bit rate switch of ``length`` bytes, ``stuffed`` as
    badly as can be or not at all (the fixed stuff bits are always there).

    Raises ValueError when no such frame exists.
    """
    if length not in FD_LENGTHS:
        raise ValueError(f"a CAN FD frame has one of {', '.join(map(str, FD_LENGTHS))} bytes, not {length}")
    head = _FD_HEAD_EXTENDED if extended else _FD_HEAD
    body = _FD_CONTROL + 8 * length
    crc_field = 4 + (17 if length <= 16 else 21)
    fixed = 1 + crc_field // 4
    # Where stuff bits may fall in either part the slower part is charged first.
    in_head = _most_stuff_bits(head) if stuffed else 0
    in_body = _most_stuff_bits(head + body) - in_head if stuffed else 0
    return FrameBits(head + in_head + _FD_TAIL, body + in_body + crc_field + fixed + 1)


def _most_stuff_bits(exposed: int) -> int:
    """The first stuff bit takes five equal bits, each further one four: a stuff bit begins the next run."""
    return (exposed - 1) // 4


class Stream(NamedTuple):
    """A message sent at a rate; ``is_fd`` with bit rate switch."""

    name: str
    frame_id: int
    length: int
    is_fd: bool
    rate_hz: float


class Row(NamedTuple):
    """One message of a load table: bits of a frame and share of the bus, without and with worst stuffing."""

    name: str
    frame_id: int
    length: int
    rate_hz: float
    bits_plain: int
    bits_worst: int
    load_plain: float
    load_worst: float


class BusLoad(NamedTuple):
    """A set of streams on one bus; the loads are shares, 1.0 being a full bus."""

    title: str
    bitrate: int
    data_bitrate: int
    rows: tuple[Row, ...]
    load_plain: float
    load_worst: float


def bus_load(
    title: str, streams: Iterable[Stream], bitrate: int = 1_000_000, data_bitrate: int | None = None
) -> BusLoad:
    """Return the load of ``streams`` on a bus of ``bitrate`` bit/s (FD data phase: ``data_bitrate``)."""
    fast = data_bitrate or bitrate
    rows = []
    for stream in streams:
        measure = fd_bits if stream.is_fd else classic_bits
        extended = stream.frame_id > 0x7FF
        plain = measure(stream.length, extended=extended, stuffed=False)
        worst = measure(stream.length, extended=extended, stuffed=True)
        rows.append(
            Row(
                stream.name,
                stream.frame_id,
                stream.length,
                stream.rate_hz,
                sum(plain),
                sum(worst),
                stream.rate_hz * plain.seconds(bitrate, fast),
                stream.rate_hz * worst.seconds(bitrate, fast),
            )
        )
    return BusLoad(
        title, bitrate, fast, tuple(rows), sum(r.load_plain for r in rows), sum(r.load_worst for r in rows)
    )


def stream(codec: MessageCodec, frame_id: int, imu_rate_hz: float, solution_rate_hz: float) -> Stream:
    """A message at its rate: those of a sample of the IMU, those of an epoch of the solution at these, others
    by their cycle time. ``frame_id`` is that on the bus.

    Raises ValueError for a message that is sent on request.
    """
    name, every = codec.name, codec.cycle_ms
    if name in IMU_CLASSIC + IMU_MORE + IMU_FD:
        rate = imu_rate_hz
    elif every is None:
        raise ValueError(f"{name} has no cycle time")
    elif name == "SOL_REJECTS":  # one frame for each reason
        rate = 1e3 / every * (_maximum(codec, "REASON") + 1)
    elif name.startswith("SOL_") and every == contract()["SOL_TIME"].cycle_ms:
        rate = solution_rate_hz
    else:
        rate = 1e3 / every
    return Stream(name, frame_id, codec.length, codec.is_fd, rate)


def default_streams(imu_rate_hz: float, solution_rate_hz: float = 50.0, *, fd: bool = False) -> list[Stream]:
    """Return every cyclic message of the contract at its rate: the IMU (``fd``: as CAN FD) at
    ``imu_rate_hz``, the solution at ``solution_rate_hz``, the others by their cycle time.
    """
    left_out = IMU_CLASSIC if fd else IMU_FD
    return [
        stream(codec, codec.frame_id, imu_rate_hz, solution_rate_hz)
        for name, codec in contract().items()
        if codec.cycle_ms is not None and name not in left_out
    ]


def _maximum(codec: MessageCodec, signal: str) -> float:
    return next(s.maximum for s in codec.info if s.name == signal)


def default_table(
    imu_rates_hz: Sequence[float] = (200.0, 1000.0),
    solution_rate_hz: float = 50.0,
    bitrate: int = 1_000_000,
    data_bitrate: int | None = None,
    *,
    fd: bool = False,
) -> list[BusLoad]:
    """Return the load of the default set for each IMU rate, the solution being published at
    ``solution_rate_hz``; with ``fd`` the IMU sends its CAN FD frame.
    """
    kind = "CAN FD" if fd else "classic"
    return [
        bus_load(
            f"IMU {rate:g} Hz ({kind}), solution {solution_rate_hz:g} Hz",
            default_streams(rate, solution_rate_hz, fd=fd),
            bitrate,
            data_bitrate,
        )
        for rate in imu_rates_hz
    ]


def as_document(load: BusLoad) -> Mapping[str, object]:
    """Return a load as plain tables for JSON."""
    return {**load._asdict(), "rows": [row._asdict() for row in load.rows]}
