import pytest
import torch

from angie.layers.vqvae import IDLE_STEPS, Codebook, cluster


def learned(update: str = "ema", codes: int = 4, width: int = 2, **options) -> Codebook:
    torch.manual_seed(0)
    book = Codebook(codes, width, update, **options).train()
    book(torch.randn(8, 16, width))
    return book


def test_the_nearest_entry_is_found():
    book = Codebook(3, 2).eval()
    book.entries.copy_(torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]]))
    values = torch.tensor([[[0.9, 0.2], [0.1, 0.1], [0.3, 1.4]]])
    result = book(values)
    assert result.codes.tolist() == [[1, 0, 2]]
    assert result.values.tolist() == [[[1, 0], [0, 0], [0, 2]]]
    # (.01 + .04 + .01 + .01 + .09 + .36) / 6
    assert result.commitment.item() == pytest.approx(0.52 / 6)


def test_the_gradient_passes_straight_through():
    book = learned()
    values = torch.randn(2, 3, 2, requires_grad=True)
    weights = torch.randn(2, 3, 2)
    (book(values).values * weights).sum().backward()
    assert torch.allclose(values.grad, weights)


def test_the_first_batch_gives_the_first_entries():
    book = Codebook(4, 2).train()
    values = torch.randn(8, 16, 2)
    book._initialise(values.flatten(0, 1))
    same = (book.entries[:, None] == values.flatten(0, 1)).all(-1)
    assert same.any(1).all() and bool(book.initialised)


def test_too_few_vectors_are_repeated_with_a_little_noise():
    book = Codebook(16, 4).train()
    values = torch.randn(1, 3, 4)
    book._initialise(values[0])
    distance = torch.cdist(book.entries, values[0]).min(1).values
    assert distance.max() < 0.05 and len(book.entries.unique(dim=0)) == 16


def test_moving_averages_of_a_hand_worked_step():
    book = Codebook(2, 1, decay=0.9, restart_below=0.0).train()
    book.entries.copy_(torch.tensor([[0.0], [10.0]]))
    book.sums.copy_(book.entries)
    book.initialised.fill_(True)
    book(torch.tensor([[[1.0], [3.0], [9.0]]]))
    # counts .9 + .1 * 2 and .9 + .1 * 1; sums .1 * 4 and 9 + .1 * 9
    assert torch.allclose(book.counts, torch.tensor([1.1, 1.0]))
    assert torch.allclose(book.entries, torch.tensor([[0.4 / 1.1], [9.9]]))


def test_dead_entries_restart_at_vectors_of_the_batch():
    book = learned(codes=8, restart_below=1.0)
    book.entries[3:] = 1e3
    book.sums[3:] = 1e3
    book.counts[3:] = 0.5
    values = torch.randn(8, 16, 2)
    book(values)
    distance = torch.cdist(book.entries[3:], values.flatten(0, 1)).min(1).values
    assert distance.max() < 1e-6
    assert book.counts.min() >= 1
    assert len(book(values).codes.unique()) > 3


def test_restarts_bring_the_perplexity_up():
    torch.manual_seed(0)
    centres = torch.randn(16, 8) * 3

    def batch():
        choice = torch.randint(16, (32, 12))
        return centres[choice] + torch.randn(32, 12, 8) * 0.01

    book = Codebook(16, 8).train()
    book(batch())
    book.entries.zero_().add_(torch.randn(16, 8) * 1e-3)  # collapsed
    book.sums.copy_(book.entries)
    for _ in range(400):
        book(batch())
    assert book.perplexity() > 10


def test_entries_unused_for_100_steps_restart_under_the_loss_update():
    book = learned("loss")
    with torch.no_grad():
        book.entries[0] = 1e3
    values = torch.randn(2, 4, 2)
    for _ in range(IDLE_STEPS - 2):
        book(values)
    assert book.entries[0, 0] == 1e3
    for _ in range(IDLE_STEPS + 2):
        book(values)
    assert book.entries[0].abs().max() < 10


def test_the_loss_update_moves_entries_by_their_gradient():
    book = learned("loss")
    result = book(torch.randn(2, 4, 2))
    result.latent.backward()
    assert book.entries.grad.abs().sum() > 0
    assert [name for name, _ in book.named_parameters()] == ["entries"]
    assert not list(learned("ema").parameters())


def test_evaluation_leaves_the_codebook_alone():
    book = learned().eval()
    before = {name: value.clone() for name, value in book.state_dict().items()}
    book(torch.randn(8, 16, 2))
    assert all(torch.equal(value, before[name]) for name, value in book.state_dict().items())


@pytest.mark.parametrize("update", ["ema", "loss"])
def test_save_load_and_go_on_equals_never_having_stopped(update):
    values = [torch.randn(4, 12, 2, generator=torch.Generator().manual_seed(i)) for i in range(9)]

    def go_on(book, steps):
        for step in steps:
            torch.manual_seed(step)
            book(values[step])
        return book

    whole = go_on(Codebook(6, 2, update).train(), range(9))
    torch.manual_seed(99)
    half = go_on(Codebook(6, 2, update).train(), range(5))
    resumed = Codebook(6, 2, update).train()
    resumed.load_state_dict(half.state_dict())
    go_on(resumed, range(5, 9))
    for name, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name]), name


def test_perplexity_of_known_usage():
    book = Codebook(4, 2)
    book.usage.copy_(torch.tensor([1.0, 1.0, 0.0, 0.0]))
    assert book.perplexity().item() == pytest.approx(2)
    book.usage.fill_(3.0)
    assert book.perplexity().item() == pytest.approx(4)


def test_float32_even_under_autocast():
    book = learned()
    with torch.autocast("cpu", torch.bfloat16):
        result = book(torch.randn(2, 4, 2).bfloat16())
    assert result.values.dtype == torch.float32 and book.sums.dtype == torch.float32


def test_an_unknown_update_is_refused():
    with pytest.raises(ValueError, match="ema, loss"):
        Codebook(4, 2, "adam")


def test_cluster_centres_are_those_of_the_clusters():
    torch.manual_seed(0)
    truth = torch.tensor([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]])
    values = truth.repeat(20, 1) + 0.1 * torch.randn(60, 2)
    found = cluster(values, 3)
    nearest = torch.cdist(found, truth).argmin(-1)
    assert sorted(nearest.tolist()) == [0, 1, 2]
    means = torch.stack([values[place::3].mean(0) for place in nearest.tolist()])
    assert torch.allclose(found, means, atol=1e-5)


def test_a_codebook_begun_with_clusters_uses_them():
    torch.manual_seed(0)
    codebook = Codebook(4, 2, restart_below=0.1)
    values = torch.tensor([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0], [9.0, 9.0]])
    codebook.init_entries(values)
    assert bool(codebook.initialised) and torch.equal(codebook.counts, torch.ones(4))
    assert sorted(codebook.entries.tolist()) == sorted(values.tolist())
    codebook.train()(values[None])  # moving averages of the entries themselves stay there
    assert sorted(codebook.entries.round(decimals=4).tolist()) == sorted(values.tolist())


def test_fewer_vectors_than_entries_can_begin_a_codebook():
    torch.manual_seed(0)
    codebook = Codebook(8, 2)
    codebook.init_entries(torch.tensor([[0.0, 0.0], [9.0, 0.0]]))
    assert torch.isfinite(codebook.entries).all() and codebook.counts.sum() == 8


def stationary(book: Codebook, steps: int) -> float:
    """Restarts a step of a codebook of 512 entries on as many clusters, 384 vectors a step."""
    torch.manual_seed(0)
    centres = 3 * torch.randn(512, 8)
    book.train()
    book(centres[torch.randint(512, (32, 12))])
    restarts = 0
    for step in range(steps):
        book(centres[torch.randint(512, (32, 12))])
        restarts += int(book.restarted) if step >= steps // 2 else 0
    return restarts / (steps - steps // 2)


def test_entries_in_use_do_not_restart():
    assert stationary(Codebook(512, 8, "ema"), 240) < 4
    assert stationary(Codebook(512, 8, "ema", restart_below=1.0), 30) > 100  # half of all, always
    assert stationary(Codebook(512, 8, "loss"), 205) < 4
