"""The bridge configuration and the calibration sheet that go with a bench, as TOML text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from virtual_bus.crab import CRAB_SHORTEST
from virtual_bus.devices import EACH, FRAME_NS
from virtual_bus.ellipsoid import G0
from virtual_bus.flexure import Markov
from virtual_bus.grades import (
    ARCSEC,
    DEG_PER_H,
    DEG_PER_SQRT_H,
    PPM,
    RANGE_DEG_C,
    REFERENCE_DEG_C,
    UG,
    Grade,
    ImuErrors,
    Triad,
    thermal,
)
from virtual_bus.master import HEIGHT_S
from virtual_bus.scenario import Scenario
from virtual_bus.tables import DeviceTable, ImuTable
from virtual_bus.truth import mounting_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Wiring:
    """What a configuration is made from; ``buses`` are the real channels by the scenario's names."""

    scenario: Scenario
    grade: Grade
    calibration: str
    interface: str
    buses: Mapping[str, str]
    fd: bool


_STAMPS_M_S: Final = 0.003
"""Stamps of the wheel come in steps of 0.1 ms: so much at 15 m/s over the time that ticks are gathered."""
_TICKS_S: Final = 0.2
"""So long ticks are gathered, and the road is held against the path meanwhile."""
_SHARP_RAD_S: Final = 0.5
"""A sharp turn: 90 degrees in seven seconds at its quickest."""
_ALIGN_MARGIN_S: Final = 4.0
_TRANSFER_S: Final = 5.0
_TRANSFER_MRAD: Final = 1.0
_DATED_MS: Final = 10.0  # of the master's messages: one sigma
_COARSE_S: Final = 60.0
_WARMING: Final = np.linspace(0.0, 6.0, 121)
"""Instants of warming up, in its time constants."""
_FINE_S: Final = 240.0


def imu_errors(grade: Grade, imu: ImuTable) -> dict[str, float]:
    """What a filter should assume of a unit of ``grade``, calibrated: keys of the bridge's imu_errors.

    Where the filter has no state for what calibration leaves, its biases bear it. Drift by specific force is
    a constant while the force is mostly gravity. What follows temperature is a constant at the one that the
    unit is switched on at, and moves while it warms up: a bias that walks covers this where its variance
    has grown at every instant as far as that has moved.
    """
    gyro_axes, accel_axes = (
        axes * ARCSEC * 1e6 for axes in (grade.gyro_misalignment_arcsec, grade.accel_misalignment_arcsec)
    )
    cold, warm = imu.temperature_deg_c
    course = warm + (cold - warm) * np.exp(-_WARMING)

    def wander(instability: float, moved: Array) -> float:
        walk = float(np.max(moved[1:] ** 2 / _WARMING[1:])) / imu.warm_up_s
        return math.hypot(instability, math.sqrt(0.5 * grade.correlation_s * walk))

    gyro, gyro_moved = thermal(grade.gyro_bias_deg_per_h_per_deg_c, course)
    accel, accel_moved = thermal(grade.accel_bias_ug_per_deg_c, course)
    gyro_scale, gyro_grown = thermal(grade.gyro_scale_ppm_per_deg_c, course)
    accel_scale, accel_grown = thermal(grade.accel_scale_ppm_per_deg_c, course)
    by_force = grade.gyro_g_sensitivity_deg_per_h_per_g
    return {
        "gyro_bias_deg_per_h": math.hypot(grade.gyro_bias_deg_per_h, by_force, gyro),
        "gyro_instability_deg_per_h": wander(grade.gyro_instability_deg_per_h, gyro_moved),
        "gyro_random_walk_deg_per_sqrt_h": grade.gyro_random_walk_deg_per_sqrt_h,
        "gyro_scale_ppm": math.hypot(grade.gyro_scale_ppm, gyro_scale, float(gyro_grown.max())),
        # at 1 g a misalignment looks like a bias of as many ug of the level sensors
        "accel_bias_ug": math.hypot(grade.accel_bias_ug, accel_axes, accel),
        "accel_instability_ug": wander(grade.accel_instability_ug, accel_moved),
        "accel_random_walk_ug_per_sqrt_hz": grade.accel_random_walk_ug_per_sqrt_hz,
        "accel_scale_ppm": math.hypot(grade.accel_scale_ppm, accel_scale, float(accel_grown.max())),
        "gyro_axes_ppm": gyro_axes,
        "accel_axes_ppm": accel_axes,
        "correlation_s": grade.correlation_s,
    }


def off_road_m_s(grade: Grade, arm_m: float) -> float:
    """What wheels that never leave the road seem to leave it by, m/s in the mean of an interval of ticks.

    It is of the gyros, which turn the lever arm to the wheels (m): their noise, and what calibration has left
    of their misalignment in a sharp turn.
    """
    noise = grade.gyro_random_walk_deg_per_sqrt_h * DEG_PER_SQRT_H / math.sqrt(_TICKS_S)
    return arm_m * math.hypot(noise, grade.gyro_misalignment_arcsec * ARCSEC * _SHARP_RAD_S)


def alignment_s(rest_s: float, total: float | None = None) -> tuple[float, float]:
    """Coarse and fine time (s) of an alignment of ``total`` s, or of one that ends before a rest does."""
    if total is None:
        total = max(2.0, rest_s - _ALIGN_MARGIN_S)
    coarse = min(_COARSE_S, 0.25 * total)
    return coarse, min(_FINE_S, total - coarse)


def calibration_toml(
    errors: ImuErrors, grade: Grade, arms_mm: Sequence[Sequence[float]] | None = None
) -> str:
    """The calibration sheet: what was measured of this unit, so not quite what it is; the arms are."""
    gyro, accel = errors.calibrated_gyro, errors.calibrated_accel
    lines = [
        "[device]",
        f'model = "simulated unit of grade {grade.name}"',
        f"serial = {errors.serial}",
        "",
        "[gyro]",
        f"scale_arcsec_per_pulse = {_vector(gyro.scale / ARCSEC)}",
        f"bias_deg_per_h = {_vector(gyro.bias / DEG_PER_H)}",
        f"g_sensitivity_deg_per_h_per_g = {_matrix(gyro.g_sensitivity * G0 / DEG_PER_H)}",
        _axes(gyro),
        *_second_order(gyro, "deg_per_h", DEG_PER_H),
        *_temperature(gyro, "deg_per_h", DEG_PER_H),
        "",
        "[accel]",
        f"scale_m_s_per_pulse = {_vector(accel.scale)}",
        f"bias_ug = {_vector(accel.bias / UG)}",
        _axes(accel),
        *_second_order(accel, "ug", UG),
        *_temperature(accel, "ug", UG),
    ]
    if arms_mm is not None:
        lines.append(f"lever_arm_mm = {_matrix(np.array(arms_mm))}")
    if _temperature(gyro, "", 1.0) or _temperature(accel, "", 1.0):
        lines += [
            "",
            "[temperature]",
            f"reference_deg_c = {REFERENCE_DEG_C!r}",
            f"range_deg_c = {list(RANGE_DEG_C)!r}",
        ]
    return "\n".join(lines) + "\n"


def _axes(triad: Triad) -> str:
    """The line with the directions of a triad, or of more sensors."""
    if len(triad.axes) > EACH:
        return f"axes = {_matrix(triad.axes)}"
    return f"misalignment_arcsec = {_matrix((triad.axes - np.eye(3)) / ARCSEC)}"


def _redundant(grade: Grade) -> list[str]:
    """What the sensors of a redundant unit of ``grade`` differ by, for who holds them against each other."""
    return [
        "[device.imu.redundant]",
        f"gyro_random_walk_deg_per_sqrt_h = {grade.gyro_random_walk_deg_per_sqrt_h!r}",
        f"gyro_bias_deg_per_h = {math.hypot(grade.gyro_bias_deg_per_h, grade.gyro_instability_deg_per_h)!r}",
        f"gyro_scale_ppm = {max(grade.gyro_scale_ppm, grade.gyro_misalignment_arcsec * ARCSEC / PPM)!r}",
        f"accel_random_walk_ug_per_sqrt_hz = {grade.accel_random_walk_ug_per_sqrt_hz!r}",
        f"accel_bias_ug = {math.hypot(grade.accel_bias_ug, grade.accel_instability_ug)!r}",
        f"accel_scale_ppm = {max(grade.accel_scale_ppm, grade.accel_misalignment_arcsec * ARCSEC / PPM)!r}",
        "",
    ]


def _second_order(triad: Triad, unit: str, size: float) -> list[str]:
    """Lines with the second-order terms of a triad that has some; ``size`` is its unit in SI."""
    if not triad.second.any():
        return []
    per_g2 = triad.second * G0**2 / size
    products = 2.0 * np.stack((per_g2[:, 1, 2], per_g2[:, 2, 0], per_g2[:, 0, 1]), axis=1)
    squares = np.diagonal(per_g2, axis1=1, axis2=2)
    return [f"square_{unit}_per_g2 = {_matrix(squares)}", f"product_{unit}_per_g2 = {_matrix(products)}"]


def _temperature(triad: Triad, unit: str, size: float) -> list[str]:
    """Lines with a triad's polynomials in temperature, where it has some."""
    if not (triad.scale_temperature.any() or triad.bias_temperature.any()):
        return []
    return [
        f"scale_temperature_ppm_per_deg_c = {_matrix(triad.scale_temperature / PPM)}",
        f"bias_temperature_{unit}_per_deg_c = {_matrix(triad.bias_temperature / size)}",
    ]


def _transfer(s: Scenario) -> list[str]:
    """What a slave is told of its master: its noise with that of what shakes the slave, and what bends."""
    master = s.master
    if master is None:
        return []
    bends, shake, shakes = [], 0.0, 0.0
    if s.flexure is not None:
        shake = max(s.flexure.vibration_mrad)
        shakes = 2.0 * math.pi * s.flexure.vibration_hz * shake  # mrad/s
        bends = [
            f"flexure_mrad = {list(s.flexure.sigma_mrad)!r}",
            f"flexure_s = {list(s.flexure.correlation_s)!r}",
        ]
    held = Markov.correlated(master.height_m, HEIGHT_S)
    swing = 1e-3 * shakes * float(np.linalg.norm(s.lever_arm()))
    noise = {
        "mounting_sigma_deg": max(0.01, s.vehicle.mounting_sigma_deg),
        "velocity_noise_m_s": max(0.001, math.hypot(master.velocity_noise_m_s, swing)),
        "attitude_noise_mrad": max(0.01, math.hypot(master.attitude_noise_mrad, shake)),
        "position_noise_m": max(0.01, master.position_noise_m),
        "rate_noise_deg_per_s": max(
            1e-3, math.hypot(master.rate_noise_deg_per_s, math.degrees(1e-3 * shakes))
        ),
        # of its velocity, critically damped
        "vertical_walk_m_s_per_sqrt_s": 2.0 * held.sigma * held.rate**1.5,
    }
    return [
        "",
        "[navigator.main.transfer]",
        f"lever_arm_m = {_vector(s.lever_arm())}",
        f"mounting_deg = {_vector(np.array(s.vehicle.mounting_deg))}",
        *(f"{key} = {value!r}" for key, value in noise.items()),
        f"latency_sigma_ms = {_DATED_MS!r}",
        *bends,
        f"duration_s = {s.navigator.alignment_s or _TRANSFER_S!r}",
        f"sigma_mrad = {[_TRANSFER_MRAD] * 3!r}",
    ]


def config_toml(wiring: Wiring, mavlink_url: str | None) -> str:
    """A configuration of the bridge for the bench that ``wiring`` describes."""
    s = wiring.scenario
    lines = [f"# made for the simulated bench: {s.title}"]
    for name, channel in wiring.buses.items():
        lines += [
            f"[source.{name}]",
            'type = "can"',
            f"interface = {_text(wiring.interface)}",
            f"channel = {_text(channel)}",
            f"fd = {str(wiring.fd).lower()}",
            "",
        ]
    if mavlink_url is not None:
        lines += ["[source.telemetry]", 'type = "mavlink"', f"url = {_text(mavlink_url)}", ""]
    # frames of one sample follow each other; the drivers stamp the IMU's by the last of them
    before = (0 if s.imu.fd else 2 if s.imu.axes is None else 4) + (0 if s.imu.dither_hz is None else 1)
    last_ms = 1e-6 * FRAME_NS * before
    imu = [f"calibration = {_text(wiring.calibration)}", f"rate_hz = {s.imu.rate_hz!r}"]
    if s.navigator.whole_cycle is not None:
        imu.append(f"whole_cycle = {_text(s.navigator.whole_cycle)}")
    lines += _device("imu", "imu_can", s.imu, imu, last_ms)
    if s.imu.axes is not None:
        lines += _redundant(wiring.grade)
    if s.odometer is not None:
        lines += _device("odometer", "odometer_can", s.odometer, [f"m_per_tick = {s.odometer.m_per_tick!r}"])
    if s.speed is not None:
        lines += _device("speed", "speed_can", s.speed, [])
    if s.gnss is not None:
        lines += _device("gnss", "gnss_can", s.gnss, [])
    if s.master is not None:
        lines += _device("master", "master_can", s.master, [])
    if s.baro is not None:
        lines += _device("baro", "baro_can", s.baro, [f"sigma_m = {max(0.01, s.baro.noise_m)!r}"])

    devices = s.devices()
    if "table" in devices:  # which no navigator hears
        lines += _device("table", "table_can", devices.pop("table"), [], 1e-6 * FRAME_NS)

    v = s.vehicle
    # a slave is a vehicle of its own, its axes the IMU's
    mounting_deg, sigma_deg = (
        (v.mounting_deg, v.mounting_sigma_deg) if s.master is None else ((0.0,) * 3, 0.0)
    )
    C_bv = mounting_matrix(*mounting_deg).T
    imu_at = np.array(v.imu_m)
    arms = {
        "gnss_lever_arm_m": np.array(v.antenna_m),
        "odometer_lever_arm_m": np.zeros(3),
        "output_point_m": imu_at if v.output_m is None else np.array(v.output_m),
    }
    coarse_s, fine_s = alignment_s(s.rest_s(), s.navigator.alignment_s)
    place_deg_m = (s.start.lat_deg, s.start.lon_deg, s.start.height_m)
    # the simulated vehicle stands as still as a pulse of the accelerometers can say, or never
    stands = s.sway is None and s.start.speed_m_s == 0.0
    still = wiring.grade.accel_m_s_per_pulse if stands else 0.0
    known = [f"zero_velocity_sigma_m_s = {still!r}"]
    if s.gnss is not None and max(s.gnss.correlated_m) > 0.0:
        known.append(f"gnss_correlated_m = {list(s.gnss.correlated_m)!r}")
        known.append(f"gnss_correlation_s = {s.gnss.correlation_s!r}")
    if s.odometer is not None:
        known.append(f"odometer_sigma_m_s = {_STAMPS_M_S!r}")
        known.append(f"odometer_walk_m_per_sqrt_m = {s.odometer.walk_m_per_sqrt_m!r}")
        known.append(f"odometer_scale_ppm = {max(1.0, s.odometer.scale_error_ppm)!r}")
    if s.baro is not None:
        known.append(f"barometer_bias_m = {max(0.01, math.hypot(s.baro.offset_m, s.baro.drift_m))!r}")
        # a Markov process in the short run
        wander = s.baro.drift_m * math.sqrt(2.0 / s.baro.correlation_s)
        known.append(f"barometer_wander_m_per_sqrt_s = {wander!r}")
    mounting = '"find"' if s.navigator.find_mounting else _vector(np.array(mounting_deg))
    lines += [
        "[navigator.main]",
        "devices = [" + ", ".join(_text(name) for name in devices) + "]",
        f"alignment = {_text(s.navigator.alignment)}",
        f"autostart = {str(s.navigator.autostart).lower()}",
        f"mounting_deg = {mounting}",
        f"mounting_sigma_deg = {sigma_deg!r}",
        f"non_holonomic = {str(s.navigator.non_holonomic).lower()}",
        f"non_holonomic_sigma_m_s = {max(1e-6, off_road_m_s(wiring.grade, math.hypot(*v.imu_m)))!r}",
        # white over longer distances than its shortest wave
        f"sideways_walk_m_per_sqrt_m = {math.radians(v.crab_deg) * math.sqrt(0.5 * CRAB_SHORTEST)!r}",
        *(f"{key} = {_vector(C_bv @ (point - imu_at))}" for key, point in arms.items()),
        *known,
        "",
        "[navigator.main.align]",
        f"coarse_s = {coarse_s!r}",
        f"fine_s = {fine_s!r}",
        *([] if s.sway is None else [f"sway_m_s = {max(0.001, s.sway.speed_m_s(v.imu_m))!r}"]),
        *(
            []
            if s.gnss is not None or s.master is not None
            else [f"position_deg_m = {_vector(np.array(place_deg_m))}"]
        ),
        "",
        "[navigator.main.imu_errors]",
        *(f"{key} = {value!r}" for key, value in imu_errors(wiring.grade, s.imu).items()),
        *_transfer(s),
        "",
        "[sink.solution]",
        'type = "can_solution"',
        f"source = {_text(next(iter(wiring.buses)))}",
        'navigator = "main"',
        "rate_hz = 50.0",
        f"polar = {_text(s.navigator.polar)}",
    ]
    if mavlink_url is not None:
        lines += ["", "[sink.telemetry]", 'type = "mavlink"', 'source = "telemetry"', 'navigator = "main"']
    return "\n".join(lines) + "\n"


def _device(name: str, driver: str, table: DeviceTable, extra: list[str], more_ms: float = 0.0) -> list[str]:
    return [
        f"[device.{name}]",
        f'driver = "{driver}"',
        f"source = {_text(table.channel)}",
        f"latency_ms = {round(table.latency_ms + more_ms, 6)!r}",
        *extra,
        "",
    ]


def _text(value: str) -> str:
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _vector(values: Array) -> str:
    # adding zero turns a minus zero into a plain one
    return "[" + ", ".join(repr(float(value) + 0.0) for value in values) + "]"


def _matrix(values: Array) -> str:
    return "[" + ", ".join(_vector(row) for row in values) + "]"
