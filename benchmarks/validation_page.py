"""Write the tables of the README and of the documentation from the result files.

    python benchmarks/validation_page.py            # writes what differs
    python benchmarks/validation_page.py --check    # exit code 1 if a table differs

A table stands between ``<!-- table: NAME -->`` and ``<!-- end -->``; NAME is a function below. Figures come from
``benchmarks/results/*.json``, which the benchmarks write.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import results_file

ROOT = Path(__file__).resolve().parents[1]
TABLE = re.compile(r"(?P<begin>^<!-- table: (?P<name>\w+) -->\n)(?P<text>.*?)(?P<end>^<!-- end -->$)", re.M | re.S)
MODELS = ("urdf", "rigid_body", "baseline", "extended")
BASELINES = {"baseline": "", "filtered_baseline": "; least squares with the filter that was found"}
PLAIN = ("viscous_friction", "coulomb_friction", "asymmetric_coulomb_friction")

Table = Callable[[], str]
TABLES: dict[str, Table] = {}


def table(function: Table) -> Table:
    """Register a table by its function's name."""
    TABLES[function.__name__] = function
    return function


def results(name: str) -> dict[str, Any]:
    """Return the results of a file by their keys."""
    return results_file.read(name)["results"]


def markdown(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)


def stored(name: str, key: str, columns: Mapping[str, str] | None = None) -> str:
    """Return a table as it stands in a result file; ``columns`` chooses and renames some."""
    found = results(name)[key]
    chosen = columns or {c: c for c in found["columns"]}
    index = [found["columns"].index(c) for c in chosen]
    return markdown(list(chosen.values()), [[row[k] for k in index] for row in found["rows"]])


def short(value: float) -> str:
    """Return two significant digits, without an exponent where it needs none."""
    return f"{value:.2g}" if abs(value) < 1e-4 or abs(value) >= 100 else f"{float(f'{value:.2g}'):g}"


def mean(values: Mapping[str, float]) -> float:
    """Return the mean over the joints."""
    return sum(values.values()) / len(values)


def part(result: Mapping[str, Any]) -> str:
    """Return "7 of 8" or a value with its interval."""
    if "right" in result:
        return f"{result['right']} of {result['of']}"
    low_high = result.get("interval")
    return f"{result['value']:g}" + (f" ({low_high[0]:g} to {low_high[1]:g})" if low_high else "")


@table
def real_robots_short() -> str:
    rows = []
    for one in results("real_robots").values():
        nmse = {m: mean(one["nmse"][m]) for m in MODELS}
        cells = {m: short(v) for m, v in nmse.items()}
        best = min(("baseline", "extended"), key=lambda m: nmse[m])
        cells[best] = f"**{cells[best]}**"
        rows.append([one["robot"], cells["urdf"], cells["baseline"], cells["extended"]])
    return markdown(["robot", "URDF", "least squares", "torchrbd"], rows)


@table
def real_robots() -> str:
    rows = []
    for one in results("real_robots").values():
        low, high = min(one["cutoff_hz"]), max(one["cutoff_hz"])
        band = f"{low:g} Hz" if low == high else f"{low:g} to {high:g} Hz"
        cells = [short(mean(one["nmse"][m])) for m in MODELS]
        rows.append([one["robot"], one["torque"], str(one["folds"]), str(one["rows_held_out"]), band, *cells])
    head = ["robot", "torque", "folds", "samples", "band", "URDF", "re-fitted rigid body", "least squares", "torchrbd"]
    return markdown(head, rows)


@table
def closed_loop() -> str:
    names, columns = {"z1": "Unitree Z1", "go2": "Unitree Go2, front left leg"}, dict[str, dict[str, str]]()
    found = results("closed_loop")
    for key, one in found.items():
        robot, model = key.split(": ")
        columns.setdefault(model, {})[robot] = f"{one['rms_mrad']:.3g} mrad"
    order = ["URDF", *(m for m in columns if m not in ("URDF", "torchrbd identify")), "torchrbd identify"]
    rows = [
        [words, *(columns[m].get(robot, "–") for m in order), f"{found[f'{robot}: URDF']['tracking_mrad']:.3g} mrad"]
        for robot, words in names.items()
    ]
    return markdown(["robot", *order, "tracking error"], rows)


@table
def sysid_rivals() -> str:
    names, rows = {"z1": "Unitree Z1", "go2": "Unitree Go2"}, []
    for key, one in results("sysid_rivals").items():
        robot, fit = key.split(": ")
        rows.append([names[robot], fit, f"{one['rms_mrad']:.3g} mrad", f"{one['processor_s']} s"])
    return markdown(["robot", "fit", "distance from the held-out motion, RMS", "processor time"], rows)


@table
def unknown_gains() -> str:
    names, rows = {"z1": "Unitree Z1", "go2": "Unitree Go2"}, []
    for key, one in results("unknown_gains").items():
        robot, bodies = key.split(": ")
        if "inside" in one:
            inside = f"{one['inside']} of {one['of']}"
            rows.append([names[robot], bodies, f"{one['median_ratio']:.2f}", inside, f"{one['median_factor']:.2f}"])
    head = [
        "robot",
        "URDF's bodies",
        "estimate / known gain",
        "known gain in the 95 % interval",
        "half-width of the interval, a factor of",
    ]
    return markdown(head, rows)


@table
def simulated_drives() -> str:
    keys = "named or in class", "cases with a false finding", "95 % intervals that hold the truth"
    rows = []
    for way, one in results("simulated_drives").items():
        counts = [f"{round(one[key]['value'] * one[key]['of'])} of {one[key]['of']}" for key in keys]
        rows.append([way, *counts])
    return markdown(["diagnosed from", "named or in class", "robots with a false finding", keys[2]], rows)


@table
def real_joints() -> str:
    rows = []
    each = ((one, model) for one in results("real_robots").values() for model in BASELINES if model in one["nmse"])
    for one, model in each:
        extended, before = one["nmse"]["extended"], one["nmse"][model]
        worse = [j for j in extended if extended[j] > before[j]]
        ratio = mean({j: extended[j] / before[j] for j in extended})
        pairs = [f"{j} {before[j]:.3g} → {extended[j]:.3g}" for j in worse]
        rows.append(
            [
                one["robot"] + BASELINES[model],
                f"{ratio:.2f}",
                f"{len(worse)} of {len(extended)}",
                "; ".join(pairs) or "–",
            ]
        )
    head = [
        "robot",
        "NMSE over that of least squares, mean of the joints' ratios",
        "joints that are worse",
        "NMSE, least squares → torchrbd",
    ]
    return markdown(head, rows)


@table
def real_findings() -> str:
    rows = []
    for one in results("real_robots").values():
        friction = {j for f in one["findings"] if f["effect"] in PLAIN for j in f["joints"]}
        places: dict[str, list[str]] = {}
        for f in one["findings"]:
            if f["effect"] not in PLAIN:
                place = ", ".join((*f["joints"], *f["links"])) or "the whole robot"
                sure = f"{place} ({probability(f['probability'])}; {f['found_in_folds']} of {one['folds']})"
                places.setdefault(f["effect"].replace("_", " "), []).append(sure)
        words = [f"{effect} at {', '.join(at)}" for effect, at in places.items()]
        rows.append([one["robot"], f"{len(friction)} of {len(one['nmse']['urdf'])} joints", "; ".join(words) or "–"])
    return markdown(["robot", "viscous or Coulomb friction", "other findings (probability; folds that have it)"], rows)


def probability(value: float) -> str:
    """Return two digits, or "> 0.99"."""
    return "> 0.99" if value > 0.99 else f"{value:.2f}"


@table
def summary() -> str:
    c, i = results("concealed"), results("injected")
    rows = [
        ["simulated, one effect of 8 or 16 % of the torque: named", c["clean_8_16"]],
        ["simulated, one effect of 2 or 4 %: named", c["clean_2_4"]],
        ["simulated, friction everywhere, one to four effects: named", c["field"]],
        ["the same, effects of 8 % and more: named", c["field_8"]],
        ["simulated by Pinocchio, friction everywhere, one effect of 8 %: named", c["raw"]],
        ["simulated, nothing hidden: robots with a false finding", c["null_false"]],
        ["simulated, hidden effects: robots with a false finding", c["planted_false"]],
        ["simulated by Pinocchio: robots with a false finding", c["raw_false"]],
        ["findings with a probability above 0.9 that are right", c["sure_right"]],
        ["95 % intervals that contain the truth", c["coverage"]],
        ["physics outside the list: reported as unexplained, right joint and signal", c["outside_unexplained"]],
        ["physics outside the list: given a wrong name", c["outside_wrong_name"]],
        ["relative error of parameters, median", c["parameter_error"]],
        ["effect of 15 % added to a real recording: named, or its family", i["size_15"]],
        ["effect of 8 % added to a real recording: named, or its family", i["size_8"]],
        ["the same: false findings per recording", i["false_findings_a_case"]],
    ]
    return markdown(["question", "result", "required"], [[words, part(x), x.get("asked", "")] for words, x in rows])


@table
def calibration() -> str:
    found = results("null_evidence")["calibration"]["rows"]
    rows = [[x, f"{bound:.2g}", ratio] for x, bound, _, ratio in found if x % 2 == 0]
    return markdown(["x", "bound", "ratio, 30 s at 125 Hz"], rows)


@table
def input_noise() -> str:
    return stored("input_noise", "nmse")


@table
def coverage() -> str:
    return stored("input_noise", "coverage")


@table
def earning_a_name() -> str:
    found = results("earning_a_name")["all"]
    of = found["of"]
    columns = ["rule", *(f"{kind}, of {of[kind]}" for kind in of)]
    return markdown(columns, [[rule, *kept.values()] for rule, kept in found["rules"].items()])


@table
def kernels() -> str:
    chosen = ("inverse dynamics", "regressor", "mass matrix", "forward dynamics")
    found = results("speed")["7_joints"]
    return markdown([*found["columns"][:5]], [row[:5] for row in found["rows"] if row[0] in chosen])


@table
def gpu() -> str:
    columns = {c: c for c in ("7 joints", "float64", "float32")}
    return stored("speed", "gpu_7_joints", columns)


@table
def diagnosis_seconds() -> str:
    columns = {"recording": "recordings", "seconds": "`diagnose` [s]", "of identify": "`identify` [s]"}
    return stored("speed", "diagnosis", columns | {"memory [GB]": "memory [GB]"})


@table
def long_recordings() -> str:
    found = results("speed")["long_recordings"]
    return markdown(
        ["work", "rows", "seconds, of them of the processor", "memory [GB]"], [[*r[:3], r[4]] for r in found["rows"]]
    )


@table
def many_joints() -> str:
    return stored("speed", "many_joints")


@table
def fleet_alarms() -> str:
    return stored("speed", "fleet_alarms")


@table
def condition_numbers() -> str:
    return stored("next_recording", "condition_numbers")


@table
def training() -> str:
    return stored("training", "passes")


@table
def residual() -> str:
    return stored("residual", "nmse")


def pages() -> list[Path]:
    """Return the pages that may hold tables."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def filled(text: str) -> str:
    """Return a page with its tables written anew."""

    def written(found: re.Match[str]) -> str:
        if found["name"] not in TABLES:
            raise SystemExit(f"no table '{found['name']}'; there are {', '.join(TABLES)}")
        return f"{found['begin']}\n{TABLES[found['name']]()}\n{found['end']}"

    return TABLE.sub(written, text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the pages, or check them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a table differs")
    check, different = parser.parse_args(arguments).check, []
    for page in pages():
        text = page.read_text(encoding="utf-8")
        new = filled(text)
        if new != text:
            different.append(page.relative_to(ROOT))
            if not check:
                page.write_text(new, encoding="utf-8")
    words = "differs from the result files: run python benchmarks/validation_page.py" if check else "written"
    for page in different:
        print(f"{page}: {words}")
    return 1 if check and different else 0


if __name__ == "__main__":
    sys.exit(main())
