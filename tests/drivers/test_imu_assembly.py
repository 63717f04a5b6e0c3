"""The kernel for usual inertial samples against the codec, and the driver with it against frame by frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.drivers.imu_assembly import FRAME_BYTES, IRREGULAR, assemble, layout
from bridge.drivers.imu_can import ImuCan
from bridge.frame import RawFrame
from dbc.codec import contract, parse
from nav.imu.pulses import Calibration, compensate_readable
from nav.types import ImuSample
from tests.drivers.made import flipped
from tests.drivers.test_imu_can import driver, three

CODECS = [contract()[name] for name in ("IMU_GYRO", "IMU_ACCEL", "IMU_TIME")]
CALIBRATION = Calibration(
    gyro_scale_plus=np.array([1e-6, 2e-6, 3e-6]),
    accel_scale_plus=np.array([1e-4, 2e-4, 3e-4]),
    gyro_scale_minus=np.array([1.1e-6, 2.1e-6, 3.1e-6]),
    accel_scale_minus=np.array([1.1e-4, 2.1e-4, 3.1e-4]),
    gyro_bias=np.array([1e-6, -2e-6, 3e-6]),
    accel_bias=np.array([1e-3, 2e-3, -3e-3]),
    gyro_g=np.arange(9.0).reshape(3, 3) * 1e-8,
    gyro_axes=np.eye(3) + np.arange(9.0).reshape(3, 3) * 1e-4,
    accel_axes=np.eye(3) - np.arange(9.0).reshape(3, 3) * 1e-4,
)


def assembled(
    payloads: bytes, before_us: int = 0
) -> tuple[tuple[int, int, int, int, int, float], np.ndarray, np.ndarray, np.ndarray]:
    places = layout(CODECS)
    assert places is not None
    counts, dtheta, dv = np.zeros(6), np.zeros(3), np.zeros(3)
    wire = np.frombuffer(payloads, dtype=np.uint8).copy()
    head = assemble(wire, places, CALIBRATION.table(), before_us, counts, dtheta, dv)
    return head, counts, dtheta, dv


counts16 = st.lists(st.integers(-(2**15), 2**15 - 1), min_size=3, max_size=3)
flags3 = st.lists(st.integers(0, 1), min_size=3, max_size=3)


@given(
    st.integers(0, 14),
    flags3,
    counts16,
    flags3,
    counts16,
    st.integers(0, 15),
    st.integers(0, 255),
    st.integers(0, 2**32 - 1),
    st.integers(1000, 10**6),
)
@settings(max_examples=200, deadline=None)
def test_the_kernel_reads_what_the_codec_wrote(
    alive: int,
    sat_g: list[int],
    gyro: list[int],
    sat_a: list[int],
    accel: list[int],
    status: int,
    sample: int,
    time_us: int,
    interval_us: int,
) -> None:
    payloads = (
        CODECS[0].encode(alive, *sat_g, *gyro)
        + CODECS[1].encode(alive, *sat_a, *accel)
        + CODECS[2].encode(alive, status, sample, 25, time_us)
    )
    head, counts, dtheta, dv = assembled(payloads, (time_us - interval_us) % 2**32)
    tau = interval_us * 1000 * 1e-9
    assert head == (alive, any((*sat_g, *sat_a)), status, sample, time_us, tau)
    assert counts.tolist() == [*gyro, *accel]
    expected = compensate_readable(CALIBRATION, np.array(gyro, float), np.array(accel, float), tau)
    # a few roundings of the largest term, 32768 pulses of 3e-6 rad or 3e-4 m/s
    np.testing.assert_allclose(dtheta, expected[0], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(dv, expected[1], rtol=0.0, atol=1e-13)


def test_the_kernel_leaves_what_is_not_usual() -> None:
    good = [frame.data for frame in three(7)]
    assert assembled(b"".join(good))[0][0] == 7
    for bit in range(8 * 3 * FRAME_BYTES):
        spoilt = bytearray(b"".join(good))
        spoilt[bit // 8] ^= 1 << bit % 8
        head, counts, dtheta, _ = assembled(bytes(spoilt))
        assert head[0] == IRREGULAR
        assert not counts.any()
        assert not dtheta.any()
    for place in range(3):  # each alone is good, but of another sample
        other = [*good]
        other[place] = three(8)[place].data
        assert assembled(b"".join(other))[0][0] == IRREGULAR


def test_a_contract_that_the_kernel_is_not_made_for_goes_frame_by_frame() -> None:
    text = contract().text.replace(b" SG_ GYRO_X : 16|16@1- (1,0)", b" SG_ GYRO_X : 16|16@1- (2,0)")
    other = parse(text, "other.dbc")
    assert layout([other[codec.name] for codec in CODECS]) is None
    assert layout([contract()[name] for name in ("IMU_FD",) * 3]) is None
    imu = driver(messages=other)
    plain = driver()
    for frame in (f for k in range(5) for f in three(k)):
        ours, theirs = imu.feed(frame), plain.feed(frame)
        assert [s.dtheta[0] for s in ours] == [2.0 * s.dtheta[0] for s in theirs]


def bits(sample: ImuSample) -> tuple[object, ...]:
    return (*sample[:2], sample.dtheta.tobytes(), sample.dv.tobytes(), *sample[4:])


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_the_driver_is_the_same_frame_by_frame(data: st.DataObject) -> None:
    """Who asks for the counters has every frame looked at by itself: samples and counts must not differ."""
    frames: list[RawFrame] = [
        f for k in range(data.draw(st.integers(1, 40))) for f in three(k, gyro=3 * k - 50, sat=k == 11)
    ]
    for _ in range(data.draw(st.integers(0, 12))):
        place = data.draw(st.integers(0, len(frames) - 1))
        what = data.draw(st.integers(0, 5))
        if what == 0 and len(frames) > 1:
            del frames[place]
        elif what == 1:
            frames.insert(place, frames[place])
        elif what == 2:
            frames[place] = frames[place]._replace(data=data.draw(st.binary(max_size=10)))
        elif what == 3:
            other = data.draw(st.integers(0, len(frames) - 1))
            frames[place], frames[other] = frames[other], frames[place]
        elif what == 4:
            frames[place] = flipped(frames[place]) if frames[place].data else frames[place]
        else:
            frames[place] = frames[place]._replace(rx_ns=data.draw(st.integers(0, 2**62)))
    together, single = driver(), driver()
    for frame in frames:
        ours = together.feed(frame)
        theirs = single.feed(frame)
        counted(single)
        assert [bits(s) for s in ours] == [bits(s) for s in theirs]
    assert counted(together) == counted(single)


def counted(imu: ImuCan) -> tuple[object, ...]:
    c = imu.counters
    return c.frames, c.samples, c.missing, c.bridged, c.duplicates, tuple(c.rejects), c.last_ns


@pytest.mark.parametrize("kept", [1, 2])
def test_frames_kept_back_are_in_the_counts(kept: int) -> None:
    imu = driver()
    for frame in three(0)[:kept]:
        imu.feed(flipped(frame))
    assert sum(imu.counters.rejects) == kept
