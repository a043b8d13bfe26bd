"""What the columns of the report mean: title, unit, direction, formula, source."""

from dataclasses import dataclass

from data_prep.rates import IMAGE_SIZE

HIGH, LOW, TRUTH = "higher is better", "lower is better", "nearest to the truth is best"


@dataclass(frozen=True)
class Definition:
    """One column.

    Attributes:
        key: its name in the files.
        title: its name in the tables.
        better: which values are better.
        unit: of the values; empty for a plain number.
        text: formula, constants and source.
        digits: after the point, in tables.
    """

    key: str
    title: str
    better: str
    unit: str
    text: str
    digits: int = 3


PIXEL = IMAGE_SIZE / 2
"""Pixels of one normalised unit."""

MOTION: tuple[Definition, ...] = (
    Definition("fgd", "FGD", LOW, "", "Frechet distance of 32 features of windows of 64 frames "
               "every 10 (TriCon's auto-encoder, trained on the training clips; see "
               "angie.metrics.autoencoder), against the windows of the true test motion. "
               "Motion vectors [mu; L] as displacement from the speaker's rest pose over its "
               "standard deviation.", 2),
    Definition("fgd_raw", "FGD raw", LOW, "", "Frechet distance of the flattened windows "
               "themselves on the first min(n / 10, 64) principal components of the true ones.", 1),
    Definition("bc", "BC", HIGH, "", "Beat consistency of HA2G: mean over onsets of "
               "exp(-d^2 / (2 (0.1 s)^2)), d to the nearest local minimum (by 0.03) of the mean "
               "step of the active regions, each over its mean in the training clips."),
    Definition("pmb", "PMB", HIGH, "%", "Percentage of matched beats of Rhythmic Gesticulator: "
               "motion beats less than 0.2 s from an onset of their own; onsets 0.2 s apart.", 1),
    Definition("align_aist", "Align AIST", HIGH, "", "Beat Align of AIST++: mean over motion "
               "beats of exp(-d^2 / (2 (0.05 s)^2)) to the nearest onset."),
    Definition("align_bailando", "Align Bailando", HIGH, "", "Beat Align of Bailando: the same "
               "mean over onsets, to the nearest minimum of the speed smoothed by 5/60 s."),
    Definition("diversity", "Diversity", HIGH, "", "Mean L1 distance of the features of up to 500 "
               "random pairs of windows of different clips, each window used once.", 2),
    Definition("diversity_ha2g", "Div HA2G", HIGH, "", "HA2G's released code: the first 500 "
               "features against 500 shuffled ones, L1.", 2),
    Definition("diversity_pairs", "Div pairs", HIGH, "", "Mean Euclidean distance of the features "
               "of all pairs of windows (Bailando, QPGesture).", 2),
    Definition("diversity_raw", "Div raw", HIGH, "", "The same of the flattened windows.", 1),
    Definition("hellinger", "Hellinger", LOW, "", "Hellinger distance of speed histograms (GENEA), "
               "60 bins up to the 99.5th percentile of the region's true speed, mean over "
               "regions."),
    Definition("hellinger_active", "Hellinger act.", LOW, "", "The same over the active regions."),
    Definition("acceleration", "Accel.", TRUTH, "1/s^2", "Mean norm of the second difference times "
               "fps^2, mean over clips.", 2),
    Definition("jerk", "Jerk", TRUTH, "1/s^3", "Mean norm of the third difference times fps^3, "
               "mean over clips.", 1),
    Definition("maje", "MAJE", LOW, "1/1000", "Mean absolute error of positions and coordinates "
               f"(TriCon) in thousandths of a normalised unit; {PIXEL:g} pixels are one unit.", 1),
    Definition("maje_px", "MAJE px", LOW, "px", "The same in pixels.", 2),
    Definition("mad", "MAD", LOW, "1/1000 s^2", "Mean norm of the difference of accelerations "
               "(Rhythmic Gesticulator), thousandths of a normalised unit.", 0),
    Definition("mad_px", "MAD px", LOW, "px/s^2", "The same in pixels.", 1),
    Definition("cca_global", "CCA global", HIGH, "", "First canonical correlation with the true "
               "positions over the frames of all clips (GENEA, QPGesture). Clips of different "
               "poses correlate by the poses: see the motionless row."),
    Definition("cca", "CCA", HIGH, "", "The same fitted to each clip, mean over clips."),
)  # fmt: skip

IMAGES: tuple[Definition, ...] = (
    Definition("l1", "L1", LOW, "", "Mean absolute error of pixels in [0, 1] (MRAA).", 4),
    Definition("perceptual", "Perceptual", LOW, "", "Distance of deep features over an image "
               "pyramid (MRAA); the report names the network.", 2),
    Definition("l1_drawn", "L1 drawn", LOW, "", "L1 against what the renderer draws from the "
               "recorded frames' own regions: the part of the motion, without what the renderer "
               "cannot draw.", 4),
    Definition("perceptual_drawn", "Perceptual drawn", LOW, "", "The perceptual distance to these "
               "drawn frames.", 2),
    Definition("ssim", "SSIM", HIGH, "", "Structural similarity (Wang et al. 2004)."),
    Definition("psnr", "PSNR", HIGH, "dB", "Peak signal-to-noise ratio, mean over frames.", 2),
    Definition("aed", "AED", LOW, "", "Mean absolute difference of identity embeddings (FOMM, "
               "MRAA), of a network trained on the training clips, or of your own.", 4),
    Definition("akd", "AKD regions", LOW, "px", "Mean absolute difference of the region centres "
               "that the estimator sees in the frame and in the recorded one.", 2),
    Definition("akd_joints", "AKD joints", LOW, "px", "Mean absolute difference of the phantom's "
               "true joints and those that a ridge regression reads from the regions seen in the "
               "frame; or of key points of your own detector.", 2),
    Definition("mkr", "MKR", LOW, "", "Share of key points that a detector finds in the recorded "
               "frame only (FOMM, MRAA); of a detector of your own, see --detected."),
    Definition("flicker", "Flicker", LOW, "", "Mean absolute difference between the change from "
               "one frame to the next and the true change.", 4),
)  # fmt: skip

SHORT = ("fgd", "bc", "pmb", "diversity", "hellinger", "maje_px", "cca_global")
"""Columns that the terminal shows."""

ALL = (*MOTION, *IMAGES)
