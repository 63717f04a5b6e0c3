"""The configuration of a bridge: loaded strictly, before any bus is opened, and able to travel in a
capture.

A configuration is a TOML file with the tables ``[source.NAME]``, ``[device.NAME]``, ``[navigator.NAME]``
and ``[sink.NAME]``. Files that it names are sought beside it, then among the packaged ones
(bridge/configs/).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import msgspec
import tomli_w

from bridge.errors import ConfigError
from bridge.followers import in_order
from bridge.options import (
    SOURCE_OPTIONS,
    DeviceOptions,
    MavlinkSource,
    NavigatorOptions,
    SinkOptions,
    SourceOptions,
)
from bridge.strict import convert, one_of, parse, plain, unknown, wrong
from bridge.wire import DBC_ATTACHMENT, read_contract
from dbc.codec import Contract, contract

PACKAGED: Final = Path(__file__).parent / "configs"
ATTACHMENT: Final = "config.toml"
"""Name of the resolved configuration among a capture's attachments."""

Reader = Callable[[str, str], tuple[str, bytes]]
"""From the key that names a file and that name to the file's own name and bytes."""


@dataclass(frozen=True)
class Config:
    """A checked configuration with every file it needs.

    ``file`` is the name that error messages give it. ``files`` holds the files that devices and sinks
    name, by the name their options hold; names are unique, so the whole can be kept as a flat set of
    attachments. ``contract`` is what frames on the bus mean: the packaged one, in a replay the capture's.
    ``keys`` are the secrets of the sources that have one, which no attachment ever holds.
    """

    file: str
    sources: dict[str, SourceOptions]
    devices: dict[str, DeviceOptions]
    navigators: dict[str, NavigatorOptions]
    sinks: dict[str, SinkOptions]
    files: dict[str, bytes]
    contract: Contract = field(default_factory=contract)
    keys: dict[str, bytes] = field(default_factory=dict, repr=False)

    @classmethod
    def load(cls, where: str | Path) -> Config:
        """Load a configuration by path, or a packaged one by name (``bench`` or ``bench.toml``).

        Raises:
            ConfigError: it, or a file it names, is not there or is wrong.
        """
        path = _find(str(where))

        def read(key: str, name: str) -> tuple[str, bytes]:
            for folder in (path.parent, PACKAGED):
                if (folder / name).is_file():
                    return Path(name).name, _bytes(folder / name)
            raise ConfigError(
                f'{path.name}: {key}: found "{name}", expected a file in {path.parent} or one of '
                f"{', '.join(packaged_files())}"
            )

        config = _build(_bytes(path), path.name, read)
        return replace(config, keys=_keys(config, path))

    @classmethod
    def from_attachments(cls, attachments: Mapping[str, bytes]) -> Config:
        """Rebuild what `attachments` made; nothing outside of them is read.

        Raises:
            ConfigError: the configuration, the contract or a file that is named is missing or wrong.
        """
        config = cls.from_files(attachments)
        return replace(config, contract=attached_contract(attachments))

    @classmethod
    def from_files(cls, files: Mapping[str, str | bytes]) -> Config:
        """A configuration that was made here, ``config.toml`` among ``files``, with the packaged contract.

        Raises:
            ConfigError: the configuration or a file it names is missing or wrong.
        """
        if ATTACHMENT not in files:
            raise ConfigError(f"attachments: found no {ATTACHMENT}, expected the resolved configuration")
        texts = {name: text.encode() if isinstance(text, str) else text for name, text in files.items()}

        def read(key: str, name: str) -> tuple[str, bytes]:
            if name not in texts:
                raise unknown(ATTACHMENT, key, name, texts)
            return name, texts[name]

        return _build(texts[ATTACHMENT], ATTACHMENT, read)

    @classmethod
    def for_capture(cls, attachments: Mapping[str, bytes], where: str | Path | None = None) -> Config:
        """A capture's own configuration, or the one at ``where``; the contract is the capture's.

        Raises:
            ConfigError: as `load` and `from_attachments`.
        """
        if where is None:
            return cls.from_attachments(attachments)
        return replace(cls.load(where), contract=attached_contract(attachments))

    def resolved_toml(self) -> str:
        """The configuration with every default spelled out and every file by its attachment's name."""
        return tomli_w.dumps(
            {
                section: {name: plain(options) for name, options in table.items()}
                for section, table in (
                    ("source", self.sources),
                    ("device", self.devices),
                    ("navigator", self.navigators),
                    ("sink", self.sinks),
                )
            }
        )

    def attachments(self) -> dict[str, bytes]:
        """Everything `from_attachments` needs, by name."""
        return {
            ATTACHMENT: self.resolved_toml().encode(),
            DBC_ATTACHMENT: self.contract.text,
            **self.files,
        }

    def source_number(self, name: str) -> int:
        """Number of a source in the recorded stream: 1 for the first in the file."""
        return list(self.sources).index(name) + 1


def attached_contract(attachments: Mapping[str, bytes]) -> Contract:
    """The contract that a capture was recorded with.

    Raises:
        ConfigError: it is missing or damaged.
    """
    if DBC_ATTACHMENT not in attachments:
        raise ConfigError(f"attachments: found no {DBC_ATTACHMENT}, expected the contract of the frames")
    return read_contract(attachments[DBC_ATTACHMENT])


def packaged_files() -> list[str]:
    """Names of the packaged configurations and of the files they use."""
    return sorted(path.name for path in PACKAGED.iterdir() if path.suffix in (".toml", ".dbc"))


def packaged_configs() -> list[str]:
    """Names under which `Config.load` finds a packaged configuration."""
    return sorted(path.stem for path in PACKAGED.glob("*.toml") if b"[source." in path.read_bytes())


def _find(where: str) -> Path:
    path = Path(where)
    if path.is_file():
        return path
    if path.parent == Path():
        for name in (where, f"{where}.toml"):
            if (PACKAGED / name).is_file():
                return PACKAGED / name
    problem = "is a folder" if path.is_dir() else "no such file"
    raise ConfigError(
        f"{where}: {problem}; expected a path or, packaged, {one_of(path.stem, packaged_configs())}"
    )


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error


def _build(data: bytes, file: str, read: Reader) -> Config:
    # the tables of drivers and sinks import their own machinery, which may import this module
    from bridge.drivers import DRIVERS
    from bridge.sinks import SINKS

    document = parse(data, file)
    sections = ("source", "device", "navigator", "sink")
    for name in document:
        if name not in sections:
            raise ConfigError(f"{file}: {name}: found an unknown table, expected {one_of(name, sections)}")
    tables = {name: _section(document, name, file) for name in sections}
    for name in ("source", "device", "navigator"):
        if not tables[name]:
            raise ConfigError(f"{file}: {name}: found nothing, expected at least one table [{name}.NAME]")

    sources: dict[str, SourceOptions] = {}
    for name, table in tables["source"].items():
        kind = _choose(table, "type", SOURCE_OPTIONS, file, f"source.{name}")
        sources[name] = convert(table, SOURCE_OPTIONS[kind], file, f"source.{name}")

    files = _Files(read)
    devices: dict[str, DeviceOptions] = {}
    for name, table in tables["device"].items():
        key = f"device.{name}"
        entry = DRIVERS[_choose(table, "driver", DRIVERS, file, key)]
        device = convert(table, entry.options, file, key)
        _check_source(device.source, entry.source_type, sources, file, key)
        devices[name] = files.collect(device, key)

    navigators: dict[str, NavigatorOptions] = {}
    for name, table in tables["navigator"].items():
        navigators[name] = convert(table, NavigatorOptions, file, f"navigator.{name}")
        for place, device_name in enumerate(navigators[name].devices):
            if device_name not in devices:
                raise unknown(file, f"navigator.{name}.devices[{place}]", device_name, devices)
            if device_name in navigators[name].devices[:place]:
                raise wrong(file, f"navigator.{name}.devices[{place}]", device_name, "each device once")

    _check_masters(navigators, file)
    sinks: dict[str, SinkOptions] = {}
    for name, table in tables["sink"].items():
        key = f"sink.{name}"
        sink_entry = SINKS[_choose(table, "type", SINKS, file, key)]
        sink = convert(table, sink_entry.options, file, key)
        _check_source(sink.source, sink_entry.source_type, sources, file, key)
        if sink.navigator not in navigators:
            raise unknown(file, f"{key}.navigator", sink.navigator, navigators)
        sinks[name] = files.collect(sink, key)
    return Config(file, sources, devices, navigators, sinks, files.found)


def _check_masters(navigators: dict[str, NavigatorOptions], file: str) -> None:
    for name, options in navigators.items():
        master = options.master_navigator
        if master is not None and master not in navigators:
            raise unknown(file, f"navigator.{name}.master_navigator", master, navigators)
    try:
        in_order(navigators)
    except ValueError as error:
        key = f"navigator.{error}.master_navigator"
        found = navigators[str(error)].master_navigator
        raise wrong(file, key, found, "a navigator that does not follow this one in its turn") from error


def _keys(config: Config, path: Path) -> dict[str, bytes]:
    """The keys in the files that sources name, which are sought beside the configuration at ``path``."""
    keys = {}
    for name, options in config.sources.items():
        if isinstance(options, MavlinkSource) and options.signing_key_file is not None:
            where = path.parent / options.signing_key_file
            key = f"{path.name}: source.{name}.signing_key_file"
            try:
                digits = where.read_text("ascii").strip()
            except OSError as error:
                raise ConfigError(f"{key}: {where} cannot be read: {error.strerror}") from error
            except UnicodeDecodeError:
                digits = ""
            if re.fullmatch("[0-9a-fA-F]{64}", digits) is None:
                # what was found is not shown: it may be a key all the same
                raise ConfigError(f"{key}: {where}: expected 64 hexadecimal digits and nothing else")
            keys[name] = bytes.fromhex(digits)
    return keys


def _section(document: dict[str, Any], section: str, file: str) -> dict[str, dict[str, Any]]:
    tables = document.get(section, {})
    if not isinstance(tables, dict):
        raise wrong(file, section, tables, f"tables [{section}.NAME]")
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise wrong(file, f"{section}.{name}", table, f"a table [{section}.{name}]")
    return tables


def _choose(table: dict[str, Any], field: str, known: Mapping[str, object], file: str, key: str) -> str:
    if field not in table:
        names = ", ".join(sorted(known))
        raise ConfigError(f"{file}: {key}.{field}: found nothing, expected one of {names}")
    found = table[field]
    if not isinstance(found, str):
        raise wrong(file, f"{key}.{field}", found, f"one of {', '.join(sorted(known))}")
    if found not in known:
        raise unknown(file, f"{key}.{field}", found, known)
    return found


def _check_source(name: str, kind: str, sources: dict[str, SourceOptions], file: str, key: str) -> None:
    if name not in sources:
        raise unknown(file, f"{key}.source", name, sources)
    if sources[name].type != kind:
        raise wrong(file, f"{key}.source", name, f'a source of type "{kind}", not "{sources[name].type}"')


class _Files:
    """Reads the files that options name and gives each a name that no other content has."""

    def __init__(self, read: Reader) -> None:
        self._read = read
        self.found: dict[str, bytes] = {}

    def collect(self, options: Any, key: str) -> Any:
        """``options`` with their file names replaced by those in ``found``."""
        renamed = {}
        for place in options.files:
            name = getattr(options, place)
            if name is not None:
                renamed[place] = self._add(*self._read(f"{key}.{place}", name))
        return msgspec.structs.replace(options, **renamed) if renamed else options

    def _add(self, name: str, data: bytes) -> str:
        unique, number = name, 1
        while unique in (ATTACHMENT, DBC_ATTACHMENT) or self.found.get(unique, data) != data:
            number += 1
            unique = f"{number}-{name}"
        self.found[unique] = data
        return unique
