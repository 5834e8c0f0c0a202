"""Runs of stability.py: what a hard case asks, how a run of it ended, and the largest stable Courant number of a method.

What a hard case asks stands in the comment at the head of its scene, in lines of the form

    ! hard: COLUMN last|mean|max|fall, answer NUMBER|first, scale NUMBER|first
    ! hard: refused, "part of the message"

COLUMN is one of /history; mean is over time, fall from its first row to its last, `first` the value of its first row. The error of a run is |value - answer|/scale; of
several lines the largest counts. A scene that must be refused is one that no method may run.
"""
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import gimp_files as gf
import namelist
import work_precision_runs as runs
from plot_history import DISSIPATION

HARD = gf.REPOSITORY / "inputs" / "hard"
TOO_WRONG = 10.0  # scales of error, or times the energy of the case gained: more of it with exit code 0 is a silent failure
GROWTH = 2.0  # times the energy that belongs to the scene: a run that has more was not stable
LEAST, LARGEST, STEP, SHARP = 0.2, 4.0, 1.5, 1.02  # Courant numbers: first and last tried, ratio of the search, of the result
VERDICTS = ("survives", "warned", "fails", "refused", "silent", "crashes", "hangs", "not in this build")
DEFECTS = ("silent", "crashes", "hangs")

# ---------------------------------------------------------------------------------------------------- hard cases


@dataclass(frozen=True)
class Question:
    """One number that a case asks for"""
    column: str
    statistic: str
    answer: str
    scale: str

    def error(self, table):
        """Distance from the answer, in scales; nan where the run did not write the column"""
        column = table.get(self.column)
        if column is None or len(column) == 0:
            return math.nan
        answer, scale = (column[0] if word == "first" else float(word) for word in (self.answer, self.scale))
        return abs(statistic(self.statistic, column, table["time"]) - answer)/abs(scale)


@dataclass(frozen=True)
class Case:
    """A hard case: its scene and what is asked of it"""
    name: str
    text: str
    questions: tuple
    message: str = ""  # part of the message with which it must be refused

    @property
    def title(self):
        return re.search(r'title\s*=\s*"([^"]*)"', self.text).group(1)


def statistic(name, column, time):
    if name == "last":
        return column[-1]
    if name == "max":
        return column.max()
    if name == "fall":
        return column[0] - column[-1]
    return float(((column[1:] + column[:-1])/2*np.diff(time)).sum()/(time[-1] - time[0]))


def read_case(path):
    """A case from its scene; a GimpError where it does not say what it asks"""
    text = gf.read_scene(path)
    number = r"([-+\d.eE]+|first)"
    asked = re.findall(rf"^! hard: (\w+) (last|mean|max|fall), answer {number}, scale {number}$", text, re.MULTILINE)
    questions = tuple(Question(*words) for words in asked)
    message = re.search(r'^! hard: refused, "(.*)"$', text, re.MULTILINE)
    if len(questions) + bool(message) != len(re.findall(r"^! hard:", text, re.MULTILINE)) or bool(questions) == bool(message):
        raise gf.GimpError(f"{path}: must say what it asks, in lines '! hard: COLUMN last|mean|max|fall, answer .., scale ..' "
                           "or one '! hard: refused, \"..\"'")
    return Case(Path(path).stem, text, questions, message.group(1) if message else "")


def read_cases(wanted=(), folder=HARD):
    """All cases of a folder, or those that are named"""
    cases = {path.stem: path for path in sorted(Path(folder).glob("*.nml"))}
    unknown = [name for name in wanted if name not in cases]
    if unknown:
        raise gf.GimpError(f"no case {', '.join(unknown)} in {folder}; there is {', '.join(cases)}")
    return [read_case(cases[name]) for name in (wanted or cases)]


def energy_gain(table):
    """Largest gain of kinetic, stored and dissipated energy that no work explains, over the energy at the start or given by work"""
    energy = sum(table[name] for name in ("kinetic_energy", "stored_energy", *DISSIPATION))
    work = table["external_work"] + table["reaction_work"]
    given = max(abs(energy[0]), np.abs(work).max(initial=0.0), np.finfo(float).tiny)
    return float((energy - energy[0] - work).max()/given)


def not_finite(output):
    """What a finished run wrote that is no number: columns of the history, attributes of the summary, fields of the last frame"""
    bad = [f"/history/{name}" for name, column in gf.history(output).items() if not np.isfinite(column).all()]
    bad += [f"/summary {name}" for name, value in gf.summary(output).items() if isinstance(value, float) and not math.isfinite(value)]
    for frame in gf.frames(output, "last"):
        bad += [name for name, values in {"Points": frame.points, **frame.fields}.items() if not np.isfinite(values).all()]
    return bad


def judge(case, output, problem=None):
    """Row of a run: `output` is what it left, `problem` the RunError that ended it, None if its exit code is 0"""
    row = {"verdict": "survives", "reason": "", **reached(case, output)}
    if problem is not None:
        row["verdict"], row["reason"] = ending(problem)
        if case.message and row["verdict"] == "refused" and case.message in row["reason"]:
            row["verdict"] = "survives"
        return row
    if case.message:
        return row | {"verdict": "silent", "reason": "it ran, where it should have been refused"}
    table = gf.history(output)
    errors = [question.error(table) for question in case.questions]
    row |= {"error": max(errors, key=lambda e: math.inf if math.isnan(e) else e), "energy_gain": energy_gain(table)}
    bad = not_finite(output)
    if bad:
        row |= {"verdict": "silent", "reason": f"not finite: {', '.join(bad)}"}
    elif not row["error"] <= TOO_WRONG:
        row |= {"verdict": told(output), "reason": f"wrong by {row['error']:.3g} scales"}
    elif not row["energy_gain"] <= TOO_WRONG:
        row |= {"verdict": told(output), "reason": f"gained {row['energy_gain']:.3g} times the energy of the case"}
    return row


def told(output):
    """Verdict of a wrong answer with exit code 0: whether the closing table warned of it"""
    return "warned" if "  warning  " in Path(output).with_suffix(".log").read_text() else "silent"


def ending(problem):
    """Verdict and reason of a run that did not end with code 0"""
    if problem.code is None:
        return "hangs", str(problem)
    state, reason = runs.what_happened(problem)
    if state in ("refused", "not in this build"):
        return state, reason
    said = " ".join(problem.said)
    if problem.code != 1 or "the run failed" not in said or "Backtrace" in said:
        return "crashes", f"exit code {problem.code}: {' | '.join(problem.said[:3]) or 'it printed nothing'}"
    return "fails", reason


def reached(case, output):
    """Share of its time that a run reached, and its steps; nothing where it left nothing"""
    try:
        found = gf.summary(output)
        return {"reached": found["time"]/runs.value_in(case.text, "time.end"), "steps": found["steps"]}
    except (gf.GimpError, KeyError):
        return {}


# ---------------------------------------------------------------------------------------------------- one run


def run(text, folder, name, program, longest):
    """Run a scene: output file, and the RunError or None"""
    output = Path(folder) / f"{name}.vtkhdf"
    output.unlink(missing_ok=True)
    try:
        gf.run_scene(text, folder, name, program, 1, environment={"OMP_WAIT_POLICY": "passive"}, longest=longest)
        return output, None
    except gf.RunError as problem:
        return output, problem


def survival(case, method, folder, name, program, deciders, longest):
    """Row of a method on a hard case"""
    text = runs.with_method(case.text, method, deciders)
    return judge(case, *run(text, folder, name, program, longest))


# ---------------------------------------------------------------------------------------------------- the largest stable step

BLOCK = """&scene title = "free block, vibrating on its way across the grid" dimension = 2 /
&grid lower = 0.0, 0.0 upper = 16.0, 12.0 spacing = 1.0 /
&material name = "rubber" model = "neo_hookean" density = 1.0 young_modulus = 0.742857142857142857 poisson_ratio = 0.3 /  ! c = 1 m/s
&body name = "block" material = "rubber" shape = "box" lower = 3.0, 3.0 upper = 9.0, 7.0
  velocity = 0.04, 0.02 velocity_gradient = 0.01, 0.0,  0.0, -0.01 /
&time end = 100.0 /
&output name = "block" /
"""


VORTEX_ENERGY = 128.0  # J per metre, the largest on its way (64 at the start), with small steps


@dataclass(frozen=True)
class Limit:
    """A scene on which the largest stable step is sought"""
    name: str
    text: str
    unit: float  # h/c [s], the step of Courant number 1
    energy: float  # kinetic and stored energy that belongs to it: of its start, or the largest on its way [J]


def limits(wanted=()):
    """Bar (16 cells, 10 periods, no particle changes its cell), free block on its way through 4 cells, vortex (h = 1/16, two periods)"""
    bar = namelist.remove_group(gf.read_scene(gf.REPOSITORY / "inputs" / "vibrating_bar.nml"), "method")
    bar = namelist.apply_settings(bar, ["grid.spacing=1.5625", "time.end=100.0"])
    vortex = namelist.remove_group(gf.read_scene(gf.REPOSITORY / "inputs" / "vortex.nml"), "method")
    vortex = namelist.apply_settings(vortex, ["grid.spacing=0.0625", "time.end=2.0"])
    known = {
        "bar": Limit("bar", bar, 1.5625/10.0, 25.0*1e-10/4),
        "block": Limit("block", BLOCK, 1.0, 0.5*24.0*(0.04**2 + 0.02**2) + 0.5e-4*(4*6**3/12 + 6*4**3/12)),
        "vortex": Limit("vortex", vortex, 0.0625/math.sqrt(1.3461538461538), VORTEX_ENERGY),
    }
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise gf.GimpError(f"no scene {', '.join(unknown)} to seek a stable step on; there is {', '.join(known)}")
    return [known[name] for name in (wanted or known)]


def at_courant(limit, courant):
    """Its scene with equal steps of that Courant number; no bound of the adaptive step interferes"""
    text = limit.text
    for key in ("courant", "steps"):
        text = namelist.set_key(text, f"time.{key}", None)
    end, step = runs.value_in(text, "time.end"), courant*limit.unit
    rows = max(1, int(end/step/200))
    return namelist.apply_settings(text, ["time.step_rule=fixed", f"time.step={step!r}", f"output.history_every={rows}",
                                          f"output.every={end!r}", "output.fields=displacement"])


def is_stable(limit, output, problem):
    """Exit code 0, and at no time more than GROWTH times the energy of the scene"""
    if problem is not None:
        return False
    table = gf.history(output)
    energy = table["kinetic_energy"] + table["stored_energy"]
    return bool(np.isfinite(energy).all() and energy.max() <= GROWTH*limit.energy)


def bracket(stable):
    """Courant numbers next to one another on a ladder of which the first is stable, with all below it, and the second is not

    (0, c) where none is stable, (c, None) where all up to LARGEST are.
    """
    low = LEAST
    if not stable(low):
        for low in (LEAST/5, LEAST/25):
            if stable(low):
                return low, 5*low
        return 0.0, low
    while low < LARGEST:
        if not stable(low*STEP):
            return low, low*STEP
        low *= STEP
    return low, None


def largest_stable(limit, method, folder, name, program, deciders, longest):
    """Row of a method: the largest Courant number `limit`, to a factor of SHARP, and what happened above it"""
    changed = Limit(limit.name, runs.with_method(limit.text, method, deciders), limit.unit, limit.energy)
    above = {"verdict": "found", "reason": ""}  # of the last run that was not stable
    defects = []

    def stable(courant):
        output, problem = run(at_courant(changed, courant), folder, name, program, longest)
        if is_stable(limit, output, problem):
            return True
        above["verdict"], above["reason"] = ending(problem) if problem else ("found", f"Courant number {courant:.3g}: its energy grew")
        if above["verdict"] in DEFECTS:
            defects.append(f"{above['verdict']} at Courant number {courant:.3g}: {above['reason']}")
        return False

    low, high = bracket(stable)
    if low == 0 and above["verdict"] in ("refused", "not in this build"):
        return above
    while low > 0 and high is not None and high/low > SHARP:
        middle = math.sqrt(low*high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    if defects:
        return {"verdict": defects[0].split()[0], "reason": "; ".join(defects[:3]), "limit": low}
    return {"verdict": "found", "reason": above["reason"], "limit": low}
