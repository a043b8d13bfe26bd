import av
import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from angie.bundle import Bundle
from angie.pipeline import animate, scale_displacement
from angie.source import framing
from data_prep.errors import BadInput
from data_prep.media.audio import read_sound, write_wav
from data_prep.media.video import read_frames
from data_prep.phantom.make import recording, still, take
from data_prep.rates import SAMPLE_RATE
from data_prep.speaker.crop import Crop, cut_out, find_faces, speaker_crop
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


def make(photo, speech, path, bundle, **options):
    return animate(photo, speech, path, Bundle.open(bundle.folder), **options)


@pytest.fixture(scope="module")
def video(photo, speech, bundle, tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "out.mp4"
    return make(photo, speech, path, bundle)


def frames_of(path):
    return np.stack(list(read_frames(path)))


def test_the_video_meets_the_contract(video, speech):
    samples = read_sound(speech)
    wanted = -(-len(samples) // 640)
    assert video.frames == wanted
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
    assert video.crop == crop
    error = ((frames[0] - cut_out(image, crop).astype(int)) ** 2).mean()
    assert 10 * np.log10(255**2 / error) > 20  # dB, through a barely trained renderer and H.264
    assert np.abs(frames[1:] - frames[0]).mean() > 0.3


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
    with pytest.raises(BadInput, match="would replace the input"):
        make(photo, speech, speech, bundle, force=True)
    assert speech.read_bytes() == before


def test_a_given_crop_is_used(photo, speech, bundle, tmp_path):
    result = make(photo, speech, tmp_path / "crop.mp4", bundle, crop=Crop(100, 0, 300))
    assert result.crop == Crop(100, 0, 300)


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
        assert result.width_height == (side, side) and result.crop == crop
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
    statistics = bundle.generator().statistics
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
