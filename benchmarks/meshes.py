#!/usr/bin/env python3
"""What a mesh costs: the time per particle-step beside that of the same scene on the grid, and what the search takes of it.

  meshes.py                                              quads, triangles, hexahedra, tetrahedra; tents and CPDI; three rounds
  meshes.py --cases quad4,quad4-distorted --bases cpdi --pairs 5
  meshes.py --search --markdown meshes.md                with the share of the search, by perf

The scenes are the axis-aligned solutions of inputs/. In each round the grid with `kernel = "list"`, the grid with its fast kernels and each mesh run one
after the other, pinned to one processor, without output; a figure is the median over the rounds of a ratio. Times are wall times multiplied by
the share of the processor that the run had, so other work beside it is not counted.

Visits (elements tested per particle and step) and P (share of the particles that leave their element in a step) are counted by the run. --search samples
one more run of many steps and one of a single step by perf: the search is what is sampled in it, set-up subtracted.
"""
import argparse
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import bench_paths

import gimp_files as gf
import namelist
from bench_machine import find_program, pinning
from bench_measure import Skipped, admit, run_product

INPUTS, MAKE_MESH = (bench_paths.REPOSITORY / p for p in ("inputs", "preprocessing/make_mesh.py"))
NODES = {"quad4": 4, "triangle3": 3, "hexahedron8": 8, "tetrahedron4": 4}
CASES = {"quad4": 2, "quad4-distorted": 2, "triangle3": 2, "triangle3-distorted": 2,  # and their dimension
         "hexahedron8": 3, "hexahedron8-distorted": 3, "tetrahedron4": 3}
GRIDS = {"list": "list", "fast": "auto"}  # label: method.kernel
SEARCH = re.compile(r"__gimp_(search|sides)_MOD|\bfind_(point|particles)\b")  # what perf calls the procedures of the search


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", default=str(bench_paths.REPOSITORY / "build"), help="build folder (default: build)")
    parser.add_argument("--cases", default=",".join(CASES), help="some of " + ", ".join(CASES))
    parser.add_argument("--bases", default="linear,cpdi")
    parser.add_argument("--cells", default="128,24", help="along each axis in 2D and in 3D (default: 128,24)")
    parser.add_argument("--steps", default="60,20", help="in 2D and in 3D (default: 60,20)")
    parser.add_argument("--pairs", type=int, default=3, help="rounds")
    parser.add_argument("--distort", type=float, default=0.3, help="share of an edge that nodes of distorted meshes move; two thirds of it with triangles (default: 0.3)")
    parser.add_argument("--search", action="store_true", help="share of the search, by perf")
    parser.add_argument("--markdown", help="write the table to this file as well")
    arguments = parser.parse_args(words)
    for case in arguments.cases.split(","):
        if case not in CASES:
            parser.error(f"--cases: '{case}' is none of {', '.join(CASES)}")
    return arguments


def make_mesh(case, cells, distort, folder):
    """A mesh of the unit square or cube with so many cells along each axis, each of two triangles or five tetrahedra; made once"""
    kind, _, distorted = case.partition("-")
    path = Path(folder)/f"{case}.h5"
    if path.exists():
        return path
    distort = distort*2/3 if kind == "triangle3" else distort  # more would make slivers
    shape = ["tet_block"] if kind == "tetrahedron4" else ["block", "--type", kind]
    ones, counts = (",".join([str(value)]*CASES[case]) for value in (1, cells))
    done = subprocess.run([sys.executable, str(MAKE_MESH), *shape, "--upper", ones, "--cells", counts, *(["--distort", str(distort)] if distorted else []),
                           str(path)], capture_output=True, text=True)
    if done.returncode != 0:
        raise gf.GimpError(f"make_mesh.py: {done.stderr.strip()}")
    return path


def scene_of(dimension, basis, cells, steps, kernel="auto", mesh=None):
    """The axis-aligned solution, without output, on a grid or on a mesh; the particles are the same"""
    text = gf.read_scene(INPUTS/f"axis_aligned_{dimension}d.nml")
    for path, value in (("grid.spacing", 1.0/cells), ("method.basis", basis), ("method.domain", None), ("method.kernel", kernel), ("time.max_steps", steps),
                        ("output.every", None), ("output.progress", "off")):
        text = namelist.set_key(text, path, value)
    if mesh:
        text = namelist.set_key(namelist.remove_group(text, "grid"), "mesh.file", str(mesh))
        text = namelist.set_key(text, "mesh.reference_length", 1.0/cells)
    return text


def one_run(text, folder, program):
    """Processor time [ns] per particle-step of a run, and its summary"""
    told = run_product(text, folder, "run", program, *pinning(1), keep=True)
    summary = gf.summary(told["output"])
    told["output"].unlink()
    return told["ns"]*min(1.0, told["busy"]), summary


def samples(text, folder, program):
    """Samples of a run by perf: those of the search, all"""
    data, (prefix, environment) = Path(folder)/"perf.data", pinning(1)
    run_product(text, folder, "sampled", program, [*prefix, "perf", "record", "-q", "-e", "cpu-clock", "-F", "997", "-o", str(data), "--"], environment)
    told = subprocess.run(["perf", "report", "-i", str(data), "--stdio", "--no-children", "-F", "sample,symbol", "-t", ";"], capture_output=True, text=True)
    found = [(int(count), symbol) for count, symbol in re.findall(r"^\s*(\d+)\s*;(.*)$", told.stdout, re.M)]
    if not found:
        raise gf.GimpError(f"perf told nothing: {told.stderr.strip()[:200]}")
    return sum(count for count, symbol in found if SEARCH.search(symbol)), sum(count for count, _ in found)


def search_share(text, folder, program):
    """Share of the time of the steps that the search takes: a run without its set-up and first step"""
    (search, total), (before, beside) = samples(text, folder, program), samples(namelist.set_key(text, "time.max_steps", 1), folder, program)
    return (search - before)/max(1, total - beside)


def spread(values):
    return f"{statistics.median(values):.2f} | {min(values):.2f}-{max(values):.2f}"


def measure(basis, dimension, cases, cells, steps, arguments, program, folder):
    """Lines of the table of one basis in one dimension: rounds of the two grids and the meshes"""
    scenes = {label: scene_of(dimension, basis, cells, steps, kernel) for label, kernel in GRIDS.items()}
    for case in cases:
        scenes[case] = scene_of(dimension, basis, cells, steps, mesh=make_mesh(case, cells, arguments.distort, folder))
    for label in list(scenes):
        scenes[label] = admit(program, scenes[label], (2*cells)**dimension, folder)
    rounds = [{label: one_run(text, folder, program) for label, text in scenes.items()} for _ in range(arguments.pairs)]

    def ratios(label, yardstick):
        return [r[label][0]/r[yardstick][0] for r in rounds]

    for case in cases:
        told = rounds[-1][case][1]
        visits, leaves = told["search_visits"], told["search_leaves"]
        share = f"{100*search_share(scenes[case], folder, program):.0f} %" if arguments.search else ""
        yield (f"| {case}, {NODES[case.partition('-')[0]]} nodes | {basis} | {int(told['particles'])} | {spread(ratios(case, 'list'))} | {spread(ratios(case, 'fast'))} "
               f"| {share} | {visits:.4f} | {leaves:.4f} | {1 + 1.2*leaves:.4f} |")


def main(words=None):
    arguments = parse_arguments(words)
    program = find_program(arguments.build)
    if not program:
        gf.say(f"no gimp.x in {arguments.build}")
        return 1
    if arguments.search and not shutil.which("perf"):
        gf.say("perf is not there: the share of the search is not measured")
        arguments.search = False
    cells, steps = ([int(n) for n in words.split(",")] for words in (arguments.cells, arguments.steps))
    lines = ["| mesh | basis | particles | time beside list kernel | least-most | beside fast kernel | least-most | search | visits | P | 1 + 1.2 P |",
             "|---|---|---|---|---|---|---|---|---|---|---|"]
    print("\n".join(lines), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for dimension in (2, 3):
            cases = [c for c in arguments.cases.split(",") if CASES[c] == dimension]
            for basis in arguments.bases.split(",") if cases else ():
                try:
                    for line in measure(basis, dimension, cases, cells[dimension - 2], steps[dimension - 2], arguments, program, folder):
                        lines.append(line)
                        print(line, flush=True)
                except Skipped as reason:
                    gf.say(f"{basis} in {dimension}D: {reason}")
    if arguments.markdown:
        Path(arguments.markdown).write_text("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except gf.GimpError as problem:
        gf.say(str(problem))
        sys.exit(1)
