"""A simulated run without a loop around it: the bench's frames straight into the engine.

The frames, the drivers, the engine and the navigator are those of a demonstration at full speed; what
is missing is what the solution does not depend on: buses, recorder, sinks, telemetry and views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bridge.config import Config
from bridge.engine import Engine
from bridge.errors import ConfigError, NavbridgeError
from bridge.evaluate import NAVIGATING, SolutionTable, TruthTable, errors, truth_document
from bridge.frame import RawFrame
from bridge.outputs import SolutionOut
from nav import rotation
from nav.navigator import NavigatorConfig
from nav.types import S, Solution
from virtual_bus import scenario
from virtual_bus.bus import Bench

Array = NDArray[np.float64]

NAVIGATOR: Final = "main"
_SAME: Final = 1e-6


class RunError(NavbridgeError):
    """A simulated run that did not come as far as it had to."""


@dataclass(frozen=True, slots=True)
class Sampled:
    """Errors of one run at the instants asked for, and what the navigator said of them.

    ``t_s`` (K,) s since the start; ``error`` (K, 9) solution minus truth of position (m), velocity (m/s),
    attitude (rad), each east, north, up; ``covariance`` (K, 9, 9) of these; ``lat`` rad and ``height`` m of
    the first instant.
    """

    seed: int
    t_s: Array
    error: Array
    covariance: Array
    lat: float
    height: float


def load(what: str | Path) -> scenario.Scenario:
    """A scenario by name or path.

    Raises:
        ConfigError: there is none, or something in it is wrong.
    """
    try:
        return scenario.load(what)
    except scenario.ScenarioError as error:
        raise ConfigError(str(error)) from error


def configuration(bench: Bench) -> Config:
    """The bridge's configuration for a bench, no telemetry."""
    files = bench.files("virtual", "bench", None)
    return Config.from_files(files)


def navigator_of(what: scenario.Scenario) -> NavigatorConfig:
    """How a bridge for this scenario sets up its navigator; the same for every seed."""
    return Engine(configuration(Bench(what))).navigators[NAVIGATOR].config


def fly(what: scenario.Scenario, seed: int, seconds: float | None, instants_s: Sequence[float]) -> Sampled:
    """One run; the first solution while navigating at or after each of ``instants_s`` is kept.

    ``seconds`` cuts or extends the scenario.

    Raises:
        RunError: the run was over before the last of them.
    """
    bench = Bench(what, seed=seed, seconds=seconds)
    config = configuration(bench)
    engine = Engine(config)
    navigator = engine.navigators[NAVIGATOR]
    numbers = {channel: config.source_number(channel) for channel in bench.channels}
    due_ns = [round(instant * 1e9) for instant in instants_s]
    kept: list[SolutionOut] = []
    covariances: list[Array] = []
    for seq, frame in enumerate(bench.due(bench.end_ns)):
        raw = RawFrame(seq, frame.t_ns, numbers[frame.channel], frame.frame_id, frame.data)
        for output in engine.feed(raw):
            if not isinstance(output, SolutionOut) or output.solution.t_ns < due_ns[len(kept)]:
                continue
            if output.solution.mode in NAVIGATING:
                covariance = navigator.covariance()
                if _belongs(covariance, output.solution):
                    kept.append(output)
                    covariances.append(covariance)
                    if len(kept) == len(due_ns):
                        return _compared(bench, kept, np.array(covariances))
    raise RunError(f"seed {seed}: no solution at {instants_s[len(kept)]:.1f} s, the run ended before")


def _belongs(covariance: Array, solution: Solution) -> bool:
    """Whether the covariance is that of this solution: late data worked in since gives the next one's."""
    said = np.concatenate([solution.state[part] for part in (S.SIGMA_P, S.SIGMA_V, S.SIGMA_PHI)])
    return bool(np.allclose(np.sqrt(np.diag(covariance)), said, rtol=_SAME, atol=0.0))


def _compared(bench: Bench, kept: Sequence[SolutionOut], covariance: Array) -> Sampled:
    documents = []
    for output in kept:
        truth = bench.truth(output.solution.t_ns)
        w_iv_g = rotation.quat_rotate(truth.q_gb, truth.w_ib_b)
        w_iv_v = rotation.quat_rotate(rotation.quat_conjugate(truth.q_gv), w_iv_g)
        document = truth_document(truth.lat, truth.lon, truth.height, truth.v_g, truth.q_gv, w_iv_v)
        documents.append({"t_ns": output.solution.t_ns, **document})
    truths = TruthTable.from_documents(documents)
    found = errors(SolutionTable.from_outputs(kept), truths)
    return Sampled(
        seed=bench.seed,
        t_s=np.asarray(found.t_ns * 1e-9, dtype=np.float64),
        error=np.concatenate((found.position, found.velocity, found.attitude), axis=1),
        covariance=covariance,
        lat=float(truths.lat[0]),
        height=float(truths.height[0]),
    )
