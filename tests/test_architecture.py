"""The house keeps its order: a file imports only from its own room and the rooms above it."""

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "torchrbd"
ROOMS = (
    "errors", "estimators", "threads", "robot", "recordings", "parameters", "physics", "model", "inference",
    "diagnosis", "simulation", "learning", "export", "report", "cli",
)  # fmt: skip
ONLY_IN = {"yourdfpy": "robot/urdf.py", "pytorch_kinematics": "robot/chain.py"}


def imported_modules(code: str, package: tuple[str, ...]) -> set[str]:
    """Return the absolute names of all modules that a file of ``package`` imports."""
    found = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(filter(None, (base, node.module)))
            found |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
    return found


def room_of(module: str) -> str | None:
    parts = module.split(".")
    return parts[1] if parts[0] == "torchrbd" and len(parts) > 1 and parts[1] in ROOMS else None


def violations(relative: Path, code: str) -> list[str]:
    """Return what a file, given by its path in the package, imports from later rooms or against ONLY_IN."""
    own = relative.parts[0].removesuffix(".py")
    if own not in ROOMS:
        return [] if own in ("__main__", "demo") else [f"{relative} stands in no known room"]
    found = []
    for module in sorted(imported_modules(code, ("torchrbd", *relative.parent.parts))):
        room = room_of(module)
        if room is not None and ROOMS.index(room) > ROOMS.index(own):
            found.append(f"{relative} imports {module} from a later room")
        library = module.split(".")[0]
        if ONLY_IN.get(library, str(relative)) != str(relative):
            found.append(f"{relative} may not import {library}")
    return found


SOURCES = [path for path in sorted(PACKAGE.rglob("*.py")) if path.relative_to(PACKAGE).parts != ("__init__.py",)]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downwards(path: Path) -> None:
    # A typing-only import of a library that another room owns is no use of it.
    code = re.sub(r"\nif TYPE_CHECKING:\n(    .*\n)+", "\n", path.read_text())
    assert violations(path.relative_to(PACKAGE), code) == []


@pytest.mark.parametrize(
    ("place", "code"),
    [
        ("robot/tree.py", "from torchrbd.inference import identify"),
        ("robot/tree.py", "import torchrbd.model"),
        ("robot/tree.py", "from ..cli import main"),
        ("physics/base.py", "from torchrbd import report"),
        ("report/page.py", "import yourdfpy"),
        ("robot/model.py", "from pytorch_kinematics import Chain"),
        ("helpers/things.py", ""),
    ],
)
def test_violations_are_seen(place: str, code: str) -> None:
    assert len(violations(Path(place), code)) >= 1
