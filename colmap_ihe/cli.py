"""The command line: call what `arguments` parsed, and print. The only place that configures logging and signals."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from colmap_ihe.colmap.native import hear_colmap
from colmap_ihe.commandline.arguments import CommandFunction, parser_of
from colmap_ihe.commandline.bars import Bars
from colmap_ihe.commandline.commands import RUNS
from colmap_ihe.commandline.display import Display
from colmap_ihe.commandline.json_lines import JsonLines
from colmap_ihe.errors import Cancelled, KnownError
from colmap_ihe.machine import memory

EXIT_FAILED, EXIT_CANCELLED = 1, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit status: 0 done, 1 a known failure, 130 cancelled. Wrong usage
    exits with 2."""
    parsed = parser_of(RUNS).parse_args(arguments)
    parsed.arguments = sys.argv[1:] if arguments is None else list(arguments)
    warnings.filterwarnings("ignore", module=r"PIL\b")  # of broken photographs, which we name ourselves
    logging.basicConfig(level=logging.WARNING, format="%(name)s: %(message)s", stream=sys.stderr)
    if parsed.verbose:
        logging.getLogger("colmap_ihe").setLevel(logging.INFO)
        hear_colmap()
    follower = _follower(parsed)
    before = _listen(follower)
    try:
        run: CommandFunction = parsed.run
        run(parsed, follower)
        sys.stdout.flush()
    except KnownError as error:
        follower.failed(str(error), error.hint or "")
        return EXIT_FAILED
    except (Cancelled, KeyboardInterrupt):
        same = "without --from, it" if getattr(parsed, "start", None) else "the same command"
        follower.failed(f"stopped; {same} goes on from here", "")
        return EXIT_CANCELLED
    except BrokenPipeError:
        _drop_stdout()
    except OSError as error:
        _drop_stdout()
        place = f"{error.filename}: " if error.filename else ""
        follower.failed(f"{place}{error.strerror or error}", "")
        return EXIT_FAILED
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def _drop_stdout() -> None:
    """What could not be printed is not tried again as the process ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _listen(follower: Display) -> dict[int, Any]:
    """The first Ctrl-C or SIGTERM asks what is running to stop; a second one does not ask."""

    def on_signal(number: int, _frame: object) -> None:
        follower.stop()
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)

    return {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}


def _follower(parsed: argparse.Namespace) -> Display:
    return JsonLines() if parsed.json == "lines" else Bars(quiet=parsed.quiet, verbose=parsed.verbose)


def entry_point() -> None:
    memory.begin_sparing()
    status_code = main()
    sys.stderr.flush()
    # A mapper that cannot be asked to stop may still be on its thread: Python's own exit would wait for it.
    if status_code == EXIT_CANCELLED:
        os._exit(EXIT_CANCELLED)
    sys.exit(status_code)


if __name__ == "__main__":
    entry_point()
