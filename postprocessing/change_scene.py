#!/usr/bin/env python3
"""Print a scene with some of its keys changed, to run it or to keep it.

  change_scene.py inputs/two_disks.nml grid.spacing=0.05 method.basis=ugimp | build/bin/gimp.x
  change_scene.py inputs/two_disks.nml "body[right].velocity=-0.2, -0.2" time.courant= > faster.nml

GROUP.KEY= takes a key away; body[2].key means the second &body, body[right].key the one named so.
"""
import suitable_python  # noqa: F401 isort: skip (must come first)
import argparse

import gimp_files as gf
import namelist


def main(words=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", help="a namelist file")
    parser.add_argument("settings", nargs="*", metavar="GROUP.KEY=VALUE", help="what to change")
    arguments = parser.parse_args(words)
    print(namelist.apply_settings(gf.read_scene(arguments.scene), arguments.settings), end="")
    return 0


if __name__ == "__main__":
    gf.run_main(main)
