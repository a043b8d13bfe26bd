"""Spoilt files for every reader of the program: each must be told in one line, at little cost.

python scripts/fuzz.py [--cases 5000] [--seed 0] [--only NAME] [--light]

A small whole file is made of every kind (photo, sound, video, transcript, dataset, bundle,
settings, motion, checkpoints, joints, tables), spoilt by chance (truncated, bits flipped, numbers
that claim much, wrong types, NaN, `..` in names, links, pipes, payloads), and read in a child
process that may take 1 GiB more memory than it has and 10 s a case. A case fails by

    a traceback     anything but BadInput or an error of the system (the command tells both)
    a crash         the child died
    a hang          longer than 10 s
    noise           a library wrote to standard output or error
    a trace         a payload ran, or a file appeared

What a spoilt file still plays is fine. Exit status 1 if a case failed.
"""

import argparse
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fuzzing.mutations import MARK, spoil
from fuzzing.targets import LIGHT, Target, heavy

from data_prep.errors import BadInput

SECONDS = 10
"""A case may take."""

MEMORY = 1 << 30
"""Bytes that the child may take beyond what it has when it starts."""


@dataclass(frozen=True)
class Outcome:
    """What became of a case: "used", "refused", or a fault, with what to look at."""

    case: int
    kind: str
    text: str = ""

    @property
    def fault(self) -> bool:
        """Whether it must be mended."""
        return self.kind not in ("used", "refused")


class Fuzzer:
    """Runs cases in children; each case follows from the seed and its number."""

    def __init__(self, targets: dict[str, Target], folder: Path, seed: int) -> None:
        self.targets, self.folder, self.seed = targets, folder, seed
        self.names = list(targets)
        self.whole = {name: folder / "whole" / str(k) for k, name in enumerate(self.names)}
        self.files: dict[str, list[Path]] = {}
        for name, place in self.whole.items():
            place.mkdir(parents=True)
            self.files[name] = targets[name].make(place)
            targets[name].read(place)  # what is whole must be read

    def name_of(self, case: int) -> str:
        """The kind of input of a case."""
        return self.names[case % len(self.names)]

    def run(self, cases: range) -> Iterator[Outcome]:
        """Outcomes in order."""
        left = cases
        while left:
            done = 0
            for outcome in self._child(left):
                done += 1
                yield outcome
            left = left[done:]

    def _child(self, cases: range) -> Iterator[Outcome]:
        """Outcomes until the child has done all, or died of the last."""
        out, into = os.pipe()
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            os.close(out)
            try:
                self._work(cases, into)
            except BaseException:
                (self.folder / "bug").write_text(traceback.format_exc())
            finally:
                os._exit(3)  # never on as if it were the parent
        os.close(into)
        left, number = b"", cases.start
        with open(out, "rb", buffering=0) as pipe:
            while number < cases.stop:
                ready, _, _ = select.select([pipe], [], [], 2 * SECONDS)
                part = pipe.read(65536) if ready else b""
                if not part:
                    os.kill(child, signal.SIGKILL)
                    _, status = os.waitpid(child, 0)
                    kind = "crash" if ready else "hang"
                    text = f"{self.name_of(number)}: signal {status & 127}, status {status >> 8}"
                    if (self.folder / "bug").exists():
                        text += (self.folder / "bug").read_text()[-1500:]
                    yield Outcome(number, kind, text)
                    return
                *lines, left = (left + part).split(b"\n")
                for line in lines:
                    kind, _, text = line.decode(errors="replace").partition("\t")
                    yield Outcome(number, kind, text.replace("\x1f", "\n"))
                    number += 1
        os.waitpid(child, 0)

    def _work(self, cases: range, into: int) -> None:
        """In the child: every case, a line for each."""
        now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, now + MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGALRM, _late)
        noise = os.open(self.folder / "noise", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
        os.dup2(noise, 1)
        os.dup2(noise, 2)
        for case in cases:
            outcome = self._case(case, noise)
            text = outcome.text.replace("\n", "\x1f").replace("\t", " ")
            os.write(into, f"{outcome.kind}\t{text}\n".encode(errors="replace"))
        os._exit(0)

    def _case(self, case: int, noise: int) -> Outcome:
        name = self.name_of(case)
        place = self.folder / "case"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(self.whole[name], place)
        rng = np.random.default_rng([self.seed, case])
        files = self.files[name]
        file = place / files[int(rng.integers(len(files)))].relative_to(self.whole[name])
        how = spoil(file, rng)
        before = {path.relative_to(place) for path in place.rglob("*")}
        os.ftruncate(noise, 0)
        os.lseek(noise, 0, os.SEEK_SET)
        kind, text = self._read(name, place)
        sys.stdout.flush()
        sys.stderr.flush()
        said = os.pread(noise, 2000, 0).decode(errors="replace").strip()
        if said and kind in ("used", "refused"):
            kind, text = "noise", said
        after = {path.relative_to(place) for path in place.rglob("*")} - before
        odd = [path for path in after if path.parts[0] not in ("cache", "features")]
        if odd or (Path.cwd() / MARK).exists() or (place / MARK).exists():
            kind, text = "a trace", ", ".join(map(str, odd)) or MARK
        return Outcome(case, kind, f"{name}, {file.name}, {how}: {text}")

    def _read(self, name: str, place: Path) -> tuple[str, str]:
        signal.alarm(SECONDS)
        begin = time.monotonic()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.targets[name].read(place)
            return "used", ""
        except BadInput as error:
            one_line = "\n" not in str(error)
            return ("refused" if one_line else "several lines"), str(error)
        except OSError as error:
            return "refused", str(error)
        except _Late:
            return "hang", f"{time.monotonic() - begin:.0f} s"
        except Exception:
            return "traceback", traceback.format_exc()[-1500:]
        finally:
            signal.alarm(0)


def _late(*_: object) -> None:
    raise _Late


class _Late(BaseException):
    """A case that took too long."""


def main() -> None:
    """Print the faults, and how many cases became what."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=5000)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="kinds whose name holds this")
    parser.add_argument("--light", action="store_true", help="only those without networks")
    options = parser.parse_args()
    targets = {**LIGHT, **({} if options.light else heavy())}
    targets = {name: one for name, one in targets.items() if options.only in name}
    counts: Counter[str] = Counter()
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        fuzzer = Fuzzer(targets, Path(folder), options.seed)
        for outcome in fuzzer.run(range(options.first, options.first + options.cases)):
            counts[outcome.kind] += 1
            if outcome.fault:
                print(f"case {outcome.case}: {outcome.kind}: {outcome.text}", flush=True)
    told = ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
    spent = time.monotonic() - begin
    print(f"{options.cases} cases of {len(targets)} kinds in {spent:.0f} s: {told}")
    sys.exit(any(kind not in ("used", "refused") for kind in counts))


if __name__ == "__main__":
    main()
