"""From the samples of captures to the intervals of a plan, and what does not fit when it does not.

Rests are found in the counts themselves; each is compared with the plan by where gravity is and by how the
unit was turned since the rest before, as well as a rough calibration can tell. Where the table tells its
angles, attitudes and what it turned by are as told and no longer the plan's, which must only be near.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Final

import numpy as np

from nav import rotation
from nav.calibrate.encoder import Encoder
from nav.calibrate.intervals import Interval, resting, sums, turning
from nav.calibrate.model import LETTERS
from nav.calibrate.plan import Position, Rotation, Step, letters_of
from nav.calibrate.stream import BLOCK_S, Nominal, Rest, Stream, rests
from nav.types import Vector

SETTLE_S: Final = 1.0
"""So much at either end of a rest is not used: the table may still be on its way."""
_SHORTEST_S: Final = 3.0 * SETTLE_S
_DWELL: Final = 0.8  # of its planned time a position must have rested
_ANGLE: Final = np.radians(6.0)  # what a rough calibration may make of an attitude
_TURNED: Final = 0.03  # what it may make of a rotation, as a share
_TOLD: Final = np.radians(3.0)  # from the plan's attitude to that of an encoder


class Disagreement(ValueError):
    """A capture is not what the plan says; the text says where and how."""


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """The rests of all captures, and the nominal unit that they are looked at with."""

    rests: tuple[Rest, ...]
    nominal: Nominal


def segment(
    streams: Sequence[Stream], steps: Sequence[Step], nominal: Nominal, ratios: Sequence[float]
) -> list[Interval]:
    """The interval of every step, with its counts; ``ratios`` is true time over ``dt`` for each stream.

    Raises:
        Disagreement: a step is missing, is another one, or its samples cannot be used; axes are swapped.
    """
    reading = _Reading(tuple(r for s in streams for r in rests(s, nominal, _SHORTEST_S)), nominal)
    try:
        found = list(_match(reading, steps))
    except Disagreement:
        swapped = _swapped(reading, steps)
        if swapped is not None:
            raise Disagreement(swapped) from None
        raise
    true = {id(stream): ratio for stream, ratio in zip(streams, ratios, strict=True)}
    return [
        _interval(step, rest, true[id(rest[-1].stream)], nominal, *_shown(number, step, rest))
        for number, (step, rest) in enumerate(found)
    ]


def _up(C_gb: Vector) -> Vector:
    return np.asarray(C_gb[2])


def _between(a: Vector, b: Vector) -> float:
    """Angle between two directions, rad."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _apart(A: Vector, B: Vector) -> float:
    """Angle between two attitudes, rad."""
    q = rotation.quat_from_dcm(np.asarray(A).T @ B)
    return float(np.linalg.norm(rotation.rotvec_from_quat(q)))


def _match(reading: _Reading, steps: Sequence[Step]) -> Iterator[tuple[Step, tuple[Rest, ...]]]:
    """Each step with its rest, or with the rests before and after its rotation."""
    at = -1  # the last rest used
    C: Vector | None = None  # the attitude there, by the plan
    for number, step in enumerate(steps):
        first = at + 1
        if isinstance(step, Rotation) and C is not None and _apart(C, step.C_gb) < _ANGLE:
            first = at  # the table is there already
        wanted = _DWELL * step.seconds if isinstance(step, Position) else 0.0
        last_step: tuple[Rest, Vector | None] | None = None
        for k in range(first, len(reading.rests)):
            rest = reading.rests[k]
            if k > at:
                C = _carried(C, reading.rests[k - 1] if k else None, rest)
            if rest.seconds < wanted and not _there(rest, C, step.C_gb):
                continue  # a stop on the way
            last_step = (rest, C)
            at = k
            break
        if last_step is None:
            end = "ends before it" if reading.rests else "has no rest at all"
            raise Disagreement(f"{_title(number, step)}: missing: the capture {end}")
        rest, seen = last_step
        if not _there(rest, seen, step.C_gb):
            raise Disagreement(_elsewhere(reading, steps, number, at, seen))
        if rest.seconds < wanted:
            raise Disagreement(
                f"{_title(number, step)}: rested {rest.seconds:.0f} s, the plan says {step.seconds:g} s"
            )
        C = step.C_gb
        if isinstance(step, Position):
            _require_sound(step, (rest,))
            yield step, (rest,)
            continue
        if at + 1 == len(reading.rests) or reading.rests[at + 1].stream is not rest.stream:
            raise Disagreement(f"{_title(number, step)}: missing: the capture ends before it")
        after = reading.rests[at + 1]
        _require_sound(step, (rest, after))
        if np.linalg.norm(after.swept - step.turned) > _TURNED * np.linalg.norm(step.turned):
            raise Disagreement(_otherwise(number, step, step.turned, after.swept, "capture"))
        at += 1
        yield step, (rest, after)


def _otherwise(number: int, step: Step, planned: Vector, seen: Vector, whose: str) -> str:
    return (
        f"{_title(number, step)}: the plan turns by {_degrees(planned)} deg about x, y, z, the {whose} by "
        f"{_degrees(seen)}"
    )


def _shown(number: int, step: Step, found: tuple[Rest, ...]) -> tuple[Vector, Vector]:
    """Attitude C_gb (3, 3) at the beginning of a step and what it turns by (3,) rad, as told or planned."""
    encoder = found[0].stream.encoder
    turned = np.zeros(3) if isinstance(step, Position) else step.turned
    if encoder is None:
        return step.C_gb, turned
    told = [_told(number, step, encoder, rest) for rest in found]
    if isinstance(step, Position):
        return told[0], turned
    stream, inside = found[0].stream, _used(step, found)
    seen = encoder.turned(told[0], stream.time(inside.start), stream.time(inside.stop), told[1])
    if np.linalg.norm(seen - turned) > np.pi:
        raise Disagreement(_otherwise(number, step, turned, seen, "table's encoder"))
    return told[0], seen


def _told(number: int, step: Step, encoder: Encoder, rest: Rest) -> Vector:
    """The attitude (3, 3) in which the encoder says that the table rested."""
    stream, inside = rest.stream, _inside(rest)
    C_gb = encoder.attitude(stream.time(inside.start), stream.time(inside.stop))
    if C_gb is None:
        raise Disagreement(f"{_title(number, step)}: no angle of the table in it ({stream.name})")
    off = _apart(C_gb, step.C_gb)
    if off > _TOLD:
        letters = letters_of(np.round(C_gb))
        text = f", about {letters}" if letters is not None else ""
        raise Disagreement(
            f"{_title(number, step)}: the table's encoder tells an attitude{text}, {np.degrees(off):.1f} deg "
            "from the plan's"
        )
    return C_gb


def _carried(C: Vector | None, before: Rest | None, rest: Rest) -> Vector | None:
    """The attitude after the way to ``rest``; None at the beginning of a capture."""
    if C is None or before is None or before.stream is not rest.stream:
        return None
    return np.asarray(C @ rotation.dcm_from_quat(rest.turned))


def _there(rest: Rest, C: Vector | None, C_gb: Vector) -> bool:
    if _between(rest.force, _up(C_gb)) > _ANGLE:
        return False
    return C is None or _apart(C, C_gb) < _ANGLE


def _title(number: int, step: Step) -> str:
    return f"step {number + 1} ({step.name})"


def _degrees(angle: Vector) -> str:
    return str([round(value) for value in np.degrees(angle).tolist()])


def _elsewhere(reading: _Reading, steps: Sequence[Step], number: int, at: int, C: Vector | None) -> str:
    """Why the rest number ``at`` is not that of the step that should be there."""
    step, rest = steps[number], reading.rests[at]
    for later in range(number + 1, min(len(steps), number + 4)):
        if isinstance(steps[later], Position) and _there(rest, C, steps[later].C_gb):
            gone = ", ".join(_title(k, steps[k]) for k in range(number, later))
            return f"{gone}: missing: the capture goes on with {_title(later, steps[later])}"
    off = _between(rest.force, _up(step.C_gb))
    if off > _ANGLE:
        u = rest.force / np.linalg.norm(rest.force)
        where = "[" + ", ".join(f"{value:+.2f}" for value in u) + "]"
        return (
            f"{_title(number, step)}: up is {np.degrees(off):.0f} deg from where the plan has it: along "
            f"{where} in the unit's axes"
        )
    assert C is not None  # or it would have been there
    seen = letters_of(np.round(C))
    text = f", to about {seen}" if seen is not None else ""
    return (
        f"{_title(number, step)}: the unit was turned{text}, which is {np.degrees(_apart(C, step.C_gb)):.0f} "
        "deg from the plan's attitude"
    )


def _swapped(reading: _Reading, steps: Sequence[Step]) -> str | None:
    """Which axes are exchanged, where that and nothing else is wrong; None where it is not."""
    signed = [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    # forces and rotations may be wrong apart or together: those of a unit that is mounted another way round
    for forces, gyros, what in (
        (True, True, "the unit is mounted with other axes than the plan's"),
        (True, False, "the accelerometers' axes are swapped"),
        (False, True, "the gyros' axes are swapped"),
    ):
        for P in signed:
            if np.array_equal(P, np.eye(3)) or (gyros and forces and np.linalg.det(P) < 0.0):
                continue
            changed = tuple(_changed(rest, P, forces, gyros) for rest in reading.rests)
            try:
                list(_match(_Reading(changed, reading.nominal), steps))
            except Disagreement:
                continue
            return f"{what}: {_named(P)}"
    return None


def _changed(rest: Rest, P: Vector, forces: bool, gyros: bool) -> Rest:
    """A rest as it would be if P (3, 3), a signed permutation, came after the sensors."""
    force = P @ rest.force if forces else rest.force
    if not gyros:
        return replace(rest, force=force)
    angle = P @ rest.turned[1:]
    return replace(rest, force=force, turned=np.append(rest.turned[0], angle), swept=P @ rest.swept)


def _named(P: Vector) -> str:
    words = []
    for k in range(3):
        j = int(np.argmax(np.abs(P[k])))
        if (j, P[k, j]) != (k, 1.0):
            words.append(
                f"the plan's {LETTERS[k]} is the capture's {'-' if P[k, j] < 0.0 else ''}{LETTERS[j]}"
            )
    return ", ".join(words)


def _settle(stream: Stream) -> int:
    return round(SETTLE_S / float(np.median(stream.dt)))


def _inside(rest: Rest) -> slice:
    """The samples of a rest, without its ends."""
    settle = _settle(rest.stream)
    return slice(rest.first + settle, rest.last - settle)


def _used(step: Step, found: tuple[Rest, ...]) -> slice:
    """The samples of a step: the inside of a rest, or a rotation with some rest at either end."""
    if isinstance(step, Position):
        return _inside(found[0])
    settle = _settle(found[0].stream)
    before, after = found
    return slice(max(before.first, before.last - settle), min(after.last, after.first + settle))


def _require_sound(step: Step, found: tuple[Rest, ...]) -> None:
    """Raise Disagreement where samples of a step cannot be used."""
    stream = found[0].stream
    for word, places in stream.bad.items():
        count = int(np.count_nonzero(places[_used(step, found)]))
        if count:
            raise Disagreement(f"{step.name}: {word} in {count} samples ({stream.name})")


def _interval(
    step: Step, found: tuple[Rest, ...], ratio: float, nominal: Nominal, C_gb: Vector, turned: Vector
) -> Interval:
    """The sums of a step over its samples, and where the table was: from ``C_gb`` on it ``turned``."""
    stream = found[0].stream
    inside = _used(step, found)
    counts, dt = stream.counts[inside], stream.dt[inside] * ratio
    plus, minus = sums(counts)
    if isinstance(step, Position):
        shown = resting(C_gb, float(dt.sum()))
    else:
        # the rest before it says what of the rate is bias
        settle = inside.stop - found[1].first
        still = slice(max(found[0].first, inside.start - 5 * settle), found[0].last - round(BLOCK_S * settle))
        rate = nominal.motion(stream.counts[still], stream.dt[still])[0].sum(axis=0) / stream.dt[still].sum()
        angle = (nominal.motion(counts, dt)[0] - rate * dt[:, None]) @ step.axis
        shown = turning(C_gb, turned, np.concatenate((np.zeros(1), np.cumsum(angle))), dt)
    return Interval(
        step.name,
        isinstance(step, Rotation),
        stream.begin + stream.time(inside.start),
        float(dt.sum()),
        turned,
        *shown,
        plus,
        minus,
        float(stream.temperature[inside].mean()) if len(stream.temperature) else math.nan,
    )
