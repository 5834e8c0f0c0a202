#!/usr/bin/env python3
"""Ranks: what they send, how even their work is, how fast two are, and what that means for many.

  ranks.py counts                    messages, bytes and reductions of 2 to 32 ranks beside the model: about ten minutes of processor time
  ranks.py counts --quick            2, 3 and 8 ranks, a small cube: one minute
  ranks.py balance                   a collapsing column on 8 ranks: shares of work, bytes of blocks handed over; some minutes
  ranks.py speed                     1 and 2 ranks against 1 and 2 threads, strong and weak: 20 minutes on 2 free processors
  ranks.py speed --quick             smaller: 3 minutes
  ranks.py predict                   parallel efficiency of 1e8 to 1e10 particles on 1e3 to 1e5 cores, and the picture of it
  ranks.py all --publish             one after the other

Counts do not depend on what else the machine does; times do, and are told as ratios of runs in turns only. `--publish` puts tables and picture into
docs/scaling.md, `--json FILE` appends one line for each part.
"""
import argparse
import json
import os
import re
import shutil
import statistics
import tempfile
from pathlib import Path

import bench_paths

import gimp_files as gf
import namelist
import rank_counts
import rank_forecast
from bench_cases import SCENES, block_scene, count_of, side_of
from rank_counts import markdown

REPOSITORY = bench_paths.REPOSITORY
DOCUMENT = REPOSITORY / "docs" / "scaling.md"
FIGURE = REPOSITORY / "docs" / "figures" / "scaling.png"
COLUMN = REPOSITORY / "inputs" / "ranks" / "column_collapse.nml"
PARTS = ("counts", "balance", "speed", "predict")


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=(*PARTS, "all"), help="what to look at")
    parser.add_argument("--build", default=str(REPOSITORY / "build"), help="build folder (default: build)")
    parser.add_argument("--quick", action="store_true", help="in small")
    parser.add_argument("--ranks", type=lambda text: tuple(int(w) for w in text.split(",")), help="counts: numbers of ranks (default: 2,3,4,7,8,16,32)")
    parser.add_argument("--pairs", type=int, help="speed: runs of each kind in turns (default: 7)")
    parser.add_argument("--steps", type=int, help="balance: end after so many steps (default: to the end of the scene)")
    parser.add_argument("--json", metavar="FILE", help="append what was found to FILE, one line a part")
    parser.add_argument("--publish", action="store_true", help="put tables and picture into docs/")
    return parser.parse_args(words)


# ------------------------------------------------------------------------------------------------- the runs


def programs(folder):
    """gimp.x and gimp_mpi.x of a build folder"""
    found = [Path(folder).resolve() / "bin" / name for name in ("gimp.x", "gimp_mpi.x")]
    for program in found:
        if not os.access(program, os.X_OK):
            raise gf.GimpError(f"{program} is not there: build it first, or name the build folder with --build")
    return [str(program) for program in found]


def launcher(ranks, free=True):
    """mpirun for so many ranks; with `free` more ranks than processors, who waits gives way"""
    if not shutil.which("mpirun"):
        raise gf.GimpError("there is no mpirun")
    how = ["--oversubscribe", "--mca", "mpi_yield_when_idle", "1"] if free else ["--bind-to", "core"]
    root = ["--allow-run-as-root"] if os.geteuid() == 0 else []
    return ["mpirun", *root, *how, "-n", str(ranks)]


def run_ranks(text, folder, program, ranks, threads=1, free=True):
    """The summary of a run"""
    environment = {"OMP_NUM_THREADS": str(threads), "OMP_WAIT_POLICY": "passive" if free else "active", "OMP_PROC_BIND": "false" if free else "true"}
    prefix = launcher(ranks, free) if ranks else []
    return gf.summary(gf.run_scene(text, folder, program=program, prefix=prefix, environment=environment))


# ----------------------------------------------------------------------------------------------------- speed


def speed(arguments):
    """1 and 2 ranks against 1 and 2 threads, in turns"""
    plain, parallel = programs(arguments.build)
    size = 262144 if arguments.quick else 2097152
    pairs = arguments.pairs or (3 if arguments.quick else 7)
    steps = 40 if arguments.quick else 20
    side, half = side_of(size), side_of(size//2)
    if len(os.sched_getaffinity(0)) < 2:
        raise gf.GimpError("two ranks need two processors")
    text = gf.read_scene(SCENES["cube3d"])
    whole, part = (block_scene(text, s, "ugimp", steps, 20) for s in (side, half))
    kinds = {"1 thread": (whole, plain, 0, 1), "2 threads": (whole, plain, 0, 2), "1 rank": (whole, parallel, 1, 1), "2 ranks": (whole, parallel, 2, 1),
             "half, 1 rank": (part, parallel, 1, 1)}
    times = {kind: [] for kind in kinds}  # seconds for a particle and step
    with tempfile.TemporaryDirectory() as folder:
        for pair in range(pairs):
            for kind, (scene, program, ranks, threads) in kinds.items():
                told = run_ranks(scene, folder, program, ranks, threads, free=False)
                times[kind].append(1.0/told["particle_steps_per_second"])
            gf.say(f"round {pair + 1} of {pairs}: " + ", ".join(f"{kind} {1e9*runs[-1]:.1f} ns" for kind, runs in times.items()))
    ratios = {"2 ranks against 1 thread": ("1 thread", "2 ranks", 1), "2 threads against 1 thread": ("1 thread", "2 threads", 1),
              "1 rank against 1 thread": ("1 thread", "1 rank", 1), "2 ranks against 2 threads": ("2 threads", "2 ranks", 1),
              "weak: 2 ranks, twice the particles, against 1 rank": ("half, 1 rank", "2 ranks", 0.5)}
    found = {}
    for name, (first, second, factor) in ratios.items():
        values = [factor*a/b for a, b in zip(times[first], times[second])]
        low, _, high = statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else values*3
        found[name] = {"median": statistics.median(values), "quartiles": [low, high]}
    rows = [[name, f"{told['median']:.2f}", f"{told['quartiles'][0]:.2f}-{told['quartiles'][1]:.2f}"] for name, told in found.items()]
    words = (f"`cube3d` with `ugimp`, FLIP and USL, {count_of(side)} particles (weak: {count_of(half)} a rank), {steps} steps, {pairs} rounds in turns, "
             "ratio of the speeds, of time steps and sorts alone:\n\n" + markdown(("", "speed, median", "quartiles"), rows))
    return words, {"particles": count_of(side), "steps": steps, "pairs": pairs, "ratios": found}


# --------------------------------------------------------------------------------------------------- balance


def balance(arguments):
    """A collapsing column on 8 ranks"""
    _, parallel = programs(arguments.build)
    text = gf.read_scene(COLUMN)
    steps = arguments.steps or (400 if arguments.quick else None)
    if steps:
        text = namelist.set_key(text, "time.max_steps", steps)
    with tempfile.TemporaryDirectory() as folder:
        told = run_ranks(text, folder, parallel, 8)
        gf.say("without repartition")
        never = run_ranks(namelist.set_key(text, "parallel.repartition", "never"), folder, parallel, 8)
    if told["state_hash"] != never["state_hash"]:
        raise gf.GimpError("results depend on the partition")
    rows = [[name, f"{t['steps']}", f"{t['repartitions']}", f"{100*(t['imbalance_worst'] - 1):.1f} %", f"{100*(t['imbalance_particles_worst'] - 1):.1f} %",
             f"{t['pad_bytes']/1e6:.1f} MB", f"{t['repartition_bytes']/1e6:.2f} MB", f"{100*t['repartition_bytes']/t['pad_bytes']:.2f} %"]
            for name, t in (("balanced", told), ("never", never))]
    heading = ("repartition", "steps", "repartitions", "worst imbalance of work", "of particles", "bytes of pads", "handed over", "of those of pads")
    keys = ("steps", "particles", "repartitions", "imbalance_worst", "imbalance_particles_worst", "pad_bytes", "repartition_bytes", "migrated_bytes", "state_hash")
    words = f"{told['particles']} particles, 8 ranks; imbalance: largest of a rank over the mean, less one, after any sort:\n\n" + markdown(heading, rows)
    return words, {name: {k: t[k] for k in keys if k in t} for name, t in (("balanced", told), ("never", never))}


# ------------------------------------------------------------------------------------------ counts and forecast


def counts(arguments):
    """What ranks send, beside the model"""
    plain, parallel = programs(arguments.build)
    ranks = arguments.ranks or ((2, 3, 8) if arguments.quick else (2, 3, 4, 7, 8, 16, 32))
    lines = rank_counts.measure(lambda text, folder, n: run_ranks(text, folder, parallel if n else plain, n), ranks, arguments.quick)
    return rank_counts.words(lines), lines


def predict(arguments):
    """Efficiency of many ranks"""
    lines = rank_forecast.table_of(rank_forecast.Machine())
    if arguments.publish:
        rank_forecast.draw(FIGURE, lines)
        gf.say(f"wrote {FIGURE}")
    return rank_forecast.words(lines), lines


def publish(part, words):
    """Put the words of a part between its marks in docs/scaling.md"""
    begin, end = (f"<!-- generated by benchmarks/ranks.py {part}: {which} -->" for which in ("begin", "end"))
    text = DOCUMENT.read_text()
    if begin not in text or end not in text:
        raise gf.GimpError(f"{DOCUMENT} has no place for {part}: {begin}")
    DOCUMENT.write_text(re.sub(re.escape(begin) + ".*" + re.escape(end), lambda _: f"{begin}\n\n{words}\n\n{end}", text, flags=re.DOTALL))


def main(words=None):
    arguments = parse_arguments(words)
    for part in PARTS if arguments.part == "all" else (arguments.part,):
        found, data = {"counts": counts, "balance": balance, "speed": speed, "predict": predict}[part](arguments)
        print(found, flush=True)
        if arguments.publish:
            publish(part, found)
        if arguments.json:
            with open(arguments.json, "a") as file:
                file.write(json.dumps({"part": part, "found": data}) + "\n")
    return 0


if __name__ == "__main__":
    gf.run_main(main)
