"""Two real processes, as torchrun starts them, against one."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from data_prep.dataset import Dataset
from mraa.renderer import GeneratorConfig, HourglassConfig, RendererConfig
from mraa.training.objective import RendererTraining
from mraa.training.renderer import train_renderer
from mraa.training.run import RunConfig

SMALL = RendererConfig(
    regions=3,
    estimator=HourglassConfig(4, 3, 16),
    background=HourglassConfig(4, 3, 16),
    background_scale=0.25,
    flow=HourglassConfig(4, 3, 16),
    generator=GeneratorConfig("lite", width=16, bottleneck_blocks=1),
)

# At MRAA's rate rounding alone parts the losses: another order of the same batch in one process
# changes the gradients of an untrained renderer by up to 1 %, and Adam's first steps by more.
TRAINING = RendererTraining(
    steps=2,
    batch=4,
    rate=1e-5,
    perceptual_width=4,
    perceptual_scales=(0.25,),
    milestones=(),
    ema=0.9,
)


def train(dataset: Path, folder: Path) -> None:
    """A few steps on the CPU, every loss written down."""
    how = RunConfig(device="cpu", devices=1, log_every=1)
    train_renderer(Dataset(dataset), SMALL, TRAINING, folder, seed=5, run_config=how)


def losses(folder: Path) -> dict[tuple[str, str], float]:
    with (folder / "curves" / "renderer.csv").open() as file:
        return {(r["name"], r["step"]): float(r["value"]) for r in csv.DictReader(file)}


@pytest.mark.slow  # three times the imports: 10 s on two free cores
def test_two_processes_train_as_one(dataset, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    train(dataset.path, one)
    start = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    here = Path(__file__)
    done = subprocess.run(
        [*start, str(here), str(dataset.path), str(two)],
        cwd=here.parents[3],
        env={**os.environ, "PYTHONPATH": str(here.parents[3]), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    alone, together = losses(one), losses(two)
    assert alone.keys() == together.keys() and ("loss", "1") in alone
    for key, value in alone.items():
        assert abs(together[key] - value) <= 1e-4 * max(1, abs(value)), key
    a, b = (load_file(folder / "renderer.safetensors") for folder in (one, two))
    assert a.keys() == b.keys()
    for name in a:
        if "running" in name:  # statistics are those of the whole batch
            torch.testing.assert_close(a[name], b[name], atol=1e-3, rtol=1e-3)
    gradients = [
        torch.cat([x[name].flatten() for name in a if name.endswith("exp_avg")]) for x in (a, b)
    ]
    assert torch.cosine_similarity(*gradients, dim=0) > 0.99
    assert abs(gradients[0].norm() / gradients[1].norm() - 1) < 0.03


if __name__ == "__main__":
    train(Path(sys.argv[1]), Path(sys.argv[2]))
