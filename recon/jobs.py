"""What an executor is given and what it gives back: jobs and their outcomes.

    for job in jobs:
        yield attempt(job)

A job can be pickled. It does all its work itself, writes its result itself, and returns an outcome instead of raising.
What happens to it from outside, its executor tells by `job.lost(code, text)`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

from recon.problems import shortened
from recon.storage.json_text import readable

DIED: Final = "died"
TIMED_OUT: Final = "timed_out"
OUT_OF_MEMORY: Final = "out_of_memory"
FAULT: Final = "fault"

_LONGEST: Final = 1000
"""Characters of a sentence about a job: what a stage raises can hold a whole log."""


@dataclass(frozen=True)
class Outcome:
    """How a job ended.

    job : its key
    code : "" where it is done, else one word for the reason; `text` and `hint` are the sentences for people, which are
        made to be Unicode text of at most 1000 characters, whatever a stage or a file name put into them
    seconds : how long it took
    """

    job: str
    code: str = ""
    text: str = ""
    hint: str = ""
    seconds: float = 0.0

    def __post_init__(self) -> None:
        for name in ("text", "hint"):
            object.__setattr__(self, name, shortened(readable(getattr(self, name)), _LONGEST))

    @property
    def ok(self) -> bool:
        """Is its result there?"""
        return not self.code


class Job(Protocol):
    """One piece of work.

    key : what it is called, the same for no other job of the batch
    timeout : s, and memory : bytes, beyond which the executor ends it; None is without limit
    """

    @property
    def key(self) -> str:
        """What it is called."""

    @property
    def timeout(self) -> float | None:
        """Seconds that it may take."""

    @property
    def memory(self) -> int | None:
        """Bytes that its process may hold."""

    def run(self) -> Outcome:
        """Do the work."""

    def lost(self, code: str, text: str) -> Outcome:
        """The outcome of a job that could not tell it itself: DIED, TIMED_OUT, OUT_OF_MEMORY or FAULT, and why."""


def attempt(job: Job) -> Outcome:
    """Run a job here; whatever it raises, but an interruption, becomes its outcome."""
    try:
        return job.run()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a job is somebody else's code, and may even exit
        return job.lost(FAULT, f"{type(error).__name__}: {error}")
