"""What a ground station is to be shown: the latest of everything the engine put out."""

from __future__ import annotations

import math

from bridge.mavlink.ned import LocalFrame, Ned, to_ned
from bridge.outputs import FixOut, Health, Innovation, ModeChange, Output, SolutionOut
from nav.types import Mode, Solution, SolutionFlag

_UNDER_WAY = (Mode.NAVIGATE, Mode.TRANSFER, Mode.DEGRADED)
_WORST = 1e6  # of a ratio that goes out in single precision
_GROUPS = {"position": "position", "velocity": "velocity", "baro": "height", "height": "height"}


class Picture:
    """Follows one navigator; ``now_ns`` is engine time, the largest seen."""

    def __init__(self, navigator: str) -> None:
        self.navigator = navigator
        self.now_ns = 0
        self.mode = Mode.STANDBY
        self.solution: Solution | None = None
        self.fix: FixOut | None = None
        self.health: Health | None = None
        self.unrecorded_grew = False
        self.origin: LocalFrame | None = None
        self.alignments = 0
        self.barometer_seen = False
        self._ratios: dict[str, float] = {}
        self._ned: tuple[Solution, Ned] | None = None

    def update(self, output: Output, t_ns: int) -> None:
        """Take in one output of engine time ``t_ns``; those of other navigators are passed over."""
        self.now_ns = max(self.now_ns, t_ns)
        match output:
            case SolutionOut() if output.navigator == self.navigator:
                self.solution = output.solution
                self.mode = output.solution.mode
                if self.origin is None and self.mode in _UNDER_WAY and self.has(SolutionFlag.POSITION):
                    place = (output.solution.lat, output.solution.lon, output.solution.height)
                    self.origin = LocalFrame(*place) if all(map(math.isfinite, place)) else None
            case ModeChange() if output.navigator == self.navigator:
                self.mode = output.new
                if output.new in (Mode.ALIGN, Mode.TRANSFER):
                    self.alignments += 1
            case Innovation() if output.navigator == self.navigator:
                self._take_innovation(output)
            case FixOut():
                self.fix = output
            case Health():
                before = self.health.unrecorded_frames if self.health else 0
                self.unrecorded_grew = output.unrecorded_frames > before
                self.health = output

    def _take_innovation(self, innovation: Innovation) -> None:
        self.barometer_seen = self.barometer_seen or "baro" in innovation.kind
        pairs = zip(innovation.residual, innovation.sigma, strict=True)
        ratios = [min(abs(residual) / (3.0 * sigma), _WORST) for residual, sigma in pairs if sigma > 0.0]
        for word, group in _GROUPS.items():
            if word in innovation.kind:
                if group == "position" and len(ratios) == 3:
                    self._ratios["position"] = max(ratios[:2])
                    self._ratios["height"] = ratios[2]
                elif ratios:
                    self._ratios[group] = max(ratios)

    def ratio(self, group: str) -> float:
        """Largest residual of the latest "position", "velocity" or "height" update in units of 3 sigma."""
        return self._ratios.get(group, 0.0)

    def has(self, flag: SolutionFlag) -> bool:
        """Whether there is a solution with ``flag`` set."""
        return self.solution is not None and bool(self.solution.flags & flag)

    @property
    def ned(self) -> Ned | None:
        """The solution in MAVLink's axes, converted once however many messages show it."""
        if self.solution is None:
            return None
        if self._ned is None or self._ned[0] is not self.solution:
            self._ned = (self.solution, to_ned(self.solution))
        return self._ned[1]
