"""XML of robots, read safely: nothing in it is fetched, replaced or run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import lxml.etree as etree

from torchrbd.errors import RobotError

# Largest size of a robot's file [bytes].
_LARGEST_FILE = 64 << 20
# Entities are not replaced, nothing is fetched, and the size of the text is limited.
_SAFELY: dict[str, Any] = {"resolve_entities": False, "no_network": True, "load_dtd": False, "huge_tree": False}


def load(source: str | Path | bytes) -> tuple[str, bytes]:
    """Return the name of a robot's file or text in messages, and its text.

    Raises:
        RobotError: it cannot be read, or is too large for a robot.
    """
    if isinstance(source, bytes):
        return "URDF text", source
    if isinstance(source, str) and "<" in source:
        # The text is already decoded: remove a header, which might name another encoding.
        return "URDF text", re.sub(r"^\s*<\?xml[^>]*\?>", "", source).encode()
    path = Path(source)
    if path.suffix == ".xacro":
        made = path.with_suffix("") if path.with_suffix("").suffix == ".urdf" else path.with_suffix(".urdf")
        raise RobotError(f"{source}: is xacro, from which a URDF is made: xacro {source} > {made.name}")
    try:
        if (size := path.stat().st_size) > _LARGEST_FILE:
            raise RobotError(f"{source}: is {size >> 20} MB large; expected a URDF, at most {_LARGEST_FILE >> 20} MB")
        return str(source), path.read_bytes()
    except OSError as error:
        raise RobotError(f"{source}: cannot read the URDF file ({error.strerror}); check the path") from error


def parse(where: str, text: bytes) -> etree._Element:
    """Return the root of plain, well-formed XML.

    Raises:
        RobotError: it is not well-formed, or declares entities.
    """
    if not text.strip():
        raise RobotError(f"{where}: the file is empty; expected a URDF or MJCF file")
    try:
        root = etree.fromstring(text.strip(), etree.XMLParser(remove_comments=True, remove_pis=True, **_SAFELY))
    except etree.XMLSyntaxError as error:
        raise RobotError(f"{where}: not well-formed XML: {error.msg}; expected a URDF or MJCF file") from error
    if root.getroottree().docinfo.doctype or any(isinstance(one, etree._Entity) for one in root.iter()):
        raise RobotError(f"{where}: declares a document type or entities, which no robot needs; remove <!DOCTYPE ...>")
    return root
