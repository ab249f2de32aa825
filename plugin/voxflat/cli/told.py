"""What the command line says of an option: the first sentences of the Python parameter's own text."""

import inspect
import re
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any, TypeVar

import cloup

_Command = TypeVar("_Command", bound=Callable[..., Any])

_PARAMETER = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*) : .*$", re.MULTILINE)


@lru_cache
def _texts(of: Callable[..., Any]) -> dict[str, str]:
    """Return the texts of a docstring's parameters by their names."""
    doc = inspect.getdoc(of) or ""  # there is none under python -OO
    section = re.search(r"Parameters\n-+\n(.*?)(?:\n\n[A-Z]\w+\n-+\n|\Z)", doc, re.DOTALL)
    text = "" if section is None else section[1]
    starts = list(_PARAMETER.finditer(text))
    ends = [start.start() for start in starts[1:]] + [len(text)]
    found: dict[str, str] = {}
    for start, end in zip(starts, ends, strict=True):
        told = " ".join(text[start.end() : end].split())
        found |= {name.lstrip("*"): told for name in start[1].split(", ")}
    return found


def text_of(of: Callable[..., Any], name: str, sentences: int = 1) -> str:
    """Return the first sentences on a parameter, as the docstring of a function, or of a class of options, has them."""
    found = re.split(r"(?<=[.])\s+(?=[A-Z\"`])", _texts(of).get(name, ""))
    return " ".join(found[:sentences]).replace("`", "").replace("  ", " ")


def default_of(of: Callable[..., Any], name: str) -> Any:
    """Return a parameter's default; None where there is none."""
    if is_dataclass(of):
        return next(one.default for one in fields(of) if one.name == name)
    default = inspect.signature(of).parameters[name].default
    return None if default is inspect.Parameter.empty else default


def option_of(
    of: Callable[..., Any], name: str, *, sentences: int = 1, default: str | None = None, **more: Any
) -> Callable[[_Command], _Command]:
    """Return the option for a parameter, with its name, default (in words for None), and `sentences` of its text."""
    usual = default_of(of, name)
    told = default if default is not None else None if usual is None or isinstance(usual, bool) else str(usual)
    if usual is not None and not is_dataclass(of):  # an option of one method is given or not
        more.setdefault("default", usual)
    help_ = more.pop("help", None) or text_of(of, name, sentences)
    ending = "" if told is None else f"  [default: {told}]"
    return cloup.option(f"--{name.replace('_', '-')}", help=help_ + ending, show_default=False, **more)
