"""A scenario of dithered lasers: counts of latches become increments, and a replay gives the same bits."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from bridge.cli import main
from bridge.drivers.imu_can import ImuCan, ImuCanOptions
from bridge.frame import RawFrame
from nav.types import ImuSample
from tests.drivers.made import context
from virtual_bus import scenario
from virtual_bus.bus import CALIBRATION, Bench
from virtual_bus.scenario import Scenario

replace = msgspec.structs.replace
SECONDS = 8.0


def rolling() -> Scenario:
    """The packaged scenario, in its sway from the first instant on."""
    what = scenario.load("dithered")
    assert what.sway is not None
    return replace(what, sway=replace(what.sway, begins_s=None))


def samples(what: Scenario, method: str | None, arms: bool = True) -> list[ImuSample]:
    bench = Bench(what, seed=2, seconds=SECONDS)
    sheet = bench.calibration_toml()
    if not arms:
        sheet = "\n".join(line for line in sheet.splitlines() if "lever_arm" not in line)
    options = ImuCanOptions(
        driver="imu_can", source="can0", calibration=CALIBRATION, rate_hz=200.0, whole_cycle=method
    )
    imu = ImuCan(options, context("imu", {CALIBRATION: sheet.encode()}))
    frames = (RawFrame(0, f.t_ns, 1, f.frame_id, f.data) for f in bench.due(bench.end_ns))
    return [one for frame in frames if (1, frame.key) in imu.keys for one in imu.feed(frame)]


@pytest.fixture(scope="module")
def plain() -> list[ImuSample]:
    """The same unit with the same noise, read at the instants, its accelerometers in one point."""
    what = rolling()
    imu = replace(what.imu, dither_hz=None, inner_arms_mm=None)
    return samples(replace(what, imu=imu, navigator=replace(what.navigator, whole_cycle=None)), None)


def off(made: list[ImuSample], plain: list[ImuSample]) -> tuple[float, float]:
    """Root mean square differences of angle (rad) and velocity (m/s), sums since the first half second."""
    out = []
    for name in ("dtheta", "dv"):
        difference = np.array([getattr(a, name) - getattr(b, name) for a, b in zip(made, plain, strict=True)])
        total = np.cumsum(difference[100:], axis=0)
        out.append(float(np.sqrt(np.mean(np.var(total, axis=0)))))
    return out[0], out[1]


def test_latched_counts_and_arms_come_out_as_of_a_plain_unit(plain: list[ImuSample]) -> None:
    what = rolling()
    raw, _ = off(samples(what, None), plain)
    pulse = np.radians(2.0 / 3600.0)
    for method, most in (("linear+parabolic", 2.0), ("sextic+septic", 2.0)):
        angle, velocity = off(samples(what, method), plain)
        # a pulse's rounding, magnified, at the latch and at the instant; raw lags by a cycle of 0.3 rad/s
        assert angle < most * pulse < 0.1 * raw
        # rates at the ends of samples are differences of increments, (11, -7, 2) / 6: their noise over 5 ms
        # is that of the angle times 2.2 and the root of two, and its velocity 5 cm as much
        assert velocity < 2.2 * np.sqrt(2.0) * angle / 5e-3 * 0.05
    _, missing = off(samples(what, "sextic+septic", arms=False), plain)
    assert missing > 20.0 * velocity


def test_a_replay_of_the_scenario_gives_the_same_bits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (scenario.PACKAGED / "dithered.toml").read_text()
    for long, short in (("alignment_s = 60.0", "alignment_s = 8.0"), ("begins_s = 66.0", "begins_s = 9.0")):
        assert long in text
        text = text.replace(long, short)
    path, capture = tmp_path / "short.toml", str(tmp_path / "a.mcap")
    path.write_text(text)
    words = ["--seconds", "22", "--speed", "max", "--no-view", "--mavlink", "none"]
    assert main(["demo", str(path), *words, "--out", capture]) == 0
    assert main(["replay", capture]) == 0
    said = re.search(r"checkpoints: (\d+) of (\d+) agree", capsys.readouterr().out)
    assert said is not None
    assert int(said[1]) == int(said[2]) > 8
