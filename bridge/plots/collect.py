"""Running a capture through the engine once more and keeping what the pictures need."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from bridge.config import Config
from bridge.engine import Engine, build_drivers
from bridge.evaluate import SolutionTable, TruthTable
from bridge.outputs import FixOut, Innovation, ModeChange, SolutionOut
from bridge.plots.data import PlotData
from bridge.recording import Capture
from nav.types import GnssFix, ImuChange


def collect(capture: Capture, config: Config) -> list[PlotData]:
    """What each navigator of ``config`` made of ``capture``, in the order of the configuration."""
    engine = Engine(config)
    drivers = build_drivers(config)
    takers: defaultdict[tuple[int, int], list[str]] = defaultdict(list)
    for name, driver in drivers.items():
        for key in driver.keys:
            takers[key].append(name)
    times: dict[str, list[int]] = {name: [] for name in drivers}
    solutions: defaultdict[str, list[SolutionOut]] = defaultdict(list)
    modes: defaultdict[str, list[ModeChange]] = defaultdict(list)
    innovations: defaultdict[str, list[Innovation]] = defaultdict(list)
    fixes: defaultdict[str, list[GnssFix]] = defaultdict(list)
    begin_ns = end_ns = None
    for frame in capture.frames():
        begin_ns = frame.rx_ns if begin_ns is None else begin_ns
        end_ns = max(frame.rx_ns, end_ns or frame.rx_ns)
        for name in takers.get((frame.source, frame.key), ()):
            in_order = frame._replace(rx_ns=end_ns)  # engine time never goes back
            made = drivers[name].feed(in_order)
            times[name].extend(sample.t_ns for sample in made if not isinstance(sample, ImuChange))
        for out in engine.feed(frame):
            match out:
                case SolutionOut():
                    solutions[out.navigator].append(out)
                case ModeChange():
                    modes[out.navigator].append(out)
                case Innovation():
                    innovations[out.navigator].append(out)
                case FixOut():
                    fixes[out.device].append(out.fix)
    truth = TruthTable.from_documents(capture.truth())
    runs = []
    for name, options in config.navigators.items():
        seconds = ((end_ns or 0) - (begin_ns or 0)) / 1e9
        runs.append(
            PlotData(
                title=f"{capture.path.name} · navigator {name} · {seconds:.0f} s",
                navigator=name,
                begin_ns=begin_ns or 0,
                end_ns=end_ns or 0,
                solutions=SolutionTable.from_outputs(solutions[name]),
                modes=modes[name],
                innovations=innovations[name],
                fixes=[fix for device in options.devices for fix in fixes[device]],
                truth=truth if len(truth.t_ns) else None,
                samples_ns={device: np.array(times[device], dtype=np.int64) for device in options.devices},
            )
        )
    return runs
