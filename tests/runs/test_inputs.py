"""Every scene of inputs/ and inputs/hard runs, closes its energy book, and says what it shows."""
import math
import re

import pytest

import namelist
from conftest import HARD, REFUSED_INPUTS, REPOSITORY, SCENES

STEPS = 20  # enough for contact of the grid with every body, a few seconds for all scenes together


def test_there_are_scenes():
    assert len(SCENES) >= 30 and len(HARD) >= 13


def check_run(run):
    """What holds for every run in double precision"""
    summary = run.succeeded().summary
    bad = [name for name, value in summary.items() if isinstance(value, float) and not math.isfinite(value)]
    assert not bad, f"not finite in /summary: {bad}"
    # Both sides of the book are sums over particles of numbers of the size of the energy exchanged: round-off, with room
    assert abs(summary["energy_residual"]) < 1e-12
    for name, column in run.history.items():
        assert all(math.isfinite(value) for value in column), f"not finite in /history: {name}"


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_scene_runs(scene, run_scene, tmp_path):
    run = run_scene(scene, tmp_path, time__max_steps=STEPS)
    check_run(run)
    assert run.summary["steps"] == STEPS
    assert run.summary["particles"] == len(run.last_frame["points"]) > 0


@pytest.mark.parametrize("scene", REFUSED_INPUTS, ids=lambda path: path.stem)
def test_scene_is_refused(scene, run_scene, tmp_path):
    run = run_scene(scene, tmp_path)
    assert run.code == 2 and re.search('^! hard: refused, "(.*)"$', run.scene, re.MULTILINE).group(1) in run.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("scene", SCENES + REFUSED_INPUTS, ids=lambda path: path.stem)
def test_scene_says_what_it_shows(scene):
    lines = scene.read_text().splitlines()
    comment = [line for line in lines[: next(k for k, line in enumerate(lines) if not line.startswith("!"))]]
    assert len(comment) >= 3, "a leading comment of a few lines"
    assert any(line.startswith("! Expect") for line in comment), "a leading comment that says what to expect"


@pytest.mark.parametrize("scene", SCENES + REFUSED_INPUTS, ids=lambda path: path.stem)
def test_scene_writes_a_file_of_its_own_name(scene):
    names = [group.values().get("name") for group in namelist.groups(scene.read_text()) if group.name == "output"]
    assert names == [[scene.stem]]


def test_first_input_of_the_readme_runs(run_scene, tmp_path):
    scene = re.search(r"```fortran\n(.*?)```", (REPOSITORY / "README.md").read_text(), re.DOTALL).group(1)
    check_run(run_scene(scene, tmp_path, time__max_steps=STEPS))
