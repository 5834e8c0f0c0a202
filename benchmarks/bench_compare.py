"""The same scenes with two builds: how far results are apart, which is round-off and no more."""
import os
import tempfile
from pathlib import Path

import bench_cases as cases
import bench_machine as machine
import bench_paths  # noqa: F401
import gimp_files as gf
import namelist
import numpy as np
from bench_measure import Skipped, admit, run_product

SIDES = {2: 32, 3: 16}  # cells along a side: 4096 and 32768 particles
HEADING = f"{'case':9} {'basis':9} {'transfer':8} {'steps':>5} {'energy':>9} {'position':>9} {'velocity':>9} {'hash':>9}"


def final_state(text, program, folder, threads):
    """Kinetic energy, positions and velocities in order of the particles' numbers, and the hash of one run"""
    prefix, environment = machine.pinning(threads)
    told = run_product(text, folder, "run", program, prefix, environment, keep=True)
    frame = next(gf.frames(told["output"], "last"))
    order = np.argsort(frame.get("id"))
    position = frame.get("reference_position") + frame.get("displacement")  # points may be in single precision
    return told["energy"], position[order], frame.get("velocity")[order], gf.summary(told["output"]).get("state_hash")


def largest(a, b):
    """Largest difference, relative to the largest size"""
    return float(np.abs(a - b).max()/max(np.abs(a).max(), np.finfo(float).tiny))


def compare(m, builds, steps, threads=1):
    """Largest relative differences between the runs of two programs"""
    side = SIDES[m.dimension]
    text = cases.block_scene(gf.read_scene(cases.SCENES[m.case]), side, m.basis, steps, 20, m.transfer)
    text = namelist.set_key(text, "output.fields", ["id", "displacement", "reference_position", "velocity"])
    text = namelist.set_key(text, "output.precision", "double")
    with tempfile.TemporaryDirectory() as folder:
        for program in builds:
            text = admit(program, text, cases.count_of(side, m.dimension), folder)
        one, other = (final_state(text, program, folder, threads) for program in builds)
    return {"case": m.case, "basis": m.basis, "transfer": m.transfer, "steps": steps, "energy": abs(one[0] - other[0])/abs(one[0]),
            "position": largest(one[1], other[1]), "velocity": largest(one[2], other[2]), "same_hash": one[3] == other[3]}


def table_line(line):
    return (f"{line['case']:9} {line['basis']:9} {line['transfer']:8} {line['steps']:5d} {line['energy']:9.1e} {line['position']:9.1e} "
            f"{line['velocity']:9.1e} {'the same' if line['same_hash'] else 'differs':>9}")


def compare_builds(folders, measurements, steps):
    """Compare all settings; lines with the differences, and the settings that were left out"""
    programs = []
    for folder in folders:
        program = str(Path(folder).resolve()) if folder.endswith(".x") else machine.find_program(folder)
        if not program or not os.access(program, os.X_OK):
            raise gf.GimpError(f"{folder}: no such program, or no gimp.x in it")
        programs.append(program)
    lines, skipped = [], []
    for m in measurements:
        try:
            lines.append(compare(m, programs, steps))
            print(table_line(lines[-1]), flush=True)
        except Skipped as reason:
            skipped.append((m, str(reason)))
    return lines, skipped
