"""The wire contract that a configuration goes by: the packaged one live, a capture's own in a replay."""

from __future__ import annotations

from typing import Final

from bridge.errors import ConfigError
from dbc.codec import Contract, MessageCodec, contract, parse

DBC_ATTACHMENT: Final = "navbridge.dbc"
"""Name of the contract among a capture's attachments."""


def read_contract(text: bytes) -> Contract:
    """The contract in a capture's attachment; the packaged one, compiled already, where they are equal.

    Raises:
        ConfigError: it is damaged, or not a contract.
    """
    if text == contract().text:
        return contract()
    try:
        return parse(text, DBC_ATTACHMENT)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def message(messages: Contract, name: str) -> MessageCodec:
    """The codec of a message that this program reads or writes.

    Raises:
        ConfigError: ``messages`` has it not, or with other signals than the program knows what to do with.
    """
    expected = contract()[name].signals
    if name not in messages:
        raise ConfigError(f"{DBC_ATTACHMENT}: found no message {name}, which this navbridge reads")
    found = messages[name].signals
    if found != expected:
        raise ConfigError(
            f"{DBC_ATTACHMENT}: {name}: found signals {', '.join(found)}, expected {', '.join(expected)}"
        )
    return messages[name]
