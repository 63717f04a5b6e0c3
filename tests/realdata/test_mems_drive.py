"""The drive of a consumer IMU through the program: import, replay, and errors at fixes that were withheld.

Limits are those of KF-GINS on the same tables: 0.148 m with every fourth fix, and 8.17 m (RMS over outages of
the worst error) with ten outages of 15 s from 85 s on. KF-GINS takes positions only; so does one test here.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from nav.types import Mode, S, SolutionFlag
from tests.realdata import mems_drive
from tests.realdata.mems_drive import FOLDER, Array, Score
from tests.recordings import needs_recording

pytestmark = needs_recording("drive_mems_rtk")

FOURTH_FIX_M = 0.148
OUTAGE_M = 8.17


@pytest.fixture(scope="module")
def fourth(tmp_path_factory: pytest.TempPathFactory) -> Score:
    return mems_drive.every_fourth_fix(tmp_path_factory.mktemp("fourth"))


def honest(score: Score) -> None:
    """Errors are as large as they are said to be: not three times larger in one of twenty, nor a fifth."""
    assert score.inside >= 0.95
    assert 0.2 < score.normalised < 1.5


def test_between_fixes_of_one_hertz(fourth: Score) -> None:
    assert len(fourth.error) == 1350  # three of four fixes from 98.75 s to the end
    assert fourth.horizontal < FOURTH_FIX_M
    assert fourth.up < 0.05  # fixes are good to 0.01 m, and a road is smooth over one second
    honest(fourth)


@pytest.mark.parametrize("start", [70.0, 85.0, 100.0])
def test_outages(tmp_path: Path, start: float) -> None:
    score = mems_drive.outages(tmp_path, start)
    assert len(score.worst) == mems_drive.OUTAGES
    assert score.worst_rms < OUTAGE_M
    # no single outage is lost: half the acceleration that a level wrong by 1.5 degrees makes, over 15 s
    assert score.worst.max() < 0.5 * 9.8 * math.radians(1.5) * mems_drive.LENGTH_S**2
    honest(score)


def test_positions_alone_will_do(tmp_path: Path) -> None:
    score = mems_drive.outages(tmp_path, 85.0, velocity=False)
    assert score.worst_rms < OUTAGE_M


def test_it_aligns_soon_after_it_moves(fourth: Score) -> None:
    # heading cannot show before the vehicle moves; as long again as the 13 s that it takes is too long
    first_motion = mems_drive.fixes().first_motion
    assert first_motion < fourth.drive.aligned_s < first_motion + 26.0
    assert [(m.old, m.new) for m in fourth.drive.modes] == [
        (Mode.STANDBY, Mode.ALIGN),
        (Mode.ALIGN, Mode.NAVIGATE),
    ]
    found = SolutionFlag.MOUNTING | SolutionFlag.HEADING | SolutionFlag.LEVEL
    table = fourth.drive.table
    later = table.t_ns > table.t_ns[0] + 10_000_000_000
    assert np.all(table.flags[later] & found == found)


def test_heading_is_where_it_drives(fourth: Score) -> None:
    """On straight road; its own course is known to 0.02 m/s in 8."""
    state = fourth.drive.table.state
    w, x, y, z = state[:, S.Q].T
    heading = np.arctan2(2.0 * (x * y - w * z), w * w - x * x + y * y - z * z)
    east, north = state[:, S.V][:, :2].T
    straight = (np.hypot(east, north) > 8.0) & (np.abs(state[:, S.W][:, 2]) < 0.03)
    off = (heading - np.arctan2(east, north) + math.pi) % (2.0 * math.pi) - math.pi
    assert np.count_nonzero(straight) > 5000
    assert np.sqrt(np.mean(off[straight] ** 2)) < math.radians(0.5)


def test_mounting_agrees_with_the_data_sets_own(fourth: Score) -> None:
    """The turn from the sensor's rates to the solution's, against the angles that come with the data."""
    table = np.genfromtxt(FOLDER / "imu.csv", delimiter=",", names=True)
    rates = np.radians(np.stack([table[f"gyro_{axis}_deg_s"] for axis in "xyz"], axis=1))
    times = np.rint(table["t_gps_s_of_week"] * 1e9).astype(np.int64)
    drive = fourth.drive
    # a solution holds the mean rate of its two samples
    last = np.searchsorted(times, drive.tow_ns - 2_000_000)
    sensor = 0.5 * (rates[last] + rates[last - 1])
    vehicle = drive.table.state[:, S.W]
    moving = np.hypot(*drive.table.state[:, S.V][:, :2].T) > 1.0
    a, b = sensor[moving], vehicle[moving]
    u, _, vt = np.linalg.svd((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
    C_vb = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt  # Wahba's problem, by Markley's SVD
    given = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) @ _frame(185.35, -6.79, 180.0)
    angle = math.acos(min(1.0, 0.5 * (np.trace(C_vb @ given.T) - 1.0)))
    assert angle < math.radians(3.0)  # given as a good first guess


def _frame(yaw: float, pitch: float, roll: float) -> Array:
    """Passive rotation about z, then y, then x, deg."""
    (cy, cp, cr), (sy, sp, sr) = (f(np.radians([yaw, pitch, roll])) for f in (np.cos, np.sin))
    about_z = np.array([[cy, sy, 0], [-sy, cy, 0], [0, 0, 1]])
    about_y = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    about_x = np.array([[1, 0, 0], [0, cr, sr], [0, -sr, cr]])
    return np.asarray(about_x @ about_y @ about_z)
