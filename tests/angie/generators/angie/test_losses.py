"""What the stages of training show their networks, and that the losses are the paper's formulas.

Nothing is trained: a run that takes no steps records what each network sees and each loss.
"""

import dataclasses

import pytest
import torch
from torch.nn import functional
from torch.utils.data import default_collate

from angie.generators.angie import train, train_refiner
from angie.generators.angie.channels import Channels
from angie.generators.angie.codes import continued_codes, window_codes
from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.generators.angie.refiner import RefinerConfig
from angie.generators.angie.tokenizer import VQConfig, VQMotionExtractor
from angie.generators.angie.train import GPTTraining, VQTraining
from angie.generators.angie.train_refiner import RefinerTraining
from angie.motion.windows import MotionWindows
from mraa.training.checkpoint import Schedule

VQ = VQConfig(regions=4, width=16, codes=32, code_width=8, update="loss")
GPT = GPTConfig(codes=32, width=24, heads=3, layers=2, dropout=0.0)
REFINER = RefinerConfig(regions=4, sound=8, motion=8, hidden=8, layers=1)
TWO_STEPS = Schedule(rate=1e-3, batch=8, most_steps=2)


class Recorder:
    """Stands for `Run`: the same batch at every step, no optimiser, everything written down."""

    def __init__(self, steps: int) -> None:
        self.total, self.device = steps, torch.device("cpu")
        self.fabric = type("Fabric", (), {"global_rank": 0})()
        self.seen, self.losses, self.scores, self.clips = [], [], [], []

    def add(self, name, model, optimizer=None, milestones=()):
        self.model = model.train()
        self.rate, self.milestones = optimizer.param_groups[0]["lr"], list(milestones)
        assert sum(len(group["params"]) for group in optimizer.param_groups) == len(
            list(model.parameters())
        )

        def called(*inputs):
            self.seen.append(inputs)
            return model(*inputs)

        return called

    def batches(self, windows, size):
        self.batch = default_collate([windows[i] for i in range(size)])
        while True:
            yield self.batch

    def steps(self):
        yield from range(self.total)

    def update(self, loss, *names, clip=None):
        self.losses.append(float(loss.detach()))
        self.clips.append(clip)

    def due(self, checks):
        return False

    def log(self, **values):
        self.logged = values

    def restore_best(self):
        pass


@pytest.fixture(scope="module")
def windows(clips, statistics) -> MotionWindows:
    return MotionWindows(clips[:4], statistics)


@pytest.fixture(scope="module")
def vq(windows) -> VQMotionExtractor:
    torch.manual_seed(0)
    made = VQMotionExtractor(VQ).train()
    made(Channels.of(windows.statistics).normalise(windows.stack("poses", 0, 8)))
    return made.eval()


@pytest.fixture(scope="module")
def gpt() -> CoSpeechGPT:
    torch.manual_seed(1)
    made = CoSpeechGPT(GPT).eval()
    for parameter in made.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    return made


def recorded(function, *arguments, **options) -> Recorder:
    runs = []

    def begin(steps):
        runs.append(Recorder(steps))
        return runs[-1]

    torch.manual_seed(0)
    function(begin, *arguments, **options)
    return runs[0]


def test_the_vq_loss_is_equation_9(windows):
    training = VQTraining(dataclasses.replace(TWO_STEPS, rate=3e-5), commitment=0.1, latent=1.0)
    run = recorded(train.train_vq, windows, None, VQ, training)
    (deltas, quantise) = run.seen[1]
    poses = run.batch["poses"]
    wanted = (poses[:, 1:] - poses[:, :-1]) / windows.statistics.delta_scale
    assert torch.allclose(deltas, wanted) and quantise
    total = 0.0
    for stream, part in zip(run.model.streams, deltas.split([8, 12], dim=-1), strict=True):
        latent = stream.encoder(part)
        entry = stream.codebook.entries[torch.cdist(latent, stream.codebook.entries).argmin(-1)]
        assert entry.requires_grad  # equation 9 moves the entries by its gradient
        apart = (latent - entry).square().mean()
        made = stream.decoder(entry)
        total += ((made - part).abs().mean() + 1.0 * apart + 0.1 * apart).item()
    assert run.losses[1] == pytest.approx(total, rel=1e-4)
    assert run.rate == 3e-5 and run.clips == [1.0, 1.0] and run.milestones == []


@pytest.mark.parametrize("which, gets", [("commitment", "encoder"), ("latent", "codebook")])
def test_each_term_of_the_codebook_moves_its_own_side(vq, windows, which, gets):
    model = VQMotionExtractor(VQ)
    model.load_state_dict(vq.state_dict())
    model.train()
    deltas = Channels.of(windows.statistics).normalise(windows.stack("poses", 0, 8))
    getattr(model(deltas), which).backward()
    for stream in model.streams:
        for name in ("encoder", "codebook"):
            grads = [p.grad for p in getattr(stream, name).parameters()]
            moved = any(g is not None and bool((g != 0).any()) for g in grads)
            assert moved == (name == gets)


def test_the_path_loss_is_of_summed_deltas_in_the_units_of_the_picture(windows):
    plain = VQTraining(TWO_STEPS)
    runs = [
        recorded(train.train_vq, windows, None, VQ, dataclasses.replace(plain, path_loss=w,
                 path_loss_norm="square"))
        for w in (0.0, 0.7)
    ]  # fmt: skip
    target = runs[0].seen[1][0]
    made = runs[0].model(target).deltas
    scale = windows.statistics.delta_scale
    weights = torch.cat([scale[:8] / scale[:8].mean(), scale[8:] / scale[8:].mean()])
    path = ((made - target) * weights).cumsum(1).square().mean()
    assert runs[1].losses[1] - runs[0].losses[1] == pytest.approx(0.7 * float(path), rel=1e-3)


def test_the_gpt_predicts_each_code_from_those_before_and_its_own_sound(windows, vq):
    run = recorded(train.train_gpt, vq, windows, None, GPT, GPTTraining(TWO_STEPS))
    codes, onset, who = run.seen[0]
    true = window_codes(vq, windows)[:8]
    sound = windows.stack("onset", 0, 8)
    assert torch.equal(codes, true[:, :, :11]) and torch.equal(onset, sound[:, 1:]) and who is None
    logits = run.model(codes, onset)
    loss = sum(
        functional.cross_entropy(logits[:, stream].reshape(-1, 32), true[:, stream, 1:].reshape(-1))
        for stream in (0, 1)
    )
    assert run.losses[0] == pytest.approx(float(loss), rel=1e-5)


class Listener(CoSpeechGPT):
    """Predicts the code that the first number of its sound says, and is sure of it."""

    def forward(self, codes, onset, speaker=None):
        says = onset[..., 0].round().long()
        return 50.0 * functional.one_hot(says, 32).float()[:, None].expand(-1, 2, -1, -1)


def test_the_score_gives_each_code_its_own_sound(windows, vq):
    true = window_codes(vq, windows)
    true = true[:, :1].expand(-1, 2, -1)  # both streams say the same
    onset = torch.zeros(len(windows), 12, 426)
    onset[..., 0] = true[:, 0]
    coded = windows.choose(["speaker"], codes=true, onset=onset)
    assert train.cross_entropy(Listener(GPT), coded) < 1e-6
    late = windows.choose(["speaker"], codes=true, onset=onset.roll(1, 1))
    assert train.cross_entropy(Listener(GPT), late) > 1


def test_a_code_s_own_sound_is_given_while_generating(windows):
    from angie.generators.angie.sampling import Sampling, continue_codes

    says = torch.randint(32, (30,), generator=torch.Generator().manual_seed(3))
    onset = torch.zeros(30, 426)
    onset[:, 0] = says

    class Cached(Listener):
        def advance(self, codes, onset, cache, speaker=None):
            cache.steps += codes.shape[-1]
            return self.forward(codes, onset)[:, :, -1]

    start = torch.zeros(2, 1, dtype=torch.int64)
    made = continue_codes(Cached(GPT), start, onset, Sampling("greedy"), torch.Generator())
    assert torch.equal(made[0, 1:], says[1:])


@pytest.mark.parametrize("velocity", [0.0, 20.0])
def test_the_refiner_s_loss_is_equation_10(windows, vq, velocity):
    training = RefinerTraining(TWO_STEPS, velocity=velocity)
    run = recorded(train_refiner.train_refiner, vq, windows, None, REFINER, training)
    mfcc, pattern = run.seen[0]
    batch, scale = run.batch, windows.statistics.pose_scale
    assert torch.equal(mfcc, windows.stack("mfcc", 0, 8)) and mfcc.abs().max() > 0.1
    deltas = vq.decode(window_codes(vq, windows)[:8]) * windows.statistics.delta_scale
    path = batch["poses"][:, 1:2] + torch.cat([deltas[:, :1] * 0, deltas[:, 1:]], 1).cumsum(1)
    assert torch.allclose(pattern * scale, path, atol=1e-4)
    off = pattern + run.model(mfcc, pattern) - batch["poses"][:, 1:] / scale
    wanted = off[..., :8].abs().mean() + off[..., 8:].abs().mean()
    wanted = wanted + velocity * (off[:, 1:] - off[:, :-1]).abs().mean()
    assert run.losses[0] == pytest.approx(float(wanted), rel=1e-4)


def test_drift_is_added_to_patterns_only_if_asked_for(windows, vq):
    still, moved = (
        recorded(
            train_refiner.train_refiner, vq, windows, None, REFINER,
            RefinerTraining(TWO_STEPS, drifting=share),
        )
        for share in (0.0, 1.0)
    )  # fmt: skip
    truth = still.batch["pattern"]
    assert torch.equal(still.seen[0][1], truth)
    off = moved.seen[0][1] - truth
    assert (off[:, 0] == 0).all() and off[:, -1].abs().max() > 0
    assert torch.allclose(off[:, 95], 95 * off[:, 1], rtol=1e-2, atol=1e-2)


def test_patterns_of_the_gpt_are_its_likeliest_codes_after_the_first_true_one(windows, vq, gpt):
    codes, true = continued_codes(gpt, vq, windows), window_codes(vq, windows)
    assert codes.shape == true.shape and torch.equal(codes[..., 0], true[..., 0])
    onset = windows.stack("onset", 0, len(windows))
    again = gpt(codes[..., :-1], onset[:, 1:]).argmax(-1)
    assert torch.equal(again, codes[..., 1:]) and not torch.equal(codes, true)
    training = RefinerTraining(TWO_STEPS, pattern="gpt")
    run = recorded(train_refiner.train_refiner, vq, windows, None, REFINER, training, gpt)
    deltas = vq.decode(codes[:8])[:, 1:].cumsum(1) * windows.statistics.delta_scale
    made = run.seen[0][1] * windows.statistics.pose_scale
    assert torch.allclose(made[:, 1:] - made[:, :1], deltas, atol=1e-4)


def test_a_refiner_of_poses_sees_where_they_are(windows, vq):
    sizes = dataclasses.replace(REFINER, sees="pose")
    run = recorded(
        train_refiner.train_refiner, vq, windows, None, sizes, RefinerTraining(TWO_STEPS)
    )
    refiner, statistics = run.model.eval(), windows.statistics
    assert torch.allclose(refiner.mean, statistics.pose_mean / statistics.pose_scale)
    torch.nn.init.normal_(refiner.shift.out.weight)
    mfcc, pattern = run.seen[0]
    here, there = (refiner(mfcc, pattern + place) for place in (0.0, 3.0))
    assert not torch.allclose(here, there, atol=1e-3)
    with pytest.raises(ValueError, match="sees is one of displacement, pose"):
        dataclasses.replace(REFINER, sees="face")
    with pytest.raises(ValueError, match="pattern is one of codes, gpt"):
        RefinerTraining(pattern="words")


def test_regression_without_codes_learns_the_absolute_error(windows):
    sizes = dataclasses.replace(VQ, quant="no_quant")
    run = recorded(train.train_direct, windows, None, sizes, GPT, GPTTraining(TWO_STEPS))
    onset, _ = run.seen[0]
    poses = run.batch["poses"]
    target = (poses[:, 1:] - poses[:, :-1]) / windows.statistics.delta_scale
    off = (run.model(onset) - target).abs()
    assert torch.equal(onset, windows.stack("onset", 0, 8))
    wanted = off[..., :8].mean() + off[..., 8:].mean()
    assert run.losses[0] == pytest.approx(float(wanted), rel=1e-4)


def test_a_tenth_of_the_windows_of_a_joint_model_is_anyone_s():
    torch.manual_seed(0)
    hidden = train.speaker_dropout(torch.zeros(4000, dtype=torch.int64), 2)
    assert set(hidden.tolist()) == {0, 2} and 0.08 < (hidden == 2).float().mean() < 0.12
