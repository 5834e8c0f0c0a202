"""Runs on several ranks: the ways to work that this build has, how they are started, and which processes belong to them."""
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

from conftest import MPIRUN, Run, output_name, text_of

# threads that wait give way, and ranks are not bound to the few cores that others use as well
ENVIRONMENT = {"OMP_WAIT_POLICY": "passive", **os.environ, "OMPI_MCA_hwloc_base_binding_policy": "none"}


@dataclass
class Way:
    """A way to run: a program, so many ranks (0: alone, without mpirun), and threads for each"""

    program: Path
    ranks: int
    threads: int

    def __str__(self):
        return f"{self.program.name} on {self.ranks} ranks of {self.threads} threads"

    def command(self, *arguments):
        alone = [str(self.program), *arguments]
        return [*MPIRUN, "-n", str(self.ranks), *alone] if self.ranks else alone

    def run(self, text, folder, *arguments, timeout=300):
        """Run a scene to its end"""
        text = text_of(text, **{"parallel.threads": self.threads})
        done = subprocess.run(self.command(*arguments), input=text, cwd=folder, timeout=timeout, text=True, env=ENVIRONMENT,
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        return Run(done.returncode, done.stdout, done.stderr, Path(folder), text, Path(folder) / f"{output_name(text)}.vtkhdf")

    def start(self, text, folder, *arguments):
        """The process of a run under way; what it says is in folder/log"""
        (folder / "scene.nml").write_text(text_of(text, **{"parallel.threads": self.threads}))
        with (folder / "scene.nml").open() as source, (folder / "log").open("w") as log:
            return subprocess.Popen(self.command(*arguments), stdin=source, cwd=folder, stdout=log, stderr=subprocess.STDOUT, env=ENVIRONMENT)


def any_way(dice, gimp_x, most_ranks=5):
    """Some way to run: alone, or on ranks of any kind that was built"""
    programs = [path for path in (gimp_x.with_name(name) for name in ("gimp_mpi.x", "gimp_caf.x")) if path.exists()]
    if dice.random() < 0.2:
        return Way(gimp_x, 0, dice.randint(1, 2))
    return Way(dice.choice(programs), dice.randint(1, most_ranks), dice.choice((1, 1, 2)))


def processes_of(pid, name):
    """Numbers of all processes below `pid` that run a program of that name"""
    found, open_ones = [], [pid]
    while open_ones:
        below = open_ones.pop()
        for task in Path(f"/proc/{below}/task").glob("*/children"):
            try:
                open_ones += [int(word) for word in task.read_text().split()]
            except OSError:  # it has just ended
                pass
        try:
            if Path(f"/proc/{below}/comm").read_text().strip() == name:
                found.append(below)
        except OSError:
            pass
    return found
