"""The same bits on any number of ranks, with any number of threads each, however blocks are shared between them and change hands.

Usually every input on two layouts that rotate with the number of commits, so that each run of the tests in a row meets others; the
environment variable GIMP_LAYOUTS fixes where the row starts, and names of tests say which layout it was. With --long (or `ctest -L
long`) every input on all layouts, and every permitted pair of basis and transfer on some. GIMP_RANKS_TABLE names a file for the table
of what was compared, as docs/reproducibility.md has it.
"""
import datetime
import os
import subprocess
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from conftest import REPOSITORY, check_same, on_threads, text_of
from scenes_of_chance import chance_scene
from test_matrix import BREAKS_DOWN, PAIRS, SCENES, SCHEMES, SORTS, collision, input_name, input_text, pair_name

# ---------------------------------------------------------------------------------------- layouts


@dataclass(frozen=True)
class Layout:
    """How a run is shared"""

    ranks: int
    threads: int = 1
    repartition: str = ""  # "always": to other cuts at every sort; "eager": at the least imbalance
    program: str = "gimp_mpi.x"

    def __str__(self):
        words = [self.program[5:8], str(self.ranks) + (f"x{self.threads}" if self.threads > 1 else ""), self.repartition]
        return "_".join(word for word in words if word)

    def run(self, run_ranks, text, folder, **more):
        keys = {"always": {"repartition": "always"}, "eager": {"repartition": "balanced", "imbalance_limit": 1.01}}.get(self.repartition, {})
        folder.mkdir(exist_ok=True)
        return run_ranks(text, folder, self.ranks, self.threads, self.program, **keys, **more)


LAYOUTS = [Layout(3), Layout(4, repartition="always"), Layout(2, program="gimp_caf.x"), Layout(7), Layout(3, 2), Layout(2, repartition="always"),
           Layout(8), Layout(4, repartition="eager"), Layout(1), Layout(4, program="gimp_caf.x"), Layout(2, 2, "always"), Layout(4),
           Layout(3, repartition="eager"), Layout(16), Layout(2), Layout(7, repartition="always"), Layout(1, program="gimp_caf.x")]


def start_of_row():
    """A number that differs from one run of the tests in a row to the next: of commits, or of days where there is no history"""
    if os.environ.get("GIMP_LAYOUTS"):
        return int(os.environ["GIMP_LAYOUTS"])
    try:
        return int(subprocess.run(["git", "rev-list", "--count", "HEAD"], cwd=REPOSITORY, capture_output=True, check=True).stdout)
    except (OSError, subprocess.CalledProcessError, ValueError):
        return datetime.date.today().toordinal()


START = start_of_row()


def turn(k, of=LAYOUTS):
    """The layout whose turn it is for case k"""
    return of[(START + k) % len(of)]


# ---------------------------------------------------------------------------------------- how


@pytest.fixture(scope="session")
def compared():
    """Counts what was found equal: (table, row, column) -> cases; written at the end where asked for"""
    cases = Counter()
    yield cases
    if os.environ.get("GIMP_RANKS_TABLE"):
        Path(os.environ["GIMP_RANKS_TABLE"]).write_text(tables(cases))


def tables(cases):
    """Markdown: one table for each kind, with the number of cases in its cells"""
    lines = [f"{sum(cases.values()):,} cases.", ""]
    for table in dict.fromkeys(table for table, _, _ in cases):
        rows = list(dict.fromkeys(row for name, row, _ in cases if name == table))
        columns = list(dict.fromkeys(column for name, _, column in cases if name == table))
        lines += [f"| {table} | " + " | ".join(columns) + " |", "|---"*(len(columns) + 1) + "|"]
        lines += [f"| {row} | " + " | ".join(str(cases[table, row, column] or "-") for column in columns) + " |" for row in rows] + [""]
    return "\n".join(lines)


def prove_same(run_scene, run_ranks, folder, text, layouts, compared=None, table="", row="", least_sorts=0):
    """All of the output file (frames, history, books, state_hash) is the same in each layout; a run that fails does so with the same words.
    The serial run"""
    (folder / "serial").mkdir()
    serial = run_scene(on_threads(text, 1), folder / "serial")
    assert serial.code in (0, 1), serial.stderr
    for layout in layouts:
        run = layout.run(run_ranks, text, folder / str(layout))
        assert run.code == serial.code, f"{layout}: {run.stderr}{serial.stderr}"
        if serial.code:
            assert said(run) == said(serial) and len(said(run)) == 3, str(layout)
        else:
            assert run.summary["ranks"] == layout.ranks and run.summary["threads"] == layout.threads
            assert run.summary["state_hash"] == serial.summary["state_hash"], str(layout)
            check_same(serial.output, run.output)
        if compared is not None:
            compared[table, row, str(layout)] += 1
    assert serial.code or serial.summary["sorts"] >= least_sorts
    return serial


def said(run):
    """What the program said of a failure, without what mpirun adds: what went wrong, where frames and the failed state are"""
    return [line for line in run.stderr.splitlines() if line.startswith(("gimp.x: the run failed", "  committed frames", "  the failed state"))]


# ---------------------------------------------------------------------------------------- inputs and methods


@pytest.mark.parametrize("scene, layout", [(scene, turn(2*k + i)) for k, scene in enumerate(SCENES) for i in (0, 1)],
                         ids=lambda value: str(value) if isinstance(value, Layout) else input_name(value))
def test_input(run_scene, run_ranks, tmp_path, scene, layout):
    prove_same(run_scene, run_ranks, tmp_path, input_text(scene), [layout], least_sorts=SORTS)


SOME_PAIRS = [PAIRS[(START + 7*k) % len(PAIRS)] for k in range(8)]


@pytest.mark.parametrize("pair", SOME_PAIRS, ids=pair_name)
def test_pair(run_scene, run_ranks, tmp_path, pair):
    """Pairs of basis and transfer in turn, schemes and dimensions too"""
    k = PAIRS.index(pair)
    prove_pair(run_scene, run_ranks, tmp_path, pair, 1 + (k + START) % 3, SCHEMES[(k + START//3) % 4], [turn(k)])


def prove_pair(run_scene, run_ranks, folder, pair, dimension, scheme, layouts, compared=None):
    text = collision(dimension, *pair, scheme)
    run = prove_same(run_scene, run_ranks, folder, text, layouts, compared, "basis", pair[0], least_sorts=SORTS)
    assert bool(run.code) == ((*pair, dimension, scheme) in BREAKS_DOWN)


@pytest.mark.long
@pytest.mark.parametrize("scene", SCENES, ids=input_name)
def test_input_in_all_layouts(run_scene, run_ranks, tmp_path, scene, compared):
    prove_same(run_scene, run_ranks, tmp_path, input_text(scene), LAYOUTS, compared, "input", input_name(scene), SORTS)


@pytest.mark.long
@pytest.mark.parametrize("dimension, scheme", [(d, scheme) for d in (1, 2, 3) for scheme in SCHEMES])
@pytest.mark.parametrize("pair", PAIRS, ids=pair_name)
def test_pair_in_all_schemes(run_scene, run_ranks, tmp_path, pair, dimension, scheme, compared):
    layouts = [Layout(3), Layout(4, repartition="always")]
    prove_pair(run_scene, run_ranks, tmp_path, pair, dimension, scheme, layouts, compared)


# ---------------------------------------------------------------------------------------- scenes that are hard to share


@pytest.mark.parametrize("number", [START*7 % 1000 + k for k in range(5)])
def test_scene_of_chance(run_scene, run_ranks, tmp_path, number):
    prove_chance(run_scene, run_ranks, tmp_path, number, [turn(number)])


@pytest.mark.long
@pytest.mark.parametrize("number", range(200))
def test_scenes_of_chance(run_scene, run_ranks, tmp_path, number, compared):
    prove_chance(run_scene, run_ranks, tmp_path, number, {LAYOUTS[number % len(LAYOUTS)], LAYOUTS[5*number//3 % len(LAYOUTS)]}, compared)


def prove_chance(run_scene, run_ranks, folder, number, layouts, compared=None):
    text = chance_scene(number)
    trial = folder / "trial"
    trial.mkdir()
    if run_scene(text, trial).code == 2:
        pytest.skip("no such scene: its method does not go with itself or with a side")
    prove_same(run_scene, run_ranks, folder, text, layouts, compared, "scenes of chance", "all")


def scene(dimension, cells, bodies, more="", method="", time="", frames="", steps=60):
    """A scene of cells of 1 m; `bodies` are keys of &body without name and material"""
    materials = ("rubber", "metal")
    upper = ", ".join(f"{float(c)}" for c in cells)
    text = f"""&scene dimension = {dimension} /
&grid lower = {", ".join(["0.0"]*dimension)} upper = {upper} spacing = 1.0 /
&material name = "rubber" model = "neo_hookean" density = 1000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 /
&material name = "metal" model = "hencky_von_mises" density = 2000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 yield_stress = 1.0e3 /
"""
    for k, body in enumerate(bodies):
        text += f'&body name = "body{k}" material = "{materials[k % 2]}" {body} /\n'
    return text + f"""{more}
&method sort_every = 9 {method} /
&time end = 1.0e3 max_steps = {steps} {time} /
&output name = "x" history_every = 5 precision = "double" {frames} /
"""


def box(lower, upper, velocity=(), particles=2):
    row = lambda values: ", ".join(str(float(v)) for v in values)
    return f'shape = "box" lower = {row(lower)} upper = {row(upper)} particles_per_axis = {particles}' + (f" velocity = {row(velocity)}" if velocity else "")


def sides(kind, *axes):
    """Both sides of axes"""
    return "\n".join(f'&boundary side = "{axis}_{end}" condition = "{kind}" /' for axis in axes for end in ("low", "high"))


LEAVING = '&boundary side = "x_low" condition = "free" leaving = "remove" /\n&boundary side = "x_high" condition = "free" leaving = "remove" /'
LOADS = """&load kind = "point_force" body = "body0" force = 5.0e3, 2.0e3 point = 7.9, 8.1 ramp_time = 0.1 /
&load kind = "point_force" body = "body1" force = -5.0e3, 2.0e3 point = 24.0, 8.0 /
&load kind = "traction" body = "body0" face = "x_high" traction = 1.0e3, 5.0e2 times = 0.0, 0.3 factors = 0.0, 1.0 /
&load kind = "pressure" body = "body1" face = "all" pressure = 2.0e3 /
"""
PAIR = [box((2, 2), (14, 14), (3, 0.5)), box((17, 3), (29, 13), (-3, 0))]
FIELDS = 'fields = "displacement", "velocity", "stress", "smoothed_stress", "deformation_gradient" probes = 7.0, 7.0, 20.0, 8.0, 12.9, 12.9'
GHOST = 'basis = "bspline{}" spline_boundary = "ghost"'
FRAGILE = {"basis": "linear", "transfer": "flip", "stress_update": "usl"}

# name -> (scene, what the closing table must tell so that the case is one)
SPECIAL = {
    "periodic 1d 63": (scene(1, [63], [box([1], [30], [9]), box([40], [55], [-9])], sides("periodic", "x")), {}),
    "periodic 1d 130": (scene(1, [130], [box([0], [130], [9])], sides("periodic", "x"), GHOST.format(3)), {}),
    "periodic 2d 13 21": (scene(2, [13, 21], [box((0, 0), (13, 9), (5, 5)), box((3, 12), (9, 19), (-5, 0))], sides("periodic", "x", "y")), {}),
    "periodic 2d 5": (scene(2, [5, 40], [box((0, 1), (5, 30), (7, 5)), box((1, 32), (4, 38), (-9, 0))], sides("periodic", "x"), GHOST.format(2)), {}),
    "periodic 3d 3 5 13": (scene(3, [3, 5, 13], [box((0, 0, 1), (3, 5, 7), (3, 5, 9)), box((1, 1, 9), (3, 3, 12), (-9, 0, -5))],
                                 sides("periodic", "x", "y", "z"), steps=40), {}),
    "periodic 3d 13 spline": (scene(3, [13, 13, 6], [box((2, 2, 1), (10, 12, 4), (9, 7, 3))], sides("periodic", "x", "y") + "\n" + sides("symmetry", "z"),
                                    GHOST.format(3), steps=40), {}),
    "mirrors 1d": (scene(1, [6], [box([1], [4], [5])], sides("symmetry", "x"), GHOST.format(3)), {}),
    "mirrors 2d": (scene(2, [3, 50], [box((0, 2), (3, 20), (0, 9)), box((0.5, 25), (2.5, 47), (2, -9))], sides("symmetry", "x", "y"), GHOST.format(2)), {}),
    "mirrors 3d": (scene(3, [3, 4, 20], [box((0, 0, 1), (3, 4, 8), (0, 0, 9)), box((1, 1, 10), (3, 3, 18), (1, 1, -9))], sides("symmetry", "x", "y", "z"),
                         steps=40), {}),
    "mirrors wide": (scene(2, [8, 40], [box((1, 2), (7, 30), (5, 4), 1) + " deformation_gradient = 3.6, 0.0, 0.0, 3.6"], sides("symmetry", "x")),
                     {"spilled_values": 1}),
    "lone": (scene(3, [20, 20, 20], [box((9, 9, 9), (10, 10, 10), (9, -8, 7), 1)]), {}),
    "few blocks": (scene(2, [40, 8], [box((1, 1), (7, 7), (15, 0)), box((30, 2), (36, 7), (-15, 0))]), {}),
    "emptied": (scene(2, [40, 20], [box((1, 3), (17, 17), (-30, 0)), box((22, 3), (38, 17), (30, 0))], LEAVING, frames="every = 0.1 " + FIELDS, steps=110),
                {"removed_particles": 1792}),
    "kinetic damping": (scene(2, [32, 16], PAIR, LOADS, 'damping = "kinetic"'), {}),
    "loads": (scene(2, [32, 16], PAIR, LOADS, frames="every = 0.05 " + FIELDS), {}),
    "loads list": (scene(2, [32, 16], PAIR, LOADS, 'kernel = "list"'), {"wide_chunks": 0}),
    "loads spline": (scene(2, [32, 16], PAIR, LOADS.replace('"all"', '"y_high"'), 'basis = "bspline2"', steps=50), {}),
    "loads 3d": (scene(3, [12, 12, 12], [box((1, 1, 1), (7, 9, 9), (5, 0, 1)), box((8, 2, 2), (11, 10, 10), (-5, 0, 0))],
                       '&load kind = "pressure" body = "body0" face = "all" pressure = 3.0e3 /\n'
                       '&load kind = "point_force" body = "body1" force = 5.0e3, 0.0, 1.0e3 point = 9.0, 4.0, 4.0 /', steps=30), {}),
    "wide 2d": (scene(2, [40, 20], [box((3, 3), (12, 17), (9, 0), 1) + " deformation_gradient = 3.6, 0.0, 0.0, 0.8",
                                    box((20, 3), (35, 17), (-9, 0), 1) + " deformation_gradient = 0.9, 0.0, 0.0, 3.3"]), {"spilled_values": 1, "wide_chunks": 1}),
    "wide 3d": (scene(3, [16, 12, 12], [box((3, 3, 3), (10, 9, 9), (9, 0, 0), 1) + " deformation_gradient = 3.4, 0.0, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 3.4"],
                      steps=30), {"spilled_values": 1}),
    "wide periodic": (scene(2, [21, 13], [box((3, 0), (18, 13), (9, 5), 1) + " deformation_gradient = 3.6, 0.0, 0.0, 3.4"], sides("periodic", "x", "y")),
                      {"spilled_values": 1}),
    "filtered": (scene(2, [32, 16], PAIR, sides("slip", "x", "y"), "null_space_filter = 7 stress_update = \"usl\"").replace("axis = 2", "axis = 3"), {}),
}


@pytest.mark.parametrize("name", SPECIAL, ids=lambda name: name.replace(" ", "_"))
def test_scene_that_is_hard_to_share(run_scene, run_ranks, tmp_path, name):
    """On two layouts of several ranks, of which one has other cuts at every sort"""
    k = list(SPECIAL).index(name)
    prove_special(run_scene, run_ranks, tmp_path, name, [turn(k, SEVERAL), turn(k, EVER_OTHER)])


SEVERAL = [layout for layout in LAYOUTS if 2 < layout.ranks < 16 and layout.repartition != "always"]
EVER_OTHER = [layout for layout in LAYOUTS if layout.repartition == "always"]


@pytest.mark.long
@pytest.mark.parametrize("name", SPECIAL, ids=lambda name: name.replace(" ", "_"))
def test_hard_scene_in_all_layouts(run_scene, run_ranks, tmp_path, name, compared):
    prove_special(run_scene, run_ranks, tmp_path, name, LAYOUTS, compared)


def prove_special(run_scene, run_ranks, folder, name, layouts, compared=None):
    text, least = SPECIAL[name]
    run = prove_same(run_scene, run_ranks, folder, text, layouts, compared, "scenes that are hard to share", name, SORTS)
    assert run.code == 0, run.stderr
    for key, value in least.items():
        assert run.summary[key] >= value


def test_redone_steps(run_scene, run_ranks, tmp_path):
    """With sorts between a step and the one it goes back to"""
    keys = {**{f"method.{key}": word for key, word in FRAGILE.items()}, "time.redo_unstable_steps": True, "output.name": "x", "method.sort_every": 1}
    run = prove_same(run_scene, run_ranks, tmp_path, text_of("rigid_translation.nml", 500, **keys), [turn(0, SEVERAL), turn(1, EVER_OTHER)])
    assert run.summary["halvings"] >= run.summary["redone_steps"] > 0


# What goes wrong far from rank 0: words of the message -> scene
WRONG = {
    "has left the grid": scene(2, [40, 20], [box((1, 3), (9, 17)), box((30, 3), (38, 17), (30, 0))]),
    "is inverted": scene(2, [40, 20], [box((1, 3), (9, 17)), box((30, 3), (38, 17)) + " velocity_gradient = -30.0, 0.0, 0.0, 0.0"],
                         time='step_rule = "fixed" step = 0.02', method='transfer = "flip" stress_update = "usl"', steps=60),
    "more than a block in one step": scene(2, [80, 20], [box((1, 3), (9, 17)), box((50, 3), (58, 17), (-400, 0))], time='step_rule = "fixed" step = 0.03'),
}


@pytest.mark.parametrize("words", WRONG, ids=lambda words: words.replace(" ", "_"))
def test_what_goes_wrong_on_another_rank(run_scene, run_ranks, tmp_path, words):
    """The same particle in the same step, told by rank 0, with the exit code of a run alone"""
    run = prove_same(run_scene, run_ranks, tmp_path, WRONG[words], [Layout(4), turn(0, EVER_OTHER)])
    assert run.code == 1 and words in run.stderr, run.stderr


def test_what_goes_wrong_on_two_ranks_at_once(run_scene, run_ranks, tmp_path):
    """Two particles leave in one step: the same one is named"""
    text = scene(2, [40, 20], [box((1, 3), (9, 17), (-30, 0)), box((31, 3), (39, 17), (30, 0))], time='step_rule = "fixed" step = 0.01')
    run = prove_same(run_scene, run_ranks, tmp_path, text, [Layout(4), turn(0, EVER_OTHER)])
    assert run.code == 1
