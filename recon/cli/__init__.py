"""The command line, one verb for each module here: `recon VERB ...`.

    0    done                                    4    a log cannot be read, or does not hold what is needed
    1    a fault of recon itself                 5    a stage failed
    2    a pipeline or an option is wrong        6    a batch in which some jobs failed
    3    a plugin cannot be used                 7    a sealed run is not as it was sealed
    130  interrupted    143  terminated          8    a result could not be written
    129  its terminal is gone                    141  nobody reads the output

Results go to standard output; progress and errors, `error: <what>` and an indented hint, to standard error. Modules
are imported by the verb that needs them, so that `recon --help` costs nothing; this one imports nearly nothing, so that
Ctrl-C finds it ready.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Final, NoReturn

from recon.cli import _signals as signals

if TYPE_CHECKING:
    from collections.abc import Sequence

EXIT_FAULT: Final = 1
EXIT_PIPE: Final = 141
"""128 + SIGPIPE: what other programs exit with when their reader goes away."""

_VERBOSE: Final = ("-v", "--verbose")
_OBJECTS_BETWEEN_COLLECTIONS: Final = 100_000
"""Modules make hundreds of thousands of objects that stay: looking for garbage among them is a tenth of the start."""


def command() -> NoReturn:
    """The command as a process. All is written when `main` returns, so it ends without taking every object apart.

    That takes Python and Arrow 0.2 s for an hour of a drive.
    """
    code = main()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError):  # closed by the caller, or nobody reads it
            stream.flush()
    os._exit(code)


def main(args: Sequence[str] | None = None) -> int:
    """Run one command line, by default the process's own; returns the exit code and raises nothing.

    For the process's own, SIGTERM is heeded too, and no signal counts any more when all is done.
    """
    try:
        if args is None:
            signals.heed()
        code = _run(sys.argv[1:] if args is None else args)
        signals.hold()
    except KeyboardInterrupt as interruption:
        signals.hold()
        code = _stopped(interruption)
    return code


def _run(args: Sequence[str]) -> int:
    from recon import arithmetic
    from recon.cli import _console as console

    arithmetic.portable()
    arithmetic.threadless()
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    console.prepare()
    words, verbose = _without_verbose(args)
    try:
        from recon.cli._app import invoke

        return invoke(words)
    except BrokenPipeError:
        console.abandon_output()
        return EXIT_PIPE
    except Exception as error:  # the last resort: a user never sees a traceback unless he asks
        if isinstance(
            error.__context__, KeyboardInterrupt
        ):  # that is what ended it; a terminal that is gone raises, too
            raise error.__context__ from None
        return _report(error, verbose=verbose)


def _without_verbose(words: Sequence[str]) -> tuple[list[str], bool]:
    """-v is understood anywhere before `--`: who is told to add it adds it at the end."""
    end = words.index("--") if "--" in words else len(words)
    kept = [word for word in words[:end] if word not in _VERBOSE]
    return [*kept, *words[end:]], len(kept) < end


def _stopped(interruption: KeyboardInterrupt) -> int:
    from recon.cli import _console as console
    from recon.errors import EXIT_INTERRUPTED

    terminated = isinstance(interruption, signals.Terminated)
    told = str(interruption) or "nothing was written"
    console.write_error(f"{'terminated' if terminated else 'interrupted'}; {told}")
    return interruption.exit_code if isinstance(interruption, signals.Terminated) else EXIT_INTERRUPTED


def _report(error: Exception, *, verbose: bool) -> int:
    from recon.cli import _console as console
    from recon.errors import ConfigError, ReconError

    if verbose:
        import traceback

        console.write_error("".join(traceback.format_exception(error)).rstrip())
    if isinstance(error, ConfigError):
        console.write_error("\n".join(problem.as_text() for problem in error.problems))
    elif isinstance(error, ReconError):
        hint = "".join(f"\n  {line.strip()}" for line in error.hint.splitlines())
        console.write_error(f"error: {error.message}{hint}")
    else:
        seen = "" if verbose else ", '-v' shows where"
        console.write_error(f"error: this is a fault of recon, please report it{seen}: {type(error).__name__}: {error}")
    return error.exit_code if isinstance(error, ReconError) else EXIT_FAULT
