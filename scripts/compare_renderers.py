"""Train renderers that differ in one choice on equally many samples, and compare what they draw.

    python scripts/compare_renderers.py DATASET WORK [--steps 200] [--only NAME,...] [key=value ...]

All variants of `VARIANTS` are the `lite` preset with the same seed, data, steps and initial weights
(`train_renderer.initial=...`, of which each takes what fits its sizes); further settings hold for
all. Each is trained in WORK/NAME (run again, it goes on), then draws every tenth frame of the test
clips from their first frame. Prints a table in Markdown, and writes WORK/comparison.png: source,
truth, then each variant in the order of the table. The perceptual distance is that of one fixed
network, wider than that of the losses, whatever the loss was.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import torch
from refit_renderer import refit
from safetensors.torch import save_file

from angie.bundle import Bundle
from angie.config import override, parse_overrides, preset
from angie.training import train
from data_prep.dataset import Dataset
from data_prep.errors import BadInput, call_script
from data_prep.files import whole_file
from mraa.reconstruction import reconstruct
from mraa.renderer import Renderer, from_pixels, to_pixels
from mraa.training.run import RunConfig, native_precision

DEEP = ["renderer.generator.design=deep"]
LOSS = "train_renderer.perceptual_backend="
VARIANTS = {
    "random_vgg+lap": DEEP + [LOSS + "random_vgg+lap"],
    "random_vgg": DEEP + [LOSS + "random_vgg"],
    "lap": DEEP + [LOSS + "lap"],
    "lite": ["renderer.generator.design=lite", "renderer.generator.width=80"],
    "paper": ["renderer.generator.design=paper", "renderer.generator.width=64"],
    "chol": [*DEEP, "renderer.affine_mode=chol"],
    "svd": [*DEEP, "renderer.affine_mode=svd"],
}
"""Settings of each variant: losses, designs of the generator (`lite` of the cost of `deep`), and
factors of the regions' covariance; what is not named is `deep`, random_vgg+lap and sym."""

SHOWN = 8
"""Frames on the sheet."""


def train_variant(dataset: Path, folder: Path, settings: list[str], initial: str) -> Renderer:
    """Train one variant, or take it as it was trained."""
    folder.mkdir(parents=True, exist_ok=True)
    changes = parse_overrides(settings)
    if initial:
        path = folder / "initial.safetensors"
        if not path.exists():
            config = override(preset("lite"), changes).renderer
            with whole_file(path) as part:
                save_file(refit(Path(initial), config)[0], part)
        changes = parse_overrides([*settings, f"train_renderer.initial={path}"])
    how = RunConfig(device="cpu", precision=native_precision("cpu"))
    base, there = preset("lite"), (folder / "bundle" / "bundle.json").exists()
    bundle = train(
        dataset, folder / "bundle", preset=base, changes=changes, stage="renderer",
        resume=there, run=how,
    )  # fmt: skip
    return Bundle.open(bundle.folder).renderer()


@torch.no_grad()
def drawn(renderer: Renderer, dataset: Dataset) -> list[np.ndarray]:
    """The middle frame of some test clips, drawn from the first."""
    pictures = []
    for clip in shown_clips(dataset):
        store = dataset.frames(clip)
        source, driving = (
            from_pixels(torch.from_numpy(store[i])[None]) for i in (0, len(store) // 2)
        )
        background = renderer.background(source, driving)
        regions = renderer.estimator(source), renderer.estimator(driving)
        pictures.append(to_pixels(renderer(source, *regions, background)[0])[0].numpy())
    return pictures


def shown_clips(dataset: Dataset) -> list:
    """Test clips for the sheet, spread over all."""
    clips = dataset.clips("test")
    return [clips[i] for i in np.linspace(0, len(clips) - 1, SHOWN).astype(int)]


def main() -> None:
    """Train, print the table, write the sheet."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("settings", nargs="*")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--only", default=",".join(VARIANTS))
    given = parser.parse_intermixed_args()
    names = given.only.split(",")
    for name in names:
        if name not in VARIANTS:
            raise BadInput(f"--only {name}: choose from {', '.join(VARIANTS)}")
    dataset = Dataset(given.dataset)
    if not dataset.clips("test"):
        raise BadInput(f"{given.dataset}: has no test clips to compare on")
    common = [s for s in given.settings if not s.startswith("train_renderer.initial=")]
    initial = "".join(s.partition("=")[2] for s in given.settings if s not in common)
    common += [f"train_renderer.steps={given.steps}", "train_renderer.warmup_steps=0"]
    stores = [dataset.frames(clip) for clip in shown_clips(dataset)]
    columns = [[store[0] for store in stores], [store[len(store) // 2] for store in stores]]
    print("| variant | L1 | PSNR | SSIM | perceptual |\n" + "|---" * 5 + "|")
    for number, name in enumerate(names):
        settings = [*common, *VARIANTS[name]]
        renderer = train_variant(given.dataset, given.work / name, settings, initial)
        score = reconstruct(renderer, dataset, dataset.clips("test"))
        if not number:
            row = (score.copy_l1, score.copy_psnr, score.copy_ssim, score.copy_perceptual)
            print("| copying the source | {:.4f} | {:.2f} | {:.4f} | {:.2f} |".format(*row))
        row = (score.l1, score.psnr, score.ssim, score.perceptual)
        print(f"| {name} | " + "{:.4f} | {:.2f} | {:.4f} | {:.2f} |".format(*row), flush=True)
        columns.append(drawn(renderer, dataset))
    sheet = np.concatenate([np.concatenate(column) for column in columns], axis=1)
    path = given.work / "comparison.png"
    path.write_bytes(cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1].tobytes())


if __name__ == "__main__":
    call_script(main)
