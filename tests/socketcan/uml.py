"""A machine with a real SocketCAN bus: the host itself, or a user-mode Linux kernel.

Where the running kernel has no ``AF_CAN`` (containers, small virtual machines), Debian's user-mode
Linux brings a complete one: it boots in seconds as an ordinary process, with the host's file system
as its root, so the same interpreter, the same code and the same folders are there inside.

What a test author should know of the guest: it has one processor; its monotonic and wall clocks
follow the host's; a system call costs about 15 us and reading a clock is one; ``sleep`` is late by
0.2 ms typically and by some milliseconds at worst; kernel receive stamps are the guest's.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from bridge.recording_host import variables

CHANNEL: Final = "vcan0"
PACKAGES: Final = ("user-mode-linux", "kmod", "iproute2", "can-utils")
MODULES: Final = (
    "net/can/can.ko",
    "net/can/can-raw.ko",
    "net/can/can-bcm.ko",
    "net/can/can-gw.ko",
    "drivers/net/can/dev/can-dev.ko",
    "drivers/net/can/vcan.ko",
)
MODULE_ROOT: Final = Path("/usr/lib/uml/modules")
_NICE: Final = -10
BOOT_S: Final = 60.0
"""What booting and halting may cost on a busy machine, on top of the command's own time."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a command on the bus ended: its exit status (None: it never finished) and what it said."""

    status: int | None
    output: str
    console: str
    seconds: float


class Machine(Protocol):
    """Something with an interface `CHANNEL` of type vcan on which a command can run."""

    name: str

    def run(
        self, argv: Sequence[str], *, work: Path, timeout_s: float, env: Mapping[str, str] = ...
    ) -> Outcome:
        """Run ``argv`` in folder ``work``; never raises for a command that fails or hangs."""
        ...


@dataclass(frozen=True, slots=True)
class Missing:
    """Why there is no bus here, and which packages would bring one."""

    reason: str


def _group_kill(process: subprocess.Popen[bytes]) -> None:
    """End a process and all it started; it was made leader of its own session."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(timeout=30)


def _wait(process: subprocess.Popen[bytes], timeout_s: float) -> int | None:
    with contextlib.suppress(OSError):  # where we may: what runs on a bus runs in real time
        os.setpriority(os.PRIO_PROCESS, process.pid, _NICE)
    try:
        return process.wait(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        return None
    finally:
        _group_kill(process)


class HostMachine:
    """The running kernel, where it has AF_CAN and a vcan interface."""

    name = "host"

    def run(
        self, argv: Sequence[str], *, work: Path, timeout_s: float, env: Mapping[str, str] | None = None
    ) -> Outcome:
        """Run ``argv`` as an ordinary process."""
        began = time.monotonic()
        out = work / "output.txt"
        with out.open("wb") as stream:
            process = subprocess.Popen(
                list(argv),
                cwd=work,
                env={**os.environ, **(env or {})},
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            status = _wait(process, timeout_s)
        return Outcome(status, out.read_text(errors="replace"), "", time.monotonic() - began)


class UmlMachine:
    """A user-mode Linux kernel booted for one command, with the host's root as its file system."""

    name = "user-mode Linux"

    def __init__(self, kernel: str, modules: Path, memory: str = "1024M") -> None:
        self._kernel = kernel
        self._modules = modules
        self._memory = memory

    def run(
        self, argv: Sequence[str], *, work: Path, timeout_s: float, env: Mapping[str, str] | None = None
    ) -> Outcome:
        """Boot, make the bus, run ``argv`` as root of the guest, halt."""
        began = time.monotonic()
        work = work.resolve()
        out, status_file = work / "output.txt", work / "status.txt"
        status_file.unlink(missing_ok=True)
        out.write_bytes(b"")
        script = work / "init.sh"
        script.write_text(self._script(argv, work, out, status_file, env or {}))
        script.chmod(0o755)
        with (work / "console.txt").open("wb") as console:
            process = subprocess.Popen(
                [
                    self._kernel,
                    f"mem={self._memory}",
                    "rootfstype=hostfs",
                    "rootflags=/",
                    "rw",
                    f"init={script}",
                    f"uml_dir={work}",
                    "con=null",
                    "con0=fd:0,fd:1",
                ],
                cwd=work,
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            _wait(process, timeout_s + BOOT_S)
        status = int(status_file.read_text()) if status_file.exists() else None
        return Outcome(
            status,
            out.read_text(errors="replace"),
            (work / "console.txt").read_text(errors="replace"),
            time.monotonic() - began,
        )

    def _script(
        self, argv: Sequence[str], work: Path, out: Path, status: Path, env: Mapping[str, str]
    ) -> str:
        exports = {
            "PATH": f"{os.environ.get('PATH', '')}:/usr/local/sbin:/usr/sbin:/usr/bin:/sbin:/bin",
            "HOME": os.environ.get("HOME", "/root"),
            **variables(),  # or other kernels of the same libraries would be at work in there
            **env,
        }
        # the file is put in place in one step: a guest that dies while writing leaves none
        finish = f"echo $? >{shlex.quote(str(status))}.part && mv {shlex.quote(str(status))}.part"
        return "\n".join(
            [
                "#!/bin/sh",
                *(f"export {key}={shlex.quote(value)}" for key, value in exports.items()),
                "mount -t proc proc /proc",
                "mount -t sysfs sys /sys",
                "mount -t tmpfs tmpfs /run",
                "mkdir -p /dev/shm && mount -t tmpfs tmpfs /dev/shm",
                *(f"insmod {shlex.quote(str(self._modules / module))}" for module in MODULES),
                "ip link set lo up",
                f"ip link add {CHANNEL} type vcan",
                f"ip link set {CHANNEL} mtu 72 up",
                f"cd {shlex.quote(str(work))}",
                f"{shlex.join(argv)} >{shlex.quote(str(out))} 2>&1",
                f"{finish} {shlex.quote(str(status))}",
                "sync",
                "poweroff -f",
                "",
            ]
        )


def _host_has_can() -> bool:
    """True when the running kernel opens a raw CAN socket on `CHANNEL`, made here if need be."""
    if not hasattr(socket, "AF_CAN"):
        return False
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as probe:
            try:
                probe.bind((CHANNEL,))
            except OSError:
                ip = shutil.which("ip")
                if ip is None:
                    return False
                for words in (["add", CHANNEL, "type", "vcan"], ["set", CHANNEL, "mtu", "72", "up"]):
                    subprocess.run([ip, "link", *words], check=True, capture_output=True, timeout=10)
                probe.bind((CHANNEL,))
    except (OSError, subprocess.SubprocessError):
        return False
    return True


def _uml() -> UmlMachine | None:
    kernel = shutil.which("linux.uml")
    if kernel is None or not MODULE_ROOT.is_dir():
        return None
    for version in sorted(MODULE_ROOT.iterdir(), reverse=True):
        if all((version / "kernel" / module).is_file() for module in MODULES):
            return UmlMachine(kernel, version / "kernel")
    return None


def find_machine() -> Machine | Missing:
    """The host where it has the bus, else user-mode Linux, else why not and what to install."""
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    absent = [tool for tool in ("candump", "ip") if shutil.which(tool, path=path) is None]
    if not absent:
        if _host_has_can():
            return HostMachine()
        if shutil.which("insmod", path=path) and (machine := _uml()):
            return machine
    return Missing(
        "no SocketCAN here: the kernel has no vcan interface and user-mode Linux is not installed; "
        f"apt-get install {' '.join(PACKAGES)}"
    )
