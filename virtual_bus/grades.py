"""Inertial units by grade: what they are like, and one drawn with its own calibration sheet.

Grades follow the textbook "Inertial navigation" (in Chinese), Tables 2-1 to 2-5, and where these give
only bounds, typical data sheets within them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from virtual_bus.ellipsoid import G0

Array = NDArray[np.float64]

ARCSEC: Final = math.radians(1.0 / 3600.0)
DEG_PER_H: Final = math.radians(1.0) / 3600.0
DEG_PER_SQRT_H: Final = math.radians(1.0) / 60.0
UG: Final = 1e-6 * G0
PPM: Final = 1e-6
REFERENCE_DEG_C: Final = 25.0
"""The temperature that scales and biases are told at."""
RANGE_DEG_C: Final = (-45.0, 70.0)
"""Where a sheet's polynomials in temperature hold."""
_POWERS: Final = 2
_AWAY_DEG_C: Final = 30.0
"""So far from the reference all powers of temperature matter as much."""


@dataclass(frozen=True, slots=True)
class Grade:
    """How good an inertial unit is. One sigma, *after* calibration, unless it says otherwise.

    ``factory`` is how many times larger the errors are that calibration has taken out.
    """

    name: str
    gyro_bias_deg_per_h: float
    gyro_instability_deg_per_h: float
    gyro_random_walk_deg_per_sqrt_h: float
    gyro_scale_ppm: float
    gyro_asymmetry_ppm: float
    gyro_misalignment_arcsec: float
    gyro_g_sensitivity_deg_per_h_per_g: float
    gyro_arcsec_per_pulse: float  # a value, not a sigma
    accel_bias_ug: float
    accel_instability_ug: float
    accel_random_walk_ug_per_sqrt_hz: float
    accel_scale_ppm: float
    accel_asymmetry_ppm: float
    accel_misalignment_arcsec: float
    accel_m_s_per_pulse: float  # a value, not a sigma
    correlation_s: float  # of both instabilities, a value
    clock_ppm: float
    factory: float
    gyro_product_deg_per_h_per_g2: float = 0.0  # of the specific force along two of the unit's axes
    accel_square_ug_per_g2: float = 0.0  # along the sensor's own axis
    accel_product_ug_per_g2: float = 0.0  # of its own axis and one across
    gyro_scale_ppm_per_deg_c: float = 0.0
    gyro_bias_deg_per_h_per_deg_c: float = 0.0
    accel_scale_ppm_per_deg_c: float = 0.0
    accel_bias_ug_per_deg_c: float = 0.0

    @property
    def plain(self) -> bool:
        """Whether it has no second-order terms."""
        return not (
            self.gyro_product_deg_per_h_per_g2 or self.accel_square_ug_per_g2 or self.accel_product_ug_per_g2
        )


GRADES: Final = {
    grade.name: grade
    for grade in (
        # navigation grade (Table 2-1: drift under 0.015 deg/h, scale under 10 ppm), ring lasers (Table 2-3;
        # resolution of 2 arcsec, section 2.2.1.6), pendulous quartz accelerometers (Table 2-5)
        Grade(
            name="rlg",
            gyro_bias_deg_per_h=0.006,
            gyro_instability_deg_per_h=0.002,
            gyro_random_walk_deg_per_sqrt_h=0.002,
            gyro_scale_ppm=3.0,
            gyro_asymmetry_ppm=0.3,
            gyro_misalignment_arcsec=2.0,
            gyro_g_sensitivity_deg_per_h_per_g=0.0,
            gyro_arcsec_per_pulse=2.0,
            accel_bias_ug=30.0,
            accel_instability_ug=3.0,
            accel_random_walk_ug_per_sqrt_hz=8.0,
            accel_scale_ppm=20.0,
            accel_asymmetry_ppm=2.0,
            accel_misalignment_arcsec=3.0,
            accel_m_s_per_pulse=1.5e-5,
            correlation_s=3600.0,
            clock_ppm=0.5,
            factory=10.0,
        ),
        # tactical grade (Table 2-1: drift under 0.5 deg/h, scale under 100 ppm), closed-loop fibre gyros
        # (Table 2-4), quartz accelerometers of the lower classes of Table 2-5
        Grade(
            name="fog",
            gyro_bias_deg_per_h=0.1,
            gyro_instability_deg_per_h=0.03,
            gyro_random_walk_deg_per_sqrt_h=0.01,
            gyro_scale_ppm=30.0,
            gyro_asymmetry_ppm=3.0,
            gyro_misalignment_arcsec=8.0,
            gyro_g_sensitivity_deg_per_h_per_g=0.0,
            gyro_arcsec_per_pulse=0.1,
            accel_bias_ug=200.0,
            accel_instability_ug=20.0,
            accel_random_walk_ug_per_sqrt_hz=40.0,
            accel_scale_ppm=80.0,
            accel_asymmetry_ppm=10.0,
            accel_misalignment_arcsec=10.0,
            accel_m_s_per_pulse=2.0e-5,
            correlation_s=1800.0,
            clock_ppm=3.0,
            factory=10.0,
        ),
        # dynamically tuned gyros (Table 2-2: drift 0.05 to 10 deg/h, 1 to 10 deg/h per g before calibration,
        # scale 10 to 100 ppm; section 2.2.1.6), pendulous quartz accelerometers (Table 2-5), no heating
        Grade(
            name="dtg",
            gyro_bias_deg_per_h=0.1,
            gyro_instability_deg_per_h=0.03,
            gyro_random_walk_deg_per_sqrt_h=0.01,
            gyro_scale_ppm=30.0,
            gyro_asymmetry_ppm=10.0,
            gyro_misalignment_arcsec=10.0,
            gyro_g_sensitivity_deg_per_h_per_g=0.05,
            gyro_arcsec_per_pulse=0.1,
            accel_bias_ug=60.0,
            accel_instability_ug=15.0,
            accel_random_walk_ug_per_sqrt_hz=10.0,
            accel_scale_ppm=40.0,
            accel_asymmetry_ppm=5.0,
            accel_misalignment_arcsec=10.0,
            accel_m_s_per_pulse=2.0e-5,
            correlation_s=1800.0,
            clock_ppm=3.0,
            factory=20.0,
            gyro_product_deg_per_h_per_g2=0.01,
            accel_square_ug_per_g2=1.0,
            accel_product_ug_per_g2=1.0,
            gyro_scale_ppm_per_deg_c=2.0,
            gyro_bias_deg_per_h_per_deg_c=0.003,
            accel_scale_ppm_per_deg_c=5.0,
            accel_bias_ug_per_deg_c=2.0,
        ),
        # what is aligned from a better one: small ring lasers of 1 deg/h, silicon accelerometers of 1 mg
        Grade(
            name="tactical",
            gyro_bias_deg_per_h=1.0,
            gyro_instability_deg_per_h=0.2,
            gyro_random_walk_deg_per_sqrt_h=0.1,
            gyro_scale_ppm=150.0,
            gyro_asymmetry_ppm=10.0,
            gyro_misalignment_arcsec=20.0,
            gyro_g_sensitivity_deg_per_h_per_g=0.0,
            gyro_arcsec_per_pulse=0.3,
            accel_bias_ug=1000.0,
            accel_instability_ug=50.0,
            accel_random_walk_ug_per_sqrt_hz=60.0,
            accel_scale_ppm=300.0,
            accel_asymmetry_ppm=20.0,
            accel_misalignment_arcsec=20.0,
            accel_m_s_per_pulse=2.5e-5,
            correlation_s=1200.0,
            clock_ppm=10.0,
            factory=5.0,
        ),
        # rate grade (Table 2-1: drift over 0.5 deg/h, scale under 1000 ppm), vibrating gyros, silicon
        # accelerometers (Table 2-5: bias 0.1 to 1 mg, and worse over temperature)
        Grade(
            name="mems",
            gyro_bias_deg_per_h=120.0,
            gyro_instability_deg_per_h=10.0,
            gyro_random_walk_deg_per_sqrt_h=0.3,
            gyro_scale_ppm=700.0,
            gyro_asymmetry_ppm=50.0,
            gyro_misalignment_arcsec=120.0,
            gyro_g_sensitivity_deg_per_h_per_g=15.0,
            gyro_arcsec_per_pulse=0.3,
            accel_bias_ug=2500.0,
            accel_instability_ug=100.0,
            accel_random_walk_ug_per_sqrt_hz=100.0,
            accel_scale_ppm=700.0,
            accel_asymmetry_ppm=50.0,
            accel_misalignment_arcsec=120.0,
            accel_m_s_per_pulse=2.5e-5,
            correlation_s=600.0,
            clock_ppm=20.0,
            factory=5.0,
        ),
    )
}


@dataclass(frozen=True, slots=True)
class Triad:
    """Coefficients of n gyros or n accelerometers, SI, as the textbook's eqs. (2-27), (2-28).

    Output per second = (axes @ input + bias + g_sensitivity @ f + f @ second @ f) / scale, where ``scale``
    (n,) is the size of a pulse and ``asymmetry`` (n,) the excess of pulses for positive over negative output;
    ``second`` (n, 3, 3) is symmetric. Column j of ``scale_temperature`` and ``bias_temperature`` (n, k) is
    per degC^(j + 1) from the reference, of a scale as a share of it. One row of none stands for all sensors.
    """

    scale: Array
    bias: Array
    axes: Array
    asymmetry: Array
    g_sensitivity: Array
    second: Array = field(default_factory=lambda: np.zeros((1, 3, 3)))
    scale_temperature: Array = field(default_factory=lambda: np.zeros((1, 0)))
    bias_temperature: Array = field(default_factory=lambda: np.zeros((1, 0)))


@dataclass(frozen=True, slots=True)
class ImuErrors:
    """One unit as it is, and as its calibration sheet says it is."""

    gyro: Triad
    accel: Triad
    calibrated_gyro: Triad
    calibrated_accel: Triad
    serial: int


def _aside(rng: np.random.Generator, axes: Array, sigma: float) -> Array:
    """What is added to axes (n, 3), unit vectors: across them alone."""
    out = rng.standard_normal(axes.shape) * sigma
    return np.asarray(out - (out * axes).sum(axis=1, keepdims=True) * axes)


def _draw_triad(
    rng: np.random.Generator,
    nominal: Array,
    pulse: float,
    bias: float,
    scale: float,
    axes: float,
    asym: float,
    g: float,
    k: float,
) -> tuple[Triad, Triad]:
    n = len(nominal)
    sheet = Triad(
        scale=pulse * (1.0 + k * scale * rng.standard_normal(n)),
        bias=k * bias * rng.standard_normal(n),
        axes=nominal + _aside(rng, nominal, k * axes),
        asymmetry=np.zeros(n),
        g_sensitivity=k * g * rng.standard_normal((n, 3)),
    )
    true = Triad(
        scale=sheet.scale * (1.0 + scale * rng.standard_normal(n)),
        bias=sheet.bias + bias * rng.standard_normal(n),
        axes=sheet.axes + _aside(rng, nominal, axes),
        asymmetry=asym * rng.standard_normal(n),
        g_sensitivity=sheet.g_sensitivity + g * rng.standard_normal((n, 3)),
    )
    return true, sheet


def _products(rng: np.random.Generator, n: int, product: float) -> Array:
    """Second-order terms (n, 3, 3) of gyros: of two different axes of the unit."""
    out = np.zeros((n, 3, 3))
    for a, b in ((1, 2), (2, 0), (0, 1)):
        out[:, a, b] = out[:, b, a] = 0.5 * product * rng.standard_normal(n)
    return out


def _pendulous(rng: np.random.Generator, nominal: Array, square: float, product: float) -> Array:
    """Second-order terms (n, 3, 3) of accelerometers about ``nominal`` (n, 3): with what is along them."""
    own = square * rng.standard_normal((len(nominal), 1)) * nominal + _aside(rng, nominal, product)
    mixed = nominal[:, :, None] * own[:, None, :]
    return np.asarray(0.5 * (mixed + mixed.swapaxes(1, 2)))


def _powers(rng: np.random.Generator, n: int, slope: float) -> Array:
    return np.asarray(slope * rng.standard_normal((n, _POWERS)) / _AWAY_DEG_C ** np.arange(_POWERS))


def thermal(slope: float, course: Array) -> tuple[float, Array]:
    """One sigma of an error that follows temperature by ``slope`` per degC, as drawn by `_powers`.

    At the first of ``course`` (n,) degC, and (n,) of what it has moved by since, in ``slope`` times degC.
    """
    powers = np.arange(1, _POWERS + 1)
    values = slope / _AWAY_DEG_C ** (powers - 1.0) * (course[:, None] - REFERENCE_DEG_C) ** powers
    return float(np.linalg.norm(values[0])), np.linalg.norm(values - values[0], axis=1)


def _draw_more(
    rng: np.random.Generator, grade: Grade, nominal: Array, k: float
) -> tuple[dict[str, Array], ...]:
    """Second-order terms and temperature of gyros and accelerometers, ``k`` times as large as calibrated."""
    n, per_g2 = len(nominal), k / G0**2
    g = grade
    gyro = {
        "second": _products(rng, n, per_g2 * g.gyro_product_deg_per_h_per_g2 * DEG_PER_H),
        "scale_temperature": _powers(rng, n, k * g.gyro_scale_ppm_per_deg_c * PPM),
        "bias_temperature": _powers(rng, n, k * g.gyro_bias_deg_per_h_per_deg_c * DEG_PER_H),
    }
    second = (per_g2 * size * UG for size in (g.accel_square_ug_per_g2, g.accel_product_ug_per_g2))
    accel = {
        "second": _pendulous(rng, nominal, *second),
        "scale_temperature": _powers(rng, n, k * g.accel_scale_ppm_per_deg_c * PPM),
        "bias_temperature": _powers(rng, n, k * g.accel_bias_ug_per_deg_c * UG),
    }
    return gyro, accel


def draw_imu(grade: Grade, rng: np.random.Generator, axes: Array | None = None) -> ImuErrors:
    """One unit of a grade; gyros and accelerometers along ``axes`` (n, 3), unit vectors, by default three."""
    nominal = np.eye(3) if axes is None else axes
    gyro = _draw_triad(
        rng,
        nominal,
        pulse=grade.gyro_arcsec_per_pulse * ARCSEC,
        bias=grade.gyro_bias_deg_per_h * DEG_PER_H,
        scale=grade.gyro_scale_ppm * PPM,
        axes=grade.gyro_misalignment_arcsec * ARCSEC,
        asym=grade.gyro_asymmetry_ppm * PPM,
        g=grade.gyro_g_sensitivity_deg_per_h_per_g * DEG_PER_H / G0,
        k=grade.factory,
    )
    accel = _draw_triad(
        rng,
        nominal,
        pulse=grade.accel_m_s_per_pulse,
        bias=grade.accel_bias_ug * UG,
        scale=grade.accel_scale_ppm * PPM,
        axes=grade.accel_misalignment_arcsec * ARCSEC,
        asym=grade.accel_asymmetry_ppm * PPM,
        g=0.0,
        k=grade.factory,
    )
    # of a stream of their own, so that grades without them keep their units
    more = rng.spawn(1)[0]
    sheet, left = _draw_more(more, grade, nominal, grade.factory), _draw_more(more, grade, nominal, 1.0)
    true = [{name: s[name] + d[name] for name in s} for s, d in zip(sheet, left, strict=True)]
    return ImuErrors(
        replace(gyro[0], **true[0]),
        replace(accel[0], **true[1]),
        replace(gyro[1], **sheet[0]),
        replace(accel[1], **sheet[1]),
        int(rng.integers(1, 1 << 24)),
    )


def ideal_imu(grade: Grade) -> ImuErrors:
    """A unit of a grade without errors, for tests that ask about pulses alone."""
    gyro, accel = (
        Triad(np.full(3, pulse), np.zeros(3), np.eye(3), np.zeros(3), np.zeros((3, 3)))
        for pulse in (grade.gyro_arcsec_per_pulse * ARCSEC, grade.accel_m_s_per_pulse)
    )
    return ImuErrors(gyro, accel, gyro, accel, 1)
