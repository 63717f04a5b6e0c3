"""What a sample of redundant sensors costs where nothing is wrong: scales, fusion and the test in lanes."""

from __future__ import annotations

from typing import Final

from nav.imu.parity import MOST
from nav.jit import in_place
from nav.types import Vector

# places in what `quick` works on: rows of `MOST` lanes, one for each sensor; then single numbers
SCALE, UNEVEN, MATRIX, BIAS, FELT, Z = (MOST * row for row in (0, 1, 2, 10, 11, 14))
_Y, SUM, WINDOW = 15 * MOST, 16 * MOST, 17 * MOST
LIMIT, TIMES, CONSTANT, SQUARED, MOTION, LEFT, SECONDS, LANES = range(18 * MOST, 19 * MOST)
MOVED, NOW = 19 * MOST, 19 * MOST + 3
HOT: Final = 20 * MOST


@in_place
def quick(
    hot: Vector, counts: Vector, first: int, tau: float, fx: float, fy: float, fz: float, x: Vector
) -> bool:
    """Fuse a sample that nothing is wrong with and that ends no window; else false: `fuse` is to be called.

    ``counts`` pulses over ``tau`` s, from place ``first`` on `MOST` of them, zero beyond the last sensor;
    (fx, fy, fz) m/s in b for what gyros feel of it; ``x`` (3,) as of `fuse`. Bias and what is felt have gone
    through the matrix beforehand.

    Raises ValueError where ``counts`` is shorter.
    """
    if first < 0 or len(counts) < first + MOST:
        raise ValueError("counts: expected lanes for the most sensors that there may be")
    lanes = int(hot[LANES])  # not a constant: loops shall become vectors, not be unrolled
    for k in range(lanes):  # scales of both signs without a branch
        hot[Z + k] = counts[first + k] * hot[SCALE + k] + abs(counts[first + k]) * hot[UNEVEN + k]
    a, b, c, d = hot[Z], hot[Z + 1], hot[Z + 2], hot[Z + 3]
    e, f, g, h = hot[Z + 4], hot[Z + 5], hot[Z + 6], hot[Z + 7]
    for k in range(lanes):  # rows side by side, in lanes of the processor
        hot[_Y + k] = (
            (hot[MATRIX + k] * a + hot[MATRIX + MOST + k] * b)
            + (hot[MATRIX + 2 * MOST + k] * c + hot[MATRIX + 3 * MOST + k] * d)
        ) + (
            (hot[MATRIX + 4 * MOST + k] * e + hot[MATRIX + 5 * MOST + k] * f)
            + (hot[MATRIX + 6 * MOST + k] * g + hot[MATRIX + 7 * MOST + k] * h)
            - (
                (hot[BIAS + k] * tau + hot[FELT + k] * fx)
                + (hot[FELT + MOST + k] * fy + hot[FELT + 2 * MOST + k] * fz)
            )
        )
    u, v, w = hot[_Y], hot[_Y + 1], hot[_Y + 2]
    p, q, r, s, t = hot[_Y + 3], hot[_Y + 4], hot[_Y + 5], hot[_Y + 6], hot[_Y + 7]
    variance = hot[TIMES] * tau + hot[CONSTANT] + hot[SQUARED] * tau * tau
    variance += hot[MOTION] * (u * u + v * v + w * w)
    # a NaN passes no test
    if hot[LEFT] < 1.5 or not p * p + q * q + (r * r + s * s) + t * t <= hot[LIMIT] * variance:
        hot[NOW], hot[NOW + 1], hot[NOW + 2] = fx, fy, fz
        return False
    for k in range(lanes):
        hot[SUM + k] += hot[Z + k]
    hot[MOVED] += fx
    hot[MOVED + 1] += fy
    hot[MOVED + 2] += fz
    hot[SECONDS] += tau
    hot[LEFT] -= 1.0
    x[0], x[1], x[2] = u, v, w
    return True


@in_place
def quick_both(gyro: Vector, accel: Vector, counts: Vector, tau: float, dtheta: Vector, dv: Vector) -> int:
    """`quick` for a unit: 0 both are done, 1 neither is, 2 the gyros are not.

    ``gyro``, ``accel`` are their ``hot``, ``counts`` those of the gyros, then of the accelerometers, as many.
    """
    if not quick(accel, counts, MOST, tau, 0.0, 0.0, 0.0, dv):
        return 1
    return 0 if quick(gyro, counts, 0, tau, dv[0], dv[1], dv[2], dtheta) else 2
