#!/usr/bin/env python3
"""What breaks a method: its largest stable Courant number on three scenes, and what it does with the hard cases of inputs/hard.

  stability.py --methods postprocessing/methods/stability.txt --jobs 2
  stability.py --methods "basis=linear|cpgimp transfer=flip; mine: transfer=apic flip_fraction=0.5" --cases edge_creep,lone_particle
  stability.py --methods postprocessing/methods/all.txt --only bases --cases none           Courant numbers only

A method is written as work_precision.py wants it. Each hard case says in its head what its answer is and what the scale of an error is.
It is survived with exit code 0, an error of at most ten scales, and no more than ten times its energy gained; it fails cleanly where the
program says why, with exit code 1 or a warning in its closing table; everything else (a wrong answer with exit code 0, numbers that are
none, a crash, a run without an end) is a silent failure, which is a defect. A Courant number is stable where the run ends with exit code 0 and never has more than twice the energy
of the scene; equal steps, c that of the pressure wave (the bar: of the bar) at the start.

A row that is in the CSV file is not run again; it is known by method, case, scene and commit. gimp.x is taken from the environment
variable GIMP_X, from build/bin, or from the PATH. Exit code 1 if a defect was found.
"""
import suitable_python  # noqa: F401 isort: skip (must come first)
import argparse
import csv
import os
import tempfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import gimp_files as gf
import stability_figure as show
import stability_runs as st
import work_precision_runs as runs

KEY = ("kind", "case", "scene_sum", "method", "commit")
COLUMNS = (*KEY, "group", "label", "verdict", "error", "energy_gain", "reached", "limit", "steps", "reason")
NUMBERS = {"error", "energy_gain", "reached", "limit", "steps"}


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", required=True, metavar="FILE or TEXT", help="file of methods, or methods with semicolons between them")
    parser.add_argument("--only", default="", metavar="NAMES", help="groups or labels of the methods to take, comma between")
    parser.add_argument("--cases", default="", metavar="NAMES", help="hard cases, comma between; none (default: all of inputs/hard)")
    parser.add_argument("--courant", default="", metavar="NAMES",
                        help="scenes to seek the largest stable step on: bar, block, vortex; none (default: all)")
    parser.add_argument("--csv", default="stability.csv", metavar="FILE", help="table of all runs, gone on from (default: stability.csv)")
    parser.add_argument("--plot", metavar="FILE", help="picture (default: the name of the table with .png)")
    parser.add_argument("--table", metavar="FILE", help="write the tables as Markdown")
    parser.add_argument("--jobs", type=int, default=1, help="so many runs side by side (default: 1)")
    parser.add_argument("--longest", type=float, default=120.0, metavar="SECONDS",
                        help="a run that takes longer counts as one without an end (default: 120)")
    parser.add_argument("--any-commit", action="store_true", help="rows of other commits count, too")
    parser.add_argument("--only-draw", action="store_true", help="run nothing: tables and picture from the rows that are there")
    parser.add_argument("--keep", metavar="FOLDER", help="keep scenes, logs and output files there (default: a temporary folder)")
    arguments = parser.parse_args(words)
    for name in ("only", "cases", "courant"):
        setattr(arguments, name, [w.strip() for w in getattr(arguments, name).split(",") if w.strip()])
    if arguments.jobs < 1 or arguments.longest <= 0:
        parser.error("--jobs and --longest must be positive")
    arguments.plot = arguments.plot or str(Path(arguments.csv).with_suffix(".png"))
    return arguments


# ---------------------------------------------------------------------------------------------------- what is to be run


@dataclass(frozen=True)
class Task:
    """A method on a hard case (kind "case") or on a scene whose largest stable step is sought (kind "courant")"""
    key: tuple
    method: runs.Method
    subject: object  # a Case or a Limit


def plan(arguments, program):
    """All tasks, method by method, so that a study that was cut short has whole methods"""
    keys_of_time, deciders = runs.time_keys(program)
    methods = runs.read_methods(arguments.methods, keys_of_time, arguments.only)
    subjects = [] if arguments.courant == ["none"] else [("courant", limit) for limit in st.limits(arguments.courant)]
    subjects += [] if arguments.cases == ["none"] else [("case", case) for case in st.read_cases(arguments.cases)]
    commit = gf.commit_of(program)
    return [Task((kind, subject.name, runs.sum_of(subject.text), method.text, commit), method, subject)
            for method in methods for kind, subject in subjects], deciders


def carry_out(task, number, folder, program, deciders, longest):
    """Row of a task"""
    work = st.survival if task.key[0] == "case" else st.largest_stable
    found = work(task.subject, task.method, folder, f"run_{number}", program, deciders, longest)
    return dict(zip(KEY, task.key)) | {"group": task.method.group, "label": task.method.label} | found


# ---------------------------------------------------------------------------------------------------- the table on disk


def read_rows(path):
    """Rows of the table; one that was cut off in the middle does not count"""
    if not Path(path).exists():
        return []
    with open(path, newline="") as file:
        reader = csv.DictReader(file)
        if list(reader.fieldnames or ()) != list(COLUMNS):
            raise gf.GimpError(f"{path} is not a table of stability.py, or one of another version; name another file")
        return [{name: float(value) if name in NUMBERS else value for name, value in row.items() if value != ""}
                for row in reader if row[COLUMNS[-1]] is not None]


def write_rows(path, rows):
    """The whole table anew; it is replaced at once, so that a kill leaves the old or the new one"""
    with open(f"{path}.part", "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows({name: f"{value:.6g}" if isinstance(value, float) else value for name, value in row.items()} for row in rows)
        file.flush()
        os.fsync(file.fileno())
    os.replace(f"{path}.part", path)


class Table:
    """The rows on disk, and each new one as soon as its run has ended"""

    def __init__(self, path, any_commit):
        self.path = path
        self.known = len(KEY) - any_commit  # the commit is the last part of the key
        self.rows = {self.key(row): row for row in read_rows(path)}

    def key(self, row):
        return tuple(row.get(name, "") for name in KEY[:self.known])

    def row_of(self, task):
        """The row of a task, with the label and group that the method has now; None if it is to be run"""
        row = self.rows.get(task.key[:self.known])
        if row is None or (row["verdict"] == "not in this build" and row["commit"] != task.key[-1]):
            return None
        return row | {"label": task.method.label, "group": task.method.group}

    def add(self, row):
        self.rows[self.key(row)] = row
        write_rows(self.path, self.rows.values())


def run_missing(tasks, table, arguments, program, deciders):
    """Run what has no row yet"""
    missing = [task for task in tasks if table.row_of(task) is None]
    gf.say(f"{len(missing)} to run, {len(tasks) - len(missing)} in {table.path}")
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(arguments.jobs) as workers:
        waiting = [workers.submit(carry_out, task, number, arguments.keep or scratch, program, deciders, arguments.longest)
                   for number, task in enumerate(missing)]
        try:
            for number, done in enumerate(as_completed(waiting), 1):
                row = done.result()
                table.add(row)
                gf.say(f"[{number}/{len(missing)}] {row['label']}, {row['case']}: {show.words(row)}")
        except BaseException:
            workers.shutdown(wait=True, cancel_futures=True)
            raise


def main(words=None):
    arguments = parse_arguments(words)
    program = gf.find_gimp()
    tasks, deciders = plan(arguments, program)
    table = Table(arguments.csv, arguments.any_commit)
    if not arguments.only_draw:
        run_missing(tasks, table, arguments, program, deciders)
    rows = [row for row in map(table.row_of, tasks) if row is not None]
    if not rows:
        raise gf.GimpError(f"nothing to show: no row of {arguments.csv} belongs to these methods, cases and this commit")
    text = show.markdown(rows)
    print(text, end="")
    if arguments.table:
        Path(arguments.table).write_text(text)
    show.draw(rows, arguments.plot)
    return 1 if any(row["verdict"] in st.DEFECTS for row in rows) else 0


if __name__ == "__main__":
    gf.run_main(main)
