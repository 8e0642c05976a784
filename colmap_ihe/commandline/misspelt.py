"""Refuse commands and options that there are not, with the nearest that there is; and take `help COMMAND`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

from colmap_ihe.errors import did_you_mean


def with_help(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with `help COMMAND` written as `COMMAND --help`."""
    if arguments and arguments[0] == "help":
        return [*(name for name in arguments[1:2] if name != "help"), "--help"]
    return list(arguments)


def commands_of(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    """Return the parsers of the commands, by name."""
    actions = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return next(actions).choices


def refuse_misspelt(parser: argparse.ArgumentParser, arguments: Sequence[str]) -> None:
    """Exit with status 2 and one line for a command or a long option that there is not; argparse refuses the rest."""
    if not arguments or arguments[0].startswith("-"):
        return
    commands = commands_of(parser)
    if arguments[0] not in commands:
        hint = did_you_mean(arguments[0], commands) or f"expected one of {', '.join(commands)}"
        parser.error(f"no command {arguments[0]!r}: {hint}")
    command = commands[arguments[0]]
    for text in arguments[1:]:
        name = text.partition("=")[0]
        if text == "--":
            return
        if name.startswith("--") and not any(
            known.startswith(name) for known in command._option_string_actions
        ):
            hint = did_you_mean(name, command._option_string_actions) or f"see colmap-ihe help {arguments[0]}"
            command.error(f"no option {name}: {hint}")
