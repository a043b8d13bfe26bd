"""What a speaker bundle holds, in words."""

from collections.abc import Iterator
from typing import Any

from angie.bundle import Bundle
from angie.generators import family
from angie.parts import OPTIONAL, UPSTREAM, stage_of, stage_options
from data_prep.errors import BadInput


def describe(bundle: Bundle) -> str:
    """Several lines: preset, speakers, and each part with its state, data and score."""
    manifest = bundle.manifest
    points = bundle.preset.points
    what = f"{bundle.preset.renderer.regions} {'joints' if points else 'regions'}"
    size = "" if points else f"{manifest['size']}x{manifest['size']} "
    lines = [
        f"bundle      {bundle.folder}",
        f"format      {manifest['format']}, made by angie {manifest['angie']}",
        f"preset      {manifest['preset']}: {what}, {size}at {manifest['fps']} fps",
        f"speakers    {', '.join(manifest['speakers']) or 'none yet'}",
    ]
    for name in bundle.generators:
        lines += [f"{label:<12}{text}" for label, text in _generator(bundle, name)]
    for part in bundle.parts:
        lines.append(f"{part:<14}{_state(bundle, part)}")
    return "\n".join(lines)


def _generator(bundle: Bundle, name: str) -> Iterator[tuple[str, str]]:
    """A generator of the bundle, and the styles that it tells apart."""
    try:
        found, settings = family(name), bundle.settings(name)
    except BadInput as error:
        yield "generator", f"{name}: {error}"
        return
    yield "generator", f"{name}: {found.title}"
    if bundle.has("statistics"):
        styles = found.styles(settings, bundle.statistics())
        if styles:
            yield "styles", f"{', '.join(styles)} (--style NAME)"


def _state(bundle: Bundle, part: str) -> str:
    entry = bundle.manifest["parts"].get(part)
    if entry is None and part in OPTIONAL:
        return f"none (optional); angie train {stage_options(part)} makes it"
    if entry is None:
        return f"missing; angie train {stage_options(part)} makes it"
    try:
        bundle.path_of(part)
    except BadInput as error:
        return f"UNUSABLE: {error}"
    report: dict[str, Any] = entry["report"]
    words = [f"{entry['sha256'][:12]}"]
    if "dataset" in report:
        words.append(f"{report['minutes']} min in {report['clips']} clips of {report['dataset']}")
    if "imported" in report:
        words.append(f"imported from {report['imported']}, whose authors' terms hold for it")
    if "perceptual" in report:
        words.append(f"perceptual loss {report['perceptual']}")
    if "reconstruction" in report:
        score = report["reconstruction"]
        words.append(
            f"held-out L1 {score['l1']:.4f} (copy {score['copy_l1']:.4f}), "
            f"PSNR {score['psnr']:.2f} dB (copy {score['copy_psnr']:.2f})"
        )
        if "ssim" in score:  # bundles from before it was measured lack it
            words.append(
                f"SSIM {score['ssim']:.4f} (copy {score['copy_ssim']:.4f}), "
                f"perceptual by {score['backend']} {score['perceptual']:.2f} "
                f"(copy {score['copy_perceptual']:.2f})"
            )
    if "recovery" in report:
        score = report["recovery"]
        words.append(
            "held-out pose of a body of other size: shift off by "
            f"{score['shift']:.4f} (as given {score['given_shift']:.4f}), affine by "
            f"{score['affine']:.4f} (as given {score['given_affine']:.4f})"
        )
    if part not in UPSTREAM:
        found, stage = stage_of(part)
        words += found.report(stage.name, report, bundle.settings(found.name))
    return "; ".join(words)
