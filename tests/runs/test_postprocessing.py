"""The scripts of postprocessing/ and benchmarks/ on small made-up outputs; gimp.x is not needed.

`write_fake` writes a file of the layout that gimp.x promises, with known particles, so that what the scripts read and draw
can be checked against what was put in.
"""
import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

h5py = pytest.importorskip("h5py")
np = pytest.importorskip("numpy")
pytest.importorskip("matplotlib")

REPOSITORY = Path(__file__).resolve().parents[2]
SCRIPTS = REPOSITORY / "postprocessing"
BENCHMARKS = REPOSITORY / "benchmarks"
sys.path[:0] = [str(SCRIPTS), str(BENCHMARKS)]

import change_scene  # noqa: E402
import convergence  # noqa: E402
import gimp_files as gf  # noqa: E402
import namelist  # noqa: E402
import particle_pictures as pictures  # noqa: E402
import plot_history  # noqa: E402
import render  # noqa: E402
import run as benchmark  # noqa: E402
import xdmf  # noqa: E402

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


# ------------------------------------------------------------------------------------------- made-up output


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


# ------------------------------------------------------------------------------------------- reading


def test_frames_come_back_as_they_were_put_in(disk):
    read = list(gf.frames(disk))
    assert [f.index for f in read] == [0, 1, 2, 3]
    for k, frame in enumerate(read):
        x, velocity, gradient, _, _ = fake_particles(2, k/3, 6)
        assert frame.time == pytest.approx(k/3, abs=1e-15)  # times are stored in double precision
        assert len(frame) == 36 - k
        # single precision of numbers of order one
        np.testing.assert_allclose(frame.points, x[:36 - k], atol=2e-7)
        np.testing.assert_allclose(frame.fields["velocity"], velocity[:36 - k], atol=2e-7)
        np.testing.assert_allclose(frame.fields["deformation_gradient"], gradient[:36 - k], atol=2e-7)


def test_half_written_tail_is_ignored(tmp_path):
    path = write_fake(tmp_path / "killed.vtkhdf", frames=3, tail=True)
    assert [len(f) for f in gf.frames(path)] == [36, 35, 34]
    table = gf.history(path)
    assert {len(column) for column in table.values()} == {50}
    with pytest.raises(gf.GimpError, match="did not reach its end"):
        gf.summary(path)


def test_only_chosen_frames_and_fields_are_read(disk):
    (frame,) = gf.frames(disk, "-2", names=("velocity",))
    assert frame.index == 2 and set(frame.fields) == {"velocity"}
    with pytest.raises(gf.GimpError, match="no field 'pressure'.*displacement"):
        frame.get("pressure")


@pytest.mark.parametrize("words, expected", [("last", [4]), ("all", [0, 1, 2, 3, 4]), ("0,-1", [0, 4]), ("first,1:4:2", [0, 1, 3]),
                                             ("::2", [0, 2, 4])])
def test_frame_words(words, expected):
    assert gf.select_frames(words, 5) == expected


@pytest.mark.parametrize("words, message", [("7", "frames 0 to 4"), ("x", "not a number"), ("1:x", "not a number")])
def test_wrong_frame_words(words, message):
    with pytest.raises(gf.GimpError, match=message):
        gf.select_frames(words, 5)


def test_no_frame_yet():
    with pytest.raises(gf.GimpError, match="no complete frame"):
        gf.select_frames("last", 0)


def test_summary_scene_and_units_are_plain_python(disk):
    told = gf.summary(disk)
    assert told["status"] == "done" and told["steps"] == 50 and told["error_rms"] == 1e-3
    json.dumps(told)
    assert gf.scene(disk, "input") == fake_scene(2)
    assert gf.history_units(disk)["kinetic_energy"] == "J"
    with pytest.raises(gf.GimpError, match="no /scene/other"):
        gf.scene(disk, "other")


def test_setting_comes_from_the_scene_or_from_the_points(disk):
    known = gf.setting(disk)
    assert (known.dimension, known.title, known.lower, known.upper) == (2, "made up / not run", (0.0, 0.0), (1.0, 1.0))
    assert known.domain == "stretch"
    with h5py.File(disk, "a") as file:
        del file["scene"]
    assert gf.setting(disk).dimension == 2


@pytest.mark.parametrize("content, message", [(None, "no such file"), (b"not HDF5", "not HDF5")])
def test_files_that_cannot_be_read(tmp_path, content, message):
    path = tmp_path / "x.vtkhdf"
    if content:
        path.write_bytes(content)
    with pytest.raises(gf.GimpError, match=message):
        list(gf.frames(path))


def test_other_hdf5_file_is_refused(tmp_path):
    h5py.File(tmp_path / "other.h5", "w").close()
    with pytest.raises(gf.GimpError, match="not an output file of gimp.x"):
        gf.history(tmp_path / "other.h5")


# ------------------------------------------------------------------------------------------- scenes


def value_of(text, group, key, number=0):
    return [g for g in namelist.groups(text) if g.name == group][number].values().get(key)


def test_groups_and_values():
    text = fake_scene(2)
    assert [g.name for g in namelist.groups(text)] == ["scene", "grid", "material", "body", "body", "method", "time"]
    assert value_of(text, "scene", "title") == ["made up / not run"]
    assert value_of(text, "material", "density") == [1000.0]
    assert value_of(text, "material", "young_modulus") == [1.0e6]  # Fortran's d exponent
    assert value_of(text, "body", "particles_per_axis") == [2, 2]  # a repeat
    assert value_of(text, "body", "name", 1) == ["right"]


@pytest.mark.parametrize("path, value, group, number, expected", [
    ("method.basis", "linear", "method", 0, ["linear"]),
    ("grid.spacing", 0.0625, "grid", 0, [0.0625]),
    ("GRID.Spacing", "0.0625", "grid", 0, [0.0625]),
    ("body[2].velocity", [0.5, -1.0], "body", 1, [0.5, -1.0]),
    ("body[right].velocity", "0.5, -1.0", "body", 1, [0.5, -1.0]),
    ("material.density", 7, "material", 0, [7]),
    ("time.step_rule", "fixed", "time", 0, ["fixed"]),
    ("method.half_step_start", False, "method", 0, [False]),
    ("output.fields", "velocity,stress", "output", 0, ["velocity", "stress"]),
    ("scene.title", "a / b ! c", "scene", 0, ["a / b ! c"]),
    ("scene.title", 'a "b" it\'s', "scene", 0, ['a "b" it\'s']),
])
def test_setting_a_key(path, value, group, number, expected):
    before = fake_scene(2)
    after = namelist.set_key(before, path, value)
    assert value_of(after, group, path.split(".")[1].lower(), number) == expected
    kept = {(g.name, k): tuple(v) for g in namelist.groups(before) for k, v in g.values().items()}
    left = {(g.name, k): tuple(v) for g in namelist.groups(after) for k, v in g.values().items()}
    changed = {key for key in kept if kept[key] != left.get(key)}
    assert changed <= {(group, path.split(".")[1].lower())}  # nothing else moved
    for comment in ("! fake scene & with a stray sign / in a comment", "! kg/m3, not = 5", "! &time in a comment"):
        assert comment in after


def test_setting_a_key_of_all_bodies():
    text = namelist.set_key(fake_scene(2), "body[*].particles_per_axis", 3)
    assert value_of(text, "body", "particles_per_axis", 0) == value_of(text, "body", "particles_per_axis", 1) == [3]


@pytest.mark.parametrize("path", ["grid.upper", "body[1].shape", "material.model", "time.end"])
def test_taking_a_key_away(path):
    text = namelist.set_key(fake_scene(2), path, None)
    group, key = path.replace("[1]", "").split(".")
    assert value_of(text, group, key) is None
    assert [g.name for g in namelist.groups(text)] == [g.name for g in namelist.groups(fake_scene(2))]
    assert sum(len(g.keys) for g in namelist.groups(text)) == sum(len(g.keys) for g in namelist.groups(fake_scene(2))) - 1


@pytest.mark.parametrize("path, message", [("body.name", "has 2 groups &body"), ("body[3].name", "has 2 groups"),
                                           ("body[top].name", 'no &body has name = "top"'), ("spacing", "not of the form")])
def test_paths_that_name_nothing(path, message):
    with pytest.raises(namelist.NamelistError, match=message):
        namelist.set_key(fake_scene(2), path, 1)


def test_settings_of_a_command_line():
    text = namelist.apply_settings(fake_scene(2), ["time.end=2.5", "method.domain=", "time.courant=0.1"])
    assert value_of(text, "time", "end") == [2.5] and value_of(text, "time", "courant") == [0.1]
    assert value_of(text, "method", "domain") is None
    with pytest.raises(namelist.NamelistError, match="group.key=value"):
        namelist.apply_settings(text, ["time.end"])


def test_unclosed_group_is_named():
    with pytest.raises(namelist.NamelistError, match="line 2"):
        namelist.groups("! one\n&grid lower = 1.0 ! /\n")


# ------------------------------------------------------------------------------------------- pictures


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


@pytest.mark.parametrize("d", [1, 2, 3])
def test_strip_of_frames(tmp_path, d):
    path = write_fake(tmp_path / "x.vtkhdf", d=d, n=(20, 8, 4)[d - 1])
    target = tmp_path / "strip.png"
    render.main([str(path), "--frames", "0,1,last", "--output", str(target), "--plain", "--dpi", "80"])
    assert_drawn(target)


def test_strip_is_wider_than_one_frame(disk, tmp_path):
    for name, which in (("one.png", "0"), ("three.png", "0,1,2")):
        render.main([str(disk), "--frames", which, "--output", str(tmp_path / name), "--dpi", "60"])
    one, three = picture(tmp_path / "one.png"), picture(tmp_path / "three.png")
    assert three.shape[1] > 1.3*one.shape[1]


@pytest.mark.parametrize("words", [["--component", "x", "--box"], ["--field", "stress", "--component", "xy", "--shape", "ellipse"],
                                   ["--field", "deformation_gradient"], ["--limits", "0", "1", "--colormap", "magma", "--title", ""]])
def test_options_of_render(disk, tmp_path, words):
    render.main([str(disk), *words, "--output", str(tmp_path / "p.png"), "--dpi", "60"])
    assert picture(tmp_path / "p.png").std() > 0.01


def test_solid_picture(tmp_path):
    pytest.importorskip("pyvista")
    path = write_fake(tmp_path / "x.vtkhdf", d=3, n=4)
    render.main([str(path), "--frames", "0,last", "--output", str(tmp_path / "s.png"), "--dpi", "60"])
    assert_drawn(tmp_path / "s.png")


@pytest.mark.parametrize("d", [1, 2])
def test_film(tmp_path, d):
    image = pytest.importorskip("PIL.Image")
    path = write_fake(tmp_path / "x.vtkhdf", d=d, frames=3)
    render.main([str(path), "--animate", str(tmp_path / "x.gif"), "--dpi", "40"])
    with image.open(tmp_path / "x.gif") as film:
        assert film.n_frames == 3


def test_particles_tile_the_deformed_block(tmp_path):
    """Outlines of neighbours share corners, and their areas add up to that of the block times det F"""
    path = write_fake(tmp_path / "x.vtkhdf", frames=3, n=6)
    setting = gf.setting(path)
    first, *_, last = gf.frames(path)
    corners = pictures.outlines(last, first, setting)
    x, y = corners[..., 0], corners[..., 1]
    area = 0.5*np.abs((x*np.roll(y, -1, 1) - y*np.roll(x, -1, 1)).sum(1))
    gradient = last.fields["deformation_gradient"][0].reshape(3, 3)
    expected = (0.4/6)**2*np.linalg.det(gradient)
    np.testing.assert_allclose(area, expected, rtol=1e-5)  # single precision
    # second particle of the fill lies above the first: its lower corners are the upper ones of the first
    np.testing.assert_allclose(corners[1, [0, 1]], corners[0, [3, 2]], atol=1e-6)


def test_steady_half_lengths_are_not_taken_back(tmp_path):
    """uGIMP never moves its half lengths: what is written is the reference, whatever F is"""
    path = write_fake(tmp_path / "x.vtkhdf", n=6)
    with h5py.File(path, "a") as file:
        file["VTKHDF/PointData/half_length"][:, :2] = 0.2/6
        text = fake_scene(2).replace("cpgimp", "ugimp")
        del file["scene/complete"]
        file["scene/complete"] = text
    first, *_, last = gf.frames(path)
    np.testing.assert_allclose(pictures.half_edges(last, first, gf.setting(path))[:, :2], 0.2/6, rtol=1e-6)


def test_ellipse_has_the_area_of_the_box(disk):
    setting = gf.setting(disk)
    first = next(gf.frames(disk))
    points = pictures.outlines(first, first, setting, "ellipse")[0]
    x, y = points.T
    area = 0.5*abs((x*np.roll(y, -1) - y*np.roll(x, -1)).sum())
    assert area == pytest.approx((0.4/6)**2, rel=0.02)  # polygon of 20 corners: 1.6 % less


def test_size_without_half_length_is_the_spacing_of_the_particles(tmp_path):
    path = write_fake(tmp_path / "x.vtkhdf", fields=("velocity",))
    first = next(gf.frames(path))
    half = pictures.half_edges(first, first, gf.setting(path))
    np.testing.assert_allclose(half, 0.5*0.4/6, rtol=1e-5)


def test_scalars(disk):
    frame = next(gf.frames(disk))
    scalar, label, _ = pictures.scalar_of(frame, "stress")  # xx = 3, xy = 1: sqrt(9 + 3)
    np.testing.assert_allclose(scalar, np.sqrt(12.0), rtol=1e-6)
    assert label == "stress von mises [Pa]"
    assert pictures.scalar_of(frame, "stress", "xy")[0][0] == 1.0
    assert pictures.scalar_of(frame, "stress", "mean")[0][0] == 1.0
    speed = np.linalg.norm(frame.fields["velocity"], axis=1)
    np.testing.assert_allclose(pictures.scalar_of(frame, "velocity")[0], speed, rtol=1e-6)
    np.testing.assert_allclose(pictures.scalar_of(frame, "deformation_gradient", "xy")[0], frame.fields["deformation_gradient"][:, 1])
    with pytest.raises(gf.GimpError, match="x y z magnitude"):
        pictures.scalar_of(frame, "velocity", "xx")


def test_colour_range():
    assert pictures.colour_range([np.array([-1.0, 3.0])], signed=True) == (-3.0, 3.0)
    assert pictures.colour_range([np.array([-1.0, np.nan]), np.array([3.0])], signed=False) == (-1.0, 3.0)
    low, high = pictures.colour_range([np.full(3, 5.0)], signed=False)
    assert low < 5.0 < high
    with pytest.raises(gf.GimpError, match="no finite"):
        pictures.colour_range([np.array([np.nan])], signed=False)


@pytest.mark.parametrize("words", [[], ["--momentum"], ["--columns", "dt,particles"]])
def test_history_plot(disk, tmp_path, words):
    plot_history.main([str(disk), *words, "--output", str(tmp_path / "h.png"), "--dpi", "70"])
    assert_drawn(tmp_path / "h.png")


def test_energy_curves_add_up(disk):
    table = gf.history(disk)
    curves = plot_history.energy_curves(table)
    np.testing.assert_allclose(curves["total"], 1 + 0.01*table["time"], atol=1e-14)
    assert "reaction_work" not in curves  # zero throughout: not drawn


def test_losses_of_the_method_are_no_energy(disk):
    """They are curves of their own: the total is that of energy_drift, which they explain"""
    table = dict(gf.history(disk))
    plain = plot_history.energy_curves(table)["total"]
    table["transfer_loss_p2g"] = 0.3*table["time"]
    table["stress_update_error"] = -0.2*table["time"]
    curves = plot_history.energy_curves(table)
    np.testing.assert_array_equal(curves["total"], plain)
    np.testing.assert_allclose(curves["transfer_loss"], 0.3*table["time"] + table.get("transfer_loss_g2p", 0), atol=1e-15)
    assert "stress_update_error" in curves


def test_a_flywheel_does_not_hide_the_rest():
    time = np.linspace(0, 1, 5)
    table = {"time": time, "kinetic_energy": 1000 - time, "stored_energy": time}
    assert plot_history.is_flywheel(plot_history.energy_curves(table))
    table["stored_energy"] = 100*time
    assert not plot_history.is_flywheel(plot_history.energy_curves(table))


def test_history_list_tells_extremes(disk, capsys):
    plot_history.main([str(disk), "--list"])
    lines = capsys.readouterr().out.splitlines()
    table = gf.history(disk)
    words = next(line for line in lines if line.startswith("dt ")).split()
    assert lines[0].split()[:3] == ["column", "unit", "first"] and len(lines) == 1 + len(table)
    assert [float(words[k]) for k in (2, 3, 5, 7)] == pytest.approx(
        [table["dt"][0], table["dt"].min(), table["dt"].max(), table["dt"][-1]], rel=1e-5)


def test_change_scene_prints_the_changed_scene(tmp_path, capsys):
    scene = tmp_path / "s.nml"
    scene.write_text('! a comment\n&grid\n  spacing = 0.1\n/\n&time\n  end = 1.0\n  courant = 0.3\n/\n')
    change_scene.main([str(scene), "grid.spacing=0.05", "time.courant=", "method.basis=linear"])
    text = capsys.readouterr().out
    values = {group.name: group.values() for group in namelist.groups(text)}
    assert text.startswith("! a comment\n")
    assert values == {"grid": {"spacing": [0.05]}, "time": {"end": [1.0]}, "method": {"basis": ["linear"]}}


def test_values_beyond_the_colour_bar_get_an_arrow():
    values = [np.array([0.0, 1.0]), np.array([0.5, 2.0])]
    assert [pictures.beyond(values, *limits) for limits in ((0, 2), (0, 1), (0.5, 2), (0.5, 1))] == ["neither", "max", "min", "both"]


# ------------------------------------------------------------------------------------------- sidecar


@pytest.mark.parametrize("tail", [False, True])
def test_every_reference_of_the_sidecar_exists(tmp_path, tail):
    path = write_fake(tmp_path / "x.vtkhdf", frames=3, tail=tail)
    xdmf.main([str(path)])
    root = ElementTree.parse(f"{path}.xdmf").getroot()
    series = root.find("Domain/Grid")
    assert series.get("CollectionType") == "Temporal"
    grids = series.findall("Grid")
    read = list(gf.frames(path))
    assert [float(g.find("Time").get("Value")) for g in grids] == [f.time for f in read]
    checked = 0
    with h5py.File(path) as file:
        for grid, frame in zip(grids, read):
            assert int(grid.find("Topology").get("NumberOfElements")) == len(frame)
            for holder in [grid.find("Geometry"), *grid.findall("Attribute")]:
                outer = holder.find("DataItem")
                slab, source = outer.findall("DataItem")
                name, dataset = source.text.split(":")
                assert name == path.name
                data = file[dataset]
                assert tuple(map(int, source.get("Dimensions").split())) == data.shape
                assert int(source.get("Precision")) == data.dtype.itemsize
                start, stride, count = np.array(slab.text.split(), int).reshape(3, -1)
                assert tuple(map(int, slab.get("Dimensions").split())) == (3, data.ndim)
                assert list(map(int, outer.get("Dimensions").split())) == list(count)
                assert (stride == 1).all() and (start + count <= data.shape).all()
                wanted = frame.points if holder.tag == "Geometry" else frame.fields[holder.get("Name")]
                chosen = data[tuple(slice(a, a + n) for a, n in zip(start, count))]
                np.testing.assert_array_equal(chosen.astype(float), np.asarray(wanted, float))
                checked += 1
    assert checked == 3*6  # three frames of points and five fields


# ------------------------------------------------------------------------------------------- runs

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


def test_convergence_table_rates_and_json(fake_gimp, scene_file, tmp_path, capsys):
    code = convergence.main([str(scene_file), "--cells", "8,16,32", "--json", "-", "--plot", str(tmp_path / "c.png")])
    told = capsys.readouterr()
    rows = [json.loads(line) for line in told.out.splitlines()]
    assert code == 0
    assert [row["cells"] for row in rows] == [8, 16, 32]
    assert [row["h"] for row in rows] == [1/8, 1/16, 1/32]
    assert rows[2]["error_rms"] == pytest.approx(0.5/32**2) and rows[2]["wall_seconds"] == pytest.approx(3.2)
    assert set(rows[0]) >= {"error_max", "error_rms_velocity", "error_rms_stress", "particle_steps_per_core_second"}
    assert convergence.rate(rows[0], rows[1]) == pytest.approx(2.0)
    lines = told.err.splitlines()
    assert len(lines) == 4 and "2.00" in lines[2] and "1.00" in lines[3]
    assert_drawn(tmp_path / "c.png")


def test_convergence_goes_on_after_a_failed_grid(fake_gimp, scene_file, tmp_path, capsys):
    code = convergence.main([str(scene_file), "--cells", "8,64,16", "--json", "-", "--keep", str(tmp_path / "kept"),
                             "--plot", str(tmp_path / "c.png")])
    told = capsys.readouterr()
    rows = [json.loads(line) for line in told.out.splitlines()]
    assert code == 1
    assert rows[1]["error_rms"] is None and "spacing too small" in rows[1]["problem"]
    assert rows[2]["error_rms"] == pytest.approx(0.5/16**2)
    assert "nan" in told.err and "spacing too small" in told.err
    assert (tmp_path / "kept" / "cells_64.log").exists() and (tmp_path / "kept" / "cells_8.nml").exists()


def test_convergence_changes_the_scene(fake_gimp, scene_file, tmp_path):
    code = convergence.main([str(scene_file), "--cells", "64", "--set", "method.basis=linear", "--set", "body[2].velocity=1.0,2.0",
                             "--keep", str(tmp_path), "--json", str(tmp_path / "c.jsonl")])
    assert code == 0  # the fake refuses this grid only with cpgimp
    text = (tmp_path / "cells_64.nml").read_text()
    assert value_of(text, "method", "basis") == ["linear"] and value_of(text, "body", "velocity", 1) == [1.0, 2.0]
    assert len((tmp_path / "c.jsonl").read_text().splitlines()) == 1


def test_particle_files_are_found_from_another_folder(tmp_path):
    (tmp_path / "scene.nml").write_text('&body name = "a" /\n&body name = "b" shape = "file" file = "points.h5" /\n')
    (tmp_path / "points.h5").write_text("")
    assert value_of(gf.read_scene(tmp_path / "scene.nml"), "body", "file", 1) == [str(tmp_path / "points.h5")]


def test_gimp_is_looked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("GIMP_X", str(tmp_path / "nowhere"))
    with pytest.raises(gf.GimpError, match="is not a program"):
        gf.find_gimp()
    monkeypatch.delenv("GIMP_X")
    monkeypatch.setattr(gf, "REPOSITORY", tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(gf.GimpError, match="gimp.x not found"):
        gf.find_gimp()
    built = tmp_path / "build" / "bin" / "gimp.x"
    built.parent.mkdir(parents=True)
    built.write_text("#!/bin/sh\n")
    built.chmod(0o755)
    assert gf.find_gimp() == str(built)


# ------------------------------------------------------------------------------------------- benchmark

FLAGS_OF_RULE = "-std=f2018 -ffree-line-length-none -fopenmp-simd -Wall -O3 -fno-math-errno -march=x86-64-v3 -Jmodules/transfer -fpreprocessed"
FAKE_COMPILER = """#!/bin/sh
# "compiles" to a script that answers as the reference does
echo "$*" > {folder}/compiled
while [ $# -gt 0 ]; do [ "$1" = -o ] && out=$2; shift; done
cat > "$out" <<'END'
#!/bin/sh
echo '{{"what":"mpm3d","threads":1,"particles":512,"mean_mpps":       5.000,"energy": 2.5000001E+00}}'
END
chmod +x "$out"
"""


@pytest.fixture
def fake_build(tmp_path):
    folder = tmp_path / "build"
    folder.mkdir()
    compiler = tmp_path / "fortran"
    compiler.write_text(FAKE_COMPILER.format(folder=tmp_path))
    compiler.chmod(0o755)
    (folder / "CMakeCache.txt").write_text(f"CMAKE_BUILD_TYPE:STRING=Release\nCMAKE_Fortran_COMPILER:FILEPATH={compiler}\n"
                                           "CMAKE_Fortran_FLAGS:STRING=-O1\nCMAKE_Fortran_FLAGS_RELEASE:STRING=-O2 -DNDEBUG\n")
    (folder / "build.ninja").write_text("build src/core/a.f90.o: Fortran_COMPILER__gimp_core_Release src/core/a.f90\n  FLAGS = -O0\n\n"
                                        "build src/transfer/k.f90.o: Fortran_COMPILER__gimp_transfer_Release src/transfer/k.f90\n"
                                        f"  DEP_FILE = x\n  FLAGS = {FLAGS_OF_RULE}\n")
    return folder


def test_flags_of_the_product(fake_build):
    assert benchmark.product_build(fake_build)["flags"] == "-O3 -fno-math-errno -march=x86-64-v3"
    (fake_build / "build.ninja").unlink()
    assert benchmark.product_build(fake_build)["flags"] == "-O1 -O2"
    with pytest.raises(gf.GimpError, match="no build folder"):
        benchmark.product_build(fake_build / "nowhere")


def test_narrow_vectors_need_the_split_reference():
    assert benchmark.needs_split("-O3 -march=x86-64-v3") and not benchmark.needs_split("-O3 -march=x86-64-v4")


def test_cube_scene_is_the_block_of_the_reference():
    text = gf.read_scene(benchmark.SCENES["cube3d"])
    names = {g.name: g.values() for g in namelist.groups(text)}
    assert names["grid"]["spacing"] == [0.5/32]
    assert names["time"]["step"][0] == pytest.approx(benchmark.fixed_step(32), rel=1e-12)
    assert (names["material"]["density"], names["material"]["young_modulus"], names["material"]["poisson_ratio"]) == (
        [benchmark.DENSITY], [benchmark.YOUNG], [benchmark.POISSON])
    changed = {g.name: g.values() for g in namelist.groups(benchmark.block_scene(text, 16, "linear", 10, 5))}
    assert changed["grid"]["spacing"] == [0.5/16] and changed["method"]["basis"] == ["linear"]
    assert changed["method"]["sort_every"] == [5] and changed["time"]["max_steps"] == [10]
    assert changed["time"]["end"][0] == pytest.approx(10*changed["time"]["step"][0])
    plain = {g.name: g.values() for g in namelist.groups(benchmark.defaults_scene(text, 16, 10))}
    assert "method" not in plain and set(plain["time"]) == {"end", "max_steps"} and set(plain["output"]) == {"progress"}


@pytest.mark.parametrize("particles, side", [(262144, 32), (32768, 16), (30000, 16), (1, 2)])
def test_cube_of_about_so_many_particles(particles, side):
    assert benchmark.side_of(particles) == side


def test_benchmark_prints_ratio_and_error(fake_gimp, fake_build, tmp_path, capsys):
    benchmark.main(["--particles", "512", "--pairs", "3", "--steps", "7", "--build", str(fake_build), "--defaults", "--json", "-"])
    told = capsys.readouterr()
    line, plain = [json.loads(text) for text in told.out.splitlines()]
    assert line["ns_per_particle_step"] == pytest.approx(250.0) and line["reference_ns"] == pytest.approx(200.0)
    assert line["ratio"] == pytest.approx(0.8) and line["ratio_spread"] == pytest.approx([0.8, 0.8])
    assert line["energy_difference"] == pytest.approx(4e-8, rel=1e-3)
    assert (line["particles"], line["bytes_per_particle"], line["basis"], line["steps"]) == (512, 300.0, "ugimp", 7)
    assert plain["settings"] == "defaults" and plain["energy_difference"] is None
    compiled = (tmp_path / "compiled").read_text()
    assert "-march=x86-64-v3" in compiled and "-DSPLIT" in compiled and "-DSHAPE=3" in compiled
    assert "ratio" in told.err


# ------------------------------------------------------------------------------------------- as programs


@pytest.mark.parametrize("script", ["render", "plot_history", "xdmf", "convergence"])
def test_a_missing_file_is_one_clear_line(script, fake_gimp, tmp_path):
    done = run_script(SCRIPTS / f"{script}.py", tmp_path / "missing")
    assert done.returncode == 1
    complaint = [line for line in done.stderr.splitlines() if line.startswith(f"{script}.py:")]
    assert len(complaint) == 1 and "missing" in complaint[0] and "Traceback" not in done.stderr


@pytest.mark.parametrize("script", [SCRIPTS / "render.py", BENCHMARKS / "run.py"])
def test_help_reads_well(script):
    done = run_script(script, "--help")
    assert done.returncode == 0 and "usage:" in done.stdout and "default" in done.stdout
