"""Pictures: every page draws what there is, and none fails on what there is not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from bridge.evaluate import SolutionTable, TruthTable
from bridge.outputs import Innovation, ModeChange
from bridge.plots import PlotData, draw
from nav.types import FixType, GnssFix, Mode, S, SolutionFlag

PNG = b"\x89PNG\r\n\x1a\n"


def run(seconds: float = 120.0) -> PlotData:
    """An alignment of 40 s, then a curve with errors that belong to the sigmas; made up, for looking at."""
    rng = np.random.default_rng(3)
    rate = 50
    n = int(seconds * rate)
    t = np.arange(n) / rate
    v = 12.0 * np.clip((t - 45.0) / 8.0, 0.0, 1.0)
    heading = math.radians(65.0) + 0.6 * np.sin(0.08 * np.maximum(t - 50.0, 0.0) * 2.0)
    pitch, roll = 0.02 * np.sin(0.1 * t), 0.01 * np.cos(0.2 * t)
    east, north = np.cumsum(v * np.sin(heading)) / rate, np.cumsum(v * np.cos(heading)) / rate
    lat0, lon0, radius = math.radians(48.137), math.radians(11.575), 6_371_000.0
    height = 520.0 + 3.0 * np.sin(0.05 * t)

    def quaternion(h: np.ndarray, p: np.ndarray, r: np.ndarray) -> np.ndarray:
        ch, sh, cp, sp, cr, sr = (
            np.cos(h / 2),
            -np.sin(h / 2),
            np.cos(p / 2),
            np.sin(p / 2),
            np.cos(r / 2),
            np.sin(r / 2),
        )
        return np.column_stack(
            [
                ch * cp * cr - sh * sp * sr,
                ch * sp * cr - sh * cp * sr,
                ch * cp * sr + sh * sp * cr,
                sh * cp * cr + ch * sp * sr,
            ]
        )

    truth_v = np.column_stack([v * np.sin(heading), v * np.cos(heading), np.gradient(height) * rate])
    lat, lon = lat0 + north / radius, lon0 + east / radius / math.cos(lat0)
    t_ns = (1_000_000_000 + t * 1e9).astype(np.int64)
    truth = TruthTable(
        t_ns[::10],
        lat[::10],
        lon[::10],
        height[::10],
        truth_v[::10],
        quaternion(heading, pitch, roll)[::10],
        np.zeros((len(t[::10]), 3)),
    )

    def wander(size: float) -> np.ndarray:
        steps = rng.standard_normal((n, 3))
        smooth = np.zeros((n, 3))
        for k in range(1, n):
            smooth[k] = 0.995 * smooth[k - 1] + 0.1 * steps[k]
        return size * smooth

    state = np.full((n, S.SIZE), np.nan)
    error = wander(0.4)
    state[:, S.LAT] = lat + error[:, 1] / radius
    state[:, S.LON] = lon + error[:, 0] / radius / math.cos(lat0)
    state[:, S.HEIGHT] = height + error[:, 2]
    state[:, S.V] = truth_v + wander(0.02)
    state[:, S.Q] = quaternion(heading + wander(0.002)[:, 2], pitch, roll)
    state[:, S.SIGMA_P], state[:, S.SIGMA_V] = 0.45, 0.025
    state[:, S.SIGMA_PHI] = [2e-4, 2e-4, 2.2e-3]
    decay = np.exp(-np.maximum(t - 40.0, 0.0) / 30.0)[:, None]
    state[:, S.GYRO_BIAS] = np.array([4e-7, -2e-7, 3e-7]) * (1.0 - decay)
    state[:, S.SIGMA_GYRO_BIAS] = 1e-7 + 4e-7 * decay
    state[:, S.ACCEL_BIAS] = np.array([1e-3, -2e-3, 0.5e-3]) * (1.0 - decay)
    state[:, S.SIGMA_ACCEL_BIAS] = 5e-4 + 2e-3 * decay
    state[:, S.ODO_SCALE], state[:, S.SIGMA_ODO_SCALE] = 0.01 * (1 - decay[:, 0]), 0.02 * decay[:, 0] + 1e-3
    state[:, S.MOUNTING] = np.array([0.01, -0.005]) * (1 - decay)
    state[:, S.SIGMA_MOUNTING] = 0.02 * decay + 5e-4
    mode = np.where(t < 40.0, Mode.ALIGN, np.where(t < 43.0, Mode.CATCH_UP, Mode.NAVIGATE))
    state[t < 40.0, S.LAT] = np.nan
    flags = np.where(t < 40.0, SolutionFlag.LEVEL, 0x0F) | np.where(
        (t > 90) & (t < 105), SolutionFlag.DEAD_RECKONING, 0
    )
    fixes = [
        GnssFix(
            int(t_ns[k]),
            lat[k] + rng.normal(0, 0.8) / radius,
            lon[k] + rng.normal(0, 0.8) / radius,
            height[k] + rng.normal(0, 1.5),
            np.full(3, 0.8),
            truth_v[k] + rng.normal(0, 0.05, 3),
            np.full(3, 0.05),
            FixType.FIX_3D,
            "gnss",
        )
        for k in range(0, n, rate // 5)
        if not 90.0 < t[k] < 105.0
    ]
    innovations = []
    for fix in fixes:
        if (fix.t_ns - 1_000_000_000) / 1e9 > 43.0:
            far = rng.random() < 0.02
            residual = tuple(float(x) for x in rng.normal(0.0, 4.0 if far else 0.8, 3))
            innovations.append(
                Innovation(fix.t_ns, "main", "gnss_position", residual, (0.9, 0.9, 1.6), 3.0, not far)
            )
            innovations.append(Innovation(fix.t_ns, "main", "barometer", (residual[0],), (0.9,), 1.0, True))
    samples = {"imu": np.delete(t_ns, slice(4000, 4100)), "gnss": np.array([fix.t_ns for fix in fixes])}
    changes = [
        ModeChange(1_000_000_000, "main", Mode.STANDBY, Mode.ALIGN, "started"),
        ModeChange(41_000_000_000, "main", Mode.ALIGN, Mode.CATCH_UP, "aligned"),
        ModeChange(44_000_000_000, "main", Mode.CATCH_UP, Mode.NAVIGATE, "caught up"),
    ]
    return PlotData(
        "made up · navigator main · 120 s",
        "main",
        1_000_000_000,
        int(t_ns[-1]),
        SolutionTable(t_ns, mode.astype(np.int64), flags.astype(np.int64), state),
        changes,
        innovations,
        fixes,
        truth,
        samples,
    )


def test_every_picture_is_drawn(tmp_path: Path) -> None:
    paths = list(draw(run(), tmp_path))
    assert {path.stem for path in paths} == {
        "track",
        "attitude",
        "velocity",
        "biases",
        "parameters",
        "rates",
        "error_position",
        "error_velocity",
        "error_attitude",
        "innovations_gnss_position",
        "innovations_barometer",
    }
    for path in paths:
        assert path.read_bytes().startswith(PNG)
        assert path.stat().st_size > 10_000


def test_what_is_not_there_is_not_drawn(tmp_path: Path) -> None:
    full = run(60.0)
    nothing = SolutionTable(
        *(
            column[:0]
            for column in (
                full.solutions.t_ns,
                full.solutions.mode,
                full.solutions.flags,
                full.solutions.state,
            )
        )
    )
    bare = PlotData("bare", "main", 0, 1, nothing, [], [], [], None, {})
    assert list(draw(bare, tmp_path)) == []
    blind = PlotData("no truth", "main", full.begin_ns, full.end_ns, nothing, [], [], full.fixes, None, {})
    assert [path.stem for path in draw(blind, tmp_path)] == ["track"]


def test_a_run_of_one_solution_is_no_trouble(tmp_path: Path) -> None:
    full = run(60.0)
    keep = np.zeros(len(full.solutions.t_ns), dtype=bool)
    keep[-1] = True
    short = PlotData(
        "short",
        "main",
        full.begin_ns,
        full.end_ns,
        full.solutions.where(keep),
        full.modes,
        full.innovations[:1],
        full.fixes[:1],
        None,
        {"imu": full.samples_ns["imu"][:1]},
    )
    assert list(draw(short, tmp_path))
