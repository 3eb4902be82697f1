"""Make the robots and motions of tests and examples importable: import this before them."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent.parent / folder) for folder in ("tests", "examples")]
