"""What the program says about itself: help, version, and the input reference, which is written by it."""
import re
import subprocess

import pytest

import gimp_files
from conftest import INPUTS, REPOSITORY

REFERENCE = REPOSITORY / "docs" / "input-reference.md"


def say(gimp_x, *arguments):
    """Exit code, standard output and error output for these arguments and an empty input"""
    done = subprocess.run([str(gimp_x), *arguments], input="", timeout=60, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    return done.returncode, done.stdout, done.stderr


def test_reference_is_what_the_program_says(gimp_x):
    code, text, _ = say(gimp_x, "--reference")
    assert code == 0
    assert REFERENCE.read_text() == text, "docs/input-reference.md is old: gimp.x --reference > docs/input-reference.md"


def test_help_names_every_argument_and_exit_code(gimp_x):
    code, text, _ = say(gimp_x, "--help")
    assert code == 0
    for argument in ("--check", "--restart FILE", "--help [GROUP]", "--version", "--reference"):
        assert f"gimp.x {argument}" in text
    codes = text.split("exit codes\n")[1].split("\n")
    assert [line.split()[0] for line in codes if line.strip()] == ["0", "1", "2", "75"]
    assert max(map(len, text.splitlines())) <= 120


def test_every_group_of_the_reference_has_its_help(gimp_x):
    groups = [line[5:-1] for line in REFERENCE.read_text().splitlines() if line.startswith("## `&")]
    assert len(groups) == 13
    for group in groups:
        code, text, _ = say(gimp_x, "--help", group)
        assert code == 0 and text.startswith(f"&{group} (")


def test_version(gimp_x):
    code, text, _ = say(gimp_x, "--version")
    assert code == 0 and text.startswith("gimp.x 0.")


@pytest.mark.parametrize("arguments", [("--hlep",), ("--help", "bdoy"), ("--check", "scene.nml"), ("--help", "body", "extra")])
def test_arguments_that_are_not_understood(gimp_x, arguments):
    code, text, problem = say(gimp_x, *arguments)
    assert code == 2 and text == "" and problem.startswith("gimp.x: ") and problem.count("\n") == 1


def test_output_format_names_what_a_run_writes(run_scene, tmp_path):
    """Every column, every attribute of the summary and every field stands in docs/output-format.md"""
    text = (REPOSITORY / "docs" / "output-format.md").read_text()
    run = run_scene(INPUTS / "vortex.nml", tmp_path, time__max_steps=2, **{"output.probes": [1.0, 0.0]}).succeeded()
    known = set(re.findall(r"`([a-zA-Z0-9_]+)`", text))
    axes = {"_x", "_y", "_z", "_xx", "_yy", "_zz", "_xy"}  # written as `name_x`, `_y`, ...

    def is_told(name):
        stem = re.sub(r"_[xyz]{1,2}$", "", name)
        return name in known or any(stem + axis in known for axis in axes)

    assert [name for name in run.history if not is_told(name)] == []
    assert [name for name in run.summary if name not in known] == []
    fields = [word for word in say_words(REFERENCE.read_text(), "fields")]
    assert len(fields) == 18 and [name for name in fields if name not in known] == []
    assert gimp_files.scene(run.output, "input") == run.scene


def say_words(reference, key):
    """The words of a key, from its row in the reference"""
    row = next(line for line in reference.splitlines() if line.startswith(f"| `{key}` |"))
    return re.findall(r"`([a-z_]+)`", row.split("Words:")[1])
