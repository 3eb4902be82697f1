"""Rank all hypotheses on every raw case, and ask the same likelihood about the truth.

    python -m benchmarks.concealed.raw.rank DIR -o OUT [-j N] [--option KEY=VALUE ...]

writes OUT/<id>.json: {"id", "first": [H], "last": [H], "oracle": [nats or null], "seconds", "oracle_seconds",
"peak_mb"}, or {"id", "error", "traceback", "seconds"}. A hypothesis H is {"effect", "joints", "links", "log_evidence",
"parameters"} and whatever else of ``EXTRA`` it has. Cases that have their file are kept. The truth is read when a case
has its ranking; the oracle is told effect, place, shape and window, and fits the rest.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import re
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ..parameters import SHAPES
from ..workers import workers

EXTRA = ("other", "window", "shape")
"""Attributes of a hypothesis that are written where it has them."""
RANKING = "torchrbd.diagnosis.ranking"
_TOLD = SHAPES | {"side"}


def find_ranker() -> Callable[..., Any]:
    """Return the product's ranking.

    Raises:
        SystemExit: this version has none.
    """
    try:
        return importlib.import_module(RANKING).rank_hypotheses
    except (ImportError, AttributeError) as error:
        raise SystemExit(f"{RANKING}.rank_hypotheses cannot be imported ({error}): nothing to benchmark") from None


def told(true: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the oracle is told of a concealed effect: keywords of ``evidence_of``."""
    known = true["parameters"]
    shape = {k: v for k, v in known.items() if k in _TOLD}
    if "delay" in known:
        shape["step"] = known["delay"]
    if true["other"]:
        shape["other"] = true["other"]
    times, files = true["where"]["time_s"], true["where"]["recordings"]
    window = (files[0], *times[0]) if times and files else None
    return {
        "effect": true["effect"],
        "joints": tuple(true["joints"]),
        "links": tuple(true["links"]),
        "shape": shape or None,
        "window": window,
    }


def written(hypothesis: Any) -> dict[str, Any]:
    """Return a hypothesis as JSON has it."""
    more = {k: _plain(getattr(hypothesis, k)) for k in EXTRA if getattr(hypothesis, k, None) is not None}
    return {
        "effect": hypothesis.effect,
        "joints": list(hypothesis.joints),
        "links": list(hypothesis.links),
        "log_evidence": _plain(hypothesis.log_evidence),
        "parameters": {k: _plain(v) for k, v in dict(hypothesis.parameters).items()},
        **more,
    }


def _plain(value: Any) -> Any:
    """Return numbers, texts and lists of them; infinities and NaN are none."""
    if isinstance(value, str) or value is None:
        return value
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(v) for v in value]
    try:
        number = float(value)
    except (TypeError, ValueError):
        return str(value)
    return number if math.isfinite(number) else None


def rank_case(rank: Callable[..., Any], options: Mapping[str, Any], truths: Path, case: Path, out: Path) -> None:
    """Rank one case and write its file."""
    _forget_peak()
    start = time.perf_counter()
    try:
        ranking = rank(case / "robot.urdf", sorted(case.glob("fit_*.parquet")), **options)
    except Exception as error:
        # A case that ends in an error is an outcome to be counted, not a reason to stop.
        failure = {"error": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
        _write({"id": case.name, **failure, "seconds": time.perf_counter() - start}, out / f"{case.name}.json")
        return
    seconds, peak = time.perf_counter() - start, _peak_mb()
    result = {"id": case.name, **{k: [written(h) for h in getattr(ranking, k)] for k in ("first", "last")}}
    truth, start = json.loads((truths / f"{case.name}.json").read_text()), time.perf_counter()
    result["oracle"] = [_evidence(ranking, true) for true in truth["effects"]]
    figures = {"seconds": seconds, "oracle_seconds": time.perf_counter() - start, "peak_mb": peak}
    _write(result | figures, out / f"{case.name}.json")


def _write(content: Any, path: Path) -> None:
    unfinished = path.with_suffix(".unfinished")
    unfinished.write_text(json.dumps(content, indent=1), encoding="utf-8")
    unfinished.replace(path)


def _evidence(ranking: Any, true: Mapping[str, Any]) -> float | None:
    try:
        return _plain(ranking.evidence_of(**told(true)))
    except Exception as error:
        print(f"no evidence of {true['effect']}: {type(error).__name__}: {error}")
        return None


def _forget_peak() -> None:
    """Let the system count this process's peak memory anew, where it can."""
    clear = Path("/proc/self/clear_refs")
    if clear.exists():
        clear.write_text("5")


def _peak_mb() -> float | None:
    status = Path("/proc/self/status")
    found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text()) if status.exists() else None
    return int(found[1]) / 1024 if found else None


def rank_folder(folder: Path, out: Path, jobs: int, options: Mapping[str, Any], rank: Callable[..., Any]) -> None:
    """Rank all cases of a folder that have no file yet."""
    out.mkdir(parents=True, exist_ok=True)
    todo = [case for case in sorted((folder / "cases").iterdir()) if not (out / f"{case.name}.json").exists()]
    work = partial(rank_case, rank, options, folder / "truth")
    if jobs == 1:
        for number, case in enumerate(todo, 1):
            work(case, out)
            print(f"{number} of {len(todo)}: {case.name}", flush=True)
        return
    with workers(jobs, _one_thread) as pool:
        for done in [pool.submit(work, case, out) for case in todo]:
            done.result()


def _one_thread() -> None:
    import torch

    torch.set_num_threads(1)


def _option(text: str) -> tuple[str, Any]:
    key, _, value = text.partition("=")
    try:
        return key, json.loads(value)
    except json.JSONDecodeError:
        return key, value


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line and rank."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="DIR", help="with cases and truth")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("-j", "--jobs", type=int, default=1, help="processes")
    parser.add_argument(
        "--option", type=_option, action="append", default=[], metavar="KEY=VALUE", help="of the ranking"
    )
    args = parser.parse_args(arguments)
    rank = find_ranker()
    _one_thread()
    rank_folder(args.folder, args.output, args.jobs, dict(args.option), rank)


if __name__ == "__main__":
    main()
