"""Motion that was saved, to be drawn again: on the same photo as it was, on another moved there."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from data_prep.arrays import read_arrays
from data_prep.errors import BadInput
from data_prep.rates import FPS
from mraa.avd import hull_scale
from mraa.motion import Motion, read_motion

_POSE = ("pose_shift", "pose_cholesky")


@dataclass(frozen=True)
class SavedMotion:
    """Region motion and the pose that it was made for.

    Attributes:
        motion: T frames, 25 a second.
        pose: of the photo that it was made for, one frame.
        regions: hash of the region estimator whose they are; "" where that is not known.
    """

    motion: Motion
    pose: Motion
    regions: str = ""

    def on(self, pose: Motion) -> Motion:
        """The same motion on another photo's person.

        As MRAA's relative motion (section 3.4), for Cholesky factors: shifts move by
        `s (mu - mu_0)`, s being the ratio of the persons' sizes, and factors become
        `L L_0^-1 L_photo`, which are lower triangular again.

        Args:
            pose: of the other photo, one frame. Of the same photo the motion stays as it is.
        """
        if torch.equal(pose.vector(), self.pose.vector()):
            return self.motion
        scale = hull_scale(pose.shift[0], self.pose.shift[0])
        shift = pose.shift + scale * (self.motion.shift - self.pose.shift)
        return Motion(shift, _relative(self.motion.cholesky, self.pose.cholesky, pose.cholesky))


def _relative(moved: torch.Tensor, start: torch.Tensor, source: torch.Tensor) -> torch.Tensor:
    """`L L_0^-1 L_s` of factors (T, K, 3), (1, K, 3) and (1, K, 3), as (l1, l2, l3)."""
    l1, l2, l3 = moved.unbind(-1)
    first1, first2, first3 = start.unbind(-1)
    own1, own2, own3 = source.unbind(-1)
    upper, lower = l1 / first1, l3 / first3
    slant = (l2 - lower * first2) / first1
    return torch.stack([upper * own1, slant * own1 + lower * own2, lower * own3], dim=-1)


def write_saved(path: Path, saved: SavedMotion) -> None:
    """Write .npz: `shift` (T, K, 2), `cholesky` (T, K, 3), the pose, `fps`, and the regions."""
    with Path(path).open("wb") as file:
        np.savez(
            file,
            shift=saved.motion.shift.numpy(),
            cholesky=saved.motion.cholesky.numpy(),
            pose_shift=saved.pose.shift.numpy(),
            pose_cholesky=saved.pose.cholesky.numpy(),
            fps=np.array(float(FPS)),
            regions=np.array(saved.regions),
        )


def load_motion(path: Path | str) -> SavedMotion:
    """Read motion that `GestureVideo.save_motion` or `angie gestures` wrote.

    The latter does not say for which pose it was made; its first frame is taken for it.

    Raises:
        BadInput: missing, or no motion of regions.
    """
    path = Path(path)
    motion = read_motion(path)
    try:
        arrays = read_arrays(path, (*_POSE, "fps", "regions"))
        fps = float(arrays.get("fps", np.array(FPS)))
        if fps != FPS:
            raise ValueError(f"{fps:g} frames a second, not {FPS}")
        pose = motion[:1]
        if all(name in arrays for name in _POSE):
            pose = Motion(*(torch.from_numpy(arrays[name].astype(np.float32)) for name in _POSE))
        if pose.frames != 1 or pose.regions != motion.regions or not pose.has_extent:
            raise ValueError(f"a pose of shape {tuple(pose.shift.shape)}")
        if not pose.vector().isfinite().all() or (pose.cholesky[..., ::2] <= 0).any():
            raise ValueError("a pose that cannot be")
    except (ValueError, TypeError, KeyError) as error:
        what = " ".join(str(error).split())
        raise BadInput(f"{path}: not saved motion ({what}); --save-motion writes it") from error
    return SavedMotion(motion, pose, str(arrays.get("regions", "")))
