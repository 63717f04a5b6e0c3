"""Every entry of ALIGNMENTS is configured, numbered and commanded, and keeps what the table promises."""

from __future__ import annotations

import gc
import math
import re
import sys
import types
from dataclasses import fields, replace
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import cantools
import msgspec
import numpy as np
import pytest

from bridge.commands import CONFIGURED, METHODS, CommandCode, Reason, Result, judge
from bridge.config import ATTACHMENT, Config
from bridge.engine import Engine
from bridge.navigators import navigator_config
from bridge.options import AlignOptions
from bridge.outputs import Progress
from nav.align import ALIGNMENTS, AlignConfig, AlignStatus, NavInit, advance, begin, result, store
from nav.align.store import Track
from nav.rotation import dcm_from_quat, euler_from_dcm, quat_conjugate, quat_multiply, rotvec_from_quat
from nav.types import ImuSample, Sample
from tests.contracts.journeys import CONFIG, journey, only, with_a_gap
from tests.engine.made import bench_frames

DBC: Any = cantools.database.load_string((files("dbc") / "navbridge.dbc").read_text("cp1252"), "dbc")
KINDS = {"gnss", "odometer", "speed", "baro"}


def test_the_numbers_of_alignments_are_those_of_the_wire() -> None:
    assert len(set(METHODS.values())) == len(METHODS)
    assert CONFIGURED not in METHODS.values()
    for message, signal in (("COMMAND", "ARGUMENT"), ("SOL_ALIGN", "METHOD")):
        choices = DBC.get_message_by_name(message).get_signal_by_name(signal).choices
        named = {str(name): number for number, name in choices.items() if number != CONFIGURED}
        assert named == METHODS
    # recorded commands and other people's tables hold them: they never change
    assert list(METHODS.values()) == [*range(1, 18), *range(33, 42)]
    assert list(METHODS)[:5] == ["static", "motion", "analytic", "open_loop", "kalman_closed"]
    assert list(METHODS)[5:10] == [
        "kalman_open", "kalman_psi", "gyrocompass", "rapid_gyrocompass", "moving_gyrocompass",
    ]  # fmt: skip
    assert list(METHODS)[10:17] == [
        "inertial", "inertial_single", "inertial_wahba", "odometer", "gnss", "large_angle", "stored",
    ]  # fmt: skip
    assert [name.removeprefix("transfer_") for name in list(METHODS)[17:]] == [
        "one_shot", "velocity", "position", "velocity_heading", "velocity_heading_13", "velocity_heading_7",
        "velocity_attitude", "velocity_rate", "velocity_11",
    ]  # fmt: skip


def test_the_reasons_of_a_refusal_are_those_of_the_wire() -> None:
    signals = DBC.get_message_by_name("COMMAND_ACK")
    assert set(signals.get_signal_by_name("REASON").choices) == {int(reason) for reason in Reason}
    assert {int(result) for result in Result} <= set(signals.get_signal_by_name("RESULT").choices)
    codes = DBC.get_message_by_name("COMMAND").get_signal_by_name("CODE").choices
    assert set(codes) == {int(code) for code in CommandCode}


@pytest.mark.parametrize("name", ALIGNMENTS)
def test_an_alignment_has_a_number_and_needs_what_there_is(name: str) -> None:
    assert name in METHODS
    assert ALIGNMENTS[name].stages
    assert ALIGNMENTS[name].needs <= KINDS | {"heading"}


@pytest.mark.parametrize("name", ALIGNMENTS)
@pytest.mark.parametrize("code", [CommandCode.START_ALIGNMENT, CommandCode.RESTART])
def test_a_command_starts_it_where_nothing_is_lacking(name: str, code: CommandCode) -> None:
    able = dict.fromkeys(ALIGNMENTS, "")
    for lacks in ("position", "heading", *sorted(KINDS)):
        unable = able | {name: lacks}
        verdict = judge(code, METHODS[name], {"one": able, "two": unable})
        assert (verdict.result, verdict.reason) == (Result.ACCEPTED, Reason.NONE)
        assert verdict.methods == {"one": name}
        (text,) = verdict.texts
        assert text.startswith(f"two: alignment {name} refused: it needs ")
        verdict = judge(code, METHODS[name], {"two": unable})
        assert verdict.result is Result.DENIED
        assert verdict.reason not in (Reason.NONE, Reason.UNKNOWN_CODE, Reason.UNKNOWN_METHOD)
        assert verdict.methods == {}


# ---- behaviour ------------------------------------------------------------------------------------

JOURNEYS = ("rest", "road")
NEWEST = 64  # samples that a stage may look at again without that counting as stored work


class Ran(NamedTuple):
    statuses: list[AlignStatus]
    refusals: list[tuple[float, str]]
    init: NavInit | None
    ended_ns: int
    most_stored: int


def run(name: str, samples: tuple[Sample, ...], config: AlignConfig = CONFIG) -> Ran:
    """Feed until it is done; ``most_stored``: older inertial samples that a single step took up, at most."""
    taken: set[int] = set()
    with pytest.MonkeyPatch.context() as patch:
        for way in ("ahead", "back"):
            patch.setattr(Track, way, _counting(way, taken))
        run_ = begin(ALIGNMENTS[name], config)
        statuses, refusals, most, last_ns = [], [], 0, 0
        for sample in samples:
            taken.clear()
            run_, status = advance(run_, sample)
            most = max(most, len(taken))
            statuses.append(status)
            if isinstance(sample, ImuSample):
                last_ns = sample.t_ns
            if status.refusal is not None:
                refusals.append((sample.t_ns * 1e-9, status.refusal))
            if status.done:
                return Ran(statuses, refusals, result(run_), last_ns, most)
    return Ran(statuses, refusals, None, last_ns, most)


def _counting(way: str, taken: set[int]) -> Any:
    original = getattr(Track, way)

    def counted(self: Track, place: int, most: int) -> Any:
        piece = original(self, place, most)
        first = place if way == "ahead" else place - len(piece.t_ns)
        inertial = piece.rows.shape[1] == 6
        # who asks whether a sensor is stuck looks at what came last
        if inertial and (way == "ahead" or place < self.count):
            taken.update(range(first, min(first + len(piece.t_ns), self.count - NEWEST)))
        return piece

    return counted


def needs_of(name: str) -> set[str]:
    return set(ALIGNMENTS[name].needs) - {"heading"}


@cache
def with_its_needs(name: str, where: str) -> Ran:
    return run(name, only(journey(where)[0], needs_of(name)))


def is_right(where: str, init: NavInit) -> bool:
    """Whether the attitude is off by no more than 99.9 % of those of its covariance."""
    apart = quat_multiply(journey(where)[1][init.t_ns], quat_conjugate(init.q_gb))
    phi = rotvec_from_quat(apart)
    return bool(phi @ np.linalg.solve(init.P_phi, phi) < 16.3)


def assert_in_range(status: AlignStatus) -> None:
    if status.estimate is not None:
        assert status.estimate.shape == (4,)
        assert math.isclose(float(status.estimate @ status.estimate), 1.0, abs_tol=1e-6)
    assert status.covariance.shape == (3, 3)
    assert np.all(np.isfinite(status.covariance))
    np.testing.assert_allclose(status.covariance, status.covariance.T, rtol=1e-6, atol=1e-18)
    assert np.linalg.eigvalsh(status.covariance)[0] > -1e-12
    assert status.limit.shape == (3,)
    assert np.all(np.isfinite(status.limit))
    assert np.all(status.limit >= 0.0)
    assert 0.0 <= status.progress <= 1.0
    assert not (status.done and status.behind)
    if status.refusal is not None:
        assert len(status.refusal) > 10
        assert not status.done


def assert_hand_over(ran: Ran) -> None:
    init = ran.init
    assert init is not None
    # navigation's first epoch follows alignment's last sample
    assert init.t_ns == ran.ended_ns
    assert math.isclose(float(init.q_gb @ init.q_gb), 1.0, abs_tol=1e-6)
    for values in (init.v_g, init.sigma_v, init.sigma_p, init.gyro_bias, init.accel_bias):
        assert values.shape == (3,)
        assert np.all(np.isfinite(values))
    assert np.all(np.linalg.eigvalsh(init.P_phi) > 0.0)
    if init.P is not None:
        assert init.P.shape == (15, 15)
        np.testing.assert_allclose(init.P, init.P.T, rtol=1e-6, atol=1e-15)
        size = np.sqrt(np.diag(init.P))
        size[size == 0.0] = 1.0
        assert np.linalg.eigvalsh(init.P / np.outer(size, size))[0] > -1e-6
        np.testing.assert_allclose(np.diag(init.P)[6:9], np.diag(init.P_phi), rtol=1e-6)


@pytest.mark.parametrize("where", JOURNEYS)
@pytest.mark.parametrize("name", ALIGNMENTS)
def test_its_status_is_in_range_its_work_bounded_and_its_answer_of_now(name: str, where: str) -> None:
    ran = with_its_needs(name, where)
    odd = [status for status in ran.statuses if status.refusal or status.done or status.behind]
    for status in ran.statuses[::11] + odd[:100]:
        assert_in_range(status)
    assert ran.most_stored <= CONFIG.replay_samples
    if ran.init is not None:
        assert_hand_over(ran)
        assert is_right(where, ran.init)


@pytest.mark.parametrize("where", JOURNEYS)
@pytest.mark.parametrize("name", ALIGNMENTS)
def test_the_same_samples_give_the_same_bits(name: str, where: str) -> None:
    one, other = with_its_needs(name, where), run(name, only(journey(where)[0], needs_of(name)))
    assert one.refusals == other.refusals
    assert len(one.statuses) == len(other.statuses)
    for a, b in zip(one.statuses, other.statuses, strict=True):
        assert a[3:] == b[3:]
        for left, right in zip(a[:3], b[:3], strict=True):
            assert (left is None) == (right is None)
            assert left is None or left.tobytes() == right.tobytes()
    if one.init is not None and other.init is not None:
        for each in fields(NavInit):
            left, right = getattr(one.init, each.name), getattr(other.init, each.name)
            assert np.array_equal(left, right) or left is right is None, each.name


@pytest.mark.parametrize("name", ALIGNMENTS)
def test_it_needs_what_it_says_and_no_more(name: str) -> None:
    needs = needs_of(name)
    able = [where for where in JOURNEYS if with_its_needs(name, where).init is not None]
    assert able, f"{name} ends on neither journey with {needs or 'inertial samples'} alone"
    for need in needs:
        without = run(name, only(journey(able[0])[0], KINDS - {need}))
        assert without.init is None, f"{name} ends without {need}"


@pytest.mark.parametrize("where", JOURNEYS)
@pytest.mark.parametrize("name", ALIGNMENTS)
def test_silence_is_refused_with_its_cause_or_does_no_harm(name: str, where: str) -> None:
    whole = with_its_needs(name, where)
    if whole.init is None:
        return
    # in the middle of what it took
    half = 0.5 * whole.ended_ns * 1e-9
    cut = run(name, with_a_gap(only(journey(where)[0], needs_of(name)), half, half + 2.0))
    refused = [why for t, why in cut.refusals if half < t < half + 4.0]
    assert any("missing" in why for why in refused) or (cut.init is not None and is_right(where, cut.init))


def size_of(state: Any) -> int:
    """Bytes of everything that a state holds on to."""
    total, seen, waiting = 0, set(), [state]
    leave = (type, types.ModuleType, types.FunctionType, types.BuiltinFunctionType, types.MethodType)
    while waiting:
        thing = waiting.pop()
        if id(thing) in seen or isinstance(thing, leave) or "Dispatcher" in type(thing).__name__:
            continue
        seen.add(id(thing))
        if isinstance(thing, np.ndarray):
            total += thing.nbytes
            if thing.base is not None:
                waiting.append(thing.base)
            continue
        total += sys.getsizeof(thing)
        waiting += gc.get_referents(thing)
    return total


@pytest.mark.parametrize("where", JOURNEYS)
@pytest.mark.parametrize("name", ALIGNMENTS)
def test_what_never_ends_does_not_grow(name: str, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "BLOCK", 240)
    config = replace(CONFIG, store_s=10.0, coarse_s=1e6, fine_s=1e6, sigma_heading=1e-9, window_s=8.0)
    samples = journey(where)[0][:3000]
    sizes, run_ = [], begin(ALIGNMENTS[name], config)
    step_ns = samples[-1].t_ns
    for lap in range(3):
        for sample in samples:
            run_, status = advance(run_, sample._replace(t_ns=sample.t_ns + lap * step_ns))
            assert not (status.done and lap > 0), "it was not meant to end"
        sizes.append(size_of(run_.state))
    assert sizes[2] < 1.25 * max(sizes[0], sizes[1]) + 20_000, sizes


EVERY_OPTION = """
coarse_s = 61.0
fine_s = 239.0
position_deg_m = [47.0, 8.0, 400.0]
position_sigma_m = 9.0
sway_m_s = 0.004
rest_s = 4.0
heading_deg = 1.0
window_s = 41.0
store_s = 901.0
replay_samples = 65
known_heading_deg = 40.0
known_heading_sigma_deg = 2.0
known_attitude_deg = [1.0, 2.0, 40.0]
known_attitude_sigma_deg = [0.2, 2.0]
slip_m_s = 0.01
slope_deg = 1.0
"""


def test_every_field_of_its_configuration_can_be_configured() -> None:
    attachments, _ = bench_frames(3.0)
    head, table, rest = attachments[ATTACHMENT].decode().partition("[navigator.main.align]\n")
    text = head.replace("[navigator.main]\n", "[navigator.main]\ngnss_velocity_age_ms = 100.0\n")
    text += table + EVERY_OPTION + rest[rest.index("[") :]
    align = navigator_config("main", Config.from_files({**attachments, ATTACHMENT: text.encode()})).align
    assert align is not None
    plain = AlignConfig(0.0, 0.0, 0.0, 0.0)
    names = [each.name for each in fields(AlignConfig)]
    same = [n for n in names if str(getattr(align, n)) == str(getattr(plain, n))]
    assert same == []
    assert {option.name for option in msgspec.structs.fields(AlignOptions)} == set(
        re.findall(r"^(\w+) =", EVERY_OPTION, re.M)
    )
    assert align.heading == pytest.approx((math.radians(40.0), math.radians(2.0)))
    assert align.attitude is not None
    heading, pitch, roll = euler_from_dcm(dcm_from_quat(align.attitude[0]) @ align.C_vb.T)
    np.testing.assert_allclose(np.degrees([pitch, roll, heading]), [1.0, 2.0, 40.0])
    np.testing.assert_allclose(np.degrees(align.attitude[1]), [0.2, 0.2, 2.0])


# ---- from the configuration, through the engine --------------------------------------------------------


@pytest.mark.parametrize("name", ALIGNMENTS)
def test_it_is_configured_by_name_and_started_by_number(name: str) -> None:
    attachments, frames = bench_frames(3.0)
    table = b"[navigator.main.align]\n"
    text = attachments[ATTACHMENT].replace(table, table + b"known_heading_deg = 40.0\nstore_s = 600.0\n")
    number = f'alignment = "{name}"'.encode()
    configured = Config.from_files({**attachments, ATTACHMENT: text.replace(b'alignment = "static"', number)})
    engine = Engine(configured, warm=False)
    assert engine.navigators["main"].config.alignment == name
    said = [out for frame in frames[:600] for out in engine.feed(frame) if isinstance(out, Progress)]
    assert {out.method for out in said} == {name}
    engine = Engine(Config.from_files({**attachments, ATTACHMENT: text}), warm=False)
    for frame in frames[:100]:
        engine.feed(frame)
    verdict = engine._order(CommandCode.RESTART, METHODS[name], [])
    assert (verdict.result, verdict.methods) == (Result.ACCEPTED, {"main": name})
    said = [out for frame in frames[100:600] for out in engine.feed(frame) if isinstance(out, Progress)]
    assert {out.method for out in said} == {name}
