"""Strict reading of TOML into structs; errors name file, key, what was found and what is expected."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
import types
import typing
from collections.abc import Iterable
from typing import Any, TypeVar, cast

import msgspec

from bridge.errors import ConfigError

T = TypeVar("T")


class Table(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Base of everything read from a configuration: no unknown key."""


def wrong(file: str, key: str, found: object, expected: str) -> ConfigError:
    """The one shape of a complaint about a value: ``FILE: KEY: found X, expected Y``."""
    return ConfigError(f"{file}: {key}: found {_show(found)}, expected {expected}")


def unknown(file: str, key: str, found: str, names: Iterable[str]) -> ConfigError:
    """A name that is not in ``names``; the nearest of them is suggested."""
    return wrong(file, key, found, one_of(found, names))


def one_of(found: str, names: Iterable[str]) -> str:
    """Text "one of a, b, c", and the nearest name to ``found`` suggested."""
    known = sorted(names)
    if not known:
        return "nothing here: none is defined"
    near = difflib.get_close_matches(found, known, n=1, cutoff=0.6)
    hint = f'; did you mean "{near[0]}"?' if near else ""
    return f"one of {', '.join(known)}{hint}"


def parse(data: bytes, file: str) -> dict[str, Any]:
    """TOML text to plain tables.

    Raises:
        ConfigError: not UTF-8, not TOML, or a number that is not finite.
    """
    try:
        table = tomllib.loads(data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: not UTF-8 text ({error.reason} at byte {error.start})") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{file}: not valid TOML: {error}") from error
    _finite(table, file, "")
    return table


def convert(table: object, target: type[T], file: str, key: str = "") -> T:
    """``table`` as ``target``, no value coerced but an integer where a float is meant.

    Raises:
        ConfigError: an unknown or missing key, a wrong type or a broken constraint, with its dotted key.
    """
    try:
        return msgspec.convert(table, target)
    except msgspec.ValidationError as error:
        raise _diagnose(table, target, file, key, str(error)) from error


def _finite(value: object, file: str, key: str) -> None:
    if isinstance(value, float):
        if not math.isfinite(value):
            raise wrong(file, key, value, "a finite number")
    elif isinstance(value, dict):
        for name, item in value.items():
            _finite(item, file, _join(key, name))
    elif isinstance(value, list):
        for place, item in enumerate(value):
            _finite(item, file, f"{key}[{place}]")


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _show(found: object) -> str:
    if isinstance(found, str):
        return f'"{found}"'
    if isinstance(found, bool):
        return str(found).lower()
    if isinstance(found, dict):
        return "a table"
    text = repr(found)
    return text if len(text) <= 60 else text[:57] + "..."


def _members(target: Any) -> tuple[Any, ...]:
    """The alternatives of a union, or the type alone."""
    origin = typing.get_origin(target)
    if origin is typing.Union or origin is types.UnionType:
        return typing.get_args(target)
    return (target,)


def _fails(value: object, target: Any) -> str | None:
    try:
        msgspec.convert(value, target)
    except msgspec.ValidationError as error:
        return str(error)
    return None


def _diagnose(value: object, target: Any, file: str, key: str, message: str) -> ConfigError:
    """Find the innermost value at fault and say what is wrong with it."""
    for member in _members(target):
        origin = typing.get_origin(member)
        if isinstance(member, type) and issubclass(member, msgspec.Struct) and isinstance(value, dict):
            return _diagnose_struct(value, member, file, key, message)
        if origin is dict and isinstance(value, dict):
            inner = typing.get_args(member)[1]
            for name, item in value.items():
                if (text := _fails(item, inner)) is not None:
                    return _diagnose(item, inner, file, _join(key, name), text)
        if origin in (list, tuple) and isinstance(value, list):
            arguments = typing.get_args(member)
            kinds = (
                arguments if origin is tuple and arguments[-1] is not Ellipsis else arguments[:1] * len(value)
            )
            for place, (item, inner) in enumerate(zip(value, kinds, strict=False)):
                if (text := _fails(item, inner)) is not None:
                    return _diagnose(item, inner, file, f"{key}[{place}]", text)
    return wrong(file, key or "the file", value, _expected(message))


def _diagnose_struct(
    value: dict[str, object], member: type[msgspec.Struct], file: str, key: str, message: str
) -> ConfigError:
    fields = {field.encode_name: field for field in msgspec.structs.fields(member)}
    for name in value:
        if name not in fields:
            expected = one_of(name, fields)
            return ConfigError(f"{file}: {_join(key, name)}: found an unknown key, expected {expected}")
    for name, field in fields.items():
        if name not in value:
            if field.required:
                return ConfigError(
                    f"{file}: {_join(key, name)}: found nothing, expected this key to be given"
                )
        elif (text := _fails(value[name], field.type)) is not None:
            return _diagnose(value[name], field.type, file, _join(key, name), text)
    # the fields are right one by one, so the struct's own __post_init__ spoke
    return ConfigError(f"{file}: {key or 'the file'}: {_plain(message)}")


def _plain(message: str) -> str:
    return re.sub(r" - at `[^`]*`$", "", message).replace("`", "")


def _expected(message: str) -> str:
    text = _plain(message)
    match = re.match(r"Expected (.*?)(?:, got .*)?$", text)
    if match:
        words = {"float": "a number", "int": "an integer", "str": "text", "bool": "true or false"}
        found = match.group(1)
        for name, word in words.items():
            found = re.sub(rf"\b{name}\b", word, found)
        return found.replace("object", "a table").replace("array", "a list")
    return text[:1].lower() + text[1:]


def plain(value: object) -> Any:
    """A struct as plain tables without its unset keys (TOML has no null)."""
    return _without_none(cast(object, msgspec.to_builtins(value)))


def _without_none(value: object) -> object:
    if isinstance(value, dict):
        return {name: _without_none(item) for name, item in value.items() if item is not None}
    if isinstance(value, list):
        return [_without_none(item) for item in value]
    return value
