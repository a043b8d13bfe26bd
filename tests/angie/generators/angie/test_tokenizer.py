import copy
import dataclasses

import pytest
import torch

from angie.generators.angie.tokenizer import HALO, VQConfig, VQMotionExtractor

TINY = VQConfig(regions=4, width=16, codes=32, code_width=8)


@pytest.fixture(scope="module")
def vq() -> VQMotionExtractor:
    torch.manual_seed(0)
    extractor = VQMotionExtractor(TINY).train()
    extractor(torch.randn(8, 96, 20))
    return extractor.eval()


@pytest.mark.parametrize(
    "frames, tokens, decoded", [(96, 12, 96), (120, 15, 120), (240, 30, 240), (100, 12, 96)]
)
def test_lengths(vq, frames, tokens, decoded):
    codes = vq.encode(torch.randn(2, frames, 20))
    assert codes.shape == (2, 2, tokens) and codes.dtype == torch.int64
    assert codes.min() >= 0 and codes.max() < 32
    assert vq.decode(codes).shape == (2, decoded, 20)


def test_forward_encode_and_decode_agree(vq):
    deltas = torch.randn(2, 96, 20)
    result = vq(deltas)
    assert torch.equal(result.codes, vq.encode(deltas))
    assert torch.allclose(result.deltas, vq.decode(result.codes), atol=1e-6)


def test_the_streams_do_not_see_one_another(vq):
    deltas = torch.randn(1, 96, 20)
    other = deltas.clone()
    other[..., 8:] = torch.randn(1, 96, 12)
    codes, changed = vq.encode(deltas), vq.encode(other)
    assert torch.equal(codes[:, 0], changed[:, 0])
    assert not torch.equal(codes[:, 1], changed[:, 1])
    assert torch.equal(vq.decode(codes)[..., :8], vq.decode(changed)[..., :8])


def test_decoding_in_windows_of_the_training_length(vq):
    codes = torch.randint(32, (2, 12))
    assert torch.allclose(vq.decode_chunked(codes), vq.decode(codes[None])[0], atol=1e-5)
    codes = torch.randint(32, (2, 24))  # frames 88 to 104 are of the second window alone
    alone = vq.decode(codes[None, :, 6:18])[0, 40:56]
    assert torch.allclose(vq.decode_chunked(codes)[88:104], alone, atol=1e-5)
    assert vq.decode_chunked(torch.randint(32, (2, 31))).shape == (248, 20)
    assert vq.decode_chunked(torch.randint(32, (2, 3))).shape == (24, 20)


def test_a_long_sequence_is_decoded_in_blocks_as_in_one_pass(vq, monkeypatch):
    codes = torch.randint(32, (2, 150))
    whole = vq.decode(codes[None])[0]
    for block in (1, 40, 128, 200):
        monkeypatch.setattr("angie.generators.angie.tokenizer.BLOCK", block)
        assert torch.allclose(vq.decode_whole(codes), whole, atol=1e-5)
    assert vq.decode_whole(codes[:, :3]).shape == (24, 20)


def test_a_decoded_frame_depends_on_fewer_codes_than_the_halo():
    decoder = VQMotionExtractor(TINY).shift.decoder
    for parameter in decoder.parameters():
        torch.nn.init.constant_(parameter, 0.02)  # nothing cancels, every path is open
    latent = torch.rand(1, 101, TINY.code_width, requires_grad=True)
    for frame in (400, 403, 407):  # of code 50
        (gradient,) = torch.autograd.grad(decoder(latent)[0, frame].sum(), latent)
        seen = gradient[0].abs().sum(-1).nonzero()
        assert 50 - HALO < seen.min() and seen.max() < 50 + HALO


def test_start_codes_are_those_of_no_motion(vq):
    codes = vq.encode(torch.zeros(1, 96, 20))[0]
    assert torch.equal(vq.start_codes(), codes[:, 0])
    other = copy.deepcopy(vq)
    other.config = dataclasses.replace(vq.config, context="clip")
    assert torch.equal(other.start_codes(), codes[:, 6])
    with pytest.raises(ValueError, match="context is one of window, clip, not 'words'"):
        VQConfig(context="words")


def test_the_receptive_field_is_wider_than_a_window():
    encoder = VQMotionExtractor(TINY).shift.encoder
    deltas = torch.randn(1, 1600, 8, requires_grad=True)
    encoder(deltas)[0, 100].sum().backward()
    seen = deltas.grad[0].abs().sum(-1).nonzero()
    assert seen.max() - seen.min() + 1 == 402


def test_the_paper_preset_has_the_paper_s_shapes():
    with torch.device("meta"):
        vq = VQMotionExtractor(VQConfig())
    assert vq.shift.codebook.entries.shape == (512, 512)
    assert vq.cholesky.codebook.entries.shape == (512, 512)
    assert vq.shift.encoder.layers[0].weight.shape == (512, 40, 4)
    assert vq.cholesky.encoder.layers[0].weight.shape == (512, 60, 4)
    assert vq.shift.decoder.layers[-1].weight.shape == (40, 512, 3)
    # per stream of C channels: encoder 3 stages of conv4 and 3 residual blocks (conv3, conv1),
    # the first stage's conv4 from C, and conv3; the decoder mirrors it and adds conv3 to C
    w = 512
    block = 3 * (3 * w * w + w + w * w + w)
    for stream, channels in ((vq.shift, 40), (vq.cholesky, 60)):
        encoder = (4 * channels * w + w) + 2 * (4 * w * w + w) + 3 * block + (3 * w * w + w)
        decoder = (3 * w * w + w) + 3 * block + 3 * (4 * w * w + w) + 3 * w * channels + channels
        assert sum(p.numel() for p in stream.parameters()) == encoder + w * w + decoder
