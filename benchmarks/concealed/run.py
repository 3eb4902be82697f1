"""Run torchrbd over a folder of concealed cases, let rivals run over the same, and score all of it.

    python -m benchmarks.concealed.run diagnose DIR... -o OUT    diagnosis.json of every case; goes on where it stopped
    python -m benchmarks.concealed.run rivals DIR... -o OUT      what other methods choose and predict
    python -m benchmarks.concealed.run oracle DIR... -o OUT      the errors of a model that is told the truth
    python -m benchmarks.concealed.run told DIR... -o OUT        what is found in real recordings where the hidden
                                                                 effect and its joint are told
    python -m benchmarks.concealed.run score DIR... -o OUT       OUT/scores.md, OUT/scores.json, OUT/calibration.svg

DIR holds ``cases/<id>`` (all that the tool sees) and ``truth/<id>.json``. Truth is read only when every case has its
output: the oracle and the scorer refuse before.
"""

from __future__ import annotations

import argparse
import json
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

import torchrbd
from torchrbd.effects.registry import PLAIN
from torchrbd.errors import InputError
from torchrbd.export import write_diagnosis
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.robot import RobotModel

from .oracle import offered, oracle_errors
from .pictures import draw_calibration
from .rival_scores import rivals_markdown, score_rivals
from .score import CaseScore, score_case, score_injected
from .tables import markdown, must_hold
from .workers import workers

DIAGNOSIS, SECONDS, SERIES = "diagnosis.json", "run.json", "series.npz"
RIVALS, ORACLE, TOLD = "rivals.json", "oracle.json", "told.json"
UNTOUCHED = "untouched"
Work = Callable[[Path, Path], None]


def recordings(case: Path) -> tuple[list[Path], list[Path]]:
    """Return the recordings of a case to fit and those to hold out."""
    return sorted(case.glob("fit_*.parquet")), sorted(case.glob("holdout*.parquet"))


def prepared(case: Path, job: str) -> Prepared:
    """Read a case as a diagnosis does; ``job`` is named in errors."""
    fit, holdout = (list(map(str, files)) for files in recordings(case))
    robot, sources, settings = read_arguments(str(case / "robot.urdf"), fit, {"holdout": holdout}, job)
    return prepare(robot, sources, settings, ())


def diagnose_case(case: Path, out: Path) -> None:
    """Diagnose one case and write diagnosis.json, the torques it predicts, and the seconds it took.

    Args:
        case: folder with robot.urdf and recordings.
        out: folder of its outputs.
    """
    fit, holdout = recordings(case)
    start, told, mapping = time.perf_counter(), {}, case / "mapping.yaml"
    try:
        stated = mapping if mapping.exists() else None
        diagnosis, failure = torchrbd.diagnose(case / "robot.urdf", fit, holdout=holdout, mapping=stated), ""
    except Exception as error:
        # A case that ends in an error is an outcome to be counted, not a reason to stop.
        diagnosis, failure = None, f"{type(error).__name__}: {error}"
        told = {"traceback": traceback.format_exc()}
    write_json({"seconds": time.perf_counter() - start, **told}, out / SECONDS)
    # diagnosis.json comes last: where it is, the case is done.
    if diagnosis is None:
        write_json({"error": failure}, out / DIAGNOSIS)
        return
    series = diagnosis.identification.series
    np.savez_compressed(
        out / SERIES,
        held_out=series.held_out, q=series.q, qd=series.qd, measured=series.measured,
        rigid_body=series.predicted["rigid_body"], extended=series.predicted["extended"],
    )  # fmt: skip
    write_diagnosis(diagnosis, out / "diagnosis.unfinished")
    (out / "diagnosis.unfinished").replace(out / DIAGNOSIS)


def for_each_case(folder: Path, out: Path, file: str, work: Work, *, jobs: int = 1, every: int = 1) -> None:
    """Do some work on every case that does not have its file yet, behind a progress bar.

    Args:
        folder: with ``cases``.
        out: of the outputs, a folder for each case.
        file: that the work leaves in it.
        work: called with the case's folder and its output folder.
        jobs: processes.
        every: of so many cases one is taken; their names are random.
    """
    todo = [case for case in _cases(folder)[::every] if not (out / case.name / file).exists()]
    for case in todo:
        (out / case.name).mkdir(parents=True, exist_ok=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(file, total=len(todo))
        if jobs == 1:
            for case in todo:
                work(case, out / case.name)
                bar.advance(task)
            return
        with workers(jobs, partial(torch.set_num_threads, 1)) as pool:
            for done in as_completed([pool.submit(work, case, out / case.name) for case in todo]):
                done.result()
                bar.advance(task)


def read_truths(folder: Path, out: Path, file: str = DIAGNOSIS) -> list[dict[str, Any]]:
    """Return the truth of every case, once all have their output.

    Raises:
        InputError: cases without output, or without truth.
    """
    cases = _cases(folder)
    missing = [c.name for c in cases if not (out / c.name / file).exists()]
    if missing:
        raise InputError(
            f"{out}: {len(missing)} of {len(cases)} cases have no {file} yet, the first is {missing[0]}; truth is read "
            "only when all of them are written: run them first"
        )
    unknown = [c.name for c in cases if not (folder / "truth" / f"{c.name}.json").exists()]
    if unknown:
        raise InputError(f"{folder / 'truth'}: no truth of {len(unknown)} cases, the first is {unknown[0]}")
    return [_read_json(folder / "truth" / f"{c.name}.json") for c in cases]


def score_folder(folder: Path, out: Path) -> list[CaseScore]:
    """Score every case; injected ones against the untouched recordings that their truth names.

    Raises:
        InputError: see ``read_truths``.
    """
    truths, scores = read_truths(folder, out), []
    for truth in truths:
        own = out / truth["id"]
        diagnosis, seconds = _read_json(own / DIAGNOSIS), float(_read_json(own / SECONDS)["seconds"])
        if truth["tier"] == UNTOUCHED:
            continue
        if truth.get("baseline"):
            told = _read_json(own / TOLD) if (own / TOLD).exists() else None
            score = score_injected(truth, diagnosis, _read_json(out / truth["baseline"] / DIAGNOSIS), seconds, told)
            scores += [score] if score is not None else []
        else:
            oracle = _read_json(own / ORACLE) if (own / ORACLE).exists() else None
            scores.append(score_case(truth, diagnosis, seconds, oracle))
    return scores


def _oracle_case(truths: Mapping[str, dict[str, Any]], case: Path, out: Path) -> None:
    fit, holdout = recordings(case)
    write_json(oracle_errors(case / "robot.urdf", fit, holdout, truths[case.name]), out / ORACLE)


def _told_case(truths: Mapping[str, dict[str, Any]], case: Path, out: Path) -> None:
    """Search for nothing but friction, what the untouched recordings show, and what is hidden, at its joint."""
    truth, found = truths[case.name], {"findings": []}
    if truth.get("baseline"):
        shown, urdf = _read_json(out.parent / truth["baseline"] / DIAGNOSIS)["findings"], case / "robot.urdf"
        robot = RobotModel.from_urdf(urdf)
        names = set(PLAIN).union(*(offered(robot, f) for f in (*shown, *truth["effects"])))
        fit, holdout = recordings(case)
        diagnosis = torchrbd.diagnose(urdf, fit, holdout=holdout, effects=sorted(names))
        write_diagnosis(diagnosis, out / "told.unfinished")
        found = {"findings": _read_json(out / "told.unfinished")["findings"]}
        (out / "told.unfinished").unlink()
    write_json(found, out / TOLD)


def _rivals_case(case: Path, out: Path) -> None:
    # SINDy comes with an extra that only this needs.
    from .rivals import run_rivals

    fit, holdout = recordings(case)
    write_json(run_rivals(case / "robot.urdf", fit, holdout), out / RIVALS)


def _score(folders: Sequence[Path], out: Path) -> None:
    cases = [score for folder in folders for score in score_folder(folder, out)]
    text, rivals = markdown(cases), []
    for truth in (t for folder in folders for t in read_truths(folder, out)):
        own = out / truth["id"]
        if (own / RIVALS).exists() and (own / SERIES).exists():
            diagnosis = _read_json(own / DIAGNOSIS)
            rivals.append(score_rivals(truth, _read_json(own / RIVALS), diagnosis, np.load(own / SERIES)))
    if rivals:
        text += "\n" + rivals_markdown(rivals)
    held = [{"what": w, "bound": b, "holds": h, **asdict(f)} for w, f, b, h in must_hold(cases)]
    write_json({"must_hold": held, "cases": [asdict(c) for c in cases], "rivals": rivals}, out / "scores.json")
    (out / "scores.md").write_text(text, encoding="utf-8")
    draw_calibration(cases, out / "calibration.svg")
    Console(soft_wrap=True, highlight=False).print(text, markup=False)


def _cases(folder: Path) -> list[Path]:
    cases = sorted(p for p in (folder / "cases").glob("*") if p.is_dir())
    if not cases:
        raise InputError(f"{folder / 'cases'}: no case is there; generate some first")
    return cases


def _read_json(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def write_json(content: Any, path: Path) -> None:
    unfinished = path.with_suffix(".unfinished")
    unfinished.write_text(json.dumps(content, indent=1), encoding="utf-8")
    unfinished.replace(path)


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of 1 or more, got {text}")
    return int(text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, call, and say what cannot be used."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", choices=("diagnose", "rivals", "oracle", "told", "score"))
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="with cases and truth")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the outputs of all of them")
    parser.add_argument("-j", "--jobs", type=_positive, default=1, help="processes")
    parser.add_argument("--every", type=_positive, default=1, help="diagnose, rivals: run over one of so many cases")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    out, jobs = options.output, options.jobs
    try:
        for folder in options.folders if options.work != "score" else ():
            if options.work == "diagnose":
                for_each_case(folder, out, DIAGNOSIS, diagnose_case, jobs=jobs, every=options.every)
            elif options.work == "rivals":
                for_each_case(folder, out, RIVALS, _rivals_case, jobs=jobs, every=options.every)
            else:
                truths = {t["id"]: t for t in read_truths(folder, out)}
                file, one = (ORACLE, _oracle_case) if options.work == "oracle" else (TOLD, _told_case)
                for_each_case(folder, out, file, partial(one, truths), jobs=jobs)
        if options.work == "score":
            _score(options.folders, out)
    except InputError as error:
        Console(stderr=True).print(str(error), style="red", markup=False)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
