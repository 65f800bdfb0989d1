"""Checks DICOM written by incise with pydicom, highdicom and SimpleITK.

Usage: check_dicom_out.py INCISE OUTDIR [DCM2NIIX]

Writes small CT, MR and PET series with pydicom, and volumes with SimpleITK, lets incise bake and
render them, and checks: every value with pydicom's strict validation; the attributes that the
information objects require, by the tables of highdicom (types 1 and 2 of the mandatory modules);
VRs against the dictionary; size, spacing, origin, direction and values as read by SimpleITK, against
the same volume baked as NRRD; segmentations by highdicom. Prints one line for each check, and the
number of failures, which is the exit status.
"""

import glob
import json
import os
import pkgutil
import shutil
import subprocess
import sys

import numpy as np
import pydicom
import SimpleITK as sitk
from pydicom import config
from pydicom.datadict import dictionary_VR
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian

INCISE, OUT = sys.argv[1], sys.argv[2]
DCM2NIIX = sys.argv[3] if len(sys.argv) > 3 else None
CT, MR, PET = ("1.2.840.10008.5.1.4.1.1.2", "1.2.840.10008.5.1.4.1.1.4", "1.2.840.10008.5.1.4.1.1.128")
SC = "1.2.840.10008.5.1.4.1.1.7"
failures = 0


def check(what, fine, detail=""):
    global failures
    failures += not fine
    print(f"{'ok    ' if fine else 'FAILED'} {what}{' ' + str(detail) if detail != '' else ''}")


def at(name):
    return os.path.join(OUT, name)


def incise(*arguments):
    done = subprocess.run([INCISE, *arguments], capture_output=True, text=True)
    if done.returncode:
        print(done.stderr)
    check("incise " + " ".join(os.path.basename(a) for a in arguments), done.returncode == 0)
    return done.stderr


def json_map(name):
    return json.loads(pkgutil.get_data("highdicom", f"_standard/{name}.json"))


IODS, MODULES, ATTRIBUTES = json_map("sop_class_iod_map"), json_map("iod_module_map"), json_map("module_attribute_map")


def direction(angles):
    a, b, c = angles
    rz = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rx = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    return rz @ ry @ rx


def text16(values):
    """Decimal strings of at most 16 characters."""
    return [f"{v:.12f}"[:16] for v in values]


def source(name, sop_class, modality, tilt=0.0):
    """A series of six slices of a patient, oblique, on request tilted."""
    folder = at(name)
    os.makedirs(folder)
    axes = direction((0.2, -0.3, 0.1))
    step = axes @ np.array([0.0, tilt, 3.0])
    for k in range(6):
        ds = Dataset()
        ds.file_meta = FileMetaDataset()
        ds.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        ds.SpecificCharacterSet = "ISO_IR 100"
        ds.SOPClassUID = ds.file_meta.MediaStorageSOPClassUID = sop_class
        ds.SOPInstanceUID = ds.file_meta.MediaStorageSOPInstanceUID = f"1.2.826.0.1.77.3.{k + 1}"
        ds.StudyInstanceUID, ds.SeriesInstanceUID = "1.2.826.0.1.77.1", "1.2.826.0.1.77.2"
        ds.FrameOfReferenceUID, ds.Modality = "1.2.826.0.1.77.4", modality
        ds.PatientName, ds.PatientID, ds.PatientBirthDate, ds.PatientSex = "M\u00fcller^Zo\u00eb", "ID-4711", "19700102", "F"
        ds.StudyDate, ds.StudyTime, ds.AccessionNumber = "20240506", "070809", "ACC-99"
        ds.StudyID, ds.ReferringPhysicianName, ds.StudyDescription = "ST-1", "Doc^Tor", "Secret study"
        ds.SeriesNumber, ds.SeriesDescription, ds.InstitutionName = 7, "Secret series", "Secret hospital"
        ds.SeriesDate, ds.SeriesTime = "20240506", "070810"
        ds.AcquisitionDate, ds.AcquisitionTime = "20240506", "070811"
        ds.PatientPosition, ds.BodyPartExamined, ds.InstanceNumber = "HFS", "HEAD", k + 1
        ds.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
        ds.ImagePositionPatient = text16(np.array([-20.5, 30.25, 100.125]) + k * step)
        ds.ImageOrientationPatient = text16(np.r_[axes[:, 0], axes[:, 1]])
        ds.PixelSpacing, ds.SliceThickness = ["0.75", "0.5"], "3"
        ds.Rows, ds.Columns, ds.SamplesPerPixel, ds.PhotometricInterpretation = 10, 12, 1, "MONOCHROME2"
        ds.BitsAllocated, ds.BitsStored, ds.HighBit, ds.PixelRepresentation = 16, 16, 15, 1
        i, j = np.meshgrid(np.arange(12), np.arange(10))
        values = ((i * 37 + j * 101 + k * 211) % 1700).astype("<i2")
        if modality == "CT":
            ds.RescaleSlope, ds.RescaleIntercept, ds.RescaleType, ds.KVP = "1", "-1024", "HU", "120"
        elif modality == "MR":
            ds.ScanningSequence, ds.SequenceVariant, ds.ScanOptions = "SE", "NONE", ""
            ds.MRAcquisitionType, ds.RepetitionTime, ds.EchoTime, ds.EchoTrainLength = "2D", "500", "15", "1"
        else:
            ds.RescaleSlope, ds.RescaleIntercept, ds.Units = f"{0.5 + 0.1 * k:.3f}", "0", "BQML"
            ds.CountsSource, ds.SeriesType, ds.DecayCorrection = "EMISSION", ["WHOLE BODY", "IMAGE"], "START"
            ds.CollimatorType, ds.CorrectedImage, ds.FrameReferenceTime = "NONE", ["DECY", "ATTN"], "1000"
            ds.ActualFrameDuration, ds.NumberOfSlices, ds.ImageIndex, ds.DecayFactor = "120000", 6, k + 1, "1.01"
            tracer = Dataset()
            tracer.RadiopharmaceuticalStartTime, tracer.RadionuclideTotalDose = "060606", "350000000"
            tracer.RadionuclideHalfLife = "6586.2"
            ds.RadiopharmaceuticalInformationSequence = [tracer]
        ds.PixelData = values.tobytes()
        ds.save_as(os.path.join(folder, f"IM{k:04}"), enforce_file_format=True)
    return folder


def slices(folder):
    return [pydicom.dcmread(f) for f in sorted(glob.glob(os.path.join(folder, "*.dcm")))]


def elements(ds):
    for element in ds:
        yield element
        if element.VR == "SQ":
            for item in element.value:
                yield from elements(item)


def conforms(what, ds):
    """Values, VRs, and the required attributes of the mandatory modules."""
    bad = []
    for element in elements(ds):
        try:
            config.settings.reading_validation_mode = config.RAISE
            pydicom.DataElement(element.tag, element.VR, element.value, validation_mode=config.RAISE)
        except Exception as error:
            bad.append(f"{element.keyword}: {error}")
        if element.VR not in dictionary_VR(element.tag):
            bad.append(f"{element.keyword} has the VR {element.VR}")
        if element.VR == "DS":
            texts = element.value if isinstance(element.value, pydicom.multival.MultiValue) else [element.value]
            bad += [f"{element.keyword}: {t}" for t in texts if t is not None and len(str(t)) > 16]
    check(f"{what}: values", not bad, bad or "")
    iod = IODS[ds.SOPClassUID]
    required = [m["key"] for m in MODULES[iod] if m["usage"] == "M"]
    missing, places = [], {}
    for module in required:
        for attribute in ATTRIBUTES[module]:
            places[attribute["keyword"], tuple(attribute["path"])] = attribute["type"]
    for (keyword, path), kind in places.items():
        holders = [ds]
        for name in path:
            holders = [item for holder in holders for item in holder.get(name, [])]
        # A functional group is either shared or of each frame, which is checked where it matters.
        if path and path[-1].endswith("FunctionalGroupsSequence"):
            continue
        for holder in holders:
            if kind in ("1", "2") and keyword not in holder:
                missing.append(f"{'/'.join(path)}/{keyword} ({kind})")
            elif kind == "1" and holder[keyword].is_empty:
                missing.append(f"{'/'.join(path)}/{keyword} is empty")
    check(f"{what}: {len(places)} attributes of {len(required)} modules of {iod}", not missing, missing or "")
    meta = ds.file_meta
    check(
        f"{what}: meta information",
        meta.MediaStorageSOPInstanceUID == ds.SOPInstanceUID
        and meta.MediaStorageSOPClassUID == ds.SOPClassUID
        and meta.TransferSyntaxUID == ExplicitVRLittleEndian
        and meta.ImplementationClassUID.is_valid,
    )


def identities(ds):
    """Values that identify the patient or the source."""
    texts = [str(e.value) for e in elements(ds) if e.VR not in ("OB", "OW") and not str(e.value).startswith("2.25.")]
    secret = ["ller", "4711", "1970", "2024", "ACC-99", "Secret", "Doc", "ST-1", "1.2.826.0.1.77"]
    return [t for t in texts if any(s in t for s in secret)]


def image(path):
    if os.path.isdir(path):
        reader = sitk.ImageSeriesReader()
        reader.SetFileNames(reader.GetGDCMSeriesFileNames(path))
        return reader.Execute()
    return sitk.ReadImage(path)


def positions(found, size, spacing_of_slices):
    """LPS positions of the corners, by the plane of every slice: SimpleITK has no sheared grids."""
    first, last = found[0], found[-1]
    corners = []
    for ds in (first, last):
        x, y = np.array(ds.ImageOrientationPatient[:3], float), np.array(ds.ImageOrientationPatient[3:], float)
        rows, columns = map(float, ds.PixelSpacing)
        start = np.array(ds.ImagePositionPatient, float)
        corners += [start, start + x * columns * (size[0] - 1), start + y * rows * (size[1] - 1)]
    return np.array(corners)


def same_as_nrrd(what, folder, nrrd, tolerance):
    """The series as SimpleITK reads it, against the NRRD of the same bake."""
    a, b = image(folder), image(nrrd)
    va, vb = sitk.GetArrayFromImage(a).astype(float), sitk.GetArrayFromImage(b).astype(float)
    off = np.abs(va - vb).max() if va.shape == vb.shape else np.inf
    check(f"{what}: values as SimpleITK reads them", off <= tolerance, f"off by {off:.3g}")
    found = slices(folder)
    mine = positions(found, a.GetSize(), None)
    n = b.GetSize()
    theirs = np.array(
        [b.TransformContinuousIndexToPhysicalPoint((i, j, k)) for k in (0, n[2] - 1) for i, j in ((0, 0), (n[0] - 1, 0), (0, n[1] - 1))]
    )
    off = np.abs(mine - theirs).max()
    check(f"{what}: planes", off < 1e-6, f"off by {off:.1e} mm")
    return a, b


def same_geometry(what, a, b):
    off = max(
        np.abs(np.subtract(a.TransformContinuousIndexToPhysicalPoint(p), b.TransformContinuousIndexToPhysicalPoint(p))).max()
        for p in [(0, 0, 0), tuple(n - 1 for n in a.GetSize())]
    )
    check(f"{what}: geometry as SimpleITK reads it", a.GetSize() == b.GetSize() and off < 1e-6, f"off by {off:.1e} mm")


def check_series():
    for name, sop_class, tilt in [("CT", CT, 0.0), ("CT-tilted", CT, 0.9), ("MR", MR, 0.0), ("PT", PET, 0.0)]:
        folder = source(name, sop_class, name[:2], tilt)
        twist = ["--deform", "twist:angle=20"]
        notices = incise("bake", folder, *twist, "-o", at(name + "-out"))
        incise("bake", folder, *twist, "-q", "-o", at(name + ".nrrd"))
        found = slices(at(name + "-out"))
        check(f"{name}: class and modality", {(d.SOPClassUID, d.Modality) for d in found} == {(sop_class, name[:2])})
        conforms(name, found[2])
        check(f"{name}: no patient", not identities(found[2]), identities(found[2]) or "")
        check(f"{name}: derived", found[0].ImageType[:2] == ["DERIVED", "SECONDARY"] and "twist" in found[0].DerivationDescription)
        uids = [{d[k].value for d in found} for k in ("SOPInstanceUID", "SeriesInstanceUID", "StudyInstanceUID", "FrameOfReferenceUID")]
        valid = all(pydicom.uid.UID(u).is_valid and u.startswith("2.25.") for u in set().union(*uids))
        check(f"{name}: UIDs", [len(u) for u in uids] == [6, 1, 1, 1] and valid)
        step = float(found[0].get("RescaleSlope", 1)) if name == "PT" else 0.0
        # The padding of cuts is the lowest value in NRRD.
        padding = [d.pixel_array == d.get("PixelPaddingValue", -(2**20)) for d in found]
        check(f"{name}: padding", all(p.any() for p in padding[1:2]), f"{np.sum(padding)} voxels")
        if name == "PT":
            check("PT: notice", "rounded to steps" in notices)
        inside = ~np.array(padding)
        a, b = image(at(name + "-out")), image(at(name + ".nrrd"))
        va, vb = sitk.GetArrayFromImage(a).astype(float), sitk.GetArrayFromImage(b).astype(float)
        off = np.abs(va - vb)[inside].max()
        check(f"{name}: values as SimpleITK reads them", off <= 0.501 * step + 1e-9, f"off by {off:.3g}, step {step:.3g}")
        if tilt == 0:
            same_geometry(name, a, b)
        else:
            mine, n = positions(found, a.GetSize(), None), found
            axes = direction((0.2, -0.3, 0.1))
            start = np.array([-20.5, 30.25, 100.125])
            end = start + 5 * (axes @ np.array([0.0, tilt, 3.0]))
            theirs = np.array([c + o for c in (start, end) for o in (np.zeros(3), axes[:, 0] * 0.5 * 11, axes[:, 1] * 0.75 * 9)])
            off = np.abs(mine - theirs).max()
            check(f"{name}: planes of the source", off < 1e-6 and len(n) == 6, f"off by {off:.1e} mm")
        incise("bake", folder, *twist, "--patient", "-q", "-o", at(name + "-patient"))
        found = slices(at(name + "-patient"))
        original = pydicom.dcmread(os.path.join(folder, "IM0002"))
        conforms(name + " with patient", found[2])
        copied = ["PatientName", "PatientID", "PatientBirthDate", "PatientSex", "StudyInstanceUID", "StudyDate", "StudyTime",
                  "AccessionNumber", "StudyID", "ReferringPhysicianName", "FrameOfReferenceUID"]
        wrong = [k for k in copied if str(found[2][k].value) != str(original[k].value)]
        check(f"{name} with patient: {len(copied)} attributes", not wrong, wrong or "")
        reference = found[2].SourceImageSequence[0]
        check(
            f"{name} with patient: reference",
            (reference.ReferencedSOPClassUID, reference.ReferencedSOPInstanceUID) == (sop_class, original.SOPInstanceUID)
            and found[2].ReferencedSeriesSequence[0].SeriesInstanceUID == original.SeriesInstanceUID
            and found[2].SeriesInstanceUID != original.SeriesInstanceUID,
        )
        if DCM2NIIX:
            check_dcm2niix(name, at(name + "-out"), inside, vb, tilt)


def check_dcm2niix(name, folder, inside, values, tilt):
    target = at(name + "-nii")
    os.makedirs(target, exist_ok=True)
    subprocess.run([DCM2NIIX, "-z", "n", "-b", "n", "-f", "x", "-o", target, folder], capture_output=True)
    path = os.path.join(target, "x.nii")
    made = os.path.exists(path)
    check(f"{name}: dcm2niix makes a volume", made)
    if made and tilt == 0:
        nii = sitk.ReadImage(path)
        n = sitk.DICOMOrient(nii, sitk.DICOMOrientImageFilter.GetOrientationFromDirectionCosines(image(folder).GetDirection()))
        same = sitk.GetArrayFromImage(n).astype(float)
        off = np.abs(same - values)[inside].max() if same.shape == values.shape else np.inf
        check(f"{name}: values as dcm2niix reads them", off <= 0.6, f"off by {off:.3g}")


def check_other_formats():
    rng = np.random.default_rng(5)
    axes = direction((-0.4, 0.5, 1.2))
    for name, values in [
        ("u8", rng.integers(0, 200, (5, 6, 7)).astype(np.uint8)),
        ("i16", rng.integers(-1000, 3000, (5, 6, 7)).astype(np.int16)),
        ("u16", rng.integers(0, 65000, (5, 6, 7)).astype(np.uint16)),
        ("i32", rng.integers(10**6, 10**6 + 60000, (5, 6, 7)).astype(np.int32)),
        ("f32", rng.normal(0, 1e-3, (5, 6, 7)).astype(np.float32)),
        ("whole-f32", rng.integers(-5, 2000, (5, 6, 7)).astype(np.float32)),
    ]:
        img = sitk.GetImageFromArray(values)
        img.SetSpacing((0.4, 0.9, 2.2))
        img.SetOrigin((-100.123456789, 22.5, 1e3 / 3))
        img.SetDirection(axes.flatten())
        sitk.WriteImage(img, at(name + ".mha"))
        incise("bake", at(name + ".mha"), "-o", at(name + "-out"))
        found = slices(at(name + "-out"))
        conforms(name, found[0])
        check(f"{name}: class", {d.SOPClassUID for d in found} == {SC})
        step = float(found[0].RescaleSlope) * 0.501 if name == "f32" else 0
        a, b = same_as_nrrd(name, at(name + "-out"), at(name + ".mha"), step)
        same_geometry(name, a, b)


def check_pictures():
    incise("render", at("CT"), "--size", "31x17", "--backend", "cpu", "-q", "-o", at("p.png"))
    for options, name in [([], "p.dcm"), (["--patient"], "p-patient.dcm")]:
        incise("render", at("CT"), *options, "--size", "31x17", "--backend", "cpu", "-q", "-o", at(name))
        ds = pydicom.dcmread(at(name))
        conforms(name, ds)
        check(f"{name}: class", ds.SOPClassUID == SC and ds.ConversionType == "WSD" and ds.Modality == "OT")
        png = sitk.GetArrayFromImage(sitk.ReadImage(at("p.png")))
        check(f"{name}: pixels are the PNG's (pydicom)", np.array_equal(ds.pixel_array, png))
        check(f"{name}: pixels are the PNG's (SimpleITK)", np.array_equal(np.squeeze(sitk.GetArrayFromImage(sitk.ReadImage(at(name)))), png))
        check(f"{name}: patient", bool(identities(ds)) == bool(options))
        if options:
            check(f"{name}: name", str(ds.PatientName) == "M\u00fcller^Zo\u00eb", ds.PatientName)


def check_segmentations():
    import highdicom

    axes = direction((-0.4, 0.5, 1.2))
    labels = np.zeros((7, 6, 5), np.uint16)
    labels[1:4, 1:4, 1:4], labels[2:5, 3:6, 2:5], labels[4:6, 0:2, 0:3] = 3, 70, 1001
    img = sitk.GetImageFromArray(labels)
    img.SetSpacing((0.4, 0.9, 2.2))
    img.SetOrigin((-100.123456789, 22.5, 1e3 / 3))
    img.SetDirection(axes.flatten())
    sitk.WriteImage(img, at("labels.nrrd"))
    with open(at("labels.nrrd"), "rb") as file:
        head, rest = file.read().split(b"\n\n", 1)
    # Names as 3D Slicer writes them.
    for n, (value, name) in enumerate([(3, "Liver"), (70, "Zyste \u00e4"), (1001, "Vein")]):
        head += f"\nSegment{n}_ID:=s{n}\nSegment{n}_LabelValue:={value}\nSegment{n}_Layer:=0\nSegment{n}_Name:={name}\nSegment{n}_Color:=0.8 0.1 0.{n}".encode()
    with open(at("labels.seg.nrrd"), "wb") as file:
        file.write(head + b"\n\n" + rest)
    for name, path in [("seg", at("labels.seg.nrrd"))]:
        incise("bake", path, "-o", at(name + ".dcm"))
        ds = pydicom.dcmread(at(name + ".dcm"))
        conforms(name, ds)
        seg = highdicom.seg.segread(at(name + ".dcm"))
        check(f"{name}: highdicom reads segments", seg.number_of_segments == 3, [d.SegmentLabel for d in seg.SegmentSequence])
        volume = seg.get_volume(combine_segments=True)
        renumbered = np.searchsorted([0, 3, 70, 1001], labels)
        array, affine = volume.array, volume.affine
        off, seen = 0.0, 0
        for k, j, i in np.ndindex(array.shape):
            p = affine @ np.array([k, j, i, 1.0])
            index = np.array(img.TransformPhysicalPointToContinuousIndex(p[:3]))
            whole = np.round(index).astype(int)
            off = max(off, np.abs(index - whole).max())
            if (whole >= 0).all() and (whole < img.GetSize()).all():
                seen += array[k, j, i] == renumbered[whole[2], whole[1], whole[0]]
        check(f"{name}: voxels as highdicom reads them", seen == labels.size, f"{seen} of {labels.size}, off by {off:.1e} voxels")
        shared, frames = ds.SharedFunctionalGroupsSequence[0], ds.PerFrameFunctionalGroupsSequence
        check(
            f"{name}: functional groups",
            {e.keyword for e in shared} == {"PixelMeasuresSequence", "PlaneOrientationSequence"}
            and all({e.keyword for e in f} == {"FrameContentSequence", "PlanePositionSequence", "SegmentIdentificationSequence"} for f in frames),
        )
        bits = ds.pixel_array
        check(f"{name}: frames", bits.shape[0] == ds.NumberOfFrames and bits.sum() == (labels > 0).sum(), bits.shape)
        check(f"{name}: no patient", not identities(ds), identities(ds) or "")
        check(f"{name}: deformed", "Resampled" in ds.DerivationDescription)


shutil.rmtree(OUT, ignore_errors=True)
os.makedirs(OUT)
check_series()
check_other_formats()
check_pictures()
check_segmentations()
print(f"{failures} failures")
sys.exit(min(failures, 255))
