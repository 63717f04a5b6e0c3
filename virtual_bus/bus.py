"""The bench: a scenario's devices on their buses, in one order of time, and the truth behind them."""

from __future__ import annotations

import errno
import heapq
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import can
import numpy as np

from virtual_bus import devices, faults, scenario
from virtual_bus.arrangement import Arrangement
from virtual_bus.configuration import Wiring, calibration_toml, config_toml
from virtual_bus.devices import Device
from virtual_bus.dither import CYCLE, Dither
from virtual_bus.faults import AnyFault, BusFrame, Faults, Flood
from virtual_bus.grades import GRADES, PPM, draw_imu
from virtual_bus.master import Master, master_of
from virtual_bus.redundancy import AXES
from virtual_bus.sayings import Sayings
from virtual_bus.scenario import Scenario
from virtual_bus.sensors import Barometer, Gnss, GnssErrors, Imu, Odometer, SpeedLog, Warming, generator
from virtual_bus.tables import DeviceTable
from virtual_bus.truth import TruthState, itself
from virtual_bus.turntable import Encoder, TableTruth, Turntable

CALIBRATION = "imu_calibration.toml"
"""Name of the calibration file that goes with `Bench.config_toml`."""

_RETRY_S = 0.0005


@dataclass(slots=True)
class Sent:
    """What `Bench.send_due` has done: frames sent by channel, and tries that met a full buffer."""

    frames: dict[str, int]
    full: int = 0


class Bench:
    """A running scenario.

    ``scenario`` is one, or the name or path of one; ``seed`` draws every error. It lasts ``seconds``, or
    as long as the scenario says. ``start_ns`` is added to every time that goes in or comes out, so that a
    bench can live on the clock of whoever drives it. Raises `virtual_bus.scenario.ScenarioError`.
    """

    def __init__(
        self, what: Scenario | str | Path, seed: int = 1, seconds: float | None = None, start_ns: int = 0
    ) -> None:
        self.scenario = what if isinstance(what, Scenario) else scenario.load(what)
        self.seed = seed
        self.seconds = self.scenario.seconds() if seconds is None else float(seconds)
        if not 0.0 < self.seconds <= 1e6:
            raise scenario.ScenarioError(
                f"seconds: found {seconds}, expected more than 0 and at most a million"
            )
        self.start_ns = start_ns
        self.end_ns = start_ns + round(self.seconds * 1e9)
        self.trajectory = self.scenario.trajectory(self.seconds, generator(seed, "vehicle/mounting"))
        self.grade = GRADES[self.scenario.grade]
        axes = self.scenario.imu.axes
        sensors = None if axes is None else AXES[axes]
        self.imu_errors = draw_imu(self.grade, generator(seed, "imu/unit"), sensors)
        self.channels = sorted({table.channel for table in self.scenario.devices().values()})
        self._faults = Faults(self.scenario.fault)
        self.master: Master | None = None
        self._streams = 0
        self._heap: list[tuple[int, int, BusFrame, Iterator[BusFrame]]] = []
        for stream in self._device_streams():
            self._push(stream)
        for fault in self._faults.of(Flood):
            self._push(self._flood(fault))

    @property
    def next_ns(self) -> int | None:
        """When the next frame is due; None after the last."""
        return self._heap[0][0] + self.start_ns if self._heap else None

    def due(self, until_ns: int) -> Iterator[BusFrame]:
        """The frames up to and including ``until_ns`` that were not given before, in time order."""
        heap, start_ns = self._heap, self.start_ns
        until_ns -= start_ns
        while heap and heap[0][0] <= until_ns:
            _, number, frame, stream = heap[0]
            following = next(stream, None)
            if following is None:
                heapq.heappop(heap)
            else:
                heapq.heapreplace(heap, (following.t_ns, number, following, stream))
            yield frame._replace(t_ns=frame.t_ns + start_ns) if start_ns else frame

    def prepare(self) -> None:
        """Solve the whole trajectory now, so that real time meets no pause for it later."""
        self.trajectory.solve(self.end_ns - self.start_ns)

    def truth(self, t_ns: int) -> TruthState:
        """Truth at ``t_ns`` for the output point; times outside of the scenario are taken at its ends.

        Beside a master the vehicle is what carries the IMU on its own: a store that turns as the IMU does.
        """
        point = self.scenario.vehicle.output_m
        state = self.trajectory.state(t_ns - self.start_ns, None if point is None else np.array(point))
        if self.scenario.master is not None:
            state = itself(state)
        return state if not self.start_ns else replace(state, t_ns=t_ns)

    def inject(self, fault: AnyFault) -> None:
        """Add a fault, its start counted from the start of the scenario."""
        self._faults.all.append(fault)
        if isinstance(fault, Flood):
            self._push(self._flood(fault))

    def send_due(self, buses: Mapping[str, can.BusABC], now_ns: int, sent: Sent | None = None) -> Sent:
        """Send what is due at ``now_ns`` on the python-can bus of each channel.

        A full send buffer is waited for, and counted in ``sent.full``; any other error of a bus is
        raised as `can.CanError`.
        """
        sent = sent or Sent({})
        for frame in self.due(now_ns):
            send(buses[frame.channel], frame, sent)
        return sent

    def wiring(self, interface: str, channel: str) -> Wiring:
        """What the configuration says about this bench, for `virtual_bus.configuration`."""
        fd = self.scenario.imu.fd
        several = len(self.channels) > 1
        buses = {name: name if several else channel for name in self.channels}
        return Wiring(self.scenario, self.grade, CALIBRATION, interface, buses, fd)

    def config_toml(self, interface: str, channel: str, mavlink_url: str | None = None) -> str:
        """A bridge configuration for this bench; it names the calibration file `CALIBRATION`."""
        return config_toml(self.wiring(interface, channel), mavlink_url)

    def calibration_toml(self) -> str:
        """The calibration sheet of this bench's IMU, as its maker would have measured it."""
        return calibration_toml(self.imu_errors, self.grade, self.scenario.imu.inner_arms_mm)

    def files(self, interface: str, channel: str, mavlink_url: str | None = None) -> dict[str, str]:
        """Everything that `navbridge run` needs for this bench: file names and texts."""
        return {
            "config.toml": self.config_toml(interface, channel, mavlink_url),
            CALIBRATION: self.calibration_toml(),
        }

    def _push(self, stream: Iterator[BusFrame]) -> None:
        first = next(stream, None)
        if first is not None:
            heapq.heappush(self._heap, (first.t_ns, self._streams, first, stream))
        self._streams += 1

    def _flood(self, fault: Flood) -> Iterator[BusFrame]:
        rng = generator(self.seed, f"flood/{fault.frame_id}")
        return devices.flood_frames(fault, self.channels[0], self.end_ns - self.start_ns, rng)

    def _device(self, name: str, table: DeviceTable, rate_hz: float, gnss: bool = False) -> Device:
        rng = generator(self.seed, f"{name}/bus")
        ppm = float(rng.standard_normal()) * (self.grade.clock_ppm if name == "imu" else 20.0)
        if table.clock_ppm is not None:
            ppm = table.clock_ppm
        return Device(
            name=name,
            table=table,
            rate_hz=rate_hz,
            clock_ppm=0.0 if gnss else ppm,
            end_ns=self.end_ns - self.start_ns,
            faults=self._faults,
            rng=rng,
            exponential=gnss,
        )

    def _arrangement(self) -> Arrangement:
        table = self.scenario.imu
        dithers = None
        if table.dither_hz is not None:
            x, y, z = (round(1000.0 * frequency) for frequency in table.dither_hz)
            a, b, c = generator(self.seed, "imu/dither").integers(0, CYCLE, 3).tolist()
            dithers = (Dither(x, a), Dither(y, b), Dither(z, c))
        arms = None if table.inner_arms_mm is None else 1e-3 * np.array(table.inner_arms_mm)
        return Arrangement(dithers, arms)

    def _device_streams(self) -> Iterator[Iterator[BusFrame]]:
        s, trajectory, active = self.scenario, self.trajectory, self._faults
        noise = {name: generator(self.seed, name) for name in s.devices()}
        streams: dict[str, Iterator[BusFrame]] = {}

        imu = Imu(
            trajectory,
            self.grade,
            self.imu_errors,
            noise["imu"],
            active,
            arrangement=self._arrangement(),
            warming=Warming(*s.imu.temperature_deg_c, s.imu.warm_up_s),
        )
        device = self._device("imu", s.imu, s.imu.rate_hz)
        streams["imu"] = devices.imu_frames(device, s.imu, imu, self.imu_errors.serial)
        if s.odometer is not None:
            scale = s.odometer.scale_error_ppm * PPM * float(noise["odometer"].standard_normal())
            walk = s.odometer.walk_m_per_sqrt_m
            odometer = Odometer(trajectory, s.odometer.m_per_tick, scale, active, walk, noise["odometer"])
            device = self._device("odometer", s.odometer, s.odometer.rate_hz)
            streams["odometer"] = devices.odometer_frames(device, s.odometer, odometer)
        if s.speed is not None:
            scale = s.speed.scale_error_ppm * PPM * float(noise["speed"].standard_normal())
            log = SpeedLog(trajectory, s.speed.sigma_m_s, scale, noise["speed"])
            device = self._device("speed", s.speed, s.speed.rate_hz)
            streams["speed"] = devices.speed_frames(device, s.speed.sigma_m_s, log)
        if s.baro is not None:
            b = s.baro
            baro = Barometer(trajectory, b.offset_m, b.drift_m, b.correlation_s, b.noise_m, noise["baro"])
            streams["baro"] = devices.baro_frames(self._device("baro", b, b.rate_hz), baro)
        if s.gnss is not None:
            g = s.gnss
            errors = GnssErrors(g.white_m, g.correlated_m, g.correlation_s, g.velocity_m_s)
            gnss = Gnss(trajectory, np.array(s.vehicle.antenna_m), errors, noise["gnss"], active)
            device = self._device("gnss", g, g.rate_hz, gnss=True)
            streams["gnss"] = devices.gnss_frames(device, g, gnss, s.start)
        if s.master is not None:
            device = self._device("master", s.master, s.master.rate_hz)
            self.master = master_of(s.master, trajectory, noise["master"])
            sayings = Sayings(self.master, s.master.age_ms, active)
            streams["master"] = devices.master_frames(device, s.master, sayings)
        if isinstance(s, Turntable) and s.encoder is not None and isinstance(trajectory, TableTruth):
            encoder = Encoder(trajectory, s.encoder, noise["table"])
            device = self._device("table", s.encoder, s.encoder.rate_hz)
            streams["table"] = devices.table_frames(device, encoder.read)
        for name, stream in streams.items():
            yield faults.disturb(stream, active, name, generator(self.seed, f"{name}/faults"))


def send(bus: can.BusABC, frame: BusFrame, sent: Sent) -> None:
    """Send one frame, waiting for room in the send buffer as long as it takes."""
    message = can.Message(
        arbitration_id=frame.frame_id,
        is_extended_id=frame.frame_id > 0x7FF,
        data=frame.data,
        is_fd=frame.is_fd,
        bitrate_switch=frame.is_fd,
    )
    while True:
        try:
            bus.send(message)
        except can.CanOperationError as error:
            if not _is_full(error):
                raise
            sent.full += 1
            time.sleep(_RETRY_S)
        else:
            sent.frames[frame.channel] = sent.frames.get(frame.channel, 0) + 1
            return


def _is_full(error: can.CanOperationError) -> bool:
    """Whether the kernel has no room for the frame just now: ENOBUFS, or a timeout of python-can's."""
    cause: BaseException | None = error
    while cause is not None:
        if errno.ENOBUFS in (getattr(cause, "errno", None), getattr(cause, "error_code", None)):
            return True
        cause = cause.__cause__
    return "buffer" in str(error).lower()
