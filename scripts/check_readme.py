"""Run the commands of every README in a copy of the checkout.

    python scripts/check_readme.py WORK [--limit 120] [--only TEXT]

Commands are the lines of code blocks and the first cells of tables that begin with `angie`,
`python` or `bash`, in the order of the READMEs. They run in WORK, a copy of this checkout, with
names in capitals replaced by what earlier commands made. Those that take hours (`LONG`) are stopped
after LIMIT seconds; by then they must not have failed, and must have begun to write their output.
Prints a line for each command and keeps its output in WORK/logs; exit status 1 if one fails.
"""

import argparse
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

READMES = (
    "README.md",
    "data_prep/README.md",
    "data_prep/phantom/README.md",
    "mraa/README.md",
    "angie/README.md",
    "angie/evaluation/README.md",
    "scripts/README.md",
)
"""In this order: the first makes the dataset and the bundle that the others need."""

ELSEWHERE = {
    "pip install": "scripts/test.sh installs the package",
    "bash scripts/demo.sh": "makes an environment of several GB",
    "bash scripts/test.sh": "is what CI runs",
    "python scripts/check_readme.py": "is this script",
    "angie app": "tests/angie/app/test_page.py, in a browser",
    "angie serve": "tests/angie/app/test_service.py, over HTTP",
    "angie animate --jobs": "tests/angie/test_batch.py, which makes a list",
    "angie verify": "tests/angie/test_verify.py; here the video has other inputs",
    "angie import-mraa": "tests/angie/test_released.py, which makes a checkpoint",
    "angie study": "tests/angie/evaluation/test_study.py, which makes a report and answers",
    "angie prepare --pats": "tests/data_prep/prepare/test_pats.py, which makes a table",
    "bash scripts/train_on_gpu.sh": "needs a GPU",
    "python scripts/train_on_gpu.py": "needs packed frames; on a GPU by train_on_gpu.sh",
    "python scripts/pack_frames.py": "needs videos of people before a blue screen",
    "python scripts/draw_backgrounds.py": "needs scikit-image's sample photos",
    "python scripts/pack_weights.py": "needs the wheel of EfficientNet-Lite0",
    "python scripts/check_pictures.py": "needs folders as pack_frames.py takes them",
    "python scripts/replace_renderer.py": "needs what train_on_gpu.py wrote",
}
"""Commands that do not run here, and what does run them."""

LONG = (
    "angie train DATASET",
    "angie train data -o model",
    "angie phantom -o DIR --minutes 20",
    "angie ablate",
    "python scripts/bench_",
    "python scripts/check_angie.py",
    "python scripts/check_kill.py",
    "python scripts/check_numbers.py",
    "python scripts/check_codebook.py",
    "python scripts/mutate.py",
    "python scripts/check_real.py",
    "python scripts/check_sync.py",
    "python scripts/fuzz.py",
    "python scripts/compare_renderers.py",
    "angie teach",
    "bash scripts/prove_motion.sh",
    "bash scripts/train_default.sh",
)
"""Commands that may take hours, or minutes and nothing depends on: begun, then stopped."""

NAMES = {
    "PHOTO": "photo.jpg", "AUDIO": "speech.wav", "VIDEO": "talk.mp4", "VIDEO_OR_FOLDER": "raw",
    "RAW": "raw", "DATASET": "dataset", "BUNDLE": "bundle", "FOLDER": "folder",
    "GIVEN.safetensors": "bundle/renderer.safetensors", "OLD": ".", "NEW": ".",
}  # fmt: skip
"""What stands for a name in capitals that a command reads; one that it writes gets a new name."""

FAST = ("train_vq.schedule.most_steps=30", "train_gpt.schedule.most_steps=30",
        "train_refiner.schedule.most_steps=30")  # fmt: skip


def commands(text: str) -> list[str]:
    """The commands of a README: lines of code blocks, first cells of tables."""
    block = re.compile(r"^```(?:bash)?\n(.*?)^```", re.MULTILINE | re.DOTALL)
    lines = [line for part in block.findall(text) for line in part.splitlines()]
    lines += re.findall(r"^\| `([^`]+)` \|", text, re.MULTILINE)
    return [line for line in lines if re.match(r"(angie|bash|python|pip) ", line)]


def plain(command: str) -> list[str]:
    """The words of a command without what is optional (in brackets) and without dots."""
    return shlex.split(re.sub(r"\[[^\]]*\]", "", command).replace("...", ""))


def filled(command: str, number: int) -> tuple[list[str], list[str]]:
    """The words of a command with names that exist, and those of its new outputs."""
    words, outputs = [], []
    for before, word in zip(["", *plain(command)], plain(command), strict=False):
        writes = before == "-o" or word == "WORK" or word.startswith("OUT")
        if writes and (word.isupper() or word.split(".")[0].isupper() or is_long(command)):
            word = f"made-{number}{Path(word).suffix}"
        if writes:
            outputs.append(word)
        words.append(NAMES.get(word, word))
    return words, outputs


def is_long(command: str) -> bool:
    """Whether a command is begun only."""
    return command.startswith(LONG)


def run(words: list[str], work: Path, log: Path, limit: float | None) -> tuple[str, float]:
    """Run words of a command: "ran", "begun" (stopped at the limit) or "failed", and seconds."""
    environment = dict(os.environ, PYTHONPATH=str(work))
    environment["PATH"] = f"{work / 'logs' / 'bin'}{os.pathsep}{environment['PATH']}"
    start = time.monotonic()
    with log.open("w") as output:
        process = subprocess.Popen(
            words, cwd=work, env=environment, stdout=output, stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        try:
            status = process.wait(limit)
            result = "failed" if status else "ran"
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGINT)
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            result = "begun"
    return result, time.monotonic() - start


def copy_checkout(work: Path) -> None:
    """Copy the checkout to a new folder, with an `angie` command that runs the copy."""
    leave = shutil.ignore_patterns(".git", ".venv*", "__pycache__", ".*_cache", "*.egg-info")
    shutil.copytree(ROOT, work, ignore=leave)
    folder = work / "logs" / "bin"
    folder.mkdir(parents=True)
    for name, arguments in (("angie", "-m angie"), ("python", "")):
        path = folder / name
        path.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {arguments} "$@"\n')
        path.chmod(0o755)


def give_photo_and_speech(work: Path) -> None:
    """Write photo.jpg and speech.wav, four seconds of the recording that ships."""
    import imageio.v3 as imageio
    import soundfile

    imageio.imwrite(work / "photo.jpg", imageio.imread(work / "angie/default/photo.png"))
    samples, rate = soundfile.read(work / "angie/default/speech.flac", stop=4 * 16_000)
    soundfile.write(work / "speech.wav", samples, rate)


def give_others(work: Path) -> None:
    """From what the first README made: a driving video, videos to score, a model of joints."""
    import numpy as np
    import soundfile

    from data_prep.media.audio import read_sound
    from data_prep.rates import SAMPLE_RATE

    talks = sorted((work / "raw").rglob("*.mp4"))
    shutil.copy(talks[0], work / "talk.mp4")
    shutil.copytree(work / "bundle", work / "other-bundle")
    shutil.copytree(work / "dataset" / "video", work / "folder")
    for folder in ("data/motion", "data/audio", "arrays"):
        (work / folder).mkdir(parents=True)
    rows = ["clip,speaker,split,fps"]
    for place, talk in enumerate(talks):
        name = "clip" if place == 0 else talk.stem
        with np.load(talk.with_suffix(".truth.npz")) as truth:
            np.save(work / "data" / "motion" / f"{name}.npy", truth["joints"])
        soundfile.write(work / "data" / "audio" / f"{name}.wav", read_sound(talk), SAMPLE_RATE)
        split = "test" if place == 0 else "train"
        rows.append(f"{name},{talk.parent.name},{split},25")
    (work / "data" / "clips.csv").write_text("\n".join(rows) + "\n")
    shutil.copy(work / "data" / "motion" / "clip.npy", work / "arrays")
    train = ["angie", "train", "data", "-o", "model", "--preset", "tiny", *FAST]
    result, _ = run(train, work, work / "logs" / "model.txt", None)
    if result == "failed":
        sys.exit(f"check_readme.py: no model of joints, see {work / 'logs' / 'model.txt'}")


def main() -> None:
    """Run all commands."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, help="new folder for the copy")
    parser.add_argument("--limit", type=float, default=120, help="seconds for those of hours")
    parser.add_argument("--only", default="", help="run only commands with this text")
    given = parser.parse_args()
    sys.path.insert(0, str(ROOT))  # the checkout's packages, whether they are installed or not
    work = given.work.resolve()
    if work.exists() and not given.only:
        parser.error(f"{work} is there already; name a new folder")
    if not work.exists():
        copy_checkout(work)
        give_photo_and_speech(work)
    failed = number = 0
    done: set[str] = set()
    for readme in READMES:
        for command in commands((ROOT / readme).read_text(encoding="utf-8")):
            if command in done or given.only not in command:
                continue
            done.add(command)
            number += 1
            why = [text for start, text in ELSEWHERE.items() if command.startswith(start)]
            if why:
                print(f"{'elsewhere':10}{'':8}{readme}: {command}   ({why[0]})", flush=True)
                continue
            if (work / "bundle" / "bundle.json").exists() and not (work / "talk.mp4").exists():
                give_others(work)
            words, outputs = filled(command, number)
            log = work / "logs" / f"{number:03}.txt"
            words += ["--force"] if (work / "".join(outputs[:1])).is_file() else []
            result, seconds = run(words, work, log, given.limit if is_long(command) else None)
            if result == "begun" and outputs and not any((work / o).exists() for o in outputs):
                parts = [path for o in outputs for path in work.glob(f".{o}*")]
                result = result if parts else "failed"
            failed += result == "failed"
            print(f"{result:10}{seconds:6.0f} s {readme}: {command}", flush=True)
            if result == "failed":
                print(f"          see {log}", flush=True)
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
