#!/usr/bin/env python3
"""Write FILE.xdmf beside an output file of gimp.x, for programs that cannot read VTKHDF over time (ParaView up to 5.11).

  xdmf.py disks.vtkhdf              writes disks.vtkhdf.xdmf; open it with the reader "Xdmf3"

The .xdmf holds no data: it points into the .vtkhdf, which must stay beside it.
"""
import suitable_python  # noqa: F401 isort: skip (must come first)
import argparse
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import gimp_files as gf

# Six components go as a Matrix: Tensor6 would mean another order (xx xy xz yy yz zz) than ours
KINDS = {1: "Scalar", 3: "Vector", 6: "Matrix", 9: "Tensor"}


def slab(parent, file_name, dataset, first, count):
    """Reference to `count` rows of a dataset from row `first` on"""
    shape = dataset.shape
    rank = len(shape)
    wanted = (count, *shape[1:])
    item = ElementTree.SubElement(parent, "DataItem", ItemType="HyperSlab", Dimensions=" ".join(map(str, wanted)))
    corner = ElementTree.SubElement(item, "DataItem", Dimensions=f"3 {rank}", Format="XML")
    rows = ((first, *[0]*(rank - 1)), (1,)*rank, wanted)  # start, stride, count
    corner.text = "  ".join(" ".join(map(str, row)) for row in rows)
    number = {"f": "Float", "i": "Int", "u": "UInt"}[dataset.dtype.kind]
    source = ElementTree.SubElement(item, "DataItem", Format="HDF", Dimensions=" ".join(map(str, shape)),
                                    NumberType=number, Precision=str(dataset.dtype.itemsize))
    source.text = f"{file_name}:{dataset.name}"


def document(path):
    """The XML tree for an output file, and the number of frames"""
    with gf.open_file(path) as file:
        layout = gf.Layout(file)
        if len(layout) == 0:
            raise gf.GimpError(f"{path}: holds no complete frame yet")
        root = ElementTree.Element("Xdmf", Version="3.0")
        series = ElementTree.SubElement(ElementTree.SubElement(root, "Domain"), "Grid", Name="particles", GridType="Collection",
                                        CollectionType="Temporal")
        name = Path(path).name
        for time, first, count in zip(layout.times, layout.first, layout.size):
            grid = ElementTree.SubElement(series, "Grid", Name="particles", GridType="Uniform")
            ElementTree.SubElement(grid, "Time", Value=repr(float(time)))
            ElementTree.SubElement(grid, "Topology", TopologyType="Polyvertex", NumberOfElements=str(count), NodesPerElement="1")
            slab(ElementTree.SubElement(grid, "Geometry", GeometryType="XYZ"), name, layout.root["Points"], first, count)
            for field, data in layout.root.get("PointData", {}).items():
                kind = KINDS.get(1 if data.ndim == 1 else data.shape[1], "Matrix")
                holder = ElementTree.SubElement(grid, "Attribute", Name=field, AttributeType=kind, Center="Node")
                slab(holder, name, data, first, count)
        return ElementTree.ElementTree(root), len(layout)


def main(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", help="output file of a run, NAME.vtkhdf")
    arguments = parser.parse_args(words)
    tree, count = document(arguments.file)
    ElementTree.indent(tree)
    target = f"{arguments.file}.xdmf"
    try:
        tree.write(target, xml_declaration=True, encoding="utf-8")
    except OSError as problem:
        raise gf.GimpError(f"{target}: cannot be written ({problem.strerror})") from None
    print(f"{target} ({count} frames)")
    return 0


if __name__ == "__main__":
    gf.run_main(main)
