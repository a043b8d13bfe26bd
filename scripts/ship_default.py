"""Put a trained bundle into the package as the default, with a phantom's photo, speech and words.

    python scripts/ship_default.py BUNDLE

Weights are rounded to half precision (they are computed with in float32), which halves the size.
"""

import argparse
import dataclasses
import shutil
from pathlib import Path

import numpy as np
import soundfile
from PIL import Image
from safetensors.torch import load_file

from angie.bundle import BUNDLE, PHOTO, SPEECH, WORDS, Bundle
from angie.parts import halve
from data_prep.errors import call_script
from data_prep.files import whole_folder
from data_prep.phantom.make import recording, still
from data_prep.speech.words import Word, write_words

PRESENTER, VIDEO = 1, 0
"""Which phantom is shown, in clothes and at a place that the training videos do not have."""

SEED = 7
"""Of the photo and the recording; the training videos have another."""

SECONDS = 12.0
"""Length of the recording, about."""


def ship_bundle(trained: Bundle, folder: Path) -> None:
    """Copy the parts of a bundle in half precision, in order, so that the hashes chain."""
    with whole_folder(folder, mark="bundle.json", force=True) as part:
        training = trained.preset.train_renderer
        training = dataclasses.replace(training, initial=Path(training.initial).name)
        preset = dataclasses.replace(trained.preset, train_renderer=training)
        shipped = Bundle.create(part, preset)
        shipped.manifest["speakers"] = trained.manifest["speakers"]
        shipped.manifest["crop"] = trained.manifest["crop"]
        for name in (part for part in trained.parts if trained.has(part) or part != "avd"):
            path = trained.path_of(name)
            report = {**trained.report(name), "precision": "float16"}
            if name == "statistics":
                shutil.copy(path, part / path.name)
                report["precision"] = "float32"
                shipped.add(name, part / path.name, report)
            else:
                shipped.add(name, halve(load_file(path)), report)


def main() -> None:
    """Write the default bundle, photo and recording of the package."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("bundle", type=Path, help="what `angie train` made")
    trained = Bundle.open(parser.parse_args().bundle)
    BUNDLE.parent.mkdir(exist_ok=True)
    ship_bundle(trained, BUNDLE)
    Image.fromarray(still(PRESENTER, number=VIDEO, seed=SEED)).save(PHOTO, optimize=True)
    speech = recording(PRESENTER, seconds=SECONDS, number=VIDEO, seed=SEED)
    samples = np.clip(speech.samples, -1, 1)
    soundfile.write(SPEECH, samples, speech.rate, subtype="PCM_16")
    write_words(WORDS, [Word(w.word, w.start, w.end) for w in speech.words])
    for path in sorted(BUNDLE.parent.rglob("*")):
        if path.is_file():
            print(f"{path.stat().st_size / 1e6:6.2f} MB  {path.relative_to(BUNDLE.parent)}")


if __name__ == "__main__":
    call_script(main)
