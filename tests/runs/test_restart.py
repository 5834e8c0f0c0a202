"""A run that was stopped and goes on from a checkpoint leaves what the run leaves that nobody stopped: the same bits in the state,
in every frame, every row of the history, and the same counts; on another number of threads, too.

Checkpoints that cannot be trusted are refused. Five runs are killed at random times until they are done; the environment variable
GIMP_KILLS asks for more.
"""
import re
import os
import random
import signal
import subprocess
import time

import numpy as np
import pytest

import gimp_files
from conftest import INPUTS, check_same, on_threads, run_in_parts, text_of, with_checkpoints

h5py = pytest.importorskip("h5py")

KILLS = (int(os.environ.get("GIMP_KILLS", "10")) + 1)//2

BLOCK = """
&scene dimension = 2 /
&grid lower = 0.0, 0.0 upper = 2.0, 1.0 spacing = 0.125 /
&material name = "rubber" model = "neo_hookean" density = 1000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 /
&material name = "metal" model = "hencky_von_mises" density = 2000.0 young_modulus = 1.0e5 poisson_ratio = 0.3 yield_stress = 1.0e3
  hardening = "linear" hardening_modulus = 1.0e3 /
&body name = "block" material = "rubber" shape = "box" lower = 0.25, 0.25 upper = 0.75, 0.75 velocity = 4.0, 0.3 /
&body name = "disk" material = "metal" shape = "sphere" center = 1.25, 0.5 radius = 0.25 velocity = 3.0, 0.0 /
&boundary side = "x_high" condition = "free" leaving = "remove" /
&boundary side = "y_low" condition = "velocity" velocity = 0.0, 0.1 times = 0.0, 0.1 factors = 0.0, 1.0 /
&load kind = "gravity" acceleration = 0.0, -9.81 ramp_time = 0.1 /
&load kind = "point_force" body = "block" point = 0.3, 0.3 force = 100.0, 20.0 /
&load kind = "pressure" body = "disk" face = "all" pressure = 50.0 /
&time end = 0.4 /
&output name = "block" every = 0.05 history_every = 3 csv = .true. probes = 0.3, 0.3, 1.2, 0.5 /
"""
PERIODIC = BLOCK.replace('&boundary side = "x_high" condition = "free" leaving = "remove" /',
                         '&boundary side = "x_low" condition = "periodic" /\n&boundary side = "x_high" condition = "periodic" /')

# beside all inputs, bases, transfers and schemes, which are in test_matrix.py: damping, loads, sides that move, take out or close,
# wide supports with spills, fixed steps, steps redone and held below the critical one, other updates of F
CASES = {
    "1d cayley": ("vibrating_bar.nml", {"method.deformation_update": "cayley", "method.stress_update": "usl"}, 60),
    "2d local damping": ("falling_disk.nml", {"method.damping": "local", "method.damping_factor": 0.3}, 60),
    "2d kinetic damping": ("two_disks.nml", {"method.damping": "kinetic", "method.sort_every": 7}, 60),
    "2d wide": ("falling_disk.nml", {"body.deformation_gradient": [3.6, 0.0, 0.0, 0.8], "body.particles_per_axis": 1}, 60),
    "2d removal": (BLOCK, {}, 0),
    "2d removal usavg": (BLOCK, {"method.stress_update": "usavg", "time.step_rule": "fixed", "time.step": 0.002}, 0),
    "2d redone steps": ("rigid_translation.nml", {"method.basis": "linear", "method.transfer": "flip", "method.stress_update": "usl",
                                                  "time.redo_unstable_steps": True}, 0),
    "2d critical step": ("rigid_translation.nml", {"method.basis": "linear", "method.transfer": "flip", "method.stress_update": "usl",
                                                   "time.stability_check": "lanczos", "time.stability_every": 5,
                                                   "time.stability_limit": 0.9}, 120),
    "2d periodic splines": (PERIODIC.replace('all" pressure', 'x_low" pressure'), {"method.basis": "bspline2", "method.spline_boundary": "ghost"}, 60),
    "2d periodic": (PERIODIC, {"output.every": 0.013}, 0),
}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.replace(" ", "_"))
def test_same_bits_after_a_restart(run_scene, tmp_path, case):
    scene, keys, steps = CASES[case]
    text = text_of(scene, steps, **{"output.name": "x", "output.history_every": 3, "output.csv": True, **keys})
    (tmp_path / "whole").mkdir()
    (tmp_path / "parts").mkdir()
    whole = run_scene(on_threads(text, 1), tmp_path / "whole").succeeded()
    total = int(whole.summary["steps"])
    rest = run_in_parts(run_scene, tmp_path / "parts", text, random.Random(case).randint(8, total - 1), total, (1, 2))
    check_same(whole.output, rest.output)
    csv = [tmp_path / part / "x.history.csv" for part in ("whole", "parts")]
    assert csv[0].read_bytes() == csv[1].read_bytes()
    if case.startswith("2d removal"):
        assert whole.summary["removed_particles"] > 30
    if case == "2d redone steps":
        assert whole.summary["halvings"] > 0
    if case == "2d wide":
        assert whole.summary["spilled_values"] > 0


def test_many_restarts_make_one_run(run_scene, tmp_path):
    """Each part stops anywhere; the next goes on from the end of it, where a checkpoint is written when any are asked for"""
    (tmp_path / "whole").mkdir()
    (tmp_path / "parts").mkdir()
    whole = run_scene(BLOCK, tmp_path / "whole").succeeded()
    stop, arguments = 0, ()
    dice = random.Random(1)
    while stop < whole.summary["steps"]:
        stop += dice.randint(1, 60)
        text = with_checkpoints(text_of(BLOCK, stop), every_steps=1000)
        part = run_scene(on_threads(text, dice.randint(1, 3)), tmp_path / "parts", arguments=arguments).succeeded()
        arguments = ("--restart", "block.checkpoint.h5")
    assert part.summary["status"] == "done"
    check_same(whole.output, part.output)


def test_checkpoints_change_no_bit(run_scene, tmp_path):
    """Whatever asks for them: steps, simulated time, the clock on the wall"""
    text = text_of(BLOCK, 100)
    runs = {}
    for word, keys in {"none": {}, "steps": {"every_steps": 1}, "time": {"every": 0.01}, "clock": {"every_minutes": 1.0e-9}}.items():
        (tmp_path / word).mkdir()
        runs[word] = run_scene(with_checkpoints(text, **keys) if keys else text, tmp_path / word).succeeded()
        check_same(runs["none"].output, runs[word].output)
        assert (tmp_path / word / "block.checkpoint.h5").exists() == (word != "none")
        assert (tmp_path / word / "block.checkpoint.old.h5").exists() == (word != "none")
        assert not list((tmp_path / word).glob("*.part"))
    for word in ("steps", "clock"):
        with h5py.File(tmp_path / word / "block.checkpoint.old.h5") as file:
            assert file.attrs["step"] == 99
    with h5py.File(tmp_path / "time" / "block.checkpoint.old.h5") as file:
        k = int(file.attrs["step"])
    times = dict(zip(*(np.loadtxt(tmp_path / "time" / "block.history.csv", delimiter=",", skiprows=1, usecols=c) for c in (0, 1))))
    assert any(t0 < 0.01*m for t0 in [times[3*(k//3) - 3]] for m in [int(times[3*(k//3) + 3]/0.01)]), "where a multiple was passed"


def test_the_end_may_move(run_scene, tmp_path):
    """A finished run goes on to a later end, with frames at the times it asks for now; so does one with other cadences"""
    text = with_checkpoints(text_of(BLOCK, **{"time.end": 0.12}), every=1.0)
    run_scene(text, tmp_path).succeeded()
    later = text_of(text, **{"time.end": 0.2, "output.every": 0.05, "output.overwrite": True})
    run = run_scene(later, tmp_path, arguments=("--restart", "block.checkpoint.h5")).succeeded()
    assert np.allclose(run.times, [0.0, 0.05, 0.1, 0.12, 0.15, 0.2], rtol=0, atol=1e-12)
    last = text_of(text, **{"time.end": 0.3, "output.every": 0.025, "output.history_every": 1, "restart.every": 0.0,
                            "restart.from": "block.checkpoint.h5"})
    run = run_scene(last, tmp_path).succeeded()
    assert np.allclose(run.times, [0.0, 0.05, 0.1, 0.12, 0.15, 0.2, 0.225, 0.25, 0.275, 0.3], rtol=0, atol=1e-12)
    assert run.summary["status"] == "done"
    assert np.all(np.diff(run.history["step"]) > 0)


# ---------------------------------------------------------------------------------------- killed runs


@pytest.mark.parametrize("number", range(KILLS))
def test_a_killed_run_goes_on(gimp_x, tmp_path, number):
    """Kill, look, go on, until it is done: at all times the output is readable and there is a sound checkpoint"""
    text = with_checkpoints(text_of(BLOCK, **{"output.every": 0.004}), every_steps=3)
    (tmp_path / "scene.nml").write_text(text)
    (tmp_path / "whole").mkdir()
    start = time.monotonic()
    subprocess.run([str(gimp_x)], input=BLOCK.replace("every = 0.05", "every = 0.004"), cwd=tmp_path / "whole", text=True,
                   capture_output=True, check=True, timeout=300)
    seconds = time.monotonic() - start
    dice = random.Random(number)
    path, newest, older = (tmp_path / f"block.{end}" for end in ("vtkhdf", "checkpoint.h5", "checkpoint.old.h5"))
    arguments, kills = [], 0
    for _ in range(200):
        with (tmp_path / "scene.nml").open() as source:
            run = subprocess.Popen([str(gimp_x), *arguments], stdin=source, cwd=tmp_path, stdout=subprocess.DEVNULL,
                                   stderr=subprocess.PIPE, text=True)
        try:
            run.wait(timeout=max(0.05, dice.uniform(0.1, 0.5)*seconds) if kills < 6 else 60)
        except subprocess.TimeoutExpired:
            run.send_signal(signal.SIGKILL)
            kills += 1
        told = run.communicate()[1]
        if run.returncode == 0:
            break
        assert run.returncode == -signal.SIGKILL, told
        if not (newest.exists() or older.exists()):  # killed before the first one: the run starts anew
            path.unlink(missing_ok=True)
            continue
        assert len(gimp_files.frame_times(path)) > 0
        arguments = ["--restart", (newest if newest.exists() else older).name]
        check = subprocess.run([str(gimp_x), "--check", *arguments], input=text, cwd=tmp_path, capture_output=True, text=True)
        assert check.returncode == 0, check.stderr
    assert run.returncode == 0 and kills > 0  # later runs have less left to do and may end before their kill
    check_same(tmp_path / "whole" / "block.vtkhdf", path)


# ---------------------------------------------------------------------------------------- checkpoints that are refused


@pytest.fixture(scope="module")
def stopped(gimp_x, tmp_path_factory):
    """A run with two checkpoints: its folder, and its scene"""
    folder = tmp_path_factory.mktemp("stopped")
    text = with_checkpoints(text_of(BLOCK, 40), every_steps=15)
    subprocess.run([str(gimp_x)], input=text, cwd=folder, text=True, capture_output=True, check=True, timeout=300)
    return folder, text


def refused(gimp_x, folder, text, path, *arguments):
    """What is told when a run must not go on, with --check and without; nothing is changed"""
    before = {p: p.read_bytes() for p in folder.iterdir()}
    told = set()
    for check in ((), ("--check",)):
        run = subprocess.run([str(gimp_x), *check, "--restart", str(path), *arguments], input=text, cwd=folder, text=True,
                             capture_output=True, timeout=60)
        assert run.returncode == 2, run.stdout + run.stderr
        told.add(run.stderr)
    assert before == {p: p.read_bytes() for p in folder.iterdir()}
    assert len(told) == 1
    return told.pop()


@pytest.fixture
def copy(stopped, tmp_path):
    """The same in a folder that may be spoilt"""
    for path in stopped[0].iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path, stopped[1]


def test_damage_is_noticed_anywhere(gimp_x, copy):
    folder, text = copy
    path = folder / "block.checkpoint.h5"
    sound = path.read_bytes()
    dice = random.Random(3)
    for place in [0, 40, 80, 100, 300, 511, 512, 520, len(sound) - 1] + [dice.randrange(len(sound)) for _ in range(20)]:
        spoilt = bytearray(sound)
        spoilt[place] ^= 1 << dice.randrange(8)
        path.write_bytes(spoilt)
        told = refused(gimp_x, folder, text, path.name)
        assert "1 mistake in the scene" in told and "checkpoint.h5" in told
        assert any(w in told for w in ("is damaged", "is not a gimp.x checkpoint", "newer than", "older than")), told
        assert "; block.checkpoint.old.h5 is whole (step 30)" in told
    path.write_bytes(sound[:-1000])
    assert "is damaged: it has" in refused(gimp_x, folder, text, path.name)
    run = subprocess.run([str(gimp_x), "--restart", "block.checkpoint.old.h5"], input=text_of(text, 60), cwd=folder, text=True,
                         capture_output=True, timeout=60)
    assert run.returncode == 0, run.stderr
    with h5py.File(folder / "block.checkpoint.old.h5") as file:
        assert file.attrs["step"] == 45  # the damaged one was not kept in its place
    subprocess.run([str(gimp_x), "--check", "--restart", "block.checkpoint.h5"], input=text, cwd=folder, text=True, check=True,
                   capture_output=True, timeout=60)


def test_foreign_newer_and_older_files(gimp_x, copy):
    folder, text = copy
    (folder / "foreign.h5").write_bytes(b"an HDF5 file this is not")
    assert "foreign.h5: is not a gimp.x checkpoint" in refused(gimp_x, folder, text, "foreign.h5")
    assert "block.vtkhdf: is not a gimp.x checkpoint" in refused(gimp_x, folder, text, "block.vtkhdf")
    told = refused(gimp_x, folder, text, "nothing.checkpoint.h5")
    assert "nothing.checkpoint.h5: no such file" in told and "whole" not in told
    (folder / "block.checkpoint.h5").rename(folder / "moved.h5")
    told = refused(gimp_x, folder, text, "block.checkpoint.h5")  # as a kill between two renames leaves it
    assert "block.checkpoint.h5: no such file; block.checkpoint.old.h5 is whole (step 30)" in told
    sound = (folder / "moved.h5").read_bytes()
    now = int(re.search(rb" version +(\d+) ", sound).group(1))

    def of_version(number):
        return sound.replace(b" version            %d " % now, b" version            %d " % number, 1)

    (folder / "newer.h5").write_bytes(of_version(now + 1))
    assert f"newer.h5: has format version {now + 1}, newer than the {now}" in refused(gimp_x, folder, text, "newer.h5")
    (folder / "older.h5").write_bytes(of_version(now - 1))
    assert f"older.h5: has format version {now - 1}, older than the {now} that this program knows; the gimp.x that wrote it" \
        in refused(gimp_x, folder, text, "older.h5")


def test_another_scene(gimp_x, copy):
    folder, text = copy
    for key, value, words in (("grid.spacing", 0.25, "&grid: spacing was 0.125 ! m, is 0.25 ! m"),
                              ("material[1].young_modulus", 2.0e5, "&material: young_modulus was"),
                              ("body[2].velocity", [3.0, 0.1], "&body 2: velocity was"),
                              ("method.stress_update", "usl", '&method: stress_update was "musl", is "usl"'),
                              ("time.courant", 0.3, "&time: courant was 0.4, is 0.3"),
                              ("output.fields", ["mass"], "&output: fields was"),
                              ("output.csv", False, "&output: csv was")):
        told = refused(gimp_x, folder, text_of(text, **{key: value}), "block.checkpoint.h5")
        assert "is a checkpoint of another scene: " + words in told
    told = refused(gimp_x, folder, text + '&load kind = "gravity" acceleration = 0.0, 1.0 /\n', "block.checkpoint.h5")
    assert "&load 4: kind = \"gravity\" was not there" in told


def test_the_output_must_be_there(gimp_x, copy):
    folder, text = copy
    output = folder / "block.vtkhdf"
    kept = output.read_bytes()
    output.unlink()
    assert "block.vtkhdf is missing; the output of the run must be there" in refused(gimp_x, folder, text, "block.checkpoint.h5")
    output.write_bytes(b"something else")
    assert "block.vtkhdf: is not an HDF5 file" in refused(gimp_x, folder, text, "block.checkpoint.h5")
    other = text_of(text, 30, **{"output.name": "other"})
    subprocess.run([str(gimp_x)], input=other, cwd=folder, text=True, capture_output=True, check=True, timeout=60)
    output.write_bytes((folder / "other.vtkhdf").read_bytes())
    assert "is not the output file that this checkpoint belongs to" in refused(gimp_x, folder, text, "block.checkpoint.h5")
    output.write_bytes(kept)
    (folder / "block.history.csv").unlink()
    assert "block.history.csv is missing or shorter" in refused(gimp_x, folder, text, "block.checkpoint.h5")


def test_what_was_cut_off_does_not_come_back(gimp_x, copy):
    """After a restart from the older checkpoint the newer one no longer fits the output file; the older one still does"""
    folder, text = copy
    newest = (folder / "block.checkpoint.h5").read_bytes()
    for steps in (36, 38):
        run = subprocess.run([str(gimp_x), "--restart", "block.checkpoint.old.h5"], input=text_of(BLOCK, steps), cwd=folder, text=True,
                             capture_output=True, timeout=60)
        assert run.returncode == 0, run.stderr
    assert (folder / "block.checkpoint.h5").read_bytes() == newest  # no checkpoints were asked for
    told = refused(gimp_x, folder, text, "block.checkpoint.h5")
    assert "block.vtkhdf was continued from step 30 since" in told


def test_command_line(gimp_x, copy):
    folder, text = copy
    run = subprocess.run([str(gimp_x), "--restart"], input=text, cwd=folder, text=True, capture_output=True, timeout=60)
    assert run.returncode == 2 and "--restart needs a checkpoint" in run.stderr
    # the command line counts where the scene names one, too
    named = text_of(text, **{"restart.from": "nothing.h5"})
    assert "nothing.h5: no such file" in refused(gimp_x, folder, named, "nothing.h5")
    run = subprocess.run([str(gimp_x), "--restart", "block.checkpoint.h5", "--check"], input=named, cwd=folder, text=True,
                         capture_output=True, timeout=60)
    assert run.returncode == 0 and "continued from step 40 of block.checkpoint.h5" in run.stdout


def test_a_new_run_removes_old_checkpoints(gimp_x, copy):
    """They belong to an output file that is replaced"""
    folder, _ = copy
    again = text_of(BLOCK, 5, **{"output.overwrite": True})
    subprocess.run([str(gimp_x)], input=again, cwd=folder, text=True, capture_output=True, check=True, timeout=60)
    assert not list(folder.glob("*.checkpoint*"))


def test_single_and_double_states_do_not_mix(gimp_x, tmp_path):
    single = gimp_x.with_name("gimp_sp.x")
    if not single.exists():
        pytest.skip("built without gimp_sp.x")
    text = text_of("two_disks.nml", 20, **{"restart.every_steps": 20, "output.name": "mixed"})
    assert subprocess.run([str(single)], input=text, cwd=tmp_path, capture_output=True, text=True).returncode == 0
    again = text_of("two_disks.nml", 40, **{"restart.every_steps": 20, "output.name": "mixed"})
    wrong = subprocess.run([str(gimp_x), "--restart", "mixed.checkpoint.h5"], input=again, cwd=tmp_path, capture_output=True, text=True)
    assert wrong.returncode == 2 and "single precision" in wrong.stderr and "double precision" in wrong.stderr
    right = subprocess.run([str(single), "--restart", "mixed.checkpoint.h5"], input=again, cwd=tmp_path, capture_output=True, text=True)
    assert right.returncode == 0, right.stderr
    whole = text_of("two_disks.nml", 40, **{"restart.every_steps": 20, "output.name": "whole"})
    assert subprocess.run([str(single)], input=whole, cwd=tmp_path, capture_output=True, text=True).returncode == 0
    check_same(tmp_path / "mixed.vtkhdf", tmp_path / "whole.vtkhdf")
