import dataclasses
import re
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from angie.bundle import Bundle
from angie.motion.amplitude import scale_displacement, spread
from angie.pipeline import GesturePipeline, GestureVideo
from angie.source import View, framing
from data_prep.errors import BadInput
from data_prep.media.audio import read_sound, write_wav
from data_prep.media.video import read_frames
from data_prep.phantom.make import recording, still, take
from data_prep.rates import SAMPLE_RATE
from data_prep.speaker.crop import Crop, cut_out, find_faces, speaker_crop
from data_prep.speech.features import mono
from mraa.draw import render, source_pose
from mraa.motion import Motion
from mraa.renderer import from_pixels


@pytest.fixture(scope="module")
def photo(tmp_path_factory):
    path = tmp_path_factory.mktemp("photo") / "photo.png"
    Image.fromarray(still(0, seed=5)).save(path)
    return path


@pytest.fixture(scope="module")
def speech(tmp_path_factory):
    path = tmp_path_factory.mktemp("speech") / "speech.wav"
    talk = recording(0, seconds=3.0, seed=5)
    samples = talk.samples[: int(2.5 * talk.rate) + 100]
    write_wav(path, samples, talk.rate)
    return path


@dataclass
class Made:
    video: GestureVideo
    path: Path


def make(photo, speech, path, bundle, *, seed=0, greedy=False, **view):
    pipe = GesturePipeline(Bundle.open(bundle.folder))
    video = pipe(photo, speech, seed=seed, greedy=greedy, view=View(**view))
    return Made(video, video.save(path))


@pytest.fixture(scope="module")
def video(photo, speech, bundle, tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "out.mp4"
    return make(photo, speech, path, bundle)


def frames_of(path):
    return np.stack(list(read_frames(path)))


def test_the_video_meets_the_contract(video, speech):
    samples = read_sound(speech)
    wanted = -(-len(samples) // 640)
    assert video.video.frames == wanted
    with av.open(str(video.path)) as file:
        picture, sound = file.streams.video[0], file.streams.audio[0]
        assert (picture.codec_context.name, sound.codec_context.name) == ("h264", "aac")
        assert picture.codec_context.pix_fmt == "yuv420p"
        assert (picture.width, picture.height) == (256, 256)
        assert picture.average_rate == 25 and picture.frames == wanted
        assert picture.start_time == 0 and sound.start_time == 0
        seconds = float(picture.duration * picture.time_base)
        heard = float((sound.start_time + sound.duration) * sound.time_base)
        assert abs(seconds - heard) <= 0.04
        assert "generated" in file.metadata["comment"]
        times = [float(frame.pts * frame.time_base) for frame in file.decode(picture)]
    np.testing.assert_allclose(times, np.arange(wanted) / 25, atol=1e-4)
    data = video.path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # faststart: the index comes first


def test_sound_is_whole_and_in_place(video, speech):
    original, heard = read_sound(speech), read_sound(video.path)
    assert abs(len(heard) - len(original)) <= 1024
    n = min(len(original), len(heard))
    spectrum = np.fft.rfft(original[:n], 2 * n).conj() * np.fft.rfft(heard[:n], 2 * n)
    lag = int(np.fft.irfft(spectrum).argmax())
    assert min(lag, 2 * n - lag) <= SAMPLE_RATE // 1000


def test_the_first_frame_is_the_photo_and_later_ones_move(video, photo):
    frames = frames_of(video.path).astype(int)
    image = np.asarray(Image.open(photo))
    crop = speaker_crop(find_faces(image)[0], *image.shape[:2])
    assert video.video.crop == crop
    error = ((frames[0] - cut_out(image, crop).astype(int)) ** 2).mean()
    assert 10 * np.log10(255**2 / error) > 20  # dB, through a barely trained renderer and H.264
    assert np.abs(frames[1:] - frames[0]).mean() > 0.3


def test_frames_come_in_chunks_as_often_as_they_are_asked_for(video):
    chunks = list(video.video)
    assert all(c.dtype == np.uint8 and c.shape[1:] == (256, 256, 3) for c in chunks)
    frames = np.concatenate(chunks)
    assert 1 < len(chunks) < len(frames) == video.video.frames
    assert np.array_equal(frames, np.concatenate(list(video.video)))
    assert 10 * np.log10(255**2 / error_of(frames, frames_of(video.path))) > 30  # H.264
    assert video.video.motion.frames == len(frames)
    assert video.video.speech["mfcc"].shape == (len(frames), 28, 12)


def test_pictures_and_samples_in_memory_are_as_good_as_files(photo, speech, bundle, video):
    pipe = GesturePipeline(bundle)
    image = Image.open(photo)
    sound = (read_sound(speech), SAMPLE_RATE)
    for given in (image, np.asarray(image)):
        made = pipe(given, sound)
        assert torch.equal(made.motion.vector(), video.video.motion.vector())


def test_samples_become_mono_at_16_khz():
    stereo = np.stack([np.full(48_000, 0.5), np.full(48_000, -0.1)], axis=1)
    made = mono(stereo, 48_000)
    assert made.shape == (16_000,) and made.dtype == np.float32
    assert np.allclose(made[2000:-2000], 0.2, atol=1e-3)
    whole = mono(np.full(16_000, 16_384, np.int16), 16_000)
    assert np.allclose(whole, 0.5)
    for samples, rate in (
        (np.zeros((10, 3)), 16_000), (np.zeros(0), 16_000), (np.full(9, np.nan), 16_000),
        (np.zeros(9, bool), 16_000), (np.zeros(9), 0), (np.zeros(9, np.int64), 16_000),
    ):  # fmt: skip
        with pytest.raises(BadInput, match="audio: give samples"):
            mono(samples, rate)
    with pytest.raises(BadInput, match="audio: give an array and its rate, not int first"):
        mono(16_000, np.zeros(9))


def test_what_cannot_be_is_told_before_anything_is_made(photo, speech, bundle, tmp_path):
    pipe = GesturePipeline(bundle)
    for options, words in (
        ({"scale_motion": "arms"}, "--scale-motion arms: choose from none, hull"),
        ({"style": "adam"}, "one style only; models trained with gpt.joint=true"),
        ({"seed": -1}, "--seed -1: give a whole number from 0"),
        ({"seed": 0.5}, "--seed 0.5: give a whole number"),
        ({"controls": 3}, "controls 3: give ANGIE.s Controls"),
    ):
        with pytest.raises(BadInput, match=words):
            pipe(photo, speech, **options)
    with pytest.raises(BadInput, match=r"a\.avi: the video is an mp4"):
        pipe(photo, speech).save(tmp_path / "a.avi")
    assert list(tmp_path.iterdir()) == []
    for image, words in (
        (np.zeros((64, 64), np.uint8), r"photo: an array is \(H, W, 3\) uint8"),
        (np.zeros((64, 64, 3), np.float32), "not .* float32"),
        (np.zeros((8, 64, 3), np.uint8), "photo: is only 64x8 pixels"),
        (np.zeros((64, 64, 3), np.uint8), "photo: no face found"),
    ):
        with pytest.raises(BadInput, match=words):
            pipe(image, speech)
    with pytest.raises(BadInput, match="photo: give a file, a picture or an array, not NoneType"):
        pipe(None, speech)
    with pytest.raises(BadInput, match="audio: give a file, or samples and their rate .* ndarray"):
        pipe.speech(np.zeros(16_000))
    with pytest.raises(BadInput, match="--device nowhere: not on this machine"):
        GesturePipeline(bundle, device="nowhere")
    with pytest.raises(BadInput, match="--precision fp16"):
        GesturePipeline(bundle, precision="fp16")
    with pytest.raises(BadInput, match="--generator none: .* has angie"):
        GesturePipeline.from_pretrained(bundle.folder, "none")
    with pytest.raises(BadInput, match="not a speaker bundle"):
        GesturePipeline.from_pretrained(tmp_path)


def test_the_example_of_the_readme(photo, tmp_path, monkeypatch, capsys):
    readme = Path(__file__).parents[2] / "README.md"
    (code,) = re.findall(r"```python\n(.*?)```", readme.read_text(), re.S)
    monkeypatch.chdir(tmp_path)
    Image.open(photo).save("photo.jpg")
    talk = recording(0, seconds=1.0, seed=5)
    write_wav(Path("speech.wav"), talk.samples[: talk.rate], talk.rate)
    exec(code, {})
    assert len(frames_of(tmp_path / "out.mp4")) == 25
    assert "torch.Size([25, 20, 2])" in capsys.readouterr().out


def test_same_seed_same_video_other_seed_other(photo, speech, bundle, tmp_path, video):
    again = make(photo, speech, tmp_path / "again.mp4", bundle)
    other = make(photo, speech, tmp_path / "other.mp4", bundle, seed=1)
    first = frames_of(video.path)
    assert np.array_equal(first, frames_of(again.path))
    assert not np.array_equal(first, frames_of(other.path))


def test_greedy_gives_one_video_whatever_the_seed(photo, speech, bundle, tmp_path):
    paths = [tmp_path / f"{seed}.mp4" for seed in range(2)]
    for seed, path in enumerate(paths):
        make(photo, speech, path, bundle, seed=seed, greedy=True)
    assert np.array_equal(frames_of(paths[0]), frames_of(paths[1]))


def test_an_input_is_never_replaced(photo, speech, bundle):
    before = speech.read_bytes()
    video = GesturePipeline(bundle)(photo, speech)
    with pytest.raises(BadInput, match="would replace the input"):
        video.save(speech, force=True)
    assert speech.read_bytes() == before


def test_a_given_crop_is_used(photo, speech, bundle, tmp_path):
    result = make(photo, speech, tmp_path / "crop.mp4", bundle, crop=Crop(100, 0, 300))
    assert result.video.crop == Crop(100, 0, 300)


@pytest.fixture(scope="module")
def blip(tmp_path_factory):
    path = tmp_path_factory.mktemp("blip") / "blip.wav"
    write_wav(path, 0.1 * np.sin(np.arange(1600) / 5), 16_000)
    return path


def error_of(frame, wanted):
    return ((frame.astype(float) - wanted) ** 2).mean()


def test_a_larger_video_shows_the_photos_own_pixels(blip, bundle, tmp_path):
    image = take(0, 0, seconds=3.0, seed=5).figure_at(2).frame(0)
    photo = tmp_path / "large.png"
    Image.fromarray(image).save(photo)
    crop = Crop(300, 0, 720)
    errors = {}
    for size, side in (("256", 256), ("512", 512), ("photo", 720)):
        result = make(photo, blip, tmp_path / f"{size}.mp4", bundle, crop=crop, size=size)
        assert result.video.width_height == (side, side) and result.video.crop == crop
        first = frames_of(result.path)[0]
        assert first.shape == (side, side, 3)
        large = cv2.resize(first, (720, 720), interpolation=cv2.INTER_CUBIC)
        errors[size] = error_of(large, cut_out(image, crop, 720))
    assert max(errors["photo"], errors["512"]) < errors["256"]


def test_the_whole_photo_is_shown(photo, blip, bundle, tmp_path):
    image = np.asarray(Image.open(photo))
    crop = Crop(150, 20, 301)
    path = make(photo, blip, tmp_path / "w.mp4", bundle, crop=crop, full_frame=True).path
    frames = frames_of(path)
    assert frames.shape == (3, *image.shape)
    beside = np.abs(frames[:, :, :140].astype(int) - image[:, :140])
    assert beside.mean() < 3  # H.264


def test_in_the_whole_photo_only_the_square_moves(photo, bundle):
    image = np.asarray(Image.open(photo))
    crop = Crop(150, 20, 301)
    canvas = framing(image, crop, full_frame=True).canvas(align_corners=True)
    renderer = bundle.renderer()
    picture = from_pixels(torch.from_numpy(cut_out(image, crop))[None])
    pose = source_pose(renderer, picture)
    motion = Motion(pose.shift + torch.tensor([0.15, 0.1]), pose.cholesky)
    (frames,) = render(renderer, picture, pose, motion, "fp32", canvas)
    change = np.abs(frames[0].astype(int) - image)
    inside = np.zeros(image.shape[:2], bool)
    inside[20:321, 150:451] = True
    assert change[~inside].max() == 0 and change[inside].mean() > 0.1


def test_hull_scaling_scales_displacements_by_size(bundle, photo):
    statistics = bundle.statistics()
    rest = Motion.from_vector(statistics.rest.mean(0, keepdim=True))
    pose = Motion(rest.shift * 0.5, rest.cholesky)
    motion = Motion(pose.shift + 0.1, pose.cholesky)
    scaled = scale_displacement(motion, pose, statistics)
    torch.testing.assert_close(scaled.shift - pose.shift, torch.full_like(pose.shift, 0.05))


def test_source_pose_is_the_estimators(bundle, photo):
    renderer = bundle.renderer()
    picture = from_pixels(torch.zeros(1, 256, 256, 3, dtype=torch.uint8))
    pose = source_pose(renderer, picture)
    regions = renderer.estimator(picture)
    torch.testing.assert_close(pose.shift, regions.shift)
    torch.testing.assert_close(pose.covariance(), regions.covariance, atol=1e-6, rtol=0)


def test_amplitude_scales_the_gestures_and_zero_stands_still(photo, speech, bundle):
    pipe = GesturePipeline(bundle, precision="fp32")
    whole, half, still = (pipe(photo, speech, amplitude=a).motion for a in (1.0, 0.5, 0.0))
    pose = whole.vector()[:1]  # the first frame is the photo's
    torch.testing.assert_close(half.vector() - pose, (whole.vector() - pose) / 2)
    assert torch.equal(still.vector(), pose.expand_as(still.vector()))
    with pytest.raises(BadInput, match="--amplitude 3: give 0 to 2"):
        pipe(photo, speech, amplitude=3)


def test_a_photo_unlike_what_was_learnt_moves_less_and_is_told(photo, speech, bundle, monkeypatch):
    pipe = GesturePipeline(bundle, precision="fp32")
    measured = pipe.statistics
    pose = source_pose(pipe.renderer, pipe.subject(photo, View()).picture)
    found, ways = [], []
    for mean in (0.4, 4.0):  # of the spread, by other statistics of training
        scale = spread(pose, measured).mean() / mean
        other = dataclasses.replace(measured, diagonal_high=measured.diagonal_high * scale)
        monkeypatch.setattr(pipe, "statistics", other)
        found.append(pipe(photo, speech))
        shift = found[-1].motion.shift
        ways.append((shift - shift[:1]).abs().mean())
    usual, strange = found
    assert ways[1] < 0.7 * ways[0] and usual.notes == []
    assert "unlike the people that the model has learnt" in strange.note
    assert "--from shipped" in strange.note
