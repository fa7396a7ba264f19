"""Which tests wait for the night: ``pytest --junitxml=times.xml -m "" && python tests/tiers.py times.xml``.

Adds to ``nightly.txt``; empty it to begin anew. A test stays in the default tier where it takes less than `QUICK_S`; of
those that take longer each file keeps the shortest, as long as they take no more than `KEPT_S` together: one mission
per behaviour. Files in `STAY` keep all.
"""

import sys
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

LIST = Path(__file__).with_name("nightly.txt")
QUICK_S, KEPT_S = 0.4, 2.0
#: Every kind of fault, every kernel and its twin, every example, the order of the rooms.
STAY = {"test_faults", "test_kernels_twins", "test_doctests", "test_house"}


def listed():
    """Names of tests in the list."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return {line for line in lines if line and not line.startswith("#")}


def long_ones(times):
    """Names of the tests that wait, of (file, name, seconds)."""
    by_file = defaultdict(list)
    for file, name, seconds in times:
        if file in STAY:
            continue
        by_file[file].append((seconds, name))
    for file, tests in sorted(by_file.items()):
        left_s = KEPT_S
        for seconds, name in sorted(tests):
            if seconds < QUICK_S:
                continue
            left_s -= seconds
            if left_s < 0.0:
                yield f"{file}.py::{name}"


if __name__ == "__main__":
    times = [
        (case.get("classname").rpartition(".")[2], case.get("name"), float(case.get("time")))
        for path in sys.argv[1:]
        for case in ElementTree.parse(path).getroot().iter("testcase")
    ]
    names = sorted(listed() | set(long_ones(times)))
    LIST.write_text("# Made by tiers.py from the times of a run.\n" + "\n".join(names) + "\n", encoding="utf-8")
    print(f"{len(names)} of {len(times)} tests wait for the night")
