"""Running product and reference in turns, and keeping what was measured."""
import json
import os
import re
import shutil
import signal
import statistics
import subprocess
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

import bench_cases as cases
import bench_machine as machine
import bench_paths  # noqa: F401
import gimp_files as gf
import namelist

PHASES = ("particles", "grid", "sort")  # of wall_seconds; set-up and output are apart from it
REFERENCE_BYTES = 600  # a particle of the reference takes at most so many (333 in FLIP)


class Skipped(Exception):
    """A measurement that cannot be made here, and why, in one line"""


# --------------------------------------------------------------------------------------------------- the runs


def run_child(command, environment, folder=None, text=""):
    """Run a program: exit code, standard output, error output, and what it used

    `peak`: resident bytes, None if hidden below our own; `busy`: processor time over wall time, below 1 when others had it
    """
    with tempfile.TemporaryFile("w+") as source, tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        source.write(text)
        source.seek(0)
        began = time.monotonic()
        child = subprocess.Popen(command, stdin=source, stdout=out, stderr=err, cwd=folder, env=dict(os.environ, **environment))
        try:
            _, status, usage = os.wait4(child.pid, 0)
        except BaseException:
            child.send_signal(signal.SIGKILL)
            child.wait()
            raise
        child.returncode = os.waitstatus_to_exitcode(status)
        busy = (usage.ru_utime + usage.ru_stime)/max(time.monotonic() - began, 1e-6)
        out.seek(0)
        err.seek(0)
        peak = 1024*usage.ru_maxrss  # a fork of ours before it became the program: our own size is its least
        used = {"peak": peak if peak > machine.own_peak() else None, "busy": busy}
        return child.returncode, out.read(), err.read(), used


def run_reference(program, side, steps, sort_every, prefix, environment):
    """One run of the reference: core-nanoseconds per particle-step and kinetic energy"""
    code, out, err, used = run_child([*prefix, str(program), str(side), str(steps), str(sort_every), "fused"], environment)
    if code != 0:
        raise gf.GimpError(f"the reference ended with code {code}: {err.strip()[:200]}")
    told = json.loads(out)
    return {"ns": 1e3*told["threads"]/told["mean_mpps"], "energy": told["energy"], "particles": told["particles"], "busy": used["busy"]}


def run_product(text, folder, name, program, prefix, environment, keep=False, mass=None):
    """One run of gimp.x: the same figures from its output file, and what it says about memory and phases

    With `mass` (of all particles, equal ones) the kinetic energy is that of their velocities alone, as the reference gives it:
    the history counts the affine parts as well.
    """
    text = namelist.set_key(namelist.set_key(text, "output.name", name), "output.overwrite", True)
    code, out, err, used = run_child([*prefix, program], environment, folder, text)
    if code != 0:
        raise gf.GimpError(f"gimp.x ended with code {code}: {first_words(err or out)}")
    output = Path(folder) / f"{name}.vtkhdf"
    told, table = gf.summary(output), gf.history(output)
    energy = None
    if mass:
        *_, frame = gf.frames(output, "last", ["velocity"])
        energy = 0.5*mass*float((frame.get("velocity").astype(float)**2).sum())/len(frame)
    if not keep:
        output.unlink()  # a run of millions of particles leaves a large file
    for key in ("particle_steps_per_core_second", "steps", "particles"):
        if key not in told:
            raise gf.GimpError(f"the summary of gimp.x has no '{key}'")
    last = len(table.get("step", ())) > 0 and int(table["step"][-1]) == int(told["steps"])
    wall = told.get("wall_seconds")
    shares = {name: told[f"seconds_{name}"]/wall for name in PHASES if wall and f"seconds_{name}" in told}
    plastic = float(table["plastic_dissipation"][-1]) if last and "plastic_dissipation" in table else None
    return {"ns": 1e9/told["particle_steps_per_core_second"], "energy": (energy or float(table["kinetic_energy"][-1])) if last else None,
            "particles": int(told["particles"]), "steps": int(told["steps"]), "bytes": told.get("bytes_per_particle"),
            "state_bytes": told.get("state_bytes_per_particle"), "commit": told.get("commit"), "shares": shares,
            "plastic_dissipation": plastic, "output": output, **used}


def first_words(text):
    """The first lines of what a program said, as one"""
    said = [line.strip() for line in text.splitlines() if line.strip()]
    return " | ".join(said[:3]) or "it printed nothing"


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


# ---------------------------------------------------------------------------------------- one standard measurement


def admit(program, text, particles, folder):
    """Ask gimp.x whether it takes the scene and whether it fits: the scene; raises Skipped with the reason in one line"""
    code, out, err, _ = run_child([program, "--check"], {}, folder, text)
    if code == 2 and "flip_fraction" in err and 'transfer = "mls"' in text:  # a form without a share of FLIP does not read the key
        text = namelist.set_key(text, "method.flip_fraction", None)
        code, out, err, _ = run_child([program, "--check"], {}, folder, text)
    if code != 0:
        mistakes = [line.strip() for line in err.splitlines() if line.startswith("  ")]
        raise Skipped(f"gimp.x refuses: {mistakes[0] if mistakes else first_words(err or out)}")
    found = re.search(r"([\d,]+) bytes a particle with grid and sort", out)
    bytes_each = max(REFERENCE_BYTES, 1.25*int(found.group(1).replace(",", ""))) if found else REFERENCE_BYTES
    needed, free = particles*bytes_each + 2e8, machine.available_memory()
    if needed > free:
        raise Skipped(f"needs {needed/1e9:.1f} GB of memory, {free/1e9:.1f} GB are free")
    needed, free = 100*particles, shutil.disk_usage(folder).free  # two frames of positions and velocities
    if needed > free:
        raise Skipped(f"needs {needed/1e9:.1f} GB in {folder} for its output, {free/1e9:.1f} GB are free")
    return text


def measure(m, pairs, build_folder, build, reference_folder, steps=None, sort_every=20, tell=gf.say):
    """All pairs of one measurement: a line of the results. With several threads the product also runs on one, in turns"""
    program = machine.find_program(build_folder, "gimp.x" if m.bits == 64 else "gimp_sp.x")
    if not program:
        raise Skipped(f"no {'gimp.x' if m.bits == 64 else 'gimp_sp.x'} in {build_folder}")
    if m.threads > len(os.sched_getaffinity(0)):
        raise Skipped(f"{m.threads} threads, but only {len(os.sched_getaffinity(0))} processors")
    particles = cases.count_of(m.side, m.dimension)
    steps = steps or cases.steps_for(particles, sort_every)
    scene = cases.block_scene(gf.read_scene(cases.SCENES[m.case]), m.side, m.basis, steps, sort_every, m.transfer)
    roofline = machine.find_program(build_folder, "gimp_roofline.x")
    prefix, environment = machine.pinning(m.threads)
    products, references, alone, trips = [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        scene = admit(program, scene, particles, folder)
        reference, flags = machine.build_reference(m.variant, build, reference_folder)
        for pair in range(1, pairs + 1):
            if m.threads > 1:
                trips += machine.roofline(roofline, ["--only", "core_to_core", "--seconds", "0.02"], m.threads)
            references.append(run_reference(reference, m.side, steps, sort_every, prefix, environment))
            products.append(run_product(scene, folder, "run", program, prefix, environment, mass=m.affine_mass))
            if m.threads > 1:
                alone.append(run_product(scene, folder, "run", program, *machine.pinning(1)))
            tell(f"    pair {pair} of {pairs}: {products[-1]['ns']:.1f} ns, reference {references[-1]['ns']:.1f} ns")
    line = {**asdict(m), **report(products, references, m.same_step), "pairs": pairs, "sort_every": sort_every,
            "reference": m.variant, "floor": m.floor, "state_bytes_per_particle": products[-1]["state_bytes"],
            "shares": products[-1]["shares"], "plastic_dissipation": products[-1]["plastic_dissipation"],
            "busy": min(run["busy"] for run in products + references),
            "peak_bytes": max((p["peak"] for p in products if p["peak"]), default=None),
            "compiler": build["compiler"], "flags": flags, "build_type": build["build_type"], "commit": products[-1]["commit"]}
    line["asked_particles"] = m.particles
    if alone:
        gains = [m.threads*one["ns"]/many["ns"] for one, many in zip(alone, products)]
        line["scaling"], line["scaling_spread"] = statistics.median(gains), [min(gains), max(gains)]
        line["round_trip_ns"] = [t["farthest_median_ns"] for t in trips]
    return line


# ------------------------------------------------------------------------------------------------- the results


class Results:
    """The folder of finished measurements: measurements.jsonl and roofline.jsonl, appended line by line, so that none is lost"""

    def __init__(self, folder, resume=False):
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        if not resume:
            for name in ("measurements.jsonl", "roofline.jsonl"):
                if (self.folder / name).exists():
                    (self.folder / name).replace(self.folder / f"{name}.previous")
        self.lines, self.roofline = self._read("measurements.jsonl"), self._read("roofline.jsonl")

    def _read(self, name):
        path = self.folder / name
        lines = []
        for text in path.read_text().splitlines() if path.exists() else ():
            try:
                lines.append(json.loads(text))
            except json.JSONDecodeError:  # cut off when a run was killed
                gf.say(f"{path}: a line that is not whole is left out")
        return lines

    def keep_only(self, **same):
        """Leave out what another build measured; how many lines went"""
        kept = [line for line in self.lines if all(line.get(key) == value for key, value in same.items())]
        gone = len(self.lines) - len(kept)
        if gone:
            self.lines = kept
            (self.folder / "measurements.jsonl").replace(self.folder / "measurements.jsonl.previous")
            (self.folder / "measurements.jsonl").write_text("".join(json.dumps(line) + "\n" for line in kept))
        return gone

    def add(self, line, name="measurements.jsonl"):
        (self.lines if name == "measurements.jsonl" else self.roofline).append(line)
        with open(self.folder / name, "a") as file:
            file.write(json.dumps(line) + "\n")

    def finished(self, m, pairs):
        """Whether this measurement is there, with at least so many pairs"""
        return any(key_of(line) == m.key() and line["pairs"] >= pairs for line in self.lines)


def key_of(line):
    """Key of the measurement that a line of the results belongs to"""
    return (line["case"], line["basis"], line["transfer"], line["bits"], line["threads"], line["asked_particles"])


def with_shares_of_limit(line, roofline):
    """The line with its shares of the roofline: least time by memory and by flops over the time taken"""
    limit = machine.limits(roofline, line["threads"])
    wall = line["ns_per_particle_step"]/line["threads"]
    flops = cases.FLOPS.get((2 if line["case"].endswith("2d") else 3, line["basis"], line["transfer"])) if line["case"] != "mixed3d" else None
    memory = 2*line["state_bytes_per_particle"]/limit["memory"]/wall if limit["memory"] and line.get("state_bytes_per_particle") else None
    return {**line, "memory_share": memory, "flop_share": flops/limit[line["bits"]]/wall if flops and limit[line["bits"]] else None}


def memory_slopes(lines):
    """Peak resident bytes per added particle between the smallest and the largest size of each setting whose peaks are known"""
    groups = {}
    for line in lines:
        if line.get("peak_bytes") and line["threads"] == 1:
            groups.setdefault((line["case"], line["basis"], line["transfer"], line["bits"]), []).append(line)
    slopes = []
    for (case, basis, transfer, bits), found in groups.items():
        low, high = (pick(found, key=lambda line: line["particles"]) for pick in (min, max))
        if high["particles"] >= 2*low["particles"]:
            slopes.append({"case": case, "basis": basis, "transfer": transfer, "bits": bits, "from": low["particles"], "to": high["particles"],
                           "slope": (high["peak_bytes"] - low["peak_bytes"])/(high["particles"] - low["particles"]),
                           "told": high["bytes_per_particle"], "state": high["state_bytes_per_particle"]})
    return slopes
