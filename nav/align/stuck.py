"""A sensor that says the same again and again, to the last digit, while its neighbours do not."""

from __future__ import annotations

from typing import Final, NamedTuple

from nav.align.store import Store

LOOK_S: Final = 0.5
MOST: Final = 500  # samples
FEWEST: Final = 8
TIMES: Final = 5  # in a row that a sensor must be found so
_NAMES: Final = ("gyro x", "gyro y", "gyro z", "accelerometer x", "accelerometer y", "accelerometer z")


class Stuck(NamedTuple):
    """How often in a row each sensor was found to stand."""

    times: tuple[int, ...] = (0,) * 6


def look(stuck: Stuck, store: Store, doubtful: bool = False) -> tuple[Stuck, str | None]:
    """Look at the newest samples, and say which sensor is stuck; at once where all is ``doubtful``.

    Noise moves the last digit of a sensor in every sample. One whose increments are all alike stands still
    unless the other two of its kind do as well (ideal sensors, or none).
    """
    count = store.imu.count
    dt = float(store.imu.back(count, 1).dt[0])
    rows = store.imu.back(count, min(MOST, max(FEWEST, int(LOOK_S / dt)))).rows
    if len(rows) < FEWEST:
        return stuck, None
    alike = (rows == rows[0]).all(axis=0).tolist()
    times = tuple(
        n + 1 if alike[k] and not all(alike[k - k % 3 : k - k % 3 + 3]) else 0
        for k, n in enumerate(stuck.times)
    )
    for name, n in zip(_NAMES, times, strict=True):
        if n >= (1 if doubtful else TIMES):
            return Stuck(times), f"{name} is stuck: it says the same again and again"
    return Stuck(times), None
