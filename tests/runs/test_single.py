"""gimp_sp.x: the same program with particles and grid in single precision."""
import math
import subprocess

import numpy as np
import pytest

from conftest import INPUTS, SCENES

STEPS = 20
FEW_FRAMES = {"output__every": 0.0}
# Sums over nodes of numbers rounded to 6e-8 of the energy present; where many particles are alike they are rounded alike, so
# that each step may add that much
RESIDUAL = 6e-8


def test_version_names_the_precision(gimp_x, gimp_sp_x):
    say = [subprocess.run([str(x), "--version"], capture_output=True, text=True, check=True).stdout for x in (gimp_x, gimp_sp_x)]
    assert "double precision" in say[0] and "single precision" in say[1]
    assert say[0].replace("double", "single") == say[1]


MESHES = [scene for scene in SCENES if "&mesh" in scene.read_text()]
GRIDS = [scene for scene in SCENES if scene not in MESHES]


@pytest.mark.parametrize("scene", MESHES, ids=lambda path: path.stem)
def test_meshes_want_double_precision(scene, run_single, tmp_path):
    run = run_single(scene, tmp_path, **FEW_FRAMES)
    assert run.code == 2 and "meshes are for the program in double precision, gimp.x; this one is in single" in run.stderr


@pytest.mark.parametrize("scene", GRIDS, ids=lambda path: path.stem)
def test_scene_runs_and_is_finite(scene, run_single, tmp_path):
    run = run_single(scene, tmp_path, time__max_steps=STEPS, **FEW_FRAMES).succeeded()
    summary = run.summary
    assert summary["precision"] == "single" and summary["steps"] == STEPS
    bad = [name for name, value in summary.items() if isinstance(value, float) and not math.isfinite(value)]
    assert not bad, f"not finite in /summary: {bad}"
    for name, values in run.last_frame.items():
        assert np.isfinite(values).all(), f"not finite in the last frame: {name}"
    assert abs(summary["energy_residual"]) < STEPS*RESIDUAL


def test_axis_aligned_error_is_that_of_double(run_scene, run_single, tmp_path):
    """At h = 1/32 the error of the method is 1e4 times the round-off of positions: precision must not show"""
    error = {}
    for name, run in {"double": run_scene, "single": run_single}.items():
        folder = tmp_path / name
        folder.mkdir()
        summary = run(INPUTS / "axis_aligned_2d.nml", folder, grid__spacing=1.0/32, **FEW_FRAMES).succeeded().summary
        error[name] = [summary[key] for key in ("error_rms", "error_max", "error_rms_velocity", "error_rms_stress")]
        state = summary["state_bytes_per_particle"]
        error[name + " state"] = state
    assert error["single"] == pytest.approx(error["double"], rel=0.05)
    assert error["single state"] < 0.55*error["double state"]  # numbers of particles stay 8 bytes


@pytest.mark.parametrize("scene", ["two_disks", "block_impact_3d"])
def test_same_bits_on_any_number_of_threads(run_single, tmp_path, scene):
    seen = set()
    for threads in (1, 2, 3):
        folder = tmp_path / str(threads)
        folder.mkdir()
        text = (INPUTS / f"{scene}.nml").read_text() + f"\n&parallel threads = {threads} /\n"
        summary = run_single(text, folder, time__max_steps=100, **FEW_FRAMES).succeeded().summary
        seen.add((summary["state_hash"], summary["energy_residual"], summary["energy_drift"], summary["momentum_residual"]))
    assert len(seen) == 1


FAR = """
&scene  dimension = 2 kinematics = "plane_strain" /
&grid   lower = {low}, {low}  upper = {high}, {high}  spacing = 0.01 /
&material name = "rubber" model = "neo_hookean" density = 1000.0 young_modulus = 1.0e4 poisson_ratio = 0.3 /
&body   name = "bar" material = "rubber" shape = "box" lower = {left}, {left} upper = {right}, {right}
        particles_per_axis = 2 velocity = 0.5, 0.2 angular_velocity = 3.0 /
&boundary side = "all" condition = "slip" /
&time   end = 1.0 max_steps = 200 /
&output name = "far" fields = "displacement", "velocity" precision = "double" /
"""


def test_far_from_the_origin(run_single, tmp_path):
    """A cell is 1e-6 of the coordinates, sixteen times the gap between single precision numbers there. Positions are kept from the
    corner of the block and places in metres are double, so that the bits of the state are the same as near the origin."""
    runs = []
    for origin in (0.0, 1.0e4):
        folder = tmp_path / str(int(origin))
        folder.mkdir()
        scene = FAR.format(low=origin, high=origin + 0.64, left=origin + 0.40, right=origin + 0.56)
        runs.append(run_single(scene, folder).succeeded())
    near, far = runs
    assert near.summary["state_hash"] == far.summary["state_hash"]
    # coordinates of 1e4 m in double precision: 2e-12 m
    assert np.abs(far.last_frame["points"][:, :2] - 1.0e4 - near.last_frame["points"][:, :2]).max() < 1e-11
    assert np.abs(far.last_frame["displacement"] - near.last_frame["displacement"]).max() < 1e-11


def test_clock_is_double(run_single, tmp_path):
    """Time is the sum of the steps to round-off in double precision; a clock in single precision would be off by 1e-7"""
    run = run_single(INPUTS / "two_disks.nml", tmp_path, time__max_steps=100, output__history_every=1, **FEW_FRAMES).succeeded()
    assert len(run.history["dt"]) == 101
    assert run.summary["time"] == pytest.approx(math.fsum(run.history["dt"][1:]), rel=1e-12)
