"""Commands killed at random moments, on a full disk, interrupted, and two in one folder.

python scripts/check_kill.py WORK [--kills 100] [--seed 0] [--only prepare,train,...] [--no-disk]

At tiny sizes every command is run once undisturbed. Then it is begun anew again and again, killed
with SIGKILL (all its processes) at a random moment, and repeated until it ends: what it made must
be the same, byte for byte where it is deterministic and number for number in reports. After that:

    a full disk     the output lies on a small tmpfs (or a limit of file sizes stands for it): one
                    line, status 2; with room made, the same result in the end
    read-only       one line, status 2
    Ctrl-C          one line, status 130, and the training goes on to the same result
    two at once     one of them is refused in one line, the other makes the same result

The program is imported once; each command runs in a fork of that process. WORK keeps the phantom,
the dataset and the undisturbed results, which a second call does not make again.
"""

import argparse
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

FEW = (
    "train_renderer.batch=2", "train_renderer.steps=16",
    "train_vq.schedule.most_steps=12", "train_vq.checks=3", "train_gpt.schedule.most_steps=12",
    "train_refiner.schedule.most_steps=12", "train_avd.schedule.most_steps=12",
    "train_avd.with_all=true",
)  # fmt: skip
VARIANTS = "vq,gpt"


@dataclass
class Ended:
    """How a command ended: its status (or minus the signal), and its lines on standard error."""

    status: int
    lines: list[str] = field(default_factory=list)

    @property
    def is_one_line(self) -> bool:
        """Whether it was told as bad input is."""
        return self.status == 2 and sum(line.startswith("angie: ") for line in self.lines) == 1


class Command:
    """A command of the program in a process group of its own, forked from this process."""

    def __init__(self, *words: object, log: Path, limit: int | None = None) -> None:
        self.log = log
        self.begun = time.monotonic()
        self.child = os.fork()
        if self.child == 0:
            self._be(list(map(str, words)), limit)

    def _be(self, words: list[str], limit: int | None) -> None:
        status = 1
        try:
            os.setpgid(0, 0)
            file = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(file, 1)
            os.dup2(file, 2)
            if limit is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            signal.signal(signal.SIGINT, signal.default_int_handler)
            sys.argv = ["angie", *words]
            from angie.cli import main

            _save_often()
            main()
            status = 0
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
        except BaseException:
            import traceback

            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)

    def send(self, number: int) -> None:
        """Signal all its processes; nothing if they have ended."""
        try:
            os.killpg(self.child, number)
        except ProcessLookupError:
            pass

    def running(self) -> bool:
        """Whether it has not ended."""
        done, status = os.waitpid(self.child, os.WNOHANG)
        if done:
            self._status = os.waitstatus_to_exitcode(status)
        return not done

    def wait(self) -> Ended:
        """Wait for its end."""
        if not hasattr(self, "_status"):
            self._status = os.waitstatus_to_exitcode(os.waitpid(self.child, 0)[1])
        text = self.log.read_text(errors="replace")
        return Ended(self._status, [line for line in text.splitlines() if line.strip()])


def _save_often() -> None:
    """Let trainings of seconds have checkpoints on the way."""
    from mraa.training.devices import RunConfig

    plain = RunConfig.__init__

    def often(self: RunConfig, *values: object, **named: object) -> None:
        plain(self, *values, **{"checkpoint_seconds": 0.2, **named})  # type: ignore[arg-type]

    RunConfig.__init__ = often  # type: ignore[method-assign]


def digest(path: Path) -> str:
    """Hash of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def of_bundle(folder: Path) -> dict[str, str]:
    """Hashes of the parts, as the manifest states them and as they are."""
    parts = json.loads((folder / "bundle.json").read_text())["parts"]
    found = {name: digest(folder / entry["file"]) for name, entry in parts.items()}
    assert found == {name: entry["sha256"] for name, entry in parts.items()}
    return found


def of_dataset(folder: Path) -> dict[str, str]:
    """Hashes of every file but what tells of the run itself."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): digest(path) for path in files}


def of_report(folder: Path) -> dict[str, str]:
    """Every score of a report."""
    found = {}
    for path in sorted(folder.rglob("*.json")):
        content = json.loads(path.read_text())
        if isinstance(content, dict) and "rows" in content:
            found[path.name] = json.dumps(content["rows"], sort_keys=True)
    assert found, f"{folder}: no scores"
    return found


def of_file(path: Path) -> dict[str, str]:
    """Hash of a video."""
    return {path.name: digest(path)}


@dataclass(frozen=True)
class Job:
    """A command to disturb.

    Attributes:
        words: of the command line, but for its output.
        output: name of what it makes in a work folder.
        again: words that make it go on after a kill.
        result: what must be the same of the output.
        force: whether an undisturbed run may find an output there.
    """

    words: tuple[object, ...]
    output: str
    again: tuple[str, ...]
    result: Callable[[Path], dict[str, str]]

    def run(self, folder: Path, *more: str, limit: int | None = None) -> Command:
        """Begin it with the output in a folder."""
        target = folder / self.output
        log = folder.parent / f"{folder.name}.log"
        return Command(*self.words, "-o", target, *more, log=log, limit=limit)


def jobs(work: Path) -> dict[str, Job]:
    """Every command that takes long, on what lies in `work`."""
    data, bundle = work / "undisturbed" / "dataset", work / "undisturbed" / "bundle"
    photo, sound = work / "photo.png", work / "sound.wav"
    train = ("train", data, "--preset", "tiny", "--device", "cpu", *FEW)
    scored = ("--fgd-steps", 20, "--image-stride", 50, "--device", "cpu")
    return {
        "prepare": Job(("prepare", work / "raw", "--jobs", 1), "dataset", (), of_dataset),
        "train": Job(train, "bundle", ("--resume",), of_bundle),
        "animate": Job(
            ("animate", photo, sound, "--speaker", bundle, "--device", "cpu"), "a.mp4", (), of_file
        ),
        "evaluate": Job(("evaluate", data, bundle, *scored), "report", (), of_report),
        "ablate": Job(
            ("ablate", data, bundle, "--variants", VARIANTS, "--no-images", *scored[:2]),
            "ablation",
            (),
            of_report,
        ),
    }


def undisturbed(work: Path, wanted: dict[str, Job]) -> dict[str, tuple[dict[str, str], float]]:
    """What each command makes, and the seconds that it takes."""
    results = {}
    folder = work / "undisturbed"
    folder.mkdir(parents=True, exist_ok=True)
    for name, job in wanted.items():
        took = folder / f"{name}.seconds"
        if not took.exists():
            begin = time.monotonic()
            ended = job.run(folder).wait()
            if ended.status:
                sys.exit(f"{name} undisturbed: status {ended.status}: {ended.lines[-5:]}")
            took.write_text(f"{time.monotonic() - begin:.2f}")
        results[name] = (job.result(folder / job.output), float(took.read_text()))
        print(f"{name}: {results[name][1]:.1f} s undisturbed", flush=True)
    return results


def different(found: dict[str, str], truth: dict[str, str]) -> str:
    """Names of what is not the same."""
    names = sorted(found.keys() | truth.keys())
    return ", ".join(name for name in names if found.get(name) != truth.get(name))


def until_done(job: Job, folder: Path) -> Ended:
    """Repeat a command that was disturbed, until it ends by itself."""
    begun = (folder / job.output).exists()
    ended = job.run(folder, *(job.again if begun else ())).wait()
    if ended.status == 2 and "exists already" in "".join(ended.lines):
        return Ended(0)  # it had been done when it was killed
    return ended


def killed(
    job: Job, folder: Path, truth: dict[str, str], seconds: float, rng: np.random.Generator
) -> str:
    """Kill a command at a random moment and repeat it; "" or what is wrong."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    moment = float(rng.uniform(0, seconds))
    command = job.run(folder)
    while time.monotonic() - command.begun < moment and command.running():
        time.sleep(0.005)
    command.send(signal.SIGKILL)
    command.wait()
    ended = until_done(job, folder)
    if ended.status:
        return f"after {moment:.2f} s: status {ended.status}: {ended.lines[-3:]}"
    if other := different(job.result(folder / job.output), truth):
        return f"after {moment:.2f} s: another result ({other})"
    left = [path.name for path in folder.iterdir() if path.name != job.output]
    return f"after {moment:.2f} s: left behind {left}" if left else ""


@contextmanager
def small_disk(folder: Path, megabytes: float) -> Iterator[bool]:
    """A folder on a tmpfs of that size; False where nothing can be mounted."""
    folder.mkdir(parents=True, exist_ok=True)
    size = f"size={round(megabytes * 1024)}k"
    mounted = not subprocess.run(
        ["mount", "-t", "tmpfs", "-o", size, "none", str(folder)], capture_output=True
    ).returncode
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


def size_of(path: Path) -> float:
    """Megabytes of a file or folder."""
    files = [path] if path.is_file() else [one for one in path.rglob("*") if one.is_file()]
    return sum(one.stat().st_size for one in files) / 2**20


def full(name: str, job: Job, work: Path, truth: dict[str, str], share: float) -> str:
    """Run a command where only a part of its result has room, then make room and repeat it."""
    needed = size_of(work / "undisturbed" / job.output)
    folder = work / "full"
    with small_disk(folder, max(share * needed, 0.008)) as mounted:
        if not mounted:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
        limit = None if mounted else round(share * needed * 2**20 / 4)
        ended = job.run(folder, limit=limit).wait()
        if not ended.is_one_line:
            return f"full disk at {share:.0%}: status {ended.status}: {ended.lines[-4:]}"
        if mounted:
            subprocess.run(["mount", "-o", "remount,size=2g", str(folder)], check=True)
        again = until_done(job, folder)
        if again.status:
            return f"full disk at {share:.0%}, then room: {again.status}: {again.lines[-4:]}"
        if job.result(folder / job.output) != truth:
            return f"full disk at {share:.0%}: another result"
    return ""


def read_only(name: str, job: Job, work: Path) -> str:
    """Run a command where nothing can be written."""
    folder = work / "read_only"
    with small_disk(folder, 1) as mounted:
        if not mounted:
            return ""
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        ended = job.run(folder).wait()
        subprocess.run(["mount", "-o", "remount,rw", str(folder)], check=True)
        left = list(folder.iterdir())
    if not ended.is_one_line or left:
        return f"read-only: status {ended.status}: {ended.lines[-4:]} {left}"
    return ""


def interrupted(
    job: Job, folder: Path, truth: dict[str, str], seconds: float, rng: np.random.Generator
) -> str:
    """Ctrl-C at a random moment of the second half, then repeat."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command = job.run(folder)
    moment = float(rng.uniform(0.3, 0.9)) * seconds
    while time.monotonic() - command.begun < moment and command.running():
        time.sleep(0.005)
    command.send(signal.SIGINT)
    ended = command.wait()
    quiet = ended.status == 130 and ended.lines[-1:] == ["angie: interrupted"]
    if ended.status != 0 and not quiet:
        return f"Ctrl-C after {moment:.2f} s: status {ended.status}: {ended.lines[-4:]}"
    again = until_done(job, folder)
    if again.status or job.result(folder / job.output) != truth:
        return f"Ctrl-C after {moment:.2f} s: another result, {again.lines[-3:]}"
    return ""


def two_at_once(job: Job, folder: Path, truth: dict[str, str]) -> str:
    """The same command twice in one folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    first = job.run(folder)
    log = folder.parent / f"{folder.name}.second.log"
    second = Command(*job.words, "-o", folder / job.output, log=log)
    ends = [first.wait(), second.wait()]
    refused = [end for end in ends if end.status]
    if any(not end.is_one_line for end in refused) or len(refused) == 2:
        return f"two at once: {[(end.status, end.lines[-3:]) for end in ends]}"
    if job.result(folder / job.output) != truth:
        return "two at once: another result"
    return ""


def prepare_work(work: Path) -> None:
    """The phantom, a photo and a recording."""
    if (work / "sound.wav").exists():
        return
    from PIL import Image

    from data_prep.media.audio import read_sound, write_wav
    from data_prep.media.video import read_frames
    from data_prep.phantom.make import make_phantom

    (work / "raw").mkdir(parents=True, exist_ok=True)
    videos = make_phantom(work / "raw", minutes=0.4, seed=0, presenters=2, jobs=1)
    Image.fromarray(next(read_frames(videos[0]))).save(work / "photo.png")
    write_wav(work / "sound.wav", read_sound(videos[0])[: 2 * 16000])


def main() -> None:
    """Disturb every command, and print what went wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("work", type=Path)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="prepare,train,animate,evaluate,ablate")
    parser.add_argument("--no-disk", action="store_true", help="kills only")
    options = parser.parse_args()
    work = options.work.resolve()
    prepare_work(work)
    wanted = {name: job for name, job in jobs(work).items() if name in options.only.split(",")}
    results = undisturbed(work, wanted)
    rng = np.random.default_rng(options.seed)
    counts: Counter[str] = Counter()
    faults = 0

    def tell(name: str, fault: str) -> None:
        nonlocal faults
        counts[name] += 1
        faults += bool(fault)
        if fault:
            print(f"{name}: {fault}", flush=True)

    spent = np.array([seconds for _, seconds in results.values()])
    for _ in range(options.kills):  # as many of each as it takes time
        name = str(rng.choice(list(results), p=spent / spent.sum()))
        truth, seconds = results[name]
        tell(f"{name} killed", killed(wanted[name], work / "killed", truth, seconds, rng))
    if not options.no_disk:
        for name, (truth, seconds) in results.items():
            job = wanted[name]
            for share in (0.2, 0.7):
                tell(f"{name} on a full disk", full(name, job, work, truth, share))
            tell(f"{name} read-only", read_only(name, job, work))
            tell(f"{name} Ctrl-C", interrupted(job, work / "ctrl", truth, seconds, rng))
            tell(f"{name} twice", two_at_once(job, work / "twice", truth))
    for name, count in counts.items():
        print(f"{count:4} {name}")
    print(f"{sum(counts.values())} disturbances, {faults} faults")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
