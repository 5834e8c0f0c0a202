#!/usr/bin/env python3
"""What a method costs: its time per particle-step beside that of tents with FLIP, in the same run.

  method_cost.py                                      the bases of postprocessing/methods/all.txt in 3D, 32 768 particles
  method_cost.py --only bases,transfers --case square2d --pairs 5
  method_cost.py --methods "cpdi: basis=cpdi; gauss: basis=gauss_gimp" --markdown cost.md

Every pair runs the method and `basis = "linear" transfer = "flip" stress_update = "usl"` one after the other, pinned to one processor,
without output; the figure is the median over the pairs of the ratio of their times per particle-step.
"""
import argparse
import statistics
import sys
import tempfile
from pathlib import Path

import bench_paths

import gimp_files as gf
import namelist
import work_precision_runs as methods
from bench_cases import SCENES, count_of, defaults_scene, fixed_step, side_of
from bench_machine import find_program, pinning
from bench_measure import Skipped, admit, run_product

ALL = bench_paths.REPOSITORY / "postprocessing" / "methods" / "all.txt"
YARDSTICK = methods.parse_method("linear, FLIP: basis=linear transfer=flip flip_fraction=1 stress_update=usl")[0]


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", default=str(bench_paths.REPOSITORY / "build"), help="build folder (default: build)")
    parser.add_argument("--methods", default=str(ALL), help="a file of methods, or methods with semicolons between them")
    parser.add_argument("--only", default="", help="groups or labels of them, with commas (default: all of --methods; of the file, bases)")
    parser.add_argument("--case", choices=("cube3d", "square2d"), default="cube3d")
    parser.add_argument("--particles", type=int, default=32768)
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--markdown", help="write the table to this file as well")
    return parser.parse_args(words)


def scene_of(text, method, side, steps, deciders):
    """The block of the speed benchmark with this method and equal fixed steps"""
    text = defaults_scene(text, side, steps)
    step = fixed_step(side)
    for path, value in (("time.step_rule", "fixed"), ("time.step", step), ("time.end", 100*steps*step), ("method.sort_every", 20),
                        ("output.history_every", steps)):
        text = namelist.set_key(text, path, value)
    return methods.with_method(text, method, deciders)


def cost_of(text, yardstick, pairs, program, folder):
    """Ratios of the times per particle-step of two scenes that take turns, and the bytes a particle of the first"""
    prefix, environment = pinning(1)
    ratios, told = [], None
    for _ in range(pairs):
        beside = run_product(yardstick, folder, "yardstick", program, prefix, environment)
        told = run_product(text, folder, "method", program, prefix, environment)
        ratios.append(told["ns"]/beside["ns"])
    return ratios, told


def main(words=None):
    arguments = parse_arguments(words)
    program = find_program(arguments.build)
    if not program:
        gf.say(f"no gimp.x in {arguments.build}")
        return 1
    keys_of_time, deciders = methods.time_keys(program)
    wanted = [w for w in arguments.only.split(",") if w] or (["bases"] if arguments.methods == str(ALL) else [])
    dimension = 3 if arguments.case == "cube3d" else 2
    side = side_of(arguments.particles, dimension)
    text = gf.read_scene(SCENES[arguments.case])
    lines = [f"| method, {count_of(side, dimension)} particles of {arguments.case} | time beside tents | least-most | bytes a particle |",
             "|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        yardstick = scene_of(text, YARDSTICK, side, arguments.steps, deciders)
        for method in methods.read_methods(arguments.methods, keys_of_time, wanted):
            try:
                scene = admit(program, scene_of(text, method, side, arguments.steps, deciders), arguments.particles, folder)
                ratios, told = cost_of(scene, yardstick, arguments.pairs, program, folder)
            except Skipped as reason:
                gf.say(f"{method.label}: {reason}")
                continue
            lines.append(f"| {method.label} | {statistics.median(ratios):.2f} | {min(ratios):.2f}-{max(ratios):.2f} | {told['bytes']:.0f} |")
            print(lines[-1], flush=True)
    if arguments.markdown:
        Path(arguments.markdown).write_text("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except gf.GimpError as problem:
        gf.say(str(problem))
        sys.exit(1)
