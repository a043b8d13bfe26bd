"""The service: post a photo and a recording, ask how far it is, fetch the video, or stop it."""

import contextlib
import html
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI, Form, HTTPException, Request, UploadFile
from fastapi.responses import FileResponse, HTMLResponse

from angie import __version__
from angie import request as requests
from angie.app.queue import DONE, Busy, Job, Queue
from data_prep.errors import BadInput

MEDIA = {"mp4": "video/mp4", "webm": "video/webm", "gif": "image/gif"}

SUFFIX = 12
"""Most letters of the ending that an uploaded file keeps."""


@dataclass(frozen=True)
class Told:
    """What is known of a video."""

    id: str
    state: str
    """waiting, running, done, failed or cancelled"""
    share: float
    """of the frames that are drawn, 0 to 1"""
    seconds_left: float | None
    """while frames are drawn"""
    ahead: int
    """videos that are drawn before it, while it waits"""
    message: str
    """why it failed, or what is to be known of it"""
    video: str | None
    """where to fetch it, once it is done"""


@dataclass(frozen=True)
class Health:
    """How the service is."""

    status: str
    version: str
    waiting: int
    running: int
    kept: int


Text = Annotated[str, Form()]


def service(queue: Queue, speaker: Path | None = None) -> FastAPI:
    """The application, with its own page of documentation and no file from elsewhere.

    Args:
        queue: that draws; it is not closed here.
        speaker: bundle of every video; None is the one that ships.
    """
    app = FastAPI(
        title="angie", version=__version__, description=__doc__ or "", docs_url=None, redoc_url=None
    )

    @app.exception_handler(BadInput)
    def bad_input(_: Request, error: BadInput) -> Any:
        return _refusal(422, str(error))

    @app.exception_handler(Busy)
    def busy(_: Request, error: Busy) -> Any:
        return _refusal(429, str(error))

    def job_of(name: str) -> Job:
        job = queue.get(name)
        if job is None or job.owner:
            raise HTTPException(404, "no such video; it may have been kept for long enough")
        return job

    def told(job: Job) -> Told:
        video = f"/videos/{job.id}/file" if job.state == DONE else None
        left = job.seconds_left
        return Told(
            id=job.id, state=job.state, share=round(job.share, 4),
            seconds_left=None if left is None else round(left, 1),
            ahead=0 if job.ended.is_set() else queue.ahead(job), message=job.message, video=video,
        )  # fmt: skip

    @app.post("/videos", status_code=202)
    def ask(
        photo: UploadFile,
        audio: UploadFile,
        consent: Annotated[str, Form(description="how the person of the photo agreed")],
        words: UploadFile | None = None,
        generator: Text = "",
        style: Text = "",
        seed: Text = "",
        greedy: Text = "",
        amplitude: Text = "",
        temperature: Text = "",
        start: Text = "",
        fade: Text = "",
        scale_motion: Text = "",
        crop: Text = "",
        person: Text = "",
        size: Text = "",
        full_frame: Text = "",
        format: Text = "",
    ) -> Told:
        """Ask for a video; the options are those of `angie animate`."""
        given = {
            "generator": generator, "style": style, "seed": seed, "greedy": greedy,
            "amplitude": amplitude, "temperature": temperature, "start": start, "fade": fade,
            "crop": crop,
            "scale_motion": scale_motion, "person": person, "size": size,
            "full_frame": full_frame, "format": format, "consent": consent,
        }  # fmt: skip
        if not consent.strip():
            raise BadInput("consent: say how the person of the photo agreed to be animated")
        if format.strip() and format.strip() not in MEDIA:
            raise BadInput(f"format {format}: choose from {', '.join(MEDIA)}")
        with _received(queue) as folder:
            for name, file in (("photo", photo), ("audio", audio), ("words", words)):
                if file is not None and file.filename:
                    given[name] = receive(file, folder, name, queue.limits.upload)
            if speaker is not None:
                given["speaker"] = str(speaker.resolve())
            return told(queue.submit(requests.Request.read(given, folder), folder))

    @app.get("/videos/{name}")
    def how_far(name: str) -> Told:
        """How far a video is."""
        return told(job_of(name))

    @app.get("/videos/{name}/file", response_class=FileResponse)
    def fetch(name: str) -> FileResponse:
        """The video, once it is done."""
        job = job_of(name)
        if job.state != DONE or job.video is None:
            raise HTTPException(409, f"the video is {job.state}; there is no file")
        kind = MEDIA[job.video.suffix.removeprefix(".")]
        return FileResponse(job.video, media_type=kind, filename=f"angie{job.video.suffix}")

    @app.delete("/videos/{name}", status_code=204)
    def stop(name: str) -> None:
        """Stop a video, or remove it if it is done."""
        queue.forget(job_of(name))

    @app.get("/health")
    def health() -> Health:
        """Whether the service is well; needs no token."""
        return Health(status="ok", version=__version__, **queue.counts())

    @app.get("/docs", include_in_schema=False)
    def docs() -> HTMLResponse:
        return HTMLResponse(_page(app.openapi()))

    return app


def _refusal(status: int, text: str) -> Any:
    from fastapi.responses import JSONResponse

    return JSONResponse({"detail": text}, status)


@contextlib.contextmanager
def _received(queue: Queue) -> Iterator[Path]:
    """A folder for what is uploaded; it goes if the job is not taken."""
    folder = queue.folder()
    try:
        yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def receive(file: UploadFile, folder: Path, name: str, most: int) -> str:
    """Keep an uploaded file in a folder, under a name of ours; returns that name.

    Raises:
        BadInput: it is empty or larger than `most` bytes.
    """
    ending = Path(file.filename or "").suffix[:SUFFIX]
    ending = ending if ending[1:].isalnum() else ""
    path = folder / f"{name}{ending}"
    size = 0
    with path.open("wb") as kept:
        while block := file.file.read(1 << 20):
            size += len(block)
            if size > most:
                raise BadInput(f"{name}: is larger than {most / 1e6:g} MB; give a smaller file")
            kept.write(block)
    if not size:
        raise BadInput(f"{name}: is empty; give a whole file")
    return path.name


def _page(schema: dict[str, Any]) -> str:
    """The OpenAPI schema as a page that loads nothing."""
    rows = []
    for path, methods in schema["paths"].items():
        for method, one in methods.items():
            words = html.escape(one.get("description") or one.get("summary", ""))
            body = one.get("requestBody", {}).get("content", {})
            names = [
                field
                for content in body.values()
                for field in _fields(schema, content["schema"].get("$ref", ""))
            ]
            told = ", ".join(html.escape(name) for name in names)
            rows.append(
                f"<tr><td><code>{method.upper()} {html.escape(path)}</code></td>"
                f"<td>{words}</td><td>{told}</td></tr>"
            )
    return (
        "<!doctype html><html lang=en><meta charset=utf-8><title>angie: service</title>"
        "<style>body{font:16px system-ui;margin:2em;max-width:60em}"
        "td{vertical-align:top;padding:.3em 1em .3em 0}</style>"
        f"<h1>angie {html.escape(schema['info']['version'])}</h1>"
        f"<p>{html.escape(schema['info']['description'])}</p>"
        f"<table>{''.join(rows)}</table><p><a href=/openapi.json>openapi.json</a></p></html>"
    )


def _fields(schema: dict[str, Any], reference: str) -> list[str]:
    """Names of the fields of a form, those that must be given with a star."""
    known = schema["components"]["schemas"].get(reference.rsplit("/", 1)[-1], {})
    needed = known.get("required", [])
    return [f"{name}*" if name in needed else name for name in known.get("properties", {})]
