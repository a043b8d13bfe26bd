"""Dataset folders: frames in any order, sound, features and words, and the refusal of others."""

import dataclasses
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from data_prep.dataset import (
    MAX_BYTES,
    Clip,
    Dataset,
    FrameStore,
    encode_frame,
    write_frames,
    write_table,
)
from data_prep.errors import BadInput
from data_prep.media.audio import write_wav
from data_prep.speech.features import FEATURES, Speech, write_features
from data_prep.speech.words import Word, read_words, slice_words, write_words


def frame(level: int) -> np.ndarray:
    picture = np.full((256, 256, 3), level, np.uint8)
    picture[64:128, 64:128] = (200, 60, 30)
    return picture


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("frames", "audio", "features", "words"):
        (tmp_path / name).mkdir()
    clips = [Clip("b_001", "b", "train", "b", 4.0, 5), Clip("a_000", "a", "test", "a", 0.0, 3)]
    write_table(tmp_path / "meta.csv", clips, 25)
    (tmp_path / "dataset.json").write_text(json.dumps({"format": 1}))
    for clip in clips:
        frames = [encode_frame(frame(40 * i)) for i in range(clip.n_frames)]
        write_frames(tmp_path / "frames" / f"{clip.id}.safetensors", frames)
        write_wav(tmp_path / "audio" / f"{clip.id}.wav", np.full(clip.n_frames * 640, 0.5))
    # eight frames, as where the last three belong to the gap before another split
    features = {
        "onset": np.arange(426, dtype=np.float32)[None],
        "mfcc": np.ones((8, 28, 12), np.float32),
        "onset_times": np.float32([0.1, 0.19, 0.21]),
    }
    write_features(tmp_path / "features" / "b_001.npz", Speech.of_features(features, 8))
    write_words(tmp_path / "words" / "b_001.json", [Word("hello", 0.05, 0.15)])
    return tmp_path


def test_clips_come_by_split_and_speaker(folder: Path) -> None:
    data = Dataset(folder)
    assert [clip.id for clip in data.clips()] == ["a_000", "b_001"]
    assert [clip.id for clip in data.clips("train")] == ["b_001"]
    assert [clip.id for clip in data.clips(speaker="a")] == ["a_000"]
    assert data.clips("train", "a") == []
    assert data.speakers() == ["a", "b"]
    assert data.clips("train")[0] == Clip("b_001", "b", "train", "b", 4.0, 5)


def test_frames_are_read_in_any_order_and_process(folder: Path) -> None:
    data = Dataset(folder)
    store = data.frames(data.clips("train")[0])
    assert len(store) == 5
    for index in (3, 0, 4, -1, 2):
        level = 40 * (index % 5)
        picture = store[index]
        assert picture.shape == (256, 256, 3) and picture.dtype == np.uint8
        np.testing.assert_allclose(picture[10, 10].astype(int), level, atol=2)
        np.testing.assert_allclose(picture[96, 96].astype(int), (200, 60, 30), atol=4)
    with pytest.raises(IndexError):
        store[5]
    again = pickle.loads(pickle.dumps(store))
    np.testing.assert_array_equal(again[3], store[3])


def test_frames_stay_small(tmp_path: Path) -> None:
    smooth = np.random.default_rng(0).integers(0, 255, (32, 32, 3), dtype=np.uint8)
    busy = np.repeat(np.repeat(smooth, 8, axis=0), 8, axis=1)
    busy += np.random.default_rng(1).integers(0, 40, busy.shape, dtype=np.uint8)
    assert len(encode_frame(busy)) <= MAX_BYTES


def test_sound_features_and_words_come_back(folder: Path) -> None:
    data = Dataset(folder)
    one, other = data.clips("train")[0], data.clips("test")[0]
    np.testing.assert_allclose(data.sound(one), np.full(3200, 0.5), atol=1e-4)
    speech = data.speech(one)
    assert speech["onset"][0, 425] == 425 and speech["mfcc"].shape == (5, 28, 12)
    assert speech["onset_times"].tolist() == pytest.approx([0.1, 0.19])
    assert speech.words == (Word("hello", 0.05, 0.15),) and speech.seconds == 0.2
    np.testing.assert_array_equal(speech.samples, data.sound(one))
    assert data.words(one) == [Word("hello", 0.05, 0.15)]
    assert data.words(other) is None


def test_a_feature_that_was_not_prepared_is_computed_once_and_stored(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed = []

    def loudness(speech: Speech) -> np.ndarray:
        computed.append(len(speech.samples))
        return np.abs(speech.samples.reshape(speech.frames, -1)).mean(axis=1)

    monkeypatch.setitem(FEATURES, "loudness", loudness)
    data = Dataset(folder)
    one = data.clips("train")[0]
    first = data.speech(one)["loudness"]
    np.testing.assert_allclose(first, np.full(5, 0.5), atol=1e-4)
    np.testing.assert_array_equal(data.speech(one)["loudness"], first)
    assert computed == [3200]
    shorter = dataclasses.replace(one, n_frames=4)  # after another division into splits
    assert len(data.speech(shorter)["loudness"]) == 4


def test_missing_or_damaged_parts_are_told(folder: Path, tmp_path: Path) -> None:
    data = Dataset(folder)
    other = data.clips("test")[0]
    with pytest.raises(BadInput, match=r"a_000\.npz.*prepare"):
        data.speech(other)
    damaged = folder / "features" / "b_001.npz"
    damaged.write_bytes(damaged.read_bytes()[:99])
    with pytest.raises(BadInput, match=r"b_001\.npz.*prepare"):
        data.speech(data.clips("train")[0])["onset"]
    (folder / "frames" / "a_000.safetensors").write_bytes(b"no frames at all")
    with pytest.raises(BadInput, match=r"a_000\.safetensors.*prepare"):
        data.frames(other)
    with pytest.raises(BadInput, match=r"is not a dataset \(dataset\.json"):
        Dataset(tmp_path / "frames")
    (folder / "dataset.json").write_text('{"format": 99}')
    with pytest.raises(BadInput, match="newer"):
        Dataset(folder)
    (folder / "dataset.json").write_text("{")
    with pytest.raises(BadInput, match="damaged"):
        Dataset(folder)


def test_frame_store_refuses_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="missing"):
        FrameStore(tmp_path / "none.safetensors")


def test_words_are_sliced_by_their_middle(tmp_path: Path) -> None:
    words = [Word("a", 0.0, 0.5), Word("b", 0.9, 1.3), Word("c", 1.8, 2.4), Word("d", 2.5, 3.0)]
    assert slice_words(words, 1.0, 2.2) == [
        Word("b", 0.0, pytest.approx(0.3)),
        Word("c", pytest.approx(0.8), pytest.approx(1.2)),
    ]
    (tmp_path / "bad.json").write_text('[{"word": "a"}]')
    with pytest.raises(BadInput, match=r"bad\.json"):
        read_words(tmp_path / "bad.json")
