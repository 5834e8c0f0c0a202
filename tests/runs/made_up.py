"""Outputs that are made up: files of the layout that gimp.x promises, with known particles, and a program that answers as it
would. The tests of the scripts check what is read and drawn against what was put in."""
import os
import subprocess
import sys
from pathlib import Path

import pytest

h5py = pytest.importorskip("h5py")
np = pytest.importorskip("numpy")

REPOSITORY = Path(__file__).resolve().parents[2]
SCRIPTS = REPOSITORY / "postprocessing"
BENCHMARKS = REPOSITORY / "benchmarks"
sys.path[:0] = [str(SCRIPTS), str(BENCHMARKS)]

import namelist  # noqa: E402

SCENE = """! fake scene & with a stray sign / in a comment
&scene title = "made up / not run" dimension = {d} /
&grid lower = {low} upper = {high} spacing = 0.125 /   ! &time in a comment
&material name = "rubber", model = "neo_hookean"
  density = 1000.0   ! kg/m3, not = 5
  young_modulus = 1.0d6, poisson_ratio = 0.3 /
&body
  name = "left"
  material = "rubber"
  shape = "box"
  particles_per_axis = {d}*2
/
&body name = 'right' material = "rubber" shape = "sphere" velocity = {low} /
&method basis = "cpgimp" domain = "stretch" /
&time end = 1.0 /
"""


def fake_scene(d):
    return SCENE.format(d=d, low=", ".join(["0.0"]*d), high=", ".join(["1.0"]*d))


def fake_particles(d, time, n):
    """A block that is sheared and drifts: position, velocity, F, half length, n per axis"""
    axis = (np.arange(n) + 0.5)/n*0.4 + 0.1
    start = np.stack(np.meshgrid(*[axis]*d, indexing="ij"), -1).reshape(-1, d)
    start = np.hstack([start, np.zeros((len(start), 3 - d))])
    gradient = np.eye(3)
    gradient[0, 0] += 0.3*time
    if d > 1:
        gradient[0, 1] = 0.8*time
        gradient[1, 1] -= 0.2*time
    x = start @ gradient.T
    x[:, 0] += 0.2*time
    velocity = np.column_stack([0.2 + 0.8*x[:, 1], 0.1*np.sin(6*x[:, 0]), 0*x[:, 0]])
    square, axes = np.linalg.eigh(gradient.T @ gradient)
    stretch = np.diag(axes @ np.diag(np.sqrt(square)) @ axes.T)
    half = 0.2/n*stretch*(np.arange(3) < d)
    return x, velocity, np.tile(gradient.ravel(), (len(x), 1)), np.tile(half, (len(x), 1)), start


def append(group, name, values):
    values = np.asarray(values)
    if name not in group:
        group.create_dataset(name, data=values, maxshape=(None, *values.shape[1:]), chunks=True)
        return
    data = group[name]
    data.resize(len(data) + len(values), axis=0)
    data[-len(values):] = values


def write_fake(path, d=2, frames=4, n=6, fields=("displacement", "velocity", "stress", "deformation_gradient", "half_length"),
               tail=False, errors=True):
    """An output file of the promised layout; `tail`: the run was killed in the middle of a frame and of a history row"""
    with h5py.File(path, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0], np.int32)
        root.attrs["Type"] = np.bytes_("PolyData")
        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = np.int32(frames)
        data = root.create_group("PointData")
        offset = 0
        for k in range(frames + tail):
            x, velocity, gradient, half, start = fake_particles(d, k/max(1, frames - 1), n)
            keep = slice(0, len(x) - k)  # some particles leave: frames differ in size
            all_fields = {"displacement": x - start, "velocity": velocity, "deformation_gradient": gradient,
                          "half_length": half, "stress": np.tile([3.0, 0, 0, 1.0, 0, 0], (len(x), 1)),
                          "id": np.arange(len(x)), "pressure": np.linspace(-1, 2, len(x))}
            append(root, "Points", x[keep].astype(np.float32))
            for name in fields:
                whole = all_fields[name][keep]
                append(data, name, whole if name == "id" else whole.astype(np.float32))
            if k == frames:
                break  # the tail: points and fields are there, the bookkeeping is not
            count = len(x[keep])
            append(root, "NumberOfPoints", np.array([count], np.int32))
            append(steps, "PointOffsets", np.array([offset], np.int32))
            append(steps, "PartOffsets", np.array([k], np.int32))
            append(steps, "NumberOfParts", np.array([1], np.int32))
            append(steps, "Values", np.array([k/max(1, frames - 1)]))
            offset += count
        write_books(file, tail)
        text = fake_scene(d)
        file["scene/input"] = text
        file["scene/complete"] = text
        if not tail:
            write_summary(file, errors)
    return path


def write_books(file, tail):
    rows = 50
    time = np.linspace(0, 1, rows + 1)
    kinetic = np.cos(3*time)**2
    columns = {"step": np.arange(rows + 1.0), "time": time, "dt": np.full(rows + 1, 0.02), "dt_limit": np.ones(rows + 1),
               "kinetic_energy": kinetic, "stored_energy": 1 - kinetic, "plastic_dissipation": 0.01*time,
               "damping_dissipation": 0*time, "external_work": 0.01*time, "reaction_work": 0*time,
               "energy_residual": 1e-12*np.sin(40*time), "energy_drift": 1e-4*time, "particles": np.full(rows + 1, 36.0)}
    for k, axis in enumerate("xyz"):
        columns[f"momentum_{axis}"] = 0.1*k + 0*time
        columns[f"angular_momentum_{axis}"] = 0.2*k + 0*time
    history = file.create_group("history")
    for name, values in columns.items():
        column = history.create_dataset(name, data=values, maxshape=(None,), chunks=True)
        column.attrs["unit"] = "J" if "energy" in name or "work" in name else "s"
    history.attrs["rows"] = rows if tail else rows + 1  # the tail: one row is in some columns only


def write_summary(file, errors):
    attributes = {"status": "done", "steps": 50, "time": 1.0, "particles": 36, "threads": 1, "wall_seconds": 0.5,
                  "particle_steps_per_core_second": 2.0e6, "bytes_per_particle": 250.0, "energy_residual": 1e-12}
    if errors:
        attributes.update(error_rms=1e-3, error_max=2e-3, error_rms_velocity=3e-3, error_rms_stress=4e-3)
    file.create_group("summary").attrs.update(attributes)


@pytest.fixture
def disk(tmp_path):
    return write_fake(tmp_path / "disk.vtkhdf", frames=4)


def run_script(path, *words, **environment):
    """A script as a user would start it"""
    return subprocess.run([sys.executable, str(path), *map(str, words)], capture_output=True, text=True,
                          env=dict(os.environ, **environment))


def value_of(text, group, key, number=0):
    return [g for g in namelist.groups(text) if g.name == group][number].values().get(key)


def picture(path):
    import matplotlib.pyplot as plt
    return plt.imread(str(path))


def assert_drawn(path, width=400, height=200):
    """The picture has some size and more in it than one colour"""
    pixels = picture(path)
    assert pixels.shape[1] >= width and pixels.shape[0] >= height
    colours = np.unique((pixels[::2, ::2, :3]*255).astype(int).reshape(-1, 3), axis=0)
    assert len(colours) > 30  # a colour map, not only black text on white
    return pixels


FAKE_GIMP = """#!{python}
import sys
sys.path.insert(0, {scripts!r})
import h5py, namelist
text = sys.stdin.read()
groups = {{g.name: g.values() for g in namelist.groups(text)}}
h = groups["grid"]["spacing"][0]
if h < 0.02 and "method" in groups and groups["method"].get("basis") == ["cpgimp"]:
    print("&grid 1: spacing too small", file=sys.stderr)
    sys.exit(2)
steps = groups["time"].get("max_steps", [10])[0]
with h5py.File(groups["output"]["name"][0] + ".vtkhdf", "w") as file:
    told = file.create_group("summary").attrs
    told.update(status="done", steps=steps, particles=512, wall_seconds=0.1/h, particle_steps_per_core_second=4.0e6,
                bytes_per_particle=300.0, error_rms=0.5*h**2, error_max=3*h, error_rms_velocity=h, error_rms_stress=h)
    table = file.create_group("history")
    table.attrs["rows"] = 2
    table["step"] = [0.0, steps]
    table["kinetic_energy"] = [2.0, 2.5]
"""


@pytest.fixture
def fake_gimp(tmp_path, monkeypatch):
    path = tmp_path / "gimp.x"
    path.write_text(FAKE_GIMP.format(python=sys.executable, scripts=str(SCRIPTS)))
    path.chmod(0o755)
    monkeypatch.setenv("GIMP_X", str(path))
    return path


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "scene.nml"
    path.write_text(fake_scene(2))
    return path
