"""One transfer alignment of a simulated slave after another, seed by seed: what was true, what came of it.

A `Trial` is a flight of `virtual_bus.flights.FLIGHTS` of some length; `flight` makes it of a seed, `follow`
runs a matching on it through the same `begin` and `advance` as the bridge, and `least` says how small its
errors can be.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from bridge.studies.alignment_truth import misalignment
from bridge.studies.transfer_scene import scene
from nav.align import AlignConfig, advance, begin
from nav.rotation import dcm_from_quat
from nav.transfer import PREFIX, alignment
from nav.transfer.bound import bound
from nav.transfer.matching import Matching
from nav.transfer.states import PHI
from nav.types import ImuSample, MasterState
from virtual_bus.flights import Flown, scenario_of
from virtual_bus.scenario import Scenario
from virtual_bus.sensors import generator
from virtual_bus.tables import MasterTable

Array = NDArray[np.float64]
Arriving = ImuSample | MasterState

ATTITUDE_NOISE_MRAD: Final = 0.3
"""Of a message of the master, as large as what the wing bends."""
_SPARE_S: Final = 0.5  # of a flight after its last epoch: messages are used late
_EXACT: Final = {
    name: 0.0
    for name in MasterTable.__struct_fields__
    if name.startswith(("tilt", "heading", "velocity", "position", "height", "gyro", "accel"))
    or "_noise" in name
}


class Trial(NamedTuple):
    """A flight, its length, samples of the slave and messages of the master a second."""

    manoeuvre: str
    seconds: float
    imu_hz: float = 200.0
    master_hz: float = 25.0

    def scenario(self) -> Scenario:
        """The scenario ``transfer`` with this flown."""
        base = scenario_of(self.manoeuvre)
        assert base.master is not None
        noise = max(base.master.attitude_noise_mrad, ATTITUDE_NOISE_MRAD)
        return msgspec.structs.replace(
            base,
            imu=msgspec.structs.replace(base.imu, rate_hz=self.imu_hz),
            master=msgspec.structs.replace(base.master, rate_hz=self.master_hz, attitude_noise_mrad=noise),
        )


class Flight(NamedTuple):
    """What one seed makes of a trial: configuration, samples in the order of arrival, and truth.

    The messages are dated ``late`` wrong, in sigmas of what the configuration says of it.
    """

    config: AlignConfig
    samples: list[Arriving]
    flown: Flown
    late: float


class Outcome(NamedTuple):
    """What a matching said at epochs; rad.

    ``phi`` (K, 3) about east, north, up, true C_gb = (I + [phi x]) the one said, and ``relative`` (K, 3) less
    the master's own; the covariances ``P``, ``P_relative`` (K, 3, 3) of these. NaN from where it refused, for
    the reason in ``refusal``; ``cpu_s`` is what it took. ``late`` is the flight's.
    """

    phi: Array
    P: Array
    relative: Array
    P_relative: Array
    refusal: str
    cpu_s: float
    late: float


def flight(trial: Trial, seed: int) -> Flight:
    """A trial with what a slave is told wrongly drawn, too: lever arm, and the dating of the messages."""
    made = scene(trial.scenario(), seed, trial.seconds + _SPARE_S)
    align = made.config.align
    assert align is not None
    told = align.transfer
    assert told is not None
    rng = generator(seed, "transfer/told")
    off = told.sigma_lever_arm * rng.standard_normal(3)
    late = float(rng.standard_normal())
    late_ns = round(1e9 * told.latency * late)
    samples = [
        s._replace(t_ns=s.t_ns + late_ns) if isinstance(s, MasterState) else s
        for s in made.samples
        if isinstance(s, (ImuSample, MasterState))
    ]
    config = replace(
        align,
        # it goes on to the last epoch
        transfer=replace(told, lever_arm=told.lever_arm + off, duration=math.inf, patience=math.inf),
    )
    return Flight(config, samples, made.flown, late)


def follow(matching: str, what: Flight, epochs_s: Sequence[float]) -> Outcome:
    """Run a matching of `nav.transfer.MATCHINGS` on a flight; what it says at ``epochs_s`` or just after."""
    run, refusal = begin(alignment(PREFIX + matching), what.config), ""
    found: list[tuple[Array, Array, Array, Array]] = []
    before = time.process_time()
    for sample in what.samples:
        run, status = advance(run, sample)
        if status.refusal is not None:
            refusal = status.refusal
            break
        said = status.transfer
        if said is None or sample.t_ns < round(1e9 * epochs_s[len(found)]):
            continue
        true = dcm_from_quat(what.flown.trajectory.state(sample.t_ns).q_gb)
        phi = misalignment(true, said.q_gb)
        own = what.flown.master.errors(np.array([sample.t_ns]))[0][0]
        found.append((phi, said.P[PHI, PHI].copy(), phi - own, said.relative[PHI, PHI].copy()))
        if len(found) == len(epochs_s):
            break
    spent = time.process_time() - before
    if len(found) < len(epochs_s):
        refusal = refusal or "it did not come so far"
    nothing = np.full(3, math.nan), np.full((3, 3), math.nan)
    found += [(*nothing, *nothing)] * (len(epochs_s) - len(found))
    phi, P, relative, P_relative = (np.array([one[k] for one in found]) for k in range(4))
    return Outcome(phi, P, relative, P_relative, refusal, spent, what.late)


def least(matching: Matching, trial: Trial, epochs_s: Sequence[float]) -> Array:
    """The Cramér-Rao bound (K, 3), rad, of phi relative to the master at ``epochs_s`` or just after."""
    scenario = trial.scenario()
    assert scenario.master is not None
    config = scene(scenario, 0, 1.0).config.align
    assert config is not None
    exact = msgspec.structs.replace(
        scenario,
        master=msgspec.structs.replace(scenario.master, **_EXACT),
        vehicle=msgspec.structs.replace(scenario.vehicle, mounting_sigma_deg=0.0),
        flexure=None,
    )
    made = scene(exact, 0, trial.seconds + _SPARE_S)
    dtheta, dv = made.flown.trajectory.increments(made.flown.t_ns)
    place = {int(t): k for k, t in enumerate(made.flown.t_ns[1:])}
    samples: list[Arriving] = []
    for s in made.samples:
        if isinstance(s, ImuSample):
            samples.append(s._replace(dtheta=dtheta[place[s.t_ns]], dv=dv[place[s.t_ns]]))
        elif isinstance(s, MasterState):
            samples.append(s)
    t_ns, sigma = bound(config, matching, samples)
    at = np.searchsorted(t_ns, np.round(1e9 * np.asarray(epochs_s)).astype(np.int64))
    return np.asarray(sigma[at, PHI])
