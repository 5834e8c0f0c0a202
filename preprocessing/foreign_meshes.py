"""Meshes of other programs: what a file holds, before it becomes a mesh of gimp.x. Names of kinds of cells are those of meshio.

Abaqus files are read here and not by meshio 5, which gives sets of elements to the wrong blocks, knows no surfaces and no CPE4.
"""
import contextlib
import io
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mesh_files import MeshError


@dataclass
class Foreign:
    """Points, cells in blocks of one kind, and named sets"""
    points: np.ndarray  # (n, 3)
    blocks: list  # (kind, table (n, nodes) from 0)
    cell_sets: dict = field(default_factory=dict)  # name -> list of (block, rows)
    node_sets: dict = field(default_factory=dict)  # name -> nodes from 0
    side_sets: dict = field(default_factory=dict)  # name -> list of tuples of corners


def dimension_of(kind):
    """Dimension of a kind of cells"""
    for dim, words in enumerate((("vertex",), ("line",), ("triangle", "quad", "polygon", "pixel"))):
        if kind.startswith(words):
            return dim
    return 3


def read_foreign(path, groups_from=None):
    """The content of a file; `groups_from` names a table of whole numbers for cells that says their groups"""
    path = Path(path)
    if not path.exists():
        raise MeshError(f"{path}: no such file")
    if path.suffix.lower() == ".inp":
        return read_abaqus(path)
    mesh = read_with_meshio(path)
    points = np.zeros((len(mesh.points), 3))
    points[:, :mesh.points.shape[1]] = mesh.points
    found = Foreign(points, [(block.type, np.asarray(block.data)) for block in mesh.cells])
    for name, rows in mesh.cell_sets.items():
        if not name.startswith("gmsh:"):
            found.cell_sets[name] = [(b, np.asarray(r, int)) for b, r in enumerate(rows) if r is not None and len(r)]
    if groups_from is not None:
        if groups_from not in mesh.cell_data:
            raise MeshError(f"{path}: has no data '{groups_from}' for cells; there are: {' '.join(mesh.cell_data) or 'none'}")
        sets_of_numbers(found, groups_from, mesh.cell_data[groups_from])
    elif "gmsh:physical" in mesh.cell_data:  # numbers of physical groups, their names apart; named ones of format 4.1 are sets already
        names = {(int(dim), int(tag)): name for name, (tag, dim) in mesh.field_data.items()}
        sets_of_numbers(found, "gmsh:physical", mesh.cell_data["gmsh:physical"], names, have=tuple(found.cell_sets))
    found.node_sets = {name: np.asarray(nodes, int) for name, nodes in mesh.point_sets.items()}
    return found


def read_with_meshio(path):
    """meshio's mesh; it prints and ends the program where it cannot read"""
    try:
        import meshio
    except ImportError:
        raise MeshError("reading other programs' meshes needs meshio: ./bootstrap.sh build installs it, as do apt-get install "
                        "python3-meshio and pip install meshio") from None
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return meshio.read(path)
    except (Exception, SystemExit) as problem:  # its readers fail in many ways on files that are not what they seem
        told = " ".join(f"{'' if isinstance(problem, SystemExit) else problem} {said.getvalue()}".split())[:200]
        if "Incompatible cell data" in told:
            told = ("some of its cells have a physical group and others have none, which meshio cannot read; "
                    "save without Mesh.SaveAll, or give each entity a group")
        raise MeshError(f"{path}: cannot be read as a mesh: {told or type(problem).__name__}") from None


def sets_of_numbers(found, label, tables, names=None, have=()):
    """Make sets of cells of the numbers in `tables`, one for each block; 0 is none. `names` of (dimension, number); not those that it has"""
    for b, ((kind, _), numbers) in enumerate(zip(found.blocks, tables)):
        numbers = np.asarray(numbers)
        if numbers.ndim != 1 or not np.array_equal(numbers, np.round(numbers)):
            raise MeshError(f"the data '{label}' of cells are not whole numbers, one for each cell")
        for number in np.unique(numbers[numbers != 0]).astype(int):
            name = (names or {}).get((dimension_of(kind), number), f"{label.split(':')[-1]}_{number}")
            if name not in have:
                found.cell_sets.setdefault(name, []).append((b, np.flatnonzero(numbers == number)))


# ------------------------------------------------------------------------------------------------ Abaqus


ABAQUS_KINDS = {  # letters before the first digit group -> number of nodes -> kind
    **{family: {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8"} for family in ("CPE", "CPS", "CAX", "CPEG", "M3D", "R3D", "S", "STRI")},
    "C3D": {4: "tetra", 6: "wedge", 8: "hexahedron", 10: "tetra10", 15: "wedge15", 20: "hexahedron20", 5: "pyramid", 27: "hexahedron27"},
    **{family: {2: "line", 3: "line3"} for family in ("T2D", "T3D", "R2D", "RAX")},
    "B2": {1: "line", 2: "line3", 3: "line"}, "B3": {1: "line", 2: "line3", 3: "line"},
}
ABAQUS_SIDES = {
    "triangle": ((0, 1), (1, 2), (2, 0)), "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "hexahedron": ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
}
ABAQUS_SIDES.update(triangle6=ABAQUS_SIDES["triangle"], quad8=ABAQUS_SIDES["quad"], quad9=ABAQUS_SIDES["quad"])


def abaqus_kind(word):
    """Kind of cells of an Abaqus type such as CPE4R; its own name if it is not known"""
    word = word.upper()
    if word == "STRI65":
        return "triangle6"
    if word == "S9R5":
        return "quad9"
    for family in sorted(ABAQUS_KINDS, key=len, reverse=True):
        if word.startswith(family):
            digits = word[len(family):]
            digits = digits[:len(digits) - len(digits.lstrip("0123456789"))]
            return ABAQUS_KINDS[family].get(int(digits) if digits else 0, word)
    return word


class AbaqusReader:
    """Collects what the keywords of an input file say about the mesh; all other keywords are passed over"""

    def __init__(self, path):
        self.path = path
        self.points, self.node_of = [], {}
        self.cells, self.cell_of = {}, {}  # kind -> rows; number -> (kind, row)
        self.elsets, self.nsets, self.surfaces = {}, {}, {}

    def fail(self, line, message):
        raise MeshError(f"{self.path}: line {line}: {message}")

    def block(self, line, keyword, options, rows):
        """One keyword with the lines after it, each a list of words with its number"""
        if keyword == "INCLUDE":
            self.fail(line, "*INCLUDE is not followed; put its text in")
        elif keyword == "NODE":
            for number, words in rows:
                self.add_node(number, words)
            self.extend(self.nsets, options.get("NSET"), [words[0] for _, words in rows])
        elif keyword == "ELEMENT":
            self.add_elements(line, options, rows)
        elif keyword in ("NSET", "ELSET"):
            self.extend(self.nsets if keyword == "NSET" else self.elsets, options.get(keyword), self.members(options, rows))
        elif keyword == "SURFACE" and options.get("TYPE", "ELEMENT").upper() == "ELEMENT" and "NAME" in options:
            self.surfaces.setdefault(options["NAME"], []).extend(rows)

    def add_node(self, line, words):
        try:
            number, place = int(words[0]), [float(w.upper().replace("D", "E")) for w in words[1:4]]
        except ValueError:
            self.fail(line, "a node has a number and up to three coordinates")
        if number in self.node_of:
            self.fail(line, f"node {number} was there before; several parts are not joined: write one part, or a flat file")
        self.node_of[number] = len(self.points)
        self.points.append(place + [0.0]*(3 - len(place)))

    def add_elements(self, line, options, rows):
        if "TYPE" not in options:
            self.fail(line, "*ELEMENT without TYPE")
        kind = abaqus_kind(options["TYPE"])
        table = self.cells.setdefault(kind, [])
        numbers, words = [], []
        length = None
        for number, row in rows:
            words += row
            length = length or (EXPECTED[kind] + 1 if kind in EXPECTED else len(row))
            if len(words) >= length:  # long elements go over several lines
                try:
                    element, *nodes = map(int, words)
                    nodes = [self.node_of[n] for n in nodes]
                except (ValueError, KeyError) as problem:
                    self.fail(number, f"an element of {options['TYPE']} with a node that is not there: {problem}")
                if len(words) > length:
                    self.fail(number, f"{len(words) - 1} nodes for an element of {options['TYPE']}, which has {length - 1}")
                if element in self.cell_of:
                    self.fail(number, f"element {element} was there before; several parts are not joined: write one part, or a flat file")
                self.cell_of[element] = (kind, len(table))
                table.append(nodes)
                numbers.append(str(element))
                words = []
        if words:
            self.fail(rows[-1][0], f"the last element of {options['TYPE']} has {len(words) - 1} nodes; it must have {length - 1}")
        self.extend(self.elsets, options.get("ELSET"), numbers)

    @staticmethod
    def members(options, rows):
        """Numbers or names of sets, those of GENERATE counted out"""
        if "GENERATE" not in options:
            return [word for _, words in rows for word in words]
        found = []
        for _, words in rows:
            first, last, step = (list(map(int, words)) + [1])[:3]
            found += map(str, range(first, last + 1, step))
        return found

    @staticmethod
    def extend(sets, name, members):
        if name:
            sets.setdefault(name, []).extend(members)

    def numbers(self, sets, members, depth=0):
        """Numbers of the members of a set; sets may name others"""
        by_upper = {name.upper(): name for name in sets}
        for word in members:
            if word.lstrip("-").isdigit():
                yield int(word)
            elif word.upper() in by_upper and depth < 20:
                yield from self.numbers(sets, sets[by_upper[word.upper()]], depth + 1)
            else:
                raise MeshError(f"{self.path}: a set names '{word}', which is not there")

    def foreign(self):
        """All that was found"""
        kinds = list(self.cells)
        found = Foreign(np.array(self.points).reshape(-1, 3), [(kind, np.array(self.cells[kind])) for kind in kinds])
        for name, members in self.elsets.items():
            rows = {}
            for number in dict.fromkeys(self.numbers(self.elsets, members)):
                if number in self.cell_of:
                    kind, row = self.cell_of[number]
                    rows.setdefault(kind, []).append(row)
            found.cell_sets[name] = [(kinds.index(kind), np.array(r)) for kind, r in rows.items()]
        for name, members in self.nsets.items():
            found.node_sets[name] = np.array(sorted({self.node_of[n] for n in self.numbers(self.nsets, members) if n in self.node_of}), int)
        for name, rows in self.surfaces.items():
            found.side_sets[name] = [side for line, words in rows for side in self.sides(line, name, words)]
        return found

    def sides(self, line, name, words):
        """Corners of the sides of one line of *SURFACE: an element or a set of them, and which side"""
        side = words[1].upper() if len(words) > 1 else ""
        if not (side.startswith("S") and side[1:].isdigit()):
            self.fail(line, f"surface {name}: '{', '.join(words)}' must be an element or a set and a side S1, S2, ..")
        for number in self.numbers(self.elsets, words[:1]):
            if number not in self.cell_of and str(number) != words[0]:
                continue  # GENERATE may count over gaps
            kind, row = self.cell_of.get(number, (None, 0))
            sides = ABAQUS_SIDES.get(kind, ())
            if kind and not sides:
                continue  # a kind that is refused later, with all of its elements
            if not 0 < int(side[1:]) <= len(sides):
                self.fail(line, f"surface {name}: element {number} has no side {side}")
            yield tuple(self.cells[kind][row][c] for c in sides[int(side[1:]) - 1])


EXPECTED = {"line": 2, "line3": 3, "triangle": 3, "triangle6": 6, "quad": 4, "quad8": 8, "quad9": 9, "tetra": 4, "hexahedron": 8, "wedge": 6,
            "pyramid": 5, "tetra10": 10, "wedge15": 15, "hexahedron20": 20, "hexahedron27": 27}


def read_abaqus(path):
    """The mesh of an Abaqus input file: nodes, elements, sets, surfaces of elements"""
    reader = AbaqusReader(path)
    try:
        lines = Path(path).read_text().splitlines()
    except UnicodeDecodeError:
        raise MeshError(f"{path}: is not a text file") from None
    keyword = None
    for number, line in enumerate([*lines, "*END"], 1):
        words = [w.strip() for w in line.split(",")]
        if line.startswith("**") or not line.strip():
            continue
        if line.startswith("*"):
            if keyword:
                reader.block(*keyword)
            options = dict((k.strip().upper(), v.strip().strip('"')) for k, _, v in (w.partition("=") for w in words[1:] if w))
            keyword = (number, words[0][1:].upper(), options, [])
        elif keyword:
            keyword[3].append((number, [w for w in words if w]))
    return reader.foreign()
