"""Campaigns of alignments: is the attitude that each method says while it runs as good as it says?

Every method of `ALIGNMENTS` runs on the base that it is for, with sensors drawn from what it is told of them:
constant errors, noise, and what calibration leaves of scale and axes.
The seeds are ``seed_base``, ``seed_base + 1``, ... and every one counts: at an epoch at which a run says no
attitude for the present, it has none that could be judged, and a campaign says how many there were.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import ndtri

from bridge.studies.alignment_runs import SCENES, Left, Scene
from bridge.studies.alignment_truth import (
    HEIGHT,
    LAT,
    LON,
    drive,
    fixes,
    merged,
    misalignment,
    road,
    sensed,
    times,
)
from bridge.studies.consistency import INSIDE, SHARE, Array, band, nees, share_inside
from bridge.studies.workers import Progress, each
from nav.align import ALIGNMENTS, AlignConfig, advance, begin, result
from nav.rotation import dcm_from_euler, dcm_from_quat, euler_from_dcm
from nav.types import ImuSample
from virtual_bus.grades import ARCSEC, GRADES, PPM
from virtual_bus.sensors import generator

EPOCHS: Final = 12
STORED: Final = math.radians(0.1)
"""Standard deviation of a heading from outside, rad."""


class Trial(NamedTuple):
    """Where a method is tried: scene, seconds between samples, and between which (s) its epochs lie."""

    scene: str
    dt: float
    first_s: float
    last_s: float


_STAND: Final = Trial("standing", 0.2, 30.0, 299.0)
_COARSE: Final = _STAND._replace(first_s=17.0, last_s=59.0)
_SWAY: Final = Trial("swaying", 0.05, 40.0, 69.0)
_ROAD: Final = Trial("winding road", 0.1, 120.0, 598.0)
TRIALS: Final[dict[str, Trial]] = {
    "static": _STAND,
    "motion": Trial("consumer", 0.05, 30.0, 60.0),
    "analytic": _COARSE,
    "open_loop": _STAND,
    "stored": _COARSE,
    "kalman_closed": _STAND,
    "kalman_open": _STAND,
    "kalman_psi": _STAND,
    "gyrocompass": _STAND,
    "rapid_gyrocompass": _STAND,
    "moving_gyrocompass": _ROAD,
    "inertial_single": _SWAY,
    "inertial": _SWAY,
    "inertial_wahba": _SWAY,
    "odometer": _ROAD,
    "gnss": Trial("stops", 0.1, 60.0, 328.0),
    "large_angle": Trial("misaligned 30, 10, any", 0.2, 30.0, 299.0),
}
"""For each method the base that it is for."""


def _left(grade: str) -> Left:
    """Of scale and axes, what calibration leaves of a unit of a grade."""
    unit = GRADES[grade]
    return Left(
        gyro_scale=unit.gyro_scale_ppm * PPM,
        gyro_axes=unit.gyro_misalignment_arcsec * ARCSEC,
        accel_scale=unit.accel_scale_ppm * PPM,
        accel_axes=unit.accel_misalignment_arcsec * ARCSEC,
    )


_LEFT: Final = _left("rlg")
_CONSUMER: Final = AlignConfig(
    gyro_bias=math.radians(0.1),
    accel_bias=0.05,
    angle_random_walk=math.radians(0.3) / 60.0,
    velocity_random_walk=1e-3,
    sigma_heading=1e-9,  # it does not end: what it says as it goes on is looked at
    **_left("mems")._asdict(),
)
_CONSUMER_S: Final = 65.0


def _consumer(seed: int, dt: float) -> Scene:
    """A consumer's IMU in a car with RTK fixes, mounted anyhow: from a stand on a winding road."""
    rng = generator(seed, "consumer")
    C_vb = dcm_from_euler(*(rng.uniform(-x, x) for x in (math.pi, 1.3, 3.0)))
    heading = rng.uniform(0.0, 2.0 * math.pi)
    trajectory = drive(road("winding", _CONSUMER_S), heading, LAT, LON, HEIGHT, C_vb=C_vb)
    t_ns = times(0.0, _CONSUMER_S, dt)
    samples, eps, nabla = sensed(rng, _CONSUMER, *trajectory.increments(t_ns), dt)
    fix = fixes(trajectory, times(0.0, _CONSUMER_S, 0.25), rng, 0.01, 0.0, 100.0, 0.05)

    def C_gb(t: int) -> Array:
        return dcm_from_quat(trajectory.state(t).q_gb)

    return Scene(_CONSUMER, merged(samples, fix), C_gb, eps, nabla, trajectory)


def scene_of(method: str, seed: int, dt: float | None = None) -> Scene:
    """What a seed makes of the base that a method is for; ``dt`` s between samples where not the trial's."""
    trial = TRIALS[method]
    dt = dt or trial.dt
    if trial.scene == "consumer":
        return _consumer(seed, dt)
    scene = SCENES[trial.scene](seed, dt, left=_LEFT)
    if "heading" not in ALIGNMENTS[method].needs:
        return scene
    heading = float(euler_from_dcm(scene.C_gb(scene.start_ns))[0])
    said = heading + STORED * generator(seed, "stored heading").standard_normal()
    return replace(scene, config=replace(scene.config, C_vb=np.eye(3), heading=(said, STORED)))


# ---- runs ---------------------------------------------------------------------------------------


class Followed(NamedTuple):
    """Of one run: phi (K, 3) and covariance (K, 3, 3) at the epochs and the end; NaN where it said none."""

    seed: int
    phi: Array
    P: Array
    refusal: str


def epochs(method: str) -> Array:
    """Times (s) since the beginning at which a method is looked at; what it hands over comes after them."""
    trial = TRIALS[method]
    return np.linspace(trial.first_s, trial.last_s, EPOCHS)


def follow(method: str, seed: int) -> Followed:
    """Run a method, and compare what it says for the present with the truth."""
    scene = scene_of(method, seed)
    at = epochs(method)
    phi, P = np.full((EPOCHS + 1, 3), math.nan), np.full((EPOCHS + 1, 3, 3), math.nan)
    run, refusal, k = begin(ALIGNMENTS[method], scene.config), "", 0
    for sample in scene.samples:
        run, status = advance(run, sample)
        if status.refusal is not None:
            refusal = status.refusal
            break
        t = (sample.t_ns - scene.start_ns) * 1e-9
        while k + 1 < EPOCHS and t > at[k + 1] - 1e-6:
            k += 1
        due = t > at[k] - 1e-6 and math.isnan(phi[k, 0]) and isinstance(sample, ImuSample)
        if due and status.estimate is not None and not status.behind:
            phi[k], P[k] = misalignment(scene.C_gb(sample.t_ns), status.estimate), status.covariance
        if status.done:
            init = result(run)
            phi[-1], P[-1] = misalignment(scene.C_gb(init.t_ns), init.q_gb), init.P_phi
            break
    return Followed(seed, phi, P, refusal)


@dataclass(frozen=True, slots=True)
class Judged:
    """What the runs of a method say at its epochs ``t_s`` (K,), the last of which is its end (NaN).

    ``seen`` (K,): runs that said an attitude there. ``nees`` (K,): mean of their normalised errors squared of
    three axes, to lie in ``bands`` (K, 2). ``bias`` (K, 3): mean of error over sigma, times the root of
    ``seen``, to lie within ``bias_band``. ``rms`` (K, 3) rad, ``sigma`` (K, 3) rad what was claimed (rms).
    """

    method: str
    runs: int
    refusals: tuple[str, ...]
    t_s: Array
    seen: Array
    nees: Array
    bands: Array
    bias: Array
    bias_band: float
    rms: Array
    sigma: Array

    @property
    def nees_inside(self) -> float:
        """Share of the epochs whose mean lies in its band."""
        return share_inside(self.nees, *self.bands.T)

    @property
    def bias_inside(self) -> float:
        """Share of epochs and axes whose mean error is that of chance."""
        return share_inside(self.bias, -self.bias_band, self.bias_band)

    @property
    def passed(self) -> bool:
        """Whether enough lies inside, and no run refused."""
        return not self.refusals and self.nees_inside >= INSIDE and self.bias_inside >= INSIDE


def judged(method: str, followed: Sequence[Followed], share: float = SHARE) -> Judged:
    """Statistics of the runs of a method, with two-sided bands that hold ``share``."""
    phi, P = np.array([f.phi for f in followed]), np.array([f.P for f in followed])
    kept = [k for k in range(EPOCHS + 1) if np.any(np.isfinite(phi[:, k, 0]))]
    phi, P = phi[:, kept], P[:, kept]
    seen = np.isfinite(phi[..., 0]).sum(axis=0)
    variance = np.einsum("nkii->nki", P)
    return Judged(
        method=method,
        runs=len(followed),
        refusals=tuple(f.refusal for f in followed if f.refusal),
        t_s=np.append(epochs(method), math.nan)[kept],
        seen=seen,
        nees=np.nanmean(nees(phi, P), axis=0),
        bands=np.array([band(3, int(n), share) for n in seen]),
        bias=np.nanmean(phi / np.sqrt(variance), axis=0) * np.sqrt(seen)[:, None],
        bias_band=float(ndtri(0.5 * (1.0 + share))),
        rms=np.sqrt(np.nanmean(phi**2, axis=0)),
        sigma=np.sqrt(np.nanmean(variance, axis=0)),
    )


def run_alignments(
    methods: Sequence[str],
    runs: int,
    *,
    seed_base: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[Judged]:
    """Follow ``runs`` runs of each method."""
    items = [(method, seed) for method in methods for seed in range(seed_base, seed_base + runs)]
    found: dict[tuple[str, int], Followed] = {}
    for method, followed in each(_one, items, jobs):
        found[method, followed.seed] = followed
        if progress is not None:
            progress(len(found), len(items))
    seeds = range(seed_base, seed_base + runs)
    return [judged(method, [found[method, seed] for seed in seeds]) for method in methods]


def _one(item: tuple[str, int]) -> tuple[str, Followed]:
    return item[0], follow(*item)


# ---- for people ---------------------------------------------------------------------------------


def lines(found: Sequence[Judged]) -> list[str]:
    """A table, a line a method; angles in degrees."""
    low, high = band(3, found[0].runs)
    out = [
        f"{found[0].runs} runs a method; mean NEES of 3 axes, 95 % band {low:.2f} to {high:.2f}",
        f"{'method':<20}{'epochs':>7}{'NEES':>15}{'inside':>8}{'bias inside':>13}{'refused':>9}"
        f"{'heading at end: rms':>21}{'claimed':>9}",
    ]
    for one in found:
        spread = f"{one.nees.min():.2f} to {one.nees.max():.2f}"
        rms, sigma = math.degrees(one.rms[-1, 2]), math.degrees(one.sigma[-1, 2])
        out.append(
            f"{one.method:<20}{len(one.t_s):>7}{spread:>15}{100 * one.nees_inside:>6.0f} %"
            f"{100 * one.bias_inside:>11.0f} %{len(one.refusals):>9}{rms:>21.4f}{sigma:>9.4f}"
            f"{'' if one.passed else '  NOT consistent'}"
        )
    for one in found:
        out += [f"{one.method} refused: {reason}" for reason in sorted(set(one.refusals))]
    good = sum(one.passed for one in found)
    out.append(f"consistent: {good} of {len(found)} (at least {100 * INSIDE:.0f} % inside, none refused)")
    return out


def document(found: Sequence[Judged]) -> dict[str, Any]:
    """The same as plain JSON; angles rad, the end's time null."""
    return {
        "passed": all(one.passed for one in found),
        "methods": {
            one.method: {
                "runs": one.runs,
                "passed": one.passed,
                "refusals": list(one.refusals),
                "nees_inside": one.nees_inside,
                "bias_inside": one.bias_inside,
                "bias_band": one.bias_band,
                "epochs": [
                    {
                        "t_s": None if math.isnan(t) else float(t),
                        "runs": int(seen),
                        "nees": float(value),
                        "nees_band": band_.tolist(),
                        "bias": bias.tolist(),
                        "rms": rms.tolist(),
                        "sigma": sigma.tolist(),
                    }
                    for t, seen, value, band_, bias, rms, sigma in zip(
                        one.t_s, one.seen, one.nees, one.bands, one.bias, one.rms, one.sigma, strict=True
                    )
                ],
            }
            for one in found
        },
    }
