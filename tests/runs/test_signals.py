"""A run can be asked for a checkpoint (USR1) or for its end with one (USR2, TERM, INT, max_walltime), by a queue or by hand; what goes
on from there has the bits of a run that nobody disturbed.

The scenes have no end to speak of: a test waits for what it needs to see and then stops the run.
"""
import signal
import subprocess
import time

import pytest

import gimp_files
from conftest import MPIRUN, text_of, with_checkpoints

h5py = pytest.importorskip("h5py")

ENDLESS = text_of("two_disks.nml", **{"grid.spacing": 0.025, "time.end": 1.0e3, "output.every": 1.0e2, "output.progress": "on"})
CHECKPOINT = "two_disks.checkpoint.h5"


def start(command, folder, text):
    """A run under way: its process; what it says is in folder/log"""
    (folder / "scene.nml").write_text(text)
    with (folder / "scene.nml").open() as source, (folder / "log").open("w") as log:
        return subprocess.Popen([str(word) for word in command], stdin=source, cwd=folder, stdout=log, stderr=subprocess.STDOUT)


def wait_for(path, run, seconds=60):
    """Until a file is there; the run must be alive meanwhile"""
    limit = time.monotonic() + seconds
    while not path.exists():
        assert run.poll() is None, (path.parent / "log").read_text()
        assert time.monotonic() < limit, f"{path} did not come"
        time.sleep(0.01)


def step_of(checkpoint):
    with h5py.File(checkpoint) as file:
        return int(file.attrs["step"])


@pytest.fixture(params=["alone", "2 ranks"])
def program(request):
    """The command of a run: gimp.x, or gimp_mpi.x on two ranks"""
    return [request.getfixturevalue("gimp_x")] if request.param == "alone" else [*MPIRUN, "-n", 2, request.getfixturevalue("gimp_mpi_x")]


def check_goes_on(run_scene, folder):
    """Some steps more, from the checkpoint (on one rank, whoever wrote it) and without one, end in the same state"""
    step = step_of(folder / CHECKPOINT)
    text = text_of(ENDLESS, step + 10)
    (folder / "whole").mkdir()
    whole = run_scene(text, folder / "whole").succeeded()
    summary = run_scene(text, folder, arguments=("--restart", CHECKPOINT)).succeeded().summary
    assert summary["steps"] == whole.summary["steps"] == step + 10
    assert summary["state_hash"] == whole.summary["state_hash"]
    assert summary["status"] == "max_steps"


def test_a_wish_to_stop(program, run_scene, tmp_path):
    """Of a queue: USR2, sent to the program or to mpirun, which hands it on"""
    run = start(program, tmp_path, ENDLESS)
    wait_for(tmp_path / "two_disks.vtkhdf", run)
    run.send_signal(signal.SIGUSR2)
    assert run.wait(timeout=60) == 75, (tmp_path / "log").read_text()
    said = (tmp_path / "log").read_text()
    summary = gimp_files.summary(tmp_path / "two_disks.vtkhdf")
    assert summary["status"] == "stopped"
    assert summary["steps"] == step_of(tmp_path / CHECKPOINT)
    assert f"stopped by signal USR2; go on with --restart {CHECKPOINT} and the same scene" in said
    assert said.count("checkpoint at step") == said.count("stopped by") == 1, "one rank speaks"
    check_goes_on(run_scene, tmp_path)


@pytest.mark.parametrize("word", ["TERM", "INT"])
def test_other_signals_that_stop(gimp_x, tmp_path, word):
    run = start([gimp_x], tmp_path, ENDLESS)
    wait_for(tmp_path / "two_disks.vtkhdf", run)
    run.send_signal(signal.Signals["SIG" + word])
    assert run.wait(timeout=60) == 75
    assert f"stopped by signal {word}" in (tmp_path / "log").read_text()
    assert step_of(tmp_path / CHECKPOINT) == gimp_files.summary(tmp_path / "two_disks.vtkhdf")["steps"]


def test_a_wish_for_a_checkpoint(program, run_scene, tmp_path):
    """The run goes on after it: the second checkpoint is a later one"""
    run = start(program, tmp_path, ENDLESS)
    wait_for(tmp_path / "two_disks.vtkhdf", run)
    for name in (CHECKPOINT, "two_disks.checkpoint.old.h5"):
        run.send_signal(signal.SIGUSR1)
        wait_for(tmp_path / name, run)
    run.kill()
    run.wait(timeout=60)
    if program[0] == MPIRUN[0]:
        time.sleep(0.5)  # its ranks notice that it is gone
    assert step_of(tmp_path / "two_disks.checkpoint.old.h5") < step_of(tmp_path / CHECKPOINT)
    check_goes_on(run_scene, tmp_path)


def test_the_clock_on_the_wall(run_scene, tmp_path):
    """A run stops in time by itself, and what goes on from it does so too"""
    text = with_checkpoints(ENDLESS, max_walltime=0.015)
    first = run_scene(text, tmp_path)
    assert first.code == 75
    assert "stopped by max_walltime" in first.stdout
    second = run_scene(text, tmp_path, arguments=("--restart", CHECKPOINT))
    assert second.code == 75
    assert second.summary["steps"] > step_of(tmp_path / "two_disks.checkpoint.old.h5") > 0
    check_goes_on(run_scene, tmp_path)


def test_nobody_waits_who_has_nothing_to_lose(gimp_x, tmp_path):
    """A program that waits for its scene ends at once"""
    run = subprocess.Popen([str(gimp_x)], stdin=subprocess.PIPE, cwd=tmp_path)
    time.sleep(0.1)
    run.send_signal(signal.SIGTERM)
    assert run.wait(timeout=20) == -signal.SIGTERM
    run.stdin.close()


def test_a_lost_rank_ends_the_job(gimp_mpi_x, tmp_path):
    """The others wait for it: the job must not"""
    run = start([*MPIRUN, "-n", 2, gimp_mpi_x], tmp_path, ENDLESS)
    wait_for(tmp_path / "two_disks.vtkhdf", run)
    children = subprocess.run(["ps", "-o", "pid=", "--ppid", str(run.pid)], capture_output=True, text=True, check=True).stdout.split()
    assert len(children) == 2
    begin = time.monotonic()
    subprocess.run(["kill", "-9", children[1]], check=True)
    assert run.wait(timeout=60) not in (0, 75)
    assert time.monotonic() - begin < 30
