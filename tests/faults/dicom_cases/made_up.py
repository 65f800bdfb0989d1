"""Distances that a file does not state, or states badly: what is assumed must be said."""

import numpy as np

from .base import MR, ORIGIN, SPACING, encoded, enhanced, expected_of, frame_groups, image
from .base import multiframe, one_item, patterns

PIXEL = ["spacing", "1 mm"]
UNEVEN = ["uneven", "varies", "vary", "missing", "irregular", "not even"]
UNPLACED = {"ImagePositionPatient": None, "ImageOrientationPatient": None, "FrameOfReferenceUID": None}


def unplaced(k, **attributes):
    return image(k, **{**UNPLACED, **attributes})


def single(cases):
    """One file."""
    one = patterns(1)
    cases.one("no-pixel-spacing", image(0, PixelSpacing=None), expected_of(one), "notice",
              spacing_mm=[1, 1, 1], warns=PIXEL)
    cases.one("empty-pixel-spacing", image(0, PixelSpacing=""), expected_of(one), "notice",
              spacing_mm=[1, 1, 1], warns=PIXEL)
    cases.one("no-pixel-spacing-with-thickness", image(0, PixelSpacing=None, SliceThickness="3"),
              expected_of(one), "notice", spacing_mm=[1, 1, 3], warns=PIXEL)
    cases.one("zero-pixel-spacing", image(0, PixelSpacing=[0, 0]), expected_of(one), "notice",
              warns=["spacing"])
    cases.one("zero-row-spacing", image(0, PixelSpacing=[0, 0.6]), expected_of(one), "notice",
              warns=["spacing"])
    cases.one("negative-pixel-spacing", image(0, PixelSpacing=[-0.8, -0.6]), expected_of(one), "notice",
              warns=["spacing"])
    cases.one("one-value-of-pixel-spacing", image(0, PixelSpacing=0.7), expected_of(one), "notice",
              warns=["spacing"])
    letters = encoded(image(0, PixelSpacing=["1.5", "2.5"])).replace(b"1.5\\2.5", b"abc\\def")
    cases.one("letters-for-pixel-spacing", letters, expected_of(one), "notice", warns=["spacing"])
    cases.one("not-square", image(0, PixelSpacing=[2.0, 0.25]), expected_of(one), "PS3.3 10.7.1.3",
              spacing_mm=[0.25, 2.0, 1.0])
    imager = dict(PixelSpacing=None, ImagerPixelSpacing=[0.2, 0.1], Modality="DX", **UNPLACED)
    cases.one("imager-spacing", image(0, **imager), expected_of(one, [0.1, 0.2, 1.0]), "PS3.3 C.8.11.7",
              warns=[["detector", "imager", "magnif"]])
    nominal = dict(PixelSpacing=None, NominalScannedPixelSpacing=[0.2, 0.1], Modality="OT", **UNPLACED)
    cases.one("nominal-spacing", image(0, **nominal), expected_of(one, [0.1, 0.2, 1.0]), "PS3.3 C.8.6.2")
    both = dict(PixelSpacing=[0.15, 0.15], ImagerPixelSpacing=[0.2, 0.2], Modality="DX", **UNPLACED)
    cases.one("imager-and-pixel-spacing", image(0, **both), expected_of(one), "PS3.3 10.7.1.3",
              spacing_mm=[0.15, 0.15, 1.0])
    aspect = dict(PixelSpacing=None, PixelAspectRatio=[2, 1], **UNPLACED)
    cases.one("aspect-ratio", image(0, **aspect), expected_of(one), "PS3.3 C.7.6.3.1.7", warns=["spacing"])
    cases.one("thickness", image(0, SliceThickness="4"), expected_of(one, [0.6, 0.8, 4.0]), "pydicom")
    cases.one("spacing-between", image(0, SpacingBetweenSlices="3", SliceThickness="4"),
              expected_of(one, [0.6, 0.8, 3.0]), "PS3.3 C.7.6.2")
    cases.one("no-orientation", image(0, ImageOrientationPatient=None), expected_of(one, None, ORIGIN),
              "notice", warns=["orientation"])
    cases.one("no-position", image(0, ImagePositionPatient=None), expected_of(one), "notice",
              warns=["position"])


def several(cases):
    """A file of several frames, and several files, without positions."""
    four = patterns(4)
    cases.one("frames-without-distance", multiframe(four, PixelSpacing=[0.3, 0.3]),
              expected_of(four, [0.3, 0.3, 1.0]), "notice", warns=["1 mm"])
    cases.one("frames-with-thickness", multiframe(four, SliceThickness="2"),
              expected_of(four, [0.6, 0.8, 2.0]), "notice", warns=["thickness"])
    cases.one("frames-with-spacing", multiframe(four, SpacingBetweenSlices="3", SliceThickness="2"),
              expected_of(four, [0.6, 0.8, 3.0]), "PS3.3 C.7.6.2", not_warns=["1 mm", "thickness"])
    cases.one("frames-with-zero-spacing", multiframe(four, SpacingBetweenSlices="0"),
              expected_of(four, [0.6, 0.8, 1.0]), "notice", warns=["1 mm"])
    cases.one("frames-with-zero-thickness", multiframe(four, SliceThickness="0"),
              expected_of(four, [0.6, 0.8, 1.0]), "notice", warns=["1 mm"])
    cases.one("frames-without-anything", multiframe(four, PixelSpacing=None),
              expected_of(four, [1.0, 1.0, 1.0]), "notice", warns=["spacing", "1 mm"])
    frames = [frame_groups(position=()) for _ in range(4)]
    measures = {"PixelMeasuresSequence": one_item(PixelSpacing=[0.8, 0.6])}
    ds = enhanced(frames, four, shared={**measures, "PlaneOrientationSequence": None})
    cases.one("enhanced-without-position", ds, expected_of(four, [0.6, 0.8, 1.0]), "notice",
              warns=["position", "1 mm"])
    files = lambda **a: [unplaced(k, **a) for k in range(4)]
    cases.stack("files-without-distance", files(), expected_of(four, [0.6, 0.8, 1.0]), "notice",
                warns=["1 mm"])
    cases.stack("files-with-thickness", files(SliceThickness="2"), expected_of(four, [0.6, 0.8, 2.0]),
                "notice", warns=["thickness"])
    cases.stack("files-with-spacing", files(SpacingBetweenSlices="3"), expected_of(four, [0.6, 0.8, 3.0]),
                "PS3.3 C.7.6.2", not_warns=["1 mm"])
    location = [unplaced(k, SliceLocation=f"{10 + 4 * k}") for k in range(4)]
    cases.stack("files-with-location", location, expected_of(four), "notice",
                warns=[["position", "location"]])
    locations = [unplaced(k, SliceLocation=f"{10 + 4 * k}", InstanceNumber=None) for k in (2, 0, 3, 1)]
    cases.stack("files-with-location-alone", locations, {"size": [6, 5, 4]}, "notice",
                warns=[["position", "location"]])
    numbered = [unplaced(k, InstanceNumber=n) for k, n in enumerate((2, 9, 10, 101))]
    cases.stack("order-of-instance-numbers", numbered, expected_of(four), "PS3.3 C.7.6.1",
                names=["d", "c", "b", "a"], warns=["instance number"])
    for name, names in {
        "names-im": ["IM1", "IM2", "IM9", "IM10"],
        "names-slice": ["slice 1.dcm", "slice 9.dcm", "slice 10.dcm", "slice 100.dcm"],
        "names-parentheses": ["a (1).dcm", "a (2).dcm", "a (11).dcm", "a (12).dcm"],
        "names-uid": [f"1.2.840.{n}.dcm" for n in (8, 9, 10, 11)],
    }.items():
        slices = [unplaced(k, InstanceNumber=None) for k in range(4)]
        cases.stack(name, slices, expected_of(four), "order of the numbers in the names", names=names)
    same = [unplaced(k, InstanceNumber=1) for k in range(4)]
    cases.stack("names-with-equal-numbers", same, expected_of(four), "order of the numbers in the names",
                names=["IM1", "IM2", "IM10", "IM20"])
    slices = [image(k, ImagePositionPatient=None) for k in range(4)]
    cases.stack("orientation-alone", slices, expected_of(four), "notice", warns=["position", "1 mm"])
    slices = [image(k) if k == 0 else unplaced(k) for k in range(4)]
    cases.stack("position-of-first-alone", slices, {}, "notice", warns=[["position", "series"]])
    cases.stack("no-spacing-of-slices", [image(k, PixelSpacing=None) for k in range(4)],
                expected_of(four, [1.0, 1.0, 2.5], ORIGIN), "notice", warns=PIXEL)


def at(steps, scale=1.0, **attributes):
    return [image(n, ImagePositionPatient=["0", "0", f"{z * scale:.10g}"], PixelSpacing=[f"{scale:.10g}"] * 2,
                  **attributes) for n, z in enumerate(steps)]


def uneven(cases):
    """Uneven distances, from nanometres to metres."""
    n = 7
    scales = {"nanometres": 1e-6, "micrometres": 1e-3, "millimetres": 1.0, "metres": 1000.0}
    for name, scale in scales.items():
        even = [2.0 * k for k in range(n)]
        cases.stack(f"even-{name}", at(even, scale), expected_of(patterns(n), [scale, scale, 2 * scale]),
                    "SimpleITK", not_warns=UNEVEN)
        varied = [0, 2, 4.4, 6, 8, 10.3, 12]
        cases.stack(f"uneven-{name}", at(varied, scale), expected_of(patterns(n)), "notice", warns=[UNEVEN])
        missing = [0, 2, 4, 8, 10, 12, 14]
        cases.stack(f"missing-{name}", at(missing, scale), expected_of(patterns(n)), "notice",
                    warns=["missing"])
    slight = [0, 2.0004, 4, 6.0003, 8, 10, 12]
    cases.stack("rounded-positions", at(slight), expected_of(patterns(n), [1, 1, 2]), "SimpleITK",
                not_warns=UNEVEN)
    cases.stack("two-missing", at([0, 2, 4, 10, 12, 14, 16]), expected_of(patterns(n)), "notice",
                warns=["missing"])
    cases.stack("two-parts", at([0, 2, 4, 50, 52, 54, 56]), expected_of(patterns(n)), "notice",
                warns=[UNEVEN])
    cases.stack("overlapping-slices", at(range(4), SliceThickness="2"), expected_of(patterns(4), [1, 1, 1]),
                "PS3.3 C.7.6.2", not_warns=UNEVEN)
    cases.stack("spacing-contradicts-positions", at([0, 2, 4], SpacingBetweenSlices="5"),
                expected_of(patterns(3), [1, 1, 2]), "positions count")
    frames = [frame_groups(position=[0.0, 0.0, z]) for z in (0.0, 2.0, 4.0, 8.0)]
    cases.one("enhanced-missing", enhanced(frames, patterns(4)), expected_of(patterns(4)), "notice",
              warns=["missing"])
    three = [image(k) for k in (0, 1, 3, 4)]
    cases.stack("resampled", three, {"size": [6, 5, 5], "spacing_mm": SPACING, "values": [
        [0, 0, 0, 0], [0, 0, 2, 200], [3, 2, 3, 323], [5, 4, 4, 445]]}, "linear between slices",
        options={"resample": True}, warns=["interpolated"])


def tilted(cases):
    """Slices that are shifted within their planes."""
    tilt = np.tan(np.radians(15))
    slices = [image(k, SOPClassUID=MR, Modality="MR",
                    ImagePositionPatient=[0, f"{2 * k * tilt:.8f}", f"{2 * k}"]) for k in range(4)]
    expected = expected_of(patterns(4), [0.6, 0.8, 2 / np.cos(np.radians(15))], [0, 0, 0])
    expected["direction"] = [[1, 0, 0], [0, 1, float(np.sin(np.radians(15)))],
                             [0, 0, float(np.cos(np.radians(15)))]]
    cases.stack("tilt", slices, expected, "PS3.3 C.7.6.2.1.1", not_warns=UNEVEN)
    zigzag = [image(k, ImagePositionPatient=[3.0 * (k % 2), 0, 2.0 * k]) for k in range(4)]
    cases.stack("zigzag", zigzag, expected_of(patterns(4)), "notice",
                warns=[["aligned", "line", "offset", "shift"]])
    fan = [image(k, ImageOrientationPatient=[1, 0, 0, 0, float(np.cos(k * 0.3)), float(np.sin(k * 0.3))],
                 ImagePositionPatient=[0, 0, 0]) for k in range(4)]
    cases.stack("fan", fan, {}, "radial slices are no volume", warns=["series"])
    gantry = [image(k, GantryDetectorTilt="15", ImagePositionPatient=[0, 0, 2 * k],
                    ImageOrientationPatient=[1, 0, 0, 0, float(np.cos(0.2618)), float(np.sin(0.2618))])
              for k in range(4)]
    cases.stack("gantry-tilt", gantry, {"size": [6, 5, 4], "values": [[0, 0, 3, 300]]}, "PS3.3 C.8.2.1.1.1")


def make(cases):
    cases.kind = "made up"
    single(cases)
    several(cases)
    uneven(cases)
    tilted(cases)
