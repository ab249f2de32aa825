"""The rules that every option of every command obeys, tested on options collected from the commands themselves."""

import click
import pytest
from command_line import run

from voxflat import cli


def every_option():
    context = click.Context(cli.main)
    for name in sorted(cli.main.commands):
        for one in cli.main.get_command(context, name).params:
            if isinstance(one, click.Option):
                yield name, one


OPTIONS = [pytest.param(name, one, id=f"{name} {one.opts[-1]}") for name, one in every_option()]


@pytest.mark.parametrize(("command", "option"), OPTIONS)
def test_an_option_that_is_given_twice_is_used_twice_or_refused_by_its_name(command, option):
    values = [] if option.is_flag else ["1"] * option.nargs
    words = [option.opts[-1], *values]
    if option.multiple:
        parser = cli.main.get_command(click.Context(cli.main), command).make_parser(click.Context(cli.main))
        assert len(parser.parse_args([*words, *words])[0][option.name]) == 2
        return
    result = run(command, *words, *words)
    assert result.exit_code == 2, result.output
    *_, line = result.stderr.strip().splitlines()
    assert line == f"Error: {option.opts[-1]} is given twice. Give it once."
    second = (option.secondary_opts or option.opts)[0]  # another spelling is the same option
    assert run(command, *words, second, *values).exit_code == 2
