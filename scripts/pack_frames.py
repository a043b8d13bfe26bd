"""Pack the frames of videos densely, for a training elsewhere that has no PyAV and little room.

    python scripts/pack_frames.py KIND FOLDER ARCHIVE [--models FOLDER] [--stride N] [--crf N]

KIND says what FOLDER holds: `signer` (one person before a blue screen), `avatars` or
`phantom` (videos with truth). Each video is cut as the project cuts a photo, every `stride`-th
frame is kept, and ARCHIVE gets pieces `KIND-00.mp4` ... of 512 frames and `KIND.npz`:

    clip     (N,) int32, number of the video, in `names`
    split    (N,) uint8, 0 train, 1 validation, 2 test; a person is in one of them alone
    centres  (N, 3, 2) float32, right hand, left hand and face in pixels of the frame
    seen     (N, 3) bool, whether they are in the picture
    pose     (N,) uint8, 1 where the two hands are far apart and in the picture (open)

With a blue screen (`mraa.training.backgrounds`) the picture is laid over `GREY`, premultiplied, and
`KIND-matte-00.mp4` ... says how much of it is person: over another background `new` it is
`picture + (1 - matte) (new - GREY)`.
Only training and validation frames are packed; `--test` packs the test frames alone.
"""

import argparse
import hashlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from data_prep.errors import BadInput, call_script
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker.crop import Crop, cut_out, find_faces, median_face, speaker_crop
from mraa.training.backgrounds import Screen

PIECE = 512
"""Frames of a video file, so that many can be decoded at once."""

VALIDATION, TEST = 0.02, 0.06
"""Parts of the signer's videos that are held out."""

FADED = 0.8
"""Light, in parts of the video's usual one, below which a frame is faded."""

HELD = {"avatars": (2, 4), "phantom": (1, 2)}
"""Faces of avatars, and videos of phantoms, held out for validation and for test."""


def number(name: str) -> float:
    """A number in [0, 1) that follows from a name."""
    return int(hashlib.sha256(name.encode()).hexdigest()[:8], 16) / 2**32


def identity(name: str) -> str:
    """The face of an avatar's video: `AIAN_F_1` of `AIAN_F_1_Casual_bella_005`."""
    return "_".join(name.split("_")[:3])


def splits(kind: str, names: list[str]) -> dict[str, int]:
    """Split of every video: 0 train, 1 validation, 2 test."""
    if kind == "signer":
        ends = (VALIDATION, VALIDATION + TEST)
        return {n: 1 if number(n) < ends[0] else 2 if number(n) < ends[1] else 0 for n in names}
    person = identity if kind == "avatars" else str
    order = sorted({person(n) for n in names}, key=number)
    validation, test = HELD[kind]
    held = {who: 1 + (i >= validation) for i, who in enumerate(order[: validation + test])}
    return {n: held.get(person(n), 0) for n in names}


class Writer:
    """Pictures of one size into pieces of H.265, nearly without loss."""

    def __init__(self, stem: Path, crf: int) -> None:
        self.stem, self.crf = stem, crf
        self.count, self.container = 0, None

    def add(self, picture: np.ndarray, *, grey: bool = False) -> None:
        """Append (H, W, 3) uint8 RGB, or (H, W) uint8 grey."""
        if self.count % PIECE == 0:
            self.close()
            path = f"{self.stem}-{self.count // PIECE:02d}.mp4"
            self.container = av.open(path, "w")
            options = {
                "crf": str(self.crf),
                "preset": "medium",
                "x265-params": "log-level=error:keyint=64:pools=1:frame-threads=1",
            }
            self.stream = self.container.add_stream("libx265", rate=6, options=options)
            self.stream.width, self.stream.height = picture.shape[1], picture.shape[0]
            self.stream.pix_fmt = "yuv420p"
            self.stream.codec_context.thread_count = 1
        frame = av.VideoFrame.from_ndarray(picture, format="gray" if grey else "rgb24")
        frame.pts, frame.time_base = self.count % PIECE, Fraction(1, 6)
        for packet in self.stream.encode(frame.reformat(format="yuv420p")):
            self.container.mux(packet)
        self.count += 1

    def close(self) -> None:
        """Finish the piece that is being written."""
        if self.container is not None:
            for packet in self.stream.encode():
                self.container.mux(packet)
            self.container.close()
            self.container = None


def decoded(path: Path, stride: int) -> list[np.ndarray]:
    """Every `stride`-th frame, RGB, without frames that are faded out at the beginning and end."""
    with av.open(str(path)) as container:
        container.streams.video[0].thread_count = 1
        frames = enumerate(container.decode(video=0))
        found = [f.to_ndarray(format="rgb24") for i, f in frames if i % stride == 0]
    light = np.array([f.mean() for f in found])
    lit = np.flatnonzero(light > FADED * np.median(light))
    return found[: lit[-1] + 1][lit[0] :]


def find_crop(frames: list[np.ndarray]) -> Crop | None:
    """The square around the speaker of a video, by the median of the faces in five frames."""
    found, near = [], None
    for i in sorted({0, *range(0, len(frames), max(1, len(frames) // 5))}):
        faces = find_faces(frames[i], near) or find_faces(frames[i])
        if faces:
            near = faces[0]
            found.append(near)
    return speaker_crop(median_face(found), *frames[0].shape[:2]) if found else None


def true_centres(path: Path, crop: Crop, count: int, stride: int) -> np.ndarray:
    """Centres (count, 3, 2) in pixels of the frame, from the truth beside a video."""
    with np.load(path.with_suffix("").with_suffix(".truth.npz"), allow_pickle=False) as truth:
        names = [str(n) for n in truth["joint_names"]]
        joints = truth["joints"][:, [names.index(n) for n in ("right_hand", "left_hand", "nose")]]
    joints = joints[::stride][:count]
    joints = np.concatenate([joints, np.repeat(joints[-1:], count - len(joints), 0)])
    return (joints + 0.5 - [crop.x, crop.y]) * (IMAGE_SIZE / crop.size) - 0.5


def seen_centres(people: object, frames: list[np.ndarray], crop: Crop) -> np.ndarray:
    """Centres (count, 3, 2) in pixels of the frame, as the pose network sees them."""
    rows = []
    for frame in frames:
        pose = people.pose(frame)  # type: ignore[attr-defined]
        if pose is None:
            rows.append(np.full((3, 2), -1e3))
            continue
        points = pose.points
        hands = [people.hand_centre(points, side) for side in (0, 1)]  # type: ignore[attr-defined]
        rows.append(np.stack([*hands, points[0]]))
    return (np.stack(rows) + 0.5 - [crop.x, crop.y]) * (IMAGE_SIZE / crop.size) - 0.5


def videos(kind: str, folder: Path, test: bool) -> Iterator[tuple[Path, int]]:
    """Videos to pack and their split."""
    paths = sorted(folder.rglob("*.mp4"))
    if not paths:
        raise BadInput(f"{folder}: has no videos")
    held = splits(kind, [p.stem for p in paths])
    for path in paths:
        if (held[path.stem] == 2) == test:
            yield path, held[path.stem]


def main() -> None:
    """Write the archive's part of one kind."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("kind", choices=("signer", "avatars", "phantom"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("archive", type=Path)
    parser.add_argument("--models", type=Path, help="networks that see hands, for `signer`")
    parser.add_argument("--stride", type=int, default=6)
    parser.add_argument("--crf", type=int, default=21)
    parser.add_argument("--test", action="store_true")
    parser.add_argument("--limit", type=int, default=0)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    given.archive.mkdir(parents=True, exist_ok=True)
    keyed, people = given.kind == "signer", None
    if keyed:
        from data_prep.speaker.people import People

        if given.models is None:
            raise BadInput("signer: has no truth; give the networks with --models")
        people = People(given.models)
    pictures = Writer(given.archive / given.kind, given.crf)
    mattes = Writer(given.archive / f"{given.kind}-matte", given.crf + 11)
    rows: dict[str, list] = {name: [] for name in ("clip", "split", "centres")}
    names: list[str] = []
    for path, split in videos(given.kind, given.folder, given.test):
        frames = decoded(path, given.stride)
        crop = find_crop(frames)
        if crop is None:
            print(f"{path.name}: no face", flush=True)
            continue
        if people is None:
            centres = true_centres(path, crop, len(frames), given.stride)
        else:
            people.forget()
            centres = seen_centres(people, frames, crop)
        screen = None
        for frame in frames:
            small = cut_out(frame, crop)
            if keyed:
                screen = screen or Screen(small)
                small, matte = screen.key(small)
                mattes.add(matte, grey=True)
            pictures.add(small)
        rows["clip"] += [len(names)] * len(frames)
        rows["split"] += [split] * len(frames)
        rows["centres"].append(centres)
        names.append(path.stem)
        print(f"{len(names)} {path.stem}: split {split}, {len(frames)} frames, {crop}", flush=True)
        if given.limit and len(names) >= given.limit:
            break
    pictures.close()
    mattes.close()
    centres = np.concatenate(rows["centres"]).astype(np.float32)
    seen = ((centres > 4) & (centres < IMAGE_SIZE - 5)).all(-1)
    apart = np.linalg.norm(centres[:, 0] - centres[:, 1], axis=-1) > 60
    np.savez_compressed(
        given.archive / f"{given.kind}.npz",
        clip=np.array(rows["clip"], np.int32),
        split=np.array(rows["split"], np.uint8),
        centres=centres,
        seen=seen,
        pose=(apart & seen[:, :2].all(1)).astype(np.uint8),
        names=np.array(names),
    )
    size = sum(p.stat().st_size for p in given.archive.glob(f"{given.kind}*"))
    print(f"{pictures.count} frames of {len(names)} videos, {size / 2**20:.1f} MiB")


if __name__ == "__main__":
    call_script(main)
