"""Reconstruct held-out people from one frame, and say what is left of their hands.

    python scripts/check_pictures.py KIND=FOLDER ... --renderer NAME=PATH ... [--models FOLDER]

KIND and FOLDER as `pack_frames.py` takes them; its test videos are reconstructed, every `stride`-th
frame from the clip's first frame, and from its most open one (hands apart, in the picture). PATH is
a bundle, or a `renderer.safetensors` with its architecture in `renderer.json` beside it. The table
has PSNR and L1 of the whole picture and of 48-pixel boxes around the hands, what the PSNR gains
over showing the source throughout ("still", also a row), and with `--models` what `angie evaluate
--models` says of people: the share of hands seen at their place, of those seen in the true frame,
and the likeness of the face. With `--sheet` truth, source and reconstructions of frames spread over
each kind are written there.
"""

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from pack_frames import decoded, find_crop, true_centres, videos
from replace_renderer import architecture
from safetensors.torch import load_file

from angie.bundle import Bundle
from angie.evaluation.people import TWICE, PeopleJudge, Seen, again, pixel_errors
from angie.parts import load_weights
from data_prep.errors import BadInput, call_script
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker.crop import Crop, cut_out
from data_prep.speaker.people import Pose
from mraa.flow import deform
from mraa.renderer import Renderer, from_pixels, to_pixels

Gathered = dict[str, list[float]]
"""Values by column."""


@dataclass
class Clip:
    """Frames of one held-out video."""

    pixels: np.ndarray
    """(T, 256, 256, 3) uint8 RGB."""
    seen: list[Seen]
    """What is known of each."""

    @property
    def centres(self) -> np.ndarray:
        """(T, 3, 2) right hand, left hand, face in pixels."""
        return np.stack([seen.centres for seen in self.seen])


def load_renderer(path: Path) -> Renderer:
    """A renderer of a bundle or of a file of weights.

    Raises:
        BadInput: neither.
    """
    if path.is_dir():
        return Bundle.open(path).renderer()
    config = path.with_name("renderer.json")
    if not config.is_file():
        raise BadInput(f"{path}: needs its architecture in {config.name} beside it")
    renderer = Renderer(architecture(path))
    load_weights(renderer, load_file(path))
    return renderer.eval()


def moved(pose: Pose | None, crop: Crop) -> Pose | None:
    """A pose seen in a whole picture, in pixels of its square as the judge looks at it."""
    if pose is None:
        return None
    factor = TWICE * IMAGE_SIZE / crop.size

    def placed(points: np.ndarray) -> np.ndarray:
        return (points + 0.5 - [crop.x, crop.y]) * factor - 0.5

    centre, side, angle = pose.body
    return Pose(placed(pose.points), pose.visible, (placed(centre), side * factor, angle))


def load_clip(path: Path, kind: str, stride: int, judge: PeopleJudge | None) -> Clip | None:
    """Every `stride`-th frame of a video, cut as a photo would be."""
    frames = decoded(path, stride)
    crop = find_crop(frames)
    if crop is None or len(frames) < 2:
        return None
    pixels = np.stack([cut_out(f, crop) for f in frames])
    if kind == "signer" and judge is None:
        raise BadInput("signer: has no truth; give the networks with --models")
    known = None if kind == "signer" else true_centres(path, crop, len(frames), stride)
    if judge is None:
        assert known is not None
        return Clip(pixels, [Seen(c, (None, None), None, None) for c in known])
    judge.people.forget()
    seen = []
    for i, frame in enumerate(frames):
        found = judge.look(pixels[i], moved(judge.people.pose(frame), crop))
        seen.append(found if known is None else replace(found, centres=known[i]))
    return Clip(pixels, seen)


@torch.no_grad()
def reconstruct(renderer: Renderer, clip: Clip, source: int) -> tuple[np.ndarray, np.ndarray]:
    """Every frame of a clip from one of them, and the source as the flow warps it, as `pixels`."""
    first = from_pixels(torch.from_numpy(clip.pixels[source][None]))
    regions, made, warped = renderer.estimator(first), [], []
    for start in range(0, len(clip.pixels), 4):
        truth = from_pixels(torch.from_numpy(clip.pixels[start : start + 4]))
        still = first.expand(len(truth), -1, -1, -1)
        background = renderer.background(still, truth)
        driving = renderer.estimator(truth)
        image, flow = renderer(still, regions.repeat(len(truth)), driving, background)
        made.append(to_pixels(image).numpy())
        bent = deform(still, flow, align_corners=renderer.config.align_corners)
        warped.append(to_pixels(bent).numpy())
    return np.concatenate(made), np.concatenate(warped)


def measure(clip: Clip, made: np.ndarray, source: int, judge: PeopleJudge | None) -> Gathered:
    """Scores of a clip's frames but the source."""
    into: Gathered = {}
    for i, seen in enumerate(clip.seen):
        if i != source:
            frame = again(made[i])
            pixel_errors(frame, clip.pixels[i], seen.centres, into)
            if judge is not None:
                judge.compare(frame, seen, into)
    return into


def open_frame(clip: Clip) -> int | None:
    """The frame whose hands are farthest apart, both in the picture."""
    hands = np.nan_to_num(clip.centres[:, :2], nan=-1e3)
    inside = ((hands > 12) & (hands < IMAGE_SIZE - 12)).all((1, 2))
    apart = np.linalg.norm(hands[:, 0] - hands[:, 1], axis=-1) * inside
    return int(apart.argmax()) if apart.max() > 60 else None


def main() -> None:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("videos", nargs="+", help="KIND=FOLDER")
    parser.add_argument("--renderer", action="append", required=True, help="NAME=PATH")
    parser.add_argument("--models", type=Path)
    parser.add_argument("--stride", type=int, default=8)
    parser.add_argument("--clips", type=int, default=0, help="at most so many of a kind")
    parser.add_argument("--sheet", type=Path, help="folder for sheets")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    judge = PeopleJudge(given.models) if given.models else None
    named = [item.split("=", 1) for item in given.renderer]
    renderers = {name: load_renderer(Path(path)) for name, path in named}
    print("| kind, source | frames from | frames | " + " | ".join(COLUMNS.values()) + " |")
    print("|---" * (3 + len(COLUMNS)) + "|")
    results = []
    for item in given.videos:
        kind, folder = item.split("=", 1)
        paths = [p for p, _ in videos(kind, Path(folder), True)]
        if given.clips and len(paths) > given.clips:
            paths = [paths[i] for i in np.linspace(0, len(paths) - 1, given.clips).astype(int)]
        loaded = (load_clip(p, kind, given.stride, judge) for p in paths)
        clips = [clip for clip in loaded if clip is not None]
        for which in ("first", "open"):
            rows = table(clips, which, renderers, judge, kind, given.sheet)
            results += rows
            for row in rows:
                label = f"{kind}, {which} | {row['from']} | {row['frames']}"
                cells = " | ".join(cell(key, row) for key in COLUMNS)
                print(f"| {label} | {cells} |", flush=True)
    if given.json:
        given.json.write_text(json.dumps(results, indent=1))


COLUMNS = {
    "psnr": "PSNR",
    "gain": "gain",
    "l1": "L1",
    "psnr_hands": "hands PSNR",
    "gain_hands": "gain",
    "l1_hands": "L1",
    "psnr_face": "face PSNR",
    "seen": "hands seen",
    "face": "face likeness",
}


def cell(key: str, row: dict) -> str:
    """A number of the table."""
    if key not in row:
        return "-"
    if key == "seen":
        return f"{row[key] / 100:.2f} of {row['hands']}"
    return f"{row[key]:.4f}" if key.startswith("l1") else f"{row[key]:.2f}"


def table(
    clips: list[Clip],
    which: str,
    renderers: dict[str, Renderer],
    judge: PeopleJudge | None,
    kind: str,
    sheet: Path | None,
) -> list[dict]:
    """A row for the truth, the still source, and every renderer with what its flow alone makes."""
    sources = [0 if which == "first" else open_frame(clip) for clip in clips]
    chosen = [(c, s) for c, s in zip(clips, sources, strict=True) if s is not None]
    gathered: dict[str, Gathered] = {}
    shown: dict[str, list[np.ndarray]] = {}
    for clip, source in chosen:
        made = {
            "truth": clip.pixels,
            "still": np.repeat(clip.pixels[source][None], len(clip.pixels), 0),
        }
        for name, renderer in renderers.items():
            made[name], made[f"{name}, warped"] = reconstruct(renderer, clip, source)
        for name, frames in made.items():
            into = gathered.setdefault(name, {})
            for key, values in measure(clip, frames, source, judge).items():
                into.setdefault(key, []).extend(values)
            if name == "still" or name in renderers:
                shown.setdefault(name, []).append(frames)
    rows = []
    for name, into in gathered.items():
        row: dict = {"kind": kind, "source": which, "from": name, "frames": len(into["psnr"])}
        row |= {key: float(np.mean(values)) for key, values in into.items()}
        row["hands"] = len(into.get("seen", ()))
        for key in ("psnr", "psnr_hands"):
            if key in into:
                gain = row[key] - float(np.mean(gathered["still"][key]))
                row[key.replace("psnr", "gain")] = gain
        rows.append(row)
    if sheet is not None:
        sheet.mkdir(exist_ok=True)
        picks = np.linspace(0, len(chosen) - 1, 12).astype(int) if chosen else []
        lines = []
        for n, i in enumerate(picks):
            clip, source = chosen[i]
            frame = (
                (2 * n + 3) * len(clip.pixels) // 29 if which == "first" else n % len(clip.pixels)
            )
            frame = len(clip.pixels) // 2 if frame == source else min(frame, len(clip.pixels) - 1)
            cells = [clip.pixels[frame], *(shown[name][i][frame] for name in shown)]
            lines.append(np.concatenate(cells, 0))
        picture = np.concatenate(lines, 1)
        cv2.imwrite(str(sheet / f"{kind}-{which}.png"), np.ascontiguousarray(picture[..., ::-1]))
    return rows


if __name__ == "__main__":
    call_script(main)
