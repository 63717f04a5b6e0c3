"""What no alignment can do without: inertial sensors that are alive and throw no wild samples.

A sensor that says exactly the same for longer than it ever did is stuck, unless its neighbours do the same
(ideal sensors, or none). A coarse instrument that feels little says the same for long: it is given the time
in which its own bias, or a tenth of Earth's rate, would fill many of its pulses.

A lone sample that leaps from a smooth curve through its neighbours is wild: by far more than samples are
rough, by far more than any sample of its kind leapt lately, and by what matters, since a leap of an angle or
velocity is a bias over the time of an alignment. Where no sensor of a kind says something new with nearly
every sample, pulses come one by one, and a lone one is nothing else.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav.earth import EARTH_RATE
from nav.jit import in_place
from nav.types import ImuFlag, ImuSample, Vector

STUCK_S: Final = 2.0
LONGER: Final = 10.0  # times the longest that it has said the same before
PULSES: Final = 100.0  # that a small rate would have added or left out
ROUGH: Final = 20.0  # times the mean roughness that a wild sample is off
LARGEST: Final = 3.0  # times the largest leap of late
DENSE: Final = 0.8  # share of samples that say something new
FEWEST: Final = 50  # samples before roughness is known
MEMORY: Final = 200.0  # samples over which it is averaged
FORGET: Final = 5000.0  # samples after which a largest leap has sunk to a third
MATTERS_S: Final = 20.0  # bias over this time: a third of what it makes of a minute
_NAMES: Final = ("right", "forward", "up")
_GAP: Final = int(ImuFlag.GAP)

# columns of the state of a sensor
_RATES: Final = 0  # the last four, newest first
_LEAPS: Final = 4  # the last three, newest first
_LAST, _HELD, _LONGEST, _PULSE, _ROUGH, _MOST, _NEW = 7, 8, 9, 10, 11, 12, 13
_RATE: Final = 14  # rad/s, m/s^2, that does not stay unseen
_LEAP: Final = 15  # rad, m/s, that matters
_SEEN: Final = 16  # samples since the last break; of the first sensor, for all of them
_SIZE: Final = 17

Sensors = Vector
"""What was seen of the six (6, n); used up."""


def sensors(gyro_bias: float, accel_bias: float) -> Sensors:
    """Before the first sample; the standard deviations of constant errors (rad/s, m/s^2) give the scale."""
    state = np.zeros((6, _SIZE))
    state[:, _PULSE] = math.inf
    state[:, _RATE] = [max(gyro_bias, 0.1 * EARTH_RATE)] * 3 + [accel_bias] * 3
    state[:, _LEAP] = [gyro_bias * MATTERS_S] * 3 + [accel_bias * MATTERS_S] * 3
    return state


def against(watched: Sensors, sample: ImuSample) -> str | None:
    """What is wrong with an inertial sensor by this sample, in words, or None."""
    _, dt, dtheta, dv, _, flags = sample
    if flags & _GAP:
        watched[0, _SEEN] = 0.0
    which = _look(watched, dtheta, dv, dt)
    return None if which < 0 else _words(watched, which, dt)


def _words(watched: Sensors, which: int, dt: float) -> str:
    """What to say; and it begins to look again."""
    k = which % 6
    name = f"{_NAMES[k % 3]} {'gyro' if k < 3 else 'accelerometer'}"
    watched[k, _HELD] = watched[0, _SEEN] = 0.0
    if which < 6:
        return f"the {name} is stuck: it says the same again and again"
    leap = abs(watched[k, _LEAPS + 1]) * dt
    size = f"{math.degrees(leap):.5f} deg" if k < 3 else f"{leap:.3f} m/s"
    return f"a lone sample of the {name} is wild: {size} off its neighbours"


@in_place
def _look(state: Sensors, dtheta: Vector, dv: Vector, dt: float) -> int:
    """Take a sample: the sensor (0 to 5) that is stuck, 6 more for one that was wild, or -1."""
    seen = state[0, _SEEN] + 1.0
    state[0, _SEEN] = seen
    found = -1
    for first in (0, 3):
        values = dtheta if first == 0 else dv
        alive, pulse, most, dense = False, math.inf, 0.0, False
        for i in range(3):
            s = state[first + i]
            change = abs(values[i] - s[_LAST])
            s[_LAST] = values[i]
            if change > 0.0:
                s[_PULSE] = min(s[_PULSE], change)
                s[_LONGEST] = max(s[_LONGEST], s[_HELD])
                s[_HELD] = 0.0
            else:
                s[_HELD] += dt
            s[_NEW] += ((1.0 if change > 0.0 else 0.0) - s[_NEW]) / min(seen, MEMORY)
            alive = alive or s[_HELD] < 0.5 * STUCK_S
            dense = dense or s[_NEW] > DENSE
            pulse = min(pulse, s[_PULSE])
            most = max(most, s[_MOST])
        for i in range(3):
            s = state[first + i]
            limit = max(STUCK_S, LONGER * s[_LONGEST], PULSES * pulse / s[_RATE])
            if alive and s[_HELD] > limit:
                found = first + i
            leap = abs(_leap(s, values[i] / dt, seen))
            if dense and leap > LARGEST * most and leap * dt > s[_LEAP]:
                found = 6 + first + i
    return found


@in_place
def _leap(s: Vector, rate: float, seen: float) -> float:
    """By how much the rate three samples ago leapt from a cubic through the four around it, if only it did.

    The leaps before and after a lone one are two thirds of it, with the other sign; what was before them
    tells how rough it is.
    """
    r0, r1, r2, r3 = s[_RATES], s[_RATES + 1], s[_RATES + 2], s[_RATES + 3]
    s[_RATES], s[_RATES + 1], s[_RATES + 2], s[_RATES + 3] = rate, r0, r1, r2
    if seen < 5.0:
        return 0.0
    leap = r1 - (4.0 * (r0 + r2) - (rate + r3)) / 6.0
    middle, before, old = s[_LEAPS], s[_LEAPS + 1], abs(s[_LEAPS + 2])
    s[_LEAPS], s[_LEAPS + 1], s[_LEAPS + 2] = leap, middle, before
    if seen < 8.0:
        return 0.0
    rough = s[_ROUGH]
    s[_ROUGH] = rough + (old - rough) / min(seen - 7.0, MEMORY)
    s[_MOST] = max(old, s[_MOST] * (1.0 - 1.0 / FORGET))
    third = 0.2 * abs(middle)
    lone = abs(leap + middle / 1.5) < third and abs(before + middle / 1.5) < third
    return middle if seen > FEWEST and lone and abs(middle) > ROUGH * rough else 0.0
