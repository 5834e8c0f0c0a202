"""Importing this lets the scripts of this folder use the modules of postprocessing/."""
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
if str(REPOSITORY / "postprocessing") not in sys.path:
    sys.path.insert(0, str(REPOSITORY / "postprocessing"))

import suitable_python  # noqa: E402, F401  starts again with another Python if this one lacks modules
