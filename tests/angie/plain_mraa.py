"""MRAA written down once more, plainly and apart from the package, on a random checkpoint.

Everything follows from the names and shapes of the released tensors and the published equations;
A comes from LAPACK's SVD as in the reference code. Used to judge the import of checkpoints whose
sizes differ from the golden ones.
"""

import torch
import torch.nn.functional as F

REGIONS, TEMPERATURE = 20, 0.2
ESTIMATOR = {"block_expansion": 6, "num_blocks": 3, "max_features": 40, "scale_factor": 0.5}
BACKGROUND = {"block_expansion": 5, "num_blocks": 2, "max_features": 16, "bg_type": "shift"}
FLOW = {"block_expansion": 7, "num_blocks": 4, "max_features": 30, "scale_factor": 0.5}
WIDTHS, RESIDUAL, CODES = (8, 16, 24, 24), 3, (12, 9)
CONFIG = {
    "num_regions": REGIONS,
    "revert_axis_swap": True,
    "region_predictor_params": {**ESTIMATOR, "temperature": TEMPERATURE, "pad": 3},
    "bg_predictor_params": BACKGROUND,
    "generator_params": {
        "block_expansion": WIDTHS[0],
        "max_features": max(WIDTHS),
        "num_down_blocks": len(WIDTHS) - 1,
        "num_bottleneck_blocks": RESIDUAL,
        "skips": True,
        "pixelwise_flow_predictor_params": FLOW,
    },
    "avd_network_params": {"id_bottle_size": CODES[0], "pose_bottle_size": CODES[1]},
}


class Weights(dict):
    """A state dict that is filled with random layers."""

    def __init__(self, seed):
        self.random = torch.Generator().manual_seed(seed)

    def draw(self, *shape):
        return torch.randn(*shape, generator=self.random)

    def conv(self, name, out, into, kernel=3):
        self[name + ".weight"] = self.draw(out, into, kernel, kernel) / (into * kernel**2) ** 0.5
        self[name + ".bias"] = 0.1 * self.draw(out)

    def norm(self, name, channels):
        self[name + ".weight"] = 1 + 0.2 * self.draw(channels)
        self[name + ".bias"] = 0.2 * self.draw(channels)
        self[name + ".running_mean"] = 0.1 * self.draw(channels)
        self[name + ".running_var"] = 0.5 + self.draw(channels).abs()
        self[name + ".num_batches_tracked"] = torch.tensor(7)

    def block(self, name, out, into, kernel=3):
        self.conv(name + ".conv", out, into, kernel)
        self.norm(name + ".norm", out)

    def hourglass(self, name, into, block_expansion, num_blocks, max_features, **_):
        width = [min(max_features, block_expansion * 2**i) for i in range(num_blocks + 1)]
        for i in range(num_blocks):
            self.block(f"{name}.encoder.down_blocks.{i}", width[i + 1], width[i] if i else into)
        for place, i in enumerate(reversed(range(num_blocks))):
            double = 1 if place == 0 else 2
            self.block(f"{name}.decoder.up_blocks.{place}", width[i], double * width[i + 1])
        return block_expansion + into

    def perceptron(self, name, widths):
        for i, (into, out) in enumerate(zip(widths, widths[1:], strict=False)):
            self[f"{name}.{3 * i}.weight"] = self.draw(out, into) / into**0.5
            self[f"{name}.{3 * i}.bias"] = 0.1 * self.draw(out)
            if i < len(widths) - 2:
                self.norm(f"{name}.{3 * i + 1}", out)


def low_pass(scale):
    sigma = (1 / scale - 1) / 2
    size = 2 * round(4 * sigma) + 1
    line = torch.exp(-((torch.arange(size) - (size - 1) / 2) ** 2) / (2 * sigma**2))
    kernel = line[:, None] * line
    return (kernel / kernel.sum()).expand(3, 1, size, size).clone()


def checkpoint():
    """Random weights under the names of a released checkpoint."""
    estimator, background, generator, avd = (Weights(seed) for seed in range(4))
    channels = estimator.hourglass("predictor", 3, **ESTIMATOR)
    estimator.conv("regions", REGIONS, channels, 7)
    estimator["regions.weight"] *= 3
    estimator["down.weight"] = low_pass(ESTIMATOR["scale_factor"])
    background.block("encoder.down_blocks.0", 10, 6)
    background.block("encoder.down_blocks.1", 16, 10)
    background["fc.weight"], background["fc.bias"] = 0.1 * torch.ones(2, 16), torch.zeros(2)
    flow = "pixelwise_flow_predictor"
    channels = generator.hourglass(f"{flow}.hourglass", 4 * (REGIONS + 1), **FLOW)
    generator.conv(f"{flow}.mask", REGIONS + 1, channels, 7)
    generator.conv(f"{flow}.occlusion", 1, channels, 7)
    generator[f"{flow}.down.weight"] = low_pass(FLOW["scale_factor"])
    generator.block("first", WIDTHS[0], 3, 7)
    for i, (into, out) in enumerate(zip(WIDTHS, WIDTHS[1:], strict=False)):
        generator.block(f"down_blocks.{i}", out, into)
        generator.block(f"up_blocks.{len(WIDTHS) - 2 - i}", into, out)
    for i in range(RESIDUAL):
        for part in (1, 2):
            generator.conv(f"bottleneck.r{i}.conv{part}", WIDTHS[-1], WIDTHS[-1])
            generator.norm(f"bottleneck.r{i}.norm{part}", WIDTHS[-1])
    generator.conv("final", 3, WIDTHS[0], 7)
    numbers = 6 * REGIONS
    avd.perceptron("id_encoder", [numbers, 256, 512, 1024, CODES[0]])
    avd.perceptron("pose_encoder", [numbers, 256, 512, 1024, CODES[1]])
    avd.perceptron("decoder", [sum(CODES), 1024, 512, 256, numbers])
    return {
        "generator": dict(generator),
        "region_predictor": dict(estimator),
        "bg_predictor": dict(background),
        "avd_network": dict(avd),
        "epoch_reconstruction": 99,
        "optimizer_reconstruction": {"state": {0: {"step": 3}}, "param_groups": [{"lr": 2e-4}]},
    }


def conv(x, w, name, padding=1):
    return F.conv2d(x, w[name + ".weight"], w[name + ".bias"], padding=padding)


def norm(x, w, name):
    mean, variance = w[name + ".running_mean"], w[name + ".running_var"]
    return F.batch_norm(x, mean, variance, w[name + ".weight"], w[name + ".bias"])


def block(x, w, name, padding=1):
    return F.relu(norm(conv(x, w, name + ".conv", padding), w, name + ".norm"))


def down(x, w, name):
    return F.avg_pool2d(block(x, w, name), 2)


def up(x, w, name):
    return block(F.interpolate(x, scale_factor=2), w, name)


def hourglass(x, w, name, blocks):
    levels = [x]
    for i in range(blocks):
        levels.append(down(levels[-1], w, f"{name}.encoder.down_blocks.{i}"))
    x = levels.pop()
    for i in range(blocks):
        x = torch.cat([up(x, w, f"{name}.decoder.up_blocks.{i}"), levels.pop()], 1)
    return x


def smaller(x, kernel, scale):
    step = round(1 / scale)
    return F.conv2d(x, kernel, padding=kernel.shape[-1] // 2, groups=3)[:, :, ::step, ::step]


def grid(height, width):
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([2 * x / (width - 1) - 1, 2 * y / (height - 1) - 1], -1)


def estimate(parts, image):
    """Shift, covariance and LAPACK's `U sqrt(S)` of images."""
    w = parts["region_predictor"]
    x = smaller(image, w["down.weight"], ESTIMATOR["scale_factor"])
    logits = conv(hourglass(x, w, "predictor", ESTIMATOR["num_blocks"]), w, "regions", 3)
    heat = (logits.flatten(2) / TEMPERATURE).softmax(2).view_as(logits)[..., None]
    z = grid(*logits.shape[2:])
    shift = (heat * z).sum((2, 3))
    away = z - shift[:, :, None, None]
    covariance = (heat[..., None] * away[..., None] * away[..., None, :]).sum((2, 3))
    u, s, _ = torch.linalg.svd(covariance)
    return shift, covariance, u * s.sqrt()[..., None, :]


def background(parts, source, driving):
    """The shift (B, 2) of the background."""
    w = parts["bg_predictor"]
    x = torch.cat([source, driving], 1)
    for i in range(2):
        x = down(x, w, f"encoder.down_blocks.{i}")
    return F.linear(x.mean((2, 3)), w["fc.weight"], w["fc.bias"])


def draw(parts, source, source_regions, driving_regions, moved):
    """Prediction (B, 3, H, W); `moved` (B, 2) is the shift of the background."""
    w = parts["generator"]
    small = smaller(source, w["pixelwise_flow_predictor.down.weight"], FLOW["scale_factor"])
    z = grid(*small.shape[2:])
    (mu_s, c_s, a_s), (mu_d, c_d, a_d) = source_regions, driving_regions

    def gauss(mu, c):
        away = (z - mu[:, :, None, None])[..., None]
        return torch.exp(-0.5 * (away.mT @ c.inverse()[:, :, None, None] @ away))[..., 0, 0]

    heat = gauss(mu_d, c_d) - gauss(mu_s, c_s)
    heat = torch.cat([torch.zeros_like(heat[:, :1]), heat], 1)[:, :, None]
    m = a_s @ a_d.inverse()
    m = m * m[..., :1, :1].sign()
    away = (z - mu_d[:, :, None, None])[..., None]
    motions = (m[:, :, None, None] @ away)[..., 0] + mu_s[:, :, None, None]
    motions = torch.cat([(z + moved[:, None, None])[:, None], motions], 1)
    copies = small.repeat_interleave(REGIONS + 1, 0)
    deformed = F.grid_sample(copies, motions.flatten(0, 1), align_corners=False)
    deformed = deformed.view(len(source), REGIONS + 1, 3, *small.shape[2:])
    stack = torch.cat([heat, deformed], 2).flatten(1, 2)
    x = hourglass(stack, w, "pixelwise_flow_predictor.hourglass", FLOW["num_blocks"])
    masks = conv(x, w, "pixelwise_flow_predictor.mask", 3).softmax(1)
    field = (masks[..., None] * motions).sum(1)
    seen = torch.sigmoid(conv(x, w, "pixelwise_flow_predictor.occlusion", 3))

    def warped(features, filled=None):
        size = features.shape[2:]
        flow = F.interpolate(field.permute(0, 3, 1, 2), size=size, mode="bilinear").movedim(1, -1)
        occlusion = F.interpolate(seen, size=size, mode="bilinear")
        moved = F.grid_sample(features, flow, align_corners=False) * occlusion
        return moved if filled is None else moved + filled * (1 - occlusion)

    levels = [block(source, w, "first", 3)]
    for i in range(len(WIDTHS) - 1):
        levels.append(down(levels[-1], w, f"down_blocks.{i}"))
    x = warped(levels[-1])
    for i in range(RESIDUAL):
        name = f"bottleneck.r{i}"
        y = conv(F.relu(norm(x, w, name + ".norm1")), w, name + ".conv1")
        x = x + conv(F.relu(norm(y, w, name + ".norm2")), w, name + ".conv2")
    for i in range(len(WIDTHS) - 1):
        x = up(warped(levels[-1 - i], x), w, f"up_blocks.{i}")
    painted = torch.sigmoid(conv(warped(levels[0], x), w, "final", 3))
    return warped(source, painted)


def disentangle(parts, body, pose):
    """Shift and affine of one person's body in another's pose."""
    w = parts["avd_network"]
    (mu_i, _, a_i), (mu_p, _, a_p) = body, pose
    a_i = a_i * (a_i @ a_p.inverse())[..., :1, :1].sign()

    def perceptron(x, name, layers=4):
        for i in range(layers):
            x = F.linear(x, w[f"{name}.{3 * i}.weight"], w[f"{name}.{3 * i}.bias"])
            if i < layers - 1:
                x = F.relu(norm(x, w, f"{name}.{3 * i + 1}"))
        return x

    def flat(mu, a):
        return torch.cat([mu, a.flatten(2)], 2).flatten(1)

    codes = [perceptron(flat(mu_p, a_p), "pose_encoder"), perceptron(flat(mu_i, a_i), "id_encoder")]
    numbers = perceptron(torch.cat(codes, 1), "decoder").view(len(mu_i), REGIONS, 6)
    return numbers[..., :2], numbers[..., 2:].unflatten(-1, (2, 2))
