"""What ranks send, counted by the program, beside what the model of rank_model.py says."""
import tempfile
from pathlib import Path

import bench_paths  # noqa: F401
import h5py
import numpy as np

import gimp_files as gf
import namelist
import rank_model as model
from bench_cases import SCENES, block_scene
from bench_report import table

LANES = 8  # particles of a chunk
LIMIT = 1.1  # imbalance_limit
STEPS = 4

# settings beside the scene's own, and the passes of a step whose pads are sent
METHODS = {"usl": ({"stress_update": "usl"}, 1),
           "musl": ({"stress_update": "musl"}, 2),
           "fmpm(3)": ({"stress_update": "usl", "transfer": "fmpm", "transfer_order": 3, "flip_fraction": None}, 3)}


def cube(side, method="usl", basis="ugimp", steps=STEPS, sort_every=0):
    """The cube of the benchmarks, hardly moving: its layout stays"""
    text = block_scene(gf.read_scene(SCENES["cube3d"]), side, basis, steps, sort_every)
    text = namelist.set_key(text, "time.end", 1.0)
    for key, value in METHODS[method][0].items():
        text = namelist.set_key(text, f"method.{key}", value)
    return text


def layout_of(checkpoint, ranks, dim, basis="ugimp"):
    """Blocks of a checkpoint, cut for so many ranks as the program does at its first sort"""
    with h5py.File(checkpoint, "r") as file:
        groups = file["particles/groups"][:]
        particles = (file["particles/id"][:] > 0).sum(axis=1)
    before = np.concatenate(([0], np.cumsum(particles)))
    _, first = np.unique(groups[:, 0], return_index=True)
    at = groups[first, 4:7]
    held = np.add.reduceat(before[groups[:, 3]] - before[groups[:, 2] - 1], first)
    work = model.WORK_OF_PAD + np.add.reduceat(groups[:, 3] - groups[:, 2] + 1, first)
    by_particles = model.make_layout(at, held, ranks, dim, basis)
    by_work = model.make_layout(at, work, ranks, dim, basis)
    total = np.concatenate(([0], np.cumsum(work[np.argsort(model.morton(at))])))
    now, then = (np.diff(total[cut.first]).max()*ranks/total[-1] for cut in (by_particles, by_work))
    return by_work if now > LIMIT and then < 0.5*(now + 1) else by_particles


def measure(run, ranks, quick=False):
    """Counts of a cube on so many ranks; `run(text, folder, ranks)` gives a summary, with 0 ranks that of gimp.x"""
    side = 16 if quick else 32
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        alone = run(cube(side) + f"\n&restart\n  every_steps = {STEPS}\n/\n", folder, 0)
        checkpoint = next(Path(folder).glob("*.checkpoint.h5"))
        layouts = {n: layout_of(checkpoint, n, 3) for n in ranks}  # later runs delete it
        for n, layout in layouts.items():
            shares = model.shares_of(layout)
            for method, (_, passes) in METHODS.items():
                if method != "usl" and n not in (2, 8):
                    continue
                more, told = (run(cube(side, method, steps=s), folder, n) for s in (2*STEPS, STEPS))
                if method == "usl" and told["state_hash"] != alone["state_hash"]:
                    raise gf.GimpError(f"{n} ranks end with other bits than one")
                per_step = {key: (more[key] - told[key])/STEPS for key in ("pad_messages", "pad_bytes", "reductions")}
                lines.append({"ranks": n, "method": method, "blocks": sum(s.blocks for s in shares), "passes": passes,
                              "messages": per_step["pad_messages"], "model_messages": passes*sum(s.messages for s in shares),
                              "bytes": per_step["pad_bytes"], "model_bytes": 8*passes*sum(s.plain for s in shares),
                              "drifted_bytes": 8*passes*sum(s.drifted for s in shares), "reductions": per_step["reductions"],
                              "halo": told["halo_share"], "model_halo": max(s.ghosts/max(1, s.blocks) for s in shares),
                              "slots": sum(s.slots for s in shares)/sum(s.booked for s in shares),
                              "imbalance": told["imbalance_worst"]})
                gf.say(f"{n} ranks, {method}: {lines[-1]['messages']:.0f} messages ({lines[-1]['model_messages']}), "
                       f"{lines[-1]['bytes']:.0f} bytes ({lines[-1]['model_bytes']})")
    return lines


def markdown(heading, rows):
    """A table as text"""
    return "\n".join(table(heading, [[str(cell) for cell in row] for row in rows]))


def words(lines):
    """A table of it"""
    def beside(counted, expected):
        return f"{counted:.0f} / {expected:.0f}" if abs(counted - expected) > 1e-6 else f"{counted:.0f} (equal)"

    rows = [[line["ranks"], line["method"], beside(line["messages"], line["model_messages"]), beside(line["bytes"], line["model_bytes"]),
             f"{line['bytes']/line['ranks']/1e3:.0f}", f"{line['drifted_bytes']/max(1, line['model_bytes']):.2f}", f"{line['reductions']:.0f}",
             f"{line['halo']:.2f} / {line['model_halo']:.2f}", f"{line['slots']:.2f}", f"{100*(line['imbalance'] - 1):.1f} %"] for line in lines]
    heading = ("ranks", "method", "messages a step, counted / model", "bytes a step, counted / model", "kB a rank and step", "times so many if all drifted",
               "reductions a step", "ghosts a block of a rank, counted / model", "slots, all ranks over one", "imbalance")
    return f"A cube of {lines[0]['blocks']} full blocks in three dimensions, `ugimp`; sums over all ranks:\n\n" + markdown(heading, rows)
