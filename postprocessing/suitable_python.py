"""Importing this first makes a script start again with a Python that has the modules it needs, if the one at hand lacks them.

The first `python3` on a PATH is often not the one that the system's packages serve. Tried in turn: the one that
./bootstrap.sh found, .venv of the repository, /usr/bin/python3.
"""
import importlib.util
import os
import subprocess
import sys
from pathlib import Path

NEEDED = ("numpy", "h5py", "matplotlib")
REPOSITORY = Path(__file__).resolve().parent.parent


def candidates():
    """Other interpreters, best first"""
    noted = REPOSITORY / "build" / "python.path"
    if noted.exists():
        yield noted.read_text().strip()
    yield str(REPOSITORY / ".venv" / "bin" / "python")
    yield "/usr/bin/python3"


def find_other():
    """The first of them that imports all; none: None"""
    for python in candidates():
        if os.access(python, os.X_OK):
            test = subprocess.run([python, "-c", "import " + ",".join(NEEDED)], capture_output=True)
            if test.returncode == 0:
                return python
    return None


def start_again():
    """Run the same command with another interpreter; ends the program in any case"""
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    python = None if "GIMP_STARTED_AGAIN" in os.environ else find_other()
    if python:
        os.environ["GIMP_STARTED_AGAIN"] = "1"
        os.execv(python, [python, *sys.argv])
    sys.exit(f"{Path(sys.argv[0]).name}: this Python lacks {', '.join(missing)} (pip install {' '.join(missing)}, or ./bootstrap.sh build)")


SCRIPTS = (REPOSITORY / "postprocessing", REPOSITORY / "benchmarks", REPOSITORY / "preprocessing")
if any(importlib.util.find_spec(name) is None for name in NEEDED) and Path(sys.argv[0]).resolve().parent in SCRIPTS:
    start_again()
