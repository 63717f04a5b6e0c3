"""From ``navbridge sim turntable`` by way of ``navbridge calibrate`` to ``navbridge run``."""

from __future__ import annotations

import argparse
import json
import threading
import time
import tomllib
from dataclasses import replace

import can
import numpy as np
import pytest

from bridge import arguments, calibrating
from bridge.calibration import read_calibration
from bridge.calibration_capture import record, same_unit
from bridge.calibration_plan import Site, as_toml, load, packaged, read
from bridge.cli import main
from bridge.errors import CalibrationError, ConfigError
from bridge.recording import Capture
from bridge.studies import calibration_campaign as study
from bridge.studies.turntable import scenario_of
from nav.calibrate.model import NUISANCE
from nav.imu.geometry import GEOMETRIES
from virtual_bus.bus import CALIBRATION, Bench
from virtual_bus.sensors import generator

SEED = 3
RATE = 25.0
FACES = ("SUW", "NUE", "UWS", "DWN", "NWU", "SWD", "NDW", "SDE")


def plan_text(faces=FACES, dwell=8.0, rate=60.0, site=True):
    lines = ['title = "small"', *(["[site]", "lat_deg = 34.25", "height_m = 400.0"] if site else [])]
    for one in faces:
        lines += ["[[position]]", f'faces = "{one}"', f"dwell_s = {dwell}"]
    for one, axis in (("UEN", "x"), ("NUE", "y"), ("ENU", "z")):
        for sign in (1.0, -1.0):
            lines += ["[[rotation]]", f'faces = "{one}"', f'axis = "{axis}"']
            lines += [f"rate_deg_per_s = {sign * rate}", "turns = 1"]
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with a plan, the capture of its execution and the bench's configuration."""
    folder = tmp_path_factory.mktemp("turntable")
    (folder / "plan.toml").write_text(plan_text())
    simulate(folder, folder / "table.mcap")
    return folder


def simulate(folder, out, grade="rlg"):
    words = ["sim", "turntable", str(folder / "plan.toml"), "--grade", grade, "--rate-hz", str(RATE)]
    words += ["--seed", str(SEED), "--out", str(out), "--config-out", str(folder / "config")]
    assert main(words) == 0


@pytest.fixture(scope="module")
def recorded(bench):
    return record(Capture(bench / "table.mcap"), None)


@pytest.fixture(scope="module")
def result(bench, recorded):
    return calibrating.calibrate(load(bench / "plan.toml"), None, [recorded])


def test_the_file_is_a_certificate(bench, capsys):
    out, picture = bench / "imu.toml", bench / "residuals.png"
    words = ["calibrate", str(bench / "plan.toml"), str(bench / "table.mcap")]
    assert main([*words, "--out", str(out), "--picture", str(picture)]) == 0
    text = capsys.readouterr().out
    file = read_calibration(out.read_bytes(), "imu.toml")
    unit = Bench(scenario_of(load(bench / "plan.toml"), None, "rlg", RATE), seed=SEED).imu_errors
    assert file.serial == unit.serial
    assert f"serial number {unit.serial}" in text
    assert file.certificate is not None
    # the simulated bench begins on a GPS day of its own, and warms from 25 to 37 degrees in an hour
    assert file.certificate.date.startswith("2024-02-06T11:59:42")
    assert 25.0 <= file.certificate.temperature_deg_c < 31.0
    assert file.certificate.captures == ["table.mcap"]
    assert "gyro x scale" in text
    assert "seen mostly in combination with others" in text
    assert picture.read_bytes().startswith(b"\x89PNG")
    document = tomllib.loads(out.read_text())
    assert set(document["sigma"]["gyro"]) == set(document["gyro"])
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["certificate"] == document["certificate"]


def test_coefficients_are_as_wrong_as_they_say(bench, result):
    scenario = scenario_of(load(bench / "plan.toml"), None, "rlg", RATE)
    unit = Bench(scenario, seed=SEED).imu_errors
    delta, gravity = scenario.drawn(generator(SEED, "vehicle/mounting"))
    truth = np.concatenate((study.truth(result.fit.model, unit), delta, [gravity / scenario.gravity - 1.0]))
    error = (result.fit.theta - truth) / result.fit.sigma
    assert np.abs(error).max() < 4.5
    # one unit of six sensors: of 39 correlated errors no more than 8 beyond two sigmas (see `band`)
    assert np.mean(np.abs(error[: -len(NUISANCE)]) < 2.0) > 0.8
    assert 0.3 < result.fit.chi2 / result.fit.freedom < 2.0


def test_the_clock_of_the_unit_is_measured_against_the_host(bench, recorded):
    device = Bench(scenario_of(load(bench / "plan.toml"), None, "rlg", RATE), seed=SEED)
    ppm = float(generator(SEED, "imu/bus").standard_normal()) * device.grade.clock_ppm
    # 0.1 ms of jitter over 200 s of 5000 samples, of which the model keeps the least delayed
    assert 1e6 * (1.0 / recorded.ratio - 1.0) == pytest.approx(ppm, abs=0.3)


def test_the_bridge_runs_with_the_file(bench, result):
    (bench / "config" / CALIBRATION).write_text(calibrating.file_of(result))
    from bridge.config import Config
    from bridge.engine import build_drivers
    from bridge.frame import RawFrame

    config = Config.load(bench / "config" / "config.toml")
    driver = build_drivers(config)["imu"]
    scenario = scenario_of(load(bench / "plan.toml"), None, "rlg", RATE)
    device = Bench(scenario, seed=SEED, seconds=8.0)
    made = []
    for seq, frame in enumerate(device.due(device.end_ns)):
        made += driver.feed(RawFrame(seq, frame.t_ns, 1, frame.frame_id, frame.data))
    f_b = np.sum([one.dv for one in made], axis=0) / np.sum([one.dt for one in made])
    true = device.trajectory.increments(np.array([0, 8_000_000_000]))[1][0] / 8.0
    # 50 ug of gravity that nobody knows, noise of 8 ug/sqrt(Hz) over 8 s and 3 ug of instability
    np.testing.assert_allclose(f_b, true, rtol=0, atol=3e-4 * 9.8)
    raw = device.imu_errors.accel.bias
    assert np.abs(f_b - true).max() < 0.3 * np.abs(raw).max()


def test_check_says_what_the_file_says_of_itself(bench, result, capsys):
    (bench / "config" / CALIBRATION).write_text(calibrating.file_of(result))
    assert main(["check", str(bench / "config" / "config.toml")]) == 0
    said = capsys.readouterr().out
    assert f"{CALIBRATION}: for serial number {result.serial}, 2024-02-06 at " in said
    assert main(["check", "bench"]) == 0
    assert "fog.toml: for any unit, no certificate" in capsys.readouterr().out


def test_run_refuses_the_file_of_another_unit(bench, result, capsys):
    text = calibrating.file_of(result)
    (bench / "config" / CALIBRATION).write_text(text.replace(f"serial = {result.serial}", "serial = 7"))
    (bench / "config" / "config.toml").write_text(
        (bench / "config" / "config.toml")
        .read_text()
        .replace('"socketcan"', '"virtual"')
        .replace('"vcan0"', '"foreign"')
    )
    device = Bench(scenario_of(load(bench / "plan.toml"), None, "rlg", RATE), seed=SEED, seconds=60.0)
    done = threading.Event()

    def send() -> None:
        with can.Bus(interface="virtual", channel="foreign") as bus:
            begin = time.monotonic_ns()
            while not done.is_set():
                device.send_due(dict.fromkeys(device.channels, bus), time.monotonic_ns() - begin)
                while bus.recv(0) is not None:
                    pass
                done.wait(0.005)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        status = main(["run", str(bench / "config" / "config.toml"), "--seconds", "20"])
    finally:
        done.set()
        thread.join()
    said = capsys.readouterr().err
    assert status == 2
    assert f"serial number {result.serial}, but the calibration is for 7: no sample is used" in said
    assert "device.imu.calibration: found the calibration of another unit than imu on the bus" in said


def test_captures_of_two_units_are_told_apart(recorded):
    other = replace(recorded, serial=7, stream=replace(recorded.stream, name="other.mcap"))
    with pytest.raises(CalibrationError, match=r"serial number \d+ in table.mcap, 7 in other.mcap"):
        same_unit([recorded, other])


def test_a_capture_run_with_another_units_file_is_refused(bench, monkeypatch):
    text = Bench.calibration_toml

    def foreign(self):
        return text(self).replace(f"serial = {self.imu_errors.serial}", "serial = 7")

    monkeypatch.setattr(Bench, "calibration_toml", foreign)
    out = bench / "foreign.mcap"
    words = ["sim", "turntable", str(bench / "plan.toml"), "--rate-hz", str(RATE), "--seconds", "5"]
    assert main([*words, "--out", str(out)]) == 0
    with pytest.raises(CalibrationError, match=rf"{CALIBRATION}, is for 7"):
        record(Capture(out), None)


def test_saturated_counts_are_refused(bench, capsys):
    """60 deg/s at 25 Hz are 86400 pulses of 0.1 arcsec: more than a counter of 16 bits holds."""
    out = bench / "saturated.mcap"
    simulate(bench, out, grade="fog")
    assert main(["calibrate", str(bench / "plan.toml"), str(out)]) == 1
    said = capsys.readouterr().err
    assert "rotation 1, +x in UEN: saturated counts in" in said


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("SUW", "NUE", "UNW", *FACES[3:]), "step 3 .*: the unit was turned, to about UWS, which is 90 deg"),
        (("NUE", "SUW", *FACES[2:]), None),
        ((*FACES[:4], "ENU", *FACES[4:]), "missing: the capture goes on with"),
        (("SUW", *FACES[2:]), "step 2 .position 2, UWS.: up is 90 deg from where the plan has it: along"),
    ],
    ids=["another", "north and south", "one more", "one less"],
)
def test_a_plan_that_is_not_the_captures(bench, recorded, change, said):
    plan = read(plan_text(change).encode(), "other.toml")
    if said is None:
        # half a turn about the vertical at the beginning alone: only the Earth's rate could tell
        with pytest.raises(CalibrationError):
            calibrating.calibrate(plan, None, [recorded])
        return
    with pytest.raises(CalibrationError, match=said):
        calibrating.calibrate(plan, None, [recorded])


def test_a_table_that_was_moved_is_named(bench, recorded, result):
    """Tilted by 300 arcsec about east before the fifth position: gravity is seen to the table's north.

    With unknown biases and axes eight positions cannot tell that from two others.
    """
    plan, stream = load(bench / "plan.toml"), recorded.stream
    end = stream.begin + np.cumsum(stream.dt)
    counts = stream.counts.copy()
    for one, step in zip(result.intervals[4:8], plan.steps[4:8], strict=True):
        inside = (end > one.begin - 1.5) & (end < one.begin + one.seconds + 1.5)
        counts[inside, 3:] += np.radians(300.0 / 3600.0) * 9.8 / RATE / 1.5e-5 * step.C_gb[1]
    with pytest.raises(CalibrationError, match=r"table.mcap: the table was moved before") as error:
        calibrating.calibrate(plan, None, [replace(recorded, stream=replace(stream, counts=counts))])
    assert "the table was moved before position 5, NWU" in str(error.value)
    assert "or as likely, " in str(error.value)


def test_a_plan_that_does_not_show_everything_proposes_what_would(recorded):
    text = plan_text(("SUW", "NUE", "UWS"))
    with pytest.raises(CalibrationError) as error:
        calibrating.calibrate(read(text.encode(), "poor.toml"), None, [recorded])
    said = str(error.value)
    assert said.startswith("poor.toml: the plan does not show")
    assert "accelerometer" in said
    more = said.partition("; add to the plan: ")[2].replace(" | ", "\n")
    plan = read((text + more).encode(), "richer.toml")
    model = calibrating.model_of(plan, plan.at(None)[1], study.nominal_of(study.GRADES["rlg"]))
    assert calibrating.look(plan, model, recorded.noise).unseen == ()


def test_a_plan_alone_promises_sigmas(bench, capsys):
    assert (
        main(["calibrate", str(bench / "plan.toml"), "--config", str(bench / "config" / "config.toml")]) == 0
    )
    text = capsys.readouterr().out
    assert "gyro x g sensitivity x" in text
    assert main(["calibrate", str(bench / "plan.toml")]) == 2
    assert "expected captures, or --config" in capsys.readouterr().err


@pytest.mark.parametrize("name", packaged())
def test_packaged_plans_show_everything(name):
    plan = load(name)
    axes = GEOMETRIES["skew" if name == "positions_18" else "orthogonal"]
    nominal = study.nominal_of(study.GRADES["fog"], axes)
    model = calibrating.model_of(plan, plan.at(Site(45.0, 0.0))[1], nominal)
    assert calibrating.look(plan, model, study.noise_of(study.GRADES["fog"])).unseen == ()
    with pytest.raises(ConfigError, match="expected \\[site\\] with lat_deg and height_m, or --site"):
        plan.at(None)
    # what is written of steps is read as the same steps
    again = read(f'title = "again"\n{chr(10).join(as_toml(plan.steps))}\n'.encode(), "again.toml")
    for one, two in zip(plan.steps, again.steps, strict=True):
        np.testing.assert_allclose(one.C_gb, two.C_gb, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('faces = "SUW"', 'faces = "SUE"', 'position[0].faces: found "SUE", expected a right-handed triad'),
        ('faces = "SUW"', 'faces = "SUX"', "expected three letters of N, E, S, W, U, D"),
        ('faces = "SUW"', "", "position[0]: found"),
        ('faces = "NUE"', 'faces = "SUW"', "expected another attitude than that before"),
        ("dwell_s = 8.0", "dwell_s = 1.0", "position[0].dwell_s"),
        ("rate_deg_per_s = 60.0", "rate_deg_per_s = 0.5", "expected at least 1 either way"),
        ('axis = "x"', 'axis = "w"', "rotation[0].axis"),
        ("turns = 1", "turns = 0", "rotation[0].turns"),
        ("lat_deg = 34.25", "lat_deg = 94.25", "site.lat_deg"),
        ('title = "small"', 'title = "small"\nspeed = 1', "speed: found an unknown key"),
    ],
)
def test_a_wrong_plan_says_what_is_wrong(old, new, said):
    with pytest.raises(ConfigError) as error:
        read(plan_text().replace(old, new, 1).encode(), "plan.toml")
    assert said in str(error.value)
    assert "plan.toml: " in str(error.value)


def test_a_plan_that_is_not_there(capsys):
    assert main(["calibrate", "positions_23", "x.mcap"]) == 2
    assert 'did you mean "positions_24"?' in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["drive", "positions_8"], "PLAN: found one, but only the scenario turntable has it"),
        (["drive", "--grade", "rlg"], "--grade: found one, but only the scenario turntable has it"),
        (["turntable"], "PLAN: found nothing, expected a file or, packaged, one of positions_12"),
        (["turntable", "positions_8"], "positions_8.toml: site: found nothing, expected [site]"),
    ],
)
def test_what_the_simulated_table_is_not_told(words, said, capsys):
    assert main(["sim", *words, "--interface", "virtual", "--channel", "nobody"]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("text", ["45", "91,0", "45,20000", "45,0,9.6", "45,0,9.8,1", "north"])
def test_a_site_is_latitude_height_and_gravity(text):
    assert arguments.site("45,100,9.806") == (45.0, 100.0, 9.806)
    with pytest.raises(argparse.ArgumentTypeError, match="expected latitude in deg,height in m"):
        arguments.site(text)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("freedom = ", 'freedom = "many"  # ', "certificate.freedom: found"),
        ("[certificate]", "[certificate]\nowner = 1", "certificate.owner: found an unknown key"),
        ("[sigma.gyro]", "[sigma.gyros]", "sigma.gyros: found gyros, expected tables of gyro, accel"),
        (
            "[sigma.gyro]",
            "[sigma.gyro]\nbias_deg_per_s = [0, 0, 0]",
            "sigma.gyro.bias_deg_per_s: found an unknown",
        ),
        ("[sigma.gyro]", "[sigma.gyro]\nscale = 3\n[x]", "x: found an unknown table"),
    ],
)
def test_a_spoilt_certificate_says_what_is_wrong(result, old, new, said):
    text = calibrating.file_of(result)
    assert old in text
    with pytest.raises(ConfigError) as error:
        read_calibration(text.replace(old, new, 1).encode(), "imu.toml")
    assert said in str(error.value)


def test_a_few_rounds_of_the_campaign():
    plan = read(plan_text(dwell=30.0, rate=20.0).encode(), "plan.toml")
    found = study.run_calibrations(plan, None, "fog", 6)
    assert found.passed, study.lines([found])
    assert len(found.names) == 39
    low, high = found.band
    assert low < found.coverage <= high == 1.0


@pytest.mark.parametrize(("geometry", "coefficients"), [("skew", 65), ("cone", 78)])
def test_a_round_with_more_than_three_axes(geometry, coefficients):
    found = study.run_calibrations(load("positions_18"), Site(45.0, 0.0), "fog", 1, geometry=geometry)
    assert found.passed, study.lines([found])
    assert len(found.names) == coefficients


def test_face_positions_are_refused_for_the_skewed_axes():
    said = "accelerometer 4 asymmetry and accelerometer 4 bias one from another; accelerometer 5 asymmetry"
    with pytest.raises(CalibrationError, match=said):
        study.run_calibrations(load("positions_12"), Site(45.0, 0.0), "fog", 1, geometry="skew")
