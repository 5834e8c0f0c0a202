#!/usr/bin/env python3
"""Error against cost, for many methods on one scene: a table, a CSV file that an interrupted study goes on from, and a figure.

  work_precision.py inputs/axis_aligned_2d.nml --cells 8,16,32 --methods postprocessing/methods/all.txt --only bases
  work_precision.py inputs/vortex.nml --cells 24,48 --methods "basis=linear|cpgimp transfer=flip; mine: transfer=apic courant=0.2"
  work_precision.py inputs/two_disks.nml --cells 24,48 --measure energy_loss --courant 0.1,0.3 --precision double,single
  work_precision.py inputs/vortex.nml --cells 24,48 --methods postprocessing/methods/all.txt --jobs 4       errors only, four at a time

Each grid has CELLS cells along x of the scene's box. A method sets keys of &method and &time (bare, key=value) or any others
(GROUP.KEY=value, KEY= takes a key away); a|b tries both. What the scene says only for another method goes away: its domain with
another basis, its flip_fraction with another transfer. Runs write no frames between first and last.

Seconds count only if runs are alone: one at a time, the cheapest of --repeat runs. With --jobs runs are side by side and not timed.
On a machine that others use, too, processor time (--seconds processor) is the steadier measure; it includes set-up and output.
A run whose row is in the CSV file is not repeated; the row is known by scene, method, grid, Courant number, precision, threads and commit.
Runs that fail, and methods that this build refuses, are rows too; the figure lists them with their reasons. gimp.x is taken from the
environment variable GIMP_X, from build/bin, or from the PATH; gimp_sp.x from beside it.
"""
import suitable_python  # noqa: F401 isort: skip (must come first)
import argparse
import contextlib
import fcntl
import tempfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import gimp_files as gf
import namelist
import work_precision_figure as show
import work_precision_runs as runs


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", help="scene to run, a namelist file")
    parser.add_argument("--methods", default="as the scene has it: title", metavar="FILE or TEXT",
                        help="file of methods, or methods with semicolons between them (default: the scene as it is)")
    parser.add_argument("--only", default="", metavar="NAMES", help="groups or labels of the methods to take, comma between")
    parser.add_argument("--cells", default="8,16,32", help="cells along x of the grids, comma between (default: 8,16,32)")
    parser.add_argument("--courant", default="", help="Courant numbers, comma between (default: that of the scene)")
    parser.add_argument("--precision", default="double", help="double, single or double,single (default: double)")
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.KEY=VALUE", help="change the scene; may be repeated")
    parser.add_argument("--measure", default="error_rms", metavar="NAME",
                        help="what counts as the error: error_rms, error_max, error_rms_velocity, error_rms_stress, energy_loss, "
                             "kinetic_energy_loss, angular_momentum_loss (|1 - end/start|), or another number of the table "
                             "(default: error_rms)")
    parser.add_argument("--name", help="name of the study in the table and among the expected numbers (default: that of the scene file)")
    parser.add_argument("--csv", metavar="FILE", help="table of all runs, gone on from (default: work_precision_SCENE.csv)")
    parser.add_argument("--plot", metavar="FILE", help="figure (default: the name of the table with .png)")
    parser.add_argument("--table", metavar="FILE", help="write the closing table as Markdown, too")
    parser.add_argument("--expected", metavar="FILE", help="CSV with columns scene,measure,label,cells,expected to compare with, "
                                                           "such as postprocessing/methods/expected.csv")
    parser.add_argument("--threads", type=int, default=1, help="threads of gimp.x (default: 1)")
    parser.add_argument("--repeat", type=int, default=1,
                        help="timed runs of each case at most, of which the cheapest counts; fewer if they take long (default: 1)")
    parser.add_argument("--seconds", default="core", choices=("core", "processor"),
                        help="core: time of stepping times threads; processor: processor time of the whole program (default: core)")
    parser.add_argument("--again", action="store_true", help="time all runs once more, those that are there, too; the cheaper time counts")
    parser.add_argument("--jobs", type=int, default=1, help="so many runs side by side, which are then not timed (default: 1, timed)")
    parser.add_argument("--lock", metavar="FILE", help="hold this file while a timed run goes on, so that studies wait for one another")
    parser.add_argument("--longest", type=float, default=600.0, help="seconds after which a run is stopped (default: 600)")
    parser.add_argument("--any-commit", action="store_true", help="rows of other commits count, too")
    parser.add_argument("--only-draw", action="store_true", help="run nothing: table and figure from the rows that are there")
    parser.add_argument("--keep", metavar="FOLDER", help="keep scenes, logs and output files there (default: a temporary folder)")
    arguments = parser.parse_args(words)
    try:
        arguments.cells = [int(w) for w in arguments.cells.split(",")]
        arguments.courant = [float(w) for w in arguments.courant.split(",")] if arguments.courant else [None]
    except ValueError:
        parser.error("--cells takes whole numbers, --courant numbers, with commas between")
    arguments.precision = arguments.precision.split(",")
    if not set(arguments.precision) <= {"double", "single"}:
        parser.error("--precision: double, single or double,single")
    if min(*arguments.cells, arguments.threads, arguments.repeat, arguments.jobs, 1) < 1:
        parser.error("--cells, --threads, --repeat, --jobs: the numbers must be positive")
    arguments.only = [w.strip() for w in arguments.only.split(",") if w.strip()]
    arguments.cost = f"{arguments.seconds}_seconds"
    arguments.name = arguments.name or Path(arguments.scene).stem
    arguments.csv = arguments.csv or f"work_precision_{arguments.name}.csv"
    arguments.plot = arguments.plot or str(Path(arguments.csv).with_suffix(".png"))
    return arguments


def study_of(arguments):
    """All cases, in the order in which they run"""
    program = gf.find_gimp()
    programs = {p: program if p == "double" else gf.find_single(program) for p in arguments.precision}
    keys_of_time, deciders = runs.time_keys(program)
    text = namelist.apply_settings(gf.read_scene(arguments.scene), arguments.set)
    if arguments.methods == "as the scene has it: title":
        methods = [runs.Method("as the scene has it", ())]
    else:
        methods = runs.read_methods(arguments.methods, keys_of_time, arguments.only)
    return runs.plan(arguments.name, text, methods, arguments.cells, arguments.courant, programs, arguments.threads, deciders)


class Table:
    """The rows on disk: those that are there, and each new one as soon as its run has ended"""

    def __init__(self, path, any_commit, timed, longest, cost):
        self.path, self.timed, self.longest, self.cost = path, timed, longest, cost
        self.known = len(runs.KEY) - 1 if any_commit else len(runs.KEY)  # the commit is the last part of the key
        self.rows = {self.key(row): row for row in runs.read_rows(path)}

    def key(self, row):
        return tuple(row.get(name, "") for name in runs.KEY[:self.known])

    def row_of(self, case):
        """The row of a case if it serves, with the label and group that the method has now; else None"""
        row = self.rows.get(case.key[:self.known])
        if (row is None or (row["state"] == "too long" and row["wall_seconds"] < self.longest)
                or (row["state"] == "done" and self.timed and "core_seconds" not in row)
                or (row["state"] in ("refused", "not in this build") and row["commit"] != case.key[-1])):
            return None
        return row | {"label": case.method.label, "group": case.method.group}

    def add(self, row):
        """Take a row in; of two timed ones of the same run the cheaper counts"""
        before = self.rows.get(self.key(row), {})
        if self.cost in before and self.cost in row and before["state"] == row["state"] == "done":
            cheap, dear = sorted((before, row), key=lambda r: r[self.cost])
            row = cheap | {"timed_runs": before["timed_runs"] + row["timed_runs"],
                           "slowest_over_fastest": max(r[self.cost]*r["slowest_over_fastest"] for r in (cheap, dear))/cheap[self.cost]}
        row = {name: value for name, value in row.items() if value not in (None, "") and value == value}  # nan: left out
        self.rows[self.key(row)] = row
        runs.write_rows(self.path, self.rows.values())


@contextlib.contextmanager
def alone(path):
    """Holds a file against other studies while a timed run goes on"""
    if not path:
        yield
        return
    with open(path, "a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def progress(number, total, row, measure, cost):
    problem = show.problem_of(row, measure)
    told = show.shorten(problem, 110) if problem else f"{measure} {runs.number_of(row, measure):.3e}"
    seconds = f", {row[cost]:.3g} s" if cost in row else ""
    gf.say(f"[{number}/{total}] {row['label']}, {row['cells']} cells{', single' if row['precision'] == 'single' else ''}: {told}{seconds}")


def run_missing(cases, table, arguments):
    """Run what has no row yet; with --again, also what ended well"""
    timed = arguments.jobs == 1
    missing = [case for case in cases if (row := table.row_of(case)) is None or (arguments.again and row["state"] == "done")]
    gf.say(f"{len(missing)} to run, {len(cases) - len(missing)} in {table.path}")
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.keep or scratch

        def one(case):
            with alone(arguments.lock if timed else None):
                return runs.measure(case, folder, arguments.threads, arguments.repeat, timed, arguments.longest,
                                    arguments.cost)

        with ThreadPoolExecutor(arguments.jobs) as workers:
            waiting = [workers.submit(one, case) for case in missing]
            try:
                for number, done in enumerate(as_completed(waiting), 1):
                    table.add(done.result())
                    progress(number, len(missing), done.result(), arguments.measure, arguments.cost)
            except BaseException:
                workers.shutdown(wait=True, cancel_futures=True)
                raise


def main(words=None):
    arguments = parse_arguments(words)
    cases = study_of(arguments)
    table = Table(arguments.csv, arguments.any_commit, arguments.jobs == 1 and not arguments.only_draw, arguments.longest,
                  arguments.cost)
    if not arguments.only_draw:
        run_missing(cases, table, arguments)
    rows = [row for row in map(table.row_of, cases) if row is not None]
    if not rows:
        raise gf.GimpError(f"{arguments.csv} has no row of this study")
    if len(rows) < len(cases):
        gf.say(f"{len(cases) - len(rows)} runs of the study have no row yet")
    lines = show.lines_of(rows)
    expected = show.read_expected(arguments.expected) if arguments.expected else None
    closing = show.table(lines, arguments.measure, arguments.cost, expected)
    print(show.plain(closing))
    for problem in show.failures(lines, arguments.measure):
        print("  no result: " + problem)
    if expected:
        print(show.verdict(lines, arguments.measure, expected))
    if arguments.table:
        Path(arguments.table).write_text(show.markdown(closing) + "\n")
    title = runs.value_in(cases[0].text, "scene.title") or Path(arguments.scene).stem
    show.draw(lines, arguments.measure, arguments.plot, title + ("  " + "  ".join(arguments.set) if arguments.set else ""),
              arguments.cost)
    print(f"{arguments.csv}, {arguments.plot}")
    broken = [row for row in rows if row["state"] == "failed"]
    gf.say(f"{len(rows)} runs, {len(broken)} failed") if broken else None
    return 0


if __name__ == "__main__":
    gf.run_main(main)
