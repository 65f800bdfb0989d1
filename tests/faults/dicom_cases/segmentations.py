"""Segmentations, written by highdicom, and what its writer does not do."""

import copy

import highdicom as hd
import numpy as np
from pydicom.sequence import Sequence
from pydicom.sr.codedict import codes

from .base import ORIGIN, SPACING, expected_of, frame_groups, image, multiframe, one_item, data_set

SEGMENTATION = "1.2.840.10008.5.1.4.1.1.66.4"
NAMES = ("liver", "tumour", "spleen")
# What highdicom copies from its sources.
EMPTY = ("PatientBirthDate", "PatientSex", "AccessionNumber", "ReferringPhysicianName", "StudyID")
MOMENT = {"ContentDate": "20200101", "ContentTime": "100000", "InstanceCreationDate": "20200101",
          "InstanceCreationTime": "100000", "SeriesDate": "20200101", "SeriesTime": "100000"}


def sources(count=5):
    out = []
    for k in range(count):
        ds = image(k, pixels=np.zeros((8, 8), np.uint16), StudyDate="20200101", StudyTime="100000",
                   SliceThickness="2.5")
        for name in EMPTY:
            setattr(ds, name, "")
        out.append(ds)
    return out


def description(number):
    return hd.seg.SegmentDescription(
        segment_number=number, segment_label=NAMES[number - 1],
        segmented_property_category=codes.SCT.Tissue, segmented_property_type=codes.SCT.Tissue,
        algorithm_type="MANUAL",
    )


def written(voxels, kind, count, **more):
    """A segmentation of voxels [k, j, i] or [k, j, i, segment]."""
    ds = hd.seg.Segmentation(
        sources(len(voxels)), voxels, kind, [description(n + 1) for n in range(count)],
        series_instance_uid="1.2.3.5", series_number=7, sop_instance_uid="1.2.3.5.1", instance_number=1,
        manufacturer="none", manufacturer_model_name="none", software_versions="1",
        device_serial_number="1", **more,
    )
    for name, value in MOMENT.items():
        if name in ds:
            setattr(ds, name, value)
    ds.DimensionOrganizationSequence[0].DimensionOrganizationUID = "1.2.3.8"
    for item in ds.DimensionIndexSequence:
        item.DimensionOrganizationUID = "1.2.3.8"
    for item in ds.get("ContributingEquipmentSequence", ()):
        item.ContributionDateTime = "20200101100000"
    ds.FrameOfReferenceUID = "1.2.3.9"
    ds.file_meta.ImplementationClassUID = "1.2.3"
    ds.file_meta.ImplementationVersionName = "FAULTS"
    return ds


def labelled():
    """Three segments that differ in every slice; the fourth slice is empty."""
    voxels = np.zeros((5, 8, 8), np.uint8)
    for k in (0, 1, 2, 4):
        voxels[k, 1:3, 1 : 2 + k] = 1
        voxels[k, 4:6, k : k + 2] = 2
        voxels[k, 6, 6] = 3
    return voxels


def overlapping(voxels):
    """Each segment a plane of its own, [k, j, i, segment]; the first covers the second."""
    planes = np.stack([voxels == n for n in (1, 2, 3)], axis=-1).astype(np.uint8)
    planes[..., 0] |= planes[..., 1]
    return planes


def values_of(voxels):
    """The voxels that are not zero, and some that are."""
    places = np.argwhere(voxels)[::3].tolist() + np.argwhere(voxels == 0)[::29].tolist()
    return [[i, j, k, float(voxels[k, j, i])] for k, j, i in places]


def case(cases, name, ds, voxels, peer="highdicom", spacing=SPACING, origin=ORIGIN, count=3, **more):
    expected = expected_of(voxels, spacing, origin)
    expected["values"] = values_of(voxels)
    labels = {str(n + 1): NAMES[n] for n in range(count)}
    cases.one(f"seg-{name}", ds, expected, peer, **{"labels": labels, "modality": "SEG", **more})


def renamed(ds, numbers):
    """The same segmentation with other segment numbers."""
    for segment in ds.SegmentSequence:
        segment.SegmentNumber = numbers[segment.SegmentNumber - 1]
    for frame in ds.PerFrameFunctionalGroupsSequence:
        item = frame.SegmentIdentificationSequence[0]
        item.ReferencedSegmentNumber = numbers[item.ReferencedSegmentNumber - 1]
    return ds


def make(cases):
    voxels = labelled()
    case(cases, "binary", written(voxels, "BINARY", 3), voxels)
    case(cases, "binary-all-frames", written(voxels, "BINARY", 3, omit_empty_frames=False), voxels)
    case(cases, "labelmap", written(voxels, "LABELMAP", 3), voxels)
    case(cases, "labelmap-all-frames", written(voxels, "LABELMAP", 3, omit_empty_frames=False), voxels)
    planes = overlapping(voxels)
    case(cases, "overlapping", written(planes, "BINARY", 3), voxels, "PS3.3 C.8.20.2: the last one",
         warns=["overlap"])
    shares = np.stack([voxels == n for n in (1, 2, 3)], axis=-1) * np.array([1.0, 0.75, 0.25])
    kept = np.where(voxels == 3, 0, voxels)
    case(cases, "fractional", written(shares, "FRACTIONAL", 3), kept, "highdicom, at least one half")
    case(cases, "fractional-100", written(shares, "FRACTIONAL", 3, max_fractional_value=100), kept,
         "highdicom, at least one half")
    case(cases, "rle", written(voxels, "LABELMAP", 3, transfer_syntax_uid="1.2.840.10008.1.2.5"), voxels)
    ds = renamed(written(voxels, "BINARY", 3), (2, 200, 300))
    other = np.array([0, 2, 200, 300])[voxels]
    case(cases, "numbers", ds, other, "PS3.3 C.8.20.2",
         labels={"2": "liver", "200": "tumour", "300": "spleen"})
    # The distance between slices is stated, and slices that are empty on either side are omitted.
    middle = voxels.copy()
    middle[[0, 1, 3]] = 0
    ds = written(middle, "BINARY", 3)
    ds.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].SpacingBetweenSlices = 2.5
    shown = middle[2:5]
    case(cases, "stated-spacing", ds, shown, "PS3.3 C.8.20.2, SpacingBetweenSlices",
         origin=[ORIGIN[0], ORIGIN[1], ORIGIN[2] + 5])
    single = voxels.copy()
    single[[0, 1, 3, 4]] = 0
    ds = written(single, "BINARY", 3)
    ds.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].SpacingBetweenSlices = 2.5
    case(cases, "one-slice", ds, single[2:3], "PS3.3 C.8.20.2", origin=[ORIGIN[0], ORIGIN[1], ORIGIN[2] + 5])
    far = voxels.copy()
    far[1:4] = 0
    ds = written(far, "BINARY", 3)
    measures = ds.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0]
    measures.SpacingBetweenSlices = 2.5
    case(cases, "two-far-slices", ds, far, "PS3.3 C.8.20.2, SpacingBetweenSlices")
    ds = written(voxels, "BINARY", 3)
    frames = list(ds.PerFrameFunctionalGroupsSequence)
    pixels = ds.pixel_array
    order = list(range(len(frames)))[::-1]
    ds.PerFrameFunctionalGroupsSequence = Sequence([copy.deepcopy(frames[n]) for n in order])
    ds.PixelData = np.packbits(pixels[order].ravel(), bitorder="little").tobytes()
    ds.PixelData += b"\0" * (len(ds.PixelData) % 2)
    case(cases, "frames-backwards", ds, voxels)
    case(cases, "odd-rows", odd_bits(), odd_voxels(), "PS3.5 8.1.1", spacing=[0.6, 0.8, 2.5], count=1)
    ds = odd_bits()
    ds.SamplesPerPixel = 3
    cases.one("seg-three-samples", ds, {}, "PS3.3 C.8.20.2", error=[["sample", "colour"]])
    case(cases, "background-of-labelmap", with_background(voxels), voxels, "PS3.3 C.8.20.3")


def with_background(voxels):
    """A label map that describes its background as a segment 0."""
    ds = written(voxels, "LABELMAP", 3)
    zero = copy.deepcopy(ds.SegmentSequence[0])
    zero.SegmentNumber, zero.SegmentLabel = 0, "background"
    if ds.SegmentSequence[0].SegmentNumber != 0:
        ds.SegmentSequence = Sequence([zero, *ds.SegmentSequence])
    return ds


def odd_voxels():
    k, j, i = np.mgrid[:3, :5, :7]
    return ((i + 2 * j + k) % 3 == 0).astype(np.uint8)


def odd_bits():
    """Frames of 35 bits, packed without regard to bytes."""
    voxels = odd_voxels()
    bits = np.packbits(voxels.ravel(), bitorder="little").tobytes()
    ds = multiframe(
        voxels, SOPClassUID=SEGMENTATION, Modality="SEG", SegmentationType="BINARY", BitsAllocated=1,
        BitsStored=1, HighBit=0, PixelSpacing=None, PixelData=bits + b"\0" * (len(bits) % 2),
    )
    ds.SegmentSequence = Sequence([data_set(SegmentNumber=1, SegmentLabel=NAMES[0])])
    ds.SharedFunctionalGroupsSequence = Sequence([data_set(
        PixelMeasuresSequence=one_item(PixelSpacing=[0.8, 0.6], SliceThickness=2.5),
        PlaneOrientationSequence=one_item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0]),
        SegmentIdentificationSequence=one_item(ReferencedSegmentNumber=1),
    )])
    ds.PerFrameFunctionalGroupsSequence = Sequence([frame_groups(k) for k in range(3)])
    return ds
