#!/usr/bin/env python3
"""Error of a scene over finer and finer grids, with the rates and what it costs.

  convergence.py inputs/vortex.nml --cells 24,48,96 --set method.basis=cpgimp --plot vortex.png
  convergence.py inputs/axis_aligned_2d.nml --mesh "block --cells {n},{n} --distort 0.3" --set method.basis=cpdi2 --set method.domain=

Each grid has CELLS cells along the x axis of the box (spacing = width/CELLS). With --mesh a mesh takes the place of the grid: its words
are those of preprocessing/make_mesh.py without the file, where {n}, or whole-number arithmetic such as {2*n} and {n*2//3}, stands for
CELLS; its h is the width of the mesh over CELLS, for lattices of particles too. The scene must name an exact solution
(&verification). gimp.x is taken from the environment variable GIMP_X, from build/bin, or from the PATH.
"""
import suitable_python  # noqa: F401 isort: skip (must come first)
import argparse
import json
import math
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import gimp_files as gf
import namelist

MAKE_MESH = gf.REPOSITORY / "preprocessing" / "make_mesh.py"
ERRORS = ("error_rms", "error_max", "error_rms_velocity", "error_rms_stress")
NAN = math.nan


def parse_arguments(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", help="scene to run, a namelist file")
    parser.add_argument("--cells", default="8,16,32",
                        help="cells along x of the grids, comma between (default: 8,16,32)")
    parser.add_argument("--mesh", metavar="WORDS", help="make a mesh for each size with these words of make_mesh.py, in place of the grid")
    parser.add_argument("--set", action="append", default=[], metavar="GROUP.KEY=VALUE",
                        help="change the scene; body[2].key for the second body, GROUP.KEY= takes a key away; may be repeated")
    parser.add_argument("--json", metavar="FILE",
                        help="one JSON line for each grid; - for the standard output (the table then goes to the "
                             "error output)")
    parser.add_argument("--plot", metavar="FILE", help="draw the errors over the spacing")
    parser.add_argument("--keep", metavar="FOLDER",
                        help="keep scenes, logs and output files there (default: a temporary folder)")
    parser.add_argument("--threads", type=int, help="threads of gimp.x (default: as OMP_NUM_THREADS says)")
    arguments = parser.parse_args(words)
    try:
        arguments.cells = [int(w) for w in arguments.cells.split(",")]
    except ValueError:
        parser.error(f"--cells {arguments.cells}: whole numbers with commas between")
    if min(arguments.cells) < 1:
        parser.error("--cells: the numbers must be positive")
    return arguments


def box_of(text):
    """Lower and upper corner of the scene's grid"""
    for group in namelist.groups(text):
        if group.name == "grid":
            values = group.values()
            if "lower" in values and "upper" in values:
                return values["lower"], values["upper"]
    raise gf.GimpError("the scene has no &grid with lower and upper")


def on_mesh(text, words, cells, folder):
    """The scene on a mesh that is made for so many cells in place of its grid, and the size of the cells"""
    path = Path(folder).resolve() / f"mesh_{cells}.h5"
    path.parent.mkdir(parents=True, exist_ok=True)
    words = re.sub(r"\{([n\d+\-*/() ]+)\}", lambda found: str(eval(found.group(1), {"n": cells})), words)
    done = subprocess.run([sys.executable, MAKE_MESH, *shlex.split(words), path], capture_output=True, text=True)
    if done.returncode != 0:
        raise gf.GimpError(f"make_mesh.py {words}: {(done.stderr.strip() or 'ended badly').splitlines()[-1]}")
    with gf.open_file(path) as mesh:
        spacing = float(np.ptp(mesh["nodes"][:, 0]))/cells
    text = namelist.set_key(namelist.remove_group(text, "grid"), "mesh.file", str(path))
    return namelist.set_key(text, "mesh.reference_length", spacing), spacing


def on_grid(text, cells):
    """The scene with so many cells along x, and their size"""
    lower, upper = box_of(text)
    spacing = (upper[0] - lower[0])/cells
    return namelist.set_key(text, "grid.spacing", spacing), spacing


def run_size(text, cells, folder, threads=None, program=None, mesh=None):
    """Run the scene with so many cells along x; the row of the table. A run that fails gives nan and its reason"""
    text, spacing = on_mesh(text, mesh, cells, folder) if mesh else on_grid(text, cells)
    row = {"cells": cells, "h": spacing, **dict.fromkeys(ERRORS, NAN), "steps": NAN, "wall_seconds": NAN,
           "particle_steps_per_core_second": NAN}
    try:
        output = gf.run_scene(text, folder, f"cells_{cells}", program, threads)
        found = gf.summary(output)
        row.update({name: found[name] for name in row if name in found})
        if "error_rms" not in found:
            row["problem"] = "the scene has no exact solution (&verification)"
    except gf.GimpError as problem:
        row["problem"] = str(problem)
    return row


def rate(coarse, fine, name="error_rms"):
    """Order at which the error falls from one grid to the next"""
    if coarse[name] > 0 and fine[name] > 0 and coarse["h"] != fine["h"]:
        return math.log(coarse[name]/fine[name])/math.log(coarse["h"]/fine["h"])
    return NAN


HEADING = f"{'cells':>6} {'h [m]':>10} {'error rms':>11} {'rate':>6} {'error max':>11} {'rate':>6} {'steps':>8} {'seconds':>9}"


def table_line(row, before=None):
    """One line of the table"""
    rates = [rate(before, row, name) if before else NAN for name in ("error_rms", "error_max")]
    shown = [f"{r:6.2f}" if math.isfinite(r) else f"{'':6}" for r in rates]
    line = (f"{row['cells']:6d} {row['h']:10.4g} {row['error_rms']:11.3e} {shown[0]} {row['error_max']:11.3e} {shown[1]} "
            f"{row['steps']:8.0f} {row['wall_seconds']:9.2f}")
    return line + (f"   {row['problem']}" if "problem" in row else "")


def json_line(row):
    """One line of JSON; what is not a number becomes null, as JSON has no nan"""
    return json.dumps({k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()})


def draw(rows, path, title):
    """Errors over spacing on log axes, with lines of first and second order"""
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    figure, axes = plt.subplots(figsize=(5.6, 4.4), layout="constrained")
    for name, label, mark in zip(ERRORS, ("displacement, rms", "displacement, max", "velocity, rms", "stress, rms"), "os^d"):
        points = [(r["h"], r[name]) for r in rows if r[name] > 0]
        if points:
            axes.loglog(*zip(*points), marker=mark, markersize=5, linewidth=1.2, label=label)
    good = sorted((r["h"], r["error_rms"]) for r in rows if r["error_rms"] > 0)
    if len(good) > 1:
        (fine, error), (coarse, _) = good[0], good[-1]
        for order, line in ((1, ":"), (2, "--")):
            axes.loglog([fine, coarse], [0.6*error, 0.6*error*(coarse/fine)**order], line, color="0.6",
                        linewidth=1, label=f"order {order}")
        axes.set_xticks(sorted({r["h"] for r in rows}), [f"{h:.3g}" for h in sorted({r["h"] for r in rows})])
        axes.minorticks_off()
    else:
        axes.text(0.5, 0.5, "fewer than two grids gave an error", transform=axes.transAxes, ha="center", color="0.4")
    axes.set(xlabel="spacing [m]", ylabel="error, in units of error_scale")
    axes.set_title(title, fontsize=11)
    axes.grid(True, which="major", color="0.9")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8)
    try:
        figure.savefig(path, dpi=150)
    except (OSError, ValueError) as problem:
        raise gf.GimpError(f"{path}: cannot be written ({problem})") from None
    plt.close(figure)


def main(words=None):
    arguments = parse_arguments(words)
    text = namelist.apply_settings(gf.read_scene(arguments.scene), arguments.set)
    program = gf.find_gimp()
    table_goes_to = sys.stderr if arguments.json == "-" else sys.stdout
    rows = []
    print(HEADING, file=table_goes_to)
    with tempfile.TemporaryDirectory() as scratch:
        for cells in arguments.cells:
            rows.append(run_size(text, cells, arguments.keep or scratch, arguments.threads, program, arguments.mesh))
            print(table_line(rows[-1], rows[-2] if len(rows) > 1 else None), file=table_goes_to, flush=True)
    if arguments.json == "-":
        print("\n".join(map(json_line, rows)))
    elif arguments.json:
        Path(arguments.json).write_text("\n".join(map(json_line, rows)) + "\n")
    if arguments.plot:
        draw(rows, arguments.plot, Path(arguments.scene).stem + ("  " + "  ".join(arguments.set) if arguments.set else ""))
    return 0 if all("problem" not in row for row in rows) else 1


if __name__ == "__main__":
    gf.run_main(main)
