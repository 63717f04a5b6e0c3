"""What an alignment says while it runs, and what it hands over when it is done."""

from __future__ import annotations

from dataclasses import dataclass

from nav.types import Vector


@dataclass(frozen=True, slots=True)
class AlignStatus:
    """The one status of every alignment stage.

    ``estimate`` is q_gb (4,), or None while attitude is not known; ``covariance`` (3, 3) rad^2 is that of
    phi about east, north, up, with true C_gb = (I + [phi x]) estimated C_gb; ``limit`` (3,) rad is
    the standard deviation that these sensors cannot beat in the time given. ``progress`` runs from
    0 to 1. ``done`` says that the stage has nothing to add; ``refusal`` says why it cannot go on, and that
    it started again.
    """

    estimate: Vector | None
    covariance: Vector
    limit: Vector
    progress: float
    done: bool
    refusal: str | None = None


@dataclass(frozen=True, slots=True)
class NavInit:
    """Where navigation starts: the state of the IMU point at ``t_ns`` and how far it is to be trusted.

    Position ``lat``, ``lon`` (rad), ``height`` (m above the ellipsoid); ``v_g`` (3,) m/s east, north,
    up; ``q_gb`` (4,) takes b to east-north-up. ``P_phi`` (3, 3) rad^2 is the covariance of phi about
    east, north, up, ``sigma_v`` (3,) m/s, ``sigma_p`` (3,) m east, north, up. ``gyro_bias`` (3,) rad/s and
    ``accel_bias`` (3,) m/s^2 in b are to be subtracted from the increments' rates, and are known to
    ``sigma_gyro_bias`` and ``sigma_accel_bias`` (3,). ``C_vb`` (3, 3) takes b to the vehicle axes, with
    ``sigma_mounting`` (3,) rad about right, forward, up of the vehicle; both are None where the alignment
    has not estimated the mounting.
    """

    t_ns: int
    lat: float
    lon: float
    height: float
    v_g: Vector
    q_gb: Vector
    P_phi: Vector
    sigma_v: Vector
    sigma_p: Vector
    gyro_bias: Vector
    accel_bias: Vector
    sigma_gyro_bias: Vector
    sigma_accel_bias: Vector
    C_vb: Vector | None = None
    sigma_mounting: Vector | None = None
