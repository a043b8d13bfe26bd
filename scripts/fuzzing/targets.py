"""Every file that the program reads: how a small one is made, and what reads it."""

import contextlib
import itertools
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import soundfile
import yaml
from PIL import Image

from data_prep.dataset import COLUMNS, Dataset, encode_frame, write_frames
from data_prep.errors import BadInput
from data_prep.media.audio import read_sound, write_wav
from data_prep.media.photo import read_photo
from data_prep.media.pictures import GifWriter
from data_prep.media.video import probe, read_frames, read_grey
from data_prep.media.writer import VideoWriter
from data_prep.prepare.pats import read_intervals
from data_prep.prepare.record import read_records
from data_prep.speech.features import Speech, write_features
from data_prep.speech.transcript import read_transcript
from data_prep.speech.words import Word, read_words, write_words

FRAMES = 2000
"""Frames that are read of a video at most; a file may declare that one is shown for an hour."""


@dataclass(frozen=True)
class Target:
    """A kind of input.

    Attributes:
        make: writes a small whole one into a folder, and returns the files that can be spoilt.
        read: reads what lies in that folder, as the program does.
        light: whether it needs neither networks nor their libraries.
    """

    make: Callable[[Path], list[Path]]
    read: Callable[[Path], object]
    light: bool = True


def _picture() -> np.ndarray:
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    return np.stack([x * 4, y * 5, (x + y) * 2], axis=2).astype(np.uint8)


def _sound(seconds: float = 0.5, rate: int = 16000) -> np.ndarray:
    t = np.arange(round(seconds * rate)) / rate
    return (0.3 * np.sin(2 * np.pi * 300 * t)).astype(np.float32)


def _photo(name: str, **options: object) -> Target:
    def make(folder: Path) -> list[Path]:
        image = Image.fromarray(_picture())
        if name.endswith(".gif"):
            image = image.quantize(16)
        image.save(folder / name, **options)
        return [folder / name]

    return Target(make, lambda folder: read_photo(folder / name))


def _recording(name: str, **options: str) -> Target:
    def make(folder: Path) -> list[Path]:
        soundfile.write(folder / name, _sound(), 16000, **options)
        return [folder / name]

    return Target(make, lambda folder: read_sound(folder / name))


def _video(name: str) -> Target:
    def make(folder: Path) -> list[Path]:
        with VideoWriter(folder / "a.mp4", (64, 48), sound=(_sound(), 16000), threads=1) as video:
            for k in range(12):
                video.write(np.roll(_picture(), 3 * k, axis=1))
        if name != "a.mp4":
            _remux(folder / "a.mp4", folder / name)
        return [folder / name]

    def read(folder: Path) -> None:
        probe(folder / name)
        for _ in itertools.islice(read_frames(folder / name), FRAMES):
            pass
        for _ in itertools.islice(read_grey(folder / name, 32), FRAMES):
            pass
        read_sound(folder / name)

    return Target(make, read)


def _remux(given: Path, wanted: Path) -> None:
    import av

    with av.open(str(given)) as source, av.open(str(wanted), "w") as target:
        streams = {one: target.add_stream_from_template(one) for one in source.streams}
        for packet in source.demux():
            if packet.dts is not None:
                packet.stream = streams[packet.stream]
                target.mux(packet)


TRANSCRIPTS = {
    "a.json": '[{"word": "one", "start": 0.1, "end": 0.4}, {"text": "two", "start": 1, "dur": 2}]',
    "a.srt": "1\n00:00:01,000 --> 00:00:02,500\none\n\n2\n00:00:03,000 --> 00:00:04,000\ntwo\n",
    "a.vtt": "WEBVTT\n\n00:01.000 --> 00:02.500\none two\n",
    "a.ctm": "a 1 0.10 0.30 one 0.9\na 1 0.50 0.30 two 0.9\n",
    "a.txt": "Some words that somebody says. 1234.\n",
    "a.TextGrid": 'File type = "ooTextFile"\nObject class = "TextGrid"\n\n0\n2\n<exists>\n1\n'
    '"IntervalTier"\n"words"\n0\n2\n2\n0\n1\n"one"\n1\n2\n"two"\n',
}


def _text(name: str, text: str, read: Callable[[Path], object]) -> Target:
    def make(folder: Path) -> list[Path]:
        (folder / name).write_text(text)
        return [folder / name]

    return Target(make, lambda folder: read(folder / name))


def _make_dataset(folder: Path) -> list[Path]:
    for name in ("audio", "features", "frames", "words", "sources"):
        (folder / name).mkdir()
    row = ("a_000", "ann", "train", "a", "0.00", "25", "12", "0.48")
    (folder / "meta.csv").write_text(f"{','.join(COLUMNS)}\n{','.join(row)}\n")
    source = {"name": "a", "file": "a.mp4", "speaker": "ann", "crop": None, "spans": []}
    manifest = {"format": 2, "fps": 25, "size": 256, "splits": {"ann": "x"}, "sources": [source]}
    (folder / "dataset.json").write_text(json.dumps(manifest))
    write_wav(folder / "audio" / "a_000.wav", _sound(0.48))
    write_features(folder / "features" / "a_000.npz", Speech(_sound(0.48)))
    frames = [encode_frame(cv2.resize(_picture(), (256, 256)))] * 12
    write_frames(folder / "frames" / "a_000.safetensors", frames)
    write_words(folder / "words" / "a_000.json", [Word("one", 0.1, 0.3)])
    (folder / "sources" / "a.json").write_text(json.dumps({"key": "", "source": source}))
    return sorted(path for path in folder.rglob("*.*") if path.is_file())


def _read_dataset(folder: Path) -> None:
    data = Dataset(folder)
    read_records(folder)
    for clip in data.clips()[:3]:
        store = data.frames(clip)
        for index in {0, len(store) - 1}:
            store[index]
        speech = data.speech(clip)
        for name in ("onset", "mfcc", "onset_times"):
            speech[name]
        data.sound(clip)


PATS = (
    "interval_id,speaker,start_time,end_time,video_fn,video_link\n"
    "1,ann,00:00:01.5,00:00:04,a.mp4,x\n2,ann,0 days 00:01:00,61.5,b.mp4,y\n"
)
WORDS = '[{"word": "one", "start": 0.1, "end": 0.3}]'

LIGHT: dict[str, Target] = {
    **{f"photo {end}": _photo(f"a.{end}") for end in ("png", "jpg", "gif", "webp", "tiff", "bmp")},
    **{f"sound {end}": _recording(f"a.{end}") for end in ("wav", "flac", "mp3", "ogg", "aiff")},
    "sound float": _recording("a.wav", subtype="FLOAT"),
    **{f"video {end}": _video(f"a.{end}") for end in ("mp4", "mkv", "mov", "ts")},
    **{f"transcript {k[2:]}": _text(k, v, read_transcript) for k, v in TRANSCRIPTS.items()},
    "words": _text("a.json", WORDS, read_words),
    "PATS table": _text("a.csv", PATS, read_intervals),
    "dataset": Target(_make_dataset, _read_dataset),
}


def heavy() -> dict[str, Target]:
    """Those whose readers import torch."""
    import torch

    from angie.app.queue import Limits
    from angie.batch import read_list
    from angie.bundle import BUNDLE, Bundle
    from angie.config import override, parse_overrides, preset
    from angie.metrics.autoencoder import (
        MotionAutoencoder,
        MotionScale,
        load_autoencoder,
        save_autoencoder,
    )
    from angie.motion.keypoints import KeypointDataset
    from angie.motion.saved import SavedMotion, load_motion, write_saved
    from angie.motion.statistics import MotionStatistics
    from angie.provenance import manifest, read_origin
    from data_prep.tensors import save_tensors
    from mraa.motion import Motion, read_motion, write_motion
    from mraa.released import read_checkpoint
    from mraa.released_sizes import config_from_released, params_from_tensors, read_params
    from mraa.training.checkpoint import Checkpoint

    def bundle(folder: Path) -> list[Path]:
        for name in ("bundle.json", "statistics.safetensors", "tricon.generator.safetensors"):
            shutil.copyfile(BUNDLE / name, folder / name)
        return [folder / "bundle.json", folder / "statistics.safetensors"]

    def read_bundle(folder: Path) -> None:
        opened = Bundle.open(folder)
        for part in opened.parts:
            opened.has(part)
        for name in opened.generators:
            opened.settings(name)
        opened.write()

    def settings(folder: Path) -> list[Path]:
        text = "renderer:\n  regions: 5\ntrain_vq:\n  schedule:\n    rate: 0.001\ngpt:\n"
        text += "  dropout: 0.2\n"
        (folder / "a.yaml").write_text(text)
        return [folder / "a.yaml"]

    def read_settings(folder: Path) -> None:
        override(preset("tiny"), parse_overrides([str(folder / "a.yaml")]))

    def params(folder: Path) -> list[Path]:
        sizes = {"block_expansion": 8, "max_features": 32, "num_blocks": 2, "scale_factor": 0.25}
        flags = {"use_deformed_source": True, "use_covar_heatmap": True}
        flow = {**sizes, **flags, "estimate_occlusion_map": True}
        generator = {**sizes, "num_down_blocks": 2, "num_bottleneck_blocks": 2, "skips": True}
        content = {
            "num_regions": 5, "num_channels": 3, "estimate_affine": True, "revert_axis_swap": True,
            "region_predictor_params": {**sizes, "temperature": 0.1, "pca_based": True},
            "bg_predictor_params": {**sizes, "bg_type": "affine"},
            "generator_params": {**generator, "pixelwise_flow_predictor_params": flow},
            "avd_network_params": {"id_bottle_size": 16, "pose_bottle_size": 16},
        }  # fmt: skip
        shape = {"frame_shape": [64, 64, 3]}
        text = yaml.safe_dump({"model_params": content, "dataset_params": shape})
        (folder / "a.yaml").write_text(text)
        return [folder / "a.yaml"]

    def motion(folder: Path) -> list[Path]:
        factors = torch.ones(9, 4, 3)
        write_motion(folder / "a.npz", Motion(torch.zeros(9, 4, 2), factors), "x")
        return [folder / "a.npz"]

    def pth(folder: Path) -> list[Path]:
        part = {"a.weight": torch.zeros(3, 3), "b": torch.ones(2)}
        torch.save({"generator": part, "region_predictor": part}, folder / "a.pth")
        return [folder / "a.pth"]

    def read_pth(folder: Path) -> None:
        parts = read_checkpoint(folder / "a.pth")
        with contextlib.suppress(BadInput):  # it is not whole
            params_from_tensors(parts)

    def checkpoint(folder: Path) -> list[Path]:
        best = '{"score": null, "latest": null, "age": 0, "patience": 0}'
        notes = {"format": "2", "step": "3", "identity": "x", "best": best, "scaler": "{}"}
        save_tensors(folder / "a.safetensors", {"model.a.w": torch.zeros(4)}, notes)
        return [folder / "a.safetensors"]

    def joints(folder: Path) -> list[Path]:
        (folder / "motion").mkdir()
        (folder / "audio").mkdir()
        (folder / "clips.csv").write_text("clip,speaker,split,fps\na,ann,train,25\nb,ann,test,25\n")
        for name in "ab":
            points = np.zeros((30, 3, 2)) + np.arange(30)[:, None, None]
            np.savez(folder / "motion" / f"{name}.npz", points=points)
            write_wav(folder / "audio" / f"{name}.wav", _sound(1.2))
        return [folder / "clips.csv", folder / "motion" / "a.npz", folder / "audio" / "a.wav"]

    def read_joints(folder: Path) -> None:
        data = KeypointDataset(folder, folder / "cache")
        data.check_sound()
        data.motion_clips("train")

    def autoencoder(folder: Path) -> list[Path]:
        scale = MotionScale(("ann",), np.zeros((1, 4)), np.ones(4))
        save_autoencoder(folder / "a.safetensors", MotionAutoencoder(4, 16), scale, "x", 25.0)
        return [folder / "a.safetensors"]

    def jobs(folder: Path) -> list[Path]:
        rows = "a.png,b.wav,c.mp4,3,yes\n/a.png,,d.gif,,\n"
        (folder / "jobs.csv").write_text(f"photo,audio,output,seed,greedy\n{rows}")
        return [folder / "jobs.csv"]

    def saved(folder: Path) -> list[Path]:
        pose = Motion(torch.zeros(1, 4, 2), torch.ones(1, 4, 3))
        moved = Motion(torch.zeros(9, 4, 2), torch.ones(9, 4, 3))
        write_saved(folder / "a.npz", SavedMotion(moved, pose, "x"))
        return [folder / "a.npz"]

    def origin(name: str) -> Target:
        told = json.dumps(manifest({"settings": {"seed": 1}, "inputs": {"photo": _picture()}}, "y"))

        def make(folder: Path) -> list[Path]:
            path = folder / name
            if name.endswith(".json"):
                path.write_text(told)
                return [path]
            gif = name.endswith(".gif")
            kind = GifWriter(path, (64, 48), told) if gif else None
            with kind or VideoWriter(path, (64, 48), threads=1, description=told) as video:
                video.write(_picture())
            return [path]

        read = (
            read_origin if name.endswith(".json") else (lambda folder: read_origin(folder / name))
        )
        return Target(make, read, False)

    def uploads(folder: Path) -> list[Path]:
        Image.fromarray(_picture()).save(folder / "a.png")
        soundfile.write(folder / "a.flac", _sound(), 16000)
        return [folder / "a.png", folder / "a.flac"]

    return {
        "jobs": Target(jobs, lambda f: read_list(f / "jobs.csv"), False),
        "saved motion": Target(saved, lambda f: load_motion(f / "a.npz"), False),
        **{f"origin {n}": origin(n) for n in ("a.mp4", "a.gif", "origin.json")},
        "uploads": Target(
            uploads, lambda f: Limits(seconds=5).check(f / "a.png", f / "a.flac"), False
        ),
        "bundle": Target(bundle, read_bundle, False),
        "statistics": Target(
            bundle, lambda f: MotionStatistics.load(f / "statistics.safetensors"), False
        ),
        "settings": Target(settings, read_settings, False),
        "MRAA's settings": Target(
            params, lambda f: config_from_released(read_params(f / "a.yaml")[0]), False
        ),
        "motion": Target(motion, lambda f: read_motion(f / "a.npz"), False),
        "released checkpoint": Target(pth, read_pth, False),
        "training checkpoint": Target(checkpoint, lambda f: Checkpoint(f / "a.safetensors"), False),
        "joints": Target(joints, read_joints, False),
        "autoencoder": Target(autoencoder, lambda f: load_autoencoder(f / "a.safetensors"), False),
    }
