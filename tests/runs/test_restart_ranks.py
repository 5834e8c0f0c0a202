"""A run goes on on any other number of ranks and threads, with any way of working together, and leaves what the run leaves that
nobody stopped: the same bits in the state, in every frame and in every row of the history.

One file is a checkpoint of any number of ranks: nothing in it tells how many wrote it, and damage is told once.
"""
import os
import random
import re
import shutil
import subprocess

import numpy as np
import pytest

from conftest import check_same, text_of, with_checkpoints
from made_of_ranks import ENVIRONMENT, Way, any_way
from test_restart import BLOCK, PERIODIC

h5py = pytest.importorskip("h5py")

RESTARTS = int(os.environ.get("GIMP_RESTARTS", "50"))  # of the long test

# bodies that meet, leave, yield and wrap around; entries beyond pads; loads at points; every dimension
CASES = {
    "1d": ("vibrating_bar.nml", {}, 60),
    "2d removal": (BLOCK, {}, 0),
    "2d periodic": (PERIODIC, {"output.every": 0.013, "method.transfer": "apic"}, 60),
    "2d wide": ("falling_disk.nml", {"body.deformation_gradient": [3.6, 0.0, 0.0, 0.8], "body.particles_per_axis": 1}, 60),
    "2d redone steps": ("rigid_translation.nml", {"method.basis": "linear", "method.transfer": "flip", "method.stress_update": "usl",
                                                  "time.redo_unstable_steps": True}, 0),
    "3d": ("block_impact_3d.nml", {}, 25),
}
# further ones of the long test: what each family of methods keeps from step to step
METHODS = {
    "ugimp, usavg, tpic": {"method.basis": "ugimp", "method.stress_update": "usavg", "method.transfer": "tpic"},
    "cpdi, usl": {"method.basis": "cpdi", "method.stress_update": "usl"},
    "cpdi2": {"method.basis": "cpdi2"},
    "gauss_gimp": {"method.basis": "gauss_gimp"},
    "ddmp": {"method.basis": "ddmp"},
    "bspline2": {"method.basis": "bspline2"},
    "bspline3, mls": {"method.basis": "bspline3", "method.spline_boundary": "ghost", "method.transfer": "mls"},
    "generalized alpha": {"method.integrator": "generalized_alpha", "method.stress_update": None},
    "newmark": {"method.integrator": "newmark", "method.stress_update": None},
    "fmpm": {"method.transfer": "fmpm", "method.flip_fraction": None},
    "xpic, every other": {"method.transfer": "xpic", "method.transfer_every": 2, "method.flip_fraction": None},
    "F-bar": {"method.anti_locking": "f_bar"},
    "smoothed stress": {"method.anti_locking": "cell_stress"},
    "filter": {"method.null_space_filter": 3},
    "light nodes": {"method.basis": "linear", "method.stress_update": "usl", "method.redistribute_mass": 0.1},
    "list": {"method.kernel": "list"},
    "always repartitioned": {"parallel.repartition": "always", "method.sort_every": 3},
}
LONG = {**CASES, **{name: ("two_disks.nml", {"grid.spacing": 0.05, **keys}, 50) for name, keys in METHODS.items()}}


def scene_of(case):
    scene, keys, steps = LONG[case]
    return text_of(scene, steps, **{"output.name": "x", "output.history_every": 3, "output.csv": True, **keys})


def go_on_until_done(dice, gimp_x, folder, text, total, parts):
    """A run in so many parts, each in a way of its own, stopped at steps of chance; the last part"""
    stops = sorted(dice.sample(range(1, total), parts - 1)) + [total]
    arguments, ways = [], []
    for stop in stops:
        ways.append(any_way(dice, gimp_x))
        part = ways[-1].run(with_checkpoints(text_of(text, stop), every_steps=dice.choice((7, 1000))), folder, *arguments)
        assert part.code == 0, f"step {stop}, {[str(way) for way in ways]}: {part.stderr}"
        arguments = ["--restart", "x.checkpoint.h5"]
    return part


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.replace(" ", "_"))
def test_same_bits_on_other_ranks(run_scene, gimp_x, gimp_mpi_x, tmp_path, case):
    text = scene_of(case)
    (tmp_path / "whole").mkdir()
    (tmp_path / "parts").mkdir()
    whole = run_scene(text, tmp_path / "whole").succeeded()
    rest = go_on_until_done(random.Random(case), gimp_x, tmp_path / "parts", text, int(whole.summary["steps"]), 3)
    check_same(whole.output, rest.output)
    csv = [tmp_path / part / "x.history.csv" for part in ("whole", "parts")]
    assert csv[0].read_bytes() == csv[1].read_bytes()
    if case == "2d wide":
        assert whole.summary["spilled_values"] > 0
    if case == "2d redone steps":
        assert whole.summary["halvings"] > 0


@pytest.mark.long
@pytest.mark.parametrize("number", range(RESTARTS))
def test_many_random_restarts(run_scene, gimp_x, gimp_mpi_x, tmp_path, number):
    dice = random.Random(1000 + number)
    case = list(LONG)[number % len(LONG)]
    text = scene_of(case)
    (tmp_path / "whole").mkdir()
    (tmp_path / "parts").mkdir()
    whole = run_scene(text, tmp_path / "whole").succeeded()
    rest = go_on_until_done(dice, gimp_x, tmp_path / "parts", text, int(whole.summary["steps"]), 2)
    check_same(whole.output, rest.output)


# ---------------------------------------------------------------------------------------- the file


def content_of(path):
    """Datasets of a checkpoint but for those that hold seconds of the wall clock and names of files"""
    with h5py.File(path) as file:
        found = {}
        file.visititems(lambda name, item: found.__setitem__(name, item[()]) if isinstance(item, h5py.Dataset) else None)
        return {name: value for name, value in found.items() if name not in ("run", "output", "scene")}


def test_the_file_does_not_tell_the_ranks(gimp_x, gimp_mpi_x, tmp_path):
    """Whatever wrote it: particles, blocks and what lies beyond pads stand in it as one rank alone writes them"""
    for case, keys in (("2d removal", {}), ("2d wide", {"method.sort_every": 5})):
        text = with_checkpoints(text_of(scene_of(case), 25, **keys), every_steps=20)
        written = {}
        for way in (Way(gimp_x, 0, 1), Way(gimp_x, 0, 2), Way(gimp_mpi_x, 1, 1), Way(gimp_mpi_x, 3, 1), Way(gimp_mpi_x, 4, 2)):
            folder = tmp_path / case / str(way)
            folder.mkdir(parents=True)
            way.run(text, folder).succeeded()
            written[str(way)] = [content_of(folder / f"x.checkpoint.{end}") for end in ("h5", "old.h5")]
        alone = written.pop(str(Way(gimp_x, 0, 1)))
        assert case != "2d wide" or len(alone[0]["spill/places"]) > 0
        for way, files in written.items():
            for one, other in zip(alone, files):
                assert set(one) == set(other)
                assert [name for name in one if not np.array_equal(one[name], other[name])] == [], way


def test_damage_is_told_once(gimp_x, gimp_mpi_x, tmp_path):
    """By all ranks together, and with the name of the checkpoint that is whole"""
    text = with_checkpoints(text_of(scene_of("2d removal"), 40), every_steps=15)
    Way(gimp_mpi_x, 3, 1).run(text, tmp_path).succeeded()
    path = tmp_path / "x.checkpoint.h5"
    sound = path.read_bytes()
    dice = random.Random(5)
    before = {p.name for p in tmp_path.iterdir()}
    for place in (50, dice.randrange(512, len(sound)), len(sound) - 1):
        spoilt = bytearray(sound)
        spoilt[place] ^= 1 << dice.randrange(8)
        path.write_bytes(spoilt)
        run = Way(gimp_mpi_x, dice.randint(2, 4), 1).run(text, tmp_path, "--restart", path.name)
        assert run.code == 2, run.stderr
        assert len(re.findall("gimp.x: 1 mistake in the scene", run.stderr)) == 1, run.stderr
        assert "; x.checkpoint.old.h5 is whole (step 30)" in run.stderr
    path.write_bytes(sound[:-1])
    run = Way(gimp_mpi_x, 2, 1).run(text, tmp_path, "--restart", path.name)
    assert run.code == 2 and "is damaged: it has" in run.stderr
    assert before == {p.name for p in tmp_path.iterdir()}


def test_a_full_disk_leaves_the_last_checkpoint(gimp_x, gimp_mpi_x, tmp_path):
    """A disk with room for half a checkpoint ends the run in words; the last checkpoint stays, and a run goes on from it elsewhere"""
    unshare = shutil.which("unshare")
    if unshare is None:
        pytest.skip("needs unshare to mount a small file system")
    text = with_checkpoints(text_of("two_disks.nml", 40, **{"output.name": "x", "grid.spacing": 0.025}), every_steps=10)
    script = 'mount -t tmpfs -o size=16m tmpfs disk || exit 99; cp before/* disk/; cd disk; ' \
             'head -c $(( $(df --output=avail -B1 . | tail -1) - $1 )) /dev/zero > ballast; shift; ' \
             '"$@" < ../scene.nml > ../out 2> ../err; echo $? > ../code; rm ballast; cp * ../left/; cd ..; umount disk'
    for way in (Way(gimp_x, 0, 1), Way(gimp_mpi_x, 3, 1)):
        folder = tmp_path / str(way)
        for part in ("before", "disk", "left"):
            (folder / part).mkdir(parents=True)
        way.run(text_of(text, 15), folder / "before").succeeded()
        (folder / "scene.nml").write_text(text)
        kept = (folder / "before" / "x.checkpoint.h5").read_bytes()
        command = [unshare, "-m"] + ([] if os.geteuid() == 0 else ["-r"])
        done = subprocess.run([*command, "sh", "-c", script, "sh", str(len(kept)//2), *way.command("--restart", "x.checkpoint.h5")],
                              cwd=folder, capture_output=True, text=True, timeout=300, env=ENVIRONMENT)
        if not (folder / "code").exists():
            pytest.skip(f"a small file system cannot be mounted here: {done.stderr.strip()}")
        told = (folder / "err").read_text()
        assert (folder / "code").read_text().strip() == "1", told
        assert told.count("gimp.x: the run failed: the checkpoint at step 20 could not be written: x.checkpoint.h5.part: writing") == 1, told
        assert "is the disk full" in told
        assert (folder / "left" / "x.checkpoint.h5").read_bytes() == kept
        assert not list((folder / "left").glob("*.part"))
        rest = way.run(text, folder / "left", "--restart", "x.checkpoint.h5").succeeded()
        assert rest.summary["steps"] == 40
