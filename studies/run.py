"""Run a study of the method: ``python studies/run.py NAME``.

Its rows are kept, so that a run goes on where it stopped.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from study import coverage, coverage_wrong, fault_trial, real, rig_trial
from study.study import markdown, run

OTHERS = (rig_trial, fault_trial, coverage, coverage_wrong)
STUDIES = {study.name: study for study in (real.REAL_RIGS, real.REAL_TRIAL, *(module.STUDY for module in OTHERS))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--out", type=Path, default=Path("reports"), help="NAME.json; rows and runs: NAME/")
    parser.add_argument("--minutes", type=float, help="begin nothing after so many; 0 only summarises")
    parser.add_argument("--workers", type=int, default=2, help="tasks at a time")
    parser.add_argument("--only", action="append", metavar="KEY", help="these tasks (* and ? match)")
    parser.add_argument("--seed", type=int, default=1, help="1: the report's; methods may be tuned on others")
    parser.add_argument("--recordings", type=Path, action="append", help="a folder of measured recordings")
    parser.add_argument("--loop-minutes", type=float, help="[loop] max_minutes of each loop on measured recordings")
    options = parser.parse_args()
    study = STUDIES[options.study]
    text, cells = study.table(run(study, options))
    print("\n".join([text, "", *markdown(study.head, cells)]))


if __name__ == "__main__":
    main()
