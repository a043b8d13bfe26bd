import pytest
import torch
from torch import nn

from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.layers import packed_linear as packing
from angie.layers.packed_linear import PackedLinear, can_pack, pack, product_type


@pytest.mark.skipif(not can_pack(), reason="this PyTorch has no packed linear layers")
def test_packed_layers_compute_the_same(monkeypatch):
    monkeypatch.setattr(packing, "LEAST", 16)
    torch.manual_seed(0)
    gpt = CoSpeechGPT(GPTConfig(codes=16, onset=10, width=32, heads=2, layers=2, block=5)).eval()
    for parameter in gpt.requires_grad_(False).parameters():
        nn.init.normal_(parameter, std=0.3)
    codes, onset = torch.randint(16, (2, 2, 5)), torch.randn(2, 5, 10)
    whole = gpt(codes, onset)
    pack(gpt)
    assert isinstance(gpt.layers[0].mlp[0], PackedLinear)
    assert isinstance(gpt.layers[0].mlp[1], nn.Identity)
    assert isinstance(gpt.sound, nn.Linear)  # too small
    assert torch.allclose(gpt(codes, onset), whole, atol=1e-4)
    cache = gpt.cache(2)
    for step in range(5):
        logits = gpt.advance(codes[..., step : step + 1], onset[:, step : step + 1], cache)
        assert torch.allclose(logits, whole[:, :, step], atol=1e-4)


@pytest.mark.skipif(not can_pack(torch.bfloat16), reason="no packed bfloat16 layers here")
def test_bfloat16_products_leave_the_distribution_as_it_is(monkeypatch):
    monkeypatch.setattr(packing, "LEAST", 16)
    torch.manual_seed(0)
    gpt = CoSpeechGPT(GPTConfig(codes=16, onset=10, width=32, heads=2, layers=2, block=5)).eval()
    for parameter in gpt.requires_grad_(False).parameters():
        nn.init.normal_(parameter, std=0.3)
    codes, onset = torch.randint(16, (64, 2, 5)), torch.randn(64, 5, 10)
    whole = gpt(codes, onset)
    pack(gpt, torch.bfloat16)
    assert gpt.layers[0].mlp[0].dtype == torch.bfloat16
    rounded = gpt(codes, onset)
    assert rounded.dtype == torch.float32
    off = 0.5 * (whole.softmax(-1) - rounded.softmax(-1)).abs().sum(-1)  # total variation
    assert 0 < float(off.mean()) < 0.01 and float(whole.softmax(-1).amax(-1).mean()) > 0.1


def test_what_a_precision_means_for_the_products(monkeypatch):
    for native, half in ((True, torch.bfloat16), (False, torch.float32)):
        monkeypatch.setattr(packing, "native_bf16", lambda _, native=native: native)
        names = ("auto", "bf16", "fp32", "fp16")
        assert [product_type(name) for name in names] == [half, half] + 2 * [torch.float32]


@pytest.mark.skipif(not can_pack(), reason="this PyTorch has no packed linear layers")
def test_where_bfloat16_cannot_be_packed_float32_is(monkeypatch):
    monkeypatch.setattr(packing, "LEAST", 1)
    monkeypatch.setattr(packing, "can_pack", lambda dtype: dtype == torch.float32)
    model = nn.Sequential(nn.Linear(8, 8), nn.GELU())
    values = torch.randn(3, 8)
    with torch.no_grad():
        expected = model(values)
        packed = pack(model, torch.bfloat16)
        assert isinstance(packed[0], PackedLinear) and packed[0].dtype == torch.float32
        assert torch.allclose(packed(values), expected, atol=1e-5)


def test_small_and_foreign_models_are_left_alone(monkeypatch):
    model = nn.Sequential(nn.Linear(8, 8), nn.GELU())
    assert isinstance(pack(model)[0], nn.Linear)
    monkeypatch.setattr(packing, "LEAST", 1)
    assert isinstance(pack(nn.Linear(8, 8).double()), nn.Linear)
    monkeypatch.setattr(packing, "can_pack", lambda _: False)
    assert isinstance(pack(model)[0], nn.Linear)
    assert isinstance(model[1], nn.GELU)


@pytest.mark.skipif(not can_pack(), reason="this PyTorch has no packed linear layers")
def test_a_gelu_that_is_not_exact_stays(monkeypatch):
    monkeypatch.setattr(packing, "LEAST", 1)
    model = nn.Sequential(nn.Linear(8, 8), nn.GELU("tanh"), nn.Linear(8, 8))
    values = torch.randn(3, 8)
    with torch.no_grad():
        expected = model(values)
        assert torch.allclose(pack(model)(values), expected, atol=1e-5)
    assert isinstance(model[1], nn.GELU)
