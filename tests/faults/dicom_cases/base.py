"""Small DICOM images whose values say where they belong, and the cases made of them."""

import io
import os
import tempfile
import warnings

import numpy as np
import pydicom
import SimpleITK
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRBigEndian, ExplicitVRLittleEndian, ImplicitVRLittleEndian

warnings.simplefilter("ignore")
SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
pydicom.config.settings.reading_validation_mode = pydicom.config.IGNORE
pydicom.config.settings.writing_validation_mode = pydicom.config.IGNORE

CT = "1.2.840.10008.5.1.4.1.1.2"
MR = "1.2.840.10008.5.1.4.1.1.4"
PET = "1.2.840.10008.5.1.4.1.1.128"
ENHANCED_MR = "1.2.840.10008.5.1.4.1.1.4.1"
SECONDARY = "1.2.840.10008.5.1.4.1.1.7"
COLUMNS, ROWS = 6, 5
SPACING = [0.6, 0.8, 2.5]
ORIGIN = [1.0, 2.0, 3.0]


def pattern(k=0, t=0, columns=COLUMNS, rows=ROWS, dtype=np.uint16):
    """Values 1000 t + 100 k + 10 j + i, indexed [j, i]."""
    j, i = np.mgrid[:rows, :columns]
    return (1000 * t + 100 * k + 10 * j + i).astype(dtype)


def patterns(slices=4, t=0, **more):
    """A stack of patterns, indexed [k, j, i]."""
    return np.stack([pattern(k, t, **more) for k in range(slices)])


def apply(ds, attributes):
    """Sets attributes by keyword; None removes one."""
    for name, value in attributes.items():
        if value is None:
            if name in ds:
                delattr(ds, name)
        else:
            setattr(ds, name, value)
    return ds


def data_set(**attributes):
    return apply(Dataset(), attributes)


def one_item(**attributes):
    return Sequence([data_set(**attributes)])


def set_pixels(ds, pixels):
    """Uncompressed pixels [frames,] rows, columns [, samples], with what describes them."""
    samples = pixels.shape[-1] if pixels.ndim > 2 and pixels.shape[-1] in (3, 4) else 1
    shape = pixels.shape[:-1] if samples > 1 else pixels.shape
    ds.Rows, ds.Columns = shape[-2:]
    ds.SamplesPerPixel = samples
    ds.PhotometricInterpretation = "MONOCHROME2" if samples == 1 else "RGB"
    if samples > 1:
        ds.PlanarConfiguration = 0
    bits = 8 * pixels.dtype.itemsize
    ds.BitsAllocated, ds.BitsStored, ds.HighBit = bits, bits, bits - 1
    ds.PixelRepresentation = int(pixels.dtype.kind == "i")
    if len(shape) > 2:
        ds.NumberOfFrames = shape[0]
    data = pixels.tobytes()
    ds.PixelData = data + b"\0" * (len(data) % 2)
    ds["PixelData"].VR = "OB" if bits == 8 else "OW"


def image(k=0, t=0, pixels=None, syntax=ExplicitVRLittleEndian, **attributes):
    """Slice k of time t, 2.5 mm apart along z. Attributes replace its own; None leaves one out."""
    ds = Dataset()
    ds.SOPClassUID = CT
    ds.SOPInstanceUID = f"1.2.3.4.{t}.{k + 1}"
    ds.Modality = "CT"
    ds.PatientName = "Phantom^Test"
    ds.PatientID = "0"
    ds.StudyInstanceUID = "1.2.3"
    ds.SeriesInstanceUID = "1.2.3.4"
    ds.SeriesNumber = 3
    ds.InstanceNumber = k + 1
    ds.ImagePositionPatient = [ORIGIN[0], ORIGIN[1], ORIGIN[2] + SPACING[2] * k]
    ds.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
    ds.FrameOfReferenceUID = "1.2.3.9"
    ds.PixelSpacing = [SPACING[1], SPACING[0]]
    set_pixels(ds, pattern(k, t) if pixels is None else pixels)
    apply(ds, attributes)
    return with_meta(ds, syntax)


def multiframe(pixels, **attributes):
    """One object of several frames, without position or orientation."""
    plain = {
        "ImagePositionPatient": None,
        "ImageOrientationPatient": None,
        "FrameOfReferenceUID": None,
        "SOPClassUID": SECONDARY,
        "Modality": "OT",
    }
    return image(pixels=pixels, **{**plain, **attributes})


def with_meta(ds, syntax=ExplicitVRLittleEndian):
    ds.file_meta = FileMetaDataset()
    ds.file_meta.FileMetaInformationVersion = b"\0\1"
    ds.file_meta.MediaStorageSOPClassUID = ds.SOPClassUID
    ds.file_meta.MediaStorageSOPInstanceUID = ds.get("SOPInstanceUID") or "1.2.3.4"
    ds.file_meta.TransferSyntaxUID = syntax
    ds.file_meta.ImplementationClassUID = "1.2.3"
    ds.file_meta.ImplementationVersionName = "FAULTS"
    return ds


def encoded(ds):
    """A data set with preamble and meta group, as pydicom writes it."""
    out = io.BytesIO()
    pydicom.dcmwrite(out, ds, enforce_file_format=True)
    return out.getvalue()


def volume_of(ds):
    """Values of a data set after its rescale, [k, j, i], as pydicom decodes them."""
    pixels = ds.pixel_array
    if int(ds.get("SamplesPerPixel") or 1) == 1:
        slope = ds.get("RescaleSlope")
        slope = 1.0 if slope in (None, "") else float(slope)
        pixels = pixels * slope + float(ds.get("RescaleIntercept") or 0)
        return pixels if pixels.ndim == 3 else pixels[None]
    return pixels if pixels.ndim == 4 else pixels[None]


def picked(voxels):
    """A handful of the voxels of an array [k, j, i]: the first of every slice, and some others."""
    n = np.array(voxels.shape[:3])
    places = {(0, 0, min(1, n[2] - 1)), (0, min(1, n[1] - 1), 0), tuple(n - 1), tuple(n // 2)}
    places |= {(k, 0, 0) for k in range(min(n[0], 6))}
    return [[int(i), int(j), int(k), float(voxels[k, j, i])] for k, j, i in sorted(places)]


def picked_colors(voxels):
    """A handful of the voxels of an array [k, j, i, rgb]."""
    n = np.array(voxels.shape[:3])
    places = {(0, 0, 0), tuple(n - 1), tuple(n // 2)}
    color = lambda at: [float(v) for v in voxels[at][:3]]
    return [[int(i), int(j), int(k), color((k, j, i))] for k, j, i in sorted(places)]


def described(datasets):
    """What must come out of slices in order: size, geometry and values."""
    first, last = datasets[0], datasets[-1]
    volumes = [volume_of(ds) for ds in datasets]
    voxels = np.concatenate(volumes)
    out = {"size": [int(n) for n in voxels.shape[2::-1]]}
    if voxels.ndim == 4:
        out["colors"] = picked_colors(voxels)
    else:
        out["values"] = picked(voxels)
    if "ImagePositionPatient" in first:
        start = np.array([float(v) for v in first.ImagePositionPatient])
        out["origin_mm"] = start.tolist()
        if len(datasets) > 1:
            end = np.array([float(v) for v in last.ImagePositionPatient])
            step = (end - start) / (len(datasets) - 1)
            down, across = (float(v) for v in first.PixelSpacing)
            out["spacing_mm"] = [across, down, float(np.linalg.norm(step))]
            along = [float(v) for v in first.ImageOrientationPatient]
            axes = np.stack([along[:3], along[3:], step / np.linalg.norm(step)], axis=1)
            out["direction"] = axes.tolist()
    return out


def by_pydicom(files):
    """What must come out of files in the order of their slices, as pydicom reads them."""
    return described([opened(data) for data in files])


def opened(data):
    """A data set as pydicom reads it, with the transfer syntax that it found."""
    ds = pydicom.dcmread(io.BytesIO(data), force=True)
    if "TransferSyntaxUID" not in ds.file_meta:
        implicit, little = ds.original_encoding
        explicit = ExplicitVRLittleEndian if little else ExplicitVRBigEndian
        ds.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian if implicit else explicit
    return ds


def agrees(files, datasets, standard):
    """Who reads from files what was meant: pydicom, SimpleITK, or only the standard."""
    meant = described(datasets)
    try:
        if described([opened(data) for data in files]) == meant:
            return "pydicom"
    except Exception:
        pass
    try:
        voxels = np.concatenate([by_simple_itk(data) for data in files])
        if picked(voxels) == meant["values"]:
            return "SimpleITK"
    except Exception:
        pass
    return standard


def by_simple_itk(data):
    """The voxels of a file, [k, j, i], as GDCM decodes them."""
    with tempfile.NamedTemporaryFile(suffix=".dcm") as file:
        file.write(data)
        file.flush()
        return SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(file.name, imageIO="GDCMImageIO"))


def series_reader_agrees(folder, expected):
    """Whether SimpleITK reads the only series in a folder, with the voxels expected."""
    try:
        reader = SimpleITK.ImageSeriesReader()
        (series,) = reader.GetGDCMSeriesIDs(folder)
        reader.SetFileNames(reader.GetGDCMSeriesFileNames(folder, series))
        voxels = SimpleITK.GetArrayFromImage(reader.Execute())
        return picked(voxels.astype(float)) == expected["values"]
    except Exception:
        return False


class Cases:
    """The cases made so far, and the folder of their files."""

    def __init__(self, folder):
        self.folder, self.list, self.kind = folder, [], None

    def write(self, path, data):
        """Writes a file, of a data set or of bytes."""
        data = data if isinstance(data, bytes) else encoded(data)
        path = os.path.join(self.folder, path)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        assert not os.path.exists(path), path
        with open(path, "wb") as file:
            file.write(data)
        return data

    def add(self, name, path, peer, expected, **more):
        case = {"kind": f"dicom {self.kind}", "name": name, "path": path, "peer": peer}
        case.update(expected)
        case.update(more)
        self.list.append({k: v for k, v in case.items() if v is not None})

    def where(self, name, file=""):
        return f"{self.kind.replace(' ', '-')}/{name}{file}"

    def one(self, name, data, expected=None, peer="pydicom", ending=".dcm", **more):
        """A case of one file; without `expected`, what pydicom reads from it."""
        path = self.where(name, ending)
        data = self.write(path, data)
        self.add(name, path, peer, by_pydicom([data]) if expected is None else expected, **more)

    def stack(self, name, files, expected=None, peer="pydicom", names=None, **more):
        """A case of a folder of slices in order; without `expected`, what pydicom reads."""
        names = names or [f"{n}.dcm" for n in range(len(files))]
        written = [self.write(self.where(name, "/" + n), data) for n, data in zip(names, files)]
        expected = by_pydicom(written) if expected is None else expected
        self.add(name, self.where(name), peer, expected, **more)


def frame_groups(k=0, position=None, **groups):
    """The functional groups of a frame, with its position; others are named by their keyword."""
    ds = Dataset()
    position = [ORIGIN[0], ORIGIN[1], ORIGIN[2] + SPACING[2] * k] if position is None else position
    if position:
        ds.PlanePositionSequence = one_item(ImagePositionPatient=position)
    return apply(ds, groups)


def enhanced(frames, pixels, shared=None, **attributes):
    """An enhanced MR image of frames with their functional groups."""
    ds = multiframe(pixels, SOPClassUID=ENHANCED_MR, Modality="MR", PixelSpacing=None)
    groups = Dataset()
    groups.PixelMeasuresSequence = one_item(
        PixelSpacing=[SPACING[1], SPACING[0]], SliceThickness=SPACING[2]
    )
    groups.PlaneOrientationSequence = one_item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])
    ds.SharedFunctionalGroupsSequence = Sequence([apply(groups, shared or {})])
    ds.PerFrameFunctionalGroupsSequence = Sequence(frames)
    apply(ds, attributes)
    return with_meta(ds)


def expected_of(voxels, spacing=None, origin=None, **more):
    """What must come out of voxels [k, j, i (, rgb)] that the script itself chose."""
    voxels = np.asarray(voxels)
    out = {"size": [int(n) for n in voxels.shape[2::-1]]}
    if voxels.ndim == 4:
        out["colors"] = picked_colors(voxels)
    else:
        out["values"] = picked(voxels)
    if spacing is not None:
        out["spacing_mm"] = [float(v) for v in spacing]
    if origin is not None:
        out["origin_mm"] = [float(v) for v in origin]
    return {**out, **more}
