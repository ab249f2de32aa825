"""Messages in the words of the window."""

import re

from messages import messages

from voxflat._napari.wording import _FIELDS, in_window


def test_no_message_names_an_argument_that_the_form_has_as_a_field():
    argument = re.compile(rf"(?<![\w.])(?:{'|'.join(_FIELDS)})=['\w]")
    texts = [re.sub(r"\{[^{}]*\}", "7", one.text) for one in messages()]
    assert any(argument.search(text) for text in texts)  # in the words of Python
    assert [text for text in map(in_window, texts) if argument.search(text)] == []
    assert not [text for text in map(in_window, texts) if re.match("start (is|has|does) ", text)]


def test_arguments_become_fields_and_states():
    assert in_window("12 %. Use relax=False to disable them") == "12 %. Set Relaxation cuts to disabled to disable them"
    assert in_window("Pass cuts='automatic' or repair='cuts'") == "Set Cuts to automatic or repair='cuts'"
    assert in_window("Pass cuts or relax=True") == "Pass cuts or Relaxation cuts: enabled"
