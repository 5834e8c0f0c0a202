"""The scripts of postprocessing/ that read and draw, on small made-up outputs; gimp.x is not needed."""
import json
import xml.etree.ElementTree as ElementTree

import pytest

h5py = pytest.importorskip("h5py")
np = pytest.importorskip("numpy")
pytest.importorskip("matplotlib")

from made_up import REPOSITORY, assert_drawn, disk, fake_particles, fake_scene, picture, write_fake  # noqa: E402, F401
import gimp_files as gf  # noqa: E402
import particle_pictures as pictures  # noqa: E402
import plot_history  # noqa: E402
import render  # noqa: E402
import xdmf  # noqa: E402


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


# ------------------------------------------------------------------------------------------- pictures


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


def test_elements_under_the_particles(disk, tmp_path):
    """Lines where no particle is: the picture gets darker there"""
    mesh = REPOSITORY / "inputs" / "meshes" / "hybrid.h5"
    edges = gf.mesh_edges(mesh)
    with h5py.File(mesh) as file:
        elements = sum(len(rows) for name, rows in file["elements"].items() if not name.endswith("_group"))
        assert edges.shape == (len(file["nodes"]) + elements - 1, 2, 2)  # Euler's formula of a mesh without holes
    words = [str(disk), "--box", "--dpi", "60", "--output"]
    render.main([*words, str(tmp_path / "plain.png")])
    render.main([*words, str(tmp_path / "mesh.png"), "--mesh", str(mesh)])
    plain, drawn = picture(tmp_path / "plain.png"), picture(tmp_path / "mesh.png")
    assert (drawn < 0.99).mean() > (plain < 0.99).mean()
    solid = write_fake(tmp_path / "x.vtkhdf", d=3, n=4)
    with pytest.raises(gf.GimpError, match="in two dimensions only"):
        render.main([str(solid), "--mesh", str(mesh)])
    with pytest.raises(gf.GimpError, match="not a mesh file in two dimensions"):
        render.main([str(disk), "--mesh", str(mesh.with_name("tetrahedra.h5"))])


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
