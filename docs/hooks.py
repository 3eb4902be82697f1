"""What mkdocs does besides writing pages: pages of the API and of the effects, formulas as MathML.

API: a page for each package of ``torchrbd`` that has public names, from their docstrings. Formulas: ``$...$`` and
``$$...$$`` in a page become MathML, which browsers draw themselves. Effects: see ``gallery.py``.
"""

from __future__ import annotations

import inspect
import re
import sys
from html import unescape
from importlib import import_module
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

import torchrbd

_FORMULA = re.compile(r'<(span|div) class="arithmatex">\s*\\([(\[])(.*?)\\[)\]]\s*</\1>', re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages and their places in the navigation."""
    sys.path.insert(0, str(Path(__file__).parent))
    gallery = import_module("gallery")
    api = api_pages()
    for address, content in (api | gallery.pages()).items():
        files.append(File.generated(config, address, content=content))
    _place(config.nav, "API", list(api))
    _place(config.nav, "Effects", gallery.navigation())
    return files


def on_page_content(html: str, **_: Any) -> str:
    """Write formulas as MathML."""
    return _FORMULA.sub(_mathml, html)


def _mathml(found: re.Match[str]) -> str:
    display = "inline" if found[2] == "(" else "block"
    return convert(unescape(found[3]), display=display)


def api_pages() -> dict[str, str]:
    """Return the pages of the API by address: an index, and the public names of each package."""
    packages = {package: names for package, names in torchrbd._NAMES.items() if names}
    pages = {f"api/{package}.md": _api_page(package, names) for package, names in packages.items()}
    rows = [
        f"| [`torchrbd.{package}`]({package}.md) | {_summary(package)} | "
        f"{', '.join(f'[`{name}`][torchrbd.{package}.{name}]' for name in names)} |"
        for package, names in packages.items()
    ]
    head = "# API\n\nEvery public name is imported from `torchrbd`: `torchrbd.diagnose`, `torchrbd.Recording`.\n\n"
    table = "| package | purpose | names |\n| --- | --- | --- |\n"
    return {"api/index.md": head + table + "\n".join(rows) + "\n"} | pages


def _api_page(package: str, names: tuple[str, ...]) -> str:
    head = f"# torchrbd.{package}\n\n{_summary(package)}\n"
    return "\n".join([head, *(f"::: torchrbd.{package}.{name}\n" for name in names)])


def _summary(package: str) -> str:
    return (inspect.getdoc(import_module(f"torchrbd.{package}")) or "").partition("\n")[0]


def _place(nav: Any, title: str, addresses: list[Any]) -> None:
    """Replace the entries under a title of the navigation."""
    for entry in nav:
        if title in entry:
            entry[title] = addresses
