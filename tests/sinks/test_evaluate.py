"""Errors against truth: closed forms on a sphere-free, hand-made motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bridge.evaluate import (
    Coverage,
    Errors,
    SolutionTable,
    TruthTable,
    coverage,
    errors,
    summary,
    table,
    truth_document,
)
from nav import earth, rotation
from nav.types import Mode, S
from tests.sinks.made import VALID, out, solution

LAT, LON, HEIGHT, SPEED = 0.8, 0.2, 100.0, 20.0


def going_north(t_ns: np.ndarray, metres: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> SolutionTable:
    """Along the meridian at constant speed, shifted by metres east, north, up."""
    seconds = t_ns * 1e-9
    r_m, r_n = earth.radii(math.sin(LAT))
    state = np.full((len(t_ns), S.SIZE), 1.0)
    # second order in time is not needed: the curvature radius changes by 1e-9 over 100 m
    state[:, S.LAT] = LAT + (SPEED * seconds + metres[1]) / (r_m + HEIGHT)
    state[:, S.LON] = LON + metres[0] / ((r_n + HEIGHT) * math.cos(LAT))
    state[:, S.HEIGHT] = HEIGHT + metres[2]
    state[:, S.V] = 0.0, SPEED, 0.0
    # turning at 0.1 rad/s
    state[:, S.Q] = rotation.quat_from_euler(0.1 * seconds, np.zeros_like(seconds), np.zeros_like(seconds))
    state[:, S.SIGMA_P] = 0.5
    full = np.full(len(t_ns), 1)
    return SolutionTable(t_ns, full * int(Mode.NAVIGATE), full * int(VALID), state)


def truth(t_ns: np.ndarray) -> TruthTable:
    s = going_north(t_ns).state
    rates = np.tile([0.0, 0.0, -0.1], (len(t_ns), 1))
    return TruthTable(t_ns, s[:, S.LAT], s[:, S.LON], s[:, S.HEIGHT], s[:, S.V], s[:, S.Q], rates)


def ticks(period_ms: int, seconds: float, first_ms: float = 0.0) -> np.ndarray:
    count = int(seconds * 1000 / period_ms)
    return (np.arange(count) * period_ms * 1_000_000 + int(first_ms * 1e6)).astype(np.int64)


def test_a_known_shift_is_found_with_interpolation() -> None:
    # solutions at 100 Hz, truth between them
    found = errors(going_north(ticks(10, 5.0), (3.0, -4.0, 1.5)), truth(ticks(100, 4.5, first_ms=3.7)))
    assert len(found.t_ns) == 45
    # 3 m east stay the same longitude 90 m further north: 3 m * 90 m / 6.4e6 m * tan(lat) = 4.3e-5 m
    assert found.position == pytest.approx(np.tile([3.0, -4.0, 1.5], (45, 1)), abs=5e-5)
    # and due north there is another direction, by 3 m / 6.4e6 m * tan(lat) = 4.8e-7 rad
    assert np.abs(found.velocity).max() < SPEED * 4.9e-7
    assert np.abs(found.attitude).max() < 4.9e-7
    rows = {row.name: row for row in summary(found)}
    assert rows["horizontal"].rms == pytest.approx(5.0, abs=5e-5)
    assert rows["horizontal"].normalised == pytest.approx(math.sqrt((6.0**2 + 8.0**2) / 2.0), abs=1e-4)
    assert rows["height"].final == pytest.approx(1.5, abs=1e-6)


def test_gaps_and_ends_are_left_out() -> None:
    solutions = going_north(ticks(10, 5.0))
    hole = (solutions.t_ns < 2_000_000_000) | (solutions.t_ns > 3_000_000_000)
    found = errors(solutions.where(hole), truth(ticks(100, 10.0)))
    seconds = found.t_ns * 1e-9
    assert seconds.max() < 5.0
    assert not ((seconds > 2.0) & (seconds < 3.0)).any()


def test_aligning_solutions_do_not_count() -> None:
    aligning = going_north(ticks(10, 1.0))
    aligning.mode[:] = int(Mode.ALIGN)
    found = errors(aligning, truth(ticks(100, 1.0)))
    assert summary(found) == []
    of = coverage(aligning, 0, 1_000_000_000)
    assert of == Coverage(1.0, 0.0, None)
    first, second = table([], of)
    assert first == "navigated 0.0 of 1.0 s (0.0%), never aligned"
    assert "not under way" in second


def test_what_was_navigated_is_said_with_the_errors() -> None:
    """Aligned at 2 s, silent from 3 to 4 s, aligning again from 5 to 6 s."""
    solutions = going_north(ticks(10, 8.0))
    t = solutions.t_ns * 1e-9
    solutions.mode[(t < 2.0) | ((t > 5.0) & (t < 6.0))] = int(Mode.ALIGN)
    of = coverage(solutions.where((t <= 3.0) | (t >= 4.0)), -1_000_000_000, 9_000_000_000)
    assert of.seconds == 10.0
    # 2 to 3, 4 to 5, 6 to the last sample at 7.99; at the two ends inside a period of 0.01 s is lost
    assert of.navigated_s == pytest.approx(3.99, abs=0.011)
    assert of.aligned_s == pytest.approx(3.0)
    assert of.share == of.navigated_s / 10.0
    lines = table(summary(errors(solutions, truth(ticks(100, 8.0)))), of)
    assert lines[0] == f"navigated {of.navigated_s:.1f} of 10.0 s ({of.share:.1%}), aligned after 3.0 s"
    assert lines[1].startswith("error against truth")
    assert len(lines) == 7


def test_heading_error_is_the_small_way_round() -> None:
    t_ns = ticks(100, 1.0)
    at, reference = going_north(t_ns), truth(t_ns)
    at.state[:, S.Q] = rotation.quat_from_euler(0.1 * t_ns * 1e-9 - 0.01, 0.0, 0.0)  # across north
    found = errors(at, reference)
    assert found.heading == pytest.approx(np.full(10, -0.01))
    # heading is clockwise and up is counter-clockwise
    assert found.attitude[:, 2] == pytest.approx(np.full(10, 0.01))


def test_longitude_is_interpolated_across_the_date_line() -> None:
    t_ns = np.array([0, 10_000_000], dtype=np.int64)
    both = going_north(t_ns)
    both.state[:, S.LON] = math.pi - 1e-9, -math.pi + 1e-9
    middle, usable = both.at(np.array([5_000_000], dtype=np.int64))
    assert usable.all()
    assert abs(abs(float(middle.state[0, S.LON])) - math.pi) < 1e-8


def over_the_pole(t_ns: np.ndarray, aside: float, ahead: float = 0.0) -> SolutionTable:
    """Past the pole at ``aside`` m at constant speed, at the pole's height, said in geographic terms."""
    y = SPEED * (t_ns * 1e-9 - 2.5) + ahead
    top = earth.SEMI_MINOR + HEIGHT
    # the plane through the pole is level; 50 m away it is 2e-4 m above the ellipsoid
    r_e = np.stack([np.full(len(y), aside), y, np.full(len(y), top)], axis=1)
    lat, lon, height = earth.geodetic(r_e)
    q_ge = rotation.quat_conjugate(earth.position_quat(lat, lon))
    state = np.full((len(t_ns), S.SIZE), 1.0)
    state[:, S.LAT], state[:, S.LON], state[:, S.HEIGHT] = lat, lon, height
    state[:, S.V] = rotation.quat_rotate(q_ge, np.tile([0.0, SPEED, 0.0], (len(y), 1)))
    # right, forward, up are x, y, z of e
    state[:, S.Q] = q_ge
    full = np.full(len(t_ns), 1)
    return SolutionTable(t_ns, full * int(Mode.NAVIGATE), full * int(VALID), state)


@pytest.mark.parametrize("aside", [0.0, 0.02, 3.0])
def test_over_the_pole_errors_are_those_of_the_plane(aside: float) -> None:
    t_ns = ticks(100, 4.5, first_ms=3.7)
    s = over_the_pole(t_ns, aside).state
    reference = TruthTable(
        t_ns, s[:, S.LAT], s[:, S.LON], s[:, S.HEIGHT], s[:, S.V], s[:, S.Q], np.zeros((len(t_ns), 3))
    )
    # solutions at 100 Hz half a metre to the left and 4 m behind, which interpolation meets between them
    found = errors(over_the_pole(ticks(10, 5.0), aside - 0.5, -4.0), reference)
    assert len(found.t_ns) == 45
    assert np.linalg.norm(found.position[:, :2], axis=1) == pytest.approx(math.hypot(0.5, 4.0), abs=1e-6)
    # 50 m from the pole, 4 m on: the plane leaves the ellipsoid by 3e-5 m, and level turns by 6e-7 rad
    assert np.abs(found.position[:, 2]).max() < 5e-5
    assert np.abs(found.velocity).max() < SPEED * 1e-6
    assert np.abs(found.attitude).max() < 1e-6
    assert np.abs(found.heading).max() < 1e-6


def test_truth_at_another_point_next_to_the_pole() -> None:
    t_ns = ticks(100, 1.0)
    s = over_the_pole(t_ns, 3.0).state
    # Earth rate alone, so that the vehicle does not turn over the Earth
    rates = np.tile([0.0, 0.0, earth.EARTH_RATE], (len(t_ns), 1))
    truth = TruthTable(t_ns, s[:, S.LAT], s[:, S.LON], s[:, S.HEIGHT], s[:, S.V], s[:, S.Q], rates)
    moved = truth.at_point((-5.0, 0.0, 0.0))
    there = over_the_pole(t_ns, -2.0).state
    apart = earth.ecef(moved.lat, moved.lon, moved.height) - earth.ecef(*there[:, :3].T)
    assert np.abs(apart).max() < 1e-8
    assert moved.v_g == pytest.approx(there[:, S.V], abs=1e-6)


def test_truth_at_another_point_of_the_vehicle() -> None:
    t_ns = ticks(100, 1.0)
    # 2 m ahead while heading turns clockwise at 0.1 rad/s: the nose swings right at 0.2 m/s
    ahead = truth(t_ns).at_point((0.0, 2.0, 0.0))
    assert float((ahead.lat[0] - LAT) * (earth.radii(math.sin(LAT))[0] + HEIGHT)) == pytest.approx(
        2.0, abs=1e-6
    )
    # Earth rate over 2 m is 1.5e-4 m/s: here the rate is meant against inertial space
    assert ahead.v_g[0] == pytest.approx([0.2, SPEED, 0.0], abs=2e-4)
    assert ahead.v_g[0, 0] == pytest.approx(0.2 + 2.0 * earth.EARTH_RATE * math.sin(LAT), abs=1e-9)
    back = ahead.at_point((0.0, -2.0, 0.0))
    # there and back differ by the metric of places 2 m apart: 2 m * 2 m / 6.4e6 m
    assert float(np.abs(back.lat - truth(t_ns).lat).max() * 6.4e6) < 1e-6


def test_truth_documents_are_read_back() -> None:
    s = solution()
    q = s.state[S.Q]
    document = truth_document(s.lat, s.lon, s.height, s.v_g, q, s.state[S.W])
    read = TruthTable.from_documents([{"t_ns": 5_000_000_000, **document}])
    found = errors(SolutionTable.from_outputs([out(s)]), read)
    assert isinstance(found, Errors)
    assert np.abs(found.position).max() < 1e-8
    assert np.abs(found.attitude).max() < 1e-12
    assert document["heading_deg"] == pytest.approx(200.0)


def test_table_has_the_promised_lines() -> None:
    t_ns = ticks(100, 1.0)
    solutions = going_north(t_ns, (1.0, 0.0, 0.0))
    _, *lines = table(summary(errors(solutions, truth(t_ns))), coverage(solutions, 0, 1_000_000_000))
    assert [line.split()[0] for line in lines[1:]] == ["horizontal", "height", "velocity", "heading", "level"]
    assert "RMS" in lines[0]
