"""The queue: one after the other, stopped, refused, kept apart and cleared away."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from angie.app.queue import Busy, Limits, Queue
from angie.provenance import read_origin
from data_prep.errors import BadInput
from data_prep.media.audio import write_wav


def held(queue):
    """Holds the queue's work back until the event is set."""
    queue.pipelines.gate = threading.Event()
    return queue.pipelines.gate


def test_a_video_is_drawn_and_kept(queue, ask):
    job = ask(seed=2, consent="a drawing")
    assert job.ended.wait(60) and job.state == "done", job.message
    assert job.frames == 20 and job.share == 1 and job.picture is None
    assert read_origin(job.video).consent == "a drawing"
    assert queue.get(job.id) is job and queue.counts() == {"waiting": 0, "running": 0, "kept": 1}
    queue.forget(job)
    assert queue.get(job.id) is None and not job.folder.exists()


def test_what_fails_is_told_without_folders_and_the_next_has_its_turn(queue, ask, tmp_path):
    Image.fromarray(np.full((90, 90, 3), 90, np.uint8)).save(tmp_path / "nobody.png")
    bad, good = ask(photo=tmp_path / "nobody.png"), ask()
    assert bad.ended.wait(60) and bad.state == "failed"
    assert bad.message.startswith("photo.png: no face found") and not bad.folder.exists()
    assert good.ended.wait(60) and good.state == "done"


def test_jobs_are_stopped_where_they_are(queue, ask):
    gate = held(queue)
    running, waiting = ask(), ask()
    while queue.counts()["running"] == 0:
        pass
    assert queue.ahead(waiting) == 1
    queue.cancel(waiting)
    assert waiting.state == "cancelled" and waiting.ended.is_set()
    queue.cancel(running)
    assert not running.ended.is_set()
    gate.set()
    assert running.ended.wait(60) and running.state == "cancelled"
    assert not running.folder.exists() and not waiting.folder.exists()


def test_the_queue_is_bounded_for_all_and_for_each(queue, ask):
    gate = held(queue)
    ask("ada")
    while queue.counts()["running"] == 0:
        pass
    ask("ada")
    with pytest.raises(Busy, match="2 of your videos wait"):
        ask("ada")
    ask("bob")
    with pytest.raises(Busy, match="too many"):
        ask("eve")
    assert len(list(queue.root.iterdir())) == 3
    queue.drop("ada")
    assert [job.owner for job in queue.of("bob")] == ["bob"] and queue.of("ada") == []
    gate.set()


def test_large_inputs_are_refused(queue, ask, tmp_path):
    folder = queue.folder()
    write_wav(folder / "audio.wav", np.zeros(48_000), 16_000)
    Image.new("RGB", (64, 64)).save(folder / "photo.png")
    with pytest.raises(BadInput, match="audio.wav: lasts more than 2 s"):
        queue.limits.check(folder / "photo.png", folder / "audio.wav")
    small = replace(queue.limits, pixels=4000, seconds=9)
    with pytest.raises(BadInput, match="more than 0.004 megapixels"):
        small.check(folder / "photo.png", folder / "audio.wav")
    with pytest.raises(BadInput, match="more than 0.02 MB"):
        replace(small, upload=20_000).check(folder / "photo.png", folder / "audio.wav")


def test_old_jobs_and_a_closed_queue_leave_nothing(shipped, ask, queue):
    job = ask()
    assert job.ended.wait(60)
    queue.limits = Limits(kept=0)
    queue.sweep()
    assert queue.get(job.id) is None and not job.folder.exists()
    held(queue).set()
    with Queue(queue.pipelines) as other:
        root = other.root
        assert root.is_dir()
    assert not root.exists()
