"""Training of motion regressed from the sound, without codes (Table 3, "no quantisation")."""

from pathlib import Path

import torch

from angie.generators.angie.codes import mean_for_activity, patterns
from angie.generators.angie.direct import DirectMotion
from angie.generators.angie.gpt import GPTConfig
from angie.generators.angie.tokenizer import VQConfig
from angie.generators.angie.train_gpt import GPTTraining, someone
from angie.generators.angie.train_vq import stream_errors
from angie.motion.channels import Channels
from angie.motion.windows import MotionWindows
from mraa.training.checkpoint import BestWeights
from mraa.training.run import Run, RunConfig

AT_ONCE = 4096
"""Windows whose motion is held at once."""


def train_direct(
    folder: Path,
    windows: MotionWindows,
    held_out: MotionWindows | None,
    vq: VQConfig,
    gpt: GPTConfig,
    training: GPTTraining,
    *,
    seed: int = 0,
    run_config: RunConfig | None = None,
    resume: bool = False,
) -> DirectMotion:
    """Train transformer and decoders end to end: mean absolute error of the normalised motion.

    Args:
        folder: where checkpoint and curves go.
        windows: training windows.
        held_out: windows of other clips, to choose the weights by; or None.
        vq: sizes of the decoders.
        gpt: sizes of the transformer.
        training: how to train: that of the GPT, whose place this takes.
        seed: everything random follows from it.
        run_config: device, precision and so on.
        resume: go on from the checkpoint in `folder`.

    Returns:
        The trained model in evaluation mode, its `mean` measured.
    """
    windows = windows.choose(["poses", "onset", "speaker"])
    schedule, items = training.schedule, len(windows)
    steps = schedule.steps(items)
    every = max(1, steps // training.checks)
    run = Run(folder, "vq", steps=steps, seed=seed, config=run_config, resume=resume)
    direct = DirectMotion(vq, gpt, len(windows.statistics.speakers))
    best = BestWeights(direct)
    model, optimizer = run.setup(best, schedule.adam(direct))
    batches = run.batches(windows, schedule.batch)
    channels = Channels.of(windows.statistics, vq.quant).to(run.device)
    model.train()
    for step in run.steps():
        if int(best.age) >= training.patience:
            run.save()
            break
        run.rate(optimizer, schedule.rate, schedule.milestone_steps(items))
        batch = next(batches)
        who = someone(batch["speaker"], len(windows.statistics.speakers))
        made = model(batch["onset"], who)
        errors = stream_errors(made.float(), channels.normalise(batch["poses"]), vq)
        loss = torch.stack(list(errors.values())).sum()
        run.backward(loss)
        run.clip(model, optimizer, schedule.clip)
        optimizer.step()
        optimizer.zero_grad()
        if held_out is not None and (step + 1) % every == 0:
            best.consider(run.fabric.broadcast(direct_error(direct, held_out)))
        run.log(loss=loss, **errors, **best.scores())
    best.restore()
    direct.eval()
    places = range(len(windows))
    parts = (windows.chosen(places[i : i + AT_ONCE]) for i in places[::AT_ONCE])
    direct.mean.copy_(mean_for_activity(patterns(direct, part) for part in parts))
    return direct.cpu()


@torch.no_grad()
def direct_error(direct: DirectMotion, windows: MotionWindows) -> float:
    """Mean absolute error of the normalised motion of windows, the streams' added."""
    training = direct.training
    direct.eval()
    windows = windows.choose(["poses", "onset", "speaker"])
    made = patterns(direct, windows)
    channels = Channels.of(windows.statistics, direct.config.quant)
    total = 0.0
    for first in range(0, len(windows), 64):
        poses = windows.stack("poses", first, first + 64)
        true = channels.normalise(poses)
        errors = stream_errors(made[first : first + 64], true, direct.config)
        total += float(torch.stack(list(errors.values())).sum()) * len(poses)
    direct.train(training)
    return total / len(windows)
