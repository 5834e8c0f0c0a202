"""What a run leaves behind does not tell on how many ranks it ran: frames, history, summary and the failed state are the same bits."""
import csv
import os
import random
import signal
import subprocess
import time

import numpy as np
import pytest

import gimp_files
from conftest import MPIRUN, check_same, content, runner
from made_of_ranks import processes_of
from test_kills import check_remains, scene, whole  # noqa: F401, a fixture
from test_outputs import FIELDS, block

h5py = pytest.importorskip("h5py")

FIELDS = [name for name in FIELDS if name != "error"] + ["smoothed_stress"]


@pytest.fixture
def run_on(gimp_mpi_x, gimp_x):
    """run_on(ranks): the function that runs a scene on so many ranks; on one by gimp.x"""
    return lambda ranks: runner(gimp_x) if ranks == 1 else runner(*MPIRUN, "-n", ranks, gimp_mpi_x)


def run_twice(run_on, folder, scene, ranks):
    """The same scene on one rank and on several"""
    (folder / "one").mkdir()
    (folder / "several").mkdir()
    return run_on(1)(scene, folder / "one"), run_on(ranks)(scene, folder / "several")


@pytest.mark.parametrize("dimension, ranks", [(2, 3), (3, 2)])
def test_all_fields_and_rows(run_on, tmp_path, dimension, ranks):
    """Particles move from rank to rank, since the block crosses half of the grid; there is a probe, a frame every few steps and a CSV file"""
    text = block(dimension, output__fields=FIELDS, output__every=0.02, output__csv=True,
                  output__probes=[0.3, 0.5, 0.4][:dimension])
    one, several = run_twice(run_on, tmp_path, text, ranks)
    check_same(one.succeeded().output, several.succeeded().output)
    assert len(several.times) > 3 and several.summary["ranks"] == ranks
    texts = [(run.folder / "block.history.csv").read_text() for run in (one, several)]
    assert texts[0] == texts[1] and len(list(csv.reader(texts[0].splitlines()))) == 1 + len(one.history["time"])
    assert not list(several.folder.glob("*.part"))


def test_particles_that_leave(run_on, tmp_path):
    """Gaps in the numbers are closed over all ranks, down to the last particle"""
    text = block(2, time__max_steps=0, time__end=1.2, output__every=0.2).replace(
        "&method", '&boundary side = "all" condition = "free" leaving = "remove" /\n&method')
    one, several = run_twice(run_on, tmp_path, text, 3)
    check_same(one.succeeded().output, several.succeeded().output)
    left = several.history["particles"]
    assert left[0] > left[-1] and len(several.last_frame["points"]) == left[-1]


@pytest.mark.parametrize("particles", [1, 4])
def test_more_ranks_than_particles(run_on, tmp_path, particles):
    text = block(2, body__lower=[0.25, 0.25], body__upper=[0.3125, 0.3125], body__particles_per_axis=round(particles**0.5),
                  output__every=0.05)
    one, several = run_twice(run_on, tmp_path, text, 6)
    check_same(one.succeeded().output, several.succeeded().output)
    assert len(several.last_frame["points"]) == particles


def test_the_failed_state(run_on, tmp_path):
    """A particle turns inside out: all ranks end, and what failed is written whole"""
    text = block(2, time__step_rule="fixed", time__step=1.0e-3, method__deformation_update="cayley",
                  **{"body.velocity_gradient": [-9.0e3, 0.0, 0.0, -8.0e3]})
    one, several = run_twice(run_on, tmp_path, text, 3)
    assert one.code == several.code == 1
    assert [line for line in several.stderr.splitlines() if line in one.stderr.splitlines()] == one.stderr.splitlines()
    one, several = (content(run.folder / "block.failed.h5") for run in (one, several))
    assert set(one) == set(several) and len(one["/id"]) == 121
    assert [name for name in one if not np.array_equal(one[name], several[name])] == []
    assert (np.diff(one["/id"]) > 0).all()


def test_a_killed_rank_leaves_what_was_committed(gimp_mpi_x, whole, tmp_path):
    """The launcher ends the other ranks; frames and rows that are there are a beginning of the whole run"""
    (tmp_path / "scene.nml").write_text(scene())
    with (tmp_path / "scene.nml").open() as source:
        run = subprocess.Popen([*MPIRUN, "-n", "2", str(gimp_mpi_x)], stdin=source, cwd=tmp_path, stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    path = tmp_path / "two_disks.vtkhdf"
    limit = time.monotonic() + 60
    while not path.exists():
        assert run.poll() is None and time.monotonic() < limit
        time.sleep(0.01)
    time.sleep(random.uniform(0.0, 0.5)*whole[0])
    ranks = processes_of(run.pid, "gimp_mpi.x")
    assert ranks or run.poll() is not None
    if ranks:  # else the run was faster
        os.kill(random.choice(ranks), signal.SIGKILL)
    code = run.wait(timeout=60)
    rows, frames = check_remains(path, whole)
    assert rows >= 1 and frames >= 1
    assert code != 0 or not ranks or gimp_files.summary(path)["status"] == "done"
