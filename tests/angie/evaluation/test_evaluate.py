"""`angie evaluate` from dataset and bundle to report, and on a folder of videos."""

import json
import shutil

import numpy as np
import pytest

from angie.bundle import BUNDLE
from angie.evaluation import people
from angie.evaluation.evaluate import _grouped, evaluate, row_names
from angie.evaluation.external import evaluate_videos, watch
from angie.evaluation.images import FrameChoice, chosen_frames
from angie.evaluation.networks import EvaluationConfig
from angie.evaluation.videos import padded
from data_prep.errors import BadInput
from data_prep.media.video import VideoWriter, probe

QUICK = {"fgd_steps": 5, "aed_steps": 5, "image_stride": 200, "videos_shown": 0}


@pytest.fixture(scope="module")
def made(dataset, bundle, phantom_videos, sees_white, tmp_path_factory):
    output = tmp_path_factory.mktemp("evaluation") / "report"
    config = EvaluationConfig(seeds=2, truth=phantom_videos, models=output, **QUICK)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(people, "People", sees_white)
        numbers = evaluate(dataset.path, [bundle.folder], output, config)
    return output, numbers


def row(numbers, name, part="rows"):
    rows = numbers["spaces"][0][part]
    return next(r for r in (rows if part == "rows" else rows["rows"]) if r["name"] == name)


def test_a_report_has_its_rows_and_files(made, bundle):
    output, numbers = made
    assert [r["name"] for r in numbers["spaces"][0]["rows"]] == [
        "ground truth", "motionless", "mismatched", "nearest audio", bundle.folder.name
    ]  # fmt: skip
    names = {path.name for path in output.iterdir()}
    assert names == {
        "results.json", "table.csv", "report.html", "fgd-0.safetensors", "identity-0.safetensors"
    }  # fmt: skip
    assert json.loads((output / "results.json").read_text()) == json.loads(json.dumps(numbers))
    own = row(numbers, bundle.folder.name)
    assert own["runs"] == 2 and own["scores"]["fgd"]["interval"] is not None
    assert own["scores"]["fgd"]["mean"] > 0


def test_the_truth_is_perfect_and_stillness_has_no_beats(made):
    _, numbers = made
    truth = row(numbers, "ground truth")["scores"]
    assert truth["fgd"]["mean"] == truth["maje"]["mean"] == 0
    assert truth["cca"]["mean"] == pytest.approx(1)
    assert row(numbers, "motionless")["scores"]["bc"]["mean"] is None


def test_image_scores_of_the_true_regions_are_best_even_hardly_trained(made):
    _, numbers = made
    true, still = (row(numbers, n, "images")["scores"] for n in ("true regions", "motionless"))
    assert [key for key in true if true[key]["mean"] is None] == ["mkr"]
    assert true["psnr"]["mean"] > still["psnr"]["mean"]
    for key in ("l1", "perceptual", "aed"):  # regions of a picture so rough may be anywhere
        assert true[key]["mean"] < still[key]["mean"], key


def test_people_are_looked_for_in_what_is_drawn_and_in_what_stands_beside(made):
    output, numbers = made
    names = ["recorded", "first frame", "warping alone", "true regions"]
    assert [r["name"] for r in numbers["spaces"][0]["people"]["rows"]] == names
    whole, still, warped, drawn = (row(numbers, n, "people")["scores"] for n in names)
    for key in ("psnr", "psnr_hands", "psnr_face"):
        assert whole[key]["mean"] > 30 and whole[key]["mean"] > drawn[key]["mean"], key
    assert drawn["psnr"]["mean"] > still["psnr"]["mean"]
    assert warped["l1"]["mean"] != drawn["l1"]["mean"]
    wrists = {part["wrist"]["mean"] for part in (whole, still, warped, drawn)}
    assert len(wrists) == 1 and wrists.pop() > 0  # always seen at one place
    assert "finger tips are not known" in whole["tips"]["reason"]
    assert "people,warping alone" in (output / "table.csv").read_text()
    assert "<h2>People</h2>" in (output / "report.html").read_text()


def test_frames_drawn_from_the_true_regions_leave_the_part_of_the_motion_alone(made):
    _, numbers = made
    true, still = (row(numbers, n, "images")["scores"] for n in ("true regions", "motionless"))
    for key in ("l1_drawn", "perceptual_drawn"):
        assert true[key]["mean"] == 0 < still[key]["mean"]
    assert 0 < true["l1"]["mean"]  # what the renderer cannot draw is no part of it


def test_a_bundle_named_like_a_row_of_reference_is_told_apart(bundle, tmp_path):
    for name in ("true regions", "mine"):
        shutil.copytree(bundle.folder, tmp_path / "b" / name)
    (group,) = _grouped([tmp_path / "b" / "true regions", tmp_path / "b" / "mine"])
    assert list(group) == ["b/true regions", "mine"]


@pytest.fixture(scope="module")
def shipped(dataset, phantom_videos, tmp_path_factory):
    output = tmp_path_factory.mktemp("evaluation") / "shipped"
    return evaluate(dataset.path, [BUNDLE], output, EvaluationConfig(truth=phantom_videos, **QUICK))


@pytest.mark.slow
def test_image_scores_of_the_true_regions_are_best(shipped):
    """With a renderer that can draw; the tests' own has hardly been trained."""
    true, still = (row(shipped, n, "images")["scores"] for n in ("true regions", "motionless"))
    assert [key for key in true if true[key]["mean"] is None] == ["mkr"]
    assert true["psnr"]["mean"] > still["psnr"]["mean"]
    for key in ("l1", "perceptual", "aed", "akd", "akd_joints"):
        assert true[key]["mean"] < still[key]["mean"], key


@pytest.mark.slow
def test_videos_stand_side_by_side(dataset, bundle, tmp_path):
    config = EvaluationConfig(**{**QUICK, "videos_shown": 1})
    numbers = evaluate(dataset.path, [bundle.folder], tmp_path / "report", config)
    (name,) = numbers["spaces"][0]["videos"]
    info = probe(tmp_path / "report" / name)
    assert (info.width, info.height) == (6 * 256, 280) and info.has_sound
    clip = next(c for c in dataset.clips() if f"videos-0/{c.id}.mp4" == name)
    assert info.duration == pytest.approx(clip.n_frames / 25, abs=0.05)


def test_a_column_that_ends_early_goes_on_dark():
    given = [np.full((2, 2, 3), value, np.uint8) for value in (100, 200)]
    made = [int(frame[0, 0, 0]) for frame in padded(iter(given), 4)]
    assert made == [100, 200, 70, 70]
    assert len(list(padded(iter(given), 1))) == 1


def test_the_same_seed_gives_the_same_report_and_a_stored_auto_encoder_is_taken(
    made, dataset, bundle, tmp_path
):
    output, first = made
    config = EvaluationConfig(seeds=2, images=False, **QUICK)
    again = evaluate(dataset.path, [bundle.folder], tmp_path / "again", config)
    assert again["spaces"][0]["rows"] == first["spaces"][0]["rows"]
    assert not (tmp_path / "again" / "identity-0.safetensors").exists()
    stored = output / "fgd-0.safetensors"
    config = EvaluationConfig(2, images=False, fgd=stored, start="pose", greedy=True)
    third = evaluate(dataset.path, [bundle.folder], tmp_path / "third", config)
    name = "auto-encoder of FGD"
    assert third["spaces"][0]["origin"][name] == first["spaces"][0]["origin"][name]
    assert row(third, "nearest audio")["scores"] == row(first, "nearest audio")["scores"]
    own = row(third, bundle.folder.name)
    assert own["runs"] == 1 and "stillness" in own["about"] and "greedy" in own["about"]


@pytest.fixture
def folder(dataset, tmp_path):
    """One test clip as it is under its own name, and a silent video of nobody."""
    folder = tmp_path / "system"
    folder.mkdir()
    clip = dataset.clips("test")[0]
    shutil.copy(dataset.path / "video" / f"{clip.id}.mp4", folder)
    rng = np.random.default_rng(0)
    with VideoWriter(folder / "other.mp4", (128, 128)) as video:
        for _ in range(70):
            video.write(rng.integers(0, 255, (128, 128, 3), dtype=np.uint8))
    return folder


def test_a_folder_of_videos_is_scored(folder, dataset, bundle, tmp_path):
    output = tmp_path / "report"
    config = EvaluationConfig(**{**QUICK, "videos_shown": 1})
    numbers = evaluate_videos(folder, dataset.path, bundle.folder, output, config)
    own = row(numbers, "system")["scores"]
    assert "2 videos, 1 of them" in row(numbers, "system")["about"]
    assert own["maje_px"]["mean"] < 1  # the clip itself, but for the video's compression
    assert own["bc"]["runs"][0]["counts"]["without onsets"] == 1
    scores = row(numbers, "system", "images")["scores"]
    assert scores["l1"]["mean"] < 0.02 and scores["psnr"]["mean"] > 30
    assert scores["l1_drawn"]["mean"] is None and "not known" in scores["l1_drawn"]["reason"]
    assert len(list((output / "videos-0").iterdir())) == 1


def test_what_another_network_found_is_scored(folder, dataset, bundle, tmp_path):
    name = dataset.clips("test")[0].id
    own = tmp_path / "found"
    own.mkdir()
    points = np.zeros((9, 4, 2))
    np.savez(
        own / f"{name}.npz",
        **{"real_embeddings": np.ones((9, 8)), "made_embeddings": np.full((9, 8), 1.5)},
        **{"real_points": points, "made_points": np.where(np.arange(4)[:, None] > 0, 3, np.nan)
           + points},
    )  # fmt: skip
    config = EvaluationConfig(**QUICK, detected=own)
    numbers = evaluate_videos(folder, dataset.path, bundle.folder, tmp_path / "report", config)
    scores = row(numbers, "system", "images")["scores"]
    assert [scores[key]["mean"] for key in ("aed", "akd_joints", "mkr")] == [0.5, 3, 0.25]
    (own / f"{name}.npz").rename(own / "third.npz")
    with pytest.raises(BadInput, match="no NAME.npz"):
        evaluate_videos(folder, dataset.path, bundle.folder, tmp_path / "again", config)


def test_bad_folders_of_videos_are_refused(folder, dataset, bundle, tmp_path):
    (tmp_path / "empty").mkdir()
    wide = tmp_path / "wide"
    wide.mkdir()
    with VideoWriter(wide / "wide.mp4", (128, 64)) as video:
        video.write(np.zeros((64, 128, 3), np.uint8))
    for place, words in [("empty", "no videos"), ("none", "not a folder"), ("wide", "128x64")]:
        with pytest.raises(BadInput, match=words):
            evaluate_videos(
                tmp_path / place,
                dataset.path,
                bundle.folder,
                tmp_path / "out",
                EvaluationConfig(images=False, fgd_steps=1),
            )
    assert not list(tmp_path.glob("*out*")) and not list(tmp_path.glob(".*"))


def test_what_cannot_be_used_is_told_before_anything_is_measured(
    folder, dataset, bundle, tmp_path, monkeypatch
):
    monkeypatch.setattr("angie.evaluation.external.open_space", lambda *_: pytest.fail("measured"))
    (folder / "z.mp4").write_bytes(b"no video")
    with pytest.raises(BadInput, match=r"z\.mp4"):
        evaluate_videos(folder, dataset.path, bundle.folder, tmp_path / "out")
    (folder / "z.mp4").unlink()
    weights = tmp_path / "vgg.pth"
    weights.write_bytes(b"no weights")
    config = EvaluationConfig(perceptual_weights=str(weights))
    with pytest.raises(BadInput, match=r"vgg\.pth"):
        evaluate_videos(folder, dataset.path, bundle.folder, tmp_path / "out", config)


def test_a_video_named_like_a_training_clip_has_its_speaker_and_no_truth(space, tmp_path):
    path = tmp_path / f"{space.train[0].name}.mp4"
    with VideoWriter(path, (64, 64)) as video:
        for _ in range(4):
            video.write(np.zeros((64, 64, 3), np.uint8))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "angie.evaluation.external.measure_motion", lambda *_: space.train[0].motion[:4]
        )
        watched = watch(path, space, None)
    assert watched.clip is None and watched.performance.truth is None
    assert watched.performance.speaker == space.train[0].speaker


def test_rows_of_one_name_are_told_apart_by_as_many_parents_as_need_be(tmp_path):
    places = [tmp_path / name for name in ("p/x/a", "q/x/a", "b", "motionless")]
    assert row_names(places) == ["p/x/a", "q/x/a", "b", f"{tmp_path.name}/motionless"]


@pytest.mark.parametrize("seconds", [0.01, float("inf"), float("nan")])
def test_a_beginning_without_frames_is_refused(seconds):
    with pytest.raises(BadInput, match="--image-seconds"):
        EvaluationConfig(image_seconds=seconds)


def test_frames_of_the_beginning_alone():
    assert FrameChoice(24, 2.0).numbers(250).tolist() == [24, 25, 48, 49]
    assert FrameChoice(24).numbers(60).tolist() == [24, 25, 48, 49]
    assert FrameChoice(24, 0.5).numbers(250).tolist() == [10, 11]
    assert "in the first 2 s" in str(FrameChoice(24, 2.0)) and "first" not in str(FrameChoice(24))


def test_a_clip_shorter_than_the_stride_gives_its_last_two_frames():
    assert chosen_frames(12, 300).tolist() == [10, 11]
    assert chosen_frames(3, 25).tolist() == [1, 2] and not len(chosen_frames(2, 25))
