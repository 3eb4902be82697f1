"""The house keeps its order: a file imports only from its own room and the rooms above it."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "torchrbd"
ROOMS = (
    "errors", "robot", "recordings", "parameters", "physics", "model", "inference", "diagnosis", "simulation",
    "learning", "export", "report", "cli",
)  # fmt: skip
ONLY_IN = {"yourdfpy": "robot/urdf.py", "pytorch_kinematics": "robot/chain.py"}


def imported_modules(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    package = ("torchrbd", *path.relative_to(PACKAGE).parent.parts)
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            found.add(".".join(filter(None, (base, node.module))))
            if node.module in (None, "torchrbd"):
                found |= {f"{node.module or base}.{alias.name}" for alias in node.names}
    return found


def room_of(module: str) -> str | None:
    parts = module.split(".")
    return parts[1] if parts[0] == "torchrbd" and len(parts) > 1 and parts[1] in ROOMS else None


SOURCES = [path for path in sorted(PACKAGE.rglob("*.py")) if path.relative_to(PACKAGE).parts != ("__init__.py",)]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_downwards(path: Path) -> None:
    relative = path.relative_to(PACKAGE)
    own = relative.parts[0].removesuffix(".py")
    if own not in ROOMS:
        assert own in ("__main__", "demo"), f"{relative} stands in no known room"
        return
    for module in imported_modules(path):
        room = room_of(module)
        assert room is None or ROOMS.index(room) <= ROOMS.index(own), f"{relative} imports {module} from a later room"
        library = module.split(".")[0]
        assert library not in ONLY_IN or str(relative) == ONLY_IN[library], f"{relative} may not import {library}"


def test_a_violation_is_seen(tmp_path: Path) -> None:
    code = tmp_path / "probe.py"
    code.write_text("from torchrbd.cli import main\nimport torchrbd.report.page\n")
    tree = ast.parse(code.read_text())
    assert len(list(ast.walk(tree))) > 2
    assert room_of("torchrbd.cli") == "cli"
    assert ROOMS.index("cli") > ROOMS.index("robot")
