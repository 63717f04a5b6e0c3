"""All faults, of all sizes, on some alignments: ``python -m tests.align_robust.sweep static --seeds 8``."""

from __future__ import annotations

import argparse
import itertools

from tests.align_robust.cases import SCENES, WORDS, cases
from tests.align_robust.judge import BOUND, End, end_of, is_right


def _says(end: End) -> str:
    says = "--" if end.chi2 is None else f"{end.chi2:.0f}"
    if end.chi2 is not None and end.chi2 > BOUND:
        says = f"WRONG {says}"
    return says + (f" [{len(end.refusals)}: {end.refusals[0]}]" if end.refusals else "")


def main() -> None:
    """Print how each ends, a line a case, size and seed; ``!`` where that is not right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("method", nargs="+")
    parser.add_argument("--fault")
    parser.add_argument("--scene")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--wrong", action="store_true", help="only what is not right")
    args = parser.parse_args()
    for method, group in itertools.groupby(cases(), key=lambda case: (case.method, case.scene)):
        if method[0] not in args.method or args.scene not in (None, method[1]):
            continue
        for seed in range(args.seeds):
            print(" ", *method, "nothing", f"seed {seed}:", _says(end_of(method[0], SCENES[method[1]](seed))))
        for case in group:
            if args.fault not in (None, case.fault):
                continue
            for seed in range(args.seeds):
                for size, scene in case.scenes(seed):
                    end = end_of(case.method, scene)
                    right = is_right(end, WORDS[case.fault])
                    if not right or not args.wrong:
                        print(" " if right else "!", *case, f"{size:g} seed {seed}:", _says(end), flush=True)


if __name__ == "__main__":
    main()
