"""How many ranks would do: counted messages and bytes against latency and bandwidth, beside the time of the particles.

A cube of full blocks in three dimensions, 512 particles a block, cut along the Morton curve: what a rank of b blocks sends does not depend on
how many ranks there are, so it is worked out exactly (rank_model.py) for a sample of ranks and some b, and read between those.
"""
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, log2

import bench_paths  # noqa: F401
import numpy as np

import rank_model as model
from rank_counts import markdown

PARTICLES_OF_BLOCK = 512
SAMPLES = ((2, 24), (4, 24), (9, 24), (20, 24), (45, 30), (120, 40), (300, 48), (1000, 64), (3000, 80), (10000, 110))  # blocks a rank, side of the cube


@dataclass(frozen=True)
class Machine:
    """Times of a core from docs/performance.md (cube3d, ugimp, FLIP, USL, 262 144 particles); the network: see docs/scaling.md"""
    particle: float = 156e-9  # a particle-step of a core [s]
    sort: float = 5e-9  # sorts, a particle and step [s]
    slot: float = 3.7e-6  # the nodes of a block, a step [s]: 8 % of 175 ns, 262 144 particles, 1000 slots
    latency: float = 1.5e-6  # of a message between nodes, software included [s]
    message: float = 0.4e-6  # time of a core for each message sent or received [s]
    bandwidth: float = 25e9  # of a node [B/s]: HDR, 200 Gb/s
    cores: int = 64  # of a node, which share it
    copy: float = 4e9  # packing, handing over within a node, unpacking: a thread [B/s]
    packers: int = 10  # threads of a rank that are worth their while in packing, at most: they share memory (assumed)
    passes: int = 1  # whose pads are sent, a step: USL
    reductions: int = 3  # a step
    drifted: float = 0.3  # share of the blocks at borders whose pads are used to their end
    sort_every: int = 50  # steps
    exchanges: int = 4  # lists of any length to any rank, a sort


@lru_cache
def samples():
    """Means over a sample of ranks, by blocks of a rank"""
    found = []
    for blocks, side in SAMPLES:
        layout = model.box_layout((side, side, side), max(2, round(side**3/blocks)))
        shares = model.shares_of(layout, sample=10)
        shares = shares[1:-1] or shares  # those at the ends of the curve lie at corners
        mean = {name: np.mean([getattr(s, name) for s in shares]) for name in ("blocks", "ghosts", "slots", "messages", "plain", "drifted", "border")}
        found.append(mean)
    return found


def share(blocks):
    """What a rank of so many blocks has, between the samples (logarithms are straight lines)"""
    known = samples()
    x = np.log([s["blocks"] for s in known])
    at = np.log(max(blocks, known[0]["blocks"]))
    slope = {"ghosts": 2/3, "plain": 2/3, "drifted": 2/3, "border": 2/3, "slots": 1.0, "messages": 0.0}
    found = {}
    for name, power in slope.items():
        y = np.log([s[name] for s in known])
        found[name] = float(np.exp(np.interp(at, x, y) + power*max(0.0, at - x[-1])))
    found["border"] = min(found["border"], blocks)
    return found


def bytes_of(machine, has):
    """Bytes of pads that come in a step"""
    return 8*machine.passes*(has["plain"] + machine.drifted*(has["drifted"] - has["plain"]))


def step_time(machine, particles, cores, threads):
    """Seconds of a step by what they go into, on the fullest rank; `particles` of all ranks"""
    ranks = max(1, round(cores/threads))
    mine = particles/ranks
    blocks = mine/PARTICLES_OF_BLOCK
    has = share(blocks)
    pad_bytes = bytes_of(machine, has)
    times = {"particles": mine*(machine.particle + machine.sort)/threads}
    times["nodes"] = blocks*machine.slot/threads  # of a rank alone, without its neighbours' nodes
    times["nodes near borders"] = has["slots"]*machine.slot/threads - times["nodes"]
    times["balance"] = times["particles"]*min(0.1, 1/blocks)  # blocks are not cut
    if ranks > 1:
        node_bytes = bytes_of(machine, share(blocks*machine.cores/threads)) if cores > machine.cores else 0.0  # what leaves it; its ranks are neighbours
        rounds = ceil(log2(ranks))
        times["packing"] = 2*pad_bytes/machine.copy/min(threads, machine.packers) + 2*machine.passes*has["messages"]*machine.message
        network = machine.passes*machine.latency + pad_bytes/machine.copy + node_bytes/machine.bandwidth
        times["pads, not hidden"] = max(0.0, network - times["particles"]*(1 - has["border"]/blocks))
        times["reductions"] = machine.reductions*2*machine.latency*rounds
        times["sorts, all ranks"] = machine.exchanges*rounds*(machine.latency + 8*ranks/2*machine.cores/threads/machine.bandwidth)/machine.sort_every
    return times


def table_of(machine):
    """Efficiencies: time of the particles and their nodes over all time"""
    lines = []
    for particles in (1e8, 1e9, 1e10):
        for cores in (1e3, 1e4, 1e5):
            for threads in (1, 16):
                times = step_time(machine, particles, cores, threads)
                has = share(particles*threads/cores/PARTICLES_OF_BLOCK)
                useful = times["particles"] + times["nodes"]
                lines.append({"particles": particles, "cores": cores, "threads": threads, "ranks": round(cores/threads), "blocks": particles*threads/cores/PARTICLES_OF_BLOCK,
                              "step": sum(times.values()), "efficiency": useful/sum(times.values()), "times": times, "messages": machine.passes*has["messages"],
                              "bytes": bytes_of(machine, has), "ghosts": has["ghosts"]})
    return lines


def words(lines):
    """A table of it"""
    rows = []
    for line in lines:
        lost = sorted(((t, name) for name, t in line["times"].items() if name not in ("particles", "nodes")), reverse=True)[:2]
        rows.append([f"1e{log2(line['particles'])/log2(10):.0f}", f"1e{log2(line['cores'])/log2(10):.0f}", f"{line['ranks']} x {line['threads']}", f"{line['blocks']:.0f}",
                     f"{line['messages']:.0f}", f"{line['bytes']/1e3:.0f}", f"{1e3*line['step']:.2f}", f"{100*line['efficiency']:.0f} %",
                     ", ".join(f"{name} {100*t/line['step']:.0f} %" for t, name in lost)])
    heading = ("particles", "cores", "ranks x threads", "blocks a rank", "messages a rank and step", "kB a rank and step", "step, ms", "efficiency", "most is lost with")
    return markdown(heading, rows)


def draw(path, lines):
    """Efficiency over cores, and where the time goes"""
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    machine = Machine()
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5.2))
    cores = np.logspace(2, 5.5, 60)
    for color, particles in zip(("tab:blue", "tab:orange", "tab:green"), (1e8, 1e9, 1e10)):
        for threads, style in ((1, "-"), (16, "--")):
            found = []
            for c in cores:
                times = step_time(machine, particles, c, threads)
                found.append((times["particles"] + times["nodes"])/sum(times.values()))
            left.semilogx(cores, found, style, color=color, label=f"$10^{{{round(np.log10(particles))}}}$ particles, {threads} thread{'s'*(threads > 1)} a rank")
    left.set(xlabel="cores", ylabel="parallel efficiency", ylim=(0, 1.02), title="predicted, HDR network, nodes of 64 cores")
    left.grid(alpha=0.3)
    left.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncol=2)
    mine = np.logspace(3, 7, 60)  # particles of a core
    ranks = 1e4
    found = [step_time(machine, m*ranks, ranks, 1) for m in mine]
    names = list(found[0])
    heights = np.array([[t[name]/sum(t.values()) for t in found] for name in names])
    right.stackplot(mine, heights, labels=names, colors=plt.cm.tab20.colors[:len(names)])
    right.set(xscale="log", xlabel="particles a core", ylabel="share of a step", xlim=(mine[0], mine[-1]), ylim=(0, 1), title="where the time goes: $10^4$ ranks of one thread")
    right.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncol=3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
