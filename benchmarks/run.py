#!/usr/bin/env python3
"""Speed of gimp.x beside the speed reference, on the same machine, in the same run.

  run.py --basis ugimp                          262 144 particles, one thread, five interleaved pairs
  run.py --basis linear --particles 32768       a smaller cube
  run.py --defaults --json cube.jsonl           also the same cube with all defaults of gimp.x

The reference (benchmarks/reference) is built with the compiler and the flags of the product's build folder. Reference
and product take turns, pinned to the same processor; the ratio is the median over the pairs of reference time over
product time, both of the time steps only, sorts included. How far the two results are apart stands beside it.
"""
import argparse
import json
import math
import os
import re
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parent
sys.path.insert(0, str(REPOSITORY / "postprocessing"))

import gimp_files as gf  # noqa: E402
import namelist  # noqa: E402

SCENES = {"cube3d": REPOSITORY / "inputs" / "benchmark" / "cube3d.nml"}
BASES = ("ugimp", "linear", "cpgimp")
DENSITY, YOUNG, POISSON = 1000.0, 1.0e6, 0.3  # of the reference; the scene must agree


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", choices=tuple(SCENES), default="cube3d", help="scene (default: cube3d)")
    parser.add_argument("--basis", choices=BASES, default="ugimp", help="basis (default: ugimp)")
    parser.add_argument("--particles", type=int, default=262144,
                        help="about so many; 8 per cell of a cube (default: 262144)")
    parser.add_argument("--threads", type=int, default=1, help="threads of both (default: 1)")
    parser.add_argument("--pairs", type=int, default=5, help="pairs of runs (default: 5)")
    parser.add_argument("--steps", type=int, default=40, help="time steps of a run (default: 40)")
    parser.add_argument("--sort-every", type=int, default=20, help="steps between sorts, in both (default: 20)")
    parser.add_argument("--cpus", help="processors to pin to, as taskset takes them (default: the first ones)")
    parser.add_argument("--build", default=str(REPOSITORY / "build"),
                        help="build folder of the product (default: build)")
    parser.add_argument("--defaults", action="store_true", help="also time the cube with all defaults of gimp.x")
    parser.add_argument("--json", metavar="FILE",
                        help="append JSON lines to FILE; - for the standard output (the table then goes to the error "
                             "output)")
    arguments = parser.parse_args(words)
    for name in ("particles", "threads", "pairs", "steps", "sort_every"):
        if getattr(arguments, name) < 1:
            parser.error(f"--{name.replace('_', '-')} must be positive")
    return arguments


# ------------------------------------------------------------------------------------------------- the builds


def product_build(folder):
    """Compiler and flags of the product: from the build rules of a kernel file, else from the cache"""
    folder = Path(folder)
    cache = folder / "CMakeCache.txt"
    if not cache.exists():
        raise gf.GimpError(f"{folder} is no build folder of gimp.x (no CMakeCache.txt); name it with --build")
    entries = dict(re.findall(r"^([\w-]+):[^=\n]*=(.*)$", cache.read_text(), re.MULTILINE))
    kind = entries.get("CMAKE_BUILD_TYPE", "")
    cached = [entries.get(name, "") for name in ("CMAKE_Fortran_FLAGS", f"CMAKE_Fortran_FLAGS_{kind.upper()}")]
    flags = _rule_flags(folder) or " ".join(cached)
    return {"compiler": entries.get("CMAKE_Fortran_COMPILER", "gfortran"), "flags": speed_flags(flags), "build_type": kind}


def _rule_flags(folder):
    """Flags with which the transfer kernels were compiled (Ninja or Make)"""
    rules = folder / "build.ninja"
    if rules.exists():
        text = rules.read_text()
        for where in (r"src/transfer/\S*kernel", "src/transfer/", "src/"):
            found = re.search(rf"^build {where}\S*: Fortran_COMPILER_.*\n(?:  .*\n)*?  FLAGS = (.*)$", text, re.MULTILINE)
            if found:
                return found.group(1)
    made = folder / "src" / "transfer" / "CMakeFiles" / "gimp_transfer.dir" / "flags.make"
    if made.exists():
        found = re.search(r"^Fortran_FLAGS = (.*)$", made.read_text(), re.MULTILINE)
        if found:
            return found.group(1)
    return ""


def speed_flags(text):
    """The flags that decide about speed and rounding: no language standard, warnings, folders or preprocessor switches"""
    kept, skip = [], False
    for flag in shlex.split(text):
        if skip:
            skip = False
        elif flag in ("-J", "-I"):
            skip = True
        elif not re.match(r"-(std=|W|w$|J|I|D|g\d?$|cpp|fpp|ffree|ffixed|fpreprocessed|fopenmp)", flag):
            kept.append(flag)
    return " ".join(kept)


def needs_split(flags):
    """Whether vectors are 256 bits wide: then the reference is faster with its transfers in two passes"""
    if "-march=native" in flags:
        try:
            return "avx512f" not in Path("/proc/cpuinfo").read_text()
        except OSError:
            return False
    return not re.search(r"-m(arch=(x86-64-v4|skylake-avx512|icelake|sapphirerapids|znver[45])|avx512f)", flags)


def build_reference(variant, build, folder):
    """Build one variant of the reference with the product's compiler and flags; its path"""
    flags = build["flags"] + (" -DSPLIT" if needs_split(build["flags"]) else "")
    done = subprocess.run([str(HERE / "reference" / "build.sh"), variant], text=True, capture_output=True,
                          env=dict(os.environ, FC=build["compiler"], FLAGS=flags, BIN=str(folder)))
    if done.returncode != 0:
        raise gf.GimpError(f"the reference does not build: {' | '.join((done.stderr or done.stdout).splitlines()[-3:])}")
    return Path(folder) / variant, flags


# --------------------------------------------------------------------------------------------------- the runs


def pinning(threads, cpus=None):
    """Command that pins to processors, and the environment for it"""
    environment = {"OMP_NUM_THREADS": str(threads), "OMP_PROC_BIND": "true", "OMP_WAIT_POLICY": "active"}
    if not shutil.which("taskset"):
        gf.say("taskset is not there: runs are pinned by OMP_PROC_BIND only")
        return [], environment
    if not cpus:
        allowed = sorted(os.sched_getaffinity(0))
        if len(allowed) < threads:
            raise gf.GimpError(f"{threads} threads, but only {len(allowed)} processors")
        cpus = ",".join(map(str, allowed[:threads]))
    return ["taskset", "-c", cpus], environment


def side_of(particles):
    """Cells along a side of the block, an even number so that its faces lie on cell faces"""
    return max(2, 2*round((particles/8)**(1/3)/2))


def cube_scene(text, side, basis, steps, sort_every):
    """The scene with the settings of the reference"""
    spacing = 0.5/side
    step = fixed_step(side)
    for path, value in (("grid.spacing", spacing), ("method.basis", basis), ("method.sort_every", sort_every), ("time.step", step),
                        ("time.end", steps*step), ("time.max_steps", steps), ("output.history_every", steps)):
        text = namelist.set_key(text, path, value)
    return text


def defaults_scene(text, side, steps):
    """The same cube with nothing said about the method, the step or what is written"""
    text = namelist.set_key(text, "grid.spacing", 0.5/side)
    text = namelist.remove_group(namelist.remove_group(text, "method"), "output")
    for key in [k for g in namelist.groups(text) if g.name == "time" for k in g.keys]:
        text = namelist.set_key(text, f"time.{key}", None)
    text = namelist.set_key(text, "time.end", 100*steps*fixed_step(side))
    text = namelist.set_key(text, "time.max_steps", steps)
    return namelist.set_key(text, "output.progress", "off")


def fixed_step(side):
    """Step of the reference [s]: 0.2 h / c"""
    return 0.2*(0.5/side)/math.sqrt(YOUNG*(1 - POISSON)/((1 + POISSON)*(1 - 2*POISSON))/DENSITY)


def run_reference(program, side, steps, sort_every, prefix, environment):
    """One run of the reference: core-nanoseconds per particle-step and kinetic energy"""
    done = subprocess.run([*prefix, str(program), str(side), str(steps), str(sort_every), "fused"], text=True, capture_output=True,
                          env=dict(os.environ, **environment))
    if done.returncode != 0:
        raise gf.GimpError(f"the reference ended with code {done.returncode}: {done.stderr.strip()[:200]}")
    told = json.loads(done.stdout)
    return {"ns": 1e3*told["threads"]/told["mean_mpps"], "energy": told["energy"], "particles": told["particles"]}


def run_product(text, folder, name, program, prefix, environment):
    """One run of gimp.x: the same figures from its output file"""
    output = gf.run_scene(text, folder, name, program, prefix=prefix, environment=environment)
    told, table = gf.summary(output), gf.history(output)
    output.unlink()  # a run of millions of particles leaves a large file
    for key in ("particle_steps_per_core_second", "steps", "particles"):
        if key not in told:
            raise gf.GimpError(f"the summary of gimp.x has no '{key}'")
    last = len(table.get("step", ())) > 0 and int(table["step"][-1]) == int(told["steps"])
    return {"ns": 1e9/told["particle_steps_per_core_second"], "energy": float(table["kinetic_energy"][-1]) if last else None,
            "particles": int(told["particles"]), "steps": int(told["steps"]), "bytes": told.get("bytes_per_particle"),
            "commit": told.get("commit")}


def report(products, references, same_step=True):
    """The figures of all pairs of one case; energies are compared only where both took the same steps"""
    ratios = [r["ns"]/p["ns"] for p, r in zip(products, references)]
    energy, expected = products[-1]["energy"], references[-1]["energy"]
    return {"ns_per_particle_step": statistics.median(p["ns"] for p in products),
            "reference_ns": statistics.median(r["ns"] for r in references),
            "ratio": statistics.median(ratios), "ratio_spread": [min(ratios), max(ratios)],
            "bytes_per_particle": products[-1]["bytes"], "particles": products[-1]["particles"], "steps": products[-1]["steps"],
            "kinetic_energy": energy, "reference_kinetic_energy": expected,
            "energy_difference": abs(energy - expected)/abs(expected) if energy is not None and same_step else None}


HEADING = (f"{'case':8} {'settings':10} {'particles':>9} {'ns':>8} {'reference':>9} {'ratio':>6} {'spread':>13} "
           f"{'bytes':>6} {'energy differs by':>18}")


def table_line(line):
    """One line of the table"""
    low, high = line["ratio_spread"]
    memory = f"{line['bytes_per_particle']:6.0f}" if line["bytes_per_particle"] is not None else f"{'?':>6}"
    differs = f"{line['energy_difference']:18.1e}" if line["energy_difference"] is not None else f"{'not comparable':>18}"
    return (f"{line['case']:8} {line['settings']:10} {line['particles']:9d} {line['ns_per_particle_step']:8.2f} "
            f"{line['reference_ns']:9.2f} {line['ratio']:6.3f} {low:6.3f}-{high:5.3f} {memory} {differs}")


def main(words=None):
    arguments = parse_arguments(words)
    build = product_build(arguments.build)
    program = str(Path(arguments.build).resolve() / "bin" / "gimp.x")
    if os.environ.get("GIMP_X"):
        program = gf.find_gimp()
    elif not os.access(program, os.X_OK):
        raise gf.GimpError(f"{program} is not there: build the program first, or name it in GIMP_X")
    prefix, environment = pinning(arguments.threads, arguments.cpus)
    side = side_of(arguments.particles)
    if 8*side**3 != arguments.particles:
        gf.say(f"{8*side**3} particles: a cube of {side} cells per side")
    variant = f"{arguments.basis}3d_64"
    text = gf.read_scene(SCENES[arguments.case])
    scenes = {arguments.basis: cube_scene(text, side, arguments.basis, arguments.steps, arguments.sort_every)}
    if arguments.defaults:
        scenes["defaults"] = defaults_scene(text, side, arguments.steps)
    products, references = {name: [] for name in scenes}, []
    with tempfile.TemporaryDirectory() as folder:
        gf.say(f"building the reference {variant}: {build['compiler']} {build['flags']}")
        reference, flags = build_reference(variant, build, Path(folder) / "reference")
        for pair in range(1, arguments.pairs + 1):
            references.append(run_reference(reference, side, arguments.steps, arguments.sort_every, prefix, environment))
            for name, scene in scenes.items():
                products[name].append(run_product(scene, folder, name, program, prefix, environment))
            gf.say(f"pair {pair} of {arguments.pairs}: reference {references[-1]['ns']:.2f} ns, "
                   + ", ".join(f"{name} {runs[-1]['ns']:.2f} ns" for name, runs in products.items()))
    lines = []
    for name, runs in products.items():
        lines.append({"case": arguments.case, "basis": arguments.basis if name == arguments.basis else "default", "settings": name,
                      **report(runs, references, same_step=name == arguments.basis),
                      "threads": arguments.threads, "pairs": arguments.pairs, "sort_every": arguments.sort_every,
                      "reference": variant, "compiler": build["compiler"], "flags": flags,
                      "build_type": build["build_type"], "commit": runs[-1]["commit"]})
    table_goes_to = sys.stderr if arguments.json == "-" else sys.stdout
    print(HEADING, *map(table_line, lines), sep="\n", file=table_goes_to)
    print("ns: core-nanoseconds per particle-step; ratio: reference time / product time, median of the pairs "
          "(below 0.75 is a defect)", file=table_goes_to)
    if arguments.json == "-":
        print("\n".join(map(json.dumps, lines)))
    elif arguments.json:
        with open(arguments.json, "a") as file:
            file.write("\n".join(map(json.dumps, lines)) + "\n")
    return 0


if __name__ == "__main__":
    gf.run_main(main)
