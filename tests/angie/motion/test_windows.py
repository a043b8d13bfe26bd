import dataclasses

import numpy as np
import pytest
import torch

from angie.generators.angie.train import GPTTraining, VQTraining
from angie.generators.angie.train_refiner import RefinerTraining
from angie.motion.clips import begun_later
from angie.motion.windows import MotionWindows, other_grids
from data_prep.errors import BadInput
from data_prep.speech.features import Speech
from data_prep.speech.spectra import onset_rows

PARTS = ("poses", "onset", "mfcc")


def test_windows_start_every_32_frames_of_each_clip(make_clip, statistics):
    windows = MotionWindows([make_clip(250, 0), make_clip(96, 1)], statistics)
    # 0, 32, 64, 96, 128 end at 96 ... 224; 160 would end at 256 > 250
    assert windows.places == [(0, 0), (0, 32), (0, 64), (0, 96), (0, 128), (1, 0)]


def test_a_window_and_its_sound_belong_together(make_clip, statistics):
    clip = make_clip(250, 0)
    item = MotionWindows([clip], statistics, PARTS)[1]
    vector = clip.motion.vector()
    assert torch.equal(item["poses"], vector[31:128])
    onset = torch.from_numpy(clip.speech["onset"])
    mfcc = torch.from_numpy(clip.speech["mfcc"])
    assert torch.equal(item["onset"], statistics.standard_onset(onset[4:16]))
    assert torch.equal(item["mfcc"], statistics.standard_mfcc(mfcc[32:128]))


def test_the_first_frame_of_a_clip_leads_itself(make_clip, statistics):
    clip = make_clip(96, 0)
    poses = MotionWindows([clip], statistics)[0]["poses"]
    assert poses.shape == (97, 20)
    assert torch.equal(poses[0], poses[1]) and torch.equal(poses[1:], clip.motion.vector())


def test_rows_travel_with_their_windows(clips, statistics):
    windows = MotionWindows(clips, statistics)
    numbered = windows.choose(["onset"], number=torch.arange(len(windows)))
    assert set(numbered[7]) == {"onset", "number"} and numbered[7]["number"] == 7
    assert torch.equal(numbered.stack("number", 3, 5), torch.tensor([3, 4]))
    assert torch.equal(numbered.stack("onset", 2, 99999)[1], numbered[3]["onset"])


def test_clips_that_are_too_short_are_bad_input(make_clip, statistics):
    with pytest.raises(BadInput, match="96 frames"):
        MotionWindows([make_clip(95, 0)], statistics)


def test_more_motion_than_sound_is_bad_input(make_clip):
    long, short = make_clip(100, 0), make_clip(90, 1)
    with pytest.raises(BadInput, match="ada_0: 100 frames of motion but 90"):
        type(long)(long.name, long.speaker, long.motion, short.speech)


def test_other_grids_begin_clips_later(make_clip):
    clips = [make_clip(99, 0), make_clip(250, 1)]
    sound = np.random.default_rng(0).normal(0, 0.1, 250 * 640).astype(np.float32)
    asked = []

    def sound_of(name):
        asked.append(name)
        return sound

    assert other_grids(clips, sound_of, 1) == [] == asked
    made = other_grids(clips, sound_of, 4)
    assert asked == ["ada_0", "ada_1"]
    # 99 frames hold a window from frame 2 on, none from frame 4 on
    assert [clip.name for clip in made] == ["ada_0+2", "ada_1+2", "ada_1+4", "ada_1+6"]
    later, clip = made[2], clips[1]
    assert torch.equal(later.motion.vector(), clip.motion.vector()[4:])
    assert np.array_equal(later.speech["mfcc"], clip.speech["mfcc"][4:])
    assert np.array_equal(later.speech["onset"], onset_rows(sound[4 * 640 :]))
    assert later.speaker == clip.speaker and len(other_grids(clips, sound_of, 8)) == 10


def test_onset_times_count_from_where_a_clip_begins(make_clip):
    clip = make_clip(250, 0)
    features = {"mfcc": clip.speech["mfcc"], "onset_times": np.float32([0.1, 0.5, 2.0])}
    clip = dataclasses.replace(clip, speech=Speech.of_features(features, 250))
    later = begun_later(clip, np.zeros(250 * 640, np.float32), 6)
    assert later.speech["onset_times"].tolist() == pytest.approx([0.26, 1.76])


@pytest.mark.parametrize("grids", [0, 3, 16])
def test_grids_divide_a_token(grids):
    with pytest.raises(ValueError, match=f"1, 2, 4 or 8, not {grids}"):
        GPTTraining(grids=grids)


def test_the_speaker_of_a_window(clips, statistics):
    windows = MotionWindows(clips[:2], statistics, ["speaker"])
    names = [clip.speaker for clip in windows.clips]
    for index, (place, _) in enumerate(windows.places):
        assert statistics.speakers[int(windows[index]["speaker"])] == names[place]


def test_some_of_the_windows_keep_their_rows(clips, statistics):
    windows = MotionWindows(clips[:2], statistics)
    windows = windows.choose(["poses"], number=torch.arange(len(windows)))
    some = windows.chosen([4, 1])
    assert [int(item["number"]) for item in (some[0], some[1])] == [4, 1]
    assert torch.equal(some[0]["poses"], windows[4]["poses"])


def test_windows_without_onsets_begin_at_any_frame(make_clip, statistics):
    clip = make_clip(110, 0)
    windows = MotionWindows([clip], statistics, ["poses", "mfcc"], stride=5)
    assert [first for _, first in windows.places] == [0, 5, 10]
    assert torch.equal(windows[1]["poses"], clip.motion.vector()[4:101])
    with pytest.raises(ValueError, match="tokens"):
        windows.choose(["onset"])


@pytest.mark.parametrize("training", [GPTTraining, RefinerTraining])
def test_a_stride_is_whole_tokens_where_codes_meet_sound(training):
    assert VQTraining(stride=5).stride == 5
    with pytest.raises(ValueError, match="a multiple of 8 frames, not 5"):
        training(stride=5)
    with pytest.raises(ValueError, match="at least one frame, not 0"):
        VQTraining(stride=0)
