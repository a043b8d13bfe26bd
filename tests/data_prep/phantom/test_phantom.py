"""The phantom's truth: strokes on the joints, rest in silence, determinism, faces, files."""

import json
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from data_prep.errors import BadInput
from data_prep.phantom.figure import HEIGHT, WIDTH
from data_prep.phantom.gesture import REST, TEMPLATES, schedule
from data_prep.phantom.make import Take, make_phantom, still, take, truth, voice_named
from data_prep.phantom.motion import minimum_jerk
from data_prep.phantom.presenters import presenter
from data_prep.phantom.script import TRIGGERS
from data_prep.phantom.skeleton import FOREARM, JOINTS, UPPER_ARM, elbow
from data_prep.rates import FPS
from data_prep.speaker.crop import find_faces

WRIST = (JOINTS.index("right_wrist"), JOINTS.index("left_wrist"))


@pytest.fixture(scope="module")
def shots() -> list[Take]:
    return [take(index, 0, seconds=16, seed=3) for index in range(4)]


def speed(points: np.ndarray) -> np.ndarray:
    """Speed (T,) of points (T, 2) in pixels a frame, by central differences."""
    step = np.linalg.norm(points[2:] - points[:-2], axis=-1) / 2
    return np.concatenate([step[:1], step, step[-1:]])


def test_lexicon_is_large_enough_and_covers_the_triggers() -> None:
    assert len(TEMPLATES) >= 16
    assert set(TRIGGERS.values()) <= set(TEMPLATES)


def test_minimum_jerk_by_hand() -> None:
    # 10/8 - 15/16 + 6/32 = 0.5; at 1/4: 10/64 - 15/256 + 6/1024 = 106/1024
    got = minimum_jerk(np.array([-1.0, 0.25, 0.5, 1.0, 2.0]))
    np.testing.assert_allclose(got, [0, 106 / 1024, 0.5, 1, 1], atol=1e-12)


def test_elbow_keeps_the_lengths_of_the_arm() -> None:
    shoulder = np.array([[80.0, 22, 0], [80.0, 22, 0]])
    bent, wrist = elbow(shoulder, np.array([[40.0, 150, 60], [400.0, 22, 0]]), np.ones(2))
    np.testing.assert_allclose(np.linalg.norm(bent - shoulder, axis=1), UPPER_ARM, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(wrist - bent, axis=1), FOREARM, rtol=1e-9)
    np.testing.assert_allclose(wrist[0], [40, 150, 60])  # in reach
    assert wrist[1, 0] < 80 + UPPER_ARM + FOREARM  # out of reach: as far as the arm goes


def test_every_stroke_lands_within_a_frame_of_its_beat(shots: list[Take]) -> None:
    for shot in shots:
        joints = shot.joints.points
        assert len(shot.strokes) >= 3
        for stroke in shot.strokes:
            word = shot.speech.words[stroke.word]
            assert stroke.apex in word.beats
            path = joints[:, WRIST[stroke.hands[0]]]
            first, last = round(stroke.prepared * FPS), round(stroke.end * FPS)
            near = [int(stroke.apex * FPS), int(stroke.apex * FPS) + 1]
            along = path[near[0]] - path[first]
            reach = (path - path[first]) @ along / (along @ along)
            assert reach[near].max() > 0.99 * reach[first : last + 1].max(), stroke
            fast = speed(path)
            assert fast[near].min() < 0.2 * fast[first : last + 1].max(), stroke


def test_strokes_start_within_a_frame_of_the_stated_time(shots: list[Take], scoring) -> None:
    away = []
    for shot in shots:
        known = truth(shot, 3)
        for hand, onset, prepared in zip(
            *(known[f"stroke_{name}"] for name in ("hand", "onset", "prepared")), strict=True
        ):
            away.append(abs(scoring.stroke_start(known["joints"], hand, onset, prepared) - onset))
    assert len(away) >= 20
    assert np.mean(np.array(away) <= 1 / FPS) >= 0.95


def test_called_words_always_get_their_stroke(shots: list[Take]) -> None:
    called = 0
    for shot in shots:
        by_word = {stroke.word: stroke for stroke in shot.strokes}
        for index, word in enumerate(shot.speech.words):
            if word.word in TRIGGERS:
                called += 1
                assert by_word[index].label == TRIGGERS[word.word]
                assert by_word[index].called
    assert called >= 8


def test_hands_rest_in_long_silence(shots: list[Take]) -> None:
    for shot in shots:
        phrases = shot.speech.phrases
        gaps = [(a[1], b[0]) for a, b in zip(phrases[:-1], phrases[1:], strict=True)]
        long = [(end, start) for end, start in gaps if start - end > 1.9]
        home = shot.joints.points[0]
        for end, start in long:
            calm = slice(round((end + 1.0) * FPS), round((start - 0.45) * FPS))
            for wrist in WRIST:
                path = shot.joints.points[:, wrist]
                assert speed(path)[calm].max() < 0.5
                assert np.abs(path[calm] - home[wrist]).max() < 3


def test_hands_move_when_it_speaks(shots: list[Take]) -> None:
    for shot in shots:
        fast = speed(shot.joints.points[:, WRIST[0]])
        fast = fast + speed(shot.joints.points[:, WRIST[1]])
        at = np.arange(len(fast)) / FPS
        spoken, calm = np.zeros(len(fast), bool), np.ones(len(fast), bool)
        for start, end in shot.speech.phrases:
            spoken |= (at >= start) & (at <= end)
            calm &= (at < start - 0.5) | (at > end + 0.9)
        assert fast[spoken].mean() > 10 * fast[calm].mean()


def test_styles_differ(shots: list[Take]) -> None:
    big, small = presenter(1).style, presenter(2).style
    assert big.amplitude > 1.5 * small.amplitude
    sides = {}
    for index in (0, 3):
        style, speech = presenter(index).style, shots[0].speech
        strokes = [s for n in range(6) for s in schedule(speech, style, np.random.default_rng(n))]
        sides[index] = np.mean([s.hands[0] == 0 for s in strokes if len(s.hands) == 1])
    assert sides[0] > 0.7 > 0.3 > sides[3]


def test_joints_lie_where_the_presenter_is(shots: list[Take]) -> None:
    for shot in shots:
        points = shot.joints.points
        assert points.shape == (round(shot.speech.duration * FPS), len(JOINTS), 2)
        named = dict(zip(JOINTS, points.mean(0), strict=True))
        assert named["right_wrist"][0] < named["neck"][0] < named["left_wrist"][0]
        assert named["crown"][1] < named["nose"][1] < named["chin"][1] < named["neck"][1]
        assert points[..., 0].min() > 0 and points[..., 0].max() < WIDTH
        assert points[..., 1].max() < HEIGHT


def test_same_seed_same_frames_other_seed_others() -> None:
    first, again = still(1, seed=5), still(1, seed=5)
    assert first.shape == (HEIGHT, WIDTH, 3) and first.dtype == np.uint8
    assert np.array_equal(first, again)
    assert not np.array_equal(first, still(1, seed=6))


def test_more_pixels_show_the_same_picture(shots: list[Take]) -> None:
    for shot in shots[:2]:
        usual, large = shot.figure.frame(40), shot.figure_at(3).frame(40)
        assert large.shape == (3 * HEIGHT, 3 * WIDTH, 3)
        small = cv2.resize(large, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(int)
        error = np.abs(small - usual).mean()
        assert error < 2.5  # grain among it
        moved = np.roll(small, 1, axis=1)
        assert np.abs(moved - usual).mean() > 1.5 * error


def test_the_face_is_found_where_it_is(shots: list[Take]) -> None:
    seen = found = 0
    for shot in shots:
        for t in (40, shot.joints.frames // 2):
            nose = shot.joints.points[t, JOINTS.index("nose")]
            faces = find_faces(shot.figure.frame(t))
            seen += 1
            if faces:
                x, y = faces[0].x + faces[0].w / 2, faces[0].y + faces[0].h / 2
                found += bool(np.hypot(x - nose[0], y - nose[1]) < 25)
    assert found >= 0.95 * seen


@pytest.mark.slow
def test_the_face_is_found_in_nearly_every_frame() -> None:
    for index in range(6):
        shot = take(index, 1, seconds=10, seed=4)
        frames = [shot.figure.frame(t) for t in range(0, shot.joints.frames, 10)]
        assert sum(len(find_faces(frame)) == 1 for frame in frames) >= 0.95 * len(frames)


def test_the_mouth_opens_with_the_sound(shots: list[Take]) -> None:
    for shot in shots:
        gap = shot.figure.course.face[:, 2]
        samples = shot.speech.samples.reshape(len(gap), -1)
        loud = np.sqrt((samples**2).mean(1))
        assert np.corrcoef(gap, loud)[0, 1] > 0.5
        assert gap[loud < 0.001].max() < 0.35


def test_rest_is_a_pose_of_both_hands() -> None:
    assert REST.prep == REST.apex


def test_make_writes_videos_words_and_truth(tmp_path: Path) -> None:
    out = tmp_path / "raw"
    videos = make_phantom(out, minutes=0.04, seed=1, presenters=1)
    assert [v.relative_to(out).as_posix() for v in videos] == ["adam/adam_000.mp4"]
    with av.open(str(videos[0])) as container:
        picture, sound = container.streams.video[0], container.streams.audio[0]
        frames = picture.frames
        assert (picture.width, picture.height) == (WIDTH, HEIGHT)
        assert picture.average_rate == FPS
        assert abs(float(sound.duration * sound.time_base) - frames / FPS) <= 1 / FPS
        assert "Synthetic" in container.metadata["comment"]
    words = json.loads(videos[0].with_suffix(".words.json").read_text())
    assert words and set(words[0]) == {"word", "start", "end"}
    with np.load(videos[0].with_suffix(".truth.npz"), allow_pickle=False) as known:
        assert known["joints"].shape == (frames, len(JOINTS), 2)
        assert tuple(known["joint_names"]) == JOINTS
        assert set(known["stroke_label"].tolist()) <= set(TEMPLATES)
        assert np.all(np.diff(known["stroke_apex"]) > 0)
        assert str(known["presenter"]) == "adam" and int(known["seed"]) == 1
        assert str(known["voice"]) == "builtin"
        style = presenter(0).style
        assert float(known["style_amplitude"]) == style.amplitude
        assert float(known["style_tempo"]) == style.tempo
    assert sorted(p.name for p in videos[0].parent.iterdir()) == [
        "adam_000.mp4",
        "adam_000.truth.npz",
        "adam_000.words.json",
    ]


def test_truth_orders_the_moments_of_a_stroke(shots: list[Take]) -> None:
    known = truth(shots[0], 3)
    moments = [known[f"stroke_{name}"] for name in ("onset", "prepared", "apex", "end")]
    for before, after in zip(moments[:-1], moments[1:], strict=True):
        assert np.all(before < after)
    assert np.all(moments[0][1:] >= moments[3][:-1] - 1e-9)


@pytest.mark.slow
def test_same_seed_same_files_other_seed_others(tmp_path: Path) -> None:
    def contents(folder: str, seed: int) -> dict[str, bytes]:
        videos = make_phantom(tmp_path / folder, minutes=0.015, seed=seed, presenters=1)
        return {path.name: path.read_bytes() for path in videos[0].parent.iterdir()}

    first, again, other = contents("a", 1), contents("b", 1), contents("c", 2)
    assert len(first) == 3 and first == again
    assert all(first[name] != other[name] for name in first)


def test_an_unknown_voice_is_refused() -> None:
    assert voice_named("builtin") == "builtin"
    assert voice_named("auto") in ("builtin", "espeak")
    with pytest.raises(BadInput, match="auto, builtin, espeak"):
        voice_named("tenor")


def test_bad_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="minutes"):
        make_phantom(tmp_path / "a", minutes=0, seed=0)
    with pytest.raises(BadInput, match="cannot make the folder"):
        make_phantom(tmp_path / "no" / "such" / "parent", minutes=1, seed=0)
    assert list(tmp_path.iterdir()) == []


def test_pictures_are_drawn_from_textures_that_move(shots: list[Take]) -> None:
    shot = shots[1]
    stroke = max(shot.strokes, key=lambda s: s.end - s.onset)
    middle = round((stroke.prepared + stroke.apex) / 2 * FPS)
    a, b = (shot.figure.frame(t).astype(np.float32) for t in (middle, middle + 2))
    changed = cv2.blur(np.abs(a - b).mean(2), (5, 5)) > 8
    assert changed.mean() > 0.01
