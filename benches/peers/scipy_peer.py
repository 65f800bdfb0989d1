"""SciPy on the work of `work.py`: resampling under a displacement field, and the judge of inverses."""

import numpy as np
import scipy
from scipy import ndimage

import work


class Resample:
    """The deformed volume: map_coordinates of order 1, for the field and for the volume."""

    def __init__(self, volume: work.Volume, field: work.Field, fill: float) -> None:
        self.voxels, self.fill, self.vectors = volume.voxels, fill, field.vectors
        grids = [
            (np.arange(n) * volume.spacing[2 - a] + volume.origin[2 - a] - field.origin[2 - a]) / field.spacing[2 - a] for a, n in enumerate(self.voxels.shape)
        ]
        self.in_field = np.stack(np.meshgrid(*[g.astype(np.float32) for g in grids], indexing="ij"))
        self.here = np.stack(np.meshgrid(*[np.arange(n, dtype=np.float32) for n in self.voxels.shape], indexing="ij"))
        self.voxels_per_mm = (1 / volume.spacing[::-1]).astype(np.float32)

    def array(self, strength: float) -> np.ndarray:
        """Resamples under a share of the field."""
        at = np.empty_like(self.here)
        for axis in range(3):
            shift = ndimage.map_coordinates(self.vectors[..., 2 - axis], self.in_field, order=1, mode="nearest")
            at[axis] = self.here[axis] + shift * (strength * self.voxels_per_mm[axis])
        return ndimage.map_coordinates(self.voxels, at, order=1, mode="constant", cval=self.fill)


def residual_mm(field: work.Field, inverse: np.ndarray) -> tuple[float, float]:
    """How far the field after its inverse is from the identity, at the grid's points: mean and 99.9th percentile, mm."""
    grid = np.stack(np.meshgrid(*[np.arange(n, dtype=np.float64) for n in inverse.shape[:3]], indexing="ij"))
    at = grid + np.stack([inverse[..., 2 - a] / field.spacing[2 - a] for a in range(3)])
    back = np.stack([ndimage.map_coordinates(field.vectors[..., c].astype(np.float64), at, order=1, mode="nearest") for c in range(3)], axis=-1)
    error = np.linalg.norm(inverse + back, axis=-1)
    return float(error.mean()), float(np.percentile(error, 99.9))


def version() -> str:
    """SciPy's version."""
    return scipy.__version__
