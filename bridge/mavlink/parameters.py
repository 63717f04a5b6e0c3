"""The resolved configuration as MAVLink parameters: a read-only view of its numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from pymavlink.dialects.v20 import common as dialect

_LENGTH: Final = 16
_SECTIONS: Final = {"source": "SRC", "device": "DEV", "navigator": "NAV", "sink": "SNK"}


def _leaves(value: object, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], float]]:
    if isinstance(value, bool | int | float):
        yield path, float(value)
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from _leaves(item, (*path, str(name)))
    elif isinstance(value, list | tuple):
        for place, item in enumerate(value):
            yield from _leaves(item, (*path, str(place)))


def _shorter(words: list[str]) -> list[str]:
    """One character less: the last vowel inside the longest word that has one, else that word's end."""
    for word in sorted(words, key=len, reverse=True):
        inner = [place for place in range(1, len(word)) if word[place] in "AEIOU"]
        if inner:
            cut = inner[-1]
            return [w[:cut] + w[cut + 1 :] if w is word else w for w in words]
    longest = max(words, key=len)
    return [w[:-1] if w is longest else w for w in words if w]


def _name(path: tuple[str, ...], taken: Mapping[str, float]) -> str:
    head = _SECTIONS.get(path[0], path[0])
    words = [word for part in (head, *path[1:]) for word in part.upper().split("_") if word]
    room, number = _LENGTH, 0
    while True:
        while len("_".join(words)) > room:
            words = _shorter(words)
        name = "_".join(words) + (str(number) if number else "")
        if name not in taken:
            return name
        number += 1
        room = _LENGTH - len(str(number))


def flatten(config: Mapping[str, Any]) -> dict[str, float]:
    """Every number and switch of ``config`` under a unique name of at most 16 characters.

    Names are the path in capitals, sections abbreviated (SRC, DEV, NAV, SNK) and words shortened from
    the longest until they fit, so equal configurations give equal names.
    """
    result: dict[str, float] = {}
    for path, value in _leaves(config, ()):
        result[_name(path, result)] = value
    return result


class Parameters:
    """Answers the parameter protocol; a PARAM_SET is answered with the value as it stays."""

    def __init__(self, values: Mapping[str, float]) -> None:
        self._names = list(values)
        self._values = dict(values)
        self._index = {name: place for place, name in enumerate(self._names)}

    def __len__(self) -> int:
        return len(self._names)

    def answer(self, message: Any) -> Iterator[Any]:
        """PARAM_VALUE messages for a PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            yield from (self._value(place) for place in range(len(self)))
            return
        place = -1
        if kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            place = message.param_index
        else:
            place = self._index.get(_text(message.param_id), -1)
        if 0 <= place < len(self):
            yield self._value(place)

    def _value(self, place: int) -> Any:
        name = self._names[place]
        return dialect.MAVLink_param_value_message(
            name.encode("ascii", "replace"),
            self._values[name],
            dialect.MAV_PARAM_TYPE_REAL32,
            len(self),
            place,
        )


def _text(name: object) -> str:
    raw = name if isinstance(name, bytes) else str(name).encode("ascii", "replace")
    return raw.split(b"\0")[0].decode("ascii", "replace")
