"""The shipped pipeline behind a queue, and a voice of half a second."""

import shutil

import pytest

from angie.app.queue import Limits, Queue
from angie.bundle import PHOTO
from angie.request import Pipelines, Request


class Loaded(Pipelines):
    """The shipped pipeline, whatever is asked for; `gate` holds it back."""

    def __init__(self, pipeline):
        super().__init__()
        self.pipeline, self.gate = pipeline, None

    def of(self, request):
        if self.gate is not None:
            self.gate.wait(20)
        return self.pipeline


@pytest.fixture
def queue(shipped):
    with Queue(Loaded(shipped), Limits(upload=2_000_000, seconds=2.0, waiting=2, each=2)) as made:
        yield made


@pytest.fixture
def ask(queue, blip):
    """Puts a video into the queue."""

    def ask(owner="", photo=PHOTO, **options):
        folder = queue.folder()
        shutil.copy(photo, folder / "photo.png")
        shutil.copy(blip, folder / "audio.wav")
        request = Request(folder / "photo.png", folder / "audio.wav", **options)
        return queue.submit(request, folder, owner)

    return ask
