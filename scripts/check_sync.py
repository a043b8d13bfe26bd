"""Whether the sound of a video is the recording, and its pictures the frames that cover it.

python scripts/check_sync.py [--count 200] [--longest 180] [--minutes 0] [--seed 0] [--keep DIR]

Random recordings of every container, rate and number of channels, some with odd headers, late
first timestamps or gaps, go through the reader and the writer with cheap frames: a frame is white
where the samples that the networks would hear have a click. The video is then read as a player
shows it, by its timestamps, with edit lists and priming honoured:

lag     samples of the video's rate by which its sound lies behind the recording: 0 or 1
frames  pictures less those that cover the sound: 0
first   seconds between click and white frame near the beginning, last near the end: under 0.04

`--minutes 45` measures the memory of one recording of that length as well.
"""

import argparse
import resource
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import dataclass
from fractions import Fraction
from multiprocessing import get_context
from pathlib import Path

import av
import numpy as np
import soundfile
import soxr

from data_prep.media.audio import read_sound
from data_prep.media.writer import VideoWriter
from data_prep.rates import FPS, SAMPLES_PER_FRAME, frames_covering

OPUS = (8000, 12000, 16000, 24000, 48000)
MP3 = (8000, 11025, 12000, 16000, 22050, 24000, 32000, 44100, 48000)
AAC = (*MP3, 64000, 88200, 96000)
ANY = (*MP3, 96000, 192000)
LAYOUTS = {1: "mono", 2: "stereo", 3: "3.0", 4: "quad", 5: "5.0", 6: "5.1", 8: "7.1"}

KINDS: dict[str, tuple[str, tuple[int, ...], tuple[int, ...], bool]] = {
    "wav": ("pcm_s16le", ANY, tuple(LAYOUTS), False),
    "wav24": ("pcm_s24le", ANY, (1, 2), False),
    "wavf": ("pcm_f32le", ANY, (1, 2, 6), False),
    "flac": ("flac", ANY, tuple(LAYOUTS), False),
    "mp3": ("libmp3lame", MP3, (1, 2), False),
    "m4a": ("aac", AAC, (1, 2, 3, 5, 6), True),
    "ogg": ("vorbis", (8000, 16000, 22050, 44100, 48000), (1, 2, 6), False),
    "opus": ("libopus", OPUS, (1, 2, 6), False),
    "webm": ("libopus", OPUS, (1, 2), True),
}
"""Codec, rates, numbers of channels, and whether the container keeps timestamps."""


@dataclass(frozen=True)
class Case:
    """A recording to be made."""

    kind: str
    rate: int
    channels: int
    seconds: float
    oddity: str
    seed: int

    def __str__(self) -> str:
        what = f"{self.kind:5} {self.rate:6} Hz {self.channels} ch {self.seconds:6.2f} s"
        return f"{what} {self.oddity}".rstrip()


def random_case(rng: np.random.Generator, number: int, longest: float) -> Case:
    """One of the kinds in turn, with everything else by chance; lengths evenly over magnitudes."""
    kind = list(KINDS)[number % len(KINDS)]
    _, rates, channels, timed = KINDS[kind]
    oddities = ["", ""]
    oddities += ["late", "gap"] if timed else []
    oddities += ["length 0x7FFFFFFF", "length 0", "length + 44"] if kind.startswith("wav") else []
    oddities += ["tag behind", "zeros behind"] if kind == "mp3" else []
    seconds = float(np.exp(rng.uniform(np.log(0.2), np.log(longest))))
    return Case(
        kind,
        int(rng.choice(rates)),
        int(rng.choice(channels)),
        seconds,
        str(rng.choice(oddities)),
        number,
    )


def signal(case: Case) -> np.ndarray:
    """Quiet noise below 1.5 kHz with a loud burst near each end, (N,) at the case's rate."""
    rng = np.random.default_rng(case.seed)
    count = max(round(case.seconds * case.rate), 64)
    slow = rng.standard_normal(int(count * 3000 / case.rate) + 8)
    noise = np.interp(np.arange(count) * 3000 / case.rate, np.arange(len(slow)), slow)
    sound = 0.05 * noise
    length = max(round(0.01 * case.rate), 4)
    for place in clicks(count, case.rate):
        wave = np.sin(2 * np.pi * 900 * np.arange(length) / case.rate)
        sound[place : place + length] = 0.9 * wave[: count - place]
    return sound.astype(np.float32)


def clicks(count: int, rate: int) -> list[int]:
    """Samples at which the bursts begin."""
    return [round(0.05 * rate), count - round(0.1 * rate)]


GAP = 0.5
"""Seconds of silence that a gap of the timestamps stands for; it lies in the middle."""


def encode(path: Path, case: Case, sound: np.ndarray) -> None:
    """Write the recording; every channel holds the same."""
    codec, *_ = KINDS[case.kind]
    if codec == "vorbis":  # FFmpeg's own encoder is experimental
        several = np.repeat(sound[:, None], case.channels, axis=1)
        soundfile.write(path, several, case.rate, format="OGG", subtype="VORBIS")
        return
    start = 1.3 if case.oddity == "late" else 0.0
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=case.rate, layout=LAYOUTS[case.channels])
        if codec in ("libmp3lame", "libopus", "aac"):
            stream.codec_context.bit_rate = 64_000 * case.channels
        resampler = av.AudioResampler(stream.format.name, LAYOUTS[case.channels], case.rate)
        size = stream.codec_context.frame_size or 1024
        middle = len(sound) // 2 // size * size
        for first in range(0, len(sound), size):
            part = np.repeat(sound[first : first + size], case.channels)[None]  # packed
            frame = av.AudioFrame.from_ndarray(part, "flt", LAYOUTS[case.channels])
            late = GAP if case.oddity == "gap" and first >= middle else 0.0
            frame.sample_rate, frame.time_base = case.rate, Fraction(1, case.rate)
            frame.pts = first + round((start + late) * case.rate)
            for one in resampler.resample(frame):
                one.pts, one.time_base = frame.pts, frame.time_base
                container.mux(stream.encode(one))
        container.mux(stream.encode(None))


def make(case: Case, folder: Path) -> tuple[Path, np.ndarray]:
    """The recording, and what a player plays of it, (N,) at the case's rate from its start."""
    ending = "wav" if case.kind.startswith("wav") else case.kind
    path, sound = folder / f"{case.seed:03d}.{ending}", signal(case)
    encode(path, case, sound)
    data = bytearray(path.read_bytes())
    if case.oddity.startswith("length"):
        place = data.index(b"data") + 4
        size = int.from_bytes(data[place : place + 4], "little")
        new = {"length 0": 0, "length + 44": size + 44}.get(case.oddity, 0x7FFFFFFF)
        data[place : place + 4] = new.to_bytes(4, "little")
    elif case.oddity == "tag behind":
        data += b"TAG" + bytes(125)
    elif case.oddity == "zeros behind":
        data += bytes(3000)
    path.write_bytes(data)
    if case.oddity == "late" and case.kind == "m4a":
        sound = np.pad(sound, (1024, 0))  # no edit list leaves out the priming then
    if case.oddity == "gap":
        size = 1024 if case.kind == "m4a" else case.rate // 50
        middle = len(sound) // 2 // size * size
        sound = np.insert(sound, middle, np.zeros(round(GAP * case.rate), np.float32))
    return path, sound


def through(recording: Path, video: Path) -> int:
    """Make the video as `angie animate` does, with cheap frames; the number of them."""
    samples = read_sound(recording)
    frames = frames_covering(len(samples))
    padded = np.pad(np.abs(samples), (0, frames * SAMPLES_PER_FRAME - len(samples)))
    loud = padded.reshape(frames, SAMPLES_PER_FRAME).max(axis=1) > 0.6 * padded.max()
    black, white = (np.full((16, 16, 3), level, np.uint8) for level in (0, 255))
    with VideoWriter(video, (16, 16), FPS, sound=recording) as writer:
        for is_loud in loud:
            writer.write(white if is_loud else black)
    return frames


def shown(video: Path) -> tuple[np.ndarray, int, np.ndarray]:
    """Sound (N,) as a player places it, its rate, and the brightness of each frame by its time."""
    with av.open(str(video)) as container:
        stream = container.streams.audio[0]
        rate = stream.rate
        parts = [
            (frame.time, frame.to_ndarray().mean(axis=0)) for frame in container.decode(stream)
        ]
    end = max(round(time * rate) + len(part) for time, part in parts)
    sound = np.zeros(end, np.float32)
    for when, part in parts:
        first = round(when * rate)
        sound[max(first, 0) : first + len(part)] = part[max(-first, 0) :]
    with av.open(str(video)) as container:
        pictures = [(frame.time, frame.to_ndarray().mean()) for frame in container.decode(video=0)]
    light = np.zeros(max(round(when * FPS) for when, _ in pictures) + 1)
    for when, level in pictures:
        light[round(when * FPS)] = level
    assert len(light) == len(pictures)
    return sound, rate, light


def lag(truth: np.ndarray, found: np.ndarray) -> int:
    """Samples by which `found` lies behind."""
    size = 1 << (len(truth) + len(found)).bit_length()
    cross = np.fft.irfft(np.fft.rfft(found, size) * np.conj(np.fft.rfft(truth, size)), size)
    peak = int(cross.argmax())
    return peak - size if peak > size // 2 else peak


@dataclass(frozen=True)
class Result:
    """What was measured of a case; see the beginning of this file."""

    lag: int
    frames: int
    first: float
    last: float
    length: float

    @property
    def good(self) -> bool:
        """Whether it is as it should be."""
        apart = max(self.first, self.last)
        return abs(self.lag) <= 1 and self.frames == 0 and apart <= 1 / FPS + 1e-3


def measure(case: Case, folder: Path) -> Result:
    """Make the recording and the video, and compare them."""
    recording, truth = make(case, folder)
    video = folder / f"{case.seed:03d}.mp4"
    through(recording, video)
    sound, rate, light = shown(video)
    expected = soxr.resample(truth, case.rate, rate)
    heard = len(read_sound(recording)) / 16_000
    wanted = frames_covering(round(heard * 16_000))
    apart = [seconds_apart(expected, sound, rate, light, end) for end in (False, True)]
    for path in (recording, video):
        path.unlink()
    # Behind a gap the time is that of the container, which counts milliseconds.
    stop = int(len(expected) * 0.3) if case.oddity == "gap" else None
    return Result(
        lag(expected[:stop], sound[:stop]),
        len(light) - wanted,
        *apart,
        heard - len(truth) / case.rate,
    )


def seconds_apart(
    truth: np.ndarray, sound: np.ndarray, rate: int, light: np.ndarray, end: bool
) -> float:
    """Between the click near an end and the white frames there; 0 where they overlap."""
    half = len(truth) // 2
    part = slice(half, None) if end else slice(0, half)
    place = int(np.abs(sound[part]).argmax()) + (half if end else 0)
    when = place / rate
    white = np.flatnonzero(light > 128) / FPS
    near = white[np.abs(white - when).argmin()] if len(white) else np.inf
    return float(max(near - when, when - (near + 1 / FPS), 0.0))


def long_recording(minutes: float) -> None:
    """Peak memory in MB of a recording of so many minutes, printed."""
    with tempfile.TemporaryDirectory() as folder:
        case = Case("wav", 44100, 2, minutes * 60, "", 0)
        path = Path(folder) / "long.wav"
        write_long(path, case)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        frames = round(minutes * 60 * FPS)
        black = np.zeros((16, 16, 3), np.uint8)
        begin = time.perf_counter()
        with VideoWriter(Path(folder) / "long.mp4", (16, 16), FPS, sound=path) as writer:
            for _ in range(frames):
                writer.write(black)
        spent = time.perf_counter() - begin
        written = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        samples = read_sound(path)
        read = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        assert frames_covering(len(samples)) == frames
        mb = [round(kb / 1024) for kb in (before, written, read)]
        print(
            f"{minutes:5.1f} minutes: {mb[0]} MB before, {mb[1]} MB after writing ({spent:.0f} s), "
            f"{mb[2]} MB after reading {samples.nbytes / 2**20:.0f} MB of samples",
            flush=True,
        )


def write_long(path: Path, case: Case) -> None:
    """A recording written second by second."""
    rng = np.random.default_rng(0)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=case.rate, layout="stereo")
        for second in range(round(case.seconds)):
            part = rng.integers(-3000, 3000, (1, 2 * case.rate), np.int16)
            frame = av.AudioFrame.from_ndarray(part, "s16", "stereo")
            frame.sample_rate, frame.pts = case.rate, second * case.rate
            container.mux(stream.encode(frame))


def main() -> None:
    """Print a line for each case that is not as it should be, and what was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--longest", type=float, default=180.0, help="seconds")
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(options.seed)
    cases = [random_case(rng, number, options.longest) for number in range(options.count)]
    lags: Counter[int] = Counter()
    worst, good = 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        for case in cases:
            result = measure(case, Path(folder))
            lags[result.lag] += 1
            worst = max(worst, result.first, result.last)
            good += result.good
            if not result.good:
                print(f"{case}: {result}", flush=True)
    told = ", ".join(f"{lag}: {count}" for lag, count in sorted(lags.items()))
    print(f"{good} of {len(cases)} recordings as they should be; samples of lag {told}")
    print(f"click and white frame at most {1000 * worst:.0f} ms apart")
    for minutes in (5.0, options.minutes) if options.minutes else ():
        process = get_context("spawn").Process(target=long_recording, args=(minutes,))
        process.start()
        process.join()
    sys.exit(good < len(cases))


if __name__ == "__main__":
    main()
