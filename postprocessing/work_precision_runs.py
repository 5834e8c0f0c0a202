"""Methods, runs and their table on disk, for work_precision.py.

A method is a line of text, "label: key=value key=value"; bare keys belong to &method or &time, GROUP.KEY sets any other, KEY= takes one
away. a|b as a value means one method with a and one with b. A file of methods holds one to a line, under headings [group].
"""
import csv
import hashlib
import itertools
import json
import math
import os
import re
import resource
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

import gimp_files as gf
import namelist
from convergence import box_of
from plot_history import energy_curves

NAN = math.nan
KEY = ("scene", "scene_sum", "method", "cells", "courant", "precision", "threads", "commit")
FROM_SUMMARY = ("steps", "particles", "wall_seconds", "particle_steps_per_second", "particle_steps_per_core_second", "error_rms",
                "error_max", "error_rms_velocity", "error_rms_stress", "error_scale", "error_scale_by", "energy_drift",
                "energy_residual", "momentum_residual", "dt_min", "dt_max", "cut_nodes", "bytes_per_particle", "state_hash", "compiler")
KEPT = ("energy_kept", "kinetic_energy_kept", "angular_momentum_kept")
COLUMNS = (*KEY, "group", "label", "h", "state", "reason", "particle_steps", "core_seconds", "processor_seconds", "timed_runs", "slowest_over_fastest",
           "processor_share", *KEPT, *FROM_SUMMARY)
TIMINGS = ("wall_seconds", "core_seconds", "processor_seconds", "processor_share", "particle_steps_per_second",
           "particle_steps_per_core_second")
TEXTS = {*KEY, "group", "label", "state", "reason", "error_scale_by", "state_hash", "compiler"}


# ---------------------------------------------------------------------------------------------------- methods


@dataclass(frozen=True)
class Method:
    """What is set in a scene, and what it is called"""
    label: str
    settings: tuple  # ("method.basis", "linear"), ...
    group: str = ""

    @property
    def text(self):
        return " ".join(f"{path}={value}" for path, value in self.settings)


def time_keys(program):
    """Names of the keys of &time, and for each key of &method and &time the keys that decide whether it is read; from the program's help"""
    deciders, names = {}, {}
    for group in ("method", "time"):
        said = subprocess.run([program, "--help", group], capture_output=True, text=True).stdout
        names[group] = re.findall(r"^  (\w+)  +\w", said, re.MULTILINE)
        for part in re.split(r"\n(?=  \w)", said):
            key = part.split()[0] if part.strip() else ""
            deciders[f"{group}.{key}"] = {f"{group}.{name}" for line in re.findall(r"read with (.*)", part)
                                          for name in re.findall(r"(?:^|with )(\w+) ", line)}
    return names["time"], deciders


def parse_method(line, group="", keys_of_time=()):
    """The methods of one line: several if a value offers several"""
    label, colon, words = line.partition(":")
    if not colon or "=" in label:
        label, words = "", line
    choices = []
    for word in shlex.split(words):
        key, equals, value = word.partition("=")
        if not equals or not key:
            raise gf.GimpError(f"method '{line.strip()}': '{word}' is not of the form key=value")
        path = key if "." in key else f"{'time' if key in keys_of_time else 'method'}.{key}"
        choices.append([(path, v) for v in value.split("|")])
    if not choices:
        raise gf.GimpError(f"method '{line.strip()}' sets nothing")
    methods = []
    for settings in itertools.product(*choices):
        varied = " ".join(v for c, (_, v) in zip(choices, settings) if len(c) > 1)
        name = " ".join((label.strip(), varied)).strip() if label else " ".join(f"{p.split('.', 1)[1]}={v}" for p, v in settings)
        methods.append(Method(name, settings, group))
    return methods


def read_methods(source, keys_of_time=(), wanted=()):
    """Methods from a file, or from text with semicolons between them; `wanted` names groups or labels to take"""
    lines = Path(source).read_text().splitlines() if os.path.isfile(source) else source.split(";")
    methods, group = [], ""
    for line in lines:
        line = line.split("#")[0].strip()
        heading = re.fullmatch(r"\[(.*)\]", line)
        if heading:
            group = heading.group(1).strip()
        elif line:
            methods += parse_method(line, group, keys_of_time)
    known = {m.group for m in methods} | {m.label for m in methods}
    for name in wanted:
        if name not in known:
            raise gf.GimpError(f"no group or method '{name}' in {source}; there is {', '.join(sorted(k for k in known if k))}")
    methods = [m for m in methods if not wanted or m.group in wanted or m.label in wanted]
    labels = [m.label for m in methods]
    twice = {label for label in labels if labels.count(label) > 1}
    if twice:
        raise gf.GimpError(f"two methods are called {', '.join(sorted(twice))}")
    if not methods:
        raise gf.GimpError(f"no methods in '{source}'")
    return methods


def with_method(text, method, deciders):
    """The scene with a method. What the scene says only for another method, such as its `domain` for another basis, goes away"""
    named = {path for path, _ in method.settings}
    for group in namelist.groups(text):
        for key in group.keys:
            path = f"{group.name}.{key}"
            if path not in named and deciders.get(path, set()) & named:
                text = namelist.set_key(text, path, None)
    for path, value in method.settings:
        text = namelist.set_key(text, path, value or None)
    return text


# ---------------------------------------------------------------------------------------------------- cases


@dataclass(frozen=True)
class Case:
    """One run of the study"""
    key: tuple  # as text, in the order of KEY
    method: Method
    h: float
    text: str
    program: str

    @property
    def name(self):
        return "run_" + hashlib.sha1(repr(self.key).encode()).hexdigest()[:12]


def value_in(text, path):
    """First value of a key of the scene, or None"""
    group, key = path.split(".")
    found = [g.values()[key][0] for g in namelist.groups(text) if g.name == group and key in g.keys]
    return found[0] if found else None


def sum_of(text):
    """A short sum over what a scene says; comments and layout do not count"""
    said = [(g.name, sorted(g.values().items())) for g in namelist.groups(text)]
    return hashlib.sha1(json.dumps(said).encode()).hexdigest()[:12]


def plan(scene, text, methods, cells, courants, programs, threads, deciders):
    """All cases of a study; methods vary fastest, so that a study that was cut short has whole grids"""
    lower, upper = box_of(text)
    quiet = namelist.set_key(text, "output.every", value_in(text, "time.end"))  # frames would cost time and show nothing here
    commits = {precision: gf.commit_of(program) for precision, program in programs.items()}
    cases = []
    for number, courant, precision, method in itertools.product(cells, courants, programs, methods):
        h = (upper[0] - lower[0])/number
        changed = namelist.set_key(quiet, "grid.spacing", h)
        if courant is not None:
            changed = namelist.set_key(changed, "time.courant", courant)
        changed = with_method(changed, method, deciders)
        key = (scene, sum_of(text), method.text, number, value_in(changed, "time.courant"), precision, threads, commits[precision])
        cases.append(Case(tuple("" if k is None else str(k) for k in key), method, h, changed, programs[precision]))
    unique = {case.key: case for case in cases}  # a method with a step of its own is one case for all Courant numbers
    return list(unique.values())


# ---------------------------------------------------------------------------------------------------- one run


ENOUGH = 2.0  # seconds of timed runs, after which a case is not repeated: long runs vary less


def measure(case, folder, threads, repeat, timed, longest, cost="core_seconds"):
    """Run a case and return its row. Timed: the cheapest of `repeat` runs, or of those that fit in ENOUGH, with the spread"""
    row = dict(zip(KEY, case.key)) | {"group": case.method.group, "label": case.method.label, "h": case.h, "state": "done", "reason": ""}
    best, costs = {}, []
    while not costs or (timed and len(costs) < repeat and sum(costs) < ENOUGH):
        before, start = used_by_children(), os.times().elapsed
        output = Path(folder) / f"{case.name}.vtkhdf"
        output.unlink(missing_ok=True)
        try:
            gf.run_scene(case.text, folder, case.name, case.program, threads, environment={"OMP_WAIT_POLICY": "passive"}, longest=longest)
        except gf.RunError as problem:
            row["state"], row["reason"] = what_happened(problem)
        used, elapsed = used_by_children() - before, os.times().elapsed - start
        if row["state"] not in ("done", "failed"):
            return row | ({"wall_seconds": longest} if row["state"] == "too long" else {})
        found = figures(output)
        if "wall_seconds" in found:
            found |= {"core_seconds": found["wall_seconds"]*threads, "processor_seconds": used,
                      "processor_share": used/(elapsed*threads + 1e-9)}
        costs.append(found.get(cost, 0.0))
        if costs[-1] == min(costs):
            best = found
        if row["state"] == "failed" or cost not in found:
            break
    row.update(best)
    if timed:
        row |= {"timed_runs": len(costs), "slowest_over_fastest": max(costs)/max(min(costs), 1e-9)}
    else:
        row = {name: value for name, value in row.items() if name not in TIMINGS}
    if "steps" in row and "particles" in row:
        row["particle_steps"] = row["steps"]*row["particles"]
    return row


def used_by_children():
    """Processor seconds of all programs that this one has run"""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


NOT_BUILT = ("planned, not built yet", "there is no such key", "there is no such word", "; there is ")


def what_happened(problem):
    """State and reason of a run that did not end well"""
    if problem.code is None:
        return "too long", str(problem)
    if problem.code in (75, -2, -15):
        raise KeyboardInterrupt  # somebody stopped it: no result, the next study runs it again
    said = problem.said or [str(problem)]
    if problem.code == 2:
        mistakes = said[1:] or said
        missing = any(word in line for line in mistakes for word in NOT_BUILT)
        return "not in this build" if missing else "refused", " | ".join(re.sub(r"^line \d+: ", "", m) for m in mistakes)
    if problem.code < 0:
        return "failed", f"crashed with signal {-problem.code}"
    return "failed", re.sub(r"^gimp\S*: the run failed: ", "", said[0])


def figures(output):
    """What a run left behind, as columns of the table; empty if it left nothing to read"""
    try:
        found = {name: value for name, value in gf.summary(output).items() if name in FROM_SUMMARY}
        table = gf.history(output)
    except gf.GimpError:
        return {}
    total = energy_curves(table)["total"] if "kinetic_energy" in table else ()
    spin = [table[f"angular_momentum_{axis}"] for axis in "xyz" if f"angular_momentum_{axis}" in table]
    return found | {"energy_kept": share_kept(total), "kinetic_energy_kept": share_kept(table.get("kinetic_energy", ())),
                    "angular_momentum_kept": share_kept(*spin)}


def share_kept(*components):
    """Last value of a quantity over its first one; of a vector, along its first direction"""
    if not components or any(len(c) == 0 for c in components):
        return NAN
    size = sum(float(c[0])**2 for c in components)
    return sum(float(c[0])*float(c[-1]) for c in components)/size if size > 0 else NAN


def number_of(row, name):
    """A number of a row: a column, or NAME_loss = |1 - NAME_kept|"""
    if name.endswith("_loss") and name[:-5] + "_kept" in KEPT:
        return abs(1 - number_of(row, name[:-5] + "_kept"))
    value = row.get(name)
    return value if isinstance(value, (int, float)) else NAN


# ---------------------------------------------------------------------------------------------------- the table on disk


def read_rows(path):
    """Rows of the table; one that was cut off in the middle does not count"""
    if not Path(path).exists():
        return []
    with open(path, newline="") as file:
        reader = csv.DictReader(file)
        if not set(KEY) <= set(reader.fieldnames or ()):
            raise gf.GimpError(f"{path} is not a table of work_precision.py; name another file")
        last = reader.fieldnames[-1]
        return [{name: typed(name, value) for name, value in row.items() if value != ""} for row in reader if row[last] is not None]


def typed(name, value):
    if name in TEXTS:
        return value
    try:
        return int(value)
    except ValueError:
        return float(value)


def write_rows(path, rows):
    """The whole table anew; it is replaced at once, so that a kill leaves the old or the new one"""
    temporary = Path(f"{path}.part")
    with open(temporary, "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)
