"""After the benchmarks: a table of all of them, as ratios to the yardstick of the same run."""

import pytest

from tests.benchmarks.yardstick import yardstick_s


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Called by pytest at its end."""
    session = getattr(config, "_benchmarksession", None)
    done = [bench for bench in getattr(session, "benchmarks", []) if bench.stats.rounds]
    if not done:
        return
    terminalreporter.section(f"least CPU time, and its ratio to the yardstick of {1e3 * yardstick_s():.2f} ms")
    for bench in sorted(done, key=lambda bench: (bench.fullname.split("::")[0], bench.stats.min)):
        noted = ", ".join(f"{key} {value:.4g}" for key, value in bench.extra_info.items() if "assignment" not in key)
        name = bench.fullname.removeprefix("tests/benchmarks/test_bench_")
        row = f"{name:75} {1e3 * bench.stats.min:10.2f} ms {bench.stats.min / yardstick_s():10.2f}  {noted}"
        terminalreporter.write_line(row.rstrip())
