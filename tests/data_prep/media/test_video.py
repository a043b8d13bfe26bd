"""Videos: read at a constant rate, sound and picture in step."""

import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from data_prep.errors import BadInput
from data_prep.media.audio import read_sound, write_wav
from data_prep.media.video import VideoWriter, probe, read_frames, read_grey

GREY = np.full((64, 64, 3), 128, np.uint8)


def write_at_rate(path: Path, levels: list[int], rate: Fraction, first_pts: int = 0) -> None:
    """A video at any rate, frame i a flat grey of `levels[i]`."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate, options={"crf": "1"})
        stream.width = stream.height = 64
        stream.pix_fmt = "yuv420p"
        for i, level in enumerate(levels):
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), level, np.uint8), "rgb24")
            frame.pts, frame.time_base = i + first_pts, 1 / rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


@pytest.mark.parametrize(
    ("tags", "height", "matrix", "full"),
    [
        ({"colorspace": "bt709", "color_range": "pc"}, 64, (0.2126, 0.7152, 0.0722), True),
        ({"colorspace": "smpte170m", "color_range": "tv"}, 64, (0.299, 0.587, 0.114), False),
        ({}, 64, (0.299, 0.587, 0.114), False),
        ({}, 720, (0.2126, 0.7152, 0.0722), False),
    ],
)
def test_colours_follow_the_tags(
    tmp_path: Path, tags: dict[str, str], height: int, matrix: tuple[float, ...], full: bool
) -> None:
    red, _, blue = matrix
    colour = np.array([200, 90, 40])
    luma = float(np.dot(matrix, colour))
    chroma = ((colour[2] - luma) / (2 - 2 * blue), (colour[0] - luma) / (2 - 2 * red))
    planes = np.zeros((height * 3 // 2, 64), np.uint8)
    planes[:height] = round(luma if full else 16 + luma * 219 / 255)
    for part, value in zip(np.split(planes[height:], 2), chroma, strict=True):
        part[:] = round(128 + (value if full else value * 224 / 255))
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "1", **tags})
        stream.width, stream.height, stream.pix_fmt = 64, height, "yuv420p"
        frame = av.VideoFrame.from_ndarray(planes, "yuv420p")
        frame.pts, frame.time_base = 0, Fraction(1, 25)
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    np.testing.assert_allclose(next(read_frames(path))[32, 32].astype(int), colour, atol=4)


def test_frames_follow_presentation_times(tmp_path: Path) -> None:
    write_at_rate(tmp_path / "slow.mkv", [40, 80, 120, 160], Fraction(10))
    read = [int(frame[32, 32, 1]) for frame in read_frames(tmp_path / "slow.mkv")]
    # Shown from 0, 0.1, 0.2, 0.3 to 0.4 s; sampled every 0.04 s.
    np.testing.assert_allclose(read, [40] * 3 + [80] * 2 + [120] * 3 + [160] * 2, atol=2)
    write_at_rate(tmp_path / "fast.mp4", [*range(20, 220, 4)], Fraction(50))
    read = [int(frame[32, 32, 1]) for frame in read_frames(tmp_path / "fast.mp4")]
    np.testing.assert_allclose(read, range(20, 220, 8), atol=2)


@pytest.mark.parametrize("rate", [Fraction(1350, 61), Fraction(30000, 1001), Fraction(60000, 1001)])
def test_odd_rates_do_not_drift(tmp_path: Path, rate: Fraction) -> None:
    seconds = 8
    count = int(seconds * rate)
    flash = int(7.5 * rate)
    write_at_rate(
        tmp_path / "a.mp4", [20 + 200 * (flash <= i < flash + 3) for i in range(count)], rate
    )
    bright = [k for k, f in enumerate(read_frames(tmp_path / "a.mp4")) if f[32, 32, 1] > 120]
    assert abs(bright[0] / 25 - flash / rate) <= 0.04
    total = sum(1 for _ in read_frames(tmp_path / "a.mp4"))
    assert abs(total / 25 - count / rate) <= 0.04


def test_flash_and_click_stay_together(tmp_path: Path) -> None:
    rate = 16000
    clicks = np.zeros(6 * rate, np.float32)
    flashes = [7, 66, 141]
    for frame in flashes:
        clicks[frame * 640 : frame * 640 + 64] = 0.9
    with VideoWriter(tmp_path / "a.mp4", (64, 64), sound=(clicks, rate)) as writer:
        for k in range(150):
            writer.write(GREY + np.uint8(100 * (k in flashes)))
    info = probe(tmp_path / "a.mp4")
    heard = read_sound(tmp_path / "a.mp4", origin=info.start)
    seen = [k for k, f in enumerate(read_frames(tmp_path / "a.mp4")) if f[32, 32, 1] > 180]
    assert seen == flashes
    for frame in flashes:
        window = np.abs(heard[frame * 640 - 3200 : frame * 640 + 3200])
        assert abs(np.argmax(window) - 3200) < 160


def test_pictures_that_start_late_are_aligned_by_origin(tmp_path: Path) -> None:
    rate = 16000
    click = np.zeros(2 * rate, np.float32)
    click[rate : rate + 64] = 0.9
    path = tmp_path / "late.mkv"
    with av.open(str(path), "w") as container:
        video = container.add_stream("libx264", rate=25)
        video.width = video.height = 64
        audio = container.add_stream("pcm_s16le", rate=rate, layout="mono")
        sound = av.AudioFrame.from_ndarray((click * 32767).astype(np.int16)[None], "s16", "mono")
        sound.sample_rate, sound.pts, sound.time_base = rate, 0, Fraction(1, rate)
        container.mux(audio.encode(sound))
        for k in range(10, 50):
            frame = av.VideoFrame.from_ndarray(GREY + np.uint8(100 * (k == 25)), "rgb24")
            frame.pts, frame.time_base = k, Fraction(1, 25)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
    info = probe(path)
    assert abs(info.start - 0.4) < 0.002
    seen = [k for k, f in enumerate(read_frames(path)) if f[32, 32, 1] > 180]
    heard = read_sound(path, origin=info.start)
    assert seen == [15]
    assert abs(int(np.argmax(np.abs(heard))) - 15 * 640) < 40


def with_edits(path: Path, video: list[tuple[int, int]], audio: list[tuple[int, int]]) -> None:
    """Give the tracks of an mp4 other edit lists: (duration, media time) in milliseconds.

    Boxes are put into the file behind its data, so that no offset in it changes.
    """
    data = bytearray(path.read_bytes())
    moov = data.index(b"moov") - 4
    assert moov > data.index(b"mdat"), "the index must come last"

    def grown(box: bytes) -> bytes:
        return struct.pack(">I", len(box) + 4) + box

    head, out = bytes(data[:moov]), b""
    place, end = moov + 8, moov + struct.unpack_from(">I", data, moov)[0]
    while place < end:
        size = struct.unpack_from(">I", data, place)[0]
        box = bytes(data[place : place + size])
        if box[4:8] == b"trak":
            edits = audio if b"soun" in box else video
            scale = struct.unpack_from(">I", box, box.index(b"mdhd") + 16)[0]
            rows = b"".join(
                struct.pack(">IiI", length, time if time < 0 else time * scale // 1000, 0x10000)
                for length, time in edits
            )
            elst = grown(b"elst" + struct.pack(">II", 0, len(edits)) + rows)
            inner, at = b"", 8
            while at < len(box):
                step = struct.unpack_from(">I", box, at)[0]
                if box[at + 4 : at + 8] != b"edts":
                    inner += box[at : at + step]
                if box[at + 4 : at + 8] == b"tkhd":
                    inner += grown(b"edts" + elst)
                at += step
            box = grown(b"trak" + inner)
        out += box
        place += size
    path.write_bytes(head + grown(b"moov" + out))


@pytest.mark.parametrize(
    ("video", "audio", "lit", "count"),
    [
        # a second cut off both tracks; the frame before the cut is no keyframe
        ([(3000, 1000)], [(3000, 1000)], 35, 75),
        # the picture begins 0.4 s after the sound: an empty edit before it
        ([(400, -1), (4000, 0)], [(4000, 0)], 60, 100),
        # the sound begins 0.4 s after the picture
        ([(4000, 0)], [(400, -1), (4000, 0)], 60, 100),
        # the middle second taken out
        ([(1000, 0), (2000, 2000)], [(1000, 0), (2000, 2000)], 35, 75),
    ],
)
def test_edit_lists_are_followed(
    tmp_path: Path, video: list[tuple[int, int]], audio: list[tuple[int, int]], lit: int, count: int
) -> None:
    rate, path = 16000, tmp_path / "a.mp4"
    click = np.zeros(4 * rate, np.float32)
    click[60 * 640 : 60 * 640 + 64] = 0.9
    with av.open(str(path), "w", options={"movie_timescale": "1000"}) as container:
        stream = container.add_stream("libx264", rate=25, options={"bf": "0", "g": "250"})
        stream.width = stream.height = 64
        sound = container.add_stream("pcm_s16be", rate=rate, layout="mono")
        for k in range(100):
            frame = av.VideoFrame.from_ndarray(GREY + np.uint8(100 * (k == 60)), "rgb24")
            frame.pts, frame.time_base = k, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
        for first in range(0, len(click), 640):
            block = (click[first : first + 640] * 32767).astype(np.int16)[None]
            part = av.AudioFrame.from_ndarray(block, "s16", "mono")
            part.sample_rate, part.pts, part.time_base = rate, first, Fraction(1, rate)
            container.mux(sound.encode(part))
        container.mux(sound.encode(None))
    with_edits(path, video, audio)
    info = probe(path)
    late = [sum(length for length, time in edits if time < 0) / 1000 for edits in (video, audio)]
    seen = [k for k, f in enumerate(read_frames(path)) if f[32, 32, 1] > 180]
    heard = read_sound(path, origin=info.start)
    assert (seen, sum(1 for _ in read_frames(path))) == ([lit], count)
    assert info.start == pytest.approx(late[0], abs=1e-3)
    clicked = int(np.argmax(np.abs(heard))) / 640
    assert abs(clicked - (lit + 25 * (late[1] - late[0]))) < 0.1


def transport(path: Path, picture: np.ndarray, first: int, count: int) -> bytes:
    """Frames `first` and on of a transport stream, which may be joined to others."""
    with av.open(str(path), "w", format="mpegts") as container:
        stream = container.add_stream("mpeg2video", rate=25)
        stream.height, stream.width, stream.pix_fmt = *picture.shape[:2], "yuv420p"
        for k in range(first, first + count):
            frame = av.VideoFrame.from_ndarray(picture, "rgb24")
            frame.pts, frame.time_base = k, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path.read_bytes()


def test_a_stream_that_changes_its_size_keeps_the_first(tmp_path: Path) -> None:
    data = b""
    for side, first in ((64, 0), (32, 5)):
        picture = np.full((side, 2 * side, 3), side, np.uint8)
        picture[:, side:] += 100
        data += transport(tmp_path / "part", picture, first, 5)
    path = tmp_path / "both.ts"
    path.write_bytes(data)
    frames = list(read_frames(path))
    assert {frame.shape for frame in frames} == {(64, 128, 3)}
    assert [int(frame[:, :60].mean()) // 10 for frame in (frames[0], frames[-1])] == [6, 3]
    assert [int(frame[:, 70:].mean()) // 10 for frame in (frames[0], frames[-1])] == [16, 13]
    assert {grey.shape for grey, _ in read_grey(path, 100)} == {(50, 100)}


@pytest.mark.parametrize("second", [0, 4000])
def test_time_stamps_that_leap_are_refused_with_a_remedy(tmp_path: Path, second: int) -> None:
    path = tmp_path / "joined talk.ts"
    data = transport(tmp_path / "part", GREY, 0, 50)
    path.write_bytes(data + transport(tmp_path / "part", GREY, second * 25, 50))
    with pytest.raises(BadInput, match=r"timestamps jump \(from .* s\)") as error:
        list(read_frames(path))
    assert "ffmpeg -i 'joined talk.ts' -vf setpts=N/FRAME_RATE/TB" in str(error.value)
    (tmp_path / "whole.ts").write_bytes(data + transport(tmp_path / "part", GREY, 2000, 50))
    assert sum(1 for _ in read_frames(tmp_path / "whole.ts")) > 2040  # a pause is none


@pytest.mark.parametrize(("turn", "bright"), [((0, 1, -1, 0), "top"), ((0, -1, 1, 0), "bottom")])
def test_rotation_of_a_phone_is_applied(tmp_path: Path, turn: tuple[int, ...], bright: str) -> None:
    picture = np.full((48, 64, 3), 40, np.uint8)
    picture[:, :32] = 200
    with VideoWriter(tmp_path / "a.mp4", (64, 48)) as writer:
        writer.write(picture)
    data = bytearray((tmp_path / "a.mp4").read_bytes())
    # The track header's matrix (a b u, c d v, x y w) begins 40 bytes after its name and flags;
    # (0 1, -1 0) shows the picture turned clockwise by a quarter.
    place = data.index(b"tkhd") + 4 + 40
    a, b, c, d = (value * 0x10000 for value in turn)
    data[place : place + 20] = struct.pack(">5i", a, b, 0, c, d)
    (tmp_path / "a.mp4").write_bytes(data)
    info = probe(tmp_path / "a.mp4")
    assert (info.width, info.height) == (48, 64)
    frame = next(read_frames(tmp_path / "a.mp4"))
    assert frame.shape == (64, 48, 3)
    half = frame[:28] if bright == "top" else frame[36:]
    assert half.min() > 180 and np.sort(frame.mean(axis=(1, 2)))[0] < 60


def test_probe_tells_what_the_file_holds(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "a.mp4", (64, 32), sound=(np.zeros(16_000), 16_000)) as writer:
        for _ in range(25):
            writer.write(GREY[:32])
    info = probe(tmp_path / "a.mp4")
    assert (info.width, info.height, info.fps) == (64, 32, 25.0)
    assert info.duration == pytest.approx(1.0)
    assert info.has_sound and info.start == 0.0


def test_bad_videos_are_refused(tmp_path: Path) -> None:
    write_wav(tmp_path / "a.wav", np.zeros(16_000))
    (tmp_path / "text.mp4").write_text("no video\n" * 50)
    for name, reason in {
        "missing.mp4": "no such file",
        "text.mp4": "not a recording or video",
        "a.wav": "no moving picture",
    }.items():
        with pytest.raises(BadInput, match=reason):
            probe(tmp_path / name)
        with pytest.raises(BadInput, match=reason):
            next(read_frames(tmp_path / name))
