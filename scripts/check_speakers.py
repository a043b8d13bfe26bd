"""Tell, for every photo and video of a folder, what the search for the speaker says.

python scripts/check_speakers.py FOLDER [--models MODELS] [--manifest MANIFEST.json]
    [--sheet SHEET.png]

With a manifest (a list of {"file", "kind", "people"}) each verdict is compared with the number of
people that is stated: 0, 1 or more; entries without "people" are shown only.
"""

import argparse
import json
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from data_prep.errors import BadInput
from data_prep.media.photo import read_photo
from data_prep.media.video import probe, read_frames
from data_prep.prepare.analysis import analyse
from data_prep.prepare.source import EXTENSIONS, IngestionConfig
from data_prep.prepare.spans import find_takes
from data_prep.speaker.crop import speaker_crop
from data_prep.speaker.faces import Detector, Face, find_people
from data_prep.speaker.networks import face_detector

PHOTOS = frozenset(".jpg .jpeg .png .webp .bmp .gif .tif .tiff".split())
TILE = 300


@dataclass(frozen=True)
class Verdict:
    """What was found in a file: a picture of it with boxes, and a line of text."""

    picture: np.ndarray
    people: int
    text: str


def boxed(picture: np.ndarray, faces: list[Face]) -> np.ndarray:
    """A copy with the faces and, for one face, the crop drawn in."""
    drawn = picture.copy()
    line = max(2, max(picture.shape) // 300)
    for face in faces:
        x, y, w, h = (round(v) for v in (face.x, face.y, face.w, face.h))
        cv2.rectangle(drawn, (x, y), (x + w, y + h), (255, 0, 0), line)
    if len(faces) == 1:
        crop = speaker_crop(faces[0], *picture.shape[:2])
        end = (crop.x + crop.size, crop.y + crop.size)
        cv2.rectangle(drawn, (crop.x, crop.y), end, (0, 255, 0), line)
    return drawn


def look_at_photo(path: Path, detector: Detector | None) -> Verdict:
    """As `angie animate` would."""
    photo = read_photo(path)
    begin = time.perf_counter()
    faces = find_people(photo, detector)
    spent = 1000 * (time.perf_counter() - begin)
    heights = ", ".join(f"{face.h:.0f}" for face in faces[:4])
    text = f"{spent:.0f} ms: " + (f"{len(faces)} of height {heights}" if faces else "no face")
    return Verdict(boxed(photo, faces), len(faces), text)


def look_at_video(path: Path, detector: Detector | None) -> Verdict:
    """As `angie prepare` would, whatever its sound."""
    info = probe(path)
    analysis = analyse(path, info, detector=detector)
    takes = find_takes(analysis, info, IngestionConfig(), analysis.frames)
    seconds: Counter[str] = Counter()
    for take in takes:
        kept = take.span.reason or "one speaker"
        seconds[kept] += take.span.stop - take.span.first
    seen = sum(bool(s.faces) for s in analysis.sightings)
    text = ", ".join(f"{name} {count / 25:.1f} s" for name, count in seconds.most_common())
    best = max(takes, key=lambda take: take.span.stop - take.span.first)
    middle = (best.span.first + best.span.stop) // 2
    frame = next(read_frames(path, wanted=[(middle, middle + 1)]))
    faces = [best.span.face] if best.span.face is not None else []
    people = {"two people": 2, "no person": 0}.get(seconds.most_common(1)[0][0], 1)
    return Verdict(
        boxed(frame, faces), people, f"{text}; a face in {seen} of {len(analysis.sightings)} looks"
    )


def tile(verdict: Verdict, name: str) -> np.ndarray:
    """A small square picture with the file's name."""
    picture = verdict.picture
    scale = TILE / max(picture.shape[:2])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    square = np.zeros((TILE, TILE, 3), np.uint8)
    square[: small.shape[0], : small.shape[1]] = small[:TILE, :TILE]
    cv2.putText(square, name, (3, TILE - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 0), 1)
    return square


def main() -> None:
    """Print the table, and draw the sheet if asked to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--manifest", type=Path)
    parser.add_argument("--sheet", type=Path)
    parser.add_argument("--models", type=Path, help="folder with BlazeFace")
    options = parser.parse_args()
    expected: dict[str, int] = {}
    if options.manifest is not None:
        for entry in json.loads(options.manifest.read_text()):
            if "people" in entry:
                expected[Path(entry["file"]).name] = int(entry["people"])
    tiles: list[np.ndarray] = []
    detector = face_detector(options.models)
    right = wrong = 0
    for path in sorted(options.folder.rglob("*")):
        suffix = path.suffix.lower()
        if suffix not in PHOTOS | EXTENSIONS or not path.is_file():
            continue
        try:
            verdict = (look_at_photo if suffix in PHOTOS else look_at_video)(path, detector)
        except BadInput as error:
            print(f"{path.name:36} refused: {str(error).removeprefix(f'{path}: ')}")
            continue
        mark = ""
        if path.name in expected:
            hit = min(verdict.people, 2) == min(expected[path.name], 2)
            right, wrong = right + hit, wrong + (not hit)
            mark = "hit " if hit else "MISS"
        print(f"{path.name:36} {mark} {verdict.people:3}  {verdict.text}", flush=True)
        tiles.append(tile(verdict, path.name))
    if expected:
        print(f"{right} hits, {wrong} misses")
    if options.sheet is not None and tiles:
        tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % 6)
        rows = [np.hstack(tiles[i : i + 6]) for i in range(0, len(tiles), 6)]
        cv2.imwrite(str(options.sheet), np.vstack(rows)[..., ::-1])


if __name__ == "__main__":
    main()
