"""Proof of origin: what a video says of itself in its metadata, in the words of C2PA.

The record is a C2PA manifest in its terms (claim generator, actions, ingredients, assertions; C2PA
2.1), written as JSON. It is not signed: it tells an honest reader what the file is and lets
`angie verify` draw it again, but whoever wants to can take it out or write another.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import av.error
import numpy as np
from PIL import Image

from angie import __version__
from angie.bundle import Bundle
from data_prep.errors import BadInput
from data_prep.files import sha256
from data_prep.media.container import check_file, open_media
from data_prep.media.photo import photo_pixels
from data_prep.media.pictures import read_comment

RECORD = "origin.json"
"""File of the record in a folder of frames."""

SOURCE_TYPE = "http://cv.iptc.org/newscodes/digitalsourcetype/compositeWithTrainedAlgorithmicMedia"
"""IPTC's word for a real photo and a real recording put together by a trained model."""

ACTIONS, INGREDIENT, CONSENT = "c2pa.actions.v2", "c2pa.ingredient.v3", "angie.consent"
MARK = "claim_generator_info"


@dataclass(frozen=True)
class Origin:
    """What a video says of itself.

    Attributes:
        version: of angie.
        method: "gestures", "motion" (saved motion) or "drive".
        bundle: hash of the parts of the bundle that were used.
        generator: name of the generator, or "".
        settings: of the video.
        hashes: sha256 of what went in, by "photo", "sound" ...
        kinds: what was hashed, by the same names: "file", or "values" of arrays in memory.
        consent: how the person of the photo agreed, or nothing.
        device: type of device and precision that drew it, such as "cpu bf16".
    """

    version: str
    method: str
    bundle: str
    generator: str
    settings: dict[str, Any] = field(default_factory=dict)
    hashes: dict[str, str] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    consent: str = ""
    device: str = ""

    def __str__(self) -> str:
        told = [
            f"synthetic   made by angie {self.version} ({self.method}); not a real recording",
            f"source      {SOURCE_TYPE.rsplit('/', 1)[-1]} (IPTC)",
            f"bundle      {self.bundle}",
            f"generator   {self.generator or 'none'}",
            f"drawn on    {self.device}",
            "settings    "
            + ", ".join(f"{k}={v}" for k, v in self.settings.items() if v not in (None, "")),
        ]
        told += [f"{name:11} sha256 {value}" for name, value in self.hashes.items()]
        return "\n".join([*told, f"consent     {self.consent or 'none stated'}"])


def bundle_hash(bundle: Bundle, generator: str | None) -> str:
    """One hash of the parts of a bundle that gestures, or saved and driven motion, are made by."""
    parts = bundle.needed(generator) if generator else ["renderer"]
    told = sorted(
        (part, bundle.hash_of(part)) for part in parts if part in bundle.manifest["parts"]
    )
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def manifest(record: Mapping[str, Any], consent: str = "") -> dict[str, Any]:
    """The record that is written into a file.

    Args:
        record: `method`, `bundle`, `generator`, `device`, `settings`, and `inputs`: files, pictures
            or arrays by what they are ("photo", "sound" ...), which are hashed here.
        consent: how the person of the photo agreed.
    """
    agent = {"name": "angie", "version": __version__}
    told = {key: record.get(key, "") for key in ("method", "bundle", "generator", "device")}
    action = {
        "action": "c2pa.created",
        "digitalSourceType": SOURCE_TYPE,
        "softwareAgent": agent,
        "parameters": {**told, "settings": record.get("settings", {})},
    }
    assertions = [{"label": ACTIONS, "data": {"actions": [action]}}]
    for name, value in record.get("inputs", {}).items():
        kind, digest = hash_of(value)
        data = {"relationship": "inputTo", "dc:title": name, "kind": kind, "hash": digest}
        assertions.append({"label": INGREDIENT, "data": data})
    if consent:
        assertions.append({"label": CONSENT, "data": {"text": consent}})
    return {MARK: agent, "alg": "sha256", "assertions": assertions}


def hash_of(value: Any) -> tuple[str, str]:
    """What is hashed, "file" or "values", and its sha256."""
    if isinstance(value, str | Path):
        return "file", sha256(Path(value))
    if isinstance(value, Image.Image):
        value = photo_pixels(value)
    parts = value if isinstance(value, tuple | list) else (value,)
    total = hashlib.sha256()
    for part in parts:
        known = isinstance(part, np.ndarray | int)
        array = np.ascontiguousarray(part if known else str(part))
        total.update(f"{array.dtype.str}{array.shape}".encode())
        total.update(array.tobytes())
    return "values", total.hexdigest()


def read_origin(path: Path) -> Origin:
    """What a video says of itself.

    Args:
        path: of an mp4, webm or gif, or of a folder of frames, that angie wrote.

    Raises:
        BadInput: missing, unreadable, or a video without such a record.
    """
    path = Path(path)
    try:
        told = json.loads(_text(path))
        assertions = told["assertions"]
        done = next(a["data"]["actions"][0] for a in assertions if a["label"] == ACTIONS)
        inputs = [a["data"] for a in assertions if a["label"] == INGREDIENT]
        agreed = [str(a["data"]["text"]) for a in assertions if a["label"] == CONSENT]
        how = done["parameters"]
        return Origin(
            str(told[MARK]["version"]),
            str(how["method"]),
            str(how["bundle"]),
            str(how["generator"]),
            dict(how["settings"]),
            {str(one["dc:title"]): str(one["hash"]) for one in inputs},
            {str(one["dc:title"]): str(one["kind"]) for one in inputs},
            " ".join(agreed),
            str(how["device"]),
        )
    except (
        ValueError, KeyError, TypeError, IndexError, StopIteration, AttributeError, RecursionError,
    ) as error:  # fmt: skip
        raise BadInput(
            f"{path}: says nothing of its origin; it was not made by angie, by an old version, or "
            "was saved again by another program"
        ) from error


def _text(path: Path) -> str:
    """The record's text, or nothing."""
    if path.is_dir():
        record = path / RECORD
        check_file(record)
        return record.read_text(errors="replace")
    if path.suffix.lower() == ".gif":
        check_file(path)
        return read_comment(path)
    try:
        with open_media(path) as container:
            tags = {key.lower(): value for key, value in container.metadata.items()}
    except av.error.FFmpegError as error:
        raise BadInput(f"{path}: not a readable video") from error
    return tags.get("description", "")
