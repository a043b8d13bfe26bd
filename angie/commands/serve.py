"""Commands that answer a browser or other programs: app, serve."""

import ipaddress
import re
from pathlib import Path
from typing import Annotated, Any

import typer

from angie.commands.options import Device, Precision
from data_prep.errors import BadInput

Host = Annotated[
    str, typer.Option(help="Address to answer at; another than this machine's needs a token.")
]
Token = Annotated[
    str | None,
    typer.Option(
        envvar="ANGIE_TOKEN", help="Who asks must give it. 16 or more letters and digits."
    ),
]
Speaker = Annotated[Path | None, typer.Option(help="Speaker bundle; the shipped one by default.")]
Upload = Annotated[float, typer.Option(min=1, max=2000, help="Megabytes of a file, at most.")]
Seconds = Annotated[float, typer.Option(min=1, max=36000, help="Seconds of a recording, at most.")]
Waiting = Annotated[int, typer.Option(min=1, max=1000, help="Videos that may wait.")]
Kept = Annotated[float, typer.Option(min=0.1, help="Minutes that a finished video is kept.")]


def serve(
    host: Host = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port to answer at.")] = 8025,
    token: Token = None,
    speaker: Speaker = None,
    device: Device = "auto",
    precision: Precision = "auto",
    upload: Upload = 50,
    seconds: Seconds = 300,
    waiting: Waiting = 20,
    kept: Kept = 60,
) -> None:
    """Answer other programs over HTTP: post a photo and a recording, fetch the video."""
    _run(host, port, token, speaker, device, precision, (upload, seconds, waiting, kept), False)


def app(
    host: Host = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port to answer at.")] = 7860,
    token: Token = None,
    speaker: Speaker = None,
    device: Device = "auto",
    precision: Precision = "auto",
    upload: Upload = 50,
    seconds: Seconds = 300,
    waiting: Waiting = 20,
    kept: Kept = 60,
) -> None:
    """Open the web page on this machine; what `angie serve` answers is answered too."""
    _run(host, port, token, speaker, device, precision, (upload, seconds, waiting, kept), True)


def _run(
    host: str,
    port: int,
    token: str | None,
    speaker: Path | None,
    device: str,
    precision: str,
    limits: tuple[float, float, int, float],
    page: bool,
) -> None:
    """Answer until Ctrl-C."""
    local = is_local(host)
    check_token(token, local, host)
    try:
        import uvicorn

        from angie.app.server import application
    except ImportError as error:
        raise BadInput(
            f'{error.name}: is not installed; pip install "angie[app]" brings it'
        ) from error
    from angie.app.queue import Limits, Queue
    from angie.request import Pipelines, Request

    pipelines = Pipelines(device, precision)
    loaded = pipelines.of(Request(Path(), speaker=speaker))
    _ = loaded.generator, loaded.renderer  # what is missing is told now
    upload, seconds, waiting, kept = limits
    most = Limits(round(upload * 1e6), seconds, waiting=waiting, kept=60 * kept)
    with Queue(pipelines, most) as queue:
        made = application(queue, speaker, token=token, local=local, page=page)
        shown = f"[{host}]" if ":" in host else host
        print(f"angie: http://{shown}:{port}/{'' if page else 'docs'} (Ctrl-C ends it)", flush=True)
        config: dict[str, Any] = {"host": host, "port": port, "log_level": "warning"}
        uvicorn.run(made, timeout_graceful_shutdown=3, server_header=False, **config)


def is_local(host: str) -> bool:
    """Whether an address is this machine's own."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_token(token: str | None, local: bool, host: str) -> None:
    """Refuse an address that others can reach without a token, and a token that can be guessed.

    Raises:
        BadInput: what to give.
    """
    if token is None and not local:
        raise BadInput(f"--host {host}: others can reach it; give --token or ANGIE_TOKEN")
    if token is not None and not re.fullmatch(r"[A-Za-z0-9_.~-]{16,200}", token):
        raise BadInput("--token: give 16 to 200 letters, digits and -_.~, such as a random word")
