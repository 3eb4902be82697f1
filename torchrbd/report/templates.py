"""The templates of pages and cards; every name that they show is escaped."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from torchrbd.report.text.names import parameter_words
from torchrbd.report.text.numbers import change, measure, number, plain, probability, sentence, tied, unit, with_unit


@cache
def environment() -> Environment:
    """Return where templates are found, with filters for numbers and sentences; each template is compiled once."""
    found = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters |= {"number": number, "measure": measure, "percent": probability, "change": change}
    found.filters |= {"plain": plain, "unit": unit, "with_unit": with_unit, "tied": tied, "sentence": sentence}
    found.filters |= {"parameter_words": parameter_words}
    return found
