"""Which images belong to one volume: tolerances, units, identifiers, and differences by image."""

import os

import numpy as np

from .base import MR, ORIGIN, PET, described, image, pattern, series_reader_agrees


def stack(cases, name, datasets, **more):
    """Slices in order, that are one volume."""
    more = {"series": 1, "time_points": 1, **more}
    expected = described(datasets)
    cases.stack(name, datasets, expected, "pydicom", **more)
    if series_reader_agrees(os.path.join(cases.folder, cases.where(name)), expected):
        cases.list[-1]["peer"] = "pydicom, SimpleITK"


def jitter(cases):
    """Numbers that differ in their last digits from image to image."""
    random = np.random.default_rng(7)
    a = 0.0005
    for exponent in (9, 8, 7, 6, 5, 4):
        size = 10.0**-exponent
        datasets = []
        for k in range(4):
            turn = a + size * (k % 2 * 2 - 1)
            x = [np.cos(turn), np.sin(turn), 0.0]
            y = [-np.sin(turn), np.cos(turn), 0.0]
            directions = [f"{v:.10f}" for v in x + y]
            datasets.append(image(k, ImageOrientationPatient=directions))
        stack(cases, f"orientation-1e-{exponent}", datasets, not_warns=["uneven", "varies", "missing"])
    oblique = np.linalg.qr(random.normal(size=(3, 3)))[0]
    for exponent in (8, 6, 5):
        datasets = []
        for k in range(4):
            noise = random.normal(size=(2, 3)) * 10.0**-exponent
            along = [f"{v:.9g}" for v in (oblique[:2] + noise).ravel()]
            normal = np.cross(oblique[0], oblique[1])
            at = [f"{v:.9g}" for v in ORIGIN + normal * 2.5 * k]
            datasets.append(image(k, ImageOrientationPatient=along, ImagePositionPatient=at))
        stack(cases, f"oblique-1e-{exponent}", datasets, not_warns=["uneven", "varies", "missing"])
    for name, values in {
        "spacing-0.4885": ["0.48849999", "0.4885"],
        "spacing-1e-6": ["0.7812500", "0.7812509"],
        "spacing-1e-5": ["0.70000", "0.70001"],
        "spacing-float": ["0.683593988418579", "0.68359375"],
    }.items():
        datasets = [image(k, PixelSpacing=[values[k % 2]] * 2) for k in range(5)]
        stack(cases, name, datasets)
    for name, axis, size in (
        ("position-aside-1e-4", 0, 1e-4),
        ("position-aside-1e-3", 1, 1e-3),
        ("position-along-1e-5", 2, 1e-5),
        ("position-along-1e-4", 2, 1e-4),
    ):
        datasets = []
        for k in range(5):
            at = [ORIGIN[0], ORIGIN[1], ORIGIN[2] + 2.5 * k]
            at[axis] += size * (-1, 1, 0.5)[k % 3] if 0 < k < 4 else 0
            datasets.append(image(k, ImagePositionPatient=[f"{v:.7f}" for v in at]))
        stack(cases, name, datasets, not_warns=["uneven", "varies", "missing", "aligned"])


def units(cases):
    """Volumes from nanometres to metres."""
    for name, step, across in (
        ("half-a-nanometre", 5e-7, 5e-7),
        ("ten-nanometres", 1e-5, 1e-5),
        ("half-a-micrometre", 5e-4, 5e-4),
        ("a-micrometre", 1e-3, 2e-3),
        ("thin-slices-of-wide-pixels", 1e-3, 0.5),
        ("five-metres", 5000.0, 100.0),
        ("wide-slices-of-fine-pixels", 20.0, 1e-3),
    ):
        datasets = [
            image(k, ImagePositionPatient=["0", "0", f"{step * k:.10g}"], PixelSpacing=[f"{across:.9g}"] * 2)
            for k in range(5)
        ]
        stack(cases, name, datasets, not_warns=["uneven", "varies", "missing", "same place"])
    datasets = [image(k, ImagePositionPatient=["0", "0", f"{100000 + 0.001 * k:.3f}"],
                      PixelSpacing=[0.001] * 2) for k in range(5)]
    stack(cases, "micrometres-far-away", datasets)


def numbers(cases):
    """Spellings of numbers."""
    zeros = [["1", "0", "0", "0", "1", "0"], ["1", "-0", "-0.0", "0.0", "1", "-0"],
             ["1.0", "-0.00000", "0e0", "-0e+0", "+1", "0"]]
    stack(cases, "negative-zero", [image(k, ImageOrientationPatient=zeros[k % 3]) for k in range(4)])
    long = ["-12.345678901234", "0.33333333333333", "-3.3333333333e-7"]
    stack(cases, "sixteen-digits", [
        image(k, ImagePositionPatient=[long[0], long[1], f"{1 / 3 + 0.7 * k:.14f}"]) for k in range(4)])
    stack(cases, "more-than-sixteen-digits", [
        image(k, ImagePositionPatient=["1.0000000000000000001", "2", f"{0.1 + 0.7 * k:.20f}"],
              PixelSpacing=["0.78125000000000000", "0.78125000000000000"]) for k in range(4)])
    stack(cases, "exponents", [
        image(k, ImagePositionPatient=["1e0", "+2.0E+00", f"{0.25 * k:.4e}"], PixelSpacing=["8E-1", ".6"])
        for k in range(4)])
    stack(cases, "blanks", [
        image(k, ImagePositionPatient=[" 1 ", " 2", f"{2.5 * k} "], PixelSpacing=["0.8 ", " 0.6"])
        for k in range(4)])
    stack(cases, "descending-instances", [image(k, InstanceNumber=9 - k) for k in range(4)])
    for name, along, step in (
        ("sagittal", [0, 1, 0, 0, 0, -1], [-1, 0, 0]),
        ("coronal", [1, 0, 0, 0, 0, -1], [0, 1, 0]),
        ("tilted-head", [1, 0, 0, 0, 0.8, -0.6], [0, 0.6, 0.8]),
    ):
        stack(cases, name, [
            image(k, ImageOrientationPatient=along,
                  ImagePositionPatient=[o + 2.5 * k * s for o, s in zip(ORIGIN, step)])
            for k in range(4)])


def identifiers(cases):
    stack(cases, "same-instance-uid", [image(k, SOPInstanceUID="1.2.3.4.1") for k in range(5)])
    two = [image(k, SOPInstanceUID=f"1.2.3.4.{k // 2}") for k in range(6)]
    stack(cases, "same-instance-uid-in-pairs", two)
    stack(cases, "no-instance-uid", [image(k, SOPInstanceUID="") for k in range(4)])
    stack(cases, "no-series-uid", [image(k, SeriesInstanceUID=None) for k in range(4)])
    stack(cases, "same-instance-number", [image(k, InstanceNumber=1) for k in range(4)])
    copies = [image(k) for k in range(4)]
    names = [f"{k}.dcm" for k in range(4)] + [f"copy of {k}.dcm" for k in range(4)]
    cases.stack("copies", copies * 2, described(copies), "pydicom", names=names, series=1, time_points=1)
    names = [f"{k}.dcm" for k in range(4)] + ["backup/2.dcm"]
    cases.stack("one-copy", copies + [copies[2]], described(copies), "pydicom", names=names,
                series=1, time_points=1)
    # An anonymiser that gave every image the same identifier, and a second volume.
    times = [image(k, t, SOPInstanceUID="1.2.3.4.1", AcquisitionTime=f"10000{t}", SOPClassUID=MR,
                   Modality="MR") for t in (0, 1) for k in range(4)]
    cases.stack("same-instance-uid-two-times", times, described(times[4:]), "pydicom",
                time_points=2, options={"time": 2})


def separate(cases):
    """What must not be mixed."""
    body = [image(k) for k in range(4)]
    localizer = image(5, ImageOrientationPatient=[0, 1, 0, 0, 0, -1], ImagePositionPatient=[4, 0, 9],
                      ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"], InstanceNumber=1)
    cases.stack("localizer", body + [localizer], described(body), "pydicom", series=2,
                not_warns=["aligned", "uneven", "varies"])
    first = image(5, ImageOrientationPatient=[0, 1, 0, 0, 0, -1], ImagePositionPatient=[4, 0, 9],
                  InstanceNumber=0)
    names = ["0000.dcm"] + [f"{k + 1:04}.dcm" for k in range(4)]
    cases.stack("localizer-first", [first] + body, described(body), "pydicom", names=names, series=2)
    other = image(5, pixels=pattern(9, columns=7, rows=4), SeriesDescription="other")
    cases.stack("other-size", body + [other], described(body), "pydicom", series=2)
    big = [image(k, 1, SeriesInstanceUID="1.2.3.5", SeriesNumber=4, SeriesDescription="B") for k in range(3)]
    cases.stack("two-series", body + big, described(body), "pydicom", series=2)
    cases.add("two-series-second", cases.where("two-series"), "pydicom", described(big),
              options={"series": "2"}, description="B")
    # Two series that an anonymiser gave one identifier: at the same places, and apart.
    same = [image(k, 1, SeriesNumber=4, SeriesDescription="B") for k in range(4)]
    cases.stack("same-series-uid", body + same, described(body), "pydicom, by SeriesNumber")
    mixed = [image(k, 1, SeriesNumber=4, SeriesDescription="B", InstanceNumber=8 - k,
                   SOPInstanceUID=f"1.2.3.4.0.{k + 1}") for k in range(4)]
    cases.stack("same-uids-of-two-series", body + mixed, described(body), "pydicom, by SeriesNumber")
    wide = [image(k, 1, PixelSpacing=[1.6, 1.2], InstanceNumber=20 + k) for k in range(3)]
    cases.stack("other-spacing", body + wide, described(body), "pydicom", series=2)
    turned = [image(k, 1, ImageOrientationPatient=[0.8, 0.6, 0, -0.6, 0.8, 0], InstanceNumber=20 + k)
              for k in range(3)]
    cases.stack("other-orientation", body + turned, described(body), "pydicom", series=2)


def by_image(cases):
    """Attributes that differ from image to image of one volume."""
    def signs(k):
        return image(k, pixels=pattern(k, dtype=np.int16 if k % 2 else np.uint16) - (300 if k % 2 else 0))

    stack(cases, "pixel-representation", [signs(k) for k in range(4)])
    stack(cases, "bits-stored", [image(k, BitsStored=12 + k, HighBit=11 + k) for k in range(4)])
    stack(cases, "rescale-slope", [
        image(k, SOPClassUID=PET, Modality="PT", RescaleSlope=f"{0.5 + 0.25 * k}", RescaleIntercept="0")
        for k in range(4)])
    stack(cases, "rescale-intercept", [
        image(k, RescaleSlope="1", RescaleIntercept=f"{-1024 + 100 * k}") for k in range(4)])
    stack(cases, "rescale-in-one", [
        image(k, **({"RescaleSlope": "2", "RescaleIntercept": "-10"} if k == 2 else {})) for k in range(4)])
    stack(cases, "intercept-without-slope", [image(k, RescaleIntercept="-1024") for k in range(4)])
    stack(cases, "slope-without-intercept", [image(k, RescaleSlope="0.5") for k in range(4)])
    stack(cases, "padding-value", [image(k, PixelPaddingValue=65535 - k) for k in range(4)])
    stack(cases, "window", [image(k, WindowCenter=40 + k, WindowWidth=400 - k) for k in range(4)])
    stack(cases, "exposure", [image(k, KVP=120, XRayTubeCurrent=100 + k, ExposureTime=500 - k)
                              for k in range(4)])
    stack(cases, "acquisition-number", [image(k, AcquisitionNumber=k + 1) for k in range(4)])
    stack(cases, "acquisition-time", [image(k, AcquisitionTime=f"1000{k:02}.5") for k in range(4)])
    stack(cases, "content-time-descending", [image(k, ContentTime=f"1000{9 - k:02}") for k in range(4)])
    stack(cases, "trigger-time", [image(k, SOPClassUID=MR, Modality="MR", TriggerTime=100.5 * (k % 3))
                                  for k in range(4)])
    stack(cases, "echo-time-jitter", [image(k, SOPClassUID=MR, Modality="MR", EchoTime=f"{4.6 + k * 1e-5}")
                                      for k in range(4)])
    types = (["DERIVED", "PRIMARY"], ["ORIGINAL", "PRIMARY", "AXIAL"])
    stack(cases, "image-type", [image(k, ImageType=types[k % 2]) for k in range(4)])
    stack(cases, "thickness", [image(k, SliceThickness=2.5 + k * 1e-4) for k in range(4)])
    stack(cases, "study-uid", [image(k, StudyInstanceUID=f"1.2.{k}") for k in range(4)])
    stack(cases, "modality-missing-once", [
        image(k, **({"Modality": ""} if k == 1 else {})) for k in range(4)])


def make(cases):
    cases.kind = "grouping"
    jitter(cases)
    units(cases)
    numbers(cases)
    identifiers(cases)
    separate(cases)
    by_image(cases)
