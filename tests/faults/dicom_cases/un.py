"""Elements whose representation a writer did not know: VR UN, PS3.5 6.2.2."""

import numpy as np
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRBigEndian, ExplicitVRLittleEndian

from .base import ORIGIN, SPACING, agrees, data_set, described, enhanced, expected_of, frame_groups
from .base import image, multiframe, one_item, pattern, patterns
from .characters import segmentation
from .encoding import UNDEFINED, Style, bare, encode, file_of, header, plain

GEOMETRY = {
    "ImagePositionPatient",
    "ImageOrientationPatient",
    "PixelSpacing",
    "RescaleIntercept",
    "RescaleSlope",
}
PIXELS = {"Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation"}
SHARED, PER_FRAME = "SharedFunctionalGroupsSequence", "PerFrameFunctionalGroupsSequence"
STANDARD = "PS3.5 6.2.2"


def unknown(*keywords, undefined=False):
    """Writes some elements as UN; nothing in them has a representation."""

    def choose(element, depth, style):
        if element.keyword in keywords or "all" in keywords and element.keyword != "PixelData":
            return style.but(vr="UN", undefined=undefined and element.VR == "SQ")
        return style

    return choose


def slices(count=3, **attributes):
    return [image(k, RescaleIntercept="-24", RescaleSlope="2", **attributes) for k in range(count)]


def stack(cases, name, choose, style=Style(), datasets=None, **more):
    datasets = datasets or slices()
    if style.big:
        for ds in datasets:
            ds.file_meta.TransferSyntaxUID = ExplicitVRBigEndian
    files = [file_of(ds, style, choose) for ds in datasets]
    for ds in datasets:
        ds.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    cases.stack(name, files, described(datasets), agrees(files, datasets, STANDARD), **more)


def with_private(content, length=UNDEFINED, explicit=True):
    """A file with a private element of the representation UN, its content in bytes."""
    ds = image(0)
    ds.add_new(0x20010010, "LO", "Philips")
    pixels = data_set(PixelData=ds.PixelData)
    pixels["PixelData"].VR = "OW"
    del ds.PixelData
    start = file_of(ds)
    private = header(0x20011090, "UN", length, Style()) + content
    return start + private + encode(pixels)


def private_cases(cases):
    expected = described([image(0)])
    one = lambda name, data: cases.one(name, data, expected, agrees([data], [image(0)], STANDARD))
    implicit = Style(explicit=False)
    inner = Dataset()
    inner.add_new(0x20010010, "LO", "Philips")
    inner.add_new(0x20011001, "LO", "1.2")
    inside = encode(inner, implicit)
    item = lambda content: bare(0xFFFEE000, len(content)) + content
    open_item = lambda content: bare(0xFFFEE000, UNDEFINED) + content + bare(0xFFFEE00D, 0)
    end = bare(0xFFFEE0DD, 0)
    nested_open = header(0x20011002, "SQ", UNDEFINED, implicit) + open_item(inside) + end
    nested = header(0x20011002, "SQ", len(item(inside)), implicit) + item(inside)
    explicit = encode(inner)
    icon = data_set(Rows=2, Columns=2, BitsAllocated=8, PixelData=b"\1\2\3\4")
    icon["PixelData"].VR = "OB"
    for name, content in {
        "private item length": item(inside) + end,
        "private open item": open_item(inside) + end,
        "private no item": end,
        "private empty item": item(b"") + open_item(b"") + end,
        "private two items": item(inside) + open_item(inside) + end,
        "private nested": open_item(inside + nested_open) + end,
        "private nested lengths": item(nested + inside) + end,
        "private nested twice": open_item(nested_open + header(0x20011003, "SQ", UNDEFINED, implicit)
                                          + open_item(nested_open) + end) + end,
        "private icon": open_item(encode(icon, implicit)) + end,
    }.items():
        one(name.replace(" ", "-"), with_private(content))
    # Against the standard, but written.
    one("private-explicit-items", with_private(open_item(explicit) + end))
    one("private-stated", with_private(item(inside), len(item(inside))))
    noise = bytes(range(1, 251))
    one("private-bytes", with_private(noise, len(noise)))


def functional_groups(cases):
    frames = [frame_groups(k) for k in range(3)]
    ds = enhanced(frames, patterns(3), shared={
        "PixelValueTransformationSequence": one_item(RescaleSlope=2, RescaleIntercept=-24)
    })
    expected = expected_of(patterns(3) * 2.0 - 24, SPACING, ORIGIN)
    for name, keywords, undefined in (
        ("groups-undefined", (SHARED, PER_FRAME), True),
        ("groups-stated", (SHARED, PER_FRAME), False),
        ("shared-undefined", (SHARED,), True),
        ("per-frame-stated", (PER_FRAME,), False),
        ("nested-undefined", ("PixelMeasuresSequence", "PlanePositionSequence"), True),
        ("nested-stated", ("PlaneOrientationSequence", "PlanePositionSequence"), False),
        ("nested-elements", ("PixelSpacing", "ImagePositionPatient", "RescaleSlope"), False),
        ("frames-all", ("all",), True),
    ):
        cases.one(name, file_of(ds, Style(), unknown(*keywords, undefined=undefined)), expected, STANDARD)
    outer = Style(undefined=True)
    choose = unknown(SHARED, PER_FRAME, undefined=True)
    cases.one("groups-in-open-sequences", file_of(ds, outer, choose), expected, STANDARD)


def times(cases):
    """Two volumes told apart by a double of unknown representation."""
    datasets = [image(k, t, SOPClassUID="1.2.840.10008.5.1.4.1.1.4", Modality="MR",
                      DiffusionBValue=500.0 * t, InstanceNumber=1) for t in (0, 1) for k in range(3)]
    names = [f"{n}.dcm" for n in (3, 0, 4, 1, 5, 2)]
    files = [file_of(ds, Style(), unknown("DiffusionBValue")) for ds in datasets]
    cases.stack("double-b-value", files, described(datasets[3:]), STANDARD, names=names,
                time_points=2, options={"time": 2})


def colors(cases):
    """Palette descriptors, several US in one element."""
    tables = {c: np.arange(256, dtype=np.uint8)[::s].tobytes() for c, s in zip("RGB", (1, -1, 1))}
    ds = image(0, pixels=np.arange(30, dtype=np.uint8).reshape(5, 6))
    ds.PhotometricInterpretation = "PALETTE COLOR"
    for name, letter in (("Red", "R"), ("Green", "G"), ("Blue", "B")):
        setattr(ds, f"{name}PaletteColorLookupTableDescriptor", [256, 0, 8])
        ds[f"{name}PaletteColorLookupTableDescriptor"].VR = "US"
        setattr(ds, f"{name}PaletteColorLookupTableData", tables[letter])
    names = [e.keyword for e in ds if "PaletteColor" in e.keyword]
    index = ds.pixel_array[None]
    voxels = np.stack([index, 255 - index, index], axis=-1)
    cases.one("palette", file_of(ds, Style(), unknown(*names)), expected_of(voxels), "PS3.3 C.7.6.3.1.5")


def make(cases):
    cases.kind = "un"
    stack(cases, "geometry", unknown(*GEOMETRY))
    stack(cases, "pixels", unknown(*PIXELS))
    stack(cases, "all-but-pixel-data", unknown("all"))
    stack(cases, "pixel-data", unknown("PixelData"))
    stack(cases, "everything", unknown("all", "PixelData"))
    stack(cases, "signed-pixels", unknown(*PIXELS), datasets=[
        image(k, pixels=-pattern(k, dtype=np.int16)) for k in range(3)
    ])
    stack(cases, "big-endian-geometry", unknown(*GEOMETRY), Style(big=True))
    stack(cases, "big-endian-pixels", unknown(*PIXELS), Style(big=True))
    stack(cases, "spaced-decimals", unknown(*GEOMETRY), datasets=slices(
        PixelSpacing=[0.8000000000001, 0.6000000000001],
        ImageOrientationPatient=["1", "0", "-0.0", "0", "+1", "0"],
    ))
    stack(cases, "empty-rescale", unknown("RescaleSlope", "RescaleIntercept"), datasets=[
        image(k, RescaleSlope="", RescaleIntercept="") for k in range(3)
    ])
    text = {"SpecificCharacterSet": "ISO_IR 192", "SeriesDescription": "Schädel 頭部"}
    stack(cases, "text", unknown("SpecificCharacterSet", "SeriesDescription", "Modality"),
          datasets=slices(**text), description=text["SeriesDescription"], modality="CT")
    icon = data_set(Rows=2, Columns=2, SamplesPerPixel=1, PhotometricInterpretation="MONOCHROME2",
                    BitsAllocated=8, BitsStored=8, HighBit=7, PixelRepresentation=0)
    icon.PixelData = b"\1\2\3\4"
    icon["PixelData"].VR = "OB"
    stack(cases, "icon", unknown("IconImageSequence", undefined=True),
          datasets=slices(IconImageSequence=Sequence([icon])))
    datasets = slices(4)
    files = [file_of(ds, Style(), unknown(*GEOMETRY) if k % 2 else plain) for k, ds in enumerate(datasets)]
    cases.stack("every-second-slice", files, described(datasets), agrees(files, datasets, STANDARD),
                series=1, time_points=1)
    ds = multiframe(patterns(3), SpacingBetweenSlices="2.5")
    keywords = ("NumberOfFrames", "SpacingBetweenSlices", "PixelSpacing")
    cases.one("number-of-frames", file_of(ds, Style(), unknown(*keywords)), expected_of(patterns(3), SPACING),
              STANDARD)
    ds = segmentation("ISO_IR 192", ("liver", "kidney"))
    for name, is_open in (("segments-undefined", True), ("segments-stated", False)):
        choose = unknown("SegmentSequence", "SharedFunctionalGroupsSequence",
                         "PerFrameFunctionalGroupsSequence", undefined=is_open)
        right = {"size": [8, 8, 1], "values": [[2, 2, 0, 1], [5, 5, 0, 2]]}
        cases.one(name, file_of(ds, Style(), choose), right, STANDARD, modality="SEG",
                  labels={"1": "liver", "2": "kidney"})
    private_cases(cases)
    functional_groups(cases)
    times(cases)
    colors(cases)
