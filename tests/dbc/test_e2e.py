"""End-to-end protection against published vectors, a second implementation and damaged frames."""

from __future__ import annotations

import random

import e2e as library
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc import e2e

# AUTOSAR, "Specification of CRC Routines" (SWS_CRCLibrary), tables of CRC results: 8-bit SAE J1850
# and 16-bit CCITT-FALSE.
SWS_CRC_VECTORS = [
    ("00000000", 0x59, 0x84C0),
    ("F20183", 0x37, 0xD374),
    ("0FAA0055", 0x79, 0x2023),
    ("00FF5511", 0xB8, 0xB8F9),
    ("332255AABBCCDDEEFF", 0xCB, 0xF53F),
    ("926B55", 0x8C, 0x0745),
    ("FFFFFFFF", 0x74, 0x1D0F),
]


def polynomial_remainder(data: bytes, polynomial: int, width: int, start: int) -> int:
    """Long division bit by bit, most significant bit first: the definition of a CRC."""
    top, mask, crc = 1 << (width - 1), (1 << width) - 1, start
    for byte in data:
        crc ^= byte << (width - 8)
        for _ in range(8):
            crc = ((crc << 1) ^ polynomial if crc & top else crc << 1) & mask
    return crc


def p01_reference(data: bytes, data_id: int) -> int:
    """PRS_E2EProtocol, Profile 1, mode BOTH: data id low byte, high byte, then all but the CRC byte."""
    return polynomial_remainder(bytes([data_id & 0xFF, data_id >> 8]) + data[1:], 0x1D, 8, 0)


def p05_reference(data: bytes, data_id: int) -> int:
    """PRS_E2EProtocol, Profile 5: all but the CRC bytes, then the data id low byte, high byte."""
    return polynomial_remainder(data[2:] + bytes([data_id & 0xFF, data_id >> 8]), 0x1021, 16, 0xFFFF)


@pytest.mark.parametrize(("text", "crc8", "crc16"), SWS_CRC_VECTORS)
def test_the_polynomials_are_autosars(text: str, crc8: int, crc16: int) -> None:
    data = bytes.fromhex(text)
    assert library.crc.calculate_crc8(data) == crc8
    assert library.crc.calculate_crc16(data) == crc16
    assert polynomial_remainder(data, 0x1D, 8, 0xFF) ^ 0xFF == crc8
    assert polynomial_remainder(data, 0x1021, 16, 0xFFFF) == crc16


def test_profile_1_example_of_the_protocol_specification() -> None:
    # data id 0x123, eight bytes of zero, counter 0, mode BOTH
    data = bytearray(8)
    e2e.protect_p01(data, 0x123)
    assert data.hex() == "cc00000000000000"


def test_profile_5_example_of_the_protocol_specification() -> None:
    # data id 0x1234, eight bytes of zero, counter 0, offset 0
    data = bytearray(8)
    e2e.protect_p05(data, 0x1234)
    assert data.hex() == "1cca000000000000"


@settings(deadline=None)
@given(st.binary(min_size=2, max_size=8), st.integers(0, 0xFFFF))
def test_profile_1_agrees_with_its_definition(body: bytes, data_id: int) -> None:
    data = bytearray(body)
    e2e.protect_p01(data, data_id)
    assert data[0] == p01_reference(body, data_id)
    assert data[1:] == body[1:]  # the counter is the caller's
    assert e2e.check_p01(bytes(data), data_id) == (body[1] & 15 != 15)  # 15: an invalid counter


@settings(deadline=None)
@given(st.binary(min_size=3, max_size=64), st.integers(0, 0xFFFF))
def test_profile_5_agrees_with_its_definition(body: bytes, data_id: int) -> None:
    data = bytearray(body)
    e2e.protect_p05(data, data_id)
    assert int.from_bytes(data[:2], "little") == p05_reference(body, data_id)
    assert data[2:] == body[2:]
    assert e2e.check_p05(bytes(data), data_id)


PROFILES = [
    pytest.param(e2e.protect_p01, e2e.check_p01, 8, 8, id="P01"),
    pytest.param(e2e.protect_p05, e2e.check_p05, 32, 16, id="P05"),
]


def order_of_bits(data: bytes) -> int:
    return int.from_bytes(data, "big")


@pytest.mark.parametrize(("protect", "check", "length", "width"), PROFILES)
def test_every_single_and_double_bit_error_is_found(protect, check, length, width) -> None:
    data = bytearray(random.Random(1).randbytes(length))
    protect(data, 0x4E00)
    good = order_of_bits(data)
    bits = 8 * length
    # both polynomials divide no x^k + 1 for any k within these lengths (periods 255 and 32767 bits)
    for i in range(bits):
        for j in range(i, bits):
            bad = good ^ (1 << i) ^ (0 if i == j else 1 << j)
            assert not check(bad.to_bytes(length, "big"), 0x4E00), (i, j)


@pytest.mark.parametrize(("protect", "check", "length", "width"), PROFILES)
def test_every_burst_no_longer_than_the_crc_is_found(protect, check, length, width) -> None:
    # A burst of up to `width` bits is no multiple of the generator. Profile 5 sends its CRC low byte
    # first and in front, which reorders the polynomial, so bursts are laid inside the protected part.
    rng = random.Random(2)
    data = bytearray(rng.randbytes(length))
    protect(data, 0x4E21)
    good = order_of_bits(data)
    first = 8 * length - width  # bits below the CRC field
    for start in range(first - width):
        for _ in range(8):
            burst = 1 | (rng.getrandbits(width - 2) << 1) | (1 << (width - 1))
            bad = good ^ (burst << start)
            assert not check(bad.to_bytes(length, "big"), 0x4E21), (start, burst)


@pytest.mark.parametrize(("protect", "check", "length", "width"), PROFILES)
def test_a_frame_of_another_message_is_found(protect, check, length, width) -> None:
    data = bytearray(length)
    protect(data, 0x4E30)
    assert not any(check(bytes(data), 0x4E00 + other) for other in range(256) if other != 0x30)
