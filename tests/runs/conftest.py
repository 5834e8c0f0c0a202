"""What the tests of whole runs share: the program, and one way to run a scene and look at what it left behind."""
import os
import subprocess
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
INPUTS = REPOSITORY / "inputs"
sys.path.insert(0, str(REPOSITORY / "postprocessing"))

import gimp_files  # noqa: E402
import namelist  # noqa: E402


def pytest_addoption(parser):
    parser.addoption("--long", action="store_true", help="also run the tests that take minutes")


def pytest_configure(config):
    config.addinivalue_line("markers", "long: takes minutes; runs with --long only")


def pytest_collection_modifyitems(config, items):
    if config.getoption("--long"):
        return
    long = [item for item in items if item.get_closest_marker("long")]
    items[:] = [item for item in items if not item.get_closest_marker("long")]
    if long:
        config.hook.pytest_deselected(items=long)


@dataclass
class Run:
    """One run of gimp.x: how it ended, and its output file, read when asked for"""

    code: int  # exit code
    stdout: str
    stderr: str
    folder: Path  # where it ran
    scene: str  # the text it was given
    output: Path  # NAME.vtkhdf; may not exist if the run failed

    @cached_property
    def summary(self):
        """The attributes of /summary as a dict of plain numbers and texts"""
        return gimp_files.summary(self.output)

    @cached_property
    def history(self):
        """Column name -> array over the committed rows of /history"""
        return gimp_files.history(self.output)

    @cached_property
    def times(self):
        """Times of the committed frames [s]"""
        return gimp_files.frame_times(self.output)

    @cached_property
    def last_frame(self):
        """The last frame: name -> array over particles; `points` are the positions, three columns"""
        frame = next(gimp_files.frames(self.output, "last"))
        return {"points": frame.points, **frame.fields}

    def succeeded(self):
        """Itself if the exit code is 0; a test failure with the words of the program otherwise"""
        assert self.code == 0, f"gimp.x ended with code {self.code} in {self.folder}\n{self.stderr}{self.stdout[-2000:]}"
        return self


@pytest.fixture(scope="session")
def gimp_x():
    """Path of the program: the environment variable GIMP_X, else build/bin/gimp.x"""
    path = Path(os.environ.get("GIMP_X") or REPOSITORY / "build" / "bin" / "gimp.x").resolve()
    if not os.access(path, os.X_OK):
        pytest.exit(f"there is no program at {path}: run ./bootstrap.sh build, or name another one in GIMP_X", 2)
    return path


@pytest.fixture(scope="session")
def gimp_sp_x(gimp_x):
    """Path of the program in single precision: gimp_sp.x beside gimp.x; a build without it skips the test"""
    path = gimp_x.with_name("gimp_sp.x")
    if not os.access(path, os.X_OK):
        pytest.skip(f"there is no {path}: the build has GIMP_SINGLE=OFF")
    return path


@pytest.fixture
def run_scene(gimp_x):
    """A function run_scene(scene, folder, arguments=(), timeout=300, **overrides) -> Run

    `scene` is the path of a scene or its text. Overrides set keys, with two underscores for the dot:
    run_scene(INPUTS / "vortex.nml", tmp_path, time__max_steps=5, **{"body[1].velocity": [0.1, 0.0]}); None takes a key away.
    """

    return runner(gimp_x)


@pytest.fixture
def run_single(gimp_sp_x):
    """The same with the program in single precision"""
    return runner(gimp_sp_x)


def runner(program):
    """The function behind run_scene"""

    def run(scene, folder, arguments=(), timeout=300, **overrides):
        text = scene.read_text() if isinstance(scene, Path) else scene
        for key, value in overrides.items():
            text = namelist.set_key(text, key.replace("__", "."), value)
        done = subprocess.run([str(program), *arguments], input=text, cwd=folder, timeout=timeout, text=True,
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        return Run(done.returncode, done.stdout, done.stderr, Path(folder), text, Path(folder) / f"{output_name(text)}.vtkhdf")

    return run


def output_name(text):
    """NAME of the scene; "gimp" if it does not say"""
    try:
        names = [g.values().get("name") for g in namelist.groups(text) if g.name == "output"]
    except namelist.NamelistError:  # a scene that is broken on purpose
        names = []
    return names[0][0] if names and names[0] else "gimp"
