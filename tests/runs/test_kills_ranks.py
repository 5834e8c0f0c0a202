"""Runs on several ranks that are killed at any moment, one rank, mpirun or all of them, go on from what is there: the newest
checkpoint or the one before is whole, the output can be read, and the end is that of a run that nobody disturbed.

Each part of a run has another number of ranks. The environment variable GIMP_KILLS sets how many kills of each kind the long
test makes.
"""
import os
import random
import signal
import subprocess
import time

import pytest

import gimp_files
from conftest import check_same, text_of, with_checkpoints
from made_of_ranks import Way, processes_of
from test_restart import BLOCK

h5py = pytest.importorskip("h5py")

KINDS = ("rank", "mpirun", "all")
KILLS = int(os.environ.get("GIMP_KILLS", "100"))
EACH = 5  # kills of one run
SCENE = text_of(BLOCK, **{"output.every": 0.004})


@pytest.fixture(scope="module")
def whole(gimp_x, tmp_path_factory):
    """The run that nobody disturbs: its output, and the seconds it takes on ranks"""
    folder = tmp_path_factory.mktemp("whole")
    run = Way(gimp_x, 0, 1).run(SCENE, folder).succeeded()
    beside = tmp_path_factory.mktemp("beside")
    start = time.monotonic()
    Way(gimp_x.with_name("gimp_mpi.x"), 3, 1).run(with_checkpoints(SCENE, every_steps=3), beside).succeeded()
    return run.output, time.monotonic() - start


def kill(dice, kind, run):
    """Kill what the kind says, and see that nothing of the run is left; false if it had ended before"""
    ranks = processes_of(run.pid, "gimp_mpi.x")
    if not ranks or run.poll() is not None:
        return False
    victims = {"rank": [dice.choice(ranks)], "mpirun": [run.pid], "all": [run.pid, *ranks]}[kind]
    for pid in victims:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
    run.wait(timeout=60)
    limit = time.monotonic() + 60
    while any(is_alive(pid) for pid in ranks):
        assert time.monotonic() < limit, f"ranks outlive the kill of {kind}"
        time.sleep(0.02)
    return True


def wait_for_ranks(run):
    """Until they have started, or the run has ended"""
    while run.poll() is None and not processes_of(run.pid, "gimp_mpi.x"):
        time.sleep(0.01)


def wait_for_words(run, log):
    """Until the ranks have found each other and the first has said something: mpirun may wait forever for one that is killed
    while Open MPI starts it, which is no matter of ours"""
    while run.poll() is None and log.stat().st_size == 0:
        time.sleep(0.01)


def is_alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def run_with_kills(gimp_x, whole, folder, kind, dice):
    """Kill, look, go on, until it is done; the number of kills"""
    output, seconds = whole
    text = with_checkpoints(SCENE, every_steps=3)
    path, newest, older = (folder / f"block.{end}" for end in ("vtkhdf", "checkpoint.h5", "checkpoint.old.h5"))
    arguments, kills = [], 0
    for _ in range(100):
        run = Way(gimp_x.with_name("gimp_mpi.x"), dice.randint(2, 4), 1).start(text, folder, *arguments)
        killed = False
        if kills < EACH:
            wait_for_ranks(run)
            if kind == "rank":
                wait_for_words(run, folder / "log")
        try:
            run.wait(timeout=dice.uniform(0.0, 0.4)*seconds if kills < EACH else 300)
        except subprocess.TimeoutExpired:
            killed = kill(dice, kind, run)
            run.wait(timeout=300)
        kills += killed
        if run.returncode == 0:
            break
        assert killed, (folder / "log").read_text()
        if not (newest.exists() or older.exists()):  # killed before the first one: the run starts anew
            path.unlink(missing_ok=True)
            continue
        assert len(gimp_files.frame_times(path)) > 0
        arguments = ["--restart", (newest if newest.exists() else older).name]
        check = Way(gimp_x, 0, 1).run(text, folder, "--check", *arguments)
        assert check.code == 0, check.stderr
    assert run.returncode == 0
    check_same(output, path)
    return kills


@pytest.mark.parametrize("kind", KINDS)
def test_killed_ranks_go_on(gimp_x, gimp_mpi_x, whole, tmp_path, kind):
    assert run_with_kills(gimp_x, whole, tmp_path, kind, random.Random(kind)) > 0


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_many_kills(gimp_x, gimp_mpi_x, whole, tmp_path, kind):
    dice = random.Random("many " + kind)
    kills, runs = 0, 0
    while kills < KILLS:
        (tmp_path / str(runs)).mkdir()
        kills += run_with_kills(gimp_x, whole, tmp_path / str(runs), kind, dice)
        runs += 1
    print(f"{kind}: {kills} kills in {runs} runs")
