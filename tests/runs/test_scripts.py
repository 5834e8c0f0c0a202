"""Scripts that change scenes and run them: namelists, convergence tables, benchmarks; on a made-up program, gimp.x is not needed."""
import json

import pytest

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")

from made_up import BENCHMARKS, SCRIPTS, assert_drawn, fake_gimp, fake_scene, run_script, scene_file, value_of  # noqa: E402, F401
import change_scene  # noqa: E402
import convergence  # noqa: E402
import gimp_files as gf  # noqa: E402
import namelist  # noqa: E402
import run as benchmark  # noqa: E402


# ------------------------------------------------------------------------------------------- scenes


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


def test_change_scene_prints_the_changed_scene(tmp_path, capsys):
    scene = tmp_path / "s.nml"
    scene.write_text('! a comment\n&grid\n  spacing = 0.1\n/\n&time\n  end = 1.0\n  courant = 0.3\n/\n')
    change_scene.main([str(scene), "grid.spacing=0.05", "time.courant=", "method.basis=linear"])
    text = capsys.readouterr().out
    values = {group.name: group.values() for group in namelist.groups(text)}
    assert text.startswith("! a comment\n")
    assert values == {"grid": {"spacing": [0.05]}, "time": {"end": [1.0]}, "method": {"basis": ["linear"]}}


# ------------------------------------------------------------------------------------------- runs


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


def test_named_files_are_found_from_another_folder(tmp_path):
    (tmp_path / "scene.nml").write_text('&body name = "a" /\n&body name = "b" shape = "file" file = "points.h5" /\n')
    (tmp_path / "points.h5").write_text("")
    assert value_of(gf.read_scene(tmp_path / "scene.nml"), "body", "file", 1) == [str(tmp_path / "points.h5")]
    (tmp_path / "scene.nml").write_text('&mesh file = "points.h5" /\n')
    assert value_of(gf.read_scene(tmp_path / "scene.nml"), "mesh", "file") == [str(tmp_path / "points.h5")]
    (tmp_path / "scene.nml").write_text('&mesh file = "inputs/meshes/slope.h5" /\n')  # as scenes of the repository name them
    assert value_of(gf.read_scene(tmp_path / "scene.nml"), "mesh", "file")[0].endswith("/inputs/meshes/slope.h5")


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
