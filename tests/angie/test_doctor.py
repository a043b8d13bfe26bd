"""The doctor looks at this machine, and says what to do."""

import shutil

from angie.bundle import BUNDLE
from angie.doctor import findings


def test_a_whole_machine_needs_nothing():
    found = {one.name: one for one in findings()}
    assert set(found) >= {"Python", "torch", "devices", "threads", "codecs", "disk", "bundle"}
    assert "renderer" in found["bundle"].found and "20 regions" in found["models"].found
    assert float(found["speed"].found.split()[0]) > 0
    assert found["codecs"].advice == found["bundle"].advice == ""


def test_a_damaged_bundle_is_told(tmp_path):
    shutil.copytree(BUNDLE, tmp_path / "bundle")
    part = tmp_path / "bundle" / "angie.gpt.safetensors"
    part.write_bytes(part.read_bytes()[:-1] + b"x")
    found = {one.name: one for one in findings(tmp_path / "bundle")}
    assert "wrong hash" in found["bundle"].found and "train it again" in found["bundle"].advice
    assert "speed" not in found
