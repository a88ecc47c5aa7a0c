# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: `adaptive-terrain VERB`, and the same as `blender --command adaptive_terrain VERB`.

Exit codes: 0 done, 1 failed (one line on stderr says why), 2 wrong usage, 130 stopped by Ctrl-C, 143 by SIGTERM. bpy is
imported only by verbs that need it; the engine, whose import takes a moment, only where an interruption is reported in
one line.
"""

import argparse
import gc
import re
import signal
import sys
from typing import NoReturn

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.run import stopping
from ..text.console import LONGEST_LINE, OPENJD, open_streams, print_json, print_line, why_stdout_failed
from . import verbs
from .parser import PROGRAM, build_parser


def main(argv: list[str] | None = None) -> int:
    """Run one command; `argv` without the program's name (None: the process's own). Returns the exit code.

    Inside `stopping.listening` a signal raises KeyboardInterrupt between two steps of the work.
    """
    with stopping.listening():
        try:
            return _run(argv)
        except KeyboardInterrupt:
            print(f"{PROGRAM}: stopped", file=sys.stderr)
            return 128 + (stopping.answer() or signal.SIGINT)  # the signal that requested the stop
        finally:
            stopping.answer()  # forget a request that came after the work


def program() -> NoReturn:
    """Run `main` as a program: before and after the work Ctrl-C ends it without a traceback."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    open_streams()
    sys.exit(main())


def _run(argv: list[str] | None) -> int:
    """Parse the arguments and run their verb; print errors as one line on stderr. Returns the exit code."""
    try:
        words = _with_negatives_joined(sys.argv[1:] if argv is None else argv)
        arguments = _build_parser_without_gc(words).parse_args(words)
        arguments.run(arguments)
        print(end="", flush=True)  # an error of stdout is raised here, not at the exit of Python
    except SystemExit as exit_:  # argparse has printed its message
        return exit_.code or 0
    except verbs.UsageError as error:
        _print_error({"what": str(error)}, shown(error, LONGEST_LINE), arguments.json_errors, f" {arguments.verb}")
        return 2
    except (TerrainError, OSError, MemoryError) as reason:
        error = _too_little_memory(reason) if isinstance(reason, MemoryError) else reason
        message = why_stdout_failed(error) or shown(_error_text(error), LONGEST_LINE)
        fields = error.to_json() if isinstance(error, TerrainError) else {"what": str(message)}
        _print_error(fields, message, arguments.json_errors)
        if arguments.progress == OPENJD:
            print_line(message, "openjd_fail")
        return 1
    return 0


def _print_error(fields: dict, message: object, as_json: bool, verb: str = "") -> None:
    """Print an error on stderr as one line: its fields as JSON, or its message after the program and the verb."""
    if as_json:
        print_json(fields, sys.stderr)
    else:
        print_line(f"{PROGRAM}{verb}: error: {message}", file=sys.stderr)


def _too_little_memory(reason: MemoryError) -> TerrainError:
    """Return the error for memory that the system refuses. The text of `reason` says how much, or is empty."""
    what = f"The memory does not suffice ({reason})" if str(reason) else "The memory does not suffice"
    return TerrainError(what, fix="ask for less detail or fewer samples, or raise the limit of memory")


def _error_text(error: TerrainError | OSError) -> object:
    """Return an error that prints as one sentence: a system's error is given its file and reason."""
    if isinstance(error, TerrainError) or error.filename is None:
        return error
    return f"{error.filename} cannot be read or written ({error.strerror}); check the disk, or choose another place."


def _build_parser_without_gc(words: list[str]) -> argparse.ArgumentParser:
    """Build the parser, with the options of the verb in `words` alone, the first word that is no option.

    `--json` before it makes the parser print wrong usage as JSON. Garbage collection would search all imported modules
    for 0.1 s.
    """
    first = next((n for n, word in enumerate(words) if not word.startswith("-")), len(words))
    chosen, json_errors = "".join(words[first : first + 1]), "--json" in words[:first]
    gc.disable()
    try:
        return build_parser(chosen, json_errors)
    finally:
        gc.enable()


def _with_negatives_joined(argv: list[str]) -> list[str]:
    """Join values below 0, such as -1e9 or the frames -5--1, to their option: argparse takes them for an option."""
    joined = []
    for word in argv:
        if joined and re.match("--[^=]+$", joined[-1]) and re.match(r"-(\.?\d|inf|nan)", word, re.IGNORECASE):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


if __name__ == "__main__":
    program()
