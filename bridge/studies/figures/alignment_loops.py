"""The gyrocompass loops against what Yan Gongmin 2008, section 2.3 and appendix, says of them in closed form.

The formulas are typed here from the report, corrected where it is misprinted: strapdown gyros turn the
computed attitude the other way than a platform's, and azimuth follows a growing error of the north
accelerometer with a plus. What is judged are the linear loops of `nav.align.compass_theory` and the loops
that run, `nav.align.compass_loop`.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from bridge.studies.alignment_truth import DEG_PER_H, HEIGHT, LAT, G, Vector
from bridge.studies.figures.result import Row
from nav.align import compass_theory as theory
from nav.align.compass_loop import L_SIZE, head, lead, set_gains
from nav.rotation import rotvec_from_quat
from virtual_bus.ellipsoid import OMEGA, A, gravity

EXACT: Final = 1e-6
PERIOD, LEVEL_PERIOD = 150.0, 20.0  # s
_AT: Final = theory.place(LAT, HEIGHT)
_NORTH, _UP = OMEGA * math.cos(LAT), OMEGA * math.sin(LAT)
_GRAVITY: Final = -float(gravity(np.array(LAT), np.array(HEIGHT))[1])
_EPS: Final = np.array([0.007, -0.01, 0.02]) * DEG_PER_H
_NABLA: Final = np.array([5e-5, -3e-5, 0.0]) * G
_RAMP: Final = 1e-4 * _GRAVITY / 300.0  # m/s^3: 1e-4 g in five minutes
_KNOT: Final = 1852.0 / 3600.0
_LIMIT: Final = "1e-6 of the closed form"


def rows() -> list[Row]:
    """Poles, steady states, ramps, and the loops that run, forwards and backwards."""
    return [*_poles(), *_steady(), *_ramps(), _speed(), *_running()]


def growth(speed: float) -> float:
    """Rate (1/s) at which the printed law for the moving base grows at ``speed`` m/s to the east.

    Eqs. (2-28) to (2-30) leave out that the velocity turns with the platform: an azimuth control rate w_cU
    adds w_cU v_E to the error of the north velocity, which drives w_cU.
    """
    F, _ = theory.dynamics(_AT, *_gains(1.0), coupled=False)
    F[theory.V_N, theory.W_U] += speed
    used = theory.states_of(True)
    return float(np.linalg.eigvals(F[np.ix_(used, used)]).real.max())


def _gains(sign: float) -> tuple[theory.LevelGains, theory.AzimuthGains]:
    return (
        theory.level_gains(sign * theory.decay(LEVEL_PERIOD), _AT.gravity),
        theory.azimuth_gains(sign * theory.decay(PERIOD), _AT.gravity),
    )


def _poles() -> list[Row]:
    """Characteristic polynomials of either loop: of equal poles they tell more than the roots."""
    sigma, azimuth = 2.0 * math.pi / LEVEL_PERIOD, 2.0 * math.pi / PERIOD  # eq. (2-11) at a damping of 0.7071
    F, _ = theory.dynamics(_AT, *_gains(1.0), coupled=False)
    out = []
    for name, used, wanted in (
        (
            "poles of the level loop, eq. (2-10a)",
            [theory.V_E, 3, theory.P_E],
            np.convolve([1.0, sigma], [1.0, 2.0 * sigma, 2.0 * sigma**2]),
        ),
        (
            "poles of the azimuth loop, eq. (2-10b)",
            [theory.V_N, 2, 4, theory.W_U],
            np.convolve(*([1.0, 2.0 * azimuth, 2.0 * azimuth**2],) * 2),
        ),
    ):
        off = float(np.abs(np.poly(F[np.ix_(used, used)]) / wanted - 1.0).max())
        out.append(Row(name, None, off, f"{EXACT:g}", off < EXACT, "relative"))
    return out


def _row(name: str, exact: float, ours: float, unit: str = "deg", published: float | None = None) -> Row:
    return Row(name, published, ours, _LIMIT, abs(ours - exact) <= EXACT * abs(exact), unit, exact=exact)


def _steady() -> list[Row]:
    """Eq. (2-12); phi_E also holds against eps_U, which is in (2-14)."""
    F, G_ = theory.dynamics(_AT, *_gains(1.0), coupled=False)
    phi = np.degrees(theory.steady(F, G_, np.concatenate([_EPS, _NABLA, np.zeros(2)]))[theory.PHI])
    azimuth = 2.0 * math.pi / PERIOD
    exact = np.degrees(
        [
            -_NABLA[1] / _GRAVITY + (PERIOD / (2.0 * math.pi)) ** 2 * _NORTH * _EPS[2],
            _NABLA[0] / _GRAVITY,
            -_EPS[0] / _NORTH - 2.0 / azimuth * _EPS[2],
        ]
    )
    pairs = zip(exact.tolist(), phi.tolist(), "ENU", strict=True)
    return [_row(f"steady state, eq. (2-12), phi_{axis}", there, here) for there, here, axis in pairs]


def _ramps() -> list[Row]:
    F, G_ = theory.dynamics(_AT, *_gains(1.0), coupled=False)
    slope = 0.01 * DEG_PER_H / 300.0
    level, azimuth = (LEVEL_PERIOD / (2.0 * math.pi)) ** 2, (PERIOD / (2.0 * math.pi)) ** 2
    out = []
    for name, place, size, k, exact in (
        ("growing east gyro error, eq. (2-14), phi_E", 0, slope, 0, -azimuth * slope),
        ("growing north gyro error, eq. (2-15'), phi_N", 1, slope, 1, -1.5 * level * slope),
    ):
        e = np.zeros(8)
        e[place] = size
        phi = theory.following(F, G_, e)[0][theory.PHI]
        out.append(_row(name, math.degrees(exact), math.degrees(phi[k])))
    e = np.zeros(8)
    e[4] = _RAMP
    phi = theory.following(F, G_, e)[0][theory.PHI]
    exact = math.degrees(_RAMP / (_GRAVITY * OMEGA))
    ours = math.degrees(phi[2]) * math.cos(LAT)
    out.append(_row("1e-4 g in 300 s, eq. (2-17), phi_U cos L", exact, ours, published=0.2619))
    return out


def _speed() -> Row:
    """A reference that is a knot wrong: eq. (2-47), on its sphere."""
    sphere = _AT._replace(along_north=1.0 / A)
    ours = -math.degrees(theory.speed_error(sphere, _KNOT)) * math.cos(LAT)
    exact = math.degrees(_KNOT / (A * OMEGA))
    return _row("a knot of the reference, eq. (2-47), phi_U cos L", exact, ours, "deg/kn", 0.0634)


def _running() -> list[Row]:
    """The loops that run, against the linear ones with the channels coupled by the Earth's rate.

    What is even in the errors, finite updates and second orders, is taken off.
    """
    eps, nabla = 0.1 * _EPS, 0.1 * _NABLA
    out = []
    for sign, name in ((1.0, "forwards"), (-1.0, "backwards")):
        F, G_ = theory.dynamics(_AT, *_gains(sign))
        wanted = theory.steady(F, G_, np.concatenate([eps, nabla, np.zeros(2)]))[theory.PHI]
        phi = 0.5 * (_settled(eps, nabla, sign) - _settled(-eps, -nabla, sign))
        # the linear loops leave out Coriolis' force on the velocity that holds against eps_U: 2e-7 of phi_U
        off = float(np.abs(phi - wanted).max() / np.abs(wanted).max())
        out.append(
            Row(f"running loops, {name}, steady state", None, off, f"{EXACT:g}", off < EXACT, "relative")
        )
    return out


def _settled(eps: Vector, nabla: Vector, sign: float, seconds: float = 1500.0, dt: float = 0.02) -> Vector:
    """phi (3,) of the running loops at rest, with axes east, north, up."""
    law = np.zeros(L_SIZE)
    set_gains(law, _AT, *_gains(sign))
    x = head(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), LAT, 1.9, HEIGHT)
    n = round(seconds / dt)
    force = np.array([0.0, 0.0, _GRAVITY])
    force[1] = -float(gravity(np.array(LAT), np.array(HEIGHT))[0])
    row = np.concatenate([np.array([0.0, _NORTH, _UP]) + eps, force + nabla]) * dt
    lead(x, law, np.tile(row, (n, 1)), np.full(n, dt), np.zeros((n, 3)), sign > 0.0)
    return -rotvec_from_quat(x[0:4])
