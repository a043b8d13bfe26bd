"""Bundles from when there was ANGIE alone: the manifest that shipped then, with today's weights."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
from safetensors.torch import save_file

from angie.bundle import BUNDLE, Bundle
from angie.config import override, stored
from angie.parts import describe, halve
from data_prep.errors import BadInput
from data_prep.files import sha256
from mraa.renderer import GeneratorConfig, Renderer


@pytest.fixture
def old(tmp_path) -> Path:
    """The shipped bundle as format 1 had it, with an untrained renderer of the sizes of then."""
    folder = tmp_path / "old"
    folder.mkdir()
    for path in BUNDLE.glob("*.safetensors"):
        shutil.copy(path, folder / path.name.removeprefix("angie."))
    text = Path(__file__).with_name("format1.json").read_text()
    manifest = json.loads(text)
    sizes = stored({"renderer": manifest["config"]["renderer"]}).renderer
    save_file(halve(Renderer(sizes).state_dict()), folder / "renderer.safetensors")
    given = manifest["parts"]["renderer"]["sha256"]
    text = text.replace(given, sha256(folder / "renderer.safetensors"))
    (folder / "bundle.json").write_text(text)
    return folder


def change(folder: Path, section: str, **values) -> None:
    manifest = json.loads((folder / "bundle.json").read_text())
    manifest["config"][section] |= values
    (folder / "bundle.json").write_text(json.dumps(manifest))


def test_a_bundle_of_format_1_is_the_shipped_one(old):
    then, now = Bundle.open(old), Bundle.open(BUNDLE)
    assert then.settings("angie") == now.settings("angie")
    assert then.preset.renderer.generator == GeneratorConfig("deep", width=128)  # none is stored
    generator = now.preset.renderer.generator
    assert dataclasses.replace(then.preset.renderer, generator=generator) == now.preset.renderer
    assert then.needed() == now.needed() and all(then.has(part) for part in then.needed())
    then.renderer()
    for part in then.needed()[1:]:
        assert then.hash_of(part) == now.hash_of(part)
        before, after = (dict(b.manifest["parts"][part]["upstream"]) for b in (then, now))
        for other in (before, after):  # the renderer is another, and may be named by its regions
            other.pop("renderer", other.pop("regions", None))
        assert before == after
        assert then.report(part) == now.report(part)
    assert "audio_sensitivity" in then.report("angie.gpt")
    assert then.generator().chunked == now.generator().chunked


def test_it_is_written_as_format_3_and_stays_whole(old):
    bundle = Bundle.open(old)
    bundle.preset = override(bundle.preset, {"train_gpt": {"patience": 7}})
    bundle.write()
    manifest = json.loads((old / "bundle.json").read_text())
    assert manifest["format"] == 3 and "vq" not in manifest["config"]
    again = Bundle.open(old)
    assert all(again.has(part) for part in again.needed())
    assert "format      1, made by" in describe(bundle) and "format      3," in describe(again)
    assert again.settings("angie").train_gpt.patience == 7
    assert again.settings("angie").train_vq.path_loss == 0.3  # it was called summed


def test_a_setting_that_is_gone_is_read_at_its_default_alone(old):
    assert "mfcc_encoder" in json.loads((old / "bundle.json").read_text())["config"]["refiner"]
    change(old, "refiner", mfcc_encoder="conv")
    with pytest.raises(BadInput, match="refiner.mfcc_encoder=conv is no longer supported"):
        Bundle.open(old)
