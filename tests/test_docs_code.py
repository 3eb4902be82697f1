"""Every block of code in the README and on the documentation site runs.

A page is one test. Its blocks run in order, in one Python namespace, in one folder with recordings and the URDF of an
arm, which are made from the bundled demo. A comment in the line above a block says how it is treated:

    <!-- no-run: why -->    needs hardware, other packages or the internet
    <!-- slow: why -->      runs with -m slow alone
    <!-- data: panda -->    the same, in the folder that TORCHRBD_DATA names, where that has this set

A block of YAML whose info line has ``title="driver.yaml"`` is written to that file first.
"""

from __future__ import annotations

import contextlib
import glob
import io
import os
import re
import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

import torchrbd
from torchrbd.cli import main
from torchrbd.recordings import mapping, mapping_file

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").rglob("*.md") if "adr" not in p.parts)]
FENCE = re.compile(
    r"^(?P<indent>[ ]*)(?:<!-- (?P<mark>no-run|slow|data): (?P<why>.+?) -->\n+[ ]*)?"
    r"```(?P<language>\w+)(?P<info>[^\n]*)\n(?P<text>.*?)^[ ]*```$",
    re.MULTILINE | re.DOTALL,
)
RUN = {"python", "bash", "console", "yaml"}
# Of these nothing runs: formulas, files and what a program prints.
SHOWN = {"text", "json", "mermaid", "xml", "ini", "toml"}
RATE_HZ = 83  # a third of the demo's: short tests


@dataclass(frozen=True)
class Block:
    """One block of code: where it stands, its language, its mark (or None) and the text."""

    place: str
    language: str
    mark: str | None
    why: str
    title: str
    text: str


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page."""
    text, found = page.read_text(encoding="utf-8"), []
    for m in FENCE.finditer(text):
        title = re.search(r'title="([^"]+)"', m["info"])
        lines = [line.removeprefix(m["indent"]) for line in m["text"].splitlines()]
        place = f"{page.relative_to(ROOT)}:{text[: m.start('language')].count(chr(10)) + 1}"
        code = "\n".join(lines) + "\n"
        found.append(Block(place, m["language"], m["mark"], m["why"] or "", title[1] if title else "", code))
    return found


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder as a reader may have it: a URDF, recordings, results of a diagnosis."""
    into, demo = tmp_path_factory.mktemp("docs"), ROOT / "torchrbd" / "demo"
    fit, judge = (pd.read_parquet(demo / f"{name}.parquet") for name in ("fit", "holdout"))
    shutil.copy(demo / "arm.urdf", into / "robot.urdf")
    days = {"monday": (fit, 0, 12), "tuesday": (fit, 24, 40), "wednesday": (judge, 0, 10)}
    for name, (table, start, end) in days.items():
        part = table[(table.t >= start) & (table.t < end)].iloc[::3]
        part.assign(t=(part.t - part.t.iloc[0]).round(4)).to_csv(into / f"{name}.csv", index=False)
    monday = pd.read_csv(into / "monday.csv")
    driver: dict[str, Any] = {"stamp": 1e3 * monday.t}
    driver |= {f"pos_{k}": np.degrees(monday[f"q_joint{k + 1}"]) for k in range(6)}
    driver |= {f"current_{k}": monday[f"tau_joint{k + 1}"] / (0.1 * 100.0) for k in range(6)}  # K_t, gear ratio
    pd.DataFrame(driver).to_csv(into / "driver.csv", index=False, float_format="%.9g")
    return into


class Runner:
    """Run blocks as a reader would; the same command or diagnosis is worked on once."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.done: set[tuple[str, ...]] = set()
        self.diagnoses: dict[str, Any] = {}
        self.names: dict[str, Any] = {}

    def run(self, block: Block) -> None:
        """Run one block in the folder."""
        getattr(self, block.language)(block)

    def python(self, block: Block) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(block.text, block.place, "exec"), self.names)

    def yaml(self, block: Block) -> None:
        content = yaml.safe_load(block.text)
        if block.title:
            (self.folder / block.title).write_text(block.text, encoding="utf-8")
        if isinstance(content, dict) and set(content) & {"time", "topic", "episodes", "torque_delay"}:
            path = self.folder / (block.title or "some.yaml")
            path.write_text(block.text, encoding="utf-8")
            torchrbd.read_mapping(path)

    def console(self, block: Block) -> None:
        lines = [line[2:] for line in block.text.splitlines() if line.startswith("$ ")]
        assert lines, f"{block.place}: no line begins with '$ '"
        self.commands(block.place, lines)

    def bash(self, block: Block) -> None:
        self.commands(block.place, block.text.replace("\\\n", " ").splitlines())

    def commands(self, place: str, lines: list[str]) -> None:
        for line in lines:
            words = shlex.split(line, comments=True)
            if words:
                self.command(place, [found for word in words for found in sorted(glob.glob(word)) or [word]])

    def command(self, place: str, words: list[str]) -> None:
        name, *arguments = words
        if tuple(words) in self.done:
            return
        if name == "torchrbd":
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
                try:
                    code = main(arguments)
                except SystemExit as end:  # --help, --version
                    code = end.code
            assert not code, f"{place}: {' '.join(words)}\n{printed.getvalue()}"
        elif name == "make":
            targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
            assert set(arguments) <= set(targets), place
        elif name in ("cp", "mv"):
            source, target = (self.folder / word for word in arguments[-2:])
            (shutil.move if name == "mv" else shutil.copytree)(source, target)
        else:
            raise AssertionError(f"{place}: no way to run '{' '.join(words)}'; mark the block")
        self.done.add(tuple(words))

    def diagnose(self, robot: Any, recordings: Any, *, progress: Any = None, **options: Any) -> Any:
        """Diagnose what was not diagnosed with these arguments yet, in Python or by a command."""
        key = repr(_as_text((robot, recordings, sorted(options.items()))))
        if key not in self.diagnoses:
            self.diagnoses[key] = _DIAGNOSE(robot, recordings, **options)
        return self.diagnoses[key]


def _as_text(given: Any) -> Any:
    """Return arguments with paths as text and lists as tuples."""
    return tuple(map(_as_text, given)) if isinstance(given, list | tuple) else str(given)


_DIAGNOSE = torchrbd.diagnose


@pytest.fixture(scope="session")
def runner(folder: Path) -> Runner:
    return Runner(folder)


@pytest.fixture
def reader(runner: Runner, monkeypatch: pytest.MonkeyPatch, fit_alone: None) -> Runner:
    """Return the runner at the start of a page."""
    monkeypatch.chdir(runner.folder)
    for module in (torchrbd, torchrbd.diagnosis):
        monkeypatch.setattr(module, "diagnose", runner.diagnose)
    runner.names = {"__name__": "__main__"}
    out = ("diagnose", "robot.urdf", "monday.csv", "--holdout", "wednesday.csv", "-o", "out")
    runner.command("the folder", ["torchrbd", *out])
    for name in ("before", "after"):
        if not (runner.folder / name).exists():
            shutil.copytree(runner.folder / "out", runner.folder / name)
    return runner


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_block_says_what_it_is(page: Path) -> None:
    fences = re.findall(r"^ *```", page.read_text(encoding="utf-8"), re.MULTILINE)
    found = blocks(page)
    assert 2 * len(found) == len(fences), "a block without an end, or without a language"
    for block in found:
        assert block.language in RUN | SHOWN, f"{block.place}: nobody runs {block.language}"
        if block.mark == "no-run":
            assert len(block.why.split()) >= 3, f"{block.place}: say why it does not run"


@pytest.mark.usefixtures("without_joint_figures")
@pytest.mark.parametrize("page", [p for p in PAGES if any(b.language in RUN for b in blocks(p))], ids=named)
def test_blocks_of_a_page_run(page: Path, reader: Runner) -> None:
    for block in blocks(page):
        if block.mark is None and block.language in RUN:
            reader.run(block)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*treespec, LeafSpec:FutureWarning", "ignore::DeprecationWarning:onnx.*")  # PyTorch
@pytest.mark.parametrize("page", [p for p in PAGES if any(b.mark in ("slow", "data") for b in blocks(p))], ids=named)
def test_slow_blocks_of_a_page_run(page: Path, reader: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    data = os.environ.get("TORCHRBD_DATA", "")
    for block in blocks(page):
        if block.language not in RUN or block.mark == "no-run":
            continue
        if block.mark == "data":
            if not (Path(data) / block.why).is_dir():
                continue
            for entry in Path(data).iterdir():
                link = reader.folder / entry.name
                if entry.is_dir() and not link.exists():
                    link.symlink_to(entry)
        reader.run(block)


def help_of(*command: str) -> str:
    """Return what a command prints for --help."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([*command, "--help"])
    return printed.getvalue()


def test_options_in_the_text_exist() -> None:
    commands = re.findall(r"^[│ ]+([a-z][a-z-]+) {2,}[A-Z]", help_of(), re.MULTILINE)
    assert {"diagnose", "identify", "excite", "fleet", "inspect"} <= set(commands)
    helps = "".join(map(help_of, commands))
    known = set(re.findall(r"--[a-z][a-z-]*", helps)) | {"--help", "--csv"}  # of `ros2 topic echo`
    for page in PAGES:
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        named = {m for code in re.findall(r"`([^`\n]+)`", text) for m in re.findall(r"(?<![\w-])--[a-z][a-z-]*", code)}
        named -= {"--check"} if "python benchmarks" in text else set()
        assert named <= known, f"{page.name}: {', '.join(sorted(named - known))}"


def test_the_number_of_effects_is_that_of_the_registry() -> None:
    words = f"{len(torchrbd.known_effects())} effects"
    for page in (ROOT / "README.md", ROOT / "docs" / "images" / "overview.svg"):
        assert re.findall(r"\d+\s+effects", page.read_text(encoding="utf-8")) == [words], page


def test_the_page_of_mappings_has_every_key_and_unit() -> None:
    text = (ROOT / "docs" / "guide" / "recordings.md").read_text(encoding="utf-8")
    keys = {*mapping_file.KEYS, *mapping.TIME_UNITS}
    units = {unit for units in mapping.UNITS.values() for unit in units} | set(mapping.CURRENT_UNITS)
    assert [word for word in sorted(keys | units) if f"`{word}`" not in text] == []


def test_a_block_that_fails_is_seen(tmp_path: Path) -> None:
    text = "x\n\n```bash\ntorchrbd diagnos\n```\n\n<!-- slow: it waits -->\n```python\n1/0\n```\n"
    bash, python = FENCE.finditer(text)
    assert (bash["language"], bash["mark"]) == ("bash", None)
    assert (python["language"], python["mark"], python["why"]) == ("python", "slow", "it waits")
    run = Runner(tmp_path)
    with pytest.raises(AssertionError, match="diagnos"):
        run.bash(Block("page.md:3", "bash", None, "", "", bash["text"]))
    with pytest.raises(ZeroDivisionError):
        run.python(Block("page.md:8", "python", None, "", "", python["text"]))
