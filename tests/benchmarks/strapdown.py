"""What a navigation update costs: the kernel against the same arithmetic in C and its readable twin.

``python -m tests.benchmarks.strapdown`` prints the table for 1, 2 and 4 samples an update. The C source
beside this file is compiled for it with the system's ``cc``, at -O3 for this processor and without leave to
change the arithmetic, as the kernels are.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from nav import earth
from nav import rotation as rot
from nav.strapdown.control import control
from nav.strapdown.kernels import M_SIZE, X_C, X_H, X_HEAD, X_Q, X_V, integrate
from nav.strapdown.mechanize import NavState, update
from nav.types import Vector
from tests.benchmarks.measure import interleaved, print_table

DT = 0.005  # s, 200 Hz
SOURCE = Path(__file__).with_name("strapdown.c")
FLAGS = ("-O3", "-march=native", "-ffp-contract=off", "-fPIC", "-shared")
_NOTHING = np.zeros((0, X_HEAD))

Run = Callable[[Vector, Vector, int], None]


def compiler() -> str | None:
    """Path of a C compiler, None where there is none."""
    return shutil.which(os.environ.get("CC", "cc"))


def compiled(folder: Path) -> Run:
    """The C twin of `integrate`, compiled in ``folder``: called with state, samples and samples an update."""
    cc = compiler()
    if cc is None:
        raise FileNotFoundError("no C compiler: neither CC is set nor is there a cc")
    library = folder / "strapdown.so"
    subprocess.run([cc, *FLAGS, "-o", str(library), str(SOURCE), "-lm"], check=True)
    function = ctypes.CDLL(str(library)).integrate
    pointer = ctypes.POINTER(ctypes.c_double)
    function.argtypes = [pointer, pointer, ctypes.c_long, ctypes.c_double, ctypes.c_int, pointer, pointer]
    function.restype = None
    u, mid = control(), np.zeros(M_SIZE)

    def run(x: Vector, samples: Vector, n: int) -> None:
        a, b, c, d = (array.ctypes.data_as(pointer) for array in (x, samples, u, mid))
        function(a, b, len(samples), DT, n, c, d)

    return run


def run_kernel(x: Vector, samples: Vector, n: int) -> None:
    """The kernel of the live path."""
    integrate(x, samples, DT, n, control(), 1, _NOTHING)


def run_readable(x: Vector, samples: Vector, n: int) -> None:
    """The readable twin."""
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    state = NavState(x[X_Q : X_Q + 4], x[X_V : X_V + 3], C_en, float(x[X_H]))
    for k in range(len(samples) // n):
        part = samples[k * n : (k + 1) * n]
        state = update(state, part[:, :3], part[:, 3:], n * DT)


def start() -> Vector:
    """Head of a state of a vehicle under way."""
    x = np.zeros(X_HEAD)
    x[X_Q : X_Q + 4] = rot.quat_from_rotvec(np.array([0.02, -0.01, 1.1]))
    x[X_V : X_V + 3] = [8.0, 5.0, 0.1]
    x[X_C : X_C + 9] = earth.position_matrix(0.84, 0.2, 0.3).ravel()
    x[X_H] = 500.0
    return x


def drive(count: int) -> Vector:
    """Samples (count, 6) of a vehicle that rolls and pitches."""
    rng = np.random.default_rng(1)
    rates = 0.3 * rng.standard_normal((count, 3))
    forces = np.array([0.0, 0.0, 9.8]) + rng.standard_normal((count, 3))
    return np.ascontiguousarray(np.hstack([rates, forces]) * DT)


def timed(run: Run, samples: Vector, n: int) -> None:
    """One run from the start."""
    run(start(), samples, n)


def measure(rounds: int = 25, updates: int = 4000, sizes: tuple[int, ...] = (1, 2, 4)) -> dict[int, Vector]:
    """Seconds per update by samples an update: kernel, C (NaN without a compiler) and readable twin."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        run_c = compiled(Path(folder)) if compiler() is not None else None
        for n in sizes:
            samples = drive(updates * n)
            few = samples[: max(updates // 100, 2) * n]
            cases = {"kernel": partial(timed, run_kernel, samples, n)}
            if run_c is not None:
                cases["c"] = partial(timed, run_c, samples, n)
            cases["readable"] = partial(timed, run_readable, few, n)
            times = interleaved(cases, rounds)
            found[n] = np.array(
                [
                    times["kernel"] / updates,
                    times.get("c", np.nan) / updates,
                    times["readable"] * n / len(few),
                ]
            )
    return found


def main() -> int:
    """Print the table."""
    rows = []
    for n, (kernel, c, readable) in measure().items():
        in_c = ("no compiler", "") if np.isnan(c) else (f"{c * 1e9:.0f}", f"{kernel / c:.2f}")
        ratio = f"{readable / kernel:.0f}"
        rows.append((str(n), f"{kernel * 1e9:.0f}", *in_c, f"{readable * 1e9:.0f}", ratio))
    header = ("samples an update", "kernel ns", "C ns", "kernel / C", "NumPy ns", "NumPy / kernel")
    print_table("one navigation update: attitude, velocity, position", header, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
