"""What is entered of an odometer: intervals, and whether the part of a tick between two of them is known."""

import numpy as np

from nav.filter.aiding import Aiding
from nav.filter.settings import ImuErrors, NavigatorConfig
from nav.types import OdoSample

TICK = 0.02
CONFIG = NavigatorConfig(ImuErrors(1e-5, 1e-3, 1e-5, 1e-3), odometer=True, odometer_quantum=TICK)


class Line:
    """A timeline that only remembers what it was told of the odometer."""

    def __init__(self):
        self.z = []

    def measure(self, kind, t_ns, z):
        if kind == "odometer":
            self.z.append(z)
        return True

    def restart_path(self, t_ns):
        return True


def entered(ticks):
    """Measurements made of counts at 50 Hz, each 20 ms long."""
    line = Line()
    aiding = Aiding(CONFIG, line)
    aiding.begin(0, True)
    for k, n in enumerate(ticks):
        aiding.odometer(OdoSample(20_000_000 * (k + 1), 0.02, TICK * n, n == 0, "odo"))
    return np.array(line.z)


def test_intervals_that_roll_share_the_part_of_a_tick_between_them():
    z = entered([3] * 40)
    np.testing.assert_allclose(z[:, 1], 0.2)
    np.testing.assert_allclose(z[:, 2], 30 * TICK)
    # any part of a tick: uniform
    np.testing.assert_allclose(z[:, 4], TICK / np.sqrt(12.0))
    np.testing.assert_array_equal(z[:, 5], [1.0, 0.0, 0.0, 0.0])


def test_a_wheel_that_stands_tells_nothing_of_the_part_of_a_tick_it_stands_at():
    z = entered([3] * 20 + [0] * 30 + [3] * 20)
    # three intervals at rest, and the first that rolls again, know nothing of it
    np.testing.assert_array_equal(z[:, 5], [1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0])
