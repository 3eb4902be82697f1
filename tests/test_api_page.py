"""docs/api.md is what the docstrings say, and readable."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

import torchrbd

DOCS = Path(__file__).parent.parent / "docs"


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_api", DOCS / "make_api.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_up_to_date(maker: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert maker.main(["--check"]) == 0, "run python docs/make_api.py"
    other = tmp_path / "api.md"
    assert maker.main(["--check"], other) == 1
    other.write_text(maker.page() + "\nmore\n", encoding="utf-8")
    assert maker.main(["--check"], other) == 1
    assert capsys.readouterr().err.count("api.md differs from the docstrings: run python docs/make_api.py") == 2
    assert maker.main([], other) == 0
    assert maker.main(["--check"], other) == 0


def test_every_public_name_has_one_heading_and_a_link_to_it() -> None:
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    headings = re.findall(r"^### (\w+)$", text, re.MULTILINE)
    assert sorted(headings) == torchrbd.__all__
    links = re.findall(r"\[(\w+)\]\(#(\w+)\)", text)
    assert links == [(name, name.lower()) for name in headings]
    assert len({name.lower() for name in headings}) == len(headings)
    assert "#### RigidBodyDynamics.step" in text
    assert "#### RigidBodyDynamics.training" not in text, "what torch writes is not ours"


DOCSTRING = """Return ``x`` of <dynamics>, (*batch, n).

    tau = Y pi

More,
of ``two`` lines.

Args:
    q, qd: (*batch, n) [rad],
        and on.
    **options: those of ``identify``.

Returns:
    (*batch,), never None.

Raises: RobotError naming
    the link.

Example:
    >>> run(**options)
"""
PAGE = """Return `x` of \\<dynamics>, (\\*batch, n).

```
tau = Y pi
```

More,
of `two` lines.

**Args**

- `q, qd`: (\\*batch, n) [rad], and on.
- `**options`: those of `identify`.

**Returns:** (\\*batch,), never None.

**Raises:** RobotError naming the link.

**Example**

```python
>>> run(**options)
```"""


def test_a_docstring_as_markdown(maker: ModuleType) -> None:
    assert maker.markdown(DOCSTRING) == PAGE


def test_signatures(maker: ModuleType) -> None:
    def short(self: object, a: int, *more: str, key: float = 1.0, f: object = print, **rest: int) -> None: ...

    def long(a: int, *, first_of_two_names: tuple[float, ...] = (), the_second_of_two_names: str = "x" * 50) -> str: ...

    told = "short(a: int, *more: str, key: float = 1.0, f: object = ..., **rest: int) -> None"
    assert maker.signature("short", short) == told
    assert maker.signature("long", long).splitlines() == [
        "long(",
        "    a: int,",
        "    *,",
        "    first_of_two_names: tuple[float, ...] = (),",
        "    the_second_of_two_names: str = ...,",
        ") -> str",
    ]


def test_type_checkers_use_the_packages_types() -> None:
    assert Path(torchrbd.__file__).with_name("py.typed").is_file()
