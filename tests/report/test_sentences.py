"""Sentences for a person are made in ``report/text`` alone: elsewhere, results carry data.

What reads as a sentence: six words or more, with a verb that clauses have ("is", "has", "may") or with a full stop.
Messages of exceptions, warnings and logs stay where they are raised, docstrings are for who reads the code, and what
describes an option, a key or an effect stands next to it.
"""

import ast
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import torchrbd

PACKAGE = Path(torchrbd.__file__).parent
VERB = re.compile(
    r"\b(is|are|was|were|has|have|had|does|do|did|can|cannot|may|might|must|needs?|will|would|should|shall)\b"
)
WORD, STOP = re.compile(r"[A-Za-z][A-Za-z']+|\{\}"), re.compile(r"[a-z)]\.\s*$")
FEWEST_WORDS = 6
# Calls that take a message: exceptions and warnings, an object that raises it later, the developer's log.
MESSAGES = re.compile(r"(Error|Warning|^warn|^debug|^Unsaved)$")
ALLOWED = {
    "report/text/": "where sentences are made",
    "effects/": "an effect describes itself: its name, what shows it, why its prior, what files hold of it",
    "cli/app.py": "help",
    "cli/commands/": "help",
    "cli/parameters.py": "help",
    "cli/estimators.py": "help",
    "estimators.py": "help: what each estimator is",
    "export/schemas.py": "descriptions in a JSON schema",
    "inference/robots_file.py": "descriptions of the keys of a file, which its schema has",
    "recordings/mapping_file.py": "descriptions of the keys of a file, which its schema has",
    "recordings/mapping_text.py": "comments of a mapping that is written",
}
# Parts of messages that are put together far from where they are raised, by their beginning.
PARTS = {
    "excitation/limits.py": ("joint '{}' has {} (",),
    "_runtime/rebuilding.py": ("{}: the files of a result do not hold {}",),
    "recordings/formats/csv_files.py": ("; numbers with decimal commas are",),
    "recordings/formats/ros_bags.py": (
        "; 'rosbag reindex'",
        "; a bag that was not closed",
        "; a file that was not closed",
    ),
}


def is_sentence(text: str) -> bool:
    return len(WORD.findall(text)) >= FEWEST_WORDS and bool(VERB.search(text) or STOP.search(text))


def is_message(node: ast.AST) -> bool:
    """Say whether a node is a docstring, what is raised, or a call that gets a message."""
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant)
    if isinstance(node, ast.Call):
        named = [one for one in (node.func, *node.args) if isinstance(one, ast.Name | ast.Attribute)]
        return any(MESSAGES.search(one.attr if isinstance(one, ast.Attribute) else one.id) for one in named)
    return isinstance(node, ast.Raise | ast.Assert)


def names_in(nodes: Iterable[ast.AST]) -> set[str]:
    return {one.id for node in nodes for one in ast.walk(node) if isinstance(one, ast.Name)}


def messages(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield messages, and what is assigned to their names: within a function, or for the whole file."""
    every = [node for node in ast.walk(tree) if is_message(node)]
    yield from every
    raised = names_in(every)
    yield from (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name in raised)
    for scope in [tree, *(node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))]:
        own = raised if scope is tree else names_in(node for node in ast.walk(scope) if is_message(node))
        for node in scope.body if scope is tree else ast.walk(scope):
            if isinstance(node, ast.Assign) and names_in(node.targets) & own:
                yield node


def sentences(code: str) -> list[str]:
    """Return the sentences of a file that are no messages; f-strings have {} for values."""
    tree = ast.parse(code)
    aside = {id(part) for node in messages(tree) for part in ast.walk(node)}
    parts = (part for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values)
    aside |= {id(part) for part in parts if isinstance(part, ast.Constant)}
    found = []
    for node in ast.walk(tree):
        if id(node) in aside:
            continue
        if isinstance(node, ast.JoinedStr):
            found.append("".join(str(one.value) if isinstance(one, ast.Constant) else "{}" for one in node.values))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.append(node.value)
    return [text for text in found if is_sentence(text)]


def test_sentences_are_made_in_report_text() -> None:
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        relative = path.relative_to(PACKAGE).as_posix()
        if not relative.startswith(tuple(ALLOWED)):
            parts = PARTS.get(relative, ())
            own = [text for text in sentences(path.read_text()) if not (parts and text.startswith(parts))]
            found |= {relative: own} if own else {}
    assert found == {}


def test_a_sentence_elsewhere_is_seen() -> None:
    code = '''
"""The docstring of a file is no sentence for a person."""
def f(joint):
    """The docstring of a function is none either."""
    words = f"the torque of {joint} is not the one that was expected"
    if joint:
        raise ValueError(f"{joint}: {words}, and that is an error; give another")
    return f"{joint} does not move in these recordings: nothing is fitted"
def g(joint):
    words = f"this also reads as a sentence, but it is returned, {joint}"
    return Note("title of a plot", words, "All rows count alike, the ones at rest too.")
'''
    assert set(sentences(code)) == {
        "{} does not move in these recordings: nothing is fitted",
        "All rows count alike, the ones at rest too.",
        "this also reads as a sentence, but it is returned, {}",
    }


def test_what_is_allowed_is_there() -> None:
    assert all((PACKAGE / path).exists() for path in (*ALLOWED, *PARTS))
    for path, parts in PARTS.items():
        found = sentences((PACKAGE / path).read_text())
        assert all(any(text.startswith(part) for text in found) for part in parts)
