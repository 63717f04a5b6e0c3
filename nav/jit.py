"""The one way a kernel is compiled.

Compiled kernels are cached in a folder named after a hash over all sources of nav/: numba's own
staleness check looks at the file of the kernel alone and misses a callee edited elsewhere.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba import config

F = TypeVar("F", bound=Callable[..., object])


def _cache_folder() -> str:
    sources = hashlib.sha256()
    root = Path(__file__).parent
    for path in sorted(root.rglob("*.py")):
        sources.update(str(path.relative_to(root)).encode())
        sources.update(path.read_bytes())
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return str(Path(base) / "navbridge" / "kernels" / sources.hexdigest()[:16])


config.CACHE_DIR = os.environ.get("NUMBA_CACHE_DIR") or _cache_folder()  # type: ignore[attr-defined]


def is_cold() -> bool:
    """Whether nothing is cached for these sources yet, so that the kernels will be compiled first."""
    return next(Path(config.CACHE_DIR).rglob("*.nbi"), None) is None  # type: ignore[attr-defined]


def kernel(function: F) -> F:
    """Compile ``function`` to machine code at its first call, IEEE arithmetic in source order.

    No fastmath: results must be those of the readable twin and the same in every process.
    """
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))


def in_place(function: F) -> F:
    """A `kernel` that makes and returns no array, only works in those that it is given.

    It counts no references to them, which in short kernels that call each other is a third of the time.
    Raises TypeError at once where an array is returned, and numba an error at the first call where one is
    made.
    """
    returned = str(function.__annotations__.get("return"))
    if any(word in returned for word in ("Vector", "Matrix", "Array")):
        raise TypeError(f"{function.__name__} returns {returned}: nobody would hold it")
    compiled = cast(Any, numba.njit)(cache=True, error_model="numpy", _nrt=False)  # an untyped option
    return cast(F, compiled(function))
