"""Build command-line options from Python parameters, with the first sentences of their descriptions as help."""

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
def _descriptions(function: Callable[..., Any]) -> dict[str, str]:
    """Return the descriptions of the parameters in a docstring, keyed by parameter name."""
    doc = inspect.getdoc(function) or ""  # python -OO removes docstrings
    section = re.search(r"Parameters\n-+\n(.*?)(?:\n\n[A-Z][\w ]+\n-+\n|\Z)", doc, re.DOTALL)
    text = "" if section is None else section[1]
    starts = list(_PARAMETER.finditer(text))
    ends = [start.start() for start in starts[1:]] + [len(text)]
    descriptions: dict[str, str] = {}
    for start, end in zip(starts, ends, strict=True):
        description = " ".join(text[start.end() : end].split())
        descriptions |= {name.lstrip("*"): description for name in start[1].split(", ")}
    return descriptions


def description_of(function: Callable[..., Any], name: str, sentences: int = 1) -> str:
    """Return the first sentences of a parameter's description in the docstring of a function or a dataclass."""
    parts = re.split(r"(?<=[.])\s+(?=[A-Z\"`])", _descriptions(function).get(name, ""))
    text = re.sub(r":\w+:(?=`)", "", " ".join(parts[:sentences]))  # without roles
    others = "|".join(_descriptions(function).keys() - {name})
    text = re.sub(rf"(?<!`)`({others})`(?!`)", lambda match: f"--{match[1].replace('_', '-')}", text)
    return text.replace("`", "").replace("  ", " ")


def option_of(
    function: Callable[..., Any],
    name: str,
    *,
    sentences: int = 1,
    like: Callable[..., Any] | None = None,
    until: str = "",
    note: str = "",
    default: str | None = None,
    **more: Any,
) -> Callable[[_Command], _Command]:
    """Return the option for a parameter, with its name, its default and the first `sentences` of its description.

    `like`: a function with a parameter of the same name whose description is used instead. `until`: a clause of the
    description that is omitted together with the text after it. `note`: a sentence that is added. `default`: the
    default in words; if it is omitted, the default value or a clause "by default ..." of the description is shown.
    """
    if is_dataclass(function):
        usual: Any = next(field.default for field in fields(function) if field.name == name)
    else:
        usual = inspect.signature(function).parameters[name].default
        usual = None if usual is inspect.Parameter.empty else usual
    usual_text = default if default is not None else None if usual is None or isinstance(usual, bool) else str(usual)
    if usual is not None and not is_dataclass(function):  # method options stay None unless the user gives them
        more.setdefault("default", usual)
    help_ = more.pop("help", None) or description_of(like or function, name, sentences)
    if until and until in help_:
        help_ = help_.split(until)[0] + "."
    if clause := re.search(r"[;,] by default (.*?)(?=\.(?: |$))", help_):
        help_ = help_.replace(clause[0], "")
        usual_text = usual_text or clause[1]
    help_ = " ".join(filter(None, (help_, note)))
    ending = "" if usual_text is None else f"  [default: {usual_text}]"
    return cloup.option(f"--{name.replace('_', '-')}", help=help_ + ending, show_default=False, **more)
