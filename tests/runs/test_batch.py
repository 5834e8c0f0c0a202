"""The scripts of inputs/batch run a scene in pieces until it is done, and leave what one run leaves.

The queues are not here: `sbatch` and `qsub` only note what they were given, and the test runs one job after the other; `srun` and
`timeout` send their signal not after minutes, but as soon as a piece has told of a checkpoint.
"""
import os
import re
import shlex
import shutil
import subprocess
import sys

import pytest

import gimp_files
from conftest import INPUTS, MPIRUN, check_same, text_of, with_checkpoints

RANKS = 2
SCRIPTS = {path.stem: path for path in sorted((INPUTS / "batch").glob("*.sh"))}
SCENE = with_checkpoints(text_of("two_disks.nml", 250, **{"grid.spacing": 0.025, "output.every": 0.2, "output.progress": "on"}),
                         every_steps=80)

PIECE = f"""#!{sys.executable}
import signal, subprocess, sys
words = [word for word in sys.argv[1:] if not word.startswith("--input") and word not in ("--preserve-status", "--foreground")]
if words[0].startswith("--signal="):  # of timeout, with the minutes behind it
    number, words = signal.Signals["SIG" + words[0][9:]], words[2:]
else:  # srun; the signal is in the head of the script
    number = signal.Signals["SIG" + SLURM_SIGNAL]
    words = ["mpirun"] + words
with open("pieces", "a") as pieces:
    print(*words, file=pieces)
run = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
told = False
for line in run.stdout:
    print(line, end="", flush=True)
    if "checkpoint at step" in line and not told:
        told = True
        run.send_signal(number)
sys.exit(run.wait())
"""
SUBMIT = """#!/bin/sh
echo "$@" >> queue
"""
MPI = f"""#!/bin/sh
case " $* " in *" -n "*) ranks= ;; *) ranks="-n {RANKS}" ;; esac
exec {{mpirun}} {shlex.join(MPIRUN[1:])} $ranks "$@"
"""


@pytest.fixture
def place(gimp_mpi_x, tmp_path):
    """A folder with the scripts, the scene, and in bin/ the commands of a queue; environment to work in it"""
    bin = tmp_path / "bin"
    bin.mkdir()
    slurm = re.search(r"^#SBATCH --signal=(\w+)@\d+$", SCRIPTS["slurm"].read_text(), flags=re.MULTILINE).group(1)
    commands = {"srun": PIECE, "timeout": PIECE, "sbatch": SUBMIT, "qsub": SUBMIT, "mpirun": MPI}
    for name, text in commands.items():
        (bin / name).write_text(text.replace("SLURM_SIGNAL", repr(slurm)).replace("{mpirun}", shutil.which("mpirun")))
        (bin / name).chmod(0o755)
    for path in SCRIPTS.values():
        (tmp_path / path.name).write_text(path.read_text().replace("ranks=4", f"ranks={RANKS}"))
    (tmp_path / "two_disks.nml").write_text(SCENE)
    (tmp_path / "queue").write_text("")
    path = os.pathsep.join([str(bin), str(gimp_mpi_x.parent), os.environ["PATH"]])
    return tmp_path, {**os.environ, "PATH": path, "OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive"}


def run_chain(script, place, **more):
    """Run a script and all that it submits: exit code of the last job, number of jobs"""
    folder, environment = place
    jobs = [script + ".sh"]
    for job in jobs:  # which grows
        words = shlex.split(job)
        variables = {}
        if words[0] == "-v":
            variables = dict([words[1].split("=")])
            words = words[2:]
        done = subprocess.run(["bash", *words], cwd=folder, env={**environment, **variables, **more}, timeout=120, text=True,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        (folder / "log").write_text(done.stdout)
        jobs += (folder / "queue").read_text().splitlines()
        (folder / "queue").write_text("")
        assert len(jobs) < 20
    return done.returncode, len(jobs)


def test_scripts_are_what_is_tested():
    assert list(SCRIPTS) == ["mpirun", "pbs", "slurm"]


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_chain_of_jobs_is_one_run(script, place, run_scene):
    folder, _ = place
    (folder / "whole").mkdir()
    whole = run_scene(SCENE, folder / "whole").succeeded()
    code, jobs = run_chain(script, place)
    assert code == 0, (folder / "log").read_text()
    pieces = (folder / "pieces").read_text().splitlines()
    assert len(pieces) >= 3
    assert ["--restart two_disks.checkpoint.h5" in piece for piece in pieces] == [False] + [True]*(len(pieces) - 1)
    assert jobs == (1 if script == "mpirun" else len(pieces))
    check_same(whole.output, folder / "two_disks.vtkhdf")
    assert gimp_files.summary(folder / "two_disks.vtkhdf")["ranks"] == RANKS


@pytest.mark.parametrize("script", SCRIPTS)
def test_other_exit_codes_end_the_chain(script, place):
    folder, _ = place
    (folder / "two_disks.nml").write_text(SCENE.replace("&time", "&tim"))
    assert run_chain(script, place) == (2, 1)
    assert len((folder / "pieces").read_text().splitlines()) == 1


@pytest.mark.parametrize("script", SCRIPTS)
def test_jobs_too_short_for_a_step_end_the_chain(script, place):
    """Each would submit the next for ever"""
    folder, _ = place
    (folder / "bin" / "gimp_mpi.x").write_text("#!/bin/sh\nexit 75\n")
    (folder / "bin" / "gimp_mpi.x").chmod(0o755)
    (folder / "two_disks.checkpoint.h5").write_text("of the job before")
    assert run_chain(script, place) == (1, 1)
    assert "stopped before the first step" in (folder / "log").read_text()


def test_a_job_that_slurm_starts_again_goes_on(place):
    """After a lost node: the same script and no argument"""
    folder, _ = place
    (folder / "bin" / "sbatch").write_text("#!/bin/sh\n")  # the successor is lost
    assert run_chain("slurm", place) == (0, 1)
    assert run_chain("slurm", place, SLURM_RESTART_COUNT="1") == (0, 1)
    pieces = (folder / "pieces").read_text().splitlines()
    assert ["--restart two_disks.checkpoint.h5" in piece for piece in pieces] == [False, True]
