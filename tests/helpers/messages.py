"""Collect the text of every message of the package from its source: errors, warnings and notes."""

import ast
import itertools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import voxflat

PACKAGE = Path(voxflat.__file__).parent
FRONT_ENDS = ("cli", "_napari", "_pyvista", "vtk.py")  # their own texts may use their own words
_CALLS = re.compile(r".*(Error|Parameter|Exit)|log\.(warning|info)|warnings\.warn|show_(error|warning|info)")
_WORDS = re.compile(r"(?:[A-Za-z']+[,.:;]? ){3}[A-Za-z']+")  # a sentence, and not a key, a format or a style
_MOST = 64  # combinations of the alternatives of one text
# texts that are about objects and arguments of Python, so no command and no window can cause them
OF_PYTHON = re.compile(
    r"Pass True or False|\.filled\(0\)|copy=False|as returned by|as read_patch returns|\.(?:mesh|data)?\.?parts\b"
    r"|Pass \.\w+|image\.|3-tuples|cosines and c_ras|Regions\.volume|object from voxflat\.methods|voxflat\.range_image"
    r"|Pass True where|missing \(None\)|import sys"
)
NAMES_IN_FILES = ("c_ras", "mris_convert", "mris_flatten", "end_header", "vertex_indices")
PYTHON = re.compile(
    r"\b[a-z_]+=(?!=)|\w\(\)|voxflat\.[a-z]|\b(?:True|False|None)\b"
    r"|(?<![-\w./{'])[a-z]+(?:_[a-z]+)+(?![\w}.'])|\buse \w+_\w+"
)
_Scope = dict[str, list[ast.expr]]


@dataclass(frozen=True)
class Message:
    """Text of a message with {holes} for the expressions in it, and the place in the source that defines it.

    `of` is the call that the text is passed to, such as "InputError" or "log.warning", or "" for texts that are stored
    or returned first, such as warnings on a surface.
    """

    text: str
    path: str
    line: int
    of: str

    @property
    def place(self) -> str:
        return f"{self.path}:{self.line}"

    @property
    def is_of_front_end(self) -> bool:
        return Path(self.path).parts[0] in FRONT_ENDS


@cache
def messages() -> tuple[Message, ...]:
    """Return all texts that are passed to an exception or a log, and all other sentences that are not docstrings."""
    paths = sorted(PACKAGE.rglob("*.py"))
    found = (one for path in paths for one in _of_module(path))
    return tuple({(one.text, one.path, one.line): one for one in found}.values())


def _of_module(path: Path) -> Iterator[Message]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    yield from _within(tree, path.relative_to(PACKAGE).as_posix(), _assigned(tree.body))


def _within(node: ast.AST, path: str, scope: _Scope) -> Iterator[Message]:
    """Yield the messages in a node; `scope` contains the assignments that its names refer to."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):  # a docstring
        return
    if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_formats":  # a part of one
        return
    if isinstance(node, ast.FunctionDef):
        scope = scope | _assigned(ast.walk(node))
    children = list(ast.iter_child_nodes(node))
    if isinstance(node, ast.Call) and _CALLS.fullmatch(name := ast.unparse(node.func).removeprefix("click.")):
        texts = [text for argument in node.args for text in _texts(argument, scope, 0)]
        yield from (Message(text, path, node.lineno, name) for text in texts if " " in text)
    elif _is_text(node):
        assert isinstance(node, ast.expr)
        texts = _texts(node, scope, 0)
        yield from (Message(text, path, node.lineno, "") for text in texts if _WORDS.search(text))
    for one in children:
        yield from _within(one, path, scope)


def _is_text(node: ast.AST) -> bool:
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.Add) and (_is_text(node.left) or _is_text(node.right))
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _assigned(nodes: Iterable[ast.AST]) -> _Scope:
    """Return the texts that are assigned to each name."""
    found: _Scope = {}
    for node in nodes:
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            found.setdefault(node.targets[0].id, []).append(node.value)
    return {name: values for name, values in found.items() if all(_has_text(value) for value in values)}


def _has_text(node: ast.expr) -> bool:
    if isinstance(node, ast.IfExp):
        return _has_text(node.body) or _has_text(node.orelse)
    return _is_text(node)


def _texts(node: ast.expr, scope: _Scope, depth: int) -> list[str]:
    """Return the alternatives of a text: the branches of its conditions and of the variables in it."""
    if isinstance(node, ast.Constant):
        return [str(node.value)]
    if isinstance(node, ast.IfExp) and _has_text(node):
        return _texts(node.body, scope, depth) + _texts(node.orelse, scope, depth)
    if isinstance(node, ast.Name) and node.id in scope and depth < 3:
        return [text for value in scope[node.id] for text in _texts(value, scope, depth + 1)]
    if isinstance(node, ast.FormattedValue):
        return _texts(node.value, scope, depth)
    if isinstance(node, ast.JoinedStr):
        return _joined([_texts(part, scope, depth) for part in node.values])
    if isinstance(node, ast.BinOp) and _is_text(node):
        return _joined([_texts(node.left, scope, depth), _texts(node.right, scope, depth)])
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("in_unit", "click.style") and node.args:
        return _texts(node.args[0], scope, depth)
    return [f"{{{ast.unparse(node)}}}"]


def _joined(parts: list[list[str]]) -> list[str]:
    return ["".join(one) for one in itertools.islice(itertools.product(*parts), _MOST)]
