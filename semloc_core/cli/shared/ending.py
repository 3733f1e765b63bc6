"""How the command ends when it is stopped, when nobody reads on, and on a terminal that lacks a letter.

Nothing here imports more than Python's own: it is in force before the rest of the command is read.
"""

from __future__ import annotations

import codecs
import os
import signal
import sys
import threading
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED, UNREAD, TERMINATED = 130, 141, 143
"""Exit statuses: stopped by Ctrl-C; the reader of the output went away; stopped by SIGTERM."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)
PLAIN = {
    **dict.fromkeys("–—−‐‑─━╌╴╶╸╺", "-"),
    **dict.fromkeys("│┃", "|"),
    **dict.fromkeys("┌┐└┘├┤┬┴┼╭╮╯╰┏┓┗┛┡┩╇", "+"),
    **dict.fromkeys("‘’", "'"),
    **dict.fromkeys("“”", '"'),
    **dict.fromkeys("•●", "*"),
    "…": "...",
    "×": "x",
    "→": "->",
    "←": "<-",
    "≤": "<=",
    "≥": ">=",
    "✓": "v",
}
"""What stands for letters of the project's own that an encoding lacks."""


class Terminated(KeyboardInterrupt):
    """SIGTERM: what cleans up after Ctrl-C cleans up after it too."""


_asked = 0  # the exit status of a stop that was asked for
_working = False  # whether there is something that may have to be cleaned up


def plainly(error: UnicodeError) -> tuple[str, int]:
    """Codec error handler: a letter that an encoding lacks becomes one like it, or ``?``."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = []
    for letter in error.object[error.start : error.end]:
        plain = PLAIN.get(letter) or unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode()
        found.append(plain or "?")
    return "".join(found), error.end


def print_plainly() -> None:
    """Let stdout and stderr take any text, whatever their encoding."""
    codecs.register_error("semloc", plainly)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="semloc")


def install() -> dict[signal.Signals, object]:
    """Be stoppable from now on: at once while nothing is at work, else through the work's own cleaning up.

    Returns:
        Handlers that were there before; none where they are installed already, in other threads, or where the
        process was started to ignore a signal.

    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    here = {number: signal.getsignal(number) for number in SIGNALS}
    before = {number: was for number, was in here.items() if was not in (_stop, signal.SIG_IGN)}
    for number in before:
        signal.signal(number, _stop)
    return before  # type: ignore[return-value]


@contextmanager
def stops() -> Iterator[None]:
    """`install` for a block, if it is not in force already."""
    global _asked
    _asked = 0
    before = install()
    try:
        yield
    finally:
        for number, was in before.items():
            signal.signal(number, was)  # type: ignore[arg-type]


@contextmanager
def working() -> Iterator[None]:
    """Work that cleans up after itself when it is stopped; SystemExit with the exit status after that."""
    global _working
    _working = True
    try:
        yield
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise SystemExit(_say_stopped(TERMINATED if isinstance(error, Terminated) else INTERRUPTED)) from None
        if _asked:  # a library made another error of it
            raise SystemExit(_say_stopped(_asked)) from None
        raise
    finally:
        _working = False


def unread() -> int:
    """The exit status where the reader of the output went away; nothing more is written there."""
    gone = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            os.dup2(gone, stream.fileno())
    return UNREAD


def _stop(number: int, frame: FrameType | None) -> None:
    global _asked
    _asked = 128 + number
    if not _working:  # words are read, modules are imported: there is nothing to put in order
        os._exit(_say_stopped(_asked))
    raise Terminated if number == signal.SIGTERM else KeyboardInterrupt


def _say_stopped(status: int) -> int:
    try:
        sys.stderr.write("semloc: interrupted\n")
        sys.stderr.flush()
    except (OSError, RuntimeError):  # nobody to tell, or in the middle of another line
        pass
    return status
