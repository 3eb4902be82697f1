"""JSON schemas of the files that people and programs write and read: mappings, robots, options, results."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, get_type_hints

from pydantic import TypeAdapter, create_model

from torchrbd.diagnosis import Diagnosis
from torchrbd.export.json_files import SCHEMA
from torchrbd.inference import Identification
from torchrbd.inference.robots_file import RobotsFile
from torchrbd.options import Options, plain_words, spelling, spelt
from torchrbd.recordings.mapping_file import MappingFile

NAMES = "mapping", "robots", "config", "diagnosis"
"""Of the schemas."""
_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema(name: str) -> dict[str, Any]:
    """Return the JSON schema of one kind of file; ``NAMES`` lists them."""
    made = {"mapping": MappingFile.model_json_schema, "robots": RobotsFile.model_json_schema, "config": _config}
    return {"$schema": _DIALECT, **(made[name]() if name in made else _diagnosis())}


def _config() -> dict[str, Any]:
    """Return what ``--config`` understands: the options, as the command line spells them."""
    properties = {spelt(f.name): {"description": plain_words(f.name), **_value(f)} for f in fields(Options)}
    return {
        "title": "Options",
        "description": "Options of 'torchrbd identify' and 'diagnose'; underscores do as well as dashes.",
        "type": "object",
        "properties": properties,
        "additionalProperties": False,
    }


def _value(option: Any) -> dict[str, Any]:
    """Return what may be the value of an option."""
    how = spelling(option)
    one: dict[str, Any] = {"type": {float: "number", int: "integer"}.get(how.kind, "string")}
    if how.choices:
        one["enum"] = list(how.choices)
    if how.count > 1:
        return {"type": "array", "items": one, "minItems": how.count, "maxItems": how.count}
    forms = [one, {"type": "array", "items": one}] if how.many else [one]
    if option.name == "time":
        forms.append({"type": "array", "items": {"type": ["number", "null"]}, "minItems": 2, "maxItems": 2})
    if option.name in ("encoder_noise", "time_limit"):
        forms.append({"type": "number"})
    if option.name == "encoder_noise":
        forms.append({"type": "object", "additionalProperties": {"type": "number"}})
    return forms[0] if len(forms) == 1 else {"anyOf": forms}


def _diagnosis() -> dict[str, Any]:
    """Return what diagnosis.json holds: the parts of a ``Diagnosis``, and what its identification says."""
    own, other = get_type_hints(Diagnosis), get_type_hints(Identification)
    names = [f.name for f in fields(Diagnosis) if f.name not in ("identification", "ranking")]
    parts = {{"maps": "residual_maps"}.get(name, name): own[name] for name in names}
    head = {"fit": other["fits"], **{name: other[name] for name in ("recordings", "held_out", "cutoff_hz")}}
    head |= {
        "robot": str,
        "statement": str,
        "joints": tuple[str, ...],
        "doubts": tuple[str, ...],
        "notes": tuple[str, ...],
        "suspicions_tested": tuple[str, ...],
    }
    head |= {"suspicions": get_type_hints(other["suspicions"])["found"], "simulation": other["simulation"]}
    head |= {name: other[name] for name in ("closed_loop", "gains")}
    keys: dict[str, Any] = {name: (kind, ...) for name, kind in (head | parts).items()}
    adapter = TypeAdapter(create_model("Diagnosis", **keys))
    made = adapter.json_schema(mode="serialization")
    made["properties"] |= {"schema": {"const": SCHEMA}, "ranking": {"anyOf": [{"type": "object"}, {"type": "null"}]}}
    made["description"] = "What 'torchrbd diagnose' finds. Keys may be added, and are never renamed."
    return _with_null(made)


def _with_null(value: Any) -> Any:
    """Return a schema in which numbers may be null: JSON has no word for those that are not finite."""
    if isinstance(value, list):
        return [_with_null(one) for one in value]
    if not isinstance(value, dict):
        return value
    found = {key: _with_null(one) for key, one in value.items()}
    return found | {"type": ["number", "null"]} if value.get("type") == "number" else found
