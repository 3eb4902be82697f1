"""Importing torchrbd and asking the command for help are quick: what takes long is imported when there is work."""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import torchrbd

HEAVY = {
    "jinja2", "lxml", "matplotlib", "numpy", "pyarrow", "pydantic", "pytorch_kinematics", "scipy", "sklearn", "torch",
    "yaml", "yourdfpy",
}  # fmt: skip
HELP = "import contextlib\nfrom torchrbd.cli import main\nwith contextlib.suppress(SystemExit):\n    main({})"


def modules_after(code: str) -> set[str]:
    """Return the modules that a new Python has imported after some code."""
    show = f"{code}\nimport sys\nprint('\\n', *sys.modules)"
    told = subprocess.run([sys.executable, "-c", show], check=True, capture_output=True, text=True).stdout
    return set(told.splitlines()[-1].split())


@pytest.mark.parametrize(
    "code",
    [
        "import torchrbd",
        "from torchrbd import OptionError",
        *(
            HELP.format(arguments)
            for arguments in (
                ["--help"],
                ["--version"],
                ["identify", "--help"],
                ["diagnose", "--help"],
                ["compare-estimators", "--help"],
                ["export", "--help"],
                ["stats", "--help"],
                ["fleet", "--help"],
                ["excite", "--help"],
                ["diagnose"],
            )
        ),
    ],
)
def test_nothing_heavy_is_imported_before_there_is_work(code: str) -> None:
    assert {name.partition(".")[0] for name in modules_after(code)} & HEAVY == set()


def test_work_does_without_figures_learners_and_the_compiler() -> None:
    modules = modules_after("import torchrbd; torchrbd.identify; torchrbd.diagnose")
    assert modules & {"matplotlib", "jinja2", "sklearn", "torch._dynamo"} == set()


def test_every_public_name_is_there() -> None:
    for name in torchrbd.__all__:
        assert getattr(torchrbd, name) is not None
        assert name in dir(torchrbd)
    for room in ("effects", "inference", "parameters"):
        assert getattr(torchrbd, room) is import_module(f"torchrbd.{room}")
    with pytest.raises(AttributeError, match="'torchrbd' has no attribute 'identfy'"):
        torchrbd.identfy  # type: ignore[attr-defined]  # noqa: B018


def test_no_module_has_a_public_name() -> None:
    """Else the name would be the module as soon as somebody has imported that."""
    folder = Path(torchrbd.__file__).parent
    assert {path.stem for path in folder.iterdir()} & set(torchrbd.__all__) == set()


def test_type_checkers_are_told_the_same_names() -> None:
    stub = ast.parse(Path(torchrbd.__file__).with_suffix(".pyi").read_text())
    imported = {
        alias.name: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert imported == {name: f"torchrbd.{room}" for name, room in torchrbd._ROOM_OF.items()}
    (told,) = (node.value for node in stub.body if isinstance(node, ast.Assign))
    assert ast.literal_eval(told) == torchrbd.__all__
