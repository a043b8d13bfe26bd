"""Released checkpoints through `angie import-mraa`: golden outputs, other sizes, bad files."""

import json
import pickle
import sys
from pathlib import Path

import plain_mraa as plain
import pytest
import torch
import yaml
from safetensors.torch import load_file

from angie.bundle import Bundle
from angie.cli import main
from angie.generators.angie.family import FAMILY
from angie.training import _chosen
from mraa.avd import relative_regions
from mraa.released import read_checkpoint
from mraa.released_sizes import config_from_released, params_from_tensors

GOLDEN = Path(__file__).resolve().parents[2].parent / "shared" / "golden"
with_golden = pytest.mark.skipif(not GOLDEN.is_dir(), reason="no golden files beside the project")


def call(capsys, *arguments):
    """Exit status, standard output and standard error of `angie ARGUMENTS`."""
    status = 0
    old, sys.argv = sys.argv, ["angie", *map(str, arguments)]
    try:
        main()
    except SystemExit as leave:
        status = leave.code or 0
    finally:
        sys.argv = old
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def close(found, wanted, tolerance):
    assert found.shape == wanted.shape
    assert float((found - wanted).abs().max()) <= tolerance


@with_golden
@torch.no_grad()
def test_golden_outputs_of_an_imported_bundle(tmp_path, capsys):
    status, out, err = call(
        capsys, "import-mraa", GOLDEN / "mraa_small.pth", "-o", tmp_path / "bundle"
    )
    assert status == 0 and out == f"{tmp_path / 'bundle'}: renderer, avd\n"
    assert "5 regions" in err and "temperature 0.1, pad 0" in err and "their terms" in err
    bundle = Bundle.open(tmp_path / "bundle")
    renderer, avd = bundle.renderer(), bundle.avd()
    io = load_file(GOLDEN / "mraa_small.io.safetensors")
    source, driving = renderer.estimator(io["in.source"]), renderer.estimator(io["in.driving"])
    for name, found in (("source", source), ("driving", driving)):
        close(found.shift, io[f"out.{name}_regions.shift"], 1e-4)
        close(found.covariance, io[f"out.{name}_regions.covar"], 1e-4)
        close(found.affine, io[f"out.{name}_regions.affine"], 1e-4)
        close(found.heatmap, io[f"out.{name}_regions.heatmap"], 1e-6)
    background = renderer.background(io["in.source"], io["in.driving"])
    close(background, io["out.bg"], 1e-4)
    prediction, flow = renderer(io["in.source"], source, driving, background)
    close(flow.flow, io["out.optical_flow"], 1e-4)
    close(flow.occlusion, io["out.occlusion_map"], 1e-4)
    close(prediction, io["out.prediction"], 1e-4)
    still = renderer(io["in.source"], source, driving, None)[0]
    close(still, io["out.prediction_static_background"], 1e-4)
    moved = relative_regions(source[:1], driving[:1], driving[1:])
    close(moved.shift, io["out.relative.shift"], 1e-4)
    close(moved.affine, io["out.relative.affine"], 1e-4)
    # the output hardly depends on the pose: with other signs of A it is off by 7e-6
    moved = avd(source, driving)
    close(moved.shift, io["out.avd.shift"], 1e-6)
    close(moved.affine, io["out.avd.affine"], 1e-6)
    close(moved.covariance, io["out.avd.covar"], 1e-6)


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A checkpoint of other sizes and its configuration."""
    folder = tmp_path_factory.mktemp("other")
    torch.save(plain.checkpoint(), folder / "other.pth", _use_new_zipfile_serialization=False)
    whole = {"dataset_params": {"frame_shape": [64, 64, 3]}, "model_params": plain.CONFIG}
    (folder / "other.yaml").write_text(yaml.safe_dump(whole))
    return folder


@torch.no_grad()
def test_other_sizes_agree_with_a_plain_reference(other, tmp_path, capsys):
    status, _, err = call(
        capsys,
        *("import-mraa", other / "other.pth", "--config", other / "other.yaml"),
        *("-o", tmp_path / "bundle", "--preset", "tiny"),
    )
    assert status == 0 and "20 regions" in err and "trained on images of 64 pixels" in err
    bundle = Bundle.open(tmp_path / "bundle")
    renderer, avd, parts = bundle.renderer(), bundle.avd(), plain.checkpoint()
    config = bundle.preset.renderer
    assert (config.regions, config.heatmap_padding, config.temperature) == (20, 3, 0.2)
    assert (config.background_kind, config.generator.down_blocks) == ("shift", 3)
    random = torch.Generator().manual_seed(5)
    source, driving = torch.rand(2, 2, 3, 64, 64, generator=random)
    ours = [renderer.estimator(x) for x in (source, driving)]
    theirs = [plain.estimate(parts, x) for x in (source, driving)]
    for found, wanted in zip(ours, theirs, strict=True):
        close(found.shift, wanted[0], 1e-4)
        close(found.covariance, wanted[1], 1e-4)
        close(found.affine, wanted[2], 1e-4)
    shift = plain.background(parts, source, driving)
    background = renderer.background(source, driving)
    close(background[:, :2, 2], shift, 1e-4)
    assert float(shift.abs().max()) > 0.01
    prediction = renderer(source, *ours, background)[0]
    close(prediction, plain.draw(parts, source, *theirs, shift), 1e-4)
    still = renderer(source, *ours, None)[0]
    close(still, plain.draw(parts, source, *theirs, 0 * shift), 1e-4)
    assert float((still - prediction).abs().max()) > 1e-2
    moved = avd(*ours)
    shift, affine = plain.disentangle(parts, *theirs)
    close(moved.shift, shift, 1e-4)
    close(moved.affine, affine, 1e-4)
    turned = [(mu, c, a * torch.tensor([1.0, -1.0])) for mu, c, a in theirs]  # det U = 1
    assert float((plain.disentangle(parts, *turned)[0] - shift).abs().max()) > 1e-2


@with_golden
@pytest.mark.parametrize("name", ["paper_k20", "taichi256", "ted384", "vox256"])
def test_sizes_are_read_off_the_tensors(name):
    keys = json.loads((GOLDEN / f"mraa_{name}.keys.json").read_text())
    parts = {
        part: {key: torch.empty(shape, device="meta") for key, shape in tensors.items()}
        for part, tensors in keys["tensors"].items()
    }
    found = config_from_released(params_from_tensors(parts))
    wanted = config_from_released(keys["config"]["model_params"])
    assert found.generator.max_width == 256  # 512 are allowed, 256 are there
    params = keys["config"]["model_params"]
    params["generator_params"]["max_features"] = 256
    assert found == config_from_released(params) != wanted


def test_without_a_config_what_the_tensors_show_is_right(other):
    found = params_from_tensors(read_checkpoint(other / "other.pth"))
    for section in ("region_predictor_params", "bg_predictor_params", "generator_params"):
        for key, value in plain.CONFIG[section].items():
            if key not in ("temperature", "pad", "pixelwise_flow_predictor_params"):
                assert found[section][key] == value, (section, key)
    flow = found["generator_params"]["pixelwise_flow_predictor_params"]
    assert flow == plain.FLOW and found["num_regions"] == 20
    assert found["avd_network_params"] == plain.CONFIG["avd_network_params"]


class Hostile:
    def __reduce__(self):
        return (Path("/tmp/angie-was-here").touch, ())


def bad_files(folder, other):
    good = plain.checkpoint()
    data = (other / "other.pth").read_bytes()
    (folder / "cut.pth").write_bytes(data[: len(data) // 2])
    (folder / "text.pth").write_text("no checkpoint")
    (folder / "empty.pth").touch()
    (folder / "hostile.pth").write_bytes(pickle.dumps({"generator": Hostile()}))
    (folder / "folder.pth").mkdir()
    torch.save([1, 2], folder / "list.pth")
    torch.save({"generator": good["generator"], "kp_detector": {}}, folder / "fomm.pth")
    torch.save({**good, "generator": 3}, folder / "number.pth")
    broken = dict(good["generator"])
    del broken["up_blocks.1.conv.bias"]
    torch.save({**good, "generator": broken}, folder / "lacking.pth")
    wrong = {**good["generator"], "first.conv.weight": torch.zeros(8, 4, 7, 7)}
    torch.save({**good, "generator": wrong}, folder / "shape.pth")
    wrong = {**good["generator"], "first.conv.bias": torch.full((8,), float("nan"))}
    torch.save({**good, "generator": wrong}, folder / "nan.pth")
    wrong = {**good["region_predictor"], "jacobian.weight": torch.zeros(4, 9, 7, 7)}
    torch.save({**good, "region_predictor": wrong}, folder / "jacobian.pth")
    endless = {**good["region_predictor"], "regions.bias": torch.zeros(1).expand(10**12)}
    torch.save({**good, "region_predictor": endless}, folder / "endless.pth")


@pytest.fixture(scope="module")
def bad(other, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    bad_files(folder, other)
    return folder


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing.pth", "no such file"),
        ("folder.pth", "is a folder"),
        ("cut.pth", "not a readable checkpoint"),
        ("text.pth", "not a readable checkpoint"),
        ("empty.pth", "is empty"),
        ("hostile.pth", "not a readable checkpoint"),
        ("list.pth", "it is a list"),
        ("fomm.pth", "has no region_predictor"),
        ("number.pth", "generator: is not a table"),
        ("lacking.pth", "up_blocks.1.conv.bias"),
        ("shape.pth", "first.conv.weight"),
        ("nan.pth", "not finite"),
        ("jacobian.pth", "jacobian.weight"),
        ("endless.pth", "more values than it has"),
    ],
)
def test_bad_checkpoints_are_one_line(bad, tmp_path, capsys, name, words):
    status, out, err = call(capsys, "import-mraa", bad / name, "-o", tmp_path / "bundle")
    assert status == 2 and out == "" and words in err and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [] and not Path("/tmp/angie-was-here").exists()


def changed(**values):
    config = json.loads(json.dumps(plain.CONFIG))
    for key, value in values.items():
        section, _, name = key.partition("__")
        (config[section] if name else config)[name or section] = value
    return yaml.safe_dump(config)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: [", "no YAML"),
        ("train_params: {}", "not a configuration of MRAA"),
        (changed(num_regions=10), "num_regions 10, the tensors 20"),
        (changed(region_predictor_params__pca_based=False), "pca_based"),
        (changed(region_predictor_params__temperature="warm"), "temperature"),
        (changed(region_predictor_params__temperature=-1), "must be positive"),
        (changed(region_predictor_params__pad=2.5), "pad"),
        (changed(generator_params=3), "has no pixelwise_flow_predictor_params"),
        (changed(bg_predictor_params__bg_type="affine"), "bg_type affine, the tensors shift"),
    ],
)
def test_bad_configurations_are_one_line(other, tmp_path, capsys, text, words):
    config = tmp_path / "config.yaml"
    config.write_text(text)
    status, out, err = call(
        capsys, *("import-mraa", other / "other.pth", "-o", tmp_path / "bundle", "--config", config)
    )
    assert status == 2 and out == "" and words in err and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [config]


@pytest.fixture
def imported(other, tmp_path, capsys):
    where = tmp_path / "bundle"
    call(
        capsys,
        *("import-mraa", other / "other.pth", "--config", other / "other.yaml"),
        *("-o", where, "--preset", "tiny"),
    )
    return where


def test_an_imported_bundle_tells_what_it_lacks(imported, tmp_path, capsys):
    status, out, _ = call(capsys, "info", imported)
    assert status == 0 and "imported from other.pth, whose authors' terms" in out
    bundle = Bundle.open(imported)
    assert _chosen("vq", bundle, FAMILY) == ["motion", "vq"]
    assert _chosen("all", bundle, FAMILY) == ["renderer", "motion", "vq", "gpt", "refiner"]
    photo, speech = (Path("angie/default") / name for name in ("photo.png", "speech.flac"))
    status, _, err = call(
        capsys, "animate", photo, speech, "-o", tmp_path / "x.mp4", "--speaker", imported
    )
    assert status == 2 and err.count("\n") == 1
    assert "--resume trains what it lacks (motion, vq, gpt, refiner)" in err
    assert not (tmp_path / "x.mp4").exists()


@pytest.mark.slow
def test_an_imported_bundle_takes_the_stages_it_lacks(dataset, imported, capsys):
    few = ["train_vq.schedule.most_steps=3", "train_gpt.schedule.most_steps=3"]
    few += ["train_refiner.schedule.most_steps=3", "train_gpt.checks=1", "train_refiner.checks=1"]
    before = Bundle.open(imported).hash_of("renderer")
    status, _, _ = call(capsys, "train", dataset.path, "-o", imported, "--stage", "vq", *few)
    bundle = Bundle.open(imported)
    assert status == 0 and bundle.has("statistics") and bundle.has("angie.vq") and bundle.has("avd")
    status, _, err = call(capsys, "train", dataset.path, "-o", imported, "--resume")
    assert status == 0 and "renderer: done before" in err and "vq: done before" in err
    bundle = Bundle.open(imported)
    assert bundle.has("refiner") and bundle.hash_of("renderer") == before
    assert bundle.manifest["speakers"] == dataset.speakers()
