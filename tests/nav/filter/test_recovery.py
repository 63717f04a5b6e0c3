"""When what was refused is believed."""

import numpy as np

from nav.filter.measurements import MEASUREMENTS
from nav.filter.records import NEVER
from nav.filter.recovery import agree, contradicted


def test_what_agrees():
    t = np.arange(12.0)[:, None]
    rng = np.random.default_rng(9)
    course = np.hstack([50.0 + 3.0 * t, -20.0 + 0.2 * t**2, 5.0 + 0.0 * t])
    assert agree(course)
    assert agree(course[:3])
    assert agree(course + rng.normal(size=course.shape))
    assert not agree(20.0 * rng.normal(size=course.shape))


def test_fixes_that_agree_contradict_what_is_only_assumed():
    books = dict.fromkeys(MEASUREMENTS, (0, 0, NEVER))
    shut = books | {"non_holonomic": (0, 9, 5_000)}
    wheels = MEASUREMENTS["non_holonomic"]
    assert not contradicted(wheels, shut)
    assert not contradicted(wheels, shut | {"gnss_velocity": (4_000, 0, NEVER)})
    for fix in ("gnss_velocity", "gnss_position"):
        assert contradicted(wheels, shut | {fix: (6_000, 0, NEVER)})
    # a measurement is believed for itself
    lost = shut | {"gnss_velocity": (6_000, 0, NEVER), "gnss_position": (0, 9, 5_000)}
    assert not contradicted(MEASUREMENTS["gnss_position"], lost)
