"""A slave and its master as samples, without a bus: what a study of transfer alignment runs on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bridge.navigators import navigator_config
from bridge.studies.headless import NAVIGATOR, configuration
from nav.navigator import NavigatorConfig
from nav.rotation import quat_from_dcm
from nav.types import ImuSample, MasterState, Sample
from virtual_bus.bus import Bench
from virtual_bus.flights import Flown, fly
from virtual_bus.scenario import Scenario

Array = NDArray[np.float64]

LATE_NS = 10_000_000
"""So late a message comes behind the instant that it holds for."""


@dataclass(frozen=True, slots=True)
class Scene:
    """Samples in the order of their arrival, and how the navigator would be set up for them.

    Truth is in ``flown``: ``flown.trajectory.state(t_ns)`` of the slave, ``flown.master.errors(t_ns)``.
    """

    samples: list[Sample]
    config: NavigatorConfig
    flown: Flown


def scene(scenario: Scenario, seed: int, seconds: float | None = None) -> Scene:
    """A scenario with a master (`virtual_bus.flights.scenario_of`) of its duration or of ``seconds``.

    Rates, noise, flexure and manoeuvre are the scenario's; the same ``seed`` on the bus has the same truth,
    the same unit and a master with the same lasting errors. Raises ValueError where there is no master.
    """
    flown = fly(scenario, seed, seconds)
    table = scenario.master
    assert table is not None
    dt = np.diff(flown.t_ns) * 1e-9
    inertial = [
        ImuSample(int(t), float(step), dtheta, dv, "imu")
        for t, step, dtheta, dv in zip(flown.t_ns[1:], dt, flown.dtheta, flown.dv, strict=True)
    ]
    own_p = np.array([table.position_m, table.position_m, table.height_m])
    own_phi = 1e-3 * np.array([table.tilt_mrad, table.tilt_mrad, table.heading_mrad])
    said = flown.said
    rates = not table.platform
    messages = [
        MasterState(
            t_ns=int(t),
            lat=float(said.lat[k]),
            lon=float(said.lon[k]),
            height=float(said.height[k]),
            v_g=said.v_g[k],
            q_ga=quat_from_dcm(said.C_ga[k]),
            w_ia_a=said.w_ia_a[k] if rates else None,
            f_a=said.f_a[k] if rates else None,
            sigma_position=own_p,
            sigma_velocity=np.full(3, table.velocity_m_s),
            sigma_phi=own_phi,
            valid=True,
            device="master",
        )
        for k, t in enumerate(flown.master_ns)
    ]
    arriving: list[tuple[int, Sample]] = [(s.t_ns, s) for s in inertial]
    arriving += [(m.t_ns + LATE_NS, m) for m in messages]
    samples = [sample for _, sample in sorted(arriving, key=lambda one: one[0])]
    config = navigator_config(NAVIGATOR, configuration(Bench(scenario, seed, seconds)))
    return Scene(samples, config, flown)
