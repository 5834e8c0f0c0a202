"""A run that is killed or runs out of room leaves every committed frame and every committed row of the history readable.

Ten kills at random times; the environment variable GIMP_KILLS asks for more.
"""
import os
import random
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest

import gimp_files
import namelist
from conftest import INPUTS

h5py = pytest.importorskip("h5py")

KILLS = int(os.environ.get("GIMP_KILLS", "10"))


def scene(every=0.01):
    """Two disks with a frame every few steps, so that a kill often falls into a commit; about a second"""
    text = (INPUTS / "two_disks.nml").read_text()
    for key, value in {"grid.spacing": 0.025, "output.every": every, "output.csv": True}.items():
        text = namelist.set_key(text, key, value)
    return text


@pytest.fixture(scope="module")
def whole(gimp_x, tmp_path_factory):
    """The run that nobody disturbs: seconds it takes, its frames and history"""
    folder = tmp_path_factory.mktemp("whole")
    start = time.monotonic()
    subprocess.run([str(gimp_x)], input=scene(), cwd=folder, text=True, capture_output=True, timeout=300, check=True)
    seconds = time.monotonic() - start
    path = folder / "two_disks.vtkhdf"
    return seconds, list(gimp_files.frames(path, "all")), gimp_files.history(path)


def check_remains(path, whole):
    """What is committed is a beginning of the whole run, bit for bit: `steps`, `frames` that were found"""
    _, frames, history = whole
    with h5py.File(path) as file:
        rows = int(file["history"].attrs["rows"])
        assert {len(column) for column in file["history"].values()} == {rows}
    left = gimp_files.history(path)
    for name, column in left.items():
        assert np.array_equal(column, history[name][:rows]), name
    found = 0
    for frame in gimp_files.frames(path, "all"):
        assert frame.time == frames[found].time
        assert np.array_equal(frame.points, frames[found].points)
        for name, values in frame.fields.items():
            assert np.array_equal(values, frames[found].fields[name]), name
        found += 1
    if found:
        assert left["time"][-1] >= frames[found - 1].time, "a frame without its row"
    return rows, found


@pytest.mark.parametrize("number", range(KILLS))
def test_a_killed_run_leaves_what_it_committed(gimp_x, whole, tmp_path, number):
    after = random.Random(number).uniform(0.0, 1.0)*whole[0]
    text = tmp_path / "scene.nml"
    text.write_text(scene())
    with text.open() as source:
        run = subprocess.Popen([str(gimp_x)], stdin=source, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        time.sleep(after)
        run.send_signal(signal.SIGKILL)
    finally:
        code = run.wait(timeout=60)
    path = tmp_path / "two_disks.vtkhdf"
    if not path.exists():
        return  # killed before the first commit: there is nothing yet, and no half file under that name
    rows, frames = check_remains(path, whole)
    assert rows >= 1
    if code == -signal.SIGKILL:
        assert gimp_files.summary(path).get("status") in ("running", "done")  # done: in the moment after the last commit
    if after > 0.9*whole[0]:
        assert frames > 1


def test_kills_hit_running_programs(gimp_x, whole):
    """The times above are spread over a run that takes long enough to be hit"""
    assert whole[0] > 0.2 and len(whole[1]) > 300


def test_a_killed_run_can_be_replaced(gimp_x, whole, tmp_path):
    """What a killed run leaves behind does not stand in the way of the next one"""
    run = subprocess.Popen([str(gimp_x)], stdin=subprocess.PIPE, cwd=tmp_path, stdout=subprocess.DEVNULL, text=True)
    run.stdin.write(scene())
    run.stdin.close()
    time.sleep(0.3*whole[0])
    run.send_signal(signal.SIGKILL)
    run.wait(timeout=60)
    text = namelist.set_key(namelist.set_key(scene(), "output.overwrite", True), "time.max_steps", 20)
    subprocess.run([str(gimp_x)], input=text, cwd=tmp_path, text=True, capture_output=True, timeout=60, check=True)
    assert gimp_files.summary(tmp_path / "two_disks.vtkhdf")["status"] == "max_steps"
    assert not list(tmp_path.glob("*.part"))


# ---------------------------------------------------------------------------------------- a full disk


def on_small_disk(gimp_x, folder, kilobytes):
    """Run on a file system of that size, in a mount name space of its own, and copy what it left into `folder`/left"""
    unshare = shutil.which("unshare")
    if unshare is None:
        pytest.skip("needs unshare to mount a small file system")
    (folder / "disk").mkdir()
    (folder / "left").mkdir()
    (folder / "scene.nml").write_text(scene())
    script = 'mount -t tmpfs -o "size=$1" tmpfs disk || exit 99; (cd disk && "$2" < ../scene.nml > ../out 2> ../err); ' \
             'echo $? > code; cp disk/* left/; umount disk'
    command = [unshare, "-m"] + ([] if os.geteuid() == 0 else ["-r"])
    done = subprocess.run([*command, "sh", "-c", script, "sh", f"{kilobytes}k", str(gimp_x)], cwd=folder, capture_output=True,
                          text=True, timeout=300)
    if not (folder / "code").exists():
        pytest.skip(f"a small file system cannot be mounted here: {done.stderr.strip()}")
    return int((folder / "code").read_text()), (folder / "err").read_text(), folder / "left"


def test_a_full_disk_ends_the_run_and_keeps_what_was_committed(gimp_x, whole, tmp_path):
    code, told, left = on_small_disk(gimp_x, tmp_path, 8192)
    assert code == 1
    assert "the run failed" in told and "disk full" in told
    rows, frames = check_remains(left / "two_disks.vtkhdf", whole)
    assert rows > 1 and frames > 1
    assert "committed frames are in two_disks.vtkhdf" in told
    # the state needs room too: it is there whole and named, or neither
    assert (left / "two_disks.failed.h5").exists() == ("the failed state is in" in told)
    assert not (left / "two_disks.failed.h5.part").exists()


def test_a_disk_too_small_for_the_first_frame(gimp_x, whole, tmp_path):
    code, told, left = on_small_disk(gimp_x, tmp_path, 100)
    assert code == 1 and "the run failed" in told and "no frame was committed" in told
    assert not (left / "two_disks.vtkhdf").exists() and not (left / "two_disks.vtkhdf.part").exists()
