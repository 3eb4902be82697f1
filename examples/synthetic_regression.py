"""The paper's synthetic regression: 100 noisy inputs, of which 10 matter, judged on noiseless ones.

    python examples/synthetic_regression.py

y = T b, T ~ N(0, I_10), b ~ N(0, I_10). The inputs are T, r redundant mixtures T R / sqrt(10) with R standard normal,
and u irrelevant ones. Input noise has 1 / SNR of the variance of each column, output noise a fifth of that of y. The
tables go to benchmarks/results/synthetic_regression.json.

Source: Ting, Mistry, Peters, Schaal, Nakanishi, "A Bayesian approach to nonlinear parameter identification for rigid
body dynamics" (RSS 2006), section IV-A.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from torch import Tensor

from torchrbd.regression import (
    EIVARD,
    BestRegression,
    FactorRegression,
    Lasso,
    Moments,
    NoiseRange,
    NoisyInputRegression,
    OrdinaryLeastSquares,
    PartialLeastSquares,
    PrincipalComponents,
    Regression,
    Ridge,
    Stepwise,
    TotalLeastSquares,
    TruncatedSVD,
)

sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))
import results_file

RELEVANT, TEST_ROWS, OUTPUT_SNR = 10, 500, 5.0


@dataclass(frozen=True)
class Setting:
    """Redundant and irrelevant columns of a hundred, and the inputs' signal-to-noise ratio."""

    redundant: int
    irrelevant: int
    snr: float

    def __str__(self) -> str:
        return f"{self.redundant},{self.irrelevant} / {self.snr:g}"


SETTINGS = tuple(Setting(r, u, snr) for snr in (2.0, 5.0) for r, u in ((90, 0), (0, 90), (30, 60), (60, 30)))


@dataclass(frozen=True)
class Problem:
    """Noisy rows to fit, ``X`` (N, d) and ``y`` (N,), with their noise variances, and noiseless rows to judge by."""

    X: Tensor
    y: Tensor
    input_noise: Tensor
    output_noise: Tensor
    clean: Tensor
    output: Tensor


def draw(setting: Setting, columns: int, rows: int, seed: int) -> Problem:
    """Draw a problem; with more than 100 columns, redundant and irrelevant ones keep their shares."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    redundant = round((columns - RELEVANT) * setting.redundant / (setting.redundant + setting.irrelevant))
    b, R = normal(RELEVANT), normal(RELEVANT, redundant)
    parts = []
    for n in (rows, TEST_ROWS):
        T = normal(n, RELEVANT)
        parts.append((torch.cat((T, T @ R / RELEVANT**0.5, normal(n, columns - RELEVANT - redundant)), 1), T @ b))
    (X, y), (clean, output) = parts
    input_noise, output_noise = X.var(0) / setting.snr, y.var() / OUTPUT_SNR
    X, y = X + input_noise.sqrt() * normal(rows, columns), y + output_noise.sqrt() * normal(rows)
    return Problem(X, y, input_noise, output_noise, clean, output)


def nmse(fitted: Regression, problem: Problem) -> float:
    """Return the mean squared error at noiseless inputs over the variance of the output there."""
    return float((fitted.predict(problem.clean) - problem.output).square().mean() / problem.output.var())


CLASSICAL: dict[str, Callable[[Problem], Regression]] = {
    "OLS": lambda p: OrdinaryLeastSquares(),
    "SVD": lambda p: TruncatedSVD(),
    "ridge": lambda p: Ridge(),
    "TLS": lambda p: TotalLeastSquares(),
    "LASSO": lambda p: Lasso(),
    "stepwise": lambda p: Stepwise(),
    "PLS": lambda p: PartialLeastSquares(),
    "PCR": lambda p: PrincipalComponents(),
}
TOLD: dict[str, Callable[[Problem], Regression]] = {
    "TLS, noise given": lambda p: TotalLeastSquares(torch.cat((p.input_noise, p.output_noise.reshape(1)))),
    "EIV-ARD": lambda p: EIVARD(p.input_noise),
    "factor, noise given": lambda p: FactorRegression(p.input_noise),
    "default, noise given": lambda p: BestRegression(p.input_noise),
}
UNTOLD: dict[str, Callable[[Problem], Regression]] = {
    "factor, noise unknown": lambda p: FactorRegression(),
    "default, noise unknown": lambda p: BestRegression(),
}
PAPER = {
    "paper, noise given": lambda p: NoisyInputRegression(p.input_noise),
    "paper, noise at least given": lambda p: NoisyInputRegression(NoiseRange(low=p.input_noise)),
    "paper, noise learned": lambda p: NoisyInputRegression(),
}


def paper_run(
    build: Callable[[Problem], NoisyInputRegression], problem: Problem, iterations: int
) -> tuple[float, float]:
    """Return nmse after all iterations of the paper's model, and the least of it on the way."""
    model = build(problem)
    model.start(problem.X, problem.y)
    errors = [nmse(model, problem)]
    for _ in range(iterations):
        model.update()
        errors.append(nmse(model, problem))
    return errors[-1], min(errors)


def measure(problem: Problem, iterations: int) -> dict[str, float]:
    """Return nmse by method; of the paper's model also that of its best iterate."""
    moments = Moments.from_data(problem.X, problem.y)
    found = {name: nmse(build(problem).fit(moments), problem) for name, build in (CLASSICAL | TOLD | UNTOLD).items()}
    for name, build in PAPER.items() if iterations else ():
        found[name], found[f"{name}: best iterate"] = paper_run(build, problem, iterations)
    return found


def geometric_mean(values: list[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))


def tables(results: dict[Setting, list[dict[str, float]]]) -> tuple[Table, Table]:
    """Return nmse by method and setting, mean and standard deviation over seeds, and the ratios that are claimed."""
    means = {s: {name: float(np.mean([r[name] for r in runs])) for name in runs[0]} for s, runs in results.items()}
    spread = {s: {name: float(np.std([r[name] for r in runs])) for name in runs[0]} for s, runs in results.items()}
    errors = Table("method", *map(str, results), title="nMSE on noiseless inputs: mean (standard deviation over seeds)")
    for name in next(iter(means.values())):
        errors.add_row(name, *(f"{means[s][name]:.4f} ({spread[s][name]:.4f})" for s in results))
    best = {s: min(CLASSICAL, key=lambda name, s=s: means[s][name]) for s in results}
    errors.add_row("best classical", *best.values())
    ratios = Table("ratio of means", *map(str, results), "geometric mean", title="Ratios")
    for name in (*TOLD, *UNTOLD, *(PAPER if "paper, noise learned" in next(iter(means.values())) else ())):
        for against in ("best classical", "OLS"):
            row = [means[s][name] / means[s][best[s] if against == "best classical" else "OLS"] for s in results]
            ratios.add_row(f"{name} / {against}", *(f"{r:.3f}" for r in row), f"{geometric_mean(row):.3f}")
    return errors, ratios


def stored(table: Table) -> dict[str, list]:
    """Return a rich table as columns and rows."""
    columns = [[str(column.header), *map(str, column.cells)] for column in table.columns]
    head, *rows = map(list, zip(*columns, strict=True))
    return {"columns": head, "rows": rows}


def main() -> None:
    parser = argparse.ArgumentParser(description="The paper's synthetic regression; tables to benchmarks/results/.")
    parser.add_argument("--seeds", type=int, default=10, help="problems of each setting")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--columns", type=int, default=100)
    parser.add_argument("--rows", type=int, default=1000, help="rows to train")
    parser.add_argument(
        "--settings", type=int, nargs="+", default=list(range(len(SETTINGS))), help="numbers from 0 to 7"
    )
    parser.add_argument("--iterations", type=int, default=10_000, help="of the paper's model; 0 leaves it out")
    parser.add_argument("--dry-run", action="store_true", help="print only")
    options = parser.parse_args()
    torch.set_num_threads(1)
    console = Console()
    console.width = max(console.width, 210)
    results: dict[Setting, list[dict[str, float]]] = {}
    with Progress(console=console) as progress:
        task = progress.add_task("fitting", total=len(options.settings) * options.seeds)
        for setting in (SETTINGS[k] for k in options.settings):
            results[setting] = []
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                problem = draw(setting, options.columns, options.rows, seed)
                results[setting].append(measure(problem, options.iterations))
                progress.advance(task)
    errors, ratios = tables(results)
    console.print(errors, ratios)
    seeds = f"seeds {options.first_seed} to {options.first_seed + options.seeds - 1}"
    note = f"{options.columns} columns, {options.rows} rows, {seeds}; {options.iterations} iterations of the paper's."
    console.print(f"{note} {time.process_time():.0f} s of processor time.")
    if not options.dry_run:
        command = " ".join(["python examples/synthetic_regression.py", *sys.argv[1:]])
        path = results_file.update(
            "synthetic_regression", command, {"errors": stored(errors), "ratios": stored(ratios)}
        )
        console.print(f"wrote {path}")


if __name__ == "__main__":
    main()
