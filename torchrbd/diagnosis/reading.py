"""What ``diagnose -o`` wrote, as the parts of a ``Diagnosis``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_type_hints

from torchrbd._runtime.rebuilding import Unsaved, read_json, rebuilt
from torchrbd.diagnosis.ranked import Ranked, Ranking
from torchrbd.errors import InputError
from torchrbd.likelihood.misfit import Misfit

_FILE = "diagnosis.json"
# Parts under other keys than their own names.
_KEYS = {"maps": "residual_maps"}


def read_diagnosis(kind: type, folder: str | Path) -> dict[str, Any]:
    """Return the parts of a diagnosis that its file holds, by name, except the identification.

    Args:
        kind: the dataclass whose parts these are.
        folder: that ``diagnose -o`` wrote.

    Raises:
        InputError: the file is missing, or none of ours.
    """
    folder = Path(folder)
    content, types = read_json(folder / _FILE, "diagnose"), get_type_hints(kind)
    names = [name for name in types if name not in ("identification", "ranking", "card", "in_words")]
    try:
        found = {name: rebuilt(types[name], content[_KEYS.get(name, name)]) for name in names}
        ranking = content["ranking"]
        return found | {"ranking": None if ranking is None else _ranking(ranking, folder)}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{folder / _FILE}: is no {_FILE} as this version of torchrbd writes it ({type(error).__name__}: {error}); "
            "diagnose the recordings again"
        ) from None


def _ranking(content: dict[str, Any], folder: Path) -> Ranking:
    lists = {name: tuple(_ranked(one) for one in content[name]) for name in ("ordinary", "first", "adopted", "last")}

    def no_evidence(*_: object) -> float:
        return Unsaved(
            folder, "the data that evidence is computed from", "use torchrbd.rank_hypotheses on the recordings"
        ).evidence

    return Ranking(
        band_hz=float(content["band_hz"]),
        delay_s={name: (float(one["value"]), float(one["std"])) for name, one in content["delay_s"].items()},
        considered=int(content["considered"]),
        misfit=rebuilt(dict[str, Misfit], content["misfit"]),
        evidence_source=no_evidence,
        **lists,
    )


def _ranked(content: dict[str, Any]) -> Ranked:
    window = content["window"]
    return rebuilt(Ranked, {**content, "window": None if window is None else tuple(window.values())})
