"""The square of a photo that is animated; imports little, so that it is found beside the rest."""

from pathlib import Path

import numpy as np

from data_prep.errors import BadInput
from data_prep.photo import read_photo
from data_prep.speaker import Crop, choose_person, find_people, speaker_crop


def find_crop(path: Path, person: str | None = None) -> Crop:
    """The square of a photo's file; as `photo_crop`."""
    return photo_crop(path, read_photo(path), person)


def photo_crop(path: Path, photo: np.ndarray, person: str | None = None) -> Crop:
    """The square around the speaker's upper body, by the rule of the training data.

    Args:
        path: named in the message.
        photo: (H, W, 3) uint8 RGB.
        person: "left", "right" or "largest" of several people; None refuses them.

    Raises:
        BadInput: no face is found, or several people and none is chosen.
    """
    people = find_people(photo)
    if not people:
        raise BadInput(f"{path}: no face found; give the square yourself with --crop x,y,size")
    if len(people) > 1 and person is None:
        raise BadInput(
            f"{path}: shows {len(people)} people; choose with --person left, right or largest, "
            "or give the square yourself with --crop x,y,size"
        )
    face = people[choose_person(people, person or "largest")]
    return speaker_crop(face, *photo.shape[:2])
