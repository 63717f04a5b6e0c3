"""Packaged configurations load, run, and travel in a capture."""

from __future__ import annotations

import pytest

from bridge.config import Config, packaged_configs
from bridge.engine import Engine


@pytest.mark.parametrize("name", packaged_configs())
def test_a_packaged_configuration_is_in_order(name: str) -> None:
    config = Config.load(name)
    engine = Engine(config)
    assert set(engine.digests()) == set(config.navigators)


@pytest.mark.parametrize("name", packaged_configs())
def test_attachments_rebuild_it(name: str) -> None:
    config = Config.load(name)
    again = Config.from_attachments(config.attachments())
    assert again.sources == config.sources
    assert again.devices == config.devices
    assert again.navigators == config.navigators
    assert again.sinks == config.sinks
    assert again.files == config.files
    assert again.resolved_toml() == config.resolved_toml()
