"""What the filter estimates, and where it is kept.

Error states are *computed minus true* (a correction is subtracted), except the misalignment phi, which
follows the naming law: computed ``C = (I - [phi x]) C_nb``, so that the true attitude is
``(I + [phi x])`` times the computed one.

- position (3): metres along n (computed minus true; level axes along the ellipsoid, third the height)
- velocity (3): m/s in n
- phi (3): rad in n
- gyro bias, accel bias (3 + 3): rad/s and m/s^2 in b, of what is subtracted from the sensor
- odometer scale (1): of k in ``true distance = (1 + k) measured distance``
- mounting (2): mu about right and up of v, computed ``C_vb = (I - [mu x]) true C_vb``
- baro bias (1): m, of what is added to the height to predict the barometer
- gyro axes, accel axes (9 + 9): of M, row by row, in ``measured = true + M (true - rest) + bias``: scale
  errors on the diagonal, misalignment beside it. ``rest`` is zero for gyros; for accelerometers it is the
  force felt when navigation began, so that their bias is all that was wrong then. Left out of the filter
  where their initial sigmas are zero
- gnss (3): metres along n, of the slowly varying error of the receiver's position (orbits, ionosphere,
  reflections), which decays to zero with its correlation time; left out where its sigma is zero
- height correction (1): m/s^2, of what a third-order height channel takes off the vertical acceleration,
where
  without errors it would take nothing; left out where there is no such channel

The nominal state that they correct is one float64 vector: the strapdown state (see
`nav.strapdown.kernels`), then the places ``X_`` below.
"""

from __future__ import annotations

from typing import Final

from nav.strapdown.control import U_SIZE

POSITION: Final = slice(0, 3)
VELOCITY: Final = slice(3, 6)
PHI: Final = slice(6, 9)
GYRO_BIAS: Final = slice(9, 12)
ACCEL_BIAS: Final = slice(12, 15)
ODO_SCALE: Final = slice(15, 16)
MOUNTING: Final = slice(16, 18)
BARO_BIAS: Final = slice(18, 19)
GYRO_AXES: Final = slice(19, 28)
ACCEL_AXES: Final = slice(28, 37)
GNSS: Final = slice(37, 40)
HEIGHT_A: Final = slice(40, 41)
BASIC: Final = 19
"""Number of states without the errors of scale and axes."""
FULL: Final = 37
"""Number of states with them."""
RECEIVER: Final = 40
"""Number of states with the receiver's error as well."""
ALL: Final = 41
"""Number of states with the height channel's integral as well."""

X_BG: Final = 18  # gyro bias, 3
X_BA: Final = 21  # accelerometer bias, 3
X_KO: Final = 24  # odometer scale
X_QV: Final = 25  # q_vb, 4
X_BB: Final = 29  # barometer bias
X_MG: Final = 30  # gyro axes, 9
X_MA: Final = 39  # accelerometer axes, 9
X_W: Final = 48  # w_ib_b over the last update, corrected, 3
X_F: Final = 51  # f_b over the last update, corrected, 3
X_A: Final = 54  # mean acceleration of the last update in n (rate of v_n), 3
X_PATH: Final = 57  # integral of the odometer point's velocity in v since the last odometer epoch, 3
X_PT: Final = 60  # and its duration, s
X_Q0: Final = 61  # q_vb as configured or first found, the reference of the mounting shown, 4
X_GB: Final = 65  # slowly varying error of the receiver's position in n, 3
X_ROLL: Final = 68  # variance of the mounting's roll, which no measurement shows
X_F0: Final = 69  # f_b when navigation began, 3
X_TICK: Final = 72  # part of a tick since the odometer's last one, as the last epoch left it: mean, m
X_TICK_VAR: Final = 73  # its variance, m^2
X_TICK_COV: Final = 74  # and its covariance with the errors of the states, ALL
X_WD: Final = X_TICK_COV + ALL  # rate of w_ib_b, rad/s^2, from the last two updates, 3
X_WT: Final = X_WD + 3  # from the middle of the last update, where X_W holds, to its end, s; 0: not measured
X_SIZE: Final = X_WT + 1

# Places in the parameter vector that kernels take.
P_LG: Final = 0  # lever arm IMU to GNSS antenna in b, 3
P_LO: Final = 3  # IMU to odometer point in b, 3
P_LP: Final = 6  # IMU to output point in b, 3
P_SLIP: Final = 9  # side slip per lateral acceleration, s
P_GAP_W: Final = 10  # rate that may pass unseen in a gap, rad/s
P_GAP_A: Final = 11  # acceleration that may pass unseen in a gap, m/s^2
P_ARW: Final = 12  # angle random walk, rad/sqrt(s)
P_VIB_G: Final = 13  # part of the squared difference of two angle increments that is noise
P_VIB_A: Final = 14  # likewise of velocity increments
P_Q: Final = 15  # noise densities of the states, ALL
P_GNSS: Final = P_Q + ALL  # rate at which the receiver's error decays, 1/s
P_U: Final = P_GNSS + 1  # control vector of the strapdown kernel, U_SIZE
P_SIZE: Final = P_U + U_SIZE
