"""Videos asked for over HTTP one after the other: time of each, and memory of the service.

    python scripts/bench_app.py [--requests 50] [--seconds 1] [--speaker BUNDLE]

The service runs in this process, as `angie serve` runs it. Prints a line for every tenth video:
seconds of the last ten, resident memory, and how much more that is than after the first ten.
"""

import angie.cli  # noqa: F401 (how OpenMP's threads wait; before torch is imported)

# isort: split
import argparse
import json
import socket
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

import numpy as np
import uvicorn

from angie.app.queue import Limits, Queue
from angie.app.server import application
from angie.bundle import PHOTO
from angie.request import Pipelines
from data_prep.errors import call_script
from data_prep.media.audio import write_wav

BREAK = "a-line-that-is-in-no-file"


def resident() -> float:
    """Megabytes of memory that this process holds."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1e3


def form(sound: Path, seed: int) -> bytes:
    """The body of a request."""
    parts = [b""]
    for name, text in (("consent", "a drawing"), ("seed", str(seed))):
        parts.append(
            f'\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{text}\r\n'.encode()
        )
    for name, path in (("photo", PHOTO), ("audio", sound)):
        head = f'\r\nContent-Disposition: form-data; name="{name}"; filename="{path.name}"\r\n\r\n'
        parts.append(head.encode() + path.read_bytes() + b"\r\n")
    mark = f"--{BREAK}".encode()
    return mark.join(parts) + mark + b"--\r\n"


def video(address: str, sound: Path, seed: int) -> None:
    """Ask for a video, wait for it, fetch it, and let go of it."""
    kind = {"Content-Type": f"multipart/form-data; boundary={BREAK}"}
    asked = urllib.request.Request(f"{address}/videos", form(sound, seed), kind)
    told = json.load(urllib.request.urlopen(asked))
    place = f"{address}/videos/{told['id']}"
    while told["state"] in ("waiting", "running"):
        time.sleep(0.05)
        told = json.load(urllib.request.urlopen(place))
    if told["state"] != "done":
        raise SystemExit(f"the video {told['state']}: {told['message']}")
    urllib.request.urlopen(f"{place}/file").read()
    urllib.request.urlopen(urllib.request.Request(place, method="DELETE")).read()


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--requests", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--speaker", type=Path)
    given = parser.parse_args()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder, Queue(Pipelines(), Limits()) as queue:
        sound = Path(folder) / "voice.wav"
        times = np.arange(round(16_000 * given.seconds)) / 16_000
        write_wav(sound, 0.3 * np.sin(900 * times) * np.sin(20 * times), 16_000)
        made = application(queue, given.speaker, token=None, local=True, page=False)
        config = uvicorn.Config(made, host="127.0.0.1", port=port, log_level="warning")
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        while not server.started:
            time.sleep(0.05)
        before, began = 0.0, time.perf_counter()
        for number in range(1, given.requests + 1):
            video(f"http://127.0.0.1:{port}", sound, number)
            if number % 10 == 0:
                now = resident()
                before = before or now
                each = (time.perf_counter() - began) / 10
                print(f"{number:4} videos  {each:.2f} s each  {now:.0f} MB  {now - before:+.0f} MB")
                began = time.perf_counter()
        server.should_exit = True
        thread.join()


if __name__ == "__main__":
    call_script(main)
