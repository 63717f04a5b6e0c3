"""From a navigator's table to the navigator: here its units become SI, once."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from bridge.config import Config
from bridge.drivers import DRIVERS
from bridge.errors import ConfigError
from bridge.options import NavigatorOptions, Three, TransferOptions
from bridge.strict import unknown, wrong
from nav.align import AlignConfig, lack
from nav.align.types import TransferConfig
from nav.filter.settings import align_config, sensors_align
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.rotation import dcm_from_euler, quat_from_dcm
from nav.strapdown.azimuth import AZIMUTH_LAWS
from nav.transfer import alignment, methods
from nav.types import Vector

_DEG: Final = math.pi / 180.0
_DEG_PER_H: Final = _DEG / 3600.0
_DEG_PER_SQRT_H: Final = _DEG / 60.0
_UG: Final = 1e-6 * 9.80665
_SYNCHRONISED_MS: Final = 1.0
_UNSYNCHRONISED_MS: Final = 40.0


def provided(name: str, config: Config) -> dict[str, list[str]]:
    """Kinds of samples that a navigator gets, each with the devices or navigators it gets them from."""
    kinds: dict[str, list[str]] = {}
    for device in config.navigators[name].devices:
        options = config.devices[device]
        for kind in DRIVERS[options.driver].provides(options):
            kinds.setdefault(kind, []).append(device)
    master = config.navigators[name].master_navigator
    if master is not None:
        kinds.setdefault("master", []).append(master)
    return kinds


def build_navigator(name: str, config: Config) -> Navigator:
    """The navigator of one ``[navigator.NAME]``, in STANDBY.

    Raises:
        ConfigError: an unknown alignment or azimuth law, no IMU or two, an aid missing that the alignment
            needs, or values that do not go together.
    """
    return Navigator(navigator_config(name, config))


def navigator_config(name: str, config: Config) -> NavigatorConfig:
    """What ``[navigator.NAME]`` asks for, in SI units.

    Raises:
        ConfigError: as `build_navigator`.
    """
    options = config.navigators[name]
    kinds = provided(name, config)
    key = f"navigator.{name}"
    if options.alignment not in methods():
        raise unknown(config.file, f"{key}.alignment", options.alignment, methods())
    imus = kinds.get("imu", [])
    if len(imus) != 1:
        found = ", ".join(imus) or "no IMU"
        raise ConfigError(f"{config.file}: {key}.devices: found {found}, expected exactly one IMU")
    _check_updates(config.file, key, options)
    channel = options.height_channel
    if channel is not None and "baro" not in kinds:
        expected = "a device among its devices that provides baro"
        raise ConfigError(f"{config.file}: {key}.height_channel: found no barometer, expected {expected}")
    C_vb = _mounting(options)
    errors = imu_errors(options)
    quantum = max(
        (getattr(config.devices[device], "m_per_tick", 0.0) for device in kinds.get("odometer", [])),
        default=0.0,
    )
    align = _align(config.file, key, options, errors, C_vb, quantum, _latency(name, kinds, config))
    _check_needs(config.file, key, options.alignment, lack(alignment(options.alignment), kinds, align))
    rolls = "odometer" in kinds
    moves = rolls or "speed" in kinds
    return NavigatorConfig(
        imu=errors,
        alignment=options.alignment,
        C_vb=C_vb,
        sigma_mounting=options.mounting_sigma_deg * _DEG,
        gnss_lever_arm=np.array(options.gnss_lever_arm_m),
        odometer_lever_arm=np.array(options.odometer_lever_arm_m),
        output_point=np.array(options.output_point_m),
        gnss_position_floor=options.gnss_position_floor_m,
        gnss_velocity_floor=options.gnss_velocity_floor_m_s,
        gnss_velocity_age=options.gnss_velocity_age_ms * 1e-3,
        gnss_correlated=options.gnss_correlated_m,
        gnss_correlation=options.gnss_correlation_s,
        odometer=rolls,
        gnss_timeout=_patience(options.gnss_timeout_s, "gnss" in kinds),
        odometer_timeout=_patience(options.odometer_timeout_s, moves),
        barometer_timeout=_patience(options.barometer_timeout_s, "baro" in kinds),
        odometer_sigma=options.odometer_sigma_m_s,
        odometer_walk=options.odometer_walk_m_per_sqrt_m,
        odometer_quantum=quantum,
        odometer_scale=options.odometer_scale_ppm * 1e-6,
        non_holonomic=options.non_holonomic_sigma_m_s if options.non_holonomic else None,
        sideways_walk=options.sideways_walk_m_per_sqrt_m,
        zero_velocity=options.zero_velocity_sigma_m_s or None,
        zero_rate=options.zero_rate_sigma_deg_per_s * _DEG or None,
        rest_gyro=None if options.rest_gyro_deg_per_s is None else options.rest_gyro_deg_per_s * _DEG,
        rest_accel=options.rest_accel_m_s2,
        azimuth=options.azimuth,
        azimuth_rate=options.azimuth_rate_deg_per_h * _DEG_PER_H,
        samples_per_update=options.samples_per_update,
        height_channel=None if channel is None else (channel.order, channel.time_constant_s),
        baro_bias=options.barometer_bias_m,
        baro_wander=options.barometer_wander_m_per_sqrt_s,
        gap_limit=options.gap_limit_s,
        align=align,
    )


def lacking(name: str, config: Config) -> dict[str, str]:
    """What each alignment lacks for one ``[navigator.NAME]``, a word of its needs or nothing.

    Raises:
        ConfigError: as `build_navigator`.
    """
    kinds = provided(name, config)
    align = align_config(navigator_config(name, config))
    return {method: lack(alignment(method), kinds, align) for method in methods()}


def _check_needs(file: str, key: str, alignment: str, lacks: str) -> None:
    if lacks == "position":
        raise ConfigError(
            f"{file}: {key}.align.position_deg_m: found nothing, expected a position, "
            "as no device provides gnss"
        )
    if lacks == "heading":
        raise ConfigError(
            f"{file}: {key}.align: found neither known_heading_deg nor known_attitude_deg, expected one of "
            f"them with alignment {alignment}"
        )
    if lacks:
        raise wrong(file, f"{key}.alignment", alignment, f"a device that provides {lacks} with it")


def _check_updates(file: str, key: str, options: NavigatorOptions) -> None:
    if options.azimuth not in AZIMUTH_LAWS:
        raise unknown(file, f"{key}.azimuth", options.azimuth, AZIMUTH_LAWS)
    rate = options.azimuth_rate_deg_per_h
    if AZIMUTH_LAWS[options.azimuth].turns != (rate != 0.0):
        expected = "0 with this azimuth law" if rate else "a rate other than 0 with this azimuth law"
        raise wrong(file, f"{key}.azimuth_rate_deg_per_h", rate, f"{expected} ({options.azimuth})")
    imu = options.imu_errors
    if options.samples_per_update == 1 and max(imu.gyro_vibration, imu.accel_vibration) > 0.0:
        expected = "2 or more with a vibration in imu_errors, which shows between samples"
        raise wrong(file, f"{key}.samples_per_update", 1, expected)


def _patience(timeout_s: float, provided: bool) -> float | None:
    return timeout_s if provided and timeout_s > 0.0 else None


def _mounting(options: NavigatorOptions) -> Vector | None:
    return None if isinstance(options.mounting_deg, str) else _turned(options.mounting_deg)


def _turned(angles_deg: Three) -> Vector:
    """What takes axes that are at this pitch, roll and heading in others to these."""
    pitch, roll, heading = (angle * _DEG for angle in angles_deg)
    return dcm_from_euler(heading, pitch, roll)


def _latency(name: str, kinds: dict[str, list[str]], config: Config) -> float:
    """Sigma of the dating of a navigator's master, s: as told, or by whether it has the IMU's clock."""
    told_ms = config.navigators[name].transfer.latency_sigma_ms
    if told_ms is None:
        clocks = {_clock(one, config) for kind in ("imu", "master") for one in kinds.get(kind, [])}
        told_ms = _UNSYNCHRONISED_MS if None in clocks or len(clocks) > 1 else _SYNCHRONISED_MS
    return told_ms * 1e-3


def _clock(name: str, config: Config) -> str | None:
    """The clock that a device shares, or that of the IMU of a navigator."""
    device = config.devices.get(name)
    if device is not None:
        return device.clock
    imus = provided(name, config).get("imu", [])
    return config.devices[imus[0]].clock if len(imus) == 1 else None


def _transfer(table: TransferOptions, latency: float) -> TransferConfig:
    return TransferConfig(
        lever_arm=np.array(table.lever_arm_m),
        sigma_lever_arm=table.lever_arm_sigma_m,
        C_ab=_turned(table.mounting_deg),
        sigma_mounting=np.full(3, table.mounting_sigma_deg * _DEG),
        sigma_velocity=table.velocity_noise_m_s,
        sigma_attitude=table.attitude_noise_mrad * 1e-3,
        sigma_position=table.position_noise_m,
        sigma_rate=table.rate_noise_deg_per_s * _DEG,
        vertical_walk=table.vertical_walk_m_s_per_sqrt_s,
        latency=latency,
        latest_s=table.latest_ms * 1e-3,
        flexure=None if table.flexure_mrad is None else 1e-3 * np.array(table.flexure_mrad),
        flexure_time=np.array(table.flexure_s),
        duration=table.duration_s,
        sigma=1e-3 * np.array(table.sigma_mrad),
        patience=table.patience_s,
        lockout=table.lockout_s,
    )


def imu_errors(options: NavigatorOptions) -> ImuErrors:
    """What a navigator is told of its sensors, in SI."""
    table = options.imu_errors
    return ImuErrors(
        angle_random_walk=table.gyro_random_walk_deg_per_sqrt_h * _DEG_PER_SQRT_H,
        velocity_random_walk=table.accel_random_walk_ug_per_sqrt_hz * _UG,
        gyro_bias=table.gyro_bias_deg_per_h * _DEG_PER_H,
        accel_bias=table.accel_bias_ug * _UG,
        gyro_instability=table.gyro_instability_deg_per_h * _DEG_PER_H,
        accel_instability=table.accel_instability_ug * _UG,
        gyro_bias_time=table.correlation_s,
        accel_bias_time=table.correlation_s,
        gyro_scale=table.gyro_scale_ppm * 1e-6,
        accel_scale=table.accel_scale_ppm * 1e-6,
        gyro_axes=table.gyro_axes_ppm * 1e-6,
        accel_axes=table.accel_axes_ppm * 1e-6,
        gyro_vibration=table.gyro_vibration,
        accel_vibration=table.accel_vibration,
    )


def _align(
    file: str,
    key: str,
    options: NavigatorOptions,
    imu: ImuErrors,
    C_vb: Vector | None,
    quantum: float,
    latency: float,
) -> AlignConfig:
    table, transfer = options.align, options.transfer
    if transfer.patience_s <= transfer.duration_s:
        expected = f"more than its duration_s = {transfer.duration_s:g}"
        raise wrong(file, f"{key}.transfer.patience_s", transfer.patience_s, expected)
    position = heading = attitude = None
    if table.position_deg_m is not None:
        lat, lon, height = table.position_deg_m
        position = (lat * _DEG, lon * _DEG, height)
    if table.known_heading_deg is not None:
        heading = (table.known_heading_deg * _DEG, table.known_heading_sigma_deg * _DEG)
    if table.known_attitude_deg is not None:
        if C_vb is None:
            place = f"{key}.align.known_attitude_deg"
            raise wrong(file, place, table.known_attitude_deg, "none while mounting_deg is to be found")
        pitch, roll, ahead = (angle * _DEG for angle in table.known_attitude_deg)
        level, azimuth = (sigma * _DEG for sigma in table.known_attitude_sigma_deg)
        q_gb = quat_from_dcm(dcm_from_euler(ahead, pitch, roll) @ C_vb)
        attitude = (q_gb, np.array([level, level, azimuth]))
    return replace(
        sensors_align(imu),
        coarse_s=table.coarse_s,
        fine_s=table.fine_s,
        position=position,
        sigma_position=table.position_sigma_m,
        sway=table.sway_m_s,
        gnss_lever_arm=np.array(options.gnss_lever_arm_m),
        gnss_velocity_age=options.gnss_velocity_age_ms * 1e-3,
        C_vb=C_vb,
        sigma_heading=table.heading_deg * _DEG,
        window_s=table.window_s,
        rest_s=table.rest_s,
        store_s=table.store_s,
        replay_samples=table.replay_samples,
        heading=heading,
        attitude=attitude,
        slope=table.slope_deg * _DEG,
        odometer_lever_arm=np.array(options.odometer_lever_arm_m),
        odometer_quantum=quantum,
        odometer_scale=options.odometer_scale_ppm * 1e-6,
        odometer_walk=options.odometer_walk_m_per_sqrt_m,
        sigma_mounting=options.mounting_sigma_deg * _DEG,
        slip=table.slip_m_s,
        transfer=_transfer(transfer, latency),
    )
