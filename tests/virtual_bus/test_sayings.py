"""Faults of what the master says: each changes that and nothing else, for as long as it is there."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from dbc.codec import contract
from virtual_bus.bus import Bench
from virtual_bus.faults import MasterFrozen, MasterLatency, MasterOutage, MasterTimeJump
from virtual_bus.scenario import ScenarioError, load

SECONDS = 4.0
FROM, UNTIL = 1.5, 2.5
"""Through the end of a second, by which devices work."""
WHEN = {"start_s": FROM, "duration_s": UNTIL - FROM}
NAMES = ("TIME", "LAT", "LON", "HEIGHT", "VEL_H", "VEL_U", "LEVEL", "HEADING", "RATE", "FORCE")
MESSAGES = {contract()[f"MASTER_{name}"].frame_id: contract()[f"MASTER_{name}"] for name in NAMES}


def epochs(*faults):
    """What is said (n, 22) besides the time; that in s, ALIVE, VALID, and when it is sent in s, (n,) each."""
    bench = Bench(replace(load("transfer"), fault=list(faults)), seed=4, seconds=SECONDS)
    rows, heads = [], []
    for frame in bench.due(bench.end_ns):
        message = MESSAGES.get(frame.frame_id)
        if message is None:
            continue
        assert message.crc_ok(frame.data)
        values = message.decode(frame.data)
        if message.name == "MASTER_TIME":
            heads.append((values[-1] * 1e-6, message.alive(frame.data), values[0], frame.t_ns * 1e-9))
            rows.append([])
        else:
            rows[-1] += values
    told, alive, valid, sent = np.array(heads).T
    return np.array(rows[:-1]), told[:-1], alive[:-1], valid[:-1], sent[:-1]


@pytest.fixture(scope="module")
def clean():
    return epochs()


def struck(pair):
    """Which messages hold for a time within the fault; they are sent 4 to 5 ms after that."""
    return (pair[-1] >= FROM + 0.0045) & (pair[-1] < UNTIL + 0.0035)


def test_frozen(clean):
    rows, told, alive, valid, _ = epochs(MasterFrozen(**WHEN))
    during = struck(clean)
    assert 48 <= np.sum(during) <= 50
    assert np.array_equal(rows[~during], clean[0][~during])
    last = rows[np.flatnonzero(during)[0] - 1]
    assert np.all(rows[during] == last)
    # it goes on telling the time, and that it is well
    for found, expected in zip((told, alive, valid), clean[1:4], strict=True):
        assert np.array_equal(found, expected)


def test_frozen_before_it_has_said_anything(clean):
    rows = epochs(MasterFrozen(start_s=0.0, duration_s=UNTIL))[0]
    assert np.all(rows[:100] == clean[0][0])


@pytest.mark.parametrize("ahead_ms", [-200.0, 300.0])
def test_time_jump(clean, ahead_ms):
    rows, told, alive, valid, _ = epochs(MasterTimeJump(**WHEN, ahead_ms=ahead_ms))
    # microseconds
    assert told - clean[1] == pytest.approx(1e-3 * ahead_ms * struck(clean), abs=1.5e-6)
    for found, expected in zip((rows, alive, valid), (clean[0], *clean[2:4]), strict=True):
        assert np.array_equal(found, expected)


def test_outage(clean):
    rows, told, _, valid, _ = epochs(MasterOutage(**WHEN))
    assert np.array_equal(valid, np.where(struck(clean), 0.0, 1.0))
    assert np.array_equal(rows, clean[0])
    quiet, heard, alive, _, _ = epochs(MasterOutage(**WHEN, silent=True))
    assert np.array_equal(quiet, clean[0][~struck(clean)])
    assert np.array_equal(heard, told[~struck(clean)])
    # its counter counts messages
    assert set(np.diff(alive) % 15) == {1.0}


def test_latency():
    """What it says of level flight at 200 m/s is 20 m behind, then there again."""
    late = epochs(MasterLatency(**WHEN, late_ms=100.0))
    clean = epochs()
    lat, lon = (np.radians(late[0][:, k] - clean[0][:, k]) * 6.38e6 for k in (0, 2))
    behind = np.hypot(lat, lon * np.cos(np.radians(34.2)))
    # 0.6 % of what the sphere has for a radius, and steps of the signals
    assert behind == pytest.approx(20.0 * struck(clean), abs=0.2)
    assert np.array_equal(late[1], clean[1])


def test_a_fault_of_a_device_that_is_not_there_is_refused(tmp_path):
    text = (
        'title = "t"\ngrade = "fog"\n[start]\nlat_deg = 48.0\nlon_deg = 11.0\n'
        '[[manoeuvre]]\nkind = "static"\nduration_s = 5.0\n'
        '[[fault]]\nkind = "{kind}"\nstart_s = 1.0\nduration_s = 1.0\n{more}'
    )
    for kind, more, table in (
        ("master_frozen", "", "master"),
        ("gnss_outage", "", "gnss"),
        ("wheel_slip", "factor = 0.5", "odometer"),
    ):
        path = tmp_path / "own.toml"
        path.write_text(text.format(kind=kind, more=more))
        with pytest.raises(ScenarioError) as error:
            load(path)
        assert str(error.value) == f'own.toml: fault[0].kind: found "{kind}", expected [{table}] with it'
        path.write_text(text.format(kind=kind, more=more) + f"\n[{table}]\n")
        assert load(path).fault
