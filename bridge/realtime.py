"""What the operating system can do for a loop that must not wait; each says so when it is refused."""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

_MCL_CURRENT: Final = 1
_MCL_FUTURE: Final = 2


@dataclass(frozen=True, slots=True)
class RealTime:
    """Options: SCHED_FIFO priority (1 to 99), the processor to stay on, memory kept from being paged out.

    Priority and processor are those of the thread that calls `apply`: start helper threads before.
    """

    fifo_priority: int | None = None
    cpu: int | None = None
    lock_memory: bool = False

    def apply(self) -> list[str]:
        """Ask the system for what is wanted; one line for each wish that was refused."""
        refused = []
        if self.cpu is not None:
            try:
                os.sched_setaffinity(0, {self.cpu})
            except (OSError, ValueError) as error:
                refused.append(f"processor {self.cpu} refused: {error}")
        if self.fifo_priority is not None:
            try:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(self.fifo_priority))
            except (OSError, ValueError) as error:
                refused.append(
                    f"SCHED_FIFO priority {self.fifo_priority} refused: {error}; it needs CAP_SYS_NICE"
                )
        if self.lock_memory:
            library = ctypes.CDLL(None, use_errno=True)
            if library.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
                reason = os.strerror(ctypes.get_errno())
                refused.append(
                    f"memory locking refused: {reason}; it needs CAP_IPC_LOCK or a higher ulimit -l"
                )
        return refused


@contextmanager
def no_collections() -> Iterator[None]:
    """Collect garbage once and then not inside: a full collection takes tens of milliseconds."""
    enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()
