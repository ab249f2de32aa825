"""Words of messages: numbers of things, and Python replaced by the options or fields of a front end."""

import re
from collections.abc import Callable, Mapping

_VALUE = r"'[^']*'|\[[^]]*\]|\([^)]*\)|\.\.\.|[\w.+-]*\w|"
_ARGUMENT = re.compile(rf"(?<![\w/.-])(?P<name>[a-z]+(_[a-z]+)*)(=(?P<value>{_VALUE}))?(?![\w/=(]|\.\w)")
_SCALAR = re.compile(r"\bnp\.\w+\(([^()]*)\)")
_TUPLE = re.compile(r"(?P<before> (?:is|are) )\((?P<numbers>-?[\d.]+(?:, -?[\d.]+)*),?\)")


def in_words(text: str, phrases: Mapping[str, str], argument: Callable[[str, str | None, str], str]) -> str:
    """Return a message in other words.

    Parameters
    ----------
    text : str
        A message that may contain functions, arguments and tuples of Python.
    phrases : mapping of str to str
        Regular expressions, such as the names of functions, and their replacements.
    argument : callable
        Called with each possible name of an argument, its value (None if the name has none) and the text of both, such
        as "relax", "False" and "relax=False". Returns the replacement of the text.
    """
    for phrase, instead in phrases.items():
        text = re.sub(phrase, instead, text)
    text = _ARGUMENT.sub(lambda match: argument(match["name"], match["value"], match[0]), text)
    return _TUPLE.sub(r"\g<before>\g<numbers>", _SCALAR.sub(r"\1", text))


def many(count: int, noun: str) -> str:
    """Return a number of things, such as "1 map" or "2,000 maps"."""
    return f"{count:,} {noun}{'s' * (count != 1)}"
