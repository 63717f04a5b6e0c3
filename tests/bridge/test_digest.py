"""The digest: canonical, chained, independent of how a NaN came about."""

import hashlib
import struct

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.digest import DigestChain, canonical_row, combine
from nav.types import Mode, S, Solution

SECOND = 1_000_000_000


def solution(t_ns: int, value: float = 0.5) -> Solution:
    return Solution(t_ns, Mode.NAVIGATE, 3, np.full(S.SIZE, value))


def test_rows_are_the_documented_bytes() -> None:
    row = canonical_row(solution(-7, 1.25))
    assert row == struct.pack("<qHI", -7, Mode.NAVIGATE, 3) + struct.pack(f"<{S.SIZE}d", *[1.25] * S.SIZE)


def test_every_nan_has_one_bit_pattern() -> None:
    odd = np.frombuffer(struct.pack("<Q", 0xFFF8_0000_0000_0123), dtype="<f8")[0]
    assert canonical_row(solution(1, odd)) == canonical_row(solution(1, float("nan")))


def test_the_row_does_not_touch_the_solution() -> None:
    state = np.full(S.SIZE, np.nan)
    state.flags.writeable = False
    canonical_row(Solution(1, Mode.ALIGN, 0, state))


@settings(deadline=None)
@given(st.lists(st.integers(0, 5 * SECOND), min_size=1, max_size=30).map(sorted))
def test_checkpoints_chain_the_blocks_of_each_second(stamps: list[int]) -> None:
    chain = DigestChain("main")
    links = [link for t_ns in stamps if (link := chain.add(solution(t_ns))) is not None]
    head = bytes(32)
    blocks = [
        b"".join(canonical_row(solution(t)) for t in stamps if t // SECOND == second)
        for second in sorted({t // SECOND for t in stamps})
    ]
    heads = []
    for block in blocks:
        head = hashlib.sha256(head + block).digest()
        heads.append(head.hex())
    # the last block is still open: it shows in the final digest only
    assert [link.sha256 for link in links] == heads[:-1]
    assert [link.index for link in links] == list(range(1, len(heads)))
    assert chain.final() == heads[-1]


def test_one_bit_changes_everything_after_it() -> None:
    a, b = DigestChain("main"), DigestChain("main")
    a.add(solution(0, 1.0))
    b.add(solution(0, np.nextafter(1.0, 2.0)))
    assert a.add(solution(SECOND)) != b.add(solution(SECOND))
    assert a.final() != b.final()


def test_a_solution_stamped_earlier_joins_the_open_block() -> None:
    chain = DigestChain("main")
    chain.add(solution(3 * SECOND))
    assert chain.add(solution(1 * SECOND)) is None
    assert chain.add(solution(4 * SECOND)) is not None


def test_an_empty_chain_has_a_digest() -> None:
    assert DigestChain("main").final() == bytes(32).hex()


def test_combination_depends_on_names_and_not_on_order() -> None:
    assert combine({"a": "1", "b": "2"}) == combine({"b": "2", "a": "1"})
    assert combine({"a": "1", "b": "2"}) != combine({"a": "2", "b": "1"})
