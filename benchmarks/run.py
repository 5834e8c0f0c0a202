#!/usr/bin/env python3
"""Speed of gimp.x beside the speed reference, on the same machine, in the same run.

One case:
  run.py --basis ugimp                          262 144 particles, one thread, five interleaved pairs
  run.py --basis linear --particles 32768       a smaller cube
  run.py --defaults --json cube.jsonl           also the same cube with all defaults of gimp.x

All standard cases, with tables, a plot and the limits of the machine before and after:
  run.py --all                                  hours; what is finished is kept, also after Ctrl-C
  run.py --all --resume --publish               go on, then put tables and plot into docs/performance.md
  run.py --all --quick                          small sizes, one pair: minutes
  run.py --all --cases cube3d --bases ugimp,linear --transfers flip --precisions double --threads 1 --max-particles 300000

The same scenes with two builds, and how far results are apart:
  run.py --compare-builds build build-portable

The reference (benchmarks/reference) is built with the compiler and the flags of the product's build folder. Reference
and product take turns, pinned to the same processor; the ratio is the median over the pairs of reference time over
product time, both of the time steps only, sorts included. How far the two results are apart stands beside it.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bench_paths

import gimp_files as gf
from bench_cases import (BASES, DENSITY, POISSON, QUICK_SIZES, SCENES, SIZES, TRANSFERS, YOUNG, Measurement,  # noqa: F401
                         block_scene, count_of, defaults_scene, fixed_step, plan, side_of, steps_for)
from bench_machine import (build_reference, find_program, machine, needs_split, pinning, product_build, reference_flags,  # noqa: F401
                           roofline)
from bench_measure import Results, Skipped, admit, measure, report, run_product, run_reference

REPOSITORY = bench_paths.REPOSITORY
PRECISIONS = {"double": 64, "single": 32}
FAILED = "failed: "  # begins the note on a measurement that went wrong, unlike one that cannot be made


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", default=str(REPOSITORY / "build"), help="build folder of the product (default: build)")
    parser.add_argument("--pairs", type=int, help="pairs of runs (default: 5; with --all 3 from a million particles on)")
    parser.add_argument("--steps", type=int, help="time steps of a run (default: 40; with --all by size; with --compare-builds 100)")
    parser.add_argument("--sort-every", type=int, default=20, help="steps between sorts, in both (default: 20)")
    parser.add_argument("--threads", help="threads of both (default: 1; with --all a list, default 1,2)")
    one = parser.add_argument_group("one case")
    one.add_argument("--case", choices=tuple(SCENES), default="cube3d", help="scene (default: cube3d)")
    one.add_argument("--basis", choices=BASES, default="ugimp", help="basis (default: ugimp)")
    one.add_argument("--transfer", choices=TRANSFERS, default="flip", help="transfer (default: flip)")
    one.add_argument("--particles", type=int, default=262144, help="about so many (default: 262144)")
    one.add_argument("--cpus", help="processors to pin to, as taskset takes them (default: the first ones)")
    one.add_argument("--defaults", action="store_true", help="also time the cube with all defaults of gimp.x")
    one.add_argument("--json", metavar="FILE",
                     help="append JSON lines to FILE; - for the standard output (the table then goes to the error output)")
    many = parser.add_argument_group("all standard cases")
    many.add_argument("--all", action="store_true", help="run them")
    many.add_argument("--quick", action="store_true", help="small sizes, one pair")
    many.add_argument("--cases", type=listed(SCENES), default=tuple(SCENES), help=f"some of {','.join(SCENES)} (default: all)")
    many.add_argument("--bases", type=listed(BASES), default=BASES, help=f"some of {','.join(BASES)} (default: all)")
    many.add_argument("--transfers", type=listed(TRANSFERS), default=TRANSFERS, help=f"some of {','.join(TRANSFERS)} (default: all)")
    many.add_argument("--precisions", type=listed(PRECISIONS), default=tuple(PRECISIONS), help="double, single (default: both)")
    many.add_argument("--sizes", type=numbers, help=f"particles (default: {','.join(map(str, SIZES))})")
    many.add_argument("--max-particles", type=int, help="leave out larger sizes")
    many.add_argument("--minutes", type=float, help="begin no measurement after so many (default: no limit)")
    many.add_argument("--results", default=str(REPOSITORY / "benchmarks" / "results"), help="folder of what was measured (default: benchmarks/results)")
    many.add_argument("--resume", action="store_true", help="keep what the folder holds from the same build, measure the rest")
    many.add_argument("--publish", action="store_true", help="put tables and plot into docs/; alone: those of the results folder")
    other = parser.add_argument_group("two builds")
    other.add_argument("--compare-builds", nargs=2, metavar=("A", "B"), help="build folders, or programs ending in .x")
    arguments = parser.parse_args(words)
    for name in ("particles", "pairs", "steps", "sort_every", "max_particles"):
        if getattr(arguments, name) is not None and getattr(arguments, name) < 1:
            parser.error(f"--{name.replace('_', '-')} must be positive")
    try:
        arguments.threads = numbers(arguments.threads) if arguments.threads else (1, 2) if arguments.all else (1,)
    except argparse.ArgumentTypeError as problem:
        parser.error(f"--threads: {problem}")
    if len(arguments.threads) > 1 and not arguments.all:
        parser.error("--threads takes one number; a list only with --all")
    return arguments


def numbers(text):
    """Positive whole numbers from words such as 1,2"""
    try:
        values = tuple(int(word) for word in text.split(","))
    except ValueError:
        values = ()
    if not values or min(values) < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is no list of positive numbers")
    return values


def listed(allowed):
    """Words from a list with commas, all of them allowed"""
    def words(text):
        chosen = tuple(word.strip() for word in text.split(","))
        wrong = [word for word in chosen if word not in allowed]
        if wrong:
            raise argparse.ArgumentTypeError(f"'{wrong[0]}' is none of {', '.join(allowed)}")
        return chosen
    return words


# ---------------------------------------------------------------------------------------------------- one case

HEADING = (f"{'case':8} {'settings':10} {'particles':>9} {'ns':>8} {'reference':>9} {'ratio':>6} {'spread':>13} "
           f"{'bytes':>6} {'energy differs by':>18}")


def table_line(line):
    """One line of the table"""
    low, high = line["ratio_spread"]
    memory = f"{line['bytes_per_particle']:6.0f}" if line["bytes_per_particle"] is not None else f"{'?':>6}"
    differs = f"{line['energy_difference']:18.1e}" if line["energy_difference"] is not None else f"{'not comparable':>18}"
    return (f"{line['case']:8} {line['settings']:10} {line['particles']:9d} {line['ns_per_particle_step']:8.2f} "
            f"{line['reference_ns']:9.2f} {line['ratio']:6.3f} {low:6.3f}-{high:5.3f} {memory} {differs}")


def build_and_program(folder):
    """Compiler and flags of a build folder, and its gimp.x"""
    build, program = product_build(folder), find_program(folder)
    if not program:
        raise gf.GimpError(f"{Path(folder).resolve() / 'bin' / 'gimp.x'} is not there: build the program first, or name it in GIMP_X")
    return build, program


def run_one(arguments):
    """One case beside its reference, optionally the same with all defaults"""
    build, program = build_and_program(arguments.build)
    m = Measurement(arguments.case, arguments.basis, arguments.transfer, 64, arguments.threads[0], arguments.particles)
    pairs, steps = arguments.pairs or 5, arguments.steps or 40
    prefix, environment = pinning(m.threads, arguments.cpus)
    if count_of(m.side, m.dimension) != arguments.particles:
        gf.say(f"{count_of(m.side, m.dimension)} particles: a block of {m.side} cells per side")
    text = gf.read_scene(SCENES[m.case])
    setting = m.basis if m.transfer == "flip" else f"{m.basis} {m.transfer}"
    scenes = {setting: block_scene(text, m.side, m.basis, steps, arguments.sort_every, m.transfer)}
    if arguments.defaults:
        scenes["defaults"] = defaults_scene(text, m.side, steps)
    products, references = {name: [] for name in scenes}, []
    with tempfile.TemporaryDirectory() as folder:
        gf.say(f"building the reference {m.variant}: {build['compiler']} {build['flags']}")
        reference, flags = build_reference(m.variant, build, Path(folder) / "reference")
        for pair in range(1, pairs + 1):
            references.append(run_reference(reference, m.side, steps, arguments.sort_every, prefix, environment))
            for name, scene in scenes.items():
                products[name].append(run_product(scene, folder, "run", program, prefix, environment))
            gf.say(f"pair {pair} of {pairs}: reference {references[-1]['ns']:.2f} ns, "
                   + ", ".join(f"{name} {runs[-1]['ns']:.2f} ns" for name, runs in products.items()))
    lines = []
    for name, runs in products.items():
        lines.append({"case": m.case, "basis": m.basis if name == setting else "default", "settings": name,
                      **report(runs, references, same_step=name == setting and m.same_step),
                      "threads": m.threads, "pairs": pairs, "sort_every": arguments.sort_every,
                      "reference": m.variant, "compiler": build["compiler"], "flags": flags,
                      "build_type": build["build_type"], "commit": runs[-1]["commit"]})
    table_goes_to = sys.stderr if arguments.json == "-" else sys.stdout
    print(HEADING, *map(table_line, lines), sep="\n", file=table_goes_to)
    print("ns: core-nanoseconds per particle-step; ratio: reference time / product time, median of the pairs "
          + (f"(below {m.floor} is a defect)" if m.floor else "(of another step)"), file=table_goes_to)
    if arguments.json == "-":
        print("\n".join(map(json.dumps, lines)))
    elif arguments.json:
        with open(arguments.json, "a") as file:
            file.write("\n".join(map(json.dumps, lines)) + "\n")
    return 0


# ------------------------------------------------------------------------------------------ all standard cases


def pairs_for(arguments, particles):
    return arguments.pairs or (1 if arguments.quick else 3 if particles > 1e6 else 5)


def work(m, pairs, steps):
    """Share of the time of a measurement among others: particle-steps, plus set-up and output worth some thirty steps"""
    return pairs*m.particles*((steps or steps_for(m.particles)) + 30)*m.threads


def run_all(arguments):
    """All standard cases: tables, plot and lines in the results folder"""
    from bench_report import grouped, publish, write_all

    build, program = build_and_program(arguments.build)
    told = machine(build)
    results = Results(arguments.results, arguments.resume or not arguments.all)
    skipped, interrupted = [], False
    if arguments.all:
        commit = {"commit": commit_of(program)} if arguments.resume else {}
        gone = results.keep_only(compiler=build["compiler"], flags=reference_flags(build), **commit)
        if gone:
            gf.say(f"{gone} measurements of another build are left out")
        try:
            skipped = measure_all(arguments, build, results)
        except KeyboardInterrupt:
            interrupted = True
            gf.say("interrupted; what is finished is kept, go on with --resume")
    text = write_all(results, told, grouped(skipped))
    print(text)
    gf.say(f"{len(results.lines)} measurements; table.md, table.csv, plot.png in {results.folder}")
    if arguments.publish and not interrupted:
        publish(text, results.folder / "plot.png")
        gf.say("docs/performance.md and docs/figures/performance.png are new")
    if interrupted:
        return 130
    return 1 if any(reason.startswith(FAILED) for _, reason in skipped) else 0


def commit_of(program):
    """What gimp.x names as its commit"""
    said = subprocess.run([program, "--version"], text=True, capture_output=True).stdout
    return said.partition("(")[2].partition(",")[0]


def measure_all(arguments, build, results):
    """Measure what is missing; the measurements that were skipped, each with its reason"""
    sizes = arguments.sizes or (QUICK_SIZES if arguments.quick else SIZES)
    sizes = [size for size in sizes if size <= (arguments.max_particles or size)]
    wanted = plan(arguments.cases, sizes, arguments.bases, arguments.transfers, [PRECISIONS[word] for word in arguments.precisions], arguments.threads)
    todo = [m for m in wanted if not results.finished(m, pairs_for(arguments, m.particles))]
    gf.say(f"{len(wanted)} measurements, {len(wanted) - len(todo)} of them finished; a pair is one run of each program")
    skipped, began, done = [], time.monotonic(), 0
    program = find_program(arguments.build, "gimp_roofline.x")
    limits_of(program, arguments, results, "before")
    weights = [work(m, pairs_for(arguments, m.particles), arguments.steps) for m in todo]
    for k, m in enumerate(todo):
        spent = time.monotonic() - began
        if arguments.minutes and spent > 60*arguments.minutes:
            skipped += [(left, f"not begun within {arguments.minutes:g} minutes") for left in todo[k:]]
            break
        left = f"; about {spent/done*sum(weights[k:])/60:.0f} min left" if done else ""
        gf.say(f"[{k + 1}/{len(todo)}] {m.words()}{left}")
        try:
            line = measure(m, pairs_for(arguments, m.particles), arguments.build, build, results.folder / "reference", arguments.steps, arguments.sort_every)
            results.add(line)
            done += weights[k]
        except Skipped as reason:
            skipped.append((m, str(reason)))
            weights[k] = 0
            gf.say(f"    skipped: {reason}")
        except gf.GimpError as problem:  # one failure must not end a run of hours
            skipped.append((m, f"{FAILED}{problem}"))
            gf.say(f"    failed: {problem}")
    limits_of(program, arguments, results, "after")
    return skipped


def limits_of(program, arguments, results, when):
    """Ask for the limits of the machine and keep them"""
    if not program:
        gf.say(f"no gimp_roofline.x in {arguments.build}: shares of the roofline stay empty")
    quick = ["--seconds", "0.002", "--megabytes", "64"] if arguments.quick else []
    most = min(max(arguments.threads), len(os.sched_getaffinity(0)))
    for line in roofline(program, quick, most):
        results.add({**line, "when": when}, "roofline.jsonl")


# -------------------------------------------------------------------------------------------------- two builds


def run_comparison(arguments):
    from bench_compare import HEADING as heading
    from bench_compare import compare_builds
    from bench_report import grouped

    print(f"{arguments.compare_builds[0]} and {arguments.compare_builds[1]}: largest relative difference at the end\n{heading}", flush=True)
    wanted = plan(arguments.cases, [32768], arguments.bases, arguments.transfers, [64], [1])
    lines, skipped = compare_builds(arguments.compare_builds, wanted, arguments.steps or 100)
    for note in grouped(skipped):
        print(f"left out: {note}")
    return 0 if lines else 1


def main(words=None):
    arguments = parse_arguments(words)
    if arguments.compare_builds:
        return run_comparison(arguments)
    if arguments.all or arguments.publish:
        return run_all(arguments)
    return run_one(arguments)


if __name__ == "__main__":
    gf.run_main(main)
