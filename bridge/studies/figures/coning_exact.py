"""Coning in many digits: the drift of an algorithm without rounding, and that of computed rotation vectors.

Drifts of interest are down to 1e-27 rad in an update, far below what an attitude in double precision can
hold, so nothing is accumulated in one: each update's drift follows from its rotation vector alone.

Yan Gongmin 2008, chapter 7: a cone about x of half angle alpha and rate Omega = 2 pi f, in samples of
h = lambda / Omega.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from typing import Final

DIGITS: Final = 60
PI: Final = Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")
_TINY: Final = Decimal(10) ** -DIGITS

Three = tuple[Decimal, Decimal, Decimal]


def sine_cosine(x: Decimal) -> tuple[Decimal, Decimal]:
    """Sine and cosine of ``x`` rad, by their series within one turn."""
    x -= 2 * PI * (x / (2 * PI)).to_integral_value()
    total, term, n = [Decimal(1), Decimal(0)], Decimal(1), 0
    while abs(term) > _TINY or n < 4:
        n += 1
        term = term * x / n
        total[n % 2] += term if n % 4 < 2 else -term
    return total[1], total[0]


class Cone:
    """Coning motion of half angle ``alpha`` rad, sampled every ``lam`` rad of its phase."""

    def __init__(self, alpha: Decimal, lam: Decimal) -> None:
        with localcontext(prec=DIGITS):
            self.lam = lam
            s, c = sine_cosine(alpha / 2)
            self._axis = -2 * lam * s * s
            self._level = 4 * s * c * sine_cosine(lam / 2)[0]

    def increment(self, sample: int) -> Three:
        """Angle increment over sample 0, 1, 2, ..., rad in b: Yan Gongmin 2008, eq. (7-10)."""
        with localcontext(prec=DIGITS):
            s, c = sine_cosine((sample + Decimal("0.5")) * self.lam)
            return self._axis, -self._level * s, self._level * c

    def drift(self, phi: Sequence[Decimal], samples: int) -> Decimal:
        """Drift about x, computed minus true, rad, of an update over ``samples`` by ``phi`` (3,), rad.

        The true attitude turns with the cone by lambda_N in an update; the computed one by the angle of
        the product of its own quaternion and the turn of the cone: it does so at any phase.
        """
        with localcontext(prec=DIGITS):
            half = samples * self.lam / 2
            length = sum((x * x for x in phi), Decimal(0)).sqrt()
            s, c = sine_cosine(length / 2)
            sin_half, cos_half = sine_cosine(half)
            # cosine of half the angle, less that of half the true one
            target = c * cos_half - s * phi[0] / length * sin_half
            excess = -(target - cos_half) / sin_half
            for _ in range(4):
                sin_now, cos_now = sine_cosine(half + excess)
                excess += (cos_now - target) / sin_now
            return 2 * excess

    def algorithm_drift(self, coefficients: Sequence[Fraction]) -> Decimal:
        """The same of the algorithm with k_1 ... k_(N-1), free of rounding: eq. (7-16) and `drift`."""
        n = len(coefficients) + 1
        with localcontext(prec=DIGITS):
            d = [self.increment(sample) for sample in range(n)]
            phi = [sum((one[axis] for one in d), Decimal(0)) for axis in range(3)]
            for i, one in enumerate(d[:-1]):
                k = coefficients[n - 2 - i]
                for axis, part in enumerate(_cross(one, d[-1])):
                    phi[axis] += part * k.numerator / k.denominator
        return self.drift(phi, n)


def _cross(a: Three, b: Three) -> Three:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
