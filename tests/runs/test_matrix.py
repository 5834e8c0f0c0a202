"""The same bits, whoever computes: every input and every permitted pair of basis and transfer, on several numbers of threads (more
than there are processors, too) and across a restart at a random step on another number of threads.

Usually two numbers of threads and one scheme and dimension for each pair; with --long (or `ctest -L long`) all. The environment
variable GIMP_MATRIX_TABLE names a file for the table of what was compared, as docs/reproducibility.md has it.
"""
import os
import random
from collections import Counter
from itertools import product
from pathlib import Path

import pytest

from conftest import INPUTS, REFUSED_INPUTS, check_same, on_threads, run_in_parts, text_of

THREADS = (1, 2, 3, 4, 8)
SORTS = 3  # at least so many in each run

# ---------------------------------------------------------------------------------------- what is compared

SCENES = sorted(set(INPUTS.rglob("*.nml")) - set(REFUSED_INPUTS))
INPUT_STEPS = 100
# large scenes on coarser grids, fixed steps as much longer
SHRUNK = {
    "benchmark/cube3d": {"grid.spacing": 0.0625, "time.step": 3.4e-4, "time.end": 1.0},
    "benchmark/mixed3d": {"grid.spacing": 0.0625, "time.step": 3.4e-4, "time.end": 1.0},
    "benchmark/square2d": {"grid.spacing": 0.015625, "time.step": 8.5e-5, "time.end": 1.0},
    "block_impact_3d": {"grid.spacing": 0.05},
    "expanding_ring": {"grid.spacing": 0.03125},
    "soil_column": {"grid.spacing": 0.01},
    "two_materials": {"grid.spacing": 0.1},
    "vortex": {"grid.spacing": 0.0625},
}

BASES = {
    "linear": {"basis": "linear"},
    "linear light": {"basis": "linear", "redistribute_mass": 0.05},
    "ugimp": {"basis": "ugimp"},
    "cpgimp stretch": {"basis": "cpgimp", "domain": "stretch"},
    "cpgimp diagonal": {"basis": "cpgimp", "domain": "diagonal"},
    "cpgimp volume": {"basis": "cpgimp", "domain": "volume"},
    "cpdi": {"basis": "cpdi"},
    "cpgimp total": {"basis": "cpgimp", "formulation": "total"},
    "ddmp": {"basis": "ddmp"},
    "cpdi2": {"basis": "cpdi2"},
    "cpdi2 simplex": {"basis": "cpdi2", "particle_domain": "simplex"},
    "gauss simpson": {"basis": "gauss_gimp", "quadrature": "simpson"},
    "gauss surface": {"basis": "gauss_gimp", "quadrature": "surface"},
    "gauss volume": {"basis": "gauss_gimp", "quadrature": "volume"},
    "bspline2 open": {"basis": "bspline2", "spline_boundary": "open"},
    "bspline2 ghost": {"basis": "bspline2", "spline_boundary": "ghost"},
    "bspline3 open": {"basis": "bspline3", "spline_boundary": "open"},
    "bspline3 ghost": {"basis": "bspline3", "spline_boundary": "ghost"},
}
TRANSFERS = {
    **{word: {"transfer": word} for word in ("flip", "pic", "apic", "tpic", "mls")},
    "xpic": {"transfer": "xpic", "transfer_order": 3, "position_update": "published"},  # which moves with a velocity of its own
    "fmpm": {"transfer": "fmpm", "transfer_order": 2, "transfer_every": 2},
}
SCHEMES = ("usl", "musl", "usf", "usavg")
# affine transfers diverge with tents, mls with all but equal splines: (basis, transfer) -> the message
REFUSED = {(basis, transfer): "diverges with basis = 'linear'" for basis in ("linear", "linear light") for transfer in ("apic", "tpic")}
REFUSED |= {("ddmp", transfer): "whose values go by tents" for transfer in ("apic", "tpic")}
REFUSED |= {(basis, "mls"): "it is for the equal splines" for basis in BASES if not basis.startswith("bspline")}
REFUSED |= {(basis, "mls"): "diverges at the ends of open knots" for basis in ("bspline2 open", "bspline3 open")}
PAIRS = [pair for pair in product(BASES, TRANSFERS) if pair not in REFUSED]
PAIRS.sort(key=lambda pair: "transfer_order" in TRANSFERS[pair[1]])  # at the end: the others keep their schemes in test_pair
PAIR_STEPS = 60
# where a method inverts a particle in this collision: forces on nodes that hardly have mass. (basis, transfer, dimension, scheme)
BREAKS_DOWN = {("ddmp", "flip", 3, "usl"), ("ddmp", "xpic", 2, "usl"), ("ddmp", "fmpm", 2, "usl"), ("gauss surface", "flip", 3, "usl"),
               ("gauss surface", "apic", 3, "usl"), ("gauss surface", "tpic", 2, "musl"), ("gauss surface", "tpic", 2, "usf")}


def collision(dimension, basis, transfer, scheme, **more):
    """A rubber block and a plastic ball that hit each other and the sides of the box: two materials, gravity, blocks that come and go"""
    first = {key: ", ".join(str(x) for x in values[:dimension]) for key, values in {
        "lower": (0.1, 0.05, 0.2), "upper": (0.45, 0.45, 0.6), "v_block": (2.0, -1.0, 0.5), "center": (0.7, 0.35, 0.45),
        "v_ball": (-2.0, -0.5, 0.1), "zero": (0.0,)*3, "one": (1.0,)*3}.items()}
    gravity = ", ".join(["0.0"]*(dimension - 1) + ["-9.81"])
    chosen = {**BASES[basis], **TRANSFERS[transfer], "stress_update": scheme, **more}
    if dimension == 1:
        chosen.pop("particle_domain", None)  # intervals are all there is
    if basis.startswith("cpdi2") and "position_update" in chosen:
        chosen["position_update"] = "grid"  # all that corners can follow
    method = " ".join(f'{key} = "{word}"' if isinstance(word, str) else f"{key} = {word}" for key, word in chosen.items())
    return f"""&scene dimension = {dimension} /
&grid lower = {first["zero"]} upper = {first["one"]} spacing = {1.0/(64, 32, 16)[dimension - 1]} /
&material name = "rubber" model = "neo_hookean" density = 1000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 /
&material name = "metal" model = "hencky_von_mises" density = 2000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 yield_stress = 1.0e3
  hardening = "linear" hardening_modulus = 1.0e3 /
&body name = "block" material = "rubber" shape = "box" lower = {first["lower"]} upper = {first["upper"]} velocity = {first["v_block"]} /
&body name = "ball" material = "metal" shape = "sphere" center = {first["center"]} radius = 0.2 velocity = {first["v_ball"]} /
&boundary side = "all" condition = "slip" /
&load kind = "gravity" acceleration = {gravity} /
&method {method} sort_every = 9 /
&time end = 1.0 max_steps = {PAIR_STEPS} /
&output name = "x" every = 0.0 history_every = 5 precision = "double" /
"""


# ---------------------------------------------------------------------------------------- how


@pytest.fixture(scope="session")
def compared():
    """Counts what --long found equal: (table, row, column) -> cases, and runs and steps of all; written at the end where asked for"""
    cases, total = Counter(), Counter()
    yield cases, total
    if os.environ.get("GIMP_MATRIX_TABLE"):
        Path(os.environ["GIMP_MATRIX_TABLE"]).write_text(tables(cases, total))


def uncounted():
    return Counter(), Counter()


def tables(cases, total):
    """Markdown: one table for each kind, with the number of cases in its cells"""
    lines = [f"{total['runs']:,} runs, {total['steps']:,} steps.", ""]
    for table in dict.fromkeys(table for table, _, _ in cases):
        rows = list(dict.fromkeys(row for name, row, _ in cases if name == table))
        columns = list(dict.fromkeys(column for name, _, column in cases if name == table))
        lines += [f"| {table} | " + " | ".join(columns) + " |", "|---"*(len(columns) + 1) + "|"]
        for row in rows:
            cells = [cases[table, row, column] or ("refused" if (row, column) in REFUSED else "-") for column in columns]
            lines.append(f"| {row} | " + " | ".join(str(cell) for cell in cells) + " |")
        lines.append("")
    return "\n".join(lines)


def prove_same_bits(run, folder, text, threads, name, compared):
    """All of the output file (frames, history, books, state_hash) is the same on each number of threads, and when the run stops and goes on"""
    dice = random.Random(name)
    whole = []
    for number in threads:
        (folder / str(number)).mkdir()
        whole.append(run(on_threads(text, number), folder / str(number)).succeeded())
        assert whole[-1].summary["threads"] == number
        assert whole[-1].summary["state_hash"] == whole[0].summary["state_hash"]
        check_same(whole[0].output, whole[-1].output)
    steps = int(whole[0].summary["steps"])
    assert steps >= 50 and whole[0].summary["sorts"] >= SORTS
    (folder / "parts").mkdir()
    at, (before, after) = dice.randint(8, steps - 1), dice.sample(THREADS[1:] if max(threads) > 3 else (1, 2, 3), 2)
    rest = run_in_parts(run, folder / "parts", text, at, steps, (before, after))
    check_same(whole[0].output, rest.output)
    compared[1]["runs"] += len(threads) + 2
    compared[1]["steps"] += len(threads)*steps + min(steps, at + 7) + steps - at


def input_text(scene):
    return text_of(scene, INPUT_STEPS, **{"output.name": "x", "method.sort_every": 17, **SHRUNK.get(input_name(scene), {})})


def input_name(scene):
    return str(scene.relative_to(INPUTS).with_suffix(""))


def prove_input(run_scene, folder, scene, threads, compared):
    prove_same_bits(run_scene, folder, input_text(scene), threads, input_name(scene), compared)
    for number in threads:
        compared[0]["input", input_name(scene), f"{number} threads" if number > 1 else "1 thread"] += 1
    compared[0]["input", input_name(scene), "restart"] += 1


def prove_pair(run, folder, pair, dimension, scheme, threads, compared, table):
    if table == "basis" and (*pair, dimension, scheme) in BREAKS_DOWN:  # in double precision
        prove_same_end(run, folder, collision(dimension, *pair, scheme), threads)
        return
    prove_same_bits(run, folder, collision(dimension, *pair, scheme), threads, f"{pair} {dimension} {scheme}", compared)
    compared[0][(table, *pair)] += 1


def prove_same_end(run, folder, text, threads):
    """A run that fails does so at the same particle in the same step"""
    ends = set()
    for number in threads:
        (folder / str(number)).mkdir()
        failed = run(on_threads(text, number), folder / str(number))
        assert failed.code == 1 and "is inverted" in failed.stderr
        ends.add(failed.stderr)
    assert len(ends) == 1


def pair_name(pair):
    return "-".join(pair).replace(" ", "_")


# ---------------------------------------------------------------------------------------- always


@pytest.mark.parametrize("scene", SCENES, ids=input_name)
def test_input(run_scene, tmp_path, scene):
    prove_input(run_scene, tmp_path, scene, (1, THREADS[1 + SCENES.index(scene) % 4]), uncounted())


@pytest.mark.parametrize("pair", PAIRS, ids=pair_name)
def test_pair(run_scene, tmp_path, pair):
    """Schemes and dimensions in turn, so that each transfer meets all of them"""
    k = PAIRS.index(pair)
    prove_pair(run_scene, tmp_path, pair, 1 + k % 3, SCHEMES[k % 4], (1, THREADS[1 + k % 4]), uncounted(), "basis")


@pytest.mark.parametrize("pair", REFUSED, ids=pair_name)
def test_refused_pair(run_scene, tmp_path, pair):
    run = run_scene(collision(2, *pair, "musl"), tmp_path)
    assert run.code == 2 and REFUSED[pair] in run.stderr
    assert not run.output.exists()


# averages over cells: basis, transfer and scheme in turn
REMEDIES = [("f_bar", "cpgimp stretch", "flip", "musl", 3), ("f_bar", "bspline2 ghost", "mls", "usl", 2), ("f_bar", "linear", "flip", "usf", 1),
            ("b_bar", "cpdi", "apic", "usl", 2), ("b_bar", "linear", "flip", "usavg", 3), ("cell_stress", "ugimp", "flip", "musl", 2),
            ("cell_stress", "bspline3 open", "tpic", "usl", 3), ("f_bar", "ddmp", "flip", "musl", 2), ("b_bar", "cpgimp total", "flip", "usl", 2),
            ("f_bar", "cpdi2", "fmpm", "usl", 2)]


@pytest.mark.parametrize("word, basis, transfer, scheme, dimension", REMEDIES)
def test_anti_locking(run_scene, tmp_path, word, basis, transfer, scheme, dimension):
    """Energy and momentum books close as well"""
    text = collision(dimension, basis, transfer, scheme, anti_locking=word)
    prove_same_bits(run_scene, tmp_path, text, (1, 3), f"{word} {basis} {dimension} {scheme}", uncounted())
    run = run_scene(text.replace('name = "x"', 'name = "books"'), tmp_path).succeeded()
    assert run.summary["energy_residual"] < 1e-12 and run.summary["momentum_residual"] < 1e-12


@pytest.mark.parametrize("basis, transfer, scheme, dimension", [("linear", "flip", "musl", 2), ("ugimp", "apic", "usl", 1), ("bspline2 open", "flip", "usf", 3)])
def test_null_space_filter(run_scene, tmp_path, basis, transfer, scheme, dimension):
    """Every seventh step; what it takes is booked, momentum stays"""
    text = collision(dimension, basis, transfer, scheme, null_space_filter=7).replace("radius = 0.2", "radius = 0.2 particles_per_axis = 4")
    prove_same_bits(run_scene, tmp_path, text, (1, 3), f"filter {basis} {dimension} {scheme}", uncounted())
    run = run_scene(text.replace('name = "x"', 'name = "books"'), tmp_path).succeeded()
    assert run.summary["energy_residual"] < 1e-12 and run.summary["momentum_residual"] < 1e-12
    assert 0.0 < run.summary["filtered_energy"] < run.history["kinetic_energy"][0]


# ---------------------------------------------------------------------------------------- with --long


@pytest.mark.long
@pytest.mark.parametrize("scene", SCENES, ids=input_name)
def test_input_on_all_threads(run_scene, tmp_path, scene, compared):
    prove_input(run_scene, tmp_path, scene, THREADS, compared)


@pytest.mark.long
@pytest.mark.parametrize("dimension, scheme", product((1, 2, 3), SCHEMES))
@pytest.mark.parametrize("pair", PAIRS, ids=pair_name)
def test_pair_in_all_schemes(run_scene, tmp_path, pair, dimension, scheme, compared):
    prove_pair(run_scene, tmp_path, pair, dimension, scheme, THREADS, compared, "basis")


@pytest.mark.long
@pytest.mark.parametrize("pair", PAIRS, ids=pair_name)
def test_pair_in_single_precision(run_single, tmp_path, pair, compared):
    prove_pair(run_single, tmp_path, pair, 2, "musl", (1, 2, 3), compared, "basis, single precision")
