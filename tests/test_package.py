"""The package says of itself what is true: version, links, files that it needs, extras."""

from __future__ import annotations

import re
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
import yaml

import torchrbd

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib  # type: ignore[no-redef]

ROOT = Path(__file__).parent.parent
LINK = re.compile(r"\]\(([^)\s]+)\)")


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def long_description() -> str:
    """Return README.md as the wheel has it: with the substitutions of pyproject.toml."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for rule in project()["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    return text


def test_the_version_is_the_installed_one() -> None:
    assert torchrbd.__version__ == metadata.version("torchrbd")


def test_a_source_tree_has_a_version_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", missing)
    monkeypatch.delitem(vars(torchrbd), "__version__", raising=False)
    assert torchrbd.__version__ == "0.0.0+source"
    monkeypatch.delitem(vars(torchrbd), "__version__")


def test_links_of_the_long_description_are_absolute() -> None:
    links = LINK.findall(long_description())
    assert links
    assert [link for link in links if not link.startswith(("https://", "#"))] == []


def test_links_of_the_long_description_name_files_that_exist() -> None:
    inside = re.findall(r"torchrbd/torchrbd/(?:blob/)?main/([^)#\s]+)", long_description())
    assert inside
    assert [path for path in inside if not (ROOT / path).exists()] == []


def test_the_extra_all_holds_every_extra_of_users() -> None:
    extras = project()["project"]["optional-dependencies"]
    for_developers = {"all", "dev", "docs", "test", "examples", "benchmark"}
    (everything,) = extras["all"]
    assert everything == f"torchrbd[{','.join(name for name in extras if name not in for_developers)}]"


def test_every_data_file_of_the_package_is_in_the_wheel() -> None:
    """The wheel takes the folder as it is; nothing in it may be ignored by git, which hatch leaves out."""
    assert project()["tool"]["hatch"]["build"]["targets"]["wheel"] == {"packages": ["torchrbd"]}
    for needed in (
        "py.typed",
        "_runtime/filters.c",
        "demo/fit.parquet",
        "robot/compiled/kernels.c",
        "report/report.html.j2",
    ):
        assert (Path(torchrbd.__file__).parent / needed).is_file()


def test_the_citation_and_the_workflows_are_yaml() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["title"] == "torchrbd"
    workflows = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
    jobs = [job for path in workflows for job in yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"]]
    assert {"lint", "types", "tests", "docs", "wheel"} <= set(jobs)


def test_the_workflow_tests_every_python_that_the_classifiers_name() -> None:
    named = re.findall(r"Python :: (3\.\d+)", "\n".join(project()["project"]["classifiers"]))
    tests = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))["jobs"]["tests"]
    assert tests["strategy"]["matrix"]["python"] == named


def test_contributing_is_short() -> None:
    assert len((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").splitlines()) <= 60
