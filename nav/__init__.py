"""Navigation mathematics: SI units and radians, arrays in, arrays out. No I/O, no clock.

Every name obeys one law.

Frames: ``i`` inertial, ``e`` Earth-fixed, ``n`` the local-level frame in use, ``g`` geographic
east-north-up, ``c`` computed, ``p`` platform, ``b`` IMU body right-forward-up, ``s`` one sensor's
axis, ``v`` vehicle right-forward-up, ``a`` the master's body, ``i0`` and ``b0`` frozen at the start
of alignment.

``C_nb`` takes b to n: ``f_n = C_nb @ f_b``; ``q_nb`` is the same rotation as a unit quaternion
(w, x, y, z). ``w_ib_b`` is the rate of b with respect to i, in b. Adjacent letters cancel when read
from right to left; a line in which they do not is a bug.

Positions are ``lat``, ``lon`` (rad) and ``height`` (m above the ellipsoid). ``v_n`` is east, north,
up when n is g. ``heading`` is clockwise from north in [0, 2 pi), ``pitch`` nose up, ``roll`` right
side down. Misalignment ``phi``: ``C_pn = I - [phi x]``.

Time is an ``int`` of nanoseconds, named ``_ns``; an interval in seconds is ``dt``.
"""
