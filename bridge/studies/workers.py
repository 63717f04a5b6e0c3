"""The same work for many seeds, in worker processes."""

from __future__ import annotations

import gc
import multiprocessing
import sys
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import ExitStack
from functools import partial
from typing import TypeVar

from bridge.realtime import no_collections
from bridge.warm import warm_up

Item = TypeVar("Item")
Found = TypeVar("Found")
Progress = Callable[[int, int], None]
_worker = ExitStack()  # closed when a worker process ends


def each(one: Callable[[Item], Found], items: Collection[Item], jobs: int) -> Iterator[Found]:
    """``one`` of every item, in the order in which they are done; with more than one job, in processes."""
    jobs = min(jobs, len(items))
    settled = partial(_settled, one)
    if jobs <= 1:
        with no_collections():
            yield from map(settled, items)
        return
    warm_up()  # compiled once here, read from the cache by the workers
    # fork would copy the threads' locks of whoever calls
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _settle) as pool:
        waiting = [pool.submit(settled, item) for item in items]
        try:
            for done in as_completed(waiting):
                yield done.result()
        finally:
            for future in waiting:
                future.cancel()


def _settle() -> None:
    _worker.enter_context(no_collections())


def _settled(one: Callable[[Item], Found], item: Item) -> Found:
    """``one`` without collections, which go through its thousands of samples in vain, and one after it."""
    found = one(item)
    gc.collect()
    return found


def on_terminal() -> Progress | None:
    """Counts on the standard error what is done, where that is a terminal."""

    def show(done: int, whole: int) -> None:
        print(f"\r{done} of {whole} runs", end="\n" if done == whole else "", file=sys.stderr, flush=True)

    return show if sys.stderr.isatty() else None
