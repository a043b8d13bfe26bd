import dataclasses
import json
import shutil

import pytest
import torch
from safetensors.torch import save_file

from angie.bundle import BUNDLE, Bundle
from angie.config import override, preset
from angie.parts import changed, describe, halve, hash_of_regions, load_weights
from angie.training import train
from data_prep.errors import BadInput

PARTS = ("renderer", "statistics", "angie.vq", "angie.gpt", "angie.refiner")


@pytest.fixture
def copy(bundle, tmp_path):
    """A copy of the trained bundle that a test may damage."""
    folder = tmp_path / "bundle"
    shutil.copytree(bundle.folder, folder, ignore=shutil.ignore_patterns("train"))
    return folder


def test_every_part_is_there_and_says_what_it_was_trained_on(copy):
    bundle = Bundle.open(copy)
    manifest = json.loads((copy / "bundle.json").read_text())
    assert all(bundle.has(part) for part in PARTS)
    assert bundle.needed() == list(PARTS)
    upstream = manifest["parts"]["angie.gpt"]["upstream"]
    assert upstream["angie.vq"] == manifest["parts"]["angie.vq"]["sha256"]
    assert manifest["config"] == json.loads(json.dumps(dataclasses.asdict(bundle.preset)))
    report = manifest["parts"]["renderer"]["report"]
    assert report["perceptual"] == "random_vgg+lap" and report["minutes"] > 0
    text = describe(bundle)
    assert "adam, bella" in text and "PSNR" in text


def test_parts_load_in_evaluation_mode(copy):
    bundle = Bundle.open(copy)
    generator, renderer = bundle.generator(), bundle.renderer()
    assert not renderer.training and not generator.gpt.training
    assert not any(p.requires_grad for p in renderer.parameters())


def test_a_changed_file_is_refused(copy):
    data = bytearray((copy / "angie.vq.safetensors").read_bytes())
    data[-1] ^= 1
    (copy / "angie.vq.safetensors").write_bytes(data)
    with pytest.raises(BadInput, match="wrong hash"):
        Bundle.open(copy).generator()


def test_a_missing_part_is_named(copy):
    (copy / "angie.gpt.safetensors").unlink()
    with pytest.raises(BadInput, match="gpt.safetensors: missing"):
        Bundle.open(copy).generator()
    assert "UNUSABLE" in describe(Bundle.open(copy))


def test_a_newer_format_is_refused(copy):
    manifest = json.loads((copy / "bundle.json").read_text())
    manifest["format"] += 1
    (copy / "bundle.json").write_text(json.dumps(manifest))
    with pytest.raises(BadInput, match="update angie"):
        Bundle.open(copy)


def test_a_part_trained_on_another_renderer_is_refused(copy):
    bundle = Bundle.open(copy)
    tensors = {
        k: v + 1 if v.is_floating_point() else v for k, v in bundle.renderer().state_dict().items()
    }
    bundle.add("renderer", tensors, {})
    assert not bundle.has("angie.vq")
    with pytest.raises(BadInput, match="trained on another renderer"):
        Bundle.open(copy).generator()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "damaged (Expecting value"),
        ("{", "damaged (Expecting property name"),
        ("[]", "an entry is of another kind"),
        ("{}", "lacks 'format'"),
        ('{"format": 1}', "lacks 'config'"),
        ('{"format": 2, "config": {}}', "lacks 'parts'"),
        ('{"format": 2, "config": {"hat": 1}, "parts": {}}', "hat: no such setting"),
        ('{"format": 2, "config": {}, "parts": {"renderer": {}}}', "renderer is not described"),
        ('{"format": "x"}', "an entry is of another kind"),
    ],
)
def test_a_damaged_manifest_is_one_line(copy, text, words):
    (copy / "bundle.json").write_text(text)
    with pytest.raises(BadInput) as error:
        Bundle.open(copy)
    assert words in str(error.value) and "\n" not in str(error.value)
    assert str(error.value).startswith(f"{copy / 'bundle.json'}: ")


def test_half_precision_loads_into_float32():
    layer = torch.nn.Linear(3, 2)
    stored = halve(layer.state_dict())
    assert stored["weight"].dtype == torch.float16 and stored["bias"].dtype == torch.float32
    other = torch.nn.Linear(3, 2)
    load_weights(other, stored)
    torch.testing.assert_close(other.weight, layer.weight, atol=1e-3, rtol=0)


def test_training_refuses_to_overwrite(dataset, copy, tmp_path):
    with pytest.raises(BadInput, match="--resume or start anew with --force"):
        train(dataset.path, copy)
    other = tmp_path / "other"
    other.mkdir()
    (other / "note.txt").write_text("mine")
    with pytest.raises(BadInput, match="holds other files"):
        train(dataset.path, other, preset=preset("tiny"))
    assert (other / "note.txt").exists()


def test_training_tells_wrong_arguments(dataset, copy, tmp_path):
    with pytest.raises(BadInput, match="--stage everything: choose from renderer, motion, avd, vq"):
        train(dataset.path, tmp_path / "new", stage="everything")
    with pytest.raises(BadInput, match="--generator none: there is no such generator"):
        train(dataset.path, tmp_path / "new", generator="none")
    with pytest.raises(BadInput, match="not a dataset"):
        train(tmp_path, tmp_path / "new")
    with pytest.raises(BadInput, match="made with --preset tiny"):
        train(dataset.path, copy, preset=preset("lite"), resume=True)
    with pytest.raises(BadInput, match="has no renderer yet"):
        train(dataset.path, tmp_path / "new", preset=preset("tiny"), stage="vq")


def test_settings_that_do_not_fit_the_parts_are_refused(copy):
    manifest = json.loads((copy / "bundle.json").read_text())
    manifest["config"]["renderer"]["temperature"] = 0.2
    (copy / "bundle.json").write_text(json.dumps(manifest))
    with pytest.raises(BadInput, match="renderer was trained with other settings"):
        Bundle.open(copy).renderer()


def test_a_part_trained_again_makes_those_after_it_train_again(dataset, bundle, tmp_path):
    folder = tmp_path / "bundle"
    shutil.copytree(bundle.folder, folder)
    train(dataset.path, folder, stage="vq", resume=True, seed=1)
    again = Bundle.open(folder)
    assert again.has("angie.vq") and not again.has("angie.gpt")
    assert again.hash_of("angie.vq") != bundle.hash_of("angie.vq")
    finished = train(dataset.path, folder, resume=True, seed=1)
    assert all(finished.has(part) for part in PARTS)
    assert finished.hash_of("renderer") == bundle.hash_of("renderer")
    assert finished.hash_of("angie.gpt") != bundle.hash_of("angie.gpt")


def test_resume_keeps_finished_stages(dataset, bundle, capsys):
    before = {part: bundle.hash_of(part) for part in PARTS}
    again = train(dataset.path, bundle.folder, resume=True)
    assert {part: again.hash_of(part) for part in PARTS} == before
    assert capsys.readouterr().err.count("done before") == 5


def test_settings_of_a_training_that_is_over_are_not_written_down(dataset, bundle):
    before = (bundle.folder / "bundle.json").read_bytes()
    for section, part in (("train_vq", "angie.vq"), ("train_renderer", "renderer")):
        changes = {section: {"rate": 0.5}} if section == "train_renderer" else {}
        changes = changes or {section: {"schedule": {"rate": 0.5}}}
        with pytest.raises(BadInput, match=f"{part} is trained already, with {section}"):
            train(dataset.path, bundle.folder, changes=changes, resume=True)
    assert (bundle.folder / "bundle.json").read_bytes() == before


def test_the_disentanglement_network_is_an_extra_part(dataset, bundle, tmp_path):
    folder = tmp_path / "bundle"
    shutil.copytree(bundle.folder, folder)
    assert not bundle.has("avd")
    settings = {"train_avd": {"schedule": {"most_steps": 20}}, "renderer": {"avd_id_width": 8}}
    trained = train(dataset.path, folder, stage="avd", changes=settings)
    assert trained.has("avd") and all(trained.has(part) for part in PARTS)
    assert trained.avd().id_encoder[-1].out_features == 8
    assert "recovery" in trained.manifest["parts"]["avd"]["report"]


def test_a_later_setting_counts_as_its_default_for_parts_from_before_it(copy):
    bundle = Bundle.open(copy)
    trained = bundle.manifest["parts"]["angie.gpt"]["settings"]
    assert trained == bundle.sizes_of("angie.gpt")
    del trained["gpt"]["joint"]  # False where it is not set
    assert changed("angie.gpt", trained, bundle.preset) == ""
    joint = override(bundle.preset, {"gpt": {"joint": True}})
    assert changed("angie.gpt", trained, joint) == "gpt.joint=False, not True"


def test_the_widths_of_avd_are_no_part_of_the_renderer(copy):
    bundle = Bundle.open(copy)
    wider = override(bundle.preset, {"renderer": {"avd_id_width": 8}})
    trained = bundle.manifest["parts"]["renderer"]["settings"]
    assert changed("renderer", trained, wider) == ""
    assert changed("avd", bundle.sizes_of("avd"), wider) == "renderer.avd_id_width=64, not 8"


def test_gpt_and_refiner_alone_depend_on_the_context_of_codes(copy):
    before, after = Bundle.open(copy), Bundle.open(copy)
    after.preset = override(after.preset, {"vq": {"context": "clip"}})
    different = [part for part in PARTS if before.sizes_of(part) != after.sizes_of(part)]
    assert different == ["angie.gpt", "angie.refiner"]


def test_codes_measured_in_another_context_are_refused(dataset, bundle, tmp_path):
    folder = tmp_path / "bundle"
    shutil.copytree(bundle.folder, folder)
    with pytest.raises(BadInput, match="not measured for vq.context=clip; --stage vq --resume"):
        train(dataset.path, folder, changes={"vq": {"context": "clip"}}, stage="gpt", resume=True)


def test_the_motion_of_one_speaker_alone(dataset, bundle, tmp_path):
    folder = tmp_path / "bundle"
    shutil.copytree(bundle.folder, folder)
    with pytest.raises(BadInput, match="--speaker zoe: .* has adam, bella"):
        train(dataset.path, folder, stage="motion", speaker="zoe")
    with pytest.raises(BadInput, match="measured on others"):
        train(dataset.path, folder, stage="vq", speaker="bella")
    alone = train(dataset.path, folder, stage="motion", speaker="bella")
    assert alone.statistics().speakers == ("bella",) and alone.manifest["speakers"] == ["bella"]
    report = alone.manifest["parts"]["statistics"]["report"]
    assert report["clips"] == len(dataset.clips("train", speaker="bella"))
    changes = {"train_vq": {"schedule": {"most_steps": 2}}}
    trained = train(dataset.path, folder, stage="vq", speaker="bella", changes=changes)
    assert trained.manifest["parts"]["angie.vq"]["report"]["clips"] == report["clips"]


@pytest.fixture
def shipped(tmp_path):
    """A copy of the bundle that ships."""
    shutil.copytree(BUNDLE, tmp_path / "shipped")
    return Bundle.open(tmp_path / "shipped")


def test_a_renderer_of_the_same_regions_takes_the_place_of_another(shipped):
    parts = shipped.manifest["parts"]
    before = shipped.hash_of("renderer")
    parts["statistics"]["upstream"] = {"renderer": before}  # as in format 2
    tensors = shipped.tensors("renderer")
    drawing = next(k for k in tensors if k.startswith("generator.") and k.endswith("weight"))
    shipped.add("renderer", {**tensors, drawing: tensors[drawing] * 1.5}, {})
    again = Bundle.open(shipped.folder)
    assert all(again.has(part) for part in PARTS) and again.generator() is not None
    assert again.hash_of("renderer") != before
    assert again.manifest["parts"]["statistics"]["upstream"] == {"regions": again.regions()}
    seeing = next(k for k in tensors if k.startswith("estimator.") and k.endswith("weight"))
    again.add("renderer", {**tensors, seeing: tensors[seeing] * 1.5}, {})
    with pytest.raises(BadInput, match="trained on another renderer with other regions"):
        again.statistics()


def test_the_hash_of_regions_is_one_of_numbers_not_of_their_precision(shipped, tmp_path):
    tensors = {
        k: v.float() for k, v in shipped.tensors("renderer").items() if v.is_floating_point()
    }
    save_file(tensors, tmp_path / "float32.safetensors")
    save_file(halve(tensors), tmp_path / "float16.safetensors")
    kinds = [hash_of_regions(tmp_path / f"{kind}.safetensors") for kind in ("float32", "float16")]
    assert kinds[0] == kinds[1]
