"""Volumes that differ in little, lie between each other's planes, or lack what tells them apart."""

import numpy as np

from .base import MR, ORIGIN, SPACING, described, encoded, image, multiframe, patterns
from .characters import segmentation
from .times import each, private, shuffled, stack


def between(cases, name, by_time, slices=4):
    """Two volumes, the planes of one halfway between those of the other."""
    datasets = []
    for t, attributes in enumerate(by_time):
        for k in range(slices):
            place = [ORIGIN[0], ORIGIN[1], ORIGIN[2] + SPACING[2] * (k + 0.5 * t)]
            datasets.append(image(k, t, SOPClassUID=MR, Modality="MR", InstanceNumber=1 + k,
                                  ImagePositionPatient=place, **attributes))
    names = shuffled(len(datasets), 5)
    for t in range(2):
        right = {**described(datasets[t * slices:(t + 1) * slices]), "time_points": 2, "series": 1}
        options = {"time": t + 1}
        if t == 0:
            cases.stack(f"{name}-time-1", datasets, right, "pydicom", names=names, options=options)
            path = cases.list[-1]["path"]
        else:
            cases.add(f"{name}-time-2", path, "pydicom", right, options=options)


def volumes(cases):
    between(cases, "between-echo", each("EchoTime", "3", "8"))
    between(cases, "between-temporal-position", each("TemporalPositionIdentifier", 1, 2))
    between(cases, "between-description", each("SeriesDescription", "Phase 0%", "Phase 50%"))
    between(cases, "between-kernel", each("ConvolutionKernel", "B30", "B70"))
    between(cases, "between-b-value", each("DiffusionBValue", 0.0, 1000.0))
    passes = [image(k, 0, AcquisitionNumber=1 + k % 2, AcquisitionTime=f"10000{k % 2}") for k in range(8)]
    cases.stack("two-passes-of-one-volume", passes, {**described(passes), "time_points": 1}, "pydicom")
    stack(cases, "echo-that-scatters",
          [lambda k, te=te: {"EchoTime": f"{te + 0.001 * k:.3f}"} for te in (5.0, 10.0)], "random",
          peer="pydicom, by EchoTime")
    stack(cases, "description", each("SeriesDescription", "0%", "10%", "20%"), "random")
    stack(cases, "protocol", each("ProtocolName", "A 1", "A 2"), "random", ordered=False)
    stack(cases, "tube-current", each("XRayTubeCurrent", 100, 200), "random")
    vectors = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    stack(cases, "private-directions",
          [{"DiffusionBValue": 1000.0, **private(0x19, "SIEMENS MR HEADER", 0x0E, "FD", v)} for v in vectors],
          "random", peer="pydicom, by (0019,xx0E)", ordered=False)
    stack(cases, "unknown-private",
          [private(0x21, "SOME SCANNER", 0x05, "DS", v) for v in ("1", "2", "3")], "random",
          peer="pydicom, by a private attribute")


def one_lacks_it(cases):
    datasets = [image(k, t, SOPClassUID=MR, Modality="MR", TemporalPositionIdentifier=t + 1)
                for t in range(2) for k in range(4)]
    del datasets[6].TemporalPositionIdentifier
    for t in range(2):
        right = {**described(datasets[4 * t:4 * t + 4]), "time_points": 2}
        if t == 0:
            cases.stack("attribute-missing-once-time-1", datasets, right, "pydicom", options={"time": 1})
            path = cases.list[-1]["path"]
        else:
            cases.add("attribute-missing-once-time-2", path, "pydicom", right, options={"time": 2})


def guesses(cases):
    datasets = [image(k, t, InstanceNumber=1 + 2 * k + t) for t in range(2) for k in range(4)]
    for n, ds in enumerate(datasets):
        ds.SOPInstanceUID = f"1.2.3.4.7.{n}"
    cases.stack("instance-numbers-alone", datasets, {"size": [6, 5, 4], "time_points": 2}, "notice",
                warns=["instance number", "may mix"])


def segments(cases):
    files = []
    for n, names in enumerate((("liver", "kidney"), ("spleen", "kidney"))):
        ds = segmentation("ISO_IR 100", names)
        ds.SOPInstanceUID = f"1.2.3.4.8.{n}"
        pixels = np.zeros((2, 8, 8), np.uint8)
        pixels[0, 2:4, 2 * n:2 * n + 2] = 1
        pixels[1, 5:7, 5:7] = 1
        ds.PixelData = np.packbits(pixels.ravel(), bitorder="little").tobytes()
        files.append(encoded(ds))
    right = {"size": [8, 8, 1], "values": [[0, 2, 0, 1], [2, 2, 0, 3], [5, 5, 0, 2]],
             "labels": {"1": "liver", "2": "kidney", "3": "spleen"}}
    cases.stack("segments-of-two-files", files, right, "PS3.3 C.8.20.2", warns=["new number"])


def unreadable(cases):
    whole = [encoded(image(k)) for k in range(5)]
    for name, last in (("ends-in-header", whole[4][:300]), ("empty", b""), ("garbage", b"\x07" * 900)):
        files = whole[:4] + [last]
        right = {"size": [6, 5, 4], "values": [[0, 0, 3, 300]]}
        cases.stack(f"last-{name}", files, right, "the others open", warns=[["left out", "damaged"]])


def multi(cases):
    ds = multiframe(patterns(4), SpacingBetweenSlices="2.5", NumberOfFrames=3)
    cases.one("fewer-frames-than-pixels", ds, {"size": [6, 5, 3]}, "notice", warns=["frames"])
    ds = image(0, PixelSpacing=None, PixelAspectRatio=["2", "1"], SliceThickness="1")
    cases.one("aspect-ratio", ds, {"spacing_mm": [1.0, 2.0, 1.0]}, "PS3.3 C.7.6.3.1.7", warns=["1 mm"])
    ds = image(0, RescaleSlope="0", RescaleIntercept="-5", SliceThickness="1")
    cases.one("slope-zero", ds, {"values": [[0, 0, 0, -5.0], [5, 4, 0, 40.0]]}, "notice", warns=["slope"])
    ds = image(0, ImageOrientationPatient=[1, 0, 0, 0.3, 0.954, 0], SliceThickness="1")
    cases.one("rows-not-perpendicular", ds, {"size": [6, 5, 1]}, "PS3.3 C.7.6.2.1.1", warns=["perpendicular"])
    ds = multiframe(patterns(4), SOPClassUID="1.2.840.10008.5.1.4.1.1.481.2", Modality="RTDOSE",
                    ImagePositionPatient=[1, 2, 3], ImageOrientationPatient=[1, 0, 0, 0, 1, 0],
                    GridFrameOffsetVector=["0", "2", "4", "6"])
    cases.one("dose-without-scaling", ds, {"size": [6, 5, 4]}, "PS3.3 C.8.8.3", warns=["dose"])
    pet = [image(k, t, SOPClassUID="1.2.840.10008.5.1.4.1.1.128", Modality="PT", ImageIndex=1 + 4 * t + k,
                 NumberOfSlices=4, NumberOfTimeSlices=2, InstanceNumber=1) for t in range(2) for k in range(4)]
    cases.stack("pet-image-index", pet, {**described(pet[:4]), "time_points": 2}, "PS3.3 C.8.9.4.1.9",
                options={"time": 1})


def make(cases):
    cases.kind = "apart"
    volumes(cases)
    one_lacks_it(cases)
    guesses(cases)
    segments(cases)
    unreadable(cases)
    multi(cases)
