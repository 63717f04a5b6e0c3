"""What a digest can depend on besides the frames: the machine, its libraries, our own sources.

Recorded with every capture, compared at replay, so that a digest that differs has a suspect.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
import re
from pathlib import Path
from typing import Final

_ROOMS: Final = ("bridge", "dbc", "nav")
_STEERING: Final = re.compile(
    r"(OPENBLAS|MKL|BLIS|OMP|NPY|GLIBC)_\w+|NUMBA_(CPU_|OPT|ENABLE_|DISABLE_|SLP|LOOP_)\w*"
)
_IMPLIED: Final = ("llvmlite", "scipy")  # compiled code below numba and filterpy


def environment() -> dict[str, str]:
    """Versions of everything that computes, and the hardware, as text by name."""
    model, flags = _cpu()
    return {
        "navbridge": _version("navbridge"),
        "python": platform.python_version(),
        "packages": json.dumps(_packages()),
        "sources_sha256": _sources_sha256(),
        "machine": f"{platform.system()} {platform.machine()}",
        "cpu": model,
        "cpu_flags": flags,
        "libc": " ".join(platform.libc_ver()),
        "libm": _libm(),
        "variables": json.dumps(variables()),
    }


def variables() -> dict[str, str]:
    """Environment variables that choose among the kernels of numerical libraries, which round differently."""
    return {name: value for name, value in sorted(os.environ.items()) if _STEERING.fullmatch(name)}


def differences(recorded: dict[str, str]) -> list[str]:
    """Names of the entries of `environment` in which this machine differs from ``recorded``."""
    return [name for name, value in environment().items() if recorded.get(name) != value]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _packages() -> dict[str, str]:
    try:
        requirements = importlib.metadata.requires("navbridge") or []
    except importlib.metadata.PackageNotFoundError:
        requirements = []
    names = [re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in requirements if "extra ==" not in line]
    return {name: _version(name) for name in sorted({*names, *_IMPLIED})}


def _sources_sha256() -> str:
    digest = hashlib.sha256()
    root = Path(__file__).parent.parent
    for room in _ROOMS:
        for path in sorted((root / room).rglob("*.py")):
            digest.update(str(path.relative_to(root)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _cpu() -> tuple[str, str]:
    """Model name and feature flags of the first processor, sorted."""
    model, flags = platform.processor(), ""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return model, flags
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() == "model name":
            model = value.strip()
        elif name.strip() in ("flags", "Features"):
            flags = " ".join(sorted(value.split()))
            break
    return model, flags


def _libm() -> str:
    """Path and hash of the mathematics library mapped into this process."""
    try:
        maps = Path("/proc/self/maps").read_text(errors="replace")
    except OSError:
        return "unknown"
    for path in sorted(set(re.findall(r"(/\S*/libm[.-]\S*)", maps))):
        if os.path.isfile(path):
            return f"{path} {hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]}"
    return "unknown"
