"""What a transfer alignment came to: misalignment at hand-over and at the end, against master and truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from bridge.outputs import ModeChange, Output, SolutionOut, Transfer, Transmit
from nav import rotation
from nav.types import Mode, S, Solution
from virtual_bus.bus import Bench

Array = NDArray[np.float64]


def misalignment(bench: Bench, solution: Solution, t_ns: int) -> tuple[Array, Array]:
    """Phi (3,) rad, true C_gb = (I + [phi x]) the solution's, against truth and relative to the master.

    ``t_ns`` is the solution's time on the bench's clock. Raises ValueError for a bench without a master.
    """
    if bench.master is None:
        raise ValueError(f"{bench.scenario.title}: no master")
    truth = bench.truth(t_ns)
    off = rotation.quat_multiply(truth.q_gb, rotation.quat_conjugate(solution.state[S.Q]))
    phi = rotation.rotvec_from_quat(off)
    own, _, _ = bench.master.errors(np.array([t_ns - bench.start_ns]))
    return phi, phi - own[0]


class TransferSink:
    """Keeps the last solution of a transfer alignment, what it said then, and the last solution of all.

    ``start_ns`` says when the bench began, on the engine's clock.
    """

    def __init__(self, bench: Bench, navigator: str, start_ns: Callable[[], int]) -> None:
        self._bench = bench
        self._navigator = navigator
        self._start_ns = start_ns
        self._known: Transfer | None = None
        self._handed_ns: int | None = None
        self._shown: dict[str, Solution] = {}

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """See `bridge.sinks.base.Sink`."""
        for output in outputs:
            match output:
                case Transfer() if output.navigator == self._navigator:
                    self._known = output
                case ModeChange() if output.navigator == self._navigator:
                    if output.new is Mode.TRANSFER:
                        self._handed_ns = None
                    elif output.old is Mode.TRANSFER:
                        self._handed_ns = output.t_ns
                case SolutionOut() if output.navigator == self._navigator:
                    if output.solution.mode is Mode.TRANSFER:
                        self._shown["at the hand-over"] = output.solution
                    self._shown["at the end"] = output.solution
        return []

    def lines(self) -> list[str]:
        """What people read at the end of a run; nothing where there was no transfer alignment."""
        known, start_ns = self._known, self._start_ns()
        if known is None or "at the hand-over" not in self._shown:
            return []
        name = f"transfer alignment by {known.matching}"
        if self._handed_ns is None:
            help_ = f", {known.hint} would help" if known.hint else ""
            del self._shown["at the hand-over"]
            lines = [f"{name}: not handed over{help_}"]
        else:
            lines = [f"{name}: handed over after {(self._handed_ns - start_ns) * 1e-9:.1f} s"]
        lines.append(f"{'misalignment (mrad)':<40}{'east':>8}{'north':>8}{'up':>8}{'claimed sigma':>25}")
        for when, solution in self._shown.items():
            absolute, relative = misalignment(self._bench, solution, solution.t_ns - start_ns)
            row = f"relative to the master, {when}"
            told = known.sigma if when == "at the hand-over" or self._handed_ns is None else None
            lines.append(_row(row, relative, told))
            lines.append(_row(f"against truth, {when}", absolute, tuple(solution.state[S.SIGMA_PHI])))
        if not any(name.startswith("mounting") for name, _ in known.observability):
            return lines
        found = zip(known.mounting, known.sigma_mounting, strict=True)
        mounting = ", ".join(f"{math.degrees(x):.3f} ± {math.degrees(sigma):.3f}" for x, sigma in found)
        return [*lines, f"mounting found beyond the configured one: {mounting} deg about right, forward, up"]


def _row(name: str, phi: Array, sigma: Sequence[float] | None) -> str:
    text = f"{name:<40}" + "".join(f"{1e3 * x:>8.2f}" for x in phi)
    return text if sigma is None else text + " " + "".join(f"{1e3 * x:>8.2f}" for x in sigma)
