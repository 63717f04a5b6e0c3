"""The store of an alignment, and a stage that goes over it several times while samples keep coming."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav.align import AlignConfig, Alignment, AlignStatus, NavInit, advance, begin, result
from nav.align.store import BLOCK, F, Store, Sweep, is_behind, is_lost, portion
from nav.align.types import Stage
from nav.types import BaroSample, FixType, GnssFix, ImuSample, OdoSample, SpeedSample

DT_NS = 1_000_000
CONFIG = AlignConfig(gyro_bias=1e-7, accel_bias=1e-3, angle_random_walk=1e-6, velocity_random_walk=1e-4)


def imu(k):
    value = np.array([k, k + 0.25, k + 0.5])
    return ImuSample(k * DT_NS, 1e-3, value, -value, "imu")


def fix(t_ns, *, velocity=True):
    v = np.array([4.0, 5.0, 6.0])
    return GnssFix(
        t_ns,
        0.8,
        0.1,
        300.0,
        np.array([1.0, 2.0, 3.0]),
        v if velocity else None,
        0.1 * v if velocity else None,
        FixType.FIX_3D,
        "gnss",
    )


def test_samples_come_back_as_they_went_in():
    store = Store(900.0)
    for k in range(BLOCK + 10):
        store.add(imu(k))
    store.add(OdoSample(5, 0.02, 0.3, False, "odo"))
    store.add(SpeedSample(6, 12.0, 0.1, "speed"))
    store.add(fix(7))
    store.add(fix(8, velocity=False))
    store.add(BaroSample(9, 100.0, 1.0, "baro"))
    piece = store.imu.ahead(3, 4)
    np.testing.assert_array_equal(piece.t_ns, np.arange(3, 7) * DT_NS)
    np.testing.assert_array_equal(piece.dt, 1e-3)
    np.testing.assert_array_equal(piece.rows[:, 1], np.arange(3, 7) + 0.25)
    np.testing.assert_array_equal(piece.rows[:, 3], -np.arange(3.0, 7.0))
    assert piece.rows.flags.c_contiguous
    # a portion ends at the border of a block, and at the ends of the track
    assert len(store.imu.ahead(BLOCK - 3, 64).t_ns) == 3
    assert len(store.imu.back(BLOCK + 3, 64).t_ns) == 3
    assert len(store.imu.back(2, 64).t_ns) == 2
    assert len(store.imu.ahead(BLOCK + 8, 64).t_ns) == 2
    assert len(store.imu.ahead(BLOCK + 10, 64).t_ns) == len(store.imu.back(0, 64).t_ns) == 0
    np.testing.assert_array_equal(store.odometer.ahead(0, 9).rows, [[0.3]])
    np.testing.assert_array_equal(store.speed.ahead(0, 9).rows, [[12.0, 0.1]])
    rows = store.gnss.ahead(0, 9).rows
    np.testing.assert_array_equal(rows[0, F.POSITION], [0.8, 0.1, 300.0])
    np.testing.assert_array_equal(rows[:, F.SIGMA_POSITION], [[1.0, 2.0, 3.0]] * 2)
    np.testing.assert_array_equal(rows[0, F.VELOCITY], [4.0, 5.0, 6.0])
    assert np.isnan(rows[1, F.VELOCITY]).all()
    assert np.isnan(rows[1, F.SIGMA_VELOCITY]).all()
    assert store.imu.number(-1) == 0
    assert store.imu.number(BLOCK * DT_NS) == BLOCK + 1
    assert store.imu.number((BLOCK + 1) * DT_NS - 1) == BLOCK + 1
    assert store.imu.number(10**12) == BLOCK + 10


def test_aids_that_are_not_later_are_left_out():
    store = Store(900.0)
    for t in (5, 5, 4, 6):
        store.add(OdoSample(t, 0.02, float(t), False, "odo"))
        store.add(SpeedSample(t, 1.0, 0.1, "speed"))
        store.add(fix(t))
    for track in (store.odometer, store.speed, store.gnss):
        np.testing.assert_array_equal(track.ahead(0, 9).t_ns, [5, 6])


def test_memory_is_bounded_and_numbers_stay():
    seconds = 10.0
    store = Store(seconds)
    for k in range(8 * BLOCK):
        store.add(imu(k))
        if k % 2 == 0:
            store.add(OdoSample(k * DT_NS, 2e-3, 0.1, False, "odo"))
        assert len(store.imu) <= seconds * 1e3 + 2 * BLOCK
        assert len(store.odometer) <= 0.5 * seconds * 1e3 + 2 * BLOCK
    assert store.imu.count == 8 * BLOCK
    assert store.imu.first > 0
    first = store.imu.first
    # everything of the last ten seconds is there
    assert first * DT_NS <= (8 * BLOCK - 1) * DT_NS - seconds * 1e9
    assert store.imu.ahead(first, 1).rows[0, 0] == first
    with pytest.raises(IndexError):
        store.imu.ahead(first - 1, 1)
    assert is_lost(store.imu, Sweep(first + 5, first - 1, first + 10, 1))
    assert not is_lost(store.imu, Sweep(first + 5, first - 1, first + 10, 0))
    assert is_lost(store.imu, Sweep(first - 1, 0, 0, 0))


@cache
def full_store():
    store = Store(900.0)
    for k in range(2 * BLOCK + 50):
        store.add(imu(k))
    return store


@settings(max_examples=60, deadline=None)
@given(
    low=st.integers(0, BLOCK),
    high=st.integers(BLOCK + 6, 2 * BLOCK + 50),
    most=st.integers(7, 500),
    turns=st.integers(0, 2),
    ahead=st.booleans(),
    multiple=st.integers(1, 6),
)
def test_a_sweep_passes_every_sample_in_turn_and_ends_at_the_present(low, high, most, turns, ahead, multiple):
    store = full_store()
    low, high = low - low % multiple, high - high % multiple
    sweep, seen = Sweep(low if ahead else high, low, high, turns, ahead), []
    while is_behind(store.imu, sweep, multiple):
        piece, went_ahead, sweep = portion(store.imu, sweep, most, multiple)
        assert 0 < len(piece.t_ns) <= most
        assert len(piece.t_ns) % multiple == 0
        passed = (piece.t_ns // DT_NS).tolist()
        seen += passed if went_ahead else passed[::-1]
    once = list(range(low, high))
    assert seen == (
        ([] if ahead else once[::-1])
        + turns * (once + once[::-1])
        + list(range(low, store.imu.count - store.imu.count % multiple))
    )


class Passes(NamedTuple):
    """A made-up stage: the mean rate after TURNS turns back, summed up on the way in every direction."""

    config: AlignConfig
    store: Store
    sweep: Sweep | None
    total: np.ndarray
    worked: int = 0


COLLECT, TURNS = 500, 2


def init(config: AlignConfig, given_: NavInit | None) -> Passes:
    return Passes(config, Store(config.store_s), None, np.zeros(3))


def step(state: Passes, sample) -> tuple[Passes, AlignStatus]:
    config, store, sweep, total, _ = state
    store.add(sample)
    worked = 0
    if sweep is None and store.imu.count == COLLECT:
        sweep = Sweep(0, 0, COLLECT, TURNS)
    behind = False
    if sweep is not None:
        piece, ahead, sweep = portion(store.imu, sweep, config.replay_samples)
        total = total + (1.0 if ahead else -1.0) * piece.rows[:, 0:3].sum(axis=0)
        worked = len(piece.t_ns)
        behind = is_behind(store.imu, sweep)
    progress = min(1.0, 0.5 * store.imu.count / COLLECT)
    done = sweep is not None and not behind
    status = AlignStatus(None, np.eye(3), np.zeros(3), progress, done, behind=behind)
    return Passes(config, store, sweep, total, worked), status


def finish(state: Passes) -> NavInit:
    zero = np.zeros(3)
    return NavInit(
        t_ns=state.store.imu.last_ns,
        lat=0.0,
        lon=0.0,
        height=0.0,
        v_g=state.total,
        q_gb=np.array([1.0, 0.0, 0.0, 0.0]),
        P_phi=np.eye(3),
        sigma_v=zero,
        sigma_p=zero,
        gyro_bias=zero,
        accel_bias=zero,
        sigma_gyro_bias=zero,
        sigma_accel_bias=zero,
    )


def test_a_stage_of_several_passes_ends_at_the_last_sample_with_bounded_work():
    config = CONFIG
    run = begin(Alignment(frozenset(), (Stage(init, step, finish),)), config)
    behind = 0
    for k in range(10 * COLLECT):
        run, status = advance(run, imu(k))
        assert run.state.worked <= config.replay_samples
        behind += status.behind
        assert not (status.done and status.behind)
        if status.done:
            break
    # 5 passes over 500 samples and what comes meanwhile, 64 a step less the one that comes
    assert behind == pytest.approx((2 * TURNS + 1) * COLLECT / (config.replay_samples - 1), abs=2 * TURNS + 2)
    init_ = result(run)
    assert init_.t_ns == k * DT_NS
    # there and back cancel; what is left is one pass over everything that ever came
    np.testing.assert_allclose(init_.v_g[0], k * (k + 1) / 2)
