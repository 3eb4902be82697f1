"""What the command line understands: made from the options, with help, suggestions and completion."""

from __future__ import annotations

import inspect
import re
import shlex
import subprocess
import sys
from dataclasses import fields
from importlib import import_module

import pytest

import torchrbd
from torchrbd.cli import main
from torchrbd.cli.app import app
from torchrbd.cli.commands import compare_estimators, excite, stats
from torchrbd.options import Options, plain_words, spelling, spelt

COMMANDS = sorted(name for name in app() if not name.startswith("-"))
WITH_OPTIONS = {
    "identify": Options.names(),
    "diagnose": Options.names(),
    "compare-estimators": compare_estimators.OPTIONS,
    "stats": stats.OPTIONS,
}


def told(capsys: pytest.CaptureFixture[str]) -> str:
    return re.sub(r"[\s│]+", " ", capsys.readouterr().out)


@pytest.mark.parametrize("command", WITH_OPTIONS)
def test_options_are_those_of_the_function(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Signature, settings, docstring and command line are the same; test_options.py compares the first three."""
    function = {"stats": "write_statistics"}.get(command, command.replace("-", "_"))
    of_python = set(inspect.signature(getattr(torchrbd, function)).parameters) & set(Options.names())
    parsed = {option.field_info.name: option for option in app()[command].assemble_argument_collection()}
    assert parsed.keys() & set(Options.names()) == of_python == set(WITH_OPTIONS[command])
    for name in of_python:
        assert parsed[name].name == f"--{spelt(name)}"
        assert parsed[name].parameter.help == plain_words(name)
        assert parsed[name].field_info.default is None
    assert main([command, "--help"]) == 0
    shown = told(capsys)
    for name in of_python:
        assert f"--{spelt(name)} " in shown


def test_a_motion_has_the_options_of_its_function() -> None:
    of_python = inspect.signature(torchrbd.excite).parameters
    for name, parameter in inspect.signature(excite.excite).parameters.items():
        if name not in ("output", "rate_hz", "quiet"):
            default = of_python[name].default
            assert parameter.default == default


@pytest.mark.parametrize("command", COMMANDS)
def test_every_help_has_examples_that_are_understood(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"Usage: torchrbd {command}")
    assert shown.endswith("\n")
    after = import_module(f"torchrbd.cli.commands.{command.replace('-', '_')}").AFTER
    assert max(map(len, after.splitlines())) < 80
    lines = [line.strip() for line in after.partition("\n\n")[0].splitlines()[1:]]
    assert lines
    for line in lines:
        assert line in shown
        words = shlex.split(re.split(r" > |\)\"|    #", line)[0].replace('eval "$(', ""))
        app().parse_args(words[words.index("torchrbd") + 1 :], exit_on_error=False, print_error=False)


def test_several_values_of_all_kinds_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    given = {}
    monkeypatch.setattr("torchrbd.cli.running.run", lambda *arguments, quiet: given.update(arguments[-1]))
    options = "--holdout c.csv d.csv --time 2:30 --joints j1 j2 --payload c.csv=1,0,0,0 --cutoff 5 --gravity 0 9.81 -1"
    more = "--encoder-noise j1=1e-4 j2=2e-4 --holdout e.csv --seed 3 --kappa 2.5"
    assert main(["diagnose", "arm.urdf", "a.csv", *options.split(), "-o", "out", *more.split()]) == 0
    read = torchrbd.Settings.from_mapping(given, "here")
    assert [str(file) for file in read.holdout] == ["c.csv", "d.csv", "e.csv"]
    assert (read.time, read.joints, read.cutoff_hz, read.seed, read.kappa) == ((2.0, 30.0), ("j1", "j2"), 5.0, 3, 2.5)
    assert read.gravity == (0.0, 9.81, -1.0)
    assert read.encoder_noise == {"j1": 1e-4, "j2": 2e-4}
    assert read.payload[0].mass == 1.0


WRONG = {
    "command": (["diagnos", "arm.urdf"], 'Unknown command "diagnos". Did you mean "diagnose"?'),
    "option": (["diagnose", "arm.urdf", "a.csv", "-o", "out", "--holdot", "b.csv"], "Did you mean --holdout?"),
    "file": (["identify", "arm.urdf", "-o", "out"], "parameter RECORDING requires an argument; give the files first"),
    "output": (["identify", "arm.urdf", "a.csv"], "parameter --output requires an argument"),
    "repetitions": (
        ["diagnose", "a", "b", "-o", "c", "--stability", "-1"],
        "stability is -1; expected a number of repetitions",
    ),
    "number": (["identify", "a", "b", "-o", "c", "--seed", "x"], 'Invalid value for --seed: unable to convert "x"'),
    "vector": (["identify", "a", "b", "-o", "c", "--gravity", "0", "1"], "--gravity requires 3"),
    "nothing": (["identify", "a", "b", "-o", "c", "--joints"], "--joints requires at least 1 element"),
    "format": (["export", "out", "--to", "sdf"], 'Choose from: "urdf", "mjcf", "isaaclab"'),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_words_are_answered(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments, words = WRONG[name]
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.err.startswith("torchrbd: error: ")
    assert words in said.err
    assert said.out == ""


def test_no_command_shows_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    shown = capsys.readouterr().out
    assert all(f"│ {command} " in shown for command in COMMANDS)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"torchrbd {torchrbd.__version__}\n"


def test_bash_completes_commands_and_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    asked = """
complete_now() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=(); _torchrbd; echo "${COMPREPLY[@]}"; }
complete_now torchrbd dia
complete_now torchrbd identify arm.urdf a.csv --hold
complete_now torchrbd export out --to ""
complete_now torchrbd identify arm.urdf a.csv --estimator ri
complete_now torchrbd diagnose arm.urdf a.csv --effects ""
complete_now torchrbd stats arm.urdf a.csv --exclude stri
complete_now torchrbd compare-estimators arm.urdf a.csv --estimators p
complete_now torchrbd fleet robots.yaml --engine ""
complete_now torchrbd schema ""
"""
    done = subprocess.run(["bash", "-c", script + asked], capture_output=True, text=True, check=True)
    commands, options, *values = (line.split() for line in done.stdout.splitlines())
    assert commands == ["diagnose"]
    assert options == ["--holdout", "--holdout-fraction"]
    assert values == [
        ["urdf", "mjcf", "isaaclab"],
        ["ridge"],
        list(torchrbd.known_effects()),
        ["stribeck_friction"],
        ["physical", "pls", "pcr"],
        ["local", "dask"],
        ["mapping", "robots", "config", "diagnosis"],
    ]


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_know_the_values_too(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(name in script for name in torchrbd.known_effects())


def test_values_that_are_completed_are_not_the_only_ones() -> None:
    """EFFECT@PLACE is none of them."""
    offered = app({"effects": ("viscous_friction",)})
    given = ["identify", "arm.urdf", "a.csv", "-o", "out", "--effects", "viscous_friction@joint1", "viscous_friction"]
    _, bound, _ = offered.parse_args(given, exit_on_error=False, print_error=False)
    assert bound.kwargs["effects"] == ["viscous_friction@joint1", "viscous_friction"]


def test_every_option_has_a_spelling() -> None:
    for option in fields(Options):
        how = spelling(option)
        assert how.group in ("Data", "Model")
        assert how.metavar


def test_help_is_quick() -> None:
    """What it imports is in test_imports.py; this is the processor's time, least of several."""
    measure = "import time; from torchrbd.cli import main; main(['diagnose', '--help']); print(time.process_time())"
    took = [
        float(
            subprocess.run([sys.executable, "-c", measure], capture_output=True, text=True, check=True).stdout.split()[
                -1
            ]
        )
        for _ in range(3)
    ]
    assert min(took) < 0.5
