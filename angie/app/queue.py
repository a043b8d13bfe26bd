"""One queue of videos: waiting, drawn one after the other, kept for a while, gone.

Whoever asks has a name (`owner`) and sees jobs by their ids alone, which cannot be guessed. All
files of a job lie in a folder of its own, which goes with it.
"""

import secrets
import shutil
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

from angie.request import Pipelines, Request
from data_prep.errors import BadInput, Cancelled
from data_prep.media.audio import open_recording
from data_prep.media.container import check_file
from data_prep.progress import Step

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from angie.pipeline import GesturePipeline
    from angie.video import GestureVideo

WAITING, RUNNING, DONE, FAILED, CANCELLED = "waiting", "running", "done", "failed", "cancelled"


class Busy(Exception):
    """There is no room for another job now; the message says why."""


@dataclass(frozen=True)
class Limits:
    """What a job may take.

    Attributes:
        upload: bytes of a file.
        seconds: of a recording.
        pixels: of a photo.
        waiting: jobs that wait, in all.
        each: jobs that wait or run for one owner with a name.
        kept: seconds that a job stays after it has ended.
    """

    upload: int = 50_000_000
    seconds: float = 300.0
    pixels: int = 50_000_000
    waiting: int = 20
    each: int = 4
    kept: float = 3600.0

    def check(self, photo: Path, audio: Path) -> None:
        """Refuse inputs that are too large, before they are read whole.

        Raises:
            BadInput: what is too large, or cannot be read.
        """
        for path in (photo, audio):
            check_file(path)
            if path.stat().st_size > self.upload:
                raise BadInput(
                    f"{path}: has more than {self.upload / 1e6:g} MB; give a smaller file"
                )
        if _pixels(photo) > self.pixels:
            raise BadInput(f"{photo}: has more than {self.pixels / 1e6:g} megapixels; reduce it")
        with open_recording(audio) as recording:
            most, heard = self.seconds * recording.rate, 0
            for block in recording.blocks():
                heard += block.shape[1]
                if heard > most:
                    raise BadInput(
                        f"{audio}: lasts more than {self.seconds:g} s; give a shorter one"
                    )


def _pixels(photo: Path) -> int:
    """Number of a picture's pixels, as its file says; 0 where it cannot be read."""
    try:
        with Image.open(photo) as image:
            return image.width * image.height
    except (OSError, ValueError, SyntaxError):
        return 0  # told when it is read
    except Image.DecompressionBombError:
        return sys.maxsize


@dataclass
class Job:
    """A video that was asked for.

    Attributes:
        id: that nobody can guess.
        owner: who asked.
        request: what is asked for; its files lie in `folder`.
        folder: of everything that belongs to the job.
        after: called with the video and its pipeline once it is drawn; its result is `extra`.
        state: "waiting", "running", "done", "failed" or "cancelled".
        step: how far it is.
        message: why it failed, or what is to be known of the video.
        video: the file, once it is done.
        ended: set when nothing more will happen.
    """

    id: str
    owner: str
    request: Request
    folder: Path
    after: Callable[["GestureVideo", "GesturePipeline"], Any] | None = None
    state: str = WAITING
    step: Step | None = None
    message: str = ""
    video: Path | None = None
    extra: Any = None
    ended: threading.Event = field(default_factory=threading.Event)
    stop: bool = False
    began: float = 0.0
    finished: float = 0.0
    frames: int = 0

    @property
    def picture(self) -> "NDArray | None":
        """The last picture drawn so far, (H, W, 3) uint8 RGB."""
        return None if self.step is None else self.step.picture

    @property
    def share(self) -> float:
        """How much of the frames is drawn, 0 to 1."""
        if self.state == DONE:
            return 1.0
        if self.step is None or self.step.label != "render" or not self.step.total:
            return 0.0
        return min(1.0, self.step.done / self.step.total)

    @property
    def seconds_left(self) -> float | None:
        """Seconds until it is done, as far as that can be told while it is drawn."""
        if self.state != RUNNING or not self.share:
            return None
        return (time.monotonic() - self.began) * (1 - self.share) / self.share

    def listen(self, step: Step) -> None:
        """Keep how far it is; ends the work if nobody wants it any more."""
        if self.stop:
            raise Cancelled(self.id)
        if step.label == "render" and (self.step is None or self.step.label != "render"):
            self.began = time.monotonic()
        self.step = step


class Queue:
    """Draws videos one after the other in a thread of its own; a context manager.

    Args:
        pipelines: that draw them.
        limits: of each job.
    """

    def __init__(self, pipelines: Pipelines, limits: Limits | None = None) -> None:
        self.pipelines, self.limits = pipelines, limits or Limits()
        self.root = Path(tempfile.mkdtemp(prefix="angie-"))
        self._jobs: dict[str, Job] = {}
        self._waiting: deque[Job] = deque()
        self._lock = threading.Condition()
        self._closed = False
        self._worker = threading.Thread(target=self._work, name="videos", daemon=True)
        self._worker.start()

    def folder(self) -> Path:
        """A new folder for the files of a job; `submit` takes it over."""
        path = self.root / secrets.token_urlsafe(16)
        path.mkdir()
        return path

    def submit(
        self,
        request: Request,
        folder: Path,
        owner: str = "",
        after: Callable[["GestureVideo", "GesturePipeline"], Any] | None = None,
    ) -> Job:
        """Put a job at the end of the queue.

        Args:
            request: whose files lie in `folder`, which `folder()` made.
            folder: goes with the job, or now if it is refused.
            owner: who asks.
            after: see `Job`.

        Raises:
            BadInput: inputs that cannot be used.
            Busy: too many jobs wait.
        """
        self.sweep()
        try:
            request.check()
            assert request.audio is not None
            self.limits.check(request.photo, request.audio)
            job = Job(folder.name, owner, request, folder, after)
            with self._lock:
                busy = sum(one.state in (WAITING, RUNNING) for one in self.of(owner))
                if owner and busy >= self.limits.each:
                    raise Busy(f"{self.limits.each} of your videos wait already; wait for one")
                if len(self._waiting) >= self.limits.waiting:
                    raise Busy("too many videos wait; try again in some minutes")
                self._jobs[job.id] = job
                self._waiting.append(job)
                self._lock.notify()
        except BadInput as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise BadInput(self.plain(str(error), folder)) from error
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return job

    def get(self, name: str) -> Job | None:
        """The job of an id, or None."""
        with self._lock:
            return self._jobs.get(name)

    def ahead(self, job: Job) -> int:
        """Jobs that come before one that waits."""
        with self._lock:
            running = sum(one.state == RUNNING for one in self._jobs.values())
            place = self._waiting.index(job) if job in self._waiting else 0
            return place + running

    def counts(self) -> dict[str, int]:
        """How many jobs wait, run, and are kept."""
        with self._lock:
            states = [job.state for job in self._jobs.values()]
        return {"waiting": states.count(WAITING), "running": states.count(RUNNING),
                "kept": len(states)}  # fmt: skip

    def cancel(self, job: Job) -> None:
        """Stop a job, wherever it is; its files go as soon as it has stopped."""
        with self._lock:
            job.stop = True
            if job in self._waiting:
                self._waiting.remove(job)
                self._end(job, CANCELLED)

    def forget(self, job: Job) -> None:
        """Stop a job and let go of all that belongs to it."""
        self.cancel(job)
        with self._lock:
            self._jobs.pop(job.id, None)
        if job.ended.is_set():
            shutil.rmtree(job.folder, ignore_errors=True)

    def drop(self, owner: str) -> None:
        """Forget all jobs of an owner, who has gone."""
        for job in self.of(owner):
            self.forget(job)

    def of(self, owner: str) -> list[Job]:
        """Jobs of an owner."""
        with self._lock:
            return [job for job in self._jobs.values() if job.owner == owner]

    def sweep(self) -> None:
        """Forget jobs that ended long ago."""
        now = time.monotonic()
        with self._lock:
            old = [
                job for job in self._jobs.values()
                if job.ended.is_set() and now - job.finished > self.limits.kept
            ]  # fmt: skip
        for job in old:
            self.forget(job)

    def close(self) -> None:
        """Stop everything and remove all files."""
        with self._lock:
            self._closed = True
            for job in self._jobs.values():
                job.stop = True
            self._lock.notify()
        self._worker.join()
        shutil.rmtree(self.root, ignore_errors=True)

    def __enter__(self) -> "Queue":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _work(self) -> None:
        while True:
            with self._lock:
                while not self._waiting and not self._closed:
                    self._lock.wait(60)
                if self._closed:
                    for job in self._waiting:
                        self._end(job, CANCELLED)
                    return
                job = self._waiting.popleft()
                job.state, job.began = RUNNING, time.monotonic()
            self._draw(job)
            self.sweep()

    def _draw(self, job: Job) -> None:
        """Carry out one job; whatever becomes of it, the next one has its turn."""
        try:
            pipeline = self.pipelines.of(job.request)
            video = job.request.make(pipeline, callback=job.listen)
            path = job.folder / f"video.{job.request.format or 'mp4'}"
            video.save(path, consent=job.request.consent, callback=job.listen)
            job.frames, job.message = video.frames, self.plain(video.note, job.folder)
            if job.after is not None:
                job.extra = job.after(video, pipeline)
            job.video, state = path, DONE
        except Cancelled:
            state = CANCELLED
        except (BadInput, OSError) as error:
            job.message, state = self.plain(str(error), job.folder), FAILED
        except Exception as error:  # a bug; the queue goes on, and says what it was
            job.message, state = f"{type(error).__name__}: {error}", FAILED
        with self._lock:
            self._end(job, CANCELLED if job.stop else state)

    def _end(self, job: Job, state: str) -> None:
        """Note how a job ended; called with the lock."""
        job.state, job.finished = state, time.monotonic()
        if job.step is not None:
            job.step = Step(job.step.label, job.step.done, job.step.total, job.step.unit)
        forgotten = job.id not in self._jobs
        if state != DONE or forgotten:
            shutil.rmtree(job.folder, ignore_errors=True)
        job.ended.set()

    @staticmethod
    def plain(text: str, folder: Path) -> str:
        """A message without the folders of this machine."""
        return text.replace(f"{folder}/", "")
