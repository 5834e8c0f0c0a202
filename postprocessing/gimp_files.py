"""Reading what a run of gimp.x leaves behind, and running scenes from Python.

Everything comes from one file, NAME.vtkhdf:

    frames(path)    the particles, frame by frame: only frames that were written whole (a run may have been killed)
    history(path)   the table of the run, one numpy array per column
    summary(path)   the closing figures: steps, errors, speed
    scene(path)     the scene that was run, as text; `complete` has all defaults filled in

Needs numpy and h5py. A `GimpError` is a mistake of the user or of a file, in one line.
"""
import hashlib
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

# A run that still writes holds a lock; looking at its committed frames is safe, because the frame count is written last.
os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")
import h5py  # noqa: E402
import numpy as np  # noqa: E402

import namelist  # noqa: E402

REPOSITORY = Path(__file__).resolve().parent.parent

UNITS = {"displacement": "m", "velocity": "m/s", "stress": "Pa", "pressure": "Pa", "von_mises": "Pa", "volume": "m3",
         "mass": "kg", "density": "kg/m3", "half_length": "m", "error": "m", "reference_position": "m"}


class GimpError(Exception):
    """A mistake that one line can explain"""


class RunError(GimpError):
    """A run that did not end well: its exit code (None: it was stopped because it took too long) and what it said, line by line"""

    def __init__(self, message, code, said=()):
        super().__init__(message)
        self.code = code
        self.said = list(said)


@dataclass
class Frame:
    """The particles at one time"""
    index: int
    time: float
    points: np.ndarray  # (n, 3); z = 0 in two dimensions
    fields: dict = field(default_factory=dict)  # name -> (n,) or (n, components)
    written: tuple = ()  # names of all fields of the file, also of those that were not read

    def __len__(self):
        return len(self.points)

    def get(self, name):
        """A field, or a GimpError that lists what there is"""
        if name not in self.fields:
            raise GimpError(f"no field '{name}' in the frames; the run wrote: {' '.join(sorted(self.written)) or 'none'}"
                            " (add it to fields of &output)")
        return self.fields[name]


# ---------------------------------------------------------------------------------------------------- reading


def open_file(path):
    """An output file for reading"""
    path = Path(path)
    if path.is_dir():
        raise GimpError(f"{path} is a folder; name the .vtkhdf file in it")
    if not path.exists():
        raise GimpError(f"{path}: no such file")
    try:
        return h5py.File(path, "r")
    except OSError as problem:
        reason = "it is cut off or not HDF5" if "signature" in str(problem) or "truncated" in str(problem) else problem
        raise GimpError(f"{path}: cannot be read ({reason})") from None


def _group(file, name):
    if name not in file:
        raise GimpError(f"{file.filename}: has no /{name}; not an output file of gimp.x?")
    return file[name]


class Layout:
    """Where each committed frame lies in the long arrays of /VTKHDF"""

    def __init__(self, file):
        self.root = _group(file, "VTKHDF")
        steps = _group(file, "VTKHDF/Steps")
        count = int(steps.attrs["NSteps"])
        self.times = steps["Values"][:count] if count else np.zeros(0)
        self.first = steps["PointOffsets"][:count].astype(np.int64) if count else np.zeros(0, np.int64)
        per_part = self.root["NumberOfPoints"][:].astype(np.int64) if count else np.zeros(0, np.int64)
        part = steps["PartOffsets"][:count] if "PartOffsets" in steps else np.arange(count)
        parts = steps["NumberOfParts"][:count] if "NumberOfParts" in steps else np.ones(count, int)
        self.size = np.array([per_part[p:p + n].sum() for p, n in zip(part, parts)], np.int64)

    def __len__(self):
        return len(self.times)


def frame_times(path):
    """Times [s] of the committed frames"""
    with open_file(path) as file:
        return np.array(Layout(file).times)


def select_frames(words, count):
    """Frame numbers from words such as "last", "all", "0,5,-1" or "0:10:2" """
    if count == 0:
        raise GimpError("the file holds no complete frame yet")
    chosen = []
    for word in str(words).replace(" ", "").split(","):
        try:
            if word == "all":
                chosen += range(count)
            elif word == "last":
                chosen.append(count - 1)
            elif word == "first":
                chosen.append(0)
            elif ":" in word:
                chosen += range(count)[slice(*(int(w) if w else None for w in word.split(":")))]
            else:
                chosen.append(range(count)[int(word)])
        except ValueError:
            raise GimpError(f"frame '{word}' is not a number, a range a:b:c, first, last or all") from None
        except IndexError:
            raise GimpError(f"no frame {word}; the file holds frames 0 to {count - 1}") from None
    return chosen


def frames(path, which="all", names=None):
    """Yield the committed frames `which` (see select_frames) with the fields `names` (default: all of them)"""
    with open_file(path) as file:
        layout = Layout(file)
        data = layout.root["PointData"] if "PointData" in layout.root else {}
        present = [name for name in data if names is None or name in names]
        for index in select_frames(which, len(layout)):
            rows = slice(layout.first[index], layout.first[index] + layout.size[index])
            yield Frame(index, float(layout.times[index]), layout.root["Points"][rows].astype(float),
                        {name: data[name][rows] for name in present}, tuple(data))


def history(path):
    """The table of the run: column name -> array, cut to the committed rows"""
    with open_file(path) as file:
        group = _group(file, "history")
        rows = int(group.attrs.get("rows", min((len(d) for d in group.values()), default=0)))
        return {name: group[name][:rows] for name in group}


def history_units(path):
    """Unit of each column of the history, as text"""
    with open_file(path) as file:
        return {name: _plain(column.attrs.get("unit", "")) for name, column in _group(file, "history").items()}


def summary(path):
    """The closing figures as a dictionary of plain numbers and texts; a run that was killed has none"""
    with open_file(path) as file:
        if "summary" not in file:
            raise GimpError(f"{path}: has no /summary; the run did not reach its end")
        return {name: _plain(value) for name, value in file["summary"].attrs.items()}


def scene(path, which="complete"):
    """The scene of the run as namelist text: "input" as it was read, "complete" with all defaults"""
    with open_file(path) as file:
        group = _group(file, "scene")
        if which not in group:
            raise GimpError(f"{path}: has no /scene/{which}")
        return _plain(group[which][()])


def mesh_edges(path):
    """Ends (n, 2, 2) of the edges between corners of the elements of a mesh file in two dimensions"""
    corners = {"triangle": 3, "quad": 4}
    edges = []
    with open_file(path) as file:
        if _plain(file.attrs.get("format", "")) != "gimp-mesh" or int(file.attrs.get("dimension", 0)) != 2:
            raise GimpError(f"{path}: is not a mesh file in two dimensions")
        for kind, table in file["elements"].items():
            if not kind.endswith("_group"):
                around = table[:, :corners[kind.rstrip("0123456789")]] - 1
                edges.append(np.stack([around, np.roll(around, -1, axis=1)], 2).reshape(-1, 2))
        return file["nodes"][:][np.unique(np.sort(np.concatenate(edges), axis=1), axis=0)]


def _plain(value):
    """An HDF5 value as number, text or list"""
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "SO":
            return "\n".join(_plain(v).rstrip() for v in value.ravel())
        return _plain(value.ravel()[0]) if value.size == 1 else value
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").rstrip("\0 ")
    if isinstance(value, np.generic):
        return _plain(value.item())
    return value


@dataclass
class Setting:
    """What a picture needs to know of the scene"""
    dimension: int = 3
    title: str = ""
    lower: tuple = ()
    upper: tuple = ()
    basis: str = ""
    domain: str = ""


def setting(path):
    """Dimension, box and basis of a run; from the scene, or guessed from the points if the scene is not in the file"""
    try:
        groups = {g.name: g.values() for g in reversed(namelist.groups(scene(path)))}
        top, grid, method = (groups.get(name, {}) for name in ("scene", "grid", "method"))
        return Setting(int(top["dimension"][0]), str(top.get("title", [""])[0]), tuple(grid.get("lower", ())),
                       tuple(grid.get("upper", ())), method.get("basis", [""])[0], method.get("domain", [""])[0])
    except (GimpError, KeyError, ValueError, IndexError):
        points = next(frames(path, "0", names=())).points
        spans = [k + 1 for k in range(3) if np.ptp(points[:, k]) > 0]
        return Setting(max(spans, default=1))


# ---------------------------------------------------------------------------------------------------- running


def find_gimp():
    """Path of gimp.x: the environment variable GIMP_X, else build/bin of this repository, else the PATH"""
    named = os.environ.get("GIMP_X")
    if named:
        if not os.access(named, os.X_OK):
            raise GimpError(f"GIMP_X = {named} is not a program")
        return str(Path(named).resolve())
    built = REPOSITORY / "build" / "bin" / "gimp.x"
    found = str(built) if os.access(built, os.X_OK) else shutil.which("gimp.x")
    if not found:
        raise GimpError("gimp.x not found: build it in build/, put it on the PATH, or name it in GIMP_X")
    return found


def find_single(program):
    """Path of the program in single precision, gimp_sp.x beside gimp.x"""
    single = Path(program).with_name("gimp_sp.x")
    if not os.access(single, os.X_OK):
        raise GimpError(f"there is no {single}: the build has GIMP_SINGLE=OFF")
    return str(single)


def commit_of(program):
    """Commit that a program was built from, as --version tells it; with a sum over the program itself if its source was changed since"""
    said = subprocess.run([program, "--version"], capture_output=True, text=True).stdout
    found = re.search(r"\(([^,)]+),", said)
    if not found:
        raise GimpError(f"{program} --version does not name a commit: {said.strip() or 'it printed nothing'}")
    commit = found.group(1)
    if "dirty" in commit:
        commit += "-" + hashlib.sha1(Path(program).read_bytes()).hexdigest()[:8]
    return commit


def read_scene(path):
    """Text of a scene file; the particle and mesh files it names become absolute, so that it can run in another folder

    They are looked for from here, from the folder of the scene, and from the repository, as scenes of inputs/ name them.
    """
    path = Path(path)
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as problem:
        raise GimpError(f"{path}: {getattr(problem, 'strerror', None) or 'is not a text file'}") from None
    for name in ("body", "mesh"):
        for number, group in enumerate(g for g in namelist.groups(text) if g.name == name):
            named = group.values().get("file")
            if named and not Path(named[0]).is_absolute():
                for folder in (Path.cwd(), path.resolve().parent, REPOSITORY):
                    if (folder / named[0]).exists():
                        text = namelist.set_key(text, f"{name}[{number + 1}].file", str(folder / named[0]))
                        break
    return text


def run_scene(text, folder, name="run", program=None, threads=None, prefix=(), environment=None, longest=None):
    """Run a scene in `folder` and return the path of its output file; a RunError tells what gimp.x complained about

    `longest` [s]: a run that takes longer is stopped.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    text = namelist.set_key(text, "output.name", name)
    text = namelist.set_key(text, "output.overwrite", True)
    (folder / f"{name}.nml").write_text(text)
    variables = dict(os.environ, **(environment or {}))
    if threads:
        variables["OMP_NUM_THREADS"] = str(threads)
    with open(folder / f"{name}.nml") as source:
        try:
            done = subprocess.run([*prefix, program or find_gimp()], stdin=source, cwd=folder, env=variables, text=True,
                                  stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=longest)
        except subprocess.TimeoutExpired:
            raise RunError(f"gimp.x was stopped after {longest:g} s", None) from None
    (folder / f"{name}.log").write_text(done.stdout + done.stderr)
    if done.returncode != 0:
        said = [line.strip() for line in (done.stderr or done.stdout).splitlines() if line.strip()]
        raise RunError(f"gimp.x ended with code {done.returncode}: {' | '.join(said[:3]) or 'it printed nothing'}",
                       done.returncode, said)
    return folder / f"{name}.vtkhdf"


# ---------------------------------------------------------------------------------------------------- scripts


def say(*words):
    """Progress, on the error output so that results can be piped"""
    print(*words, file=sys.stderr, flush=True)


def run_main(main):
    """Run a script; a mistake ends it with one line and code 1 instead of a traceback"""
    try:
        sys.exit(main())
    except GimpError as problem:
        say(f"{Path(sys.argv[0]).name}: {problem}")
        sys.exit(1)
    except namelist.NamelistError as problem:
        say(f"{Path(sys.argv[0]).name}: scene: {problem}")
        sys.exit(1)
    except KeyboardInterrupt:
        say("interrupted")
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
