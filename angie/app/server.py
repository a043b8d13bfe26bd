"""The application that is served: the service, the page if it is wanted, and the guard before."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from angie.app.guard import Guard
from angie.app.queue import Queue
from angie.app.service import service

FIELDS = 1_000_000
"""Bytes of a request beside its files."""


def application(
    queue: Queue, speaker: Path | None, *, token: str | None, local: bool, page: bool
) -> Callable[..., Any]:
    """What uvicorn runs.

    Args:
        queue: that draws.
        speaker: bundle of every video; None is the one that ships.
        token: see `Guard`.
        local: see `Guard`.
        page: show the web page at the root.
    """
    app: Any = service(queue, speaker)
    if page:
        from angie.app.page import with_page

        app = with_page(app, queue, speaker)
    files = 3  # photo, recording, transcript
    return Guard(app, token=token, body=files * queue.limits.upload + FIELDS, local=local)
