"""What each stage of a run took, as the table of docs/speed.md: `python -m tests.benchmarks.stage_times RUN_DIR`.

Times are those that run.json holds, workers included; the yardstick is measured now, so let the machine be the same.
"""

import sys
from pathlib import Path

from survey_sim import tables
from tests.benchmarks.yardstick import yardstick_s

STAGES = ("targets", "tiles", "pool", "visits", "schedule", "report")


def main(folder: Path) -> None:
    """Print the table."""
    spent = tables.read_record(folder)["stages"]
    n_visit = tables.read(folder, "visits").height
    print(f"{n_visit:,} visits, yardstick {1e3 * yardstick_s():.2f} ms", end="\n\n")
    print("| stage | wall, s | CPU, s | CPU a visit, ms | yardsticks a visit |", "|---|---|---|---|---|", sep="\n")
    rows = [(stage, spent[stage]["wall_s"], spent[stage]["cpu_s"]) for stage in STAGES if stage in spent]
    rows.append(("all", sum(wall for _, wall, _ in rows), sum(cpu for _, _, cpu in rows)))
    for stage, wall_s, cpu_s in rows:
        each_s = cpu_s / max(1, n_visit)
        print(f"| {stage} | {wall_s:.0f} | {cpu_s:.0f} | {1e3 * each_s:.1f} | {each_s / yardstick_s():.1f} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
