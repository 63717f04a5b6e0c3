"""The states of transfer alignment: one error model, of which every matching is a selection.

Errors are *computed minus true*, as in `nav.filter.states`, whose first fifteen are these; phi follows the
naming law: computed ``C = (I - [phi x]) C_nb``. All are relative to the master: its own errors obey the
same equations, so what is left between the two does as well, and biases are the slave's less the master's.

- position (3) m, velocity (3) m/s, phi (3) rad in n; gyro bias (3) rad/s, accel bias (3) m/s^2 in b
- gyro axes, accel axes (9 + 9): of M by rows in ``measured = true + M (true - rest) + bias``
- mounting (3) rad: lambda about right, forward, up of a, ``C_ab = (I + [lambda x]) C_ab as built``. In the
  master's axes, and not in the slave's, as these turn with every correction of phi: what cannot be told
  apart, a heading error and a mounting turned about the vertical, would seem to be told apart by that
- flexure, flexure rate (3 + 3) rad, rad/s: what the slave is turned besides, second-order Markov, in a
- lever (3) m: of the lever arm, in a
- delay (1) s: a message holds that much earlier than it says

Source: textbook chapter "Inertial navigation", section 2.5.3, eqs. (2-147), (2-155), (2-161) to (2-174).
"""

from __future__ import annotations

from typing import Final

from nav.filter.states import ACCEL_BIAS, GYRO_BIAS, PHI, POSITION, VELOCITY

__all__ = ["ACCEL_BIAS", "GYRO_BIAS", "PHI", "POSITION", "VELOCITY"]

GYRO_AXES: Final = slice(15, 24)
ACCEL_AXES: Final = slice(24, 33)
MOVED: Final = 9
"""States whose rates depend on others: position, velocity and phi, on those before `MOUNTING`."""
MOUNTING: Final = slice(33, 36)
FLEXURE: Final = slice(36, 39)
FLEXURE_RATE: Final = slice(39, 42)
LEVER: Final = slice(42, 45)
DELAY: Final = 45
SIZE: Final = 46

_AXES = ("right", "forward", "up")
NAMES: Final[tuple[str, ...]] = (
    *(f"{what} {axis}" for what in ("position", "velocity", "phi") for axis in ("east", "north", "up")),
    *(f"{what} {axis}" for what in ("gyro bias", "accel bias") for axis in _AXES),
    *(f"gyro axes {a} {b}" if a != b else f"gyro scale {a}" for a in _AXES for b in _AXES),
    *(f"accel axes {a} {b}" if a != b else f"accel scale {a}" for a in _AXES for b in _AXES),
    *(f"{what} {axis}" for what in ("mounting", "flexure", "flexure rate", "lever") for axis in _AXES),
    "delay",
)
"""Names of the states, in their order."""

# The nominal state that they correct: the strapdown state (places X_ of `nav.strapdown.kernels`), then these.
X_ERRORS: Final = 18
"""Place of gyro bias; from there on it is laid out as the states from `GYRO_BIAS` on are."""
X_REST: Final = X_ERRORS + SIZE - MOVED
"""Specific force (3,) in b at which the accelerometers' axes make no error."""
X_SIZE: Final = X_REST + 3


def place(states: slice) -> slice:
    """Where the nominal values of ``states`` (from `GYRO_BIAS` on) stand in the nominal state."""
    return slice(X_ERRORS + states.start - MOVED, X_ERRORS + states.stop - MOVED)
