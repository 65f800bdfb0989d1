"""VTK on the work of `work.py`: volume rendering on the CPU and on OpenGL, and resampling."""

import os
import sys

import numpy as np
import vtk
from vtk.util import numpy_support

import work

# Frame rate at which VTK may coarsen its sampling, at its best.
BEST_PER_SECOND = 5.0

if sys.platform == "linux":
    # No display is needed; off-screen rendering through EGL.
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


def use_threads(count: int) -> None:
    """VTK's wheel starts with the sequential backend."""
    vtk.vtkSMPTools.SetBackend("STDThread")
    vtk.vtkSMPTools.Initialize(count)
    vtk.vtkMultiThreader.SetGlobalDefaultNumberOfThreads(count)


def image(volume: work.Volume) -> vtk.vtkImageData:
    """A volume as VTK holds it."""
    out = vtk.vtkImageData()
    out.SetDimensions(*volume.voxels.shape[::-1])
    out.SetSpacing(*volume.spacing)
    out.SetOrigin(*volume.origin)
    scalars = numpy_support.numpy_to_vtk(volume.voxels.ravel(), deep=True)
    out.GetPointData().SetScalars(scalars)
    return out


def volume_property(case: work.Case, unit: float, best: bool) -> vtk.vtkVolumeProperty:
    """Transfer function and light; opacities are per `unit` mm. At its best VTK takes the nearest voxel, as it does by default."""
    color, opacity = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
    for value, rgb, alpha in case.points():
        color.AddRGBPoint(value, *rgb)
        opacity.AddPoint(value, alpha)
    out = vtk.vtkVolumeProperty()
    out.SetColor(color)
    out.SetScalarOpacity(opacity)
    out.SetScalarOpacityUnitDistance(unit)
    if not best:
        out.SetInterpolationTypeToLinear()
    out.ShadeOn()
    out.SetAmbient(case.light.ambient)
    out.SetDiffuse(case.light.diffuse)
    out.SetSpecular(case.light.specular)
    out.SetSpecularPower(case.light.shininess)
    return out


def fixed_point(step: float, best: bool) -> vtk.vtkFixedPointVolumeRayCastMapper:
    """The CPU mapper: equal sampling, or as it comes."""
    out = vtk.vtkFixedPointVolumeRayCastMapper()
    out.SetNumberOfThreads(vtk.vtkMultiThreader.GetGlobalDefaultNumberOfThreads())
    out.SetSampleDistance(step)
    out.SetInteractiveSampleDistance(step)
    out.SetImageSampleDistance(1.0)
    out.SetAutoAdjustSampleDistances(best)
    out.LockSampleDistanceToInputSpacingOff()
    return out


def gpu(step: float, best: bool) -> vtk.vtkOpenGLGPUVolumeRayCastMapper:
    """The OpenGL mapper: equal sampling, or as it comes."""
    out = vtk.vtkOpenGLGPUVolumeRayCastMapper()
    out.SetUseJittering(False)
    out.SetSampleDistance(step)
    out.SetImageSampleDistance(1.0)
    out.SetAutoAdjustSampleDistances(best)
    out.LockSampleDistanceToInputSpacingOff()
    return out


class Renderer:
    """A window, a volume in it and a camera."""

    def __init__(self, volume: work.Volume, case: work.Case, on_gpu: bool, best: bool = False) -> None:
        self.case, self.box = case, volume.box()
        unit = float(volume.spacing.min())
        mapper = gpu(unit, best) if on_gpu else fixed_point(unit, best)
        mapper.SetInputData(image(volume))
        self.mapper = mapper
        actor = vtk.vtkVolume()
        actor.SetMapper(mapper)
        actor.SetProperty(volume_property(case, unit, best))
        self.renderer = vtk.vtkRenderer()
        self.renderer.SetBackground(0.0, 0.0, 0.0)
        self.renderer.AddVolume(actor)
        self.renderer.RemoveAllLights()
        self.renderer.AutomaticLightCreationOff()
        light = vtk.vtkLight()
        light.SetLightTypeToHeadlight()
        # The default is black, which leaves the CPU mapper without ambient light.
        light.SetAmbientColor(1.0, 1.0, 1.0)
        self.renderer.AddLight(light)
        self.window = vtk.vtkRenderWindow()
        self.window.SetOffScreenRendering(True)
        self.window.SetMultiSamples(0)
        self.window.SetDesiredUpdateRate(BEST_PER_SECOND if best else 1e-3)
        self.window.SetSize(case.size, case.size)
        self.window.AddRenderer(self.renderer)

    def look(self, azimuth_deg: float) -> None:
        """Moves the camera; `azimuth_deg` is added to the case's."""
        eye = work.eye(*self.box, (self.case.view[0] + azimuth_deg, self.case.view[1]))
        camera = self.renderer.GetActiveCamera()
        camera.SetPosition(*eye.position)
        camera.SetFocalPoint(*eye.target)
        camera.SetViewUp(*eye.up)
        camera.SetViewAngle(work.FIELD_OF_VIEW_DEG)
        self.renderer.ResetCameraClippingRange()

    def picture(self) -> np.ndarray:
        """Renders and reads the picture back: rows from the top, 8-bit RGB."""
        self.window.Render()
        pixels = vtk.vtkUnsignedCharArray()
        n = self.case.size
        self.window.GetRGBACharPixelData(0, 0, n - 1, n - 1, 1, pixels)
        return numpy_support.vtk_to_numpy(pixels).reshape(n, n, 4)[::-1, :, :3].copy()

    def driver(self) -> str:
        """Which OpenGL the window got."""
        lines = self.window.ReportCapabilities().splitlines()
        return ", ".join(line.split(":", 1)[1].strip() for line in lines if line.startswith(("OpenGL renderer string", "OpenGL version string")))


class Reslice:
    """The deformed volume: vtkImageReslice under a vtkGridTransform, linear."""

    def __init__(self, volume: work.Volume, field: work.Field, fill: float) -> None:
        grid = vtk.vtkImageData()
        grid.SetDimensions(*field.vectors.shape[2::-1])
        grid.SetOrigin(*field.origin)
        grid.SetSpacing(*field.spacing)
        grid.GetPointData().SetScalars(numpy_support.numpy_to_vtk(field.vectors.reshape(-1, 3), deep=True))
        self.transform = vtk.vtkGridTransform()
        self.transform.SetDisplacementGridData(grid)
        self.transform.SetInterpolationModeToLinear()
        self.reslice = vtk.vtkImageReslice()
        self.reslice.SetInputData(image(volume))
        self.reslice.SetResliceTransform(self.transform)
        self.reslice.SetInterpolationModeToLinear()
        self.reslice.SetBackgroundLevel(fill)
        self.reslice.SetEnableSMP(True)
        self.shape = volume.voxels.shape

    def run(self, strength: float) -> vtk.vtkImageData:
        """Resamples under a share of the field."""
        self.transform.SetDisplacementScale(strength)
        self.reslice.Modified()
        self.reslice.Update()
        return self.reslice.GetOutput()

    def array(self, strength: float) -> np.ndarray:
        """As `run`, as voxels."""
        return numpy_support.vtk_to_numpy(self.run(strength).GetPointData().GetScalars()).reshape(self.shape)


def gradient(volume: work.Volume) -> vtk.vtkImageGradient:
    """The gradient volume's filter, ready to be updated."""
    out = vtk.vtkImageGradient()
    out.SetInputData(image(volume))
    out.SetDimensionality(3)
    out.HandleBoundariesOn()
    out.SetEnableSMP(True)
    return out


def write_png(pixels: np.ndarray, path: str) -> None:
    """Writes 8-bit RGB, rows from the top."""
    out = vtk.vtkImageData()
    out.SetDimensions(pixels.shape[1], pixels.shape[0], 1)
    out.GetPointData().SetScalars(numpy_support.numpy_to_vtk(np.ascontiguousarray(pixels[::-1]).reshape(-1, 3), deep=True))
    writer = vtk.vtkPNGWriter()
    writer.SetFileName(path)
    writer.SetInputData(out)
    writer.Write()


def version() -> str:
    """VTK's version."""
    return vtk.vtkVersion.GetVTKVersion()
