"""What tests of alignments share: an IMU at rest, running an alignment over samples, its error."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from bridge.studies import alignment_runs, alignment_truth
from bridge.studies.alignment_truth import DEG_PER_H, HEIGHT, LAT, LON, G, sensed
from nav.align import ALIGNMENTS, AlignStatus, NavInit, advance, begin, result
from nav.earth import earth_rate_g, gravity_g
from nav.rotation import dcm_from_euler
from nav.types import FixType, GnssFix, ImuSample

__all__ = [
    "BAND_3",
    "DEG_PER_H",
    "DT",
    "GRADE",
    "HEIGHT",
    "LAT",
    "LON",
    "QUICK",
    "Aligned",
    "G",
    "align",
    "fix",
    "misalignment",
    "moved",
    "nees",
    "standing",
    "swayed",
]

DT = 0.2
BAND_3 = (0.9, 5.4)  # the mean of 8 chi-square values of 3 degrees of freedom: 99.8 % of them

# navigation grade, an ordinary store
GRADE = dataclasses.replace(alignment_runs.GRADE, store_s=900.0, replay_samples=64)
QUICK = dataclasses.replace(GRADE, coarse_s=20.0, fine_s=40.0)


def standing(seed, config=GRADE, seconds=300.0, attitude=(None, None, None), dt=DT, sway=0.0, lasting=0.0):
    """True C_gb, true biases and the samples of a standing IMU; see `swayed`."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(0.0, 2.0 * math.pi) if attitude[0] is None else attitude[0]
    pitch, roll = rng.uniform(-0.3, 0.3, 2) if attitude[1] is None else attitude[1:]
    C_gb = dcm_from_euler(heading, pitch, roll)
    n = round(seconds / dt)
    rate, force = C_gb.T @ earth_rate_g(LAT), C_gb.T @ -gravity_g(LAT, HEIGHT)
    samples, eps, nabla = sensed(rng, config, np.tile(rate * dt, (n, 1)), np.tile(force * dt, (n, 1)), dt)
    return C_gb, eps, nabla, swayed(samples, C_gb, sway, rng, lasting) if sway else samples


def swayed(samples, C_gb, rms, rng, lasting=0.0):
    """A velocity of ``rms`` m/s that lasts for ``lasting`` s (0: white from sample to sample) on top."""
    dt = samples[0].dt
    keep = math.exp(-dt / lasting) if lasting else 0.0
    v = rms * rng.standard_normal((len(samples) + 1, 3))
    for k in range(1, len(v)):
        v[k] = keep * v[k - 1] + math.sqrt(1.0 - keep**2) * v[k]
    return [s._replace(dv=s.dv + dv) for s, dv in zip(samples, np.diff(v, axis=0) @ C_gb, strict=True)]


def moved(samples, begin_s, change):
    """``samples`` as ``change(sample, seconds since begin_s)`` has them from ``begin_s`` on."""
    out = []
    for sample in samples:
        t = sample.t_ns * 1e-9 - begin_s
        out.append(change(sample, t) if t > 0.0 else sample)
    return out


def fix(t_s, *, lat=LAT, v=0.0, sigma=1.0):
    """A fix of the place, at ``v`` m/s to the north."""
    return GnssFix(
        t_ns=round(t_s * 1e9),
        lat=lat,
        lon=LON,
        height=HEIGHT,
        sigma_position=np.full(3, sigma),
        v_g=np.array([0.0, v, 0.0]),
        sigma_velocity=np.full(3, 0.05),
        fix_type=FixType.FIX_3D,
        device="gnss",
    )


class Aligned(NamedTuple):
    """What an alignment came to."""

    init: NavInit | None
    status: AlignStatus
    refusals: list[str]
    seen: list[tuple[ImuSample, AlignStatus]]  # at the first inertial sample from each of the times asked for
    behind: list[int]  # times of the samples at which it was going through stored ones


def align(alignment, samples, config=GRADE, at_s=(), insist=True):
    """Run one, by name or as it is, until it is done; with ``insist`` it may start again when it refuses."""
    run = begin(ALIGNMENTS[alignment] if isinstance(alignment, str) else alignment, config)
    refusals, seen, behind, waiting, begin_ns = [], [], [], list(at_s), samples[0].t_ns
    for sample in samples:
        run, status = advance(run, sample)
        if status.refusal:
            refusals.append(status.refusal)
            if not insist:
                break
        if status.behind:
            behind.append(sample.t_ns)
        inertial = isinstance(sample, ImuSample)
        if waiting and inertial and (sample.t_ns - begin_ns) * 1e-9 > waiting[0] - 1e-6:
            seen.append((sample, status))
            waiting.pop(0)
        if status.done:
            return Aligned(result(run), status, refusals, seen, behind)
    return Aligned(None, status, refusals, seen, behind)


def misalignment(C_gb, init):
    """phi with true C_gb = (I + [phi x]) estimated C_gb."""
    return alignment_truth.misalignment(C_gb, init.q_gb)


def nees(C_gb, eps, nabla, init):
    """Of attitude and biases together, nine degrees of freedom."""
    error = np.concatenate([misalignment(C_gb, init), eps - init.gyro_bias, nabla - init.accel_bias])
    return float(error @ np.linalg.solve(init.P[6:15, 6:15], error))
