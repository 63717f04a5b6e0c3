"""Eight seeded runs on the bench: errors as large as the navigator says, no more and no less.

The seeds are 0 to 7, by rule and not by result. The real path is flown: frames of the bench through drivers,
engine and navigator. `navbridge campaign` does the same with a hundred.
"""

import json
import os

from bridge.cli import main
from bridge.studies.campaign import run_consistency, run_static
from bridge.studies.consistency import INSIDE, LIMIT_FACTOR

RUNS = 8
JOBS = min(2, os.cpu_count() or 1)


def test_a_drive_with_a_fog_unit_is_consistent():
    """One value in twenty is expected outside. Of 36 (108) independent ones of an honest filter a tenth or
    more would be so in one sample of ten (fifty): these eight seeds are a sample that is not."""
    found = run_consistency("drive", RUNS, jobs=JOBS)
    assert len(found.t_s) >= 10
    assert found.nees_inside >= INSIDE, found.nees
    assert found.bias_inside >= INSIDE, found.bias


def test_static_alignment_reaches_its_limit_and_knows_it():
    found = run_static("static_rlg", RUNS, jobs=JOBS)
    low, high = found.ratio_band
    # eight runs tell a spread no better than within ``high`` of itself
    assert all(found.to_limit < LIMIT_FACTOR * high)
    assert all((found.to_sigma > low) & (found.to_sigma < high))
    assert found.nees_band[0] < found.nees < found.nees_band[1]


def test_the_command_prints_json_and_a_picture(tmp_path, capsys):
    picture = tmp_path / "c.png"
    words = ["campaign", "consistency", "--runs", "2", "--seconds", "80", "--jobs", "1", "--json"]
    status = main([*words, "--out", str(picture)])
    document = json.loads(capsys.readouterr().out)
    assert document["runs"] == 2
    assert len(document["epochs"]) >= 10
    assert status == (0 if document["passed"] else 1)
    assert picture.read_bytes().startswith(b"\x89PNG")
