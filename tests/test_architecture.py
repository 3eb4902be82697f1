"""The house keeps its order: a file imports only from its own room and the rooms above it, and never in a circle.

Imports count wherever they stand: at the head of a file, inside a function or for type checkers alone.
"""

import ast
from collections.abc import Collection, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import torchrbd

PACKAGE = Path(__file__).parent.parent / "torchrbd"
ROOMS = (
    "errors", "_runtime", "display", "estimators", "options", "robot", "recordings", "parameters", "effects", "model",
    "regression", "dataset", "nuisance", "likelihood", "simulation", "inference", "diagnosis", "comparison", "fleet",
    "excitation", "learning", "export", "report", "cli",
)  # fmt: skip
ONLY_IN = {"yourdfpy": "robot/urdf.py", "pytorch_kinematics": "robot/chain.py"}


def imported_modules(code: str, package: tuple[str, ...]) -> set[str]:
    """Return the absolute names of all modules that a file of ``package`` imports, and of what it takes from them."""
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
    """Return the room of a module, or of a public name such as ``torchrbd.identify``."""
    parts = module.split(".")
    room = torchrbd._ROOM_OF.get(parts[1], parts[1]) if parts[0] == "torchrbd" and len(parts) > 1 else None
    return room if room in ROOMS else None


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


def circle(codes: Mapping[Path, str]) -> list[str]:
    """Return modules, given by path in the package and code, that import each other in a circle; empty without one.

    A package's own file, ``__init__.py``, does not count where a file in the package takes nothing but modules from it.
    """
    names = {path: ".".join(("torchrbd", *path.with_suffix("").parts)).removesuffix(".__init__") for path in codes}
    known = set(names.values())

    def imports(path: Path, code: str) -> set[str]:
        own, found = names[path], imported_modules(code, ("torchrbd", *path.parent.parts))
        taken = {package: {name for name in found if name.rpartition(".")[0] == package} for package in found & known}
        passed = {package for package in taken if own.startswith(f"{package}.") and set() < taken[package] <= known}
        return (found & known) - passed - {own}

    try:
        TopologicalSorter({names[path]: imports(path, code) for path, code in codes.items()}).prepare()
    except CycleError as error:
        return error.args[1]
    return []


SOURCES = [path for path in sorted(PACKAGE.rglob("*.py")) if path.relative_to(PACKAGE).parts != ("__init__.py",)]


def test_imports_point_downwards() -> None:
    wrong = {path: violations(path.relative_to(PACKAGE), path.read_text()) for path in SOURCES}
    assert {path: found for path, found in wrong.items() if found} == {}


def test_no_modules_import_each_other_in_a_circle() -> None:
    assert circle({path.relative_to(PACKAGE): path.read_text() for path in SOURCES}) == []


@pytest.mark.parametrize(
    ("place", "code"),
    [
        ("robot/tree.py", "from torchrbd.inference import identify"),
        ("robot/tree.py", "from torchrbd import identify"),
        ("robot/tree.py", "import torchrbd.model"),
        ("robot/tree.py", "from ..cli import main"),
        ("robot/tree.py", "if TYPE_CHECKING:\n    from torchrbd.model import RigidBodyDynamics"),
        ("robot/tree.py", "def build():\n    from torchrbd.model import RigidBodyDynamics"),
        ("effects/base.py", "from torchrbd import report"),
        ("report/page.py", "import yourdfpy"),
        ("robot/model.py", "from pytorch_kinematics import Chain"),
        ("robot/model.py", "if TYPE_CHECKING:\n    from pytorch_kinematics import Chain"),
        ("helpers/things.py", ""),
    ],
)
def test_violations_are_seen(place: str, code: str) -> None:
    assert len(violations(Path(place), code)) >= 1


@pytest.mark.parametrize(
    "back",
    [
        "from torchrbd.robot.a import f",
        "from torchrbd.robot import a",
        "import torchrbd.robot.a",
        "from .a import f",
        "if TYPE_CHECKING:\n    from torchrbd.robot.a import f",
        "def late():\n    from torchrbd.robot.a import f",
    ],
)
def test_circles_are_seen(back: str) -> None:
    a, b, c = (Path(f"robot/{name}.py") for name in "abc")
    codes = {a: "from torchrbd.robot.b import g", b: "from torchrbd.robot.c import h"}
    assert circle({**codes, c: "import torch"}) == []
    assert {"torchrbd.robot.a", "torchrbd.robot.b", "torchrbd.robot.c"} == set(circle({**codes, c: back}))


def test_a_file_that_imports_its_own_package_is_a_circle() -> None:
    package = {Path("robot/__init__.py"): "from torchrbd.robot.a import f", Path("robot/b.py"): "import torch"}
    assert circle({**package, Path("robot/a.py"): "from torchrbd.robot import b"}) == []
    assert circle({**package, Path("robot/a.py"): "from torchrbd.robot import b, g"})


def compared_ids(code: str, ids: Collection[str]) -> list[str]:
    """Return ids of effects that code compares something with, other than the form of a location."""
    found = []
    for node in (n for n in ast.walk(ast.parse(code)) if isinstance(n, ast.Compare)):
        sides = [node.left, *node.comparators]
        if any("form" in (getattr(side, "id", ""), getattr(side, "attr", "")) for side in sides):
            continue
        each = [
            one for side in sides for one in (side.elts if isinstance(side, (ast.Tuple, ast.List, ast.Set)) else [side])
        ]
        found += [one.value for one in each if isinstance(one, ast.Constant) and one.value in ids]
    return found


def test_effects_differ_by_their_attributes_and_not_by_their_ids() -> None:
    others = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] != "effects"]
    compared = {path: compared_ids(path.read_text(), torchrbd.known_effects()) for path in others}
    assert {path: ids for path, ids in compared.items() if ids} == {}


@pytest.mark.parametrize(
    "code",
    ["e.id == 'joint_spring'", "f.effect in ('payload', 'base_tilt')", "'time_delay' != name", "x[e.id == 'payload']"],
)
def test_compared_ids_are_seen(code: str) -> None:
    assert compared_ids(code, torchrbd.known_effects())
    assert not compared_ids("part.form == 'payload'", torchrbd.known_effects())
