"""Program of a decoder: it answers one question at a time about a photograph. `machine.decoder_pool` starts it."""

from __future__ import annotations

import sys
import traceback
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
from numpy.typing import NDArray

from colmap_ihe.errors import KnownError
from colmap_ihe.machine import decoder_wire
from colmap_ihe.machine.child_process import (
    Channel,
    channel_to_parent,
    die_with_parent,
    forget_own_words,
)
from colmap_ihe.machine.decoder_process import BROKEN
from colmap_ihe.machine.decoder_wire import (
    Message,
    SharedArrayWriter,
    call_from_plain,
    receive,
    send,
    to_plain,
)
from colmap_ihe.machine.system import data_limited, offer_to_be_killed
from colmap_ihe.photographs import colour_counts
from colmap_ihe.photographs.exif import metadata  # noqa: F401  so that no question waits for its import

_LIKELIER = 900  # than a run to be ended where memory runs out
_COUNTING = (colour_counts.count_photograph, colour_counts.hand_over_counts)


def main() -> None:
    """Answer the parent until it is gone. The folder for arrays that both map is the second argument."""
    warnings.simplefilter("ignore")  # of broken photographs, which we name ourselves
    cv2.setNumThreads(1)
    offer_to_be_killed(_LIKELIER)
    die_with_parent()
    decoder_wire.answer_memory = memory = SharedArrayWriter(Path(sys.argv[2]) if sys.argv[2] else None)
    with channel_to_parent() as channel, suppress(ConnectionError):
        send(channel, {"ready": True})
        while (received := receive(channel)) is not None:
            _answer(channel, received[0], memory)


def _answer(channel: Channel, request: Message, memory: SharedArrayWriter) -> None:
    forget_own_words()
    if not request["free"]:  # what was sent before is still in use
        memory.leave()
    answer: Message
    fd = None
    try:
        function, arguments = call_from_plain(request)
        if function not in _COUNTING:
            colour_counts.free_counter()
        with data_limited(request["memory"]):
            arrays: list[NDArray[Any]] = []
            answer = {"value": to_plain(function(*arguments), arrays)}
            if arrays:
                about, fd = memory.put(arrays)
                answer |= about
    except KnownError as error:
        answer = {"error": type(error).__name__, "message": str(error), "hint": error.hint}
    except MemoryError:
        message = f"{request['name']}: not enough memory to decode it"
        answer = {"error": "PhotographError", "message": message, "hint": "free memory, or take it out"}
    except Exception as error:  # noqa: BLE001  whatever a broken file brings a decoder to raise is about that file
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        answer = {
            "error": "PhotographError",
            "message": f"{request['name']}: cannot be read ({reason})",
            "hint": BROKEN,
            "traceback": traceback.format_exc(),
        }
    send(channel, answer, fd)
    if "arrays" in answer:
        memory.sent()
