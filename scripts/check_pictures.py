"""Reconstruct held-out people from one frame, and say what is left of their hands.

    python scripts/check_pictures.py KIND=FOLDER ... --renderer NAME=PATH ... [--models FOLDER]

KIND and FOLDER as `pack_frames.py` takes them; its test videos are reconstructed, every `stride`-th
frame from the clip's first frame, and from its most open one (hands apart, in the picture). PATH is
a bundle, or a `renderer.safetensors` with its architecture in `renderer.json` beside it. The table
has PSNR and L1 of the whole picture and of 48-pixel boxes around the hands, what the PSNR gains
over showing the source throughout ("still", also a row), and with `--models` the share of hands
seen at their place, of those seen in the true frame (score over 0.5; both at twice the size). With
`--sheet` truth, source and reconstructions of frames spread over each kind are written there.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from pack_frames import decoded, find_crop, seen_centres, true_centres, videos
from pictures.people import People, Square
from replace_renderer import architecture
from safetensors.torch import load_file

from angie.bundle import Bundle
from angie.parts import load_weights
from data_prep.errors import BadInput, call_script
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker.crop import Crop, cut_out
from mraa.renderer import Renderer, from_pixels, to_pixels

BOX = 48
"""Side in pixels of the boxes around hands."""

SEEN = 0.5
"""Score from which a hand counts as seen."""

FOLDED = 40
"""Pixels between hands below which they are folded, which the hand network cannot judge."""


@dataclass
class Clip:
    """Frames of one held-out video."""

    pixels: np.ndarray
    """(T, 256, 256, 3) uint8 RGB."""
    centres: np.ndarray
    """(T, 3, 2) right hand, left hand, face in pixels."""
    squares: list[list[Square]]
    """Where hands are seen in the true frames, in pixels of frames at twice the size."""


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


def large(image: np.ndarray) -> np.ndarray:
    """A frame at twice the size."""
    return cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)


def squares_of(people: People, frame: np.ndarray, crop: Crop, true: np.ndarray) -> list[Square]:
    """Hands that are seen in a true frame, apart from folded ones."""
    pose = people.pose(frame)
    if pose is None:
        return []
    factor = 2 * IMAGE_SIZE / crop.size
    found = [s for s in people.hand_squares(pose) if s is not None]
    moved = [((s[0] + 0.5 - [crop.x, crop.y]) * factor - 0.5, s[1] * factor, s[2]) for s in found]
    if len(moved) == 2 and np.linalg.norm(moved[0][0] - moved[1][0]) < 2 * FOLDED:
        return []
    inside = [s for s in moved if (s[0] > 8).all() and (s[0] < 2 * IMAGE_SIZE - 8).all()]
    twice = large(true)
    return [s for s in inside if people.hand_score(twice, s) > SEEN]


def load_clip(path: Path, kind: str, stride: int, people: People | None) -> Clip | None:
    """Every `stride`-th frame of a video, cut as a photo would be."""
    frames = decoded(path, stride)
    crop = find_crop(frames)
    if crop is None or len(frames) < 2:
        return None
    pixels = np.stack([cut_out(f, crop) for f in frames])
    squares: list[list[Square]] = [[] for _ in frames]
    if people is not None:
        people.forget()
        seen = zip(frames, pixels, strict=True)
        squares = [squares_of(people, f, crop, p) for f, p in seen]
    if kind == "signer":
        if people is None:
            raise BadInput("signer: has no truth; give the networks with --models")
        people.forget()
        centres = seen_centres(people, frames, crop)
    else:
        centres = true_centres(path, crop, len(frames), stride)
    return Clip(pixels, centres, squares)


@torch.no_grad()
def reconstruct(renderer: Renderer, clip: Clip, source: int) -> np.ndarray:
    """Every frame of a clip from one of them, (T, 256, 256, 3) uint8."""
    first = from_pixels(torch.from_numpy(clip.pixels[source][None]))
    regions, made = renderer.estimator(first), []
    for start in range(0, len(clip.pixels), 4):
        truth = from_pixels(torch.from_numpy(clip.pixels[start : start + 4]))
        still = first.expand(len(truth), -1, -1, -1)
        background = renderer.background(still, truth)
        driving = renderer.estimator(truth)
        image, _ = renderer(still, regions.repeat(len(truth)), driving, background)
        made.append(to_pixels(image).numpy())
    return np.concatenate(made)


def errors(made: np.ndarray, clip: Clip, source: int) -> list[tuple[float, float]]:
    """PSNR and L1 of whole frames, and of boxes around hands, one after the other."""
    rows: list[list[tuple[float, float]]] = [[], []]
    for i in range(len(made)):
        if i == source:
            continue
        gap = np.abs(made[i].astype(np.float32) - clip.pixels[i]) / 255
        parts = [(0, gap)]
        for x, y in clip.centres[i, :2]:
            if 4 < min(x, y) and max(x, y) < IMAGE_SIZE - 5:
                left, top = (max(0, round(float(v) - BOX / 2)) for v in (x, y))
                parts.append((1, gap[top : top + BOX, left : left + BOX]))
        for kind, part in parts:
            rows[kind].append((-10 * np.log10(max((part**2).mean(), 1e-8)), part.mean()))
    return [tuple(np.mean(r, axis=0)) if r else (np.nan, np.nan) for r in rows]


def hands_left(people: People, made: np.ndarray, clip: Clip, source: int) -> list[bool]:
    """Of every hand seen in the true frames, whether it is seen at its place."""
    found = []
    for i in range(len(made)):
        if i != source and clip.squares[i]:
            image = large(made[i])
            found += [people.hand_score(image, s) > SEEN for s in clip.squares[i]]
    return found


def open_frame(clip: Clip) -> int | None:
    """The frame whose hands are farthest apart, both in the picture."""
    hands = clip.centres[:, :2]
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
    people = People(given.models) if given.models else None
    named = [item.split("=", 1) for item in given.renderer]
    renderers = {name: load_renderer(Path(path)) for name, path in named}
    columns = "frames | PSNR | gain | L1 | hands PSNR | gain | L1 | hands seen"
    print(f"| kind, source | renderer | {columns} |\n" + "|---" * 10 + "|")
    results = []
    for item in given.videos:
        kind, folder = item.split("=", 1)
        paths = [p for p, _ in videos(kind, Path(folder), True)]
        if given.clips and len(paths) > given.clips:
            paths = [paths[i] for i in np.linspace(0, len(paths) - 1, given.clips).astype(int)]
        loaded = (load_clip(p, kind, given.stride, people) for p in paths)
        clips = [clip for clip in loaded if clip is not None]
        for which in ("first", "open"):
            rows = table(clips, which, renderers, people, kind, given.sheet)
            results += rows
            for row in rows:
                cells = [f"{row[c]:.2f}" if "L1" not in c else f"{row[c]:.4f}" for c in CELLS]
                label = f"{kind}, {which} | {row['renderer']} | {row['frames']}"
                print(
                    f"| {label} | " + " | ".join(cells) + f" | {row['seen']:.2f} of {row['of']} |",
                    flush=True,
                )
    if given.json:
        given.json.write_text(json.dumps(results, indent=1))


CELLS = ("psnr", "gain", "L1", "hands_psnr", "hands_gain", "hands_L1")


def table(
    clips: list[Clip],
    which: str,
    renderers: dict[str, Renderer],
    people: People | None,
    kind: str,
    sheet: Path | None,
) -> list[dict]:
    """A row for the still source and for every renderer."""
    sources = [0 if which == "first" else open_frame(clip) for clip in clips]
    chosen = [(c, s) for c, s in zip(clips, sources, strict=True) if s is not None]
    rows: list[dict] = []
    shown: dict[str, list[np.ndarray]] = {}
    for name in ("still", *renderers):
        measured, weights, left = [], [], []
        for clip, source in chosen:
            if name == "still":
                made = np.repeat(clip.pixels[source][None], len(clip.pixels), 0)
            else:
                made = reconstruct(renderers[name], clip, source)
            measured.append(errors(made, clip, source))
            weights.append(len(made) - 1)
            if people is not None:
                left += hands_left(people, made, clip, source)
            shown.setdefault(name, []).append(made)
        values = np.array(measured)  # (clips, whole or hands, PSNR or L1)
        fine = ~np.isnan(values[:, :, 0])
        share = np.array(weights)[:, None] * fine
        mean = (np.nan_to_num(values) * share[..., None]).sum(0) / share.sum(0)[:, None]
        base = rows[0] if rows else None
        row = {
            "kind": kind,
            "source": which,
            "renderer": name,
            "frames": int(sum(weights)),
            "psnr": mean[0, 0],
            "L1": mean[0, 1],
            "hands_psnr": mean[1, 0],
            "hands_L1": mean[1, 1],
            "seen": float(np.mean(left)) if left else float("nan"),
            "of": len(left),
        }
        row["gain"] = row["psnr"] - (base["psnr"] if base else row["psnr"])
        row["hands_gain"] = row["hands_psnr"] - (base["hands_psnr"] if base else row["hands_psnr"])
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
