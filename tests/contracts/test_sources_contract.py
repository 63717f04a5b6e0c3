"""What every entry of SOURCES promises; a new entry is held to it once it is registered."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.clock import HostClock, WallClock
from bridge.errors import ConfigError, SourceError
from bridge.options import SOURCE_OPTIONS, SourceOptions
from bridge.outputs import Transmit
from bridge.sources import SOURCES, Notice, Source, SourceContext
from bridge.strict import convert

FOREVER = 2**63

HERE: dict[str, dict[str, Any]] = {
    "can": {"interface": "virtual", "channel": "sources_contract"},
    "mavlink": {"url": "udpin:127.0.0.1:0"},
}
"""Options of a source that is there, without hardware."""

NOT_THERE: dict[str, dict[str, Any]] = {
    "can": {"interface": "socketcan", "channel": "nosuchbus0"},
    "mavlink": {"url": "serial:/dev/nothing"},
}
WRONG: dict[str, tuple[str, dict[str, Any]]] = {
    "can": ("interface", {"interface": "telepathy", "channel": "x"}),
    "mavlink": ("url", {"url": "telepathy:x"}),
}


def made(name: str, table: dict[str, Any]) -> Source:
    options = convert({"type": name, **table}, SOURCE_OPTIONS[name], "test.toml", "source.s")
    clock = HostClock()
    return SOURCES[name](options, SourceContext(1, "s", clock, WallClock(clock)))


def test_every_kind_of_source_has_its_options() -> None:
    assert SOURCES.keys() == SOURCE_OPTIONS.keys()
    assert all(issubclass(options, SourceOptions) and options.__doc__ for options in SOURCE_OPTIONS.values())


@pytest.mark.parametrize("name", SOURCES)
def test_a_quiet_source_gives_nothing_and_never_raises(name: str) -> None:
    source = made(name, HERE[name])
    assert source.context.name == "s"
    source.open()
    for _ in range(3):
        assert source.poll(FOREVER) == []
        assert all(isinstance(notice, Notice) for notice in source.notices())
    assert source.notices() == []
    assert all(isinstance(number, int) for number in source.descriptors())
    assert source.filters()
    assert isinstance(source.send(Transmit(1, 0x123, bytes(8))), bool)
    assert all(isinstance(count, int) for count in source.counters().values())
    source.close()
    source.close()


@pytest.mark.parametrize("name", SOURCES)
def test_one_that_has_gone_counts_what_it_could_not_send(name: str) -> None:
    source = made(name, HERE[name])
    source.open()
    source.close()
    assert not source.send(Transmit(1, 0x123, bytes(8)))
    assert source.counters()["unsent"] == 1


@pytest.mark.parametrize("name", SOURCES)
def test_one_that_is_not_there_says_which_and_why_in_a_line(name: str) -> None:
    source = made(name, NOT_THERE[name])
    with pytest.raises(SourceError, match=r"^source s: cannot open .+: .+") as caught:
        source.open()
    assert "\n" not in str(caught.value)
    source.close()


@pytest.mark.parametrize("name", SOURCES)
def test_options_that_no_source_can_have_are_refused_before_it_is_opened(name: str) -> None:
    key, table = WRONG[name]
    with pytest.raises(ConfigError, match=rf'^{key}: found "telepathy.*", expected '):
        made(name, table)
