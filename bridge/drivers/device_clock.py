"""From a device's counter to engine time.

A frame arrives after the instant it reports, late by a shortest transport delay (configured) and by
jitter that is never negative. So the points (device time, arrival minus device time) lie above a line
whose slope is the drift of the device's clock and whose height is its offset, and the least delayed of
them touch it. The line is the edge of their lower convex hull over the centroid, which has the least
summed distance among all lines below the points (Moon, Skelly, Towsley 1999, "Estimation and removal of
clock skew from network delay measurements").

Of every stretch of device time only the least delayed point is kept. Stretches begin short and double
when there are too many, so the window grows from the first instants to about a minute while work and
memory stay bounded.

A count far from the line is one of two things. Where counts go on from the last one the device is well and
its frames are late, because a host or a link is overloaded: they are dated by the line, which they do not
touch. Where counts go back or jump ahead the device began anew, and so does the line.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

POINTS: Final = 32  # stretches remembered
FIRST_STRETCH: Final = 62.5e6  # ns, so that a line exists after a fraction of a second
LAST_STRETCH: Final = (
    2e9  # ns, so that the window is at most about 64 s: crystals follow temperature in minutes
)
FORGET: Final = 256e9  # ns, a point older than this says nothing about today's line
SLOPE_AFTER: Final = 8  # points, and
SLOPE_SPAN: Final = 1e9  # ns: with less the jitter of two points makes a worse slope than none
MAX_DRIFT: Final = 0.02  # beyond the worst uncalibrated oscillator
EARLY: Final = 20e6  # ns before the line: no jitter does that, the counter has jumped ahead
LATE: Final = 250e6  # ns after the line: says nothing about the line any more
SETTLED: Final = 100_000_000  # ns of arrivals that must agree on a new offset before it is believed
STOOD: Final = 30_000_000_000  # ns likewise, where counts go on as if nothing had been: a stall ends
AGREE: Final = 20e6  # ns within which they must agree; frames of a late burst do not, they catch up

_NEVER: Final = -(2**62)


class DeviceClock:
    """One oscillator: the line from its time to engine time, fed through its `ClockPort` objects.

    Counters on one clock count from a common zero, each modulo its own width. The widest of them (a GNSS
    receiver does not wrap) says where a narrower one stands; a narrower one whose width does not divide
    the widest is stamped by its arrival until a counter that never wraps has been heard.
    """

    __slots__ = (
        "_base",
        "_height",
        "_low",
        "_low_d",
        "_low_x",
        "_points",
        "_shift",
        "_slope",
        "_stretch",
        "_stretch_end",
        "_widest",
        "_x",
        "resets",
    )

    def __init__(self) -> None:
        self.resets = 0
        """How often a counter restarted or jumped, and the line was begun anew."""
        # width of the counter that defines device time; None: never wraps; 0: none heard yet
        self._widest: int | None = 0
        self._shift = 0  # device time of the widest counter minus our axis
        self._base = 0  # engine time minus axis at the seed, ns; the line below is relative to it
        self._x = 0.0  # axis of the newest point, ns
        self._height = 0.0
        self._slope = 0.0
        self._points: list[tuple[float, float]] = []
        self._stretch = FIRST_STRETCH
        self._stretch_end = 0.0
        self._low = self._low_x = self._low_d = 0.0

    def port(self, modulus_ns: int | None, latency_ns: int) -> ClockPort:
        """A counter driven by this clock that wraps at ``modulus_ns`` (None: never)."""
        return ClockPort(self, modulus_ns, latency_ns)

    @property
    def drift_ppm(self) -> float:
        """How much faster than the host the device counts, parts per million."""
        return -1e6 * self._slope / (1.0 + self._slope)

    def seed(self, counter_ns: int, arrival_ns: int, modulus_ns: int | None) -> None:
        """Begin a new line at one point, device time being this counter's."""
        self._widest = modulus_ns
        self._shift = 0
        self._base = arrival_ns - counter_ns
        self._height = self._slope = 0.0
        self._points = []
        self._stretch = FIRST_STRETCH
        self._x = float(counter_ns)
        self._begin(self._x, 0.0)

    def _begin(self, x: float, d: float) -> None:
        self._stretch_end = x + self._stretch
        self._low = d - self._slope * x
        self._low_x = x
        self._low_d = d

    def axis(
        self, counter_ns: int, arrival_ns: int, modulus_ns: int | None, good_ns: int, good_arrival_ns: int
    ) -> int | None:
        """Place a counter on the axis; None where it cannot be told.

        ``good_ns`` is the place of the port's last good count, ``good_arrival_ns`` its arrival. If that was
        less than half a wrap ago the count is the next one after it, however late; otherwise the latest that
        the line allows. An eighth of a wrap is left for a count that goes back, or arrives before the line.
        """
        widest = self._widest
        if widest == 0:
            self.seed(counter_ns, arrival_ns, modulus_ns)
            return counter_ns
        if modulus_ns == widest:
            if modulus_ns is None:
                return counter_ns - self._shift
        elif widest is not None:
            if modulus_ns is None or modulus_ns > widest:
                # a wider counter joins: the axis is its time less a whole number of the old width
                ahead = counter_ns - self._expected(arrival_ns)
                self._shift = (ahead + widest // 2) // widest * widest
                self._widest = modulus_ns
            elif widest % modulus_ns:
                return None
        place = counter_ns - self._shift
        if modulus_ns is None:
            return place
        back = modulus_ns >> 3
        if arrival_ns - good_arrival_ns < modulus_ns >> 1:
            first = good_ns - back
            return first + (place - first) % modulus_ns
        latest = self._expected(arrival_ns) + back
        return latest - (latest - place) % modulus_ns

    def _expected(self, arrival_ns: int) -> int:
        """Where on the axis a count that arrives now is, by the line."""
        return arrival_ns - self._base - round(self._height + self._slope * self._x)

    def defined_by(self, modulus_ns: int | None) -> bool:
        """Whether a counter of this width is the widest: the one that says what device time is."""
        return self._widest == modulus_ns

    def residual(self, axis_ns: int, arrival_ns: int) -> float:
        """How much later (ns) than the line a point is."""
        return (arrival_ns - axis_ns - self._base) - (self._height + self._slope * axis_ns)

    def time(self, axis_ns: int) -> int:
        """Engine time at a place on the axis."""
        return axis_ns + self._base + round(self._height + self._slope * axis_ns)

    def explain(self, axis_ns: int, arrival_ns: int) -> int | None:
        """Take a point into the line; its engine time, or None where it is too far from the line."""
        slope, height = self._slope, self._height
        delay = arrival_ns - axis_ns - self._base
        x = float(axis_ns)
        above = delay - slope * x
        if not -EARLY < above - height < LATE:
            return None
        if above < height:  # no frame arrives before it is sent: the line was too high
            self._height = height = above
        if x > self._x:
            self._x = x
        if x >= self._stretch_end:
            self._points.append((self._low_x, self._low_d))
            self._fit(x)
            self._begin(x, float(delay))
            slope = self._slope
            height = self._height = min(self._height, delay - slope * x)
        elif above < self._low:
            self._low = above
            self._low_x = x
            self._low_d = float(delay)
        return axis_ns + self._base + round(height + slope * x)

    def _fit(self, now: float) -> None:
        points = self._points
        if len(points) > POINTS:
            if self._stretch < LAST_STRETCH:
                self._stretch *= 2.0
                slope = self._slope
                points = [
                    min(points[i : i + 2], key=lambda p: p[1] - slope * p[0])
                    for i in range(0, len(points), 2)
                ]
            else:
                del points[0]
        points = [point for point in points if point[0] > now - FORGET] or points[-1:]
        points.sort()
        self._points = points
        if len(points) >= SLOPE_AFTER and points[-1][0] - points[0][0] >= SLOPE_SPAN:
            self._slope = min(max(_lower_edge(points), -MAX_DRIFT), MAX_DRIFT)
        slope = self._slope
        self._height = min([d - slope * x for x, d in points])


def _lower_edge(points: list[tuple[float, float]]) -> float:
    """Slope of the lower convex hull's edge over the centroid of points sorted by x."""
    hull: list[tuple[float, float]] = []
    for x, d in points:
        while len(hull) >= 2:
            (x1, d1), (x2, d2) = hull[-2], hull[-1]
            if (x2 - x1) * (d - d1) > (d2 - d1) * (x - x1):
                break
            hull.pop()
        hull.append((x, d))
    middle = sum([x for x, _ in points]) / len(points)
    slope = 0.0
    for (x1, d1), (x2, d2) in pairwise(hull):
        if x2 > x1:
            slope = (d2 - d1) / (x2 - x1)
        if x2 >= middle:
            break
    return slope


class ClockPort:
    """One counter of one device: wraps, resets and a strictly increasing result."""

    __slots__ = (
        "_clock",
        "_good_arrival",
        "_good_axis",
        "_last_axis",
        "_latency",
        "_modulus",
        "_odd",
        "_odd_residual",
        "_odd_since",
        "_out",
        "_resets",
        "elapsed_ns",
    )

    def __init__(self, clock: DeviceClock, modulus_ns: int | None, latency_ns: int) -> None:
        self._clock = clock
        self._modulus = modulus_ns
        self._latency = latency_ns
        self._out = _NEVER
        self._resets = 0
        self._last_axis: int | None = None
        self._good_axis = _NEVER  # of the last count that the line could explain, or that was late only
        self._good_arrival = _NEVER
        self._odd = False
        self._odd_since = 0
        self._odd_residual = 0.0
        self.elapsed_ns: int | None = None
        """Device time between the last two counts, wraps removed; None at the first and at a restart."""

    def stamp(self, counter_ns: int, rx_ns: int) -> int:
        """Engine time (ns) at which the device read ``counter_ns``; later than any before."""
        clock = self._clock
        arrival = rx_ns - self._latency
        if self._resets != clock.resets:  # by another counter on this clock
            self._resets = clock.resets
            self._last_axis = None
            self._good_axis = self._good_arrival = _NEVER
        axis = clock.axis(counter_ns, arrival, self._modulus, self._good_axis, self._good_arrival)
        if axis is None:
            self.elapsed_ns = self._last_axis = None
            out = arrival
        else:
            last = self._last_axis
            self.elapsed_ns = None if last is None else axis - last
            explained = clock.explain(axis, arrival)
            if explained is not None:
                self._odd = False
                out = explained
                if axis > self._good_axis:  # a frame that was overtaken does not set the clock back
                    self._last_axis = self._good_axis = axis
                    self._good_arrival = arrival
            else:
                out = self._outlier(axis, counter_ns, arrival)
        if out <= self._out:
            out = self._out + 1
        self._out = out
        return out

    def _outlier(self, axis: int, counter_ns: int, arrival: int) -> int:
        clock = self._clock
        residual = clock.residual(axis, arrival)
        goes_on = residual > 0.0 and axis > self._good_axis
        patience = STOOD if goes_on else SETTLED
        self._last_axis = axis
        if not self._odd or abs(residual - self._odd_residual) > AGREE:
            self._odd = True
            self._odd_since = arrival
            self._odd_residual = residual
        elif arrival - self._odd_since >= patience and clock.defined_by(self._modulus):
            self._odd = False
            clock.resets += 1
            self._resets = clock.resets
            clock.seed(counter_ns, arrival, self._modulus)
            self._last_axis = self._good_axis = counter_ns
            self._good_arrival = arrival
            return arrival
        if goes_on:
            self._good_axis = axis
            self._good_arrival = arrival
            return clock.time(axis)
        return arrival
