"""Inner lever arms: the velocity that a swing makes of them, and their compensation.

Yan Gongmin, "On SINS In-movement Initial Alignment and Some Other Problems", 2008, chapter 5. Accelerometers
that sit apart are put through swings in closed form; what they read is led back to one point by the program's
formulas, and by the compensation that the live path runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1

from bridge.plots.style import BLUE, GREEN, INK, ORANGE, RED, Picture, legend
from bridge.studies.figures.result import Result, Row
from nav.imu.pulses import Calibration
from nav.imu.size_effect import SizeEffect, felt, in_origin
from virtual_bus.ellipsoid import G0

Array = NDArray[np.float64]

ALPHA: Final = 0.5 * math.pi
ARM: Final = 0.05
OMEGA: Final = math.pi
"""The text's example: 90 deg, 5 cm, 0.5 Hz."""
EXACT: Final = 1e-12
GEOMETRIES: Final = 1000
LEFT: Final = 1e-4
RATES_HZ: Final = (50, 100, 200, 400)
_MAX_RATE: Final = math.radians(250.0)
_ARMS_5_8: Final = (0.0235, -0.029)
_SEED: Final = 5
_UP: Final = np.array([0.0, 0.0, 1.0])


def swing(t: Array) -> tuple[Array, Array, Array]:
    """Angle, rate and acceleration of eqs. (5-1), (5-2), rad."""
    angle = ALPHA * np.sin(OMEGA * t)
    return angle, ALPHA * OMEGA * np.cos(OMEGA * t), -ALPHA * OMEGA**2 * np.sin(OMEGA * t)


def integral(f: Callable[[Array], Array], begin: float, end: float, nodes: int = 64) -> float:
    """By Gauss's rule: exact to rounding for what is integrated here."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    half = 0.5 * (end - begin)
    return float(half * w @ f(begin + half * (x + 1.0)))


def point(arms: Array, rate: Array, acceleration: Array) -> Array:
    """Acceleration (n, 3) of points at ``arms`` (n, 3) of a body that turns about its origin."""
    return np.cross(rate, np.cross(rate, arms)) + np.cross(acceleration, arms)


def swung(compensated: bool) -> Callable[[Array], Array]:
    """Acceleration along x of the room, (n,) m/s^2, that a navigation makes of a swing about the origin."""
    arms = ARM * np.eye(3)

    def along(t: Array) -> Array:
        out = np.empty(len(t))
        for k, (angle, rate, acceleration) in enumerate(zip(*swing(t), strict=True)):
            # (5-12), (5-13): each lies on its own axis and feels what pulls it inwards
            f = np.array([-ARM * rate**2, -ARM * rate**2, 0.0])
            if compensated:
                f = in_origin(np.eye(3), arms, f, rate * _UP, acceleration * _UP)
            out[k] = math.cos(angle) * f[0] - math.sin(angle) * f[1]
        return out

    return along


def compute() -> Result:
    """The half swing, the compensation of any geometry, and the live one."""
    period = 2.0 * math.pi / OMEGA
    raw = swung(compensated=False)
    half = integral(raw, 0.25 * period, 0.75 * period)
    closed = -math.pi * ARM * OMEGA * ALPHA * float(j1(ALPHA))
    ys = integral(lambda x: ALPHA**2 * np.cos(x) ** 2 * np.cos(ALPHA * np.sin(x)), 0.0, 0.5 * math.pi)
    whole = integral(raw, 0.0, 0.5 * period) + integral(raw, 0.5 * period, period)
    left = integral(swung(compensated=True), 0.25 * period, 0.75 * period)
    rows = [
        _exact("half swing", -0.44, half, closed, "m/s"),
        _exact("Ys of (5-8)", None, ys, 0.5 * math.pi * ALPHA * float(j1(ALPHA)), ""),
        _exact("one period (5-14)", None, whole, 2.0 * closed, "m/s"),
        _exact("mean rate (5-15)", None, whole / period, 2.0 * closed / period, "m/s2"),
        _exact("half swing after (5-17)", None, left, 0.0, "m/s"),
    ]
    origin, printed = _geometries()
    rows.append(_exact(f"(5-20), (5-23), worst of {GEOMETRIES} geometries", None, origin, 0.0, "m/s2"))
    rows.append(Row("the same with U as printed", None, printed, "", None, "m/s2", _PRINTED_U))
    rows += _sculling()
    rows += _turns()
    live = {rate: live_course(rate) for rate in RATES_HZ}
    for rate, (_, with_arms, without) in live.items():
        name, before, after = f"live, {rate} Hz", float(with_arms[-1]), float(without[-1])
        rows.append(Row(f"{name}: half swing, skew unit", None, before, "", None, "m/s"))
        passed = abs(after) < LEFT * abs(before)
        rows.append(Row(f"{name}: after compensation", None, after, f"< {LEFT:g} of it", passed, "m/s"))
    notes = [
        "A swing of 90 deg at 0.5 Hz about the vertical, accelerometers 5 cm from where their axes meet, "
        "along these; from one end to the other. Closed forms: -pi r w alpha J1(alpha), and pi/2 beta "
        "J1(beta) for (5-8), of which the text says that there is none.",
        "Geometries: three accelerometers on random axes and in random places, random rates up to 5 rad/s "
        "and accelerations up to 50 rad/s2; specific force of the origin against the true one.",
        "Live: a unit with skew axes and arms in all directions, compensated from increments as the bridge "
        "does it, which must find the angular acceleration in them.",
    ]
    return Result("Size effect of accelerometers that sit apart", rows, notes, _pictures(live))


_PRINTED_U: Final = (
    "(5-23) prints U where its inverse transposed belongs: they are equal for orthogonal axes alone"
)
_SCULLING: Final = "r alpha^2 w^2 as printed is twice the largest mean of the product that is rectified"


def _exact(name: str, published: float | None, ours: float, closed: float, unit: str) -> Row:
    passed = abs(ours - closed) <= EXACT * max(1.0, abs(closed))
    if published is not None:
        passed = passed and abs(ours - published) <= 0.005
    asked = f"{EXACT:g} of closed form" + ("" if published is None else ", printed digits")
    return Row(name, published, ours, asked, passed, unit, "", closed)


def _geometries() -> tuple[float, float]:
    """Largest error of the origin's specific force by (5-20) and (5-23), and with the matrix as printed."""
    rng = np.random.default_rng(_SEED)
    worst = printed = 0.0
    done = 0
    while done < GEOMETRIES:
        axes = rng.standard_normal((3, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        if abs(np.linalg.det(axes)) < 0.1:
            continue
        arms = rng.uniform(-0.1, 0.1, (3, 3))
        w, dw, force = rng.uniform(-5.0, 5.0, 3), rng.uniform(-50.0, 50.0, 3), rng.uniform(-20.0, 20.0, 3)
        read = np.sum(axes * (force + point(arms, w, dw)), axis=1)
        worst = max(worst, float(np.abs(in_origin(axes, arms, read, w, dw) - force).max()))
        found = axes.T @ (read - felt(axes, arms, w, dw))
        printed = max(printed, float(np.abs(found - force).max()))
        done += 1
    return worst, printed


def _sculling() -> list[Row]:
    """(5-25): 30 arcsec at 10 Hz, 5 cm."""
    alpha, omega, arm = math.radians(30.0 / 3600.0), 20.0 * math.pi, 0.05

    def product(t: Array) -> Array:
        # angle times tangential acceleration: what a navigation rectifies that does not turn within a period
        return arm * (alpha * omega * np.sin(omega * t)) ** 2

    period = 2.0 * math.pi / omega
    ours = integral(product, 0.0, period) / period / G0
    closed = 0.5 * arm * (alpha * omega) ** 2 / G0
    passed = abs(ours - closed) <= EXACT * closed
    return [
        Row("sculling of (5-25)", 4e-7, ours, f"{EXACT:g} of closed form", passed, "g", _SCULLING, closed)
    ]


def _turns() -> list[Row]:
    """Section 5.5: seven turns of 180 deg by hand, at up to 250 deg/s, as seven half swings of that rate."""
    omega = _MAX_RATE / ALPHA
    made = [7.0 * math.pi * abs(arm) * omega * ALPHA * float(j1(ALPHA)) for arm in _ARMS_5_8]
    why = "turned by hand: the rate's course is not told; ours are half swings of a sine with the same top"
    return [
        Row("seven turns, larger component", 1.1, max(made), "", None, "m/s", why),
        Row("seven turns, smaller component", 0.9, min(made), "", None, "m/s", why),
    ]


def _unit() -> Calibration:
    axes = np.array([[1.0, 0.1, -0.05], [-0.08, 1.0, 0.06], [0.03, -0.07, 1.0]])
    arms = np.array([[0.05, 0.03, -0.02], [-0.03, 0.05, 0.01], [0.02, -0.04, 0.05]])
    return Calibration(np.ones(3), np.ones(3), accel_axes=axes, accel_arms=arms)


def live_course(rate_hz: int) -> tuple[Array, Array, Array]:
    """Velocity (n,) m/s along x of the room about a half swing of a skew unit: times (n,) s, without, with.

    Before it the unit rests: its angular acceleration begins with a step.
    """
    unit = _unit()
    begin, rest = 0.5 * math.pi / OMEGA, 0.1
    tau = 1.0 / rate_hz
    t = np.asarray(begin - rest + tau * np.arange(round((2.0 * rest + math.pi / OMEGA) * rate_hz) + 1))

    def state(at: Array) -> tuple[Array, Array, Array]:
        angle, rate, acceleration = swing(at)
        turned = (at > begin) & (at < begin + math.pi / OMEGA)
        held = np.where(at <= begin, ALPHA, -ALPHA)
        return np.where(turned, angle, held), turned * rate, turned * acceleration

    effect = SizeEffect(unit)
    x, weights = np.polynomial.legendre.leggauss(12)
    weights = 0.5 * tau * weights
    before = np.zeros(len(t))
    after = np.zeros(len(t))
    inverse = np.linalg.inv(unit.accel_axes)
    for k in range(1, len(t)):
        at = np.asarray(t[k - 1] + 0.5 * tau * (x + 1.0))
        _, rate, acceleration = state(at)
        f = [
            inverse @ np.sum(unit.accel_axes * point(unit.accel_arms, w * _UP, dw * _UP), axis=1)
            for w, dw in zip(rate, acceleration, strict=True)
        ]
        dv = np.asarray(weights @ np.array(f))
        first, last = (float(one) for one in state(t[k - 1 : k + 1])[0])
        left = dv.copy()
        effect.take_off((last - first) * _UP, left, tau)
        # turned with the mean angle: what the program's sculling does better is not asked here
        middle = 0.5 * (first + last)
        before[k] = before[k - 1] + math.cos(middle) * dv[0] - math.sin(middle) * dv[1]
        after[k] = after[k - 1] + math.cos(middle) * left[0] - math.sin(middle) * left[1]
    return t, before, after


def _pictures(live: dict[int, tuple[Array, Array, Array]]) -> dict[str, Any]:
    t = np.linspace(0.0, 2.0 * math.pi / OMEGA, 201)
    courses = {}
    for name, compensated in (("as read", False), ("compensated", True)):
        along = swung(compensated)
        steps = [integral(along, float(a), float(b), 4) for a, b in pairwise(t)]
        courses[name] = [0.0, *np.cumsum(steps).tolist()]
    left = {str(rate): [at.tolist(), after.tolist()] for rate, (at, _, after) in live.items()}
    return {"t": t.tolist(), "velocity": courses, "live": left}


def draw(result: Result, path: Path) -> None:
    """Velocity along x of the room over a period, and what the live compensation leaves of a half swing."""
    picture = Picture(
        "Size effect of a swing of 90 deg at 0.5 Hz",
        "velocity that a navigation makes of accelerometers that sit apart; dots: the text's half swing",
        columns=2,
        height=5.0,
    )
    left, right = picture.axes[0]
    numbers = result.numbers
    t = np.array(numbers["t"])
    for (name, course), colour in zip(numbers["velocity"].items(), (RED, GREEN), strict=True):
        left.plot(t, course, color=colour, label=name)
    marks = [int(np.argmin(np.abs(t - one))) for one in (0.5, 1.5)]
    left.plot(t[marks], np.array(numbers["velocity"]["as read"])[marks], "o", color=INK, ms=5)
    left.set_xlabel("time (s)")
    left.set_ylabel("velocity along x (m/s)")
    left.legend(loc="lower left")
    for (rate, (at, after)), colour in zip(numbers["live"].items(), (INK, ORANGE, BLUE, GREEN), strict=True):
        right.plot(at, 1e6 * np.array(after), color=colour, label=f"{rate} Hz")
    right.set_xlabel("time (s)")
    right.set_ylabel("left by the live compensation, skew unit (um/s)")
    legend(right)
    picture.save(path)
