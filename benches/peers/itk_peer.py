"""SimpleITK on the work of `work.py`: resampling under a displacement field, and inverting one."""

import numpy as np
import SimpleITK as sitk

import work


def use_threads(count: int) -> None:
    """As many as everybody else."""
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(count)


def image(voxels: np.ndarray, spacing: np.ndarray, origin: np.ndarray, vectors: bool = False) -> sitk.Image:
    """A grid as SimpleITK holds it."""
    out = sitk.GetImageFromArray(voxels, isVector=vectors)
    out.SetSpacing(spacing.tolist())
    out.SetOrigin(origin.tolist())
    return out


class Resample:
    """The deformed volume: Resample under a DisplacementFieldTransform, linear."""

    def __init__(self, volume: work.Volume, field: work.Field, fill: float) -> None:
        self.image = image(volume.voxels, volume.spacing, volume.origin)
        self.field, self.fill = field, fill

    def run(self, strength: float) -> sitk.Image:
        """Resamples under a share of the field. The transform takes its field over, in double precision: it is made anew each time."""
        scaled = image(self.field.vectors.astype(np.float64) * strength, self.field.spacing, self.field.origin, vectors=True)
        return sitk.Resample(self.image, self.image, sitk.DisplacementFieldTransform(scaled), sitk.sitkLinear, self.fill, self.image.GetPixelID())

    def array(self, strength: float) -> np.ndarray:
        """As `run`, as voxels."""
        return sitk.GetArrayFromImage(self.run(strength))


class Inversion:
    """The inverse of a field on its own grid."""

    def __init__(self, field: work.Field) -> None:
        self.field = image(field.vectors, field.spacing, field.origin, vectors=True)

    def direct(self, iterations: int, tolerance: float) -> sitk.Image:
        """By InvertDisplacementField; the tolerance is of the largest error, in voxels."""
        return sitk.InvertDisplacementField(
            self.field,
            maximumNumberOfIterations=iterations,
            maxErrorToleranceThreshold=tolerance,
            meanErrorToleranceThreshold=tolerance / 100,
            enforceBoundaryCondition=False,
        )

    def iterative(self, iterations: int) -> sitk.Image:
        """By IterativeInverseDisplacementField."""
        return sitk.IterativeInverseDisplacementField(self.field, numberOfIterations=iterations, stopValue=0.0)


def array(result: sitk.Image) -> np.ndarray:
    """Vectors or voxels of a result."""
    return sitk.GetArrayFromImage(result)


def version() -> str:
    """SimpleITK's version."""
    return sitk.Version.VersionString()
