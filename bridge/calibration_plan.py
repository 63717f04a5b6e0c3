"""Plans of turntable calibrations: TOML, packaged (bridge/plans/) by name or the user's own by path.

::

    title = "..."
    [site]                       # where the table stands; may be given on the command line instead
    lat_deg = 34.25
    height_m = 400.0
    gravity_m_s2 = 9.79634       # by default normal gravity there
    [table]                      # one sigma of what is wrong with it
    tilt_arcsec = 20.0
    north_arcsec = 60.0
    gravity_ug = 50.0
    position_arcsec = 0.0        # of where it comes to rest, about each axis, if no encoder tells it
    [encoder]                    # of a table that tells its angles on the bus
    axes = "zxy"                 # outer to inner, of the unit when all are zero: then it lies ENU
    sigma_arcsec = 2.0
    [estimate]
    asymmetry = true             # a scale for positive and another for negative counts
    g_sensitivity = true         # of the gyros; not for optical ones
    second_order = false         # squares and products of specific force
    [temperature]                # where scales and biases are to be known at several
    soak_deg_c = [-20.0, 25.0, 60.0]   # at each all of the steps below, in this order
    reference_deg_c = 25.0       # that of the scales and biases in the file
    order = 2                    # of their polynomials
    [[position]]                 # in order; before all rotations
    faces = "SUW"                # where x, y, z of the unit point: N, E, S, W, U, D
    dwell_s = 120.0
    [[position]]
    attitude_deg = [0.0, 45.0, 90.0]   # or pitch, roll, heading
    dwell_s = 120.0
    [[rotation]]                 # from rest to rest in the same attitude
    faces = "ENU"
    axis = "z"                   # of the unit: x, y or z
    rate_deg_per_s = 10.0        # right-handed about it; negative the other way round
    turns = 3
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from msgspec import Meta, field

from bridge.calibration import MOST_POWERS, G
from bridge.errors import ConfigError
from bridge.options import NotNegative, Positive, Three
from bridge.strict import Table, convert, one_of, parse, wrong
from nav import rotation
from nav.calibrate.intervals import Place, place_at
from nav.calibrate.model import LETTERS, Terms
from nav.calibrate.plan import Position, Rotation, Step, faces, letters_of
from nav.calibrate.stream import SLOWEST
from nav.types import Vector

PACKAGED: Final = Path(__file__).parent / "plans"
_ARCSEC: Final = math.pi / 648000.0
_SLOWEST: Final = math.degrees(SLOWEST)
_SHORTEST: Final = 5.0  # s
DegC = Annotated[float, Meta(ge=-60.0, le=140.0)]


class _Site(Table):
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    height_m: Annotated[float, Meta(ge=-1000.0, le=10_000.0)] = 0.0
    gravity_m_s2: Annotated[float, Meta(ge=9.7, le=9.9)] | None = None


class _TableErrors(Table):
    tilt_arcsec: Positive = 20.0
    north_arcsec: Positive = 60.0
    gravity_ug: Positive = 50.0
    position_arcsec: NotNegative = 0.0


class _Encoder(Table):
    axes: Annotated[str, Meta(pattern="^[xyz]{3}$")] = "zxy"
    sigma_arcsec: Positive = 2.0


class _Estimate(Table):
    asymmetry: bool = True
    g_sensitivity: bool = True
    second_order: bool = False


class _Temperature(Table):
    soak_deg_c: Annotated[list[DegC], Meta(min_length=2)]
    reference_deg_c: DegC
    order: Annotated[int, Meta(ge=1, le=MOST_POWERS)]


class _Position(Table):
    dwell_s: Annotated[float, Meta(ge=_SHORTEST)]
    faces: str | None = None
    attitude_deg: Three | None = None


class _Rotation(Table):
    axis: Literal["x", "y", "z"]
    rate_deg_per_s: float
    turns: Annotated[int, Meta(ge=1)]
    faces: str | None = None
    attitude_deg: Three | None = None


class _Plan(Table):
    title: str
    site: _Site | None = None
    table: _TableErrors = field(default_factory=_TableErrors)
    encoder: _Encoder | None = None
    estimate: _Estimate = field(default_factory=_Estimate)
    temperature: _Temperature | None = None
    position: list[_Position] = field(default_factory=list)
    rotation: list[_Rotation] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Latitude deg and height m of a table, and gravity m/s^2 where it was measured."""

    lat_deg: float
    height_m: float
    gravity: float | None = None


@dataclass(frozen=True, slots=True)
class Encoder:
    """The axes that a table turns about, outer to inner, when all angles are zero; ``sigma`` rad of each."""

    axes: str = "zxy"
    sigma: float = 2.0 * _ARCSEC


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A plan as it was read: ``file`` and ``sha256`` say which; ``sigmas`` of tilt, north (rad), gravity.

    With ``soaks`` degC, not empty, ``steps`` are those of all of them, one after the other, and ``reference``
    degC is the temperature of scales and biases.
    ``position`` rad is one sigma of where the table comes to rest. ``encoded``: the plan says itself that the
    table tells its angles.
    """

    file: str
    sha256: str
    title: str
    site: Site | None
    sigmas: tuple[float, float, float]
    terms: Terms
    steps: tuple[Step, ...]
    soaks: tuple[float, ...] = ()
    reference: float = 0.0
    position: float = 0.0
    encoder: Encoder = Encoder()
    encoded: bool = False

    def at(self, site: Site | None) -> tuple[Site, Place]:
        """Where it is carried out: ``site``, or else its own.

        Raises:
            ConfigError: neither is known.
        """
        where = site or self.site
        if where is None:
            raise ConfigError(
                f"{self.file}: site: found nothing, expected [site] with lat_deg and height_m, or --site"
            )
        lat = math.radians(where.lat_deg)
        return where, place_at(lat, where.height_m, where.gravity, self.sigmas)


def packaged() -> dict[str, str]:
    """Titles of the packaged plans by their names."""
    return {path.stem: load(path).title for path in sorted(PACKAGED.glob("*.toml"))}


def load(where: str | Path) -> Plan:
    """Read a plan by path, or a packaged one by name.

    Raises:
        ConfigError: there is none, or something in it is unknown, missing or impossible.
    """
    path = Path(where)
    names = sorted(p.stem for p in PACKAGED.glob("*.toml"))
    if str(where).removesuffix(".toml") in names:
        path = PACKAGED / f"{str(where).removesuffix('.toml')}.toml"
    elif not path.is_file():
        raise ConfigError(f"{where}: no such plan; expected a file or, packaged, {one_of(path.stem, names)}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    return read(data, path.name)


def read(data: bytes, file: str) -> Plan:
    """A plan from its bytes; ``file`` is its name for messages.

    Raises:
        ConfigError: as `load`.
    """
    table = convert(parse(data, file), _Plan, file)
    steps: list[Step] = []
    before: Vector | None = None
    for place, one in enumerate(table.position):
        key = f"position[{place}]"
        name, C_gb = _attitude(one, file, key)
        if before is not None and np.allclose(before, C_gb, atol=0.1):
            raise wrong(
                file, key, name, "another attitude than that before, which a capture cannot tell apart"
            )
        before = C_gb
        steps.append(Position(f"position {place + 1}, {name}", C_gb, one.dwell_s))
    for place, turn in enumerate(table.rotation):
        key = f"rotation[{place}]"
        name, C_gb = _attitude(turn, file, key)
        if not abs(turn.rate_deg_per_s) >= _SLOWEST:
            raise wrong(
                file, f"{key}.rate_deg_per_s", turn.rate_deg_per_s, f"at least {_SLOWEST:g} either way"
            )
        axis = np.eye(3)[LETTERS.index(turn.axis)]
        about = f"{'-' if turn.rate_deg_per_s < 0.0 else '+'}{turn.axis}"
        title = f"rotation {place + 1}, {about} in {name}"
        steps.append(Rotation(title, C_gb, axis, math.radians(turn.rate_deg_per_s), turn.turns))
    if not steps:
        raise ConfigError(f"{file}: position: found nothing, expected at least one position or rotation")
    own = table.table
    site, soaked = table.site, table.temperature
    return Plan(
        file,
        hashlib.sha256(data).hexdigest(),
        table.title,
        None if site is None else Site(site.lat_deg, site.height_m, site.gravity_m_s2),
        (own.tilt_arcsec * _ARCSEC, own.north_arcsec * _ARCSEC, own.gravity_ug * 1e-6 * G),
        Terms(
            table.estimate.asymmetry,
            table.estimate.g_sensitivity,
            table.estimate.second_order,
            0 if soaked is None else soaked.order,
        ),
        tuple(steps) if soaked is None else _soaked(steps, soaked, file),
        () if soaked is None else tuple(soaked.soak_deg_c),
        0.0 if soaked is None else soaked.reference_deg_c,
        own.position_arcsec * _ARCSEC,
        _encoder(table.encoder, file),
        table.encoder is not None,
    )


def _soaked(steps: Sequence[Step], table: _Temperature, file: str) -> tuple[Step, ...]:
    """The steps at every temperature."""
    soaks = table.soak_deg_c
    if len(set(soaks)) != len(soaks):
        raise wrong(file, "temperature.soak_deg_c", soaks, "different temperatures")
    if table.order >= len(soaks):
        raise wrong(file, "temperature.order", table.order, f"less than the {len(soaks)} of soak_deg_c")
    if not min(soaks) <= table.reference_deg_c <= max(soaks):
        raise wrong(
            file, "temperature.reference_deg_c", table.reference_deg_c, "one between those of soak_deg_c"
        )
    return tuple(replace(one, name=f"{one.name}, {t:g} degC", temperature=t) for t in soaks for one in steps)


def _encoder(table: _Encoder | None, file: str) -> Encoder:
    if table is None:
        return Encoder()
    if table.axes[1] in (table.axes[0], table.axes[2]):
        raise wrong(file, "encoder.axes", table.axes, "three axes of which neighbours differ")
    return Encoder(table.axes, table.sigma_arcsec * _ARCSEC)


def _attitude(one: _Position | _Rotation, file: str, key: str) -> tuple[str, Vector]:
    """Its name for people and C_gb (3, 3)."""
    if (one.faces is None) == (one.attitude_deg is None):
        found = "neither" if one.faces is None else "both"
        raise wrong(file, key, found, "either faces or attitude_deg")
    if one.faces is not None:
        try:
            return one.faces, faces(one.faces)
        except ValueError as error:
            raise ConfigError(f'{file}: {key}.faces: found "{one.faces}", {error}') from error
    assert one.attitude_deg is not None
    pitch, roll, heading = one.attitude_deg
    C_gb = rotation.dcm_from_euler(*np.radians((heading, pitch, roll)))
    return f"{pitch:g}/{roll:g}/{heading:g} deg", C_gb


def as_toml(steps: Sequence[Step]) -> list[str]:
    """Lines of a plan that add ``steps`` to it."""
    lines = []
    for step in steps:
        letters = letters_of(step.C_gb)
        if letters is not None:
            where = f'faces = "{letters}"'
        else:
            heading, pitch, roll = (
                round(float(a), 6) + 0.0 for a in np.degrees(rotation.euler_from_dcm(step.C_gb))
            )
            where = f"attitude_deg = [{pitch}, {roll}, {heading}]"
        if isinstance(step, Position):
            lines += ["[[position]]", where, f"dwell_s = {step.seconds:g}"]
        else:
            axis = LETTERS[int(np.argmax(np.abs(step.axis)))]
            rate = math.degrees(step.rate)
            lines += ["[[rotation]]", where, f'axis = "{axis}"', f"rate_deg_per_s = {rate:g}"]
            lines.append(f"turns = {step.turns}")
    return lines
