"""The square of a photo that is animated; imports little, so that it is found beside the rest."""

from pathlib import Path

import numpy as np

from data_prep.errors import BadInput
from data_prep.photo import read_photo
from data_prep.speaker import Crop, choose_person, find_people, speaker_crop


def find_crop(path: Path, person: str | None = None) -> Crop:
    """The square of a photo's file; as `photo_crop`."""
    return photo_crop(path, read_photo(path), person)


def photo_crop(
    path: Path, photo: np.ndarray, person: str | None = None, *, with_crop: bool = True
) -> Crop:
    """The square around the speaker's upper body, by the rule of the training data.

    Args:
        path: named in the message.
        photo: (H, W, 3) uint8 RGB.
        person: "left", "right" or "largest" of several people; None refuses them.
        with_crop: whether the messages advise to give the square with --crop; for commands that
            have no such option they do not.

    Raises:
        BadInput: no face is found, or several people and none is chosen.
    """
    people = find_people(photo)
    if not people:
        advice = "give the square yourself with --crop x,y,size"
        advice = advice if with_crop else "take a photo that shows one"
        raise BadInput(f"{path}: no face found; {advice}")
    if len(people) > 1 and person is None:
        advice = ", or give the square yourself with --crop x,y,size" if with_crop else ""
        raise BadInput(
            f"{path}: shows {len(people)} people; choose with --person left, right or largest"
            f"{advice}"
        )
    face = people[choose_person(people, person or "largest")]
    return speaker_crop(face, *photo.shape[:2])
