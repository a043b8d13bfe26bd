"""The ablations: variants trained on one renderer, scored, in a table."""

import json
import shutil
import sys
from functools import partial

import pytest
import torch

from angie.bundle import BUNDLE, Bundle
from angie.cli import main
from angie.config import parse_overrides, preset
from angie.evaluation.ablation import _copy_motion, ablate, settings_of
from angie.evaluation.networks import EvaluationConfig
from angie.evaluation.table3 import MOTION, PICTURES, SOUND, Trained, tables
from angie.generators.angie.report import broken_share
from angie.generators.angie.settings import VARIANTS
from angie.generators.angie.tokenizer import DirectMotion
from data_prep.errors import BadInput
from mraa.training.run import RunConfig

FEW_SETTINGS = [
    "train_vq.schedule.most_steps=4",
    "train_gpt.schedule.most_steps=4",
    "train_refiner.schedule.most_steps=4",
]
FEW = parse_overrides(FEW_SETTINGS)
SCORING = EvaluationConfig(images=False, videos_shown=0, fgd_steps=5)
CPU = RunConfig(device="cpu")


def run(dataset, bundle, output, variants):
    return ablate(
        dataset.path, bundle.folder, output, variants=variants, changes=FEW, config=SCORING, run=CPU
    )


@pytest.fixture(scope="module")
def made(dataset, bundle, tmp_path_factory):
    output = tmp_path_factory.mktemp("ablation") / "out"
    return output, run(dataset, bundle, output, ["no_quant", "no_cholesky", "no_refine"])


def test_every_variant_is_a_bundle_on_one_renderer(made, bundle):
    output, _ = made
    bundles = {path.name: Bundle.open(path) for path in output.iterdir() if path.name[:2] == "no"}
    assert set(bundles) == {"no_quant", "no_cholesky", "no_refine"}
    assert {one.hash_of("renderer") for one in bundles.values()} == {bundle.hash_of("renderer")}
    direct = bundles["no_quant"].generator()
    assert isinstance(direct.vq, DirectMotion) and direct.gpt is None
    assert bundles["no_quant"].parts == [
        "renderer",
        "statistics",
        "angie.vq",
        "angie.refiner",
        "avd",
    ]
    assert bundles["no_cholesky"].generator().channels.covariance
    plain, full = bundles["no_refine"], Bundle.open(output / "full")
    assert not plain.settings("angie").generation.refine
    assert full.settings("angie").generation.refine
    assert all(plain.hash_of(part) == full.hash_of(part) for part in full.needed())


def test_the_table_has_a_row_for_each_and_those_of_reference(made):
    output, text = made
    rows = [line.split("|")[1].strip() for line in text.splitlines()[4:]]
    assert rows[-3:] == ["no_quant", "no_cholesky", "no_refine"]
    assert {"motionless", "nearest audio"} < set(rows)
    assert "FGD | FGD raw" in text and (output / "table3.md").read_text() == text + "\n"
    results = json.loads((output / "report" / "results.json").read_text())
    scores = {row["name"]: row["scores"] for row in results["spaces"][0]["rows"]}
    assert f"{scores['no_quant']['fgd']['mean']:.2f}" in text
    assert text.splitlines()[-3].endswith("| vq 8, refiner 4 |")  # as many as VQ and GPT together
    assert text.splitlines()[-1].endswith("| vq 4, gpt 4, refiner 4 |")


def test_a_repeated_run_goes_on_and_another_one_is_refused(made, dataset, bundle):
    output, _ = made
    before = {name: Bundle.open(output / name).manifest for name in ("no_quant", "full")}
    run(dataset, bundle, output, ["no_quant"])
    for name, manifest in before.items():
        assert Bundle.open(output / name).manifest == manifest
    with pytest.raises(BadInput, match="other settings"):
        ablate(dataset.path, bundle.folder, output, variants=["full"], run=CPU)


def command(monkeypatch, capsys, *arguments):
    """Exit status, standard output and standard error of `angie ablate ARGUMENTS`."""
    monkeypatch.setattr(sys, "argv", ["angie", "ablate", *map(str, arguments)])
    status = 0
    try:
        main()
    except SystemExit as leave:
        status = leave.code
    return status, *capsys.readouterr()


def test_the_command_takes_a_stride_of_images_and_a_stored_auto_encoder(
    made, dataset, bundle, tmp_path, monkeypatch, capsys
):
    output, _ = made
    report = output / "report"
    stored = shutil.copy(report / "fgd-0.safetensors", tmp_path / "stored.safetensors")
    before = json.loads((report / "results.json").read_text())
    choices = []

    def unscored(judge, data, clips, drivers, joints, choice, advance):  # to draw takes a minute
        choices.append((choice.stride, choice.seconds))
        return {}

    monkeypatch.setattr("angie.evaluation.evaluate.score_pictures", unscored)
    quick = partial(EvaluationConfig, aed_steps=2)  # no option of the command
    monkeypatch.setattr("angie.evaluation.networks.EvaluationConfig", quick)
    status, out, _ = command(
        monkeypatch, capsys, dataset.path, bundle.folder, *FEW_SETTINGS, "-o", output,
        *("--variants", "no_quant", "--image-stride", 60, "--image-seconds", 4, "--fgd", stored),
    )  # fmt: skip
    after = json.loads((report / "results.json").read_text())
    assert status == 0 and (report / "fgd-0.safetensors").read_bytes() == stored.read_bytes()
    scores = [
        next(row["scores"] for row in numbers["spaces"][0]["rows"] if row["name"] == "no_quant")
        for numbers in (before, after)
    ]
    assert scores[0]["fgd"] == scores[1]["fgd"]
    assert choices == [(60, 4.0)]
    assert after["spaces"][0]["images"]["about"].startswith(
        "Every 60th frame and the one after it in the first 4 s"
    )
    assert any(line.startswith("| no_quant | ") for line in out.splitlines())


def test_bad_strides_and_auto_encoders_are_told_before_anything_is_trained(
    made, dataset, bundle, tmp_path, monkeypatch, capsys
):
    stored = made[0] / "report" / "fgd-0.safetensors"
    text = tmp_path / "text"
    text.write_text("no auto-encoder")
    for source, options, words in (
        (bundle.folder, ["--image-stride", 1], "--image-stride"),
        (bundle.folder, ["--fgd", tmp_path / "none"], "no such file"),
        (bundle.folder, ["--fgd", text], "text: is not an autoencoder"),
        (BUNDLE, ["--fgd", stored], "regions of another renderer"),
    ):
        status, out, err = command(
            monkeypatch, capsys, dataset.path, source, "-o", tmp_path / "out", *options
        )
        assert status == 2 and out == "" and words in err and err.count("\n") == 1, err
    assert [path.name for path in tmp_path.iterdir()] == ["text"]


def test_summed_covariances_break_and_factors_do_not(made, dataset):
    output, _ = made
    from angie.evaluation.space import open_space

    variant, full = Bundle.open(output / "no_cholesky"), Bundle.open(output / "full")
    clips = open_space(dataset, full, output / "scratch", "cpu").test
    assert broken_share(full.generator(), clips) == 0
    generator = variant.generator()
    assert 0 <= broken_share(variant.generator(), clips) <= 1
    wild = torch.randn(50, 5 * generator.statistics.regions) * 50
    start = clips[0].motion[:1].vector()[0]
    assert generator.channels.broken(wild, start).any()
    assert not full.generator().channels.broken(wild, start).any()


def test_bad_requests(dataset, bundle, tmp_path):
    bare = Bundle.create(tmp_path / "bare", preset("tiny"))
    with pytest.raises(BadInput, match="renderer"):
        run(dataset, bare, tmp_path / "out", ["full"])
    shutil.rmtree(bare.folder)
    with pytest.raises(BadInput, match="choose from no_quant"):
        run(dataset, bundle, tmp_path / "out", ["half"])
    torn = tmp_path / "torn"
    torn.mkdir()
    (torn / "ablation.json").write_text("{")
    with pytest.raises(BadInput, match="torn: holds ablations of other settings"):
        run(dataset, bundle, torn, ["full"])
    shutil.rmtree(torn)
    (tmp_path / "text").write_text("keep me")
    with pytest.raises(BadInput, match="other files"):
        run(dataset, bundle, tmp_path, ["full"])
    assert [path.name for path in tmp_path.iterdir()] == ["text"]


def test_weights_that_the_renderer_began_with_are_not_needed(dataset, tmp_path):
    with pytest.raises(BadInput, match="other files"):  # and not: no such weights
        (tmp_path / "text").touch()
        ablate(dataset.path, BUNDLE, tmp_path, variants=["full"], run=CPU)


def test_regions_are_measured_once_for_all_variants(tmp_path):
    for name in ("mu_L", "full"):
        (tmp_path / name).mkdir()
    _copy_motion(tmp_path / "mu_L")  # the first one has to measure them
    assert not (tmp_path / "mu_L" / "train").exists()
    (tmp_path / "mu_L" / "train" / "motion").mkdir(parents=True)
    (tmp_path / "mu_L" / "train" / "motion" / "a.npz").write_bytes(b"motion")
    _copy_motion(tmp_path / "full")
    assert (tmp_path / "full" / "train" / "motion" / "a.npz").read_bytes() == b"motion"
    _copy_motion(tmp_path / "full")  # and is left alone


def test_a_variant_is_one_setting():
    base = preset("paper")
    for name in VARIANTS:
        made = settings_of(base, name).settings("angie")
        quant = "full" if name in ("no_refine", "paper_loss") else name
        assert (made.vq.quant, made.generation.refine) == (quant, name != "no_refine")
        streams = 3 if name == "naive" else 2
        assert (made.vq.streams, made.gpt.streams, made.refiner.streams) == (streams, streams, 2)
    lite = preset("lite")
    assert settings_of(lite, "no_quant").settings("angie").train_gpt.schedule.most_steps == 7800
    assert settings_of(lite, "paper_loss").settings("angie").train_refiner.velocity == 0


def test_the_tables_of_hand_made_numbers():
    def row(name, keys, value):
        return {"name": name, "scores": {key: {"mean": value} for key in keys}}

    keys = (*MOTION, *PICTURES)
    sound = [row(f"{name}, from sound", SOUND, 7.0) for name in ("full", "full-1")]
    drawn = [row(n, PICTURES, v) for n, v in (("still", 9.0), ("full", 1.0), ("full-1", 3.0))]
    motion = [row(n, MOTION, v) for n, v in (("still", None), ("full", 1.0), ("full-1", 3.0))]
    numbers = {
        "definitions": [{"key": key, "title": key.upper(), "digits": 1} for key in keys],
        "spaces": [{"rows": motion, "images": {"rows": [*drawn, *sound]}}],
    }
    trained = Trained(["full", "full-1"], {"cannot be drawn": 0.25}, {"vq": 3000, "gpt": 700})
    lines = tables(numbers, None, {"full": trained}).splitlines()
    # over two trainings: mean 2, half interval 12.706 * 1.414 / 1.414
    pair = "2.0 ± 12.7"
    assert lines == [
        "Motion from the sound", "",
        "|  | FGD | FGD_RAW | BC | PMB | DIVERSITY_HA2G | JERK | cannot be drawn | steps |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        "| still | - | - | - | - | - | - | - | - |",
        f"| full | {' | '.join([pair] * 6)} | 25.0 % | vq 3000, gpt 700 |", "",
        "Pictures of whole clips", "",
        "|  | L1 | PERCEPTUAL | AED | L1_DRAWN | PERCEPTUAL_DRAWN | L1, from sound | "
        "PERCEPTUAL, from sound | AED, from sound |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        "| still | 9.0 | 9.0 | 9.0 | 9.0 | 9.0 | - | - | - |",
        f"| full | {' | '.join([pair] * 5)} | 7.0 ± 0.0 | 7.0 ± 0.0 | 7.0 ± 0.0 |",
    ]  # fmt: skip
