"""Golden tables: `python3 -m tests.tables OUT` compares those that `thinlayer run --all --quick --out OUT` has written.

They are no truths, as in `tests/golden.json`: they hold every number of the studies while code moves. `--write` writes them
anew. Meshes are gmsh's; another version of it has other numbers.
"""

import csv
import json
import sys
from pathlib import Path

import numpy as np

NUMBERS = Path(__file__).with_name("tables.json")
CLOSE = 1e-4  # relative to the largest value of a column
ROUNDING = 1e-8
COSTS = {"seconds", "newton_steps", "sweeps", "equilibrium", "remainder"}
BENCHMARKS = {path.stem for path in (Path(__file__).parents[1] / ".ci" / "benchmarks").glob("*.py")}  # times alone


def sums(path: Path) -> dict[str, list[float]]:
    """Each column of numbers: its sum, its sum weighted by row numbers, and its largest magnitude."""
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    columns = {}
    for name in rows[0] if rows else ():
        try:
            values = np.array([float(row[name] or "nan") for row in rows])
        except ValueError:
            continue
        if not COSTS & {*name.split()}:
            three = np.nansum(values), np.nansum(values * np.arange(1, len(rows) + 1)), np.nanmax(np.abs([*values, 0]))
            columns[name] = [float(f"{value:.9g}") for value in three]
    return columns


def main(out: str, *options: str) -> int:
    """Print what differs; 1 if something does."""
    files = {path.relative_to(out): path for path in sorted(Path(out).rglob("*.csv"))}
    tables = {str(name): sums(path) for name, path in files.items() if name.parts[0] not in BENCHMARKS}
    if "--write" in options:
        rows = [f"{json.dumps(name)}: {json.dumps(columns)}" for name, columns in tables.items()]
        NUMBERS.write_text("{" + ",\n".join(rows) + "}\n", encoding="utf-8")
        return 0
    golden, differ = json.loads(NUMBERS.read_text(encoding="utf-8")), []
    for name in {**golden, **tables}:
        theirs, ours = golden.get(name, {}), tables.get(name, {})
        for column in {**theirs, **ours}:
            a, b = theirs.get(column, [np.inf]), ours.get(column, [np.inf])
            if len(a) != len(b) or not np.allclose(a, b, rtol=CLOSE, atol=max(CLOSE * a[-1], ROUNDING)):
                differ.append(f"{name}, {column}: {a} -> {b}")
    print("\n".join(differ) or f"{len(tables)} tables are as they were")
    return bool(differ)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
