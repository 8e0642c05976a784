"""Run the command that was typed. The only place that configures logging and signals."""

from __future__ import annotations

import argparse
import io
import logging
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from colmap_ihe.colmap.native import hear_colmap
from colmap_ihe.commandline.arguments import CommandFunction, parser_of
from colmap_ihe.commandline.bars import Terminal
from colmap_ihe.commandline.commands import COMMANDS
from colmap_ihe.commandline.display import Display
from colmap_ihe.commandline.json_lines import JsonLines
from colmap_ihe.commandline.misspelt import refuse_misspelt, with_help
from colmap_ihe.errors import Cancelled, KnownError
from colmap_ihe.machine import memory

EXIT_FAILED, EXIT_CANCELLED = 1, 130
_STOPPING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGBREAK") if hasattr(signal, name)]
"""Ctrl-C, `kill`, and Ctrl-Break of Windows."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status: 0 done, 1 a known failure, 130 cancelled. Wrong usage exits with
    2."""
    typed, parser = with_help(sys.argv[1:] if arguments is None else arguments), parser_of(COMMANDS)
    refuse_misspelt(parser, typed)
    parsed = parser.parse_args(typed)
    parsed.arguments = typed
    warnings.filterwarnings("ignore", module=r"PIL\b")  # of broken photographs, which we name ourselves
    logging.basicConfig(level=logging.WARNING, format="%(name)s: %(message)s", stream=sys.stderr)
    if parsed.verbose:
        logging.getLogger("colmap_ihe").setLevel(logging.INFO)
        hear_colmap()
    display = _display(parsed)
    handlers = _listen(display)
    try:
        run: CommandFunction = parsed.run
        run(parsed, display)
        sys.stdout.flush()
    except KnownError as error:
        display.screen.failed(str(error), error.hint or "")
        return EXIT_FAILED
    except (Cancelled, KeyboardInterrupt):
        same = "without --from, it" if getattr(parsed, "start", None) else "the same command"
        display.screen.failed(f"stopped; {same} goes on from here", "")
        return EXIT_CANCELLED
    except BrokenPipeError:
        _drop_stdout()
    except OSError as error:
        _drop_stdout()
        path = f"{error.filename}: " if error.filename else ""
        display.screen.failed(f"{path}{error.strerror or error}", "")
        return EXIT_FAILED
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return 0


def _drop_stdout() -> None:
    """Drop what could not be printed, so that it is not tried again as the process ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _listen(display: Display) -> dict[int, Any]:
    """Ask what is running to stop at the first of these signals, and end at the second. Return the handlers before."""

    def on_signal(number: int, _frame: object) -> None:
        display.stop()
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)

    return {number: signal.signal(number, on_signal) for number in _STOPPING}


def _display(parsed: argparse.Namespace) -> Display:
    if parsed.json == "lines":
        return Display(JsonLines())
    return Display(Terminal(quiet=parsed.quiet, verbose=parsed.verbose))


def entry_point() -> None:
    """Run the command line as a process of its own."""
    memory.begin_sparing()
    if isinstance(
        sys.stdout, io.TextIOWrapper
    ):  # a terminal without a character shows its code, as on stderr
        sys.stdout.reconfigure(errors="backslashreplace")
    status_code = main()
    sys.stderr.flush()
    # A mapper that cannot be asked to stop may still be on its thread: Python's own exit would wait for it.
    if status_code == EXIT_CANCELLED:
        os._exit(EXIT_CANCELLED)
    sys.exit(status_code)


if __name__ == "__main__":
    entry_point()
