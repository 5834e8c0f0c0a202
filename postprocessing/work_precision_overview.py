#!/usr/bin/env python3
"""One table of methods over several studies of work_precision.py: what each costs, and its error on every scene.

  work_precision_overview.py bar.csv:error_rms:64 disks.csv:energy_loss:48 --methods postprocessing/methods/all.txt --against linear

Each study is FILE:MEASURE:CELLS. A cell of the table holds the error on that grid and, in brackets, the rate from the next coarser one.
The cost is time per particle-step over that of one method on the same grid: the median over all grids with runs of at least --least seconds.
"""
import suitable_python  # noqa: F401 isort: skip (must come first)
import argparse
import math
import statistics
from pathlib import Path

import gimp_files as gf
import work_precision_figure as show
import work_precision_runs as runs


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("studies", nargs="+", metavar="FILE:MEASURE:CELLS", help="table of a study, its measure, and the grid to show")
    parser.add_argument("--methods", required=True, metavar="FILE", help="the methods, in the order of the table")
    parser.add_argument("--only", default="", metavar="NAMES", help="groups or labels to take, comma between")
    parser.add_argument("--against", metavar="LABEL", help="method whose cost is 1 (default: the first)")
    parser.add_argument("--least", type=float, default=0.02, help="seconds that a run must have taken for its speed to count (default: 0.02)")
    parser.add_argument("--seconds", default="core", choices=("core", "processor"), help="as in work_precision.py (default: core)")
    return parser.parse_args(words)


def read_study(words):
    """(scene, measure, cells, label -> line) of one study; the newest row of each run counts"""
    path, _, rest = words.partition(":")
    measure, _, cells = rest.partition(":")
    if not cells.isdigit():
        raise gf.GimpError(f"'{words}' is not of the form FILE:MEASURE:CELLS")
    newest = {(row["label"], row["cells"]): row for row in runs.read_rows(path) if row["precision"] == "double"}
    if not newest:
        raise gf.GimpError(f"{path} has no rows")
    lines = {line.label: line for line in show.lines_of(newest.values())}
    return Path(path).stem, measure, int(cells), lines


def error_of(line, measure, cells):
    """Error on a grid and the rate up to it, as text"""
    if line is None:
        return "-"
    for row, order in zip(line.rows, show.rates(line, measure)):
        if int(row["cells"]) == cells:
            problem = show.problem_of(row, measure)
            if problem:
                return problem.split(":")[0].split(",")[0]
            size = runs.number_of(row, measure)
            return ("< 1e-10" if size < show.ROUND_OFF else f"{size:.2e}") + (f" ({order:.1f})" if order is not None and math.isfinite(order) else "")
    return "-"


def speed(row, cost, least):
    """Time of a particle-step in a run that took long enough to be measured, else nan"""
    seconds, work = runs.number_of(row, cost), runs.number_of(row, show.WORK)
    return seconds/work if seconds >= least and work > 0 else math.nan


def relative_costs(label, against, studies, cost, least):
    """Cost of a method over that of another on each grid where both were timed"""
    found = []
    for _, _, _, lines in studies:
        if label in lines and against in lines:
            other = {row["cells"]: speed(row, cost, least) for row in lines[against].rows}
            found += [speed(row, cost, least)/other[row["cells"]] for row in lines[label].rows if row["cells"] in other]
    return [ratio for ratio in found if math.isfinite(ratio)]


def main(words=None):
    arguments = parse_arguments(words)
    studies = [read_study(words) for words in arguments.studies]
    methods = runs.read_methods(arguments.methods, (), [w.strip() for w in arguments.only.split(",") if w.strip()])
    against = arguments.against or methods[0].label
    table = [["method", f"cost / {against}", *(f"{name}, {measure}, {cells} cells" for name, measure, cells, _ in studies)]]
    for method in methods:
        ratios = relative_costs(method.label, against, studies, f"{arguments.seconds}_seconds", arguments.least)
        told = f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})" if ratios else "-"
        table.append([method.label, told, *(error_of(lines.get(method.label), measure, cells) for _, measure, cells, lines in studies)])
    print(show.markdown(table))
    return 0


if __name__ == "__main__":
    gf.run_main(main)
