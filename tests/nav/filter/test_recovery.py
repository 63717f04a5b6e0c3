"""When what was refused is believed."""

import numpy as np

from nav.filter.recovery import agree


def test_what_agrees():
    t = np.arange(12.0)[:, None]
    rng = np.random.default_rng(9)
    course = np.hstack([50.0 + 3.0 * t, -20.0 + 0.2 * t**2, 5.0 + 0.0 * t])
    assert agree(course)
    assert agree(course[:3])
    assert agree(course + rng.normal(size=course.shape))
    assert not agree(20.0 * rng.normal(size=course.shape))
