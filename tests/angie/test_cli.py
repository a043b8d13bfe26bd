"""The command: bad input is one line and exit status 2, and leaves nothing behind."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from angie.cli import main
from angie.motion.amplitude import ADVICE, is_stranger, spread
from angie.pipeline import GesturePipeline
from data_prep.media.audio import write_wav
from data_prep.media.video import VideoWriter
from data_prep.phantom.make import still


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    Image.fromarray(still(0, seed=5)).save(folder / "photo.png")
    write_wav(folder / "speech.wav", 0.1 * np.sin(np.arange(16_000) / 5), 16_000)
    Image.fromarray(np.full((90, 90, 3), 90, np.uint8)).save(folder / "nobody.png")
    (folder / "text.png").write_text("this is no picture")
    (folder / "text.wav").write_text("this is no recording")
    (folder / "empty.wav").touch()
    (folder / "empty.png").touch()
    with VideoWriter(folder / "silent.mp4", (64, 64)) as video:
        for _ in range(10):
            video.write(np.zeros((64, 64, 3), np.uint8))
    (folder / "folder").mkdir()
    return folder


def call(capsys, *arguments):
    """Exit status, standard output and standard error of `angie ARGUMENTS`."""
    status = 0
    old, sys.argv = sys.argv, ["angie", *map(str, arguments)]
    try:
        main()
    except SystemExit as leave:
        status = leave.code or 0
    finally:
        sys.argv = old
    captured = capsys.readouterr()
    return status, captured.out, captured.err


BAD = [
    ("missing.png", "speech.wav", "no such file"),
    ("photo.png", "missing.wav", "no such file"),
    ("folder", "speech.wav", "is a folder"),
    ("text.png", "speech.wav", "text.png"),
    ("empty.png", "speech.wav", "empty.png"),
    ("photo.png", "text.wav", "text.wav"),
    ("photo.png", "empty.wav", "empty.wav"),
    ("photo.png", "silent.mp4", "silent.mp4"),
    ("nobody.png", "speech.wav", "--crop"),
]


@pytest.mark.usefixtures("one_process")
@pytest.mark.parametrize(("photo", "speech", "words"), BAD)
def test_bad_input_is_one_line(inputs, bundle, tmp_path, capsys, photo, speech, words):
    before = sorted(inputs.iterdir())
    status, out, err = call(
        capsys,
        *("animate", inputs / photo, inputs / speech),
        *("-o", tmp_path / "out.mp4", "--speaker", bundle.folder),
    )
    assert status == 2 and out == ""
    assert err.count("\n") == 1 and err.startswith("angie: ") and words in err
    assert list(tmp_path.iterdir()) == [] and sorted(inputs.iterdir()) == before


@pytest.mark.usefixtures("one_process")
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["-o", "{tmp}/none/out.mp4"], "does not exist"),
        (["-o", "{tmp}/taken.mp4"], "exists already"),
        (["-o", "/proc/out.mp4"], "cannot write there"),  # read-only, for root too
        (["-o", "{tmp}/" + "x" * 300 + ".mp4"], "too long"),
        (["-o", "{tmp}/new.mp4", "--crop", "-500,0,100"], "outside"),
        (["-o", "{tmp}/new.mp4", "--crop", "0,0,1000000"], "too large"),
        (["-o", "{tmp}/new.mp4", "--device", "cpu:x"], "--device"),
        (["-o", "{tmp}/new.mp4", "--crop", "1,2"], "x,y,size"),
        (["-o", "{tmp}/new.mp4", "--crop", "5000,0,100"], "outside"),
        (["-o", "{tmp}/new.mp4", "--device", "cuda:99"], "--device"),
        (["-o", "{tmp}/new.mp4", "--device", "tpu"], "--device"),
        (["-o", "{tmp}/new.mp4", "--scale-motion", "twice"], "--scale-motion"),
        (["-o", "{tmp}/new.mp4", "--amplitude", "2.5"], "--amplitude"),
        (["-o", "{tmp}/new.mp4", "--size", "300"], "256, 512, 1024, photo"),
        (["-o", "{tmp}/new.avi"], "let its name end in .mp4"),
        (["-o", "{tmp}/new.mp4", "--format", "avi"], "choose from mp4, webm, gif, frames"),
        (["-o", "{tmp}/new.mp4", "--format", "frames"], "leave .mp4 off"),
        (["-o", "{tmp}/new.mp4", "--format", "gif"], "is a gif; let its name end in .gif"),
        (["-o", "{tmp}/new.mp4", "--preview"], "let its name end in .png"),
        (["-o", "{tmp}/new.mp4", "--start", "sofa"], "--start sofa"),
        (["-o", "{tmp}/new.mp4", "--fade", "-1"], "--fade"),
        (["-o", "{tmp}/new.mp4", "--temperature", "0"], "--temperature 0"),
        (["-o", "{tmp}/new.mp4", "--greedy", "--temperature", "1"], "give one"),
        (["-o", "{tmp}/new.mp4", "--motion", "{tmp}/none.npz"], "give the saved motion"),
        (["-o", "{tmp}/new.mp4", "--motion", "{tmp}/taken.mp4", "--greedy"], "not for --motion"),
        (["-o", "{tmp}/new.mp4", "--save-motion", "{tmp}/taken.mp4"], "exists already"),
        (["-o", "{tmp}/new.mp4", "--jobs", "jobs.csv"], "--jobs: the list names"),
        (["-o", "{tmp}/new.mp4", "--size", "512", "--full-frame"], "give one"),
        (["-o", "{tmp}/new.mp4", "--speaker", "{tmp}"], "not a speaker bundle"),
    ],
)
def test_bad_options_are_one_line(inputs, bundle, tmp_path, capsys, options, words):
    (tmp_path / "taken.mp4").write_text("keep me")
    options = [option.format(tmp=tmp_path) for option in options]
    if "--speaker" not in options:
        options += ["--speaker", str(bundle.folder)]
    status, out, err = call(
        capsys, "animate", inputs / "photo.png", inputs / "speech.wav", *options
    )
    assert status == 2 and out == "" and words in err and err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["taken.mp4"]
    assert (tmp_path / "taken.mp4").read_text() == "keep me"


def test_animate_prints_its_result(inputs, bundle, tmp_path, capsys):
    path = tmp_path / "out.mp4"
    status, out, err = call(
        capsys,
        *("animate", inputs / "photo.png", inputs / "speech.wav"),
        *("-o", path, "--speaker", bundle.folder),
    )
    assert status == 0
    pipe = GesturePipeline.from_pretrained(bundle.folder)
    pose = pipe(inputs / "photo.png", inputs / "speech.wav").pose
    strange = is_stranger(spread(pose, pipe.statistics))
    assert err == (f"angie: {ADVICE}\n" if strange else "")
    assert out == f"{path}: 25 frames of 256x256, 1.00 s of sound\n"
    assert [p.name for p in tmp_path.iterdir()] == ["out.mp4"]


def test_info_of_a_bundle(bundle, capsys):
    status, out, _ = call(capsys, "info", bundle.folder)
    assert status == 0 and "preset      tiny: 10 regions" in out


def test_prepare_and_train_tell_bad_input(tmp_path, capsys):
    status, _, err = call(capsys, "prepare", tmp_path / "none.mp4", "-o", tmp_path / "data")
    assert status == 2 and "none.mp4" in err
    status, _, err = call(capsys, "train", tmp_path, "-o", tmp_path / "bundle")
    assert status == 2 and "not a dataset" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--device", "tpu9"], "--device tpu9"),
        (["--precision", "8-bit"], "--precision 8-bit"),
        (["--seed", "-1"], "--seed"),
        (["--preset", "huge"], "--preset huge"),
        (["gtp.layers=4"], "nearest is gpt"),
        (["--stage", "vq"], "no renderer yet"),
        (["--also", "none:2"], "none: is not a dataset"),
        (["--from", "shipped", "--preset", "tiny"], "give one"),
        (["--from", "none"], "not a speaker bundle"),
        (["train_renderer.perceptual_weights=none.pth"], "none.pth"),
    ],
)
def test_bad_training_options_leave_nothing(dataset, tmp_path, capsys, options, words):
    where = ["train", dataset.path, "-o", tmp_path / "bundle"]
    status, out, err = call(capsys, *where, *options)
    assert status == 2 and out == "" and words in err
    assert list(tmp_path.iterdir()) == []


def test_force_replaces_only_folders_of_its_own(phantom_videos, tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("keep me")
    for command in (["phantom"], ["prepare", phantom_videos]):
        status, _, err = call(capsys, *command, "-o", tmp_path / "mine", "--force")
        assert status == 2 and "holds other things" in err
    status, _, err = call(capsys, "prepare", phantom_videos, "-o", phantom_videos, "--force")
    assert status == 2 and "would replace the input" in err
    assert (tmp_path / "mine" / "letter.txt").read_text() == "keep me"
    assert list(phantom_videos.rglob("*.mp4"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--drive VIDEO"),
        (["--drive", "missing.mp4"], "give the driving video"),
        (["--drive", "speech.wav"], "no moving picture"),
        (["--drive", "silent.mp4"], "no face found"),
        (["--drive", "silent.mp4", "--mode", "fast"], "--mode fast"),
        (["--drive", "silent.mp4", "--mode", "avd"], "--stage avd"),
        (["--drive", "silent.mp4", "--drive-crop", "1,2"], "--drive-crop 1,2"),
        (["--drive", "silent.mp4", "--greedy"], "not for --drive"),
        (["--drive", "silent.mp4", "--amplitude", "0.5"], "not for --drive"),
        (["speech.wav", "--mode", "relative"], "go with --drive"),
        (["speech.wav", "--track-axes"], "have no axes"),
    ],
)
def test_bad_driving_options_are_one_line(inputs, tmp_path, capsys, options, words):
    options = [inputs / o if o.endswith((".mp4", ".wav")) else o for o in options]
    status, out, err = call(
        capsys, "animate", inputs / "photo.png", *options, "-o", tmp_path / "out.mp4"
    )
    assert status == 2 and out == "" and words in err and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words", "place"),
    [
        (["animate"], "missing argument 'photo'", "angie animate"),
        (["animate", "a.png", "--sped", "3"], "no such option: --sped", "angie animate"),
        (["animate", "a.png", "--seed", "x"], "'--seed'", "angie animate"),
        (["animate", "a.png", "--size"], "'--size' requires an argument", "angie animate"),
        (["animate", "a", "b", "c", "-o", "d"], "unexpected extra argument", "angie animate"),
        (["import-mraa", "a.pth"], "'--output'", "angie import-mraa"),
        (["phantom", "-o", "x", "--minutes", "0"], "'--minutes'", "angie phantom"),
        (["animte"], "no such command 'animte'", "angie"),
        (["--verbose\nly"], "no such option: --verbose", "angie"),
    ],
)
def test_usage_errors_are_one_line(capsys, arguments, words, place):
    status, out, err = call(capsys, *arguments)
    assert status == 2 and out == "" and err.count("\n") == 1 and err.startswith("angie: ")
    assert words.lower() in err.lower() and err.endswith(f" (see {place} --help)\n")


def test_help_is_printed(capsys):
    status, nothing, alone = call(capsys)
    assert status == 2 and nothing == "" and "animate" in alone
    status, out, err = call(capsys, "--help")
    assert status == 0 and err == "" and out.strip() == alone.strip()
    status, out, err = call(capsys, "animate", "--help")
    assert status == 0 and err == "" and "--size" in out


@pytest.mark.parametrize("swallowed", [False, True])
def test_an_interrupt_is_one_line_and_leaves_nothing(tmp_path, capsys, monkeypatch, swallowed):
    def interrupted(*_, **__):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            if not swallowed:
                raise
        raise RecursionError  # as numpy does, loaded in part

    monkeypatch.setattr("data_prep.phantom.make.make_phantom", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's "&" ignores it
    try:
        status, out, err = call(capsys, "phantom", "-o", tmp_path / "raw")
    finally:
        signal.signal(signal.SIGINT, before)
    assert (status, out, err) == (130, "", "angie: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_module_and_version():
    result = subprocess.run(
        [sys.executable, "-m", "angie", "--version"], capture_output=True, text=True, check=True
    )
    assert result.stdout.startswith("angie 0.")


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("train_renderer.betas=[2,3]", "betas must lie"),
        ("train_renderer.initial=/nonexistent", "not the weights"),
        ("renderer.estimator.width=0", "width and blocks must be positive"),
        ("renderer.generator.width=1", "a width of 0"),
        ("gpt.heads=3", "not a multiple"),
        ("vq.decay=2", "decay lies between"),
        ("train_gpt.checks=0", "must be positive"),
        ("train_vq.schedule.rate=nan", "a float is wanted"),
        ("train_vq.schedule.batch=0", "must be positive"),
        ("name=mine", "--preset"),
    ],
)
def test_settings_that_cannot_work_leave_nothing(dataset, tmp_path, capsys, setting, words):
    where = ["train", dataset.path, "-o", tmp_path / "bundle", "--preset", "tiny", setting]
    status, out, err = call(capsys, *where)
    assert status == 2 and out == "" and words in err
    assert list(tmp_path.iterdir()) == []


def test_training_does_not_replace_its_dataset(dataset, capsys):
    status, _, err = call(capsys, "train", dataset.path, "-o", dataset.path.parent, "--force")
    assert status == 2 and "would replace the input" in err
    assert dataset.clips("train")


def test_the_ways_of_a_video_through_the_command(inputs, bundle, tmp_path, capsys):
    animate = ["animate", inputs / "photo.png", inputs / "speech.wav", "--speaker", bundle.folder]
    sheet, video, moved = (tmp_path / name for name in ("sheet.png", "out.gif", "motion.npz"))
    status, out, err = call(capsys, *animate, "-o", sheet, "--preview", "--save-motion", moved)
    assert (status, err) == (0, "") and out.startswith(f"{sheet}: 6 of 25 frames")
    draw = ["animate", inputs / "photo.png", "--speaker", bundle.folder, "--motion", moved]
    status, out, err = call(capsys, *draw, "-o", video, "--consent", "a drawing")
    assert (status, err) == (0, "")
    assert out == f"{video}: 25 frames of 256x256, no sound\n"
    silent = tmp_path / "silent.gif"  # a gif has no sound, though there was a recording
    status, out, _ = call(capsys, *animate, "--motion", moved, "-o", silent)
    assert status == 0 and out == f"{silent}: 25 frames of 256x256, no sound\n"
    status, out, _ = call(capsys, "info", video)
    assert status == 0 and "not a real recording" in out and "a drawing" in out
    check = ["verify", video, "--photo", inputs / "photo.png", "--speaker", bundle.folder]
    status, out, _ = call(capsys, *check, "--motion", moved)
    assert status == 0 and "verified: drawn again, every frame is equal" in out
    status, out, _ = call(capsys, *check, "--motion", inputs / "text.wav")
    assert status == 1 and "NOT verified" in out
    jobs = tmp_path / "jobs.csv"
    jobs.write_text(f"photo,audio,output\n{inputs}/none.png,{inputs}/speech.wav,a.mp4\n")
    status, out, err = call(capsys, "animate", "--jobs", jobs, "--seed", "3")
    assert status == 1 and "0 made, 0 there already, 1 failed" in out and "no such file" in err


def test_completion_is_offered(capsys):
    status, out, _ = call(capsys, "--help")
    assert status == 0 and "--install-completion" in out
