"""Azimuth law, samples an update and height channel from the configuration to the solution, on the bench."""

import hashlib

import numpy as np
import pytest

from bridge.config import Config
from bridge.engine import Engine
from bridge.evaluate import NAVIGATING
from bridge.frame import RawFrame
from bridge.outputs import SolutionOut
from nav import earth
from nav import rotation as rot
from nav.types import S
from virtual_bus.bus import Bench

SECONDS = 95.0
CHOICES = {
    "as it comes": "",
    "north": 'azimuth = "north"\nsamples_per_update = 1\n',
    "free": 'azimuth = "free"\nsamples_per_update = 4\nheight_channel = { order = 2 }\n',
    "rotating": 'azimuth = "rotating"\nazimuth_rate_deg_per_h = 60.0\nsamples_per_update = 3\n'
    "height_channel = { order = 3, time_constant_s = 20.0 }\n",
}


@pytest.fixture(scope="module")
def bench():
    """The packaged drive, 35 s of it on the road, and its frames."""
    bench = Bench("drive", seed=3, seconds=SECONDS)
    return bench, list(bench.due(bench.end_ns))


def solved(bench, choice):
    """Solutions while navigating, and a digest of all of them."""
    drive, frames = bench
    files = drive.files("virtual", "bench", None)
    files["config.toml"] = files["config.toml"].replace("[navigator.main]\n", "[navigator.main]\n" + choice)
    config = Config.from_files(files)
    engine = Engine(config)
    numbers = {channel: config.source_number(channel) for channel in drive.channels}
    found, digest = [], hashlib.sha256()
    for seq, frame in enumerate(frames):
        raw = RawFrame(seq, frame.t_ns, numbers[frame.channel], frame.frame_id, frame.data)
        for output in engine.feed(raw):
            if isinstance(output, SolutionOut):
                digest.update(output.solution.state.tobytes())
                if output.solution.mode in NAVIGATING:
                    found.append(output.solution)
    return found, digest.hexdigest()


@pytest.mark.parametrize("name", CHOICES)
def test_it_navigates_and_does_so_again(bench, name):
    solutions, digest = solved(bench, CHOICES[name])
    last = solutions[-1]
    truth = bench[0].truth(last.t_ns)
    C_eg = earth.position_matrix(truth.lat, truth.lon)
    off = earth.ecef(*last.state[:3]) - earth.ecef(truth.lat, truth.lon, truth.height)
    C = rot.dcm_from_quat(last.state[S.Q]) @ rot.dcm_from_quat(truth.q_gv).T
    errors = np.concatenate(
        [C_eg.T @ off, last.state[S.V] - truth.v_g, rot.rotvec_from_quat(rot.quat_from_dcm(C))]
    )
    sigmas = np.concatenate([last.state[S.SIGMA_P], last.state[S.SIGMA_V], last.state[S.SIGMA_PHI]])
    # nine errors, each beyond four sigmas once in sixteen thousand
    assert np.all(np.abs(errors) < 4.0 * sigmas)
    assert sigmas[8] < np.radians(0.5)
    assert sigmas[2] < 3.0
    assert solved(bench, CHOICES[name])[1] == digest
