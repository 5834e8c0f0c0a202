"""What the tests of whole runs share: the program, and one way to run a scene and look at what it left behind."""
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
INPUTS = REPOSITORY / "inputs"
HARD = sorted((INPUTS / "hard").glob("*.nml"))
REFUSED_INPUTS = [path for path in HARD if "\n! hard: refused" in path.read_text()]
SCENES = sorted(INPUTS.glob("*.nml")) + [path for path in HARD if path not in REFUSED_INPUTS]  # all that run; inputs/benchmark is apart
# more ranks than cores are fine, who waits gives way, and mpirun does not wait for itself after a code other than 0
MPIRUN = ["mpirun", "--allow-run-as-root", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1", "--mca", "odls_base_sigkill_timeout", "0"]
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


@pytest.fixture(scope="session")
def gimp_mpi_x(gimp_x):
    """Path of the program that runs on several ranks: gimp_mpi.x beside gimp.x; a build without it skips the test"""
    path = gimp_x.with_name("gimp_mpi.x")
    if not os.access(path, os.X_OK):
        pytest.skip(f"there is no {path}: the build has GIMP_MPI=OFF")
    if shutil.which(MPIRUN[0]) is None:
        pytest.skip("there is no mpirun")
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


@pytest.fixture
def run_ranks(gimp_x):
    """A function run_ranks(scene, folder, ranks, threads=1, program="gimp_mpi.x", timeout=300, **keys) -> Run: a scene, given as text

    Keys are those of &parallel. The program lies beside gimp.x; a build without it skips the test. A run that hangs fails after `timeout` [s].
    """

    def run(scene, folder, ranks, threads=1, program="gimp_mpi.x", timeout=300, **keys):
        path = gimp_x.with_name(program)
        if not os.access(path, os.X_OK):
            pytest.skip(f"there is no {path}: the build found no library for it")
        if shutil.which(MPIRUN[0]) is None:
            pytest.skip("there is no mpirun")
        return runner(*MPIRUN, "-n", ranks, path, more_environment=RANK_ENVIRONMENT)(on_threads(scene, threads, **keys), folder, timeout=timeout)

    return run


# ranks are not bound to the few cores that others use as well
RANK_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OMPI_MCA_hwloc_base_binding_policy": "none", "PRTE_MCA_hwloc_default_binding_policy": "none"}


def runner(*command, more_environment=None):
    """The function behind run_scene, for a program or a command that starts it on several ranks"""
    # threads that wait give way: where others work too, spinning at each of many short loops costs fifty times the run
    environment = {"OMP_WAIT_POLICY": "passive", **os.environ, **(more_environment or {})}

    def run(scene, folder, arguments=(), timeout=300, **overrides):
        text = gimp_files.read_scene(scene) if isinstance(scene, Path) else scene
        for key, value in overrides.items():
            text = namelist.set_key(text, key.replace("__", "."), value)
        with subprocess.Popen([*map(str, command), *arguments], cwd=folder, text=True, env=environment, stdin=subprocess.PIPE,
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            try:
                stdout, stderr = process.communicate(text, timeout=timeout)
            except subprocess.TimeoutExpired:
                process.terminate()  # mpirun then ends its ranks; killed at once it would leave them behind
                try:
                    process.communicate(timeout=20)
                except subprocess.TimeoutExpired:
                    process.kill()
                pytest.fail(f"{command[-1]} in {folder} was not done after {timeout} s")
        return Run(process.returncode, stdout, stderr, Path(folder), text, Path(folder) / f"{output_name(text)}.vtkhdf")

    return run


def output_name(text):
    """NAME of the scene; "gimp" if it does not say"""
    try:
        names = [g.values().get("name") for g in namelist.groups(text) if g.name == "output"]
    except namelist.NamelistError:  # a scene that is broken on purpose
        names = []
    return names[0][0] if names and names[0] else "gimp"


# ---------------------------------------------------------------------------------------- the same bits


# what may differ: how long it took, on how many threads and ranks, with how much room, what working together cost, who wrote it, and
# the text of a scene that asks for checkpoints
TOGETHER = ("imbalance", "repartition", "migrated_", "pad_", "list_", "reductions", "halo_share", "memory_peak_bytes")
VOLATILE = ("/summary@wall_seconds", "/summary@bytes_per_particle", "/summary@seconds_", "/summary@particle_steps_per_", "/summary@threads",
            "/summary@ranks", "/@lineage", "/scene/", *("/summary@" + name for name in TOGETHER))


def content(path):
    """All datasets and attributes of an output file that follow from the scene"""
    h5py = pytest.importorskip("h5py")
    found = {}

    def note(name, item):
        if isinstance(item, h5py.Dataset):
            found["/" + name] = item[()]
        for key, value in item.attrs.items():
            found[f"/{name}@{key}"] = value

    with h5py.File(path) as file:
        file.visititems(note)
    return {name: value for name, value in found.items() if not name.startswith(VOLATILE)}


def check_same(one, other):
    """Two output files hold the same, bit for bit"""
    one, other = content(one), content(other)
    assert set(one) == set(other)
    assert [name for name in one if not np.array_equal(one[name], other[name])] == []
    assert one["/summary@state_hash"]


def text_of(scene, steps=0, **keys):
    """A scene, given as text or by its path in inputs/, with keys set ("time.end": 1.0) and perhaps an early end"""
    text = scene if "\n" in str(scene) else gimp_files.read_scene(INPUTS / scene)
    if steps:
        keys["time.max_steps"] = steps
    for key, value in keys.items():
        text = namelist.set_key(text, key, value)
    return text


def with_checkpoints(text, **keys):
    """With the keys of &restart"""
    return text + "\n&restart " + " ".join(f"{key} = {namelist.format_value(value)}" for key, value in keys.items()) + " /\n"


def on_threads(text, threads, **keys):
    """With the keys of &parallel"""
    for key, value in {"threads": threads, **keys}.items():
        text = namelist.set_key(text, f"parallel.{key}", value)
    return text


def run_in_parts(run, folder, text, at, total, threads):
    """The second part of a run that stops some steps after its checkpoint at step `at` and goes on from there on another number of threads

    `at` is 8 or more, so that there is no second checkpoint before the stop but the one that every run with checkpoints ends with.
    """
    stop = min(total, at + 7)
    run(on_threads(with_checkpoints(text_of(text, stop), every_steps=at), threads[0]), folder).succeeded()
    name = output_name(text)
    after = f"{name}.checkpoint.old.h5" if at < stop and (folder / f"{name}.checkpoint.old.h5").exists() else f"{name}.checkpoint.h5"
    rest = run(on_threads(text, threads[1]), folder, arguments=("--restart", after)).succeeded()
    assert f"continued from step {at} of {after}" in rest.stdout
    return rest
