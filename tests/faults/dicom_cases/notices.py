"""What a user must be told, and files beside which others are damaged."""

import numpy as np

from .base import ORIGIN, SPACING, data_set, described, encoded, enhanced, expected_of, frame_groups
from .base import image, pattern, patterns
from .encoding import UNDEFINED, Style, bare, file_of, header


def displayed(cases):
    """Grey values that are shown otherwise than they are stored."""
    one = patterns(1)
    cases.one("monochrome1", image(0, PhotometricInterpretation="MONOCHROME1"), expected_of(one),
              "PS3.3 C.7.6.3.1.2", warns=[["inverted", "MONOCHROME1", "white"]])
    cases.stack("monochrome1-slices", [image(k, PhotometricInterpretation="MONOCHROME1") for k in range(3)],
                expected_of(patterns(3), SPACING), "PS3.3 C.7.6.3.1.2",
                warns=[["inverted", "MONOCHROME1", "white"]])
    inverse = image(0, PresentationLUTShape="INVERSE")
    cases.one("presentation-inverse", inverse, expected_of(one), "PS3.3 C.11.6.1",
              warns=[["inverted", "INVERSE", "white"]])
    table = (np.arange(512) * 3 + 7).astype(np.uint16)
    for name, first, bits in (("modality-table", 0, 16), ("modality-table-first", 10, 16)):
        lut = data_set(LUTDescriptor=[512, first, bits], ModalityLUTType="HU", LUTData=table.tobytes())
        lut["LUTDescriptor"].VR, lut["LUTData"].VR = "US", "OW"
        ds = image(0, ModalityLUTSequence=[lut])
        mapped = table[np.clip(pattern(0).astype(int) - first, 0, 511)][None]
        said = {"size": [6, 5, 1], "warns": [["LUT", "table"]]}
        cases.one(name, ds, {"either": [expected_of(mapped), said]}, "PS3.3 C.11.1.1: applied, or said")
    voi = data_set(LUTDescriptor=[512, 0, 16], LUTData=table.tobytes())
    voi["LUTDescriptor"].VR, voi["LUTData"].VR = "US", "OW"
    cases.one("display-table", image(0, VOILUTSequence=[voi]), expected_of(one), "PS3.3 C.11.2: display only")


def references(cases):
    """Several frames of reference, and files beside a file."""
    peer = "PS3.3 C.7.4.1.1.1"
    split = [image(k, FrameOfReferenceUID=f"1.2.3.9.{k // 2}") for k in range(4)]
    cases.stack("frames-of-reference", split, {}, peer, warns=[["frame of reference", "frames of reference",
                                                                "series"]])
    other = [image(k, 1, FrameOfReferenceUID="1.2.3.10", InstanceNumber=10 + k) for k in range(3)]
    cases.stack("frames-of-reference-at-the-same-place", [image(k) for k in range(4)] + other,
                {"size": [6, 5, 4]}, peer, warns=[["frame of reference", "frames of reference", "series"]])
    missing = [image(k, **({"FrameOfReferenceUID": None} if k == 2 else {})) for k in range(4)]
    cases.stack("frame-of-reference-missing-once", missing, expected_of(patterns(4), SPACING, ORIGIN), peer,
                not_warns=["frame of reference", "frames of reference"])
    slices = [image(k) for k in range(4)]
    cases.stack("siblings", slices, described(slices), "pydicom")
    path = cases.where("siblings", "/1.dcm")
    said = [["folder", "beside", "other", "series"]]
    cases.add("one-of-a-folder", path, "notice", described([slices[1]]), warns=said)
    names = ["IM1", "IM2", "IM3"]
    cases.stack("siblings-without-extension", slices[:3], described(slices[:3]), "pydicom", names=names)
    cases.add("one-without-extension", cases.where("siblings-without-extension", "/IM2"), "notice",
              described([slices[1]]), warns=said)
    cases.one("alone", image(0), described([image(0)]), "pydicom", ending="/only.dcm",
              not_warns=["folder", "beside"])
    strangers = [image(0), image(0, 1, SeriesInstanceUID="1.2.3.5", SOPInstanceUID="1.2.3.5.1")]
    for name, ds in zip(("a", "b"), strangers):
        cases.write(cases.where("other-series-beside", f"/{name}.dcm"), ds)
    cases.add("other-series-beside", cases.where("other-series-beside", "/a.dcm"), "pydicom",
              described([strangers[0]]), not_warns=["folder", "beside"])
    volume = enhanced([frame_groups(k) for k in range(3)], patterns(3), SOPInstanceUID="1.2.3.4.77")
    cases.write(cases.where("enhanced-beside", "/0.dcm"), volume)
    cases.write(cases.where("enhanced-beside", "/1.dcm"), image(1))
    cases.add("enhanced-beside", cases.where("enhanced-beside", "/0.dcm"), "notice",
              expected_of(patterns(3), SPACING, ORIGIN), time_points=1)


def damaged(cases):
    """One slice of a series is damaged: the others open, and the rest is said."""
    whole = [encoded(image(k)) for k in range(5)]
    pieces = {
        "truncated": whole[2][:-20],
        "truncated-by-one-byte": whole[2][:-1],
        "truncated-in-header": whole[2][:400],
        "truncated-at-pixel-data": whole[2][:-60],
        "empty-file": b"",
        "text": b"not an image\n" * 20,
        "zeros": bytes(len(whole[2])),
        "preamble-alone": whole[2][:132],
        "length-beyond": whole[2].replace(b"PN\x0c\0", b"PN\xff\x7f"),
        "no-rows": encoded(image(2, Rows=None)),
        "zero-rows": encoded(image(2, Rows=0)),
        "no-pixel-data": encoded(image(2, PixelData=None)),
    }
    assert b"PN\x0c\0" in whole[2]
    values = [[0, 0, 0, 0], [0, 0, 1, 100]]
    closed = {"size": [6, 5, 4], "values": [*values, [0, 0, 2, 300], [5, 4, 3, 445]]}
    kept = {"size": [6, 5, 5], "values": [*values, [0, 0, 3, 300], [5, 4, 4, 445]]}
    hole = {"either": [closed, kept]}
    said = ["left out", "damaged", "truncated", "cannot be read", "skipped"]
    for name, data in pieces.items():
        files = whole[:2] + [data] + whole[3:]
        quiet = name in ("empty-file", "text", "zeros", "no-rows", "no-pixel-data", "preamble-alone")
        warns = ["missing"] if quiet else [said, "missing"]
        cases.stack(f"series-{name}", files, hole, "the others open, with a hole that is said", warns=warns)
    for name in ("truncated", "truncated-in-header", "truncated-at-pixel-data"):
        cases.one(f"alone-{name}", pieces[name], {}, "refused", error=[["truncated", "damaged", "short"]])
    first = [whole[0][:-30]] + whole[1:]
    without = {"size": [6, 5, 4], "values": [[0, 0, 0, 100], [0, 0, 3, 400]],
               "origin_mm": [ORIGIN[0], ORIGIN[1], ORIGIN[2] + 2.5]}
    empty = {"size": [6, 5, 5], "values": [[0, 0, 1, 100], [0, 0, 4, 400]], "origin_mm": ORIGIN}
    cases.stack("first-truncated", first, {"either": [without, empty]}, "the others open", warns=[said])
    all_ = [data[:-30] for data in whole]
    cases.stack("all-truncated", all_, {}, "refused", error=[["truncated", "damaged"]])
    for name, syntax, fragments in (
        ("jpeg-lossless-12", "1.2.840.10008.1.2.4.51", ["JPEG", "decoded", "read"]),
        ("mpeg", "1.2.840.10008.1.2.4.102", ["MPEG", "decoded", "known", "read"]),
        ("private", "1.2.3.4.5.6", ["syntax", "decoded", "known", "read"]),
    ):
        strange = packed(image(2), syntax, b"\0\1\2\3" * 8)
        cases.stack(f"syntax-{name}", whole[:2] + [strange] + whole[3:], hole, "the others open",
                    warns=[[*fragments, *said], "missing"])
        cases.one(f"syntax-{name}-alone", strange, {}, "refused",
                  error=[["syntax", "decode", "JPEG", "MPEG"]])
    rle = packed(image(2), "1.2.840.10008.1.2.5", b"\xff" * 70)
    cases.stack("rle-damaged", whole[:2] + [rle] + whole[3:], hole, "the others open",
                warns=[said, "missing"])


def packed(ds, syntax, fragment):
    """A file whose pixel data is one encapsulated fragment."""
    ds.file_meta.TransferSyntaxUID = syntax
    del ds.PixelData
    pixels = header(0x7FE00010, "OB", UNDEFINED, Style()) + bare(0xFFFEE000, 0)
    pixels += bare(0xFFFEE000, len(fragment)) + fragment + bare(0xFFFEE0DD, 0)
    return file_of(ds) + pixels


def others(cases):
    """Files in the folder that are no part of the volume."""
    slices = [image(k) for k in range(3)]
    right = described(slices)
    report = image(0, SOPInstanceUID="1.2.3.4.99", SOPClassUID="1.2.840.10008.5.1.4.1.1.88.11", Modality="SR",
                   SeriesInstanceUID="1.2.3.6", PixelData=None, Rows=None, Columns=None)
    cases.stack("report-beside", slices + [report], right, "pydicom", not_warns=["damaged"])
    for name, file, data in (
        ("text-beside", "readme.txt", b"text\n"),
        ("thumbs-beside", "Thumbs.db", b"\xd0\xcf\x11\xe0"),
        ("store-beside", ".DS_Store", b"\0\0\0\1Bud1"),
        ("fork-beside", "._0.dcm", b"\0\5\x16\7" * 40),
    ):
        cases.stack(name, [encoded(s) for s in slices] + [data], right, "pydicom",
                    names=["0.dcm", "1.dcm", "2.dcm", file], not_warns=["damaged"])
    directory = image(0, SOPClassUID="1.2.840.10008.1.3.10", PixelData=None, Rows=None, Columns=None)
    cases.stack("directory-beside", slices + [directory], right, "pydicom",
                names=["0.dcm", "1.dcm", "2.dcm", "DICOMDIR"], not_warns=["damaged"])
    overview = image(0, 5, pixels=pattern(0, 5, 12, 11), SeriesInstanceUID="1.2.3.6", Modality="OT",
                     SOPInstanceUID="1.2.3.6.1", SOPClassUID="1.2.840.10008.5.1.4.1.1.7")
    for name in ("ImagePositionPatient", "ImageOrientationPatient"):
        delattr(overview, name)
    cases.stack("capture-beside", slices + [overview], {}, "notice", warns=["series"], series=2)


def make(cases):
    cases.kind = "notices"
    displayed(cases)
    references(cases)
    damaged(cases)
    others(cases)
