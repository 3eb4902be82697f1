"""Robots read in a Python of their own, which tells of every file and connection that is opened."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

_READ = """
    import sys
    {imports}
    import torchrbd
    torchrbd.RobotModel
    file, forbidden, seen = *sys.argv[1:], []
    sys.addaudithook(lambda event, given: seen.append((event, str(given))))
    torchrbd.RobotModel.from_urdf(file)
    told = [one for one in seen if one[0].startswith(("socket", "urllib")) or one[0] == "open"]
    assert any(file in one[1] for one in told), told
    assert not any(forbidden in one[1] or one[0] != "open" for one in told), told
"""


def read_alone(robot: Path, forbidden: str, imports: str = "") -> None:
    """Assert that reading a robot opens its own file, no connection, and nothing whose name has ``forbidden``."""
    code = textwrap.dedent(_READ).format(imports=imports)
    subprocess.run([sys.executable, "-c", code, str(robot), forbidden], check=True)
