"""The same work for many seeds, in worker processes."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

from bridge.warm import warm_up

Item = TypeVar("Item")
Found = TypeVar("Found")
Progress = Callable[[int, int], None]


def each(one: Callable[[Item], Found], items: Collection[Item], jobs: int) -> Iterator[Found]:
    """``one`` of every item, in the order in which they are done; with more than one job, in processes."""
    jobs = min(jobs, len(items))
    if jobs <= 1:
        yield from map(one, items)
        return
    warm_up()  # compiled once here, read from the cache by the workers
    # fork would copy the threads' locks of whoever calls
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        waiting = [pool.submit(one, item) for item in items]
        try:
            for done in as_completed(waiting):
                yield done.result()
        finally:
            for future in waiting:
                future.cancel()


def on_terminal() -> Progress | None:
    """Counts on the standard error what is done, where that is a terminal."""

    def show(done: int, whole: int) -> None:
        print(f"\r{done} of {whole} runs", end="\n" if done == whole else "", file=sys.stderr, flush=True)

    return show if sys.stderr.isatty() else None
