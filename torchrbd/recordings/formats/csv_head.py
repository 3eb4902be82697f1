"""Detect a CSV file's format from its first lines: separator, decimal sign, column names."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from torchrbd.errors import RecordingError

MISSING = ("", "nan", "NaN", "NAN", "-nan", "null", "NULL", "None", "NA", "N/A")
# Commas last: they may be decimal signs; semicolons and tabs may not.
_SEPARATORS = "\t;,"
_FIRST_CHARACTERS = 1 << 16
_WITH_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_SPREADSHEET = re.compile(r"sep=(.)\s*")


@dataclass(frozen=True)
class Head:
    """Format of a CSV file.

    Attributes:
        skip: number of lines before the first row of data.
        separator: between cells.
        decimal: "." or ",".
        columns: their names.
    """

    skip: int
    separator: str
    decimal: str
    columns: tuple[str, ...]


def is_number(text: str, decimal: str = ".") -> bool:
    """Return whether a cell is a number or empty."""
    text = text.strip()
    if text in MISSING:
        return True
    if decimal != "." and "." in text:
        return False
    try:
        float(text.replace(decimal, "."))
    except ValueError:
        return False
    return True


def first_lines(path: Path) -> list[str]:
    """Return a file's first lines, each with its end; the last may be cut.

    Raises:
        RecordingError: its bytes do not begin like ASCII.
    """
    with path.open("rb") as file:
        raw = file.read(_FIRST_CHARACTERS)
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise RecordingError(f"{path}: is written in UTF-16; save it as CSV in UTF-8")
    return StringIO(raw.decode("utf-8-sig", errors="replace"), newline="").readlines()


def read_head(path: Path) -> Head:
    """Find the header: the first line that is not a comment, or the comment just above the first row of numbers.

    Raises:
        RecordingError: there is no header, there are no rows, or a name occurs twice.
    """
    lines, comment, skip, separators = first_lines(path), "", 0, _SEPARATORS
    while skip < len(lines) and (lines[skip].startswith("#") or not lines[skip].strip()):
        comment, skip = lines[skip].lstrip("# ") if lines[skip].strip() else comment, skip + 1
    if skip < len(lines) and (found := _SPREADSHEET.fullmatch(lines[skip])):
        separators, skip = found.group(1), skip + 1
    line, rows = (lines[skip] if skip < len(lines) else ""), lines[skip + 1 :]
    separator = _separator(line, rows, separators)
    cells = _cells(line, separator)
    if cells and all(is_number(cell) or is_number(cell, ",") for cell in cells):
        cells, rows = _cells(comment, separator), lines[skip:]
        if len(cells) != len(_cells(line, separator)):
            raise RecordingError(
                f"{path}: the first row holds numbers; expected a header with the columns' names, "
                f"such as t,q_joint1,tau_joint1"
            )
    else:
        skip += 1
    if not cells:
        raise RecordingError(f"{path}: no header found; expected the columns' names in the first row")
    if not "".join(rows).strip():
        raise RecordingError(f"{path}: the file has a header but no rows")
    twice = sorted({name for name in cells if cells.count(name) > 1 and name})
    if twice:
        raise RecordingError(f"{path}: column '{twice[0]}' appears more than once in the header")
    columns = tuple(name or f"(unnamed {index})" for index, name in enumerate(cells, 1))
    return Head(skip, separator, _decimal(rows, separator), columns)


def _cells(line: str, separator: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _separator(line: str, rows: list[str], candidates: str) -> str:
    """Return the separator of cells: it occurs as often in the header as in the first row."""
    present = [mark for mark in candidates if mark in line]
    if not present:
        return " "
    row = next((row for row in rows if row.strip()), "")
    alike = [mark for mark in present if len(_cells(line, mark)) == len(_cells(row, mark))]
    return alike[0] if alike else max(present, key=line.count)


def _decimal(rows: list[str], separator: str) -> str:
    """Return the decimal sign: in half of Europe spreadsheets write 1.5 and 2.5 as 1,5;2,5."""
    cells = (cell for row in csv.reader(rows, delimiter=separator) for cell in row)
    return "," if any(_WITH_COMMA.fullmatch(cell.strip()) for cell in cells) else "."
