"""What this machine has for angie, what it lacks, and what to do about it."""

import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from data_prep.errors import BadInput

LEAST_PYTHON = (3, 11)

LEAST_DISK = 2e9
"""Bytes below which a disk counts as full."""

FRAMES = 48
"""Drawn to measure the speed."""

CODECS = {
    "libx264": "mp4", "aac": "mp4", "libvpx-vp9": "webm", "libopus": "webm", "gif": "gif",
}  # fmt: skip

EXTRAS = {"app": ("fastapi", "uvicorn", "gradio"), "tensorboard": ("tensorboard",)}
"""Extras of the package, and the modules that they bring."""


@dataclass(frozen=True)
class Finding:
    """Something that was looked at.

    Attributes:
        name: of it.
        found: what there is.
        advice: what to do, or nothing where all is well.
    """

    name: str
    found: str
    advice: str = ""


def findings(bundle: Path | None = None, device: str = "auto") -> Iterator[Finding]:
    """Look at the machine, the package and a bundle, one after the other.

    Args:
        bundle: a speaker bundle; None is the one that ships.
        device: torch device to measure, or "auto".
    """
    yield _python()
    yield from _torch()
    yield _threads()
    yield _codecs()
    yield from _disks()
    for extra, modules in EXTRAS.items():
        there = all(find_spec(name) for name in modules)
        yield Finding(
            f"extra {extra}", "installed" if there else f'no (pip install "angie[{extra}]")'
        )
    yield from _bundle(bundle, device)


def _python() -> Finding:
    old = sys.version_info[:2] < LEAST_PYTHON
    wanted = ".".join(map(str, LEAST_PYTHON))
    return Finding(
        "Python",
        f"{platform.python_version()} on {platform.system()} {platform.machine()}",
        f"install Python {wanted} or newer" if old else "",
    )


def _torch() -> Iterator[Finding]:
    import torch

    from mraa.training.devices import native_bf16

    yield Finding("torch", torch.__version__)
    there = ["cpu"]
    if torch.cuda.is_available():
        there = [torch.cuda.get_device_name(n) for n in range(torch.cuda.device_count())]
    elif torch.backends.mps.is_available():
        there = ["mps", "cpu"]
    native = native_bf16(torch.device("cuda" if torch.cuda.is_available() else "cpu"))
    numbers = "bfloat16" if native else "no bfloat16 of its own"
    yield Finding("devices", f"{', '.join(there)} ({numbers})")


def _threads() -> Finding:
    import torch

    from angie.request import cores

    there, used = cores(), torch.get_num_threads()
    told = os.environ.get("OMP_NUM_THREADS")
    advice = ""
    if used < there and told:
        advice = f"OMP_NUM_THREADS={told} leaves {there - used} of {there} cores idle; unset it"
    return Finding("threads", f"{used} of {there} cores", advice)


def _codecs() -> Finding:
    import av

    missing = [name for name in CODECS if name not in av.codecs_available]
    if not missing:
        return Finding("codecs", f"PyAV {av.__version__}: {', '.join(CODECS)}")
    files = ", ".join(sorted({CODECS[name] for name in missing}))
    return Finding(
        "codecs",
        f"PyAV {av.__version__} without {', '.join(missing)}",
        f"no {files} can be written; install PyAV's own wheel: pip install --force-reinstall av",
    )


def _disks() -> Iterator[Finding]:
    import tempfile

    for name, folder in (("disk", Path.cwd()), ("temporary", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free
        writable = os.access(folder, os.W_OK)
        advice = "" if free >= LEAST_DISK else "make room: less than 2 GB are left"
        advice = advice if writable else "cannot be written; work in another folder"
        yield Finding(name, f"{free / 1e9:.1f} GB free in {folder}", advice)


def _bundle(folder: Path | None, device: str) -> Iterator[Finding]:
    from angie.bundle import BUNDLE, Bundle

    folder = BUNDLE if folder is None else folder
    try:
        bundle = Bundle.open(folder)
        parts = [part for part in bundle.parts if part in bundle.manifest["parts"]]
        for part in parts:
            bundle.path_of(part)
    except BadInput as error:
        advice = "install angie again" if folder == BUNDLE else "copy or train it again"
        yield Finding("bundle", str(error), advice)
        return
    yield Finding("bundle", f"{folder} ({bundle.preset.name}): {', '.join(parts)}")
    missing = [part for part in bundle.needed() if part not in parts]
    if missing:
        yield Finding(
            "models", f"without {', '.join(missing)}", f"angie train DATASET -o {folder} --resume"
        )
        return
    yield from _speed(folder, device)


def _speed(folder: Path, device: str) -> Iterator[Finding]:
    """Whether the models load and find the person that ships, and frames a second."""
    from angie.bundle import PHOTO
    from angie.motion.saved import SavedMotion
    from angie.request import Pipelines, Request
    from angie.source import View
    from mraa.draw import source_pose
    from mraa.motion import Motion

    try:
        pipeline = Pipelines(device).of(Request(PHOTO, speaker=folder))
        name = pipeline.family.title
        _ = pipeline.generator
        pose = source_pose(pipeline.renderer, pipeline.subject(PHOTO, View()).picture)
    except BadInput as error:
        yield Finding("models", str(error), "see above")
        return
    yield Finding("models", f"{name}; renderer of {pose.regions} regions; faces by OpenCV")
    still = Motion(pose.shift.expand(FRAMES, -1, -1), pose.cholesky.expand(FRAMES, -1, -1))
    video = pipeline.render(PHOTO, SavedMotion(still, pose))
    for _ in range(2):  # the first time compiles
        began = time.perf_counter()
        drawn = sum(len(batch) for batch in video)
        rate = drawn / (time.perf_counter() - began)
    yield Finding("speed", f"{rate:.0f} frames a second of 256x256 on {pipeline.place}; 25 is real "
                  "time")  # fmt: skip
