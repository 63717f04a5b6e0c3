"""Eight seeded runs on the bench: errors as large as the navigator says, no more and no less.

The seeds are 0 to 7, by rule and not by result. The real path is flown: frames of the bench through drivers,
engine and navigator. `navbridge campaign` does the same with a hundred.
"""

import json
import os

from scipy.stats import binom

from bridge.cli import main
from bridge.studies.campaign import run_consistency, run_static
from bridge.studies.consistency import LIMIT_FACTOR, SHARE

RUNS = 8
JOBS = min(2, os.cpu_count() or 1)


def most_outside(values: int) -> int:
    """So many of the values of an honest filter, or fewer, lie outside their bands in 99 samples of 100."""
    return int(binom.ppf(0.99, values, 1.0 - SHARE))


def test_a_drive_with_a_fog_unit_is_consistent():
    """One value in twenty is expected outside; of only 36, an honest filter has a tenth there at times."""
    found = run_consistency("drive", RUNS, jobs=JOBS)
    assert len(found.t_s) >= 10
    assert round((1.0 - found.nees_inside) * found.nees.size) <= most_outside(found.nees.size), found.nees
    assert round((1.0 - found.bias_inside) * found.bias.size) <= most_outside(found.bias.size), found.bias


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
