"""Options have one source: signatures, docstrings and defaults are those of ``Options``."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import jsonschema
import pytest

import torchrbd
from torchrbd.export.schemas import schema
from torchrbd.inference.options_file import read_options
from torchrbd.options import Options, given, plain_words, spelt, words
from torchrbd.recordings.strict_yaml import strict_yaml

EVERY = set(Options.names())
OF_MOMENTS = {
    "time", "joints", "effects", "exclude", "gravity", "payload", "mapping", "cutoff_hz", "encoder_noise",
}  # fmt: skip
OF_TORQUE = {"time", "joints", "payload", "mapping", "cutoff_hz"}
FUNCTIONS: dict[Callable[..., Any], set[str]] = {
    torchrbd.identify: EVERY,
    torchrbd.diagnose: EVERY,
    torchrbd.rank_hypotheses: EVERY,
    torchrbd.identify_many: EVERY,
    torchrbd.compare_estimators: EVERY - {"estimator"},
    torchrbd.write_statistics: OF_MOMENTS,
    torchrbd.replay: OF_TORQUE | {"simulated"},
    torchrbd.residual_dataset: OF_TORQUE,
}


def documented(function: Callable[..., Any]) -> dict[str, str]:
    """Return what a docstring says of each argument."""
    _, _, listed = (function.__doc__ or "").partition("Args:")
    listed, _, _ = listed.partition("\n\n")
    entries = re.findall(r"^ {8}([\w, ]+): (.+(?:\n {12}.+)*)", listed, re.MULTILINE)
    return {name: " ".join(text.split()) for names, text in entries for name in names.split(", ")}


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_every_option_is_named_typed_and_documented(function: Callable[..., Any]) -> None:
    parameters, said = inspect.signature(function).parameters, documented(function)
    assert all(p.kind is not p.VAR_KEYWORD for p in parameters.values())
    assert said.keys() == parameters.keys()
    options = {name: p for name, p in parameters.items() if name in EVERY}
    assert options.keys() == FUNCTIONS[function]
    assert list(options) == [name for name in Options.names() if name in options]
    hints = get_type_hints(function)
    for option in (f for f in fields(Options) if f.name in options):
        assert options[option.name].kind is inspect.Parameter.KEYWORD_ONLY
        assert options[option.name].default == option.default
        assert hints[option.name] is not Any
        assert said[option.name] == words()[option.name]


def test_no_public_function_hides_its_options() -> None:
    public = (thing for thing in map(torchrbd.__getattr__, torchrbd.__all__) if inspect.isfunction(thing))
    hiding = [
        f.__name__ for f in public if any(p.kind is p.VAR_KEYWORD for p in inspect.signature(f).parameters.values())
    ]
    assert hiding == []


def test_settings_are_the_options() -> None:
    assert torchrbd.Settings.names() == Options.names()
    assert inspect.getdoc(torchrbd.Settings) == inspect.getdoc(Options)
    assert torchrbd.Settings() == torchrbd.Settings.from_mapping({}, "nowhere")


def test_every_option_is_documented_with_its_default() -> None:
    assert list(words()) == list(Options.names())
    for option in fields(Options):
        text = words()[option.name]
        if isinstance(option.default, str):
            assert f"Default: {option.default}." in text
        elif option.default not in ((), None):
            assert f"Default: {option.default:g}." in text
        else:
            assert "Default: " in text


def test_words_of_the_command_line_are_without_python() -> None:
    for name in Options.names():
        assert "Python" not in plain_words(name)
        assert "``" not in plain_words(name)
        assert "Default: " in plain_words(name)
    assert "see --holdout-fraction." in plain_words("holdout")


def test_schemas_have_what_files_may_say() -> None:
    """Every option in the schema of --config, by its spelling; values are those that the reader takes."""
    made = schema("config")
    assert made["properties"].keys() == {spelt(name) for name in Options.names()}
    assert all(
        one["description"] == plain_words(name)
        for name, one in zip(Options.names(), made["properties"].values(), strict=True)
    )
    for text in GOOD:
        content = strict_yaml(text)
        jsonschema.validate(content, made)
        assert read_options(content, "run.yaml")
    for text in BAD:
        with pytest.raises(torchrbd.OptionError, match=r"run\.yaml: line 2: "):
            read_options(strict_yaml(text), "run.yaml")
    for path in Path(__file__).parent.parent.glob("configs/run_*.yaml"):
        jsonschema.validate(strict_yaml(path.read_text()), made)


GOOD = (
    "cutoff: 5\nholdout: a.csv", "holdout: [a.csv, b.csv]\ngravity: [0, 0, -1]", "time: '2:30'", "time: [2, null]",
    "encoder-noise: 1.0e-4", "encoder-noise: {j: 0.1}", "holdout-fraction: 0.3\nseed: 4\nestimator: wls",
)  # fmt: skip
BAD = (
    "seed: 1\ncutof: 5",
    "seed: 1\ncutoff: fast",
    "seed: 1\ncutoff: -5",
    "seed: 1\ntime: [3, 2]",
    "cutoff: 1\ncutoff_hz: 2",
)


def test_options_are_picked_out_of_arguments() -> None:
    assert given({"robot": "arm.urdf", "seed": 3, "cutoff_hz": None}) == {"seed": 3, "cutoff_hz": None}


@pytest.mark.parametrize("name", sorted(EVERY - {"estimator", "effects", "holdout", "simulated"}))
def test_none_is_the_default(name: str) -> None:
    assert torchrbd.Settings.from_mapping({name: None}, "run.yaml") == torchrbd.Settings()


def test_closest_names_are_proposed() -> None:
    with pytest.raises(torchrbd.OptionError, match=r"did you mean 'coulomb_friction'\?"):
        torchrbd.Settings(effects=("coulomb_fricton",)).chosen_effects()
    robot = torchrbd.RobotModel.from_urdf(ARM)
    with pytest.raises(torchrbd.OptionError, match=r"no moving joint 'elbov'; did you mean 'elbow'\? it has: elbow"):
        torchrbd.Settings(joints=("elbov",)).used_joints(robot)
    with pytest.raises(torchrbd.OptionError, match=r"no joint 'elbov'; did you mean 'elbow'\?"):
        torchrbd.excite(robot, joints=["elbov"])


ARM = b"""<robot name="arm"><link name="base"/><joint name="elbow" type="revolute"><parent link="base"/>
<child link="arm"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="2"/></joint><link name="arm">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
