"""What --check tells of a run's cost comes true, and nothing is written for it"""
import re

import pytest

from conftest import text_of, with_checkpoints

UNITS = {"": 1.0, "k": 1.0e3, "M": 1.0e6, "G": 1.0e9}
BYTES = r"([\d.]+) ([kMG]?)B"


def bytes_of(number, unit):
    return float(number)*UNITS[unit]


def check(run_scene, text, folder, arguments=()):
    """The lines that --check prints, by their first word"""
    before = sorted(path.name for path in folder.iterdir())
    run = run_scene(text, folder, arguments=("--check", *arguments)).succeeded()
    assert sorted(path.name for path in folder.iterdir()) == before
    assert run.stdout.endswith("checked: the scene is sound; nothing was written\n")
    return {line.split()[0]: line for line in run.stdout.splitlines()}


@pytest.mark.parametrize("keys", [{"output.every": 0.05}, {"output.precision": "double", "output.probes": [0.2, 0.2, 0.8, 0.8]}],
                         ids=["frames", "history"])
def test_room_on_the_disk(run_scene, tmp_path, keys):
    """Within a fifth: bodies come to touch more blocks, steps are shortened to meet frames, and the file keeps books of its own"""
    text = with_checkpoints(text_of("two_disks.nml", 300, **{"output.history_every": 1, "output.every": 0.0, **keys}), every_steps=100)
    told = check(run_scene, text, tmp_path)
    run = run_scene(text, tmp_path).succeeded()
    frames, frame, frame_unit, history, history_unit, checkpoint, checkpoint_unit, whole, whole_unit = re.search(
        f"([\\d,]+) frames of {BYTES}, history {BYTES}, two checkpoints of {BYTES} where any are written: {BYTES}", told["disk"]).groups()
    output, checkpoints = run.output.stat().st_size, [path.stat().st_size for path in tmp_path.glob("*.checkpoint*")]
    assert int(frames) == pytest.approx(len(run.times), abs=2)
    assert bytes_of(checkpoint, checkpoint_unit) == pytest.approx(min(checkpoints), rel=0.2)
    assert bytes_of(history, history_unit) == pytest.approx(sum(column.nbytes for column in run.history.values()), rel=0.75)
    assert len(run.times)*bytes_of(frame, frame_unit) < output
    assert bytes_of(whole, whole_unit) == pytest.approx(output + sum(checkpoints), rel=0.2)


def test_steps_left(run_scene, tmp_path):
    """Of a run that goes on: half of them"""
    text = with_checkpoints(text_of("two_disks.nml", 50, **{"grid.spacing": 0.05}), every_steps=50)
    told = check(run_scene, text, tmp_path)
    assert ": 50 steps of" in told["duration"] and "(of 50 that were tried)" in told["duration"]
    run_scene(text, tmp_path).succeeded()
    told = check(run_scene, text_of(text, 100), tmp_path, ("--restart", "two_disks.checkpoint.h5"))
    assert ": 50 steps of" in told["duration"]


def test_memory_on_ranks(run_scene, gimp_mpi_x, tmp_path):
    """Told by one process, and measured by four"""
    from conftest import MPIRUN, runner
    text = text_of("two_disks.nml", 5)
    about = re.search(f"about {BYTES} each on 4", check(run_scene, text, tmp_path)["on"]).groups()
    on_ranks = runner(MPIRUN[0])
    told = check(lambda *rest, arguments: on_ranks(*rest, arguments=(*MPIRUN[1:], "-n", "4", str(gimp_mpi_x), *arguments)), text, tmp_path)
    fullest = re.search(f"4 of 1 thread; the fullest holds {BYTES}", told["ranks"]).groups()
    assert bytes_of(*about) == pytest.approx(bytes_of(*fullest), rel=0.5)


def test_a_trial_step_goes_wrong(run_scene, tmp_path):
    """A block flies out of the grid in its second step"""
    text = text_of("two_disks.nml", **{"body[1].velocity": [-200.0, 0.0], "boundary.condition": "free", "time.step_rule": "fixed",
                                       "time.courant": None, "time.step": 0.0005})
    run = run_scene(text, tmp_path, arguments=("--check",))
    assert run.code == 1
    assert re.search(r"^gimp.x: step \d+ of those that were tried went wrong: ", run.stderr, flags=re.MULTILINE), run.stderr + run.stdout
