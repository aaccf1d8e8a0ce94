"""A detached job: a trace(), render() or heatmap() that goes on in the daemon without its client.

The daemon keeps the answer in memory for an hour (--result-ms-max). It drops the answer earlier after
cancel(), or, once it was fetched, when newer answers need the memory.
"""
from __future__ import annotations

import contextlib
import functools
from typing import Any, Iterator, Optional

from . import errors
from ._net.connection import Connection
from ._net.control import Message
from ._requests.arguments import milliseconds, none_is_default, whole
from ._requests.columns import REDUCED, Columns, Whole
from ._requests.job import Progress
from ._requests.picture import Payload
from ._requests.query import Answer
from ._requests.words import check_listed, job_info
from ._session import Session


class Job:
    """A job, made with `detach` or by Client.job(), also on another connection of the same owner. The columns `ring` and
    `time` of a generator come with the answer of the former alone: the latter has no generator."""

    def __init__(self, client: Session, number: int, own: Optional[Columns] = None) -> None:
        self.number = whole("job", number, 2**64 - 1)
        self._client = client
        self._own = own or {}       # columns that follow from the rays, which the daemon's answer lacks
        self._cancelled = False     # by this object

    def __repr__(self) -> str:
        return f"<raynest.Job {self.number} at {self._client.uri}>"

    @property
    def info(self) -> dict[str, Any]:
        """The job's entry in Client.jobs(). Raises InvalidError if the daemon does not know the job (any more)."""
        for info in job_infos(self._client.connection, self.number - 1):
            if info["job"] == self.number:
                return info
            break
        raise errors.InvalidError(f"there is no job {self.number}, or its answer is gone; see "
                                  "Client.jobs()", "JOB_UNKNOWN")

    @none_is_default
    def wait(self, *, deadline: float = 0.0, progress: Progress = None) -> Job:
        """Waits for the job's end and returns the job; raises the job's error if it failed. After
        `deadline` seconds (0: no limit) it raises DeadlineError. That, like Ctrl-C, ends the wait and
        not the job. After cancel() it raises CancelledError."""
        self._check_cancelled()
        return self._client.connection.again(lambda: self._wait(deadline, progress))

    def _wait(self, deadline: float, progress: Progress) -> Job:
        message = {"job": self.number, "deadline_ms": milliseconds(deadline)}
        frames = self._client.connection.exchange("Wait", message, deadline)
        info: Message = {}
        try:
            with self._client.connection.interrupts, contextlib.closing(frames):
                for kind, info in frames:
                    if kind == "Progress" and progress:
                        progress(info["done"], info["total"], info["stage"])
        except errors.DeadlineError as late:
            raise errors.DeadlineError(f"job {self.number} still runs; wait again, or cancel it",
                                       late.name) from None
        if info.get("code"):
            failure = errors.from_daemon(info["code"], f"job {self.number}: {info['error']}", 0)
            failure.lost = False  # it is the job that ended
            raise failure
        return self

    def fetch(self, *, progress: Progress = None) -> Any:
        """Returns the answer of the original call, any number of times. Raises BusyError while the job runs.
        An answer that was fetched is dropped when the daemon needs its room."""
        self._check_cancelled()
        return self._client.connection.again(functools.partial(self._fetch, progress))

    def _fetch(self, progress: Progress) -> Any:
        client, message = self._client, {"job": self.number}
        info = self.info
        if info["kind"] != "query":
            picture = Payload(info["kind"])
            pixels = picture.receive(client.connection, "Fetch", message, progress)
            client.outcome = picture.outcome
            return pixels
        answer, rows = Answer(client.connection, "Fetch", message), Whole(None)
        with client.connection.interrupts, contextlib.closing(answer.chunks(rows.place)) as chunks:
            for _ in chunks:
                if progress:
                    total = 0 if info["detail"] in REDUCED else info["total"]  # rays, not rows
                    progress(answer.answered, max(total, answer.answered), "fetching")
        client.outcome = answer.outcome
        answer.outcome.warn_of_rays()
        return {**rows.columns(), **self._own}

    def cancel(self) -> None:
        """Cancels the job and drops its answer."""
        self._client.connection.ask("CancelJob", {"job": self.number}, "JobInfo")
        self._cancelled = True

    def _check_cancelled(self) -> None:
        """The daemon forgets a job that is cancelled, and would not know why."""
        if self._cancelled:
            raise errors.CancelledError(f"job {self.number} was cancelled, and its answer dropped",
                                        "CANCELLED")


def job_infos(connection: Connection, after: int = 0) -> Iterator[Message]:
    """Yields the jobs of all clients with a number above `after`, in order."""
    listed = 0
    while True:
        page = connection.ask("Jobs", {"after": after}, "JobList")
        listed += len(page["jobs"])
        check_listed(listed)
        for info in page["jobs"]:
            if info["job"] <= after:
                raise errors.ProtocolError("the daemon listed a job twice, or one not asked for")
            after = info["job"]
            yield job_info(info)
        if not page["more"] or not page["jobs"]:
            return
