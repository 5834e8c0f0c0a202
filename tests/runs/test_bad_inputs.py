"""Every scene of tests/bad_inputs is refused with exit code 2 and its messages, and leaves nothing behind,
with --check and without.

The first lines of a scene say what must be told: `! expect: <part of a message>`, one per mistake. A scene gives exactly as
many messages as it expects, so that one slip never draws a tail of others.
"""
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "preprocessing"))
SCENES = sorted((ROOT / "tests" / "bad_inputs").glob("*.nml"))


def expected(scene):
    return re.findall(r"^! expect: (.*)$", scene.read_bytes().decode(), flags=re.MULTILINE)


def snapshot(folder):
    """All files and folders below a folder, with the content of the files"""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


def write_particles(path, **datasets):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in datasets.items():
            file[name] = values


def write_meshes(folder):
    """A square of quads that are all of one group, one of triangles, a disk, and a cube"""
    pytest.importorskip("h5py")
    import mesh_makers
    from mesh_files import write_mesh
    axis = [0.0, 0.25, 0.5, 0.75, 1.0]
    square = mesh_makers.block("quad4", [axis, axis])
    square.element_groups, square.groups = ["soil"], {"quad4": square.groups["quad4"] + 1}
    write_mesh(folder / "mesh.h5", square)
    write_mesh(folder / "triangles.h5", mesh_makers.block("triangle3", [axis, axis]))
    write_mesh(folder / "disk.h5", mesh_makers.disk([0.5, 0.5], 0.4, 4))
    for kind in ("triangle6", "quad8", "quad9"):
        write_mesh(folder / f"{kind}.h5", mesh_makers.block(kind, [axis, axis]))
    write_mesh(folder / "solid.h5", mesh_makers.block("hexahedron8", [axis]*3))


def prepare(name, folder):
    """What some scenes need to find in the working directory"""
    if name.startswith("mesh_"):
        write_meshes(folder)
    if name == "mesh_file_foreign":
        (folder / "letter.txt").write_text("this is no mesh")
    if name == "output_exists":
        (folder / "taken.vtkhdf").write_text("a run of yesterday")
    elif name == "default_output_exists":
        (folder / "gimp.vtkhdf").write_text("a run of yesterday")
    elif name == "particle_file_unreadable":
        (folder / "particles.h5").write_text("this is no HDF5 file")
    elif name == "restart_from_foreign":
        (folder / "letter.txt").write_text("this is no checkpoint")
    elif name == "particle_file_without_mass":
        write_particles(folder / "particles.h5", position=[[0.5, 0.5]], volume=[0.01])
    elif name.endswith("particle_of_file_outside"):
        write_particles(folder / "particles.h5", position=[[0.5, 0.5], [0.5, 1.5]], volume=[0.01]*2, mass=[10.0]*2)
    elif name == "particle_of_file_inverted":
        write_particles(folder / "particles.h5", position=[[0.5, 0.5]], volume=[0.01], mass=[10.0],
                        deformation_gradient=[[-1.0, 0.0, 0.0, 1.0]])
    elif name == "particle_of_file_flat":
        write_particles(folder / "particles.h5", position=[[0.5, 0.5]], volume=[0.01], mass=[10.0], half_length=[[0.05, 0.0]])
    elif name == "particle_of_file_not_a_number":
        write_particles(folder / "particles.h5", position=[[0.5, 0.5]], volume=[0.01], mass=[10.0], velocity=[[float("nan"), 0.0]])
    elif name.startswith("corners_of_file"):
        corner = {"corners_of_file_crossed": [[.4, .4, .6, .4, .6, .6, .4, .6], [.4, .4, .6, .4, .4, .6, .6, .6]],
                  "corners_of_file_far": [[.4, .4, .42, .4, .42, .9, .4, .9]]*2,
                  "corners_of_file_missing": []}.get(name, [[.4, .4, .6, .4, .6, .6, .4, .6]]*2)
        volume = 0.1 if name.endswith("large") else 0.01 if name.endswith("far") else 0.04
        write_particles(folder / "particles.h5", position=[[0.5, 0.5]]*2, volume=[volume]*2, mass=[10.0]*2,
                        **({"corner": corner} if corner else {}))
    elif name == "output_not_writable":
        (folder / "locked").mkdir()
        (folder / "locked").chmod(0o555)


def check(gimp_x, scene, folder, arguments=("--check",), **options):
    with scene.open("rb") as text:
        return subprocess.run([str(gimp_x), *arguments], stdin=text, cwd=folder, capture_output=True, timeout=60, **options)


def as_somebody(gimp_x):
    """Options for a process without the rights of root, who may write everywhere; nothing for anybody else"""
    if os.geteuid() != 0:
        return {}
    nobody = {"user": 65534, "group": 65534, "extra_groups": []}
    try:
        subprocess.run([str(gimp_x), "--version"], cwd="/", check=True, capture_output=True, **nobody)
    except (OSError, subprocess.SubprocessError):
        pytest.skip("root may write everywhere, and nobody else can run the program here")
    return nobody


@pytest.fixture
def open_folder():
    """A working directory that any user may enter, which those of pytest are not"""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)


def test_there_are_scenes():
    assert len(SCENES) >= 45


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.stem)
def test_is_refused(gimp_x, scene, tmp_path, open_folder):
    wanted = expected(scene)
    assert wanted, "the scene says nothing about its message"
    folder, options = (open_folder, as_somebody(gimp_x)) if scene.stem == "output_not_writable" else (tmp_path, {})
    prepare(scene.stem, folder)
    before = snapshot(folder)
    run = check(gimp_x, scene, folder, **options)
    told = run.stderr.decode(errors="replace")
    assert run.returncode == 2, told
    for message in wanted:
        assert message in told
    head = re.search(r"^gimp\.x: (\d+) mistakes? in the scene", told, flags=re.MULTILINE)
    assert head, told
    messages = [line for line in told.splitlines() if line.startswith("  ")]
    assert int(head.group(1)) == len(messages) == len(wanted), told
    started = check(gimp_x, scene, folder, arguments=(), **options)
    assert (started.returncode, started.stderr) == (2, run.stderr), "a run must be refused with the words of --check"
    assert snapshot(folder) == before, "something was written"


def test_messages_come_through_a_pipe(gimp_x, tmp_path):
    """A pipe cannot be rewound; the whole text must arrive, also without a last line end"""
    text = (ROOT / "tests" / "bad_inputs" / "many_mistakes.nml").read_bytes().rstrip(b"\n")
    run = subprocess.run([str(gimp_x), "--check"], input=text, cwd=tmp_path, capture_output=True, timeout=60)
    assert run.returncode == 2
    for message in expected(ROOT / "tests" / "bad_inputs" / "many_mistakes.nml"):
        assert message in run.stderr.decode()


def test_overwrite_is_accepted(gimp_x, tmp_path):
    """The scene of an existing output is sound once overwrite is set, and a check leaves the file alone"""
    (tmp_path / "taken.vtkhdf").write_text("a run of yesterday")
    text = (ROOT / "tests" / "bad_inputs" / "output_exists.nml").read_text()
    text = text.replace('name = "taken"', 'name = "taken" overwrite = .true.')
    run = subprocess.run([str(gimp_x), "--check"], input=text.encode(), cwd=tmp_path, capture_output=True, timeout=60)
    assert run.returncode == 0, run.stderr.decode()
    assert (tmp_path / "taken.vtkhdf").read_text() == "a run of yesterday"
