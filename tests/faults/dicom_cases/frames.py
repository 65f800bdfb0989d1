"""Objects of several frames: doses, nuclear medicine, clips, mosaics, palettes, counts of frames."""

import numpy as np
from nibabel.nicom.dicomwrappers import wrapper_from_data
from pydicom.pixels import apply_color_lut

from . import segmentations
from .base import MR, ORIGIN, SPACING, data_set, encoded, enhanced, expected_of, frame_groups
from .base import image, multiframe, one_item, opened, pattern, patterns, picked
from .csa import csa_header
from .encoding import Style, file_of

DOSE = "1.2.840.10008.5.1.4.1.1.481.2"
NUCLEAR = "1.2.840.10008.5.1.4.1.1.20"
ULTRASOUND = "1.2.840.10008.5.1.4.1.1.3.1"
XA = "1.2.840.10008.5.1.4.1.1.12.1"
# Not a multiple of anything, so that a dropped scale shows.
DOSE_SCALE = 0.0125


def dose(offsets, pixels=None, **attributes):
    pixels = patterns(len(offsets)) if pixels is None else pixels
    plain = dict(SOPClassUID=DOSE, Modality="RTDOSE", DoseUnits="GY", DoseType="PHYSICAL",
                 DoseSummationType="PLAN", DoseGridScaling=str(DOSE_SCALE), GridFrameOffsetVector=offsets,
                 FrameIncrementPointer=0x3004000C)
    return image(pixels=pixels, **{**plain, **attributes})


def dose_case(cases, name, ds, voxels, spacing, origin=None, **more):
    expected = expected_of(voxels, spacing, ORIGIN if origin is None else origin, modality="RTDOSE", **more)
    cases.one(f"dose-{name}", ds, expected, "PS3.3 C.8.8.3.2", tolerance=1e-6)


def doses(cases):
    right = patterns(4) * DOSE_SCALE
    spacing = [0.6, 0.8, 3.0]
    relative = [0, 3, 6, 9]
    dose_case(cases, "relative", dose(relative), right, spacing)
    dose_case(cases, "absolute", dose([3 + v for v in relative]), right, spacing)
    dose_case(cases, "descending", dose([-v for v in relative]), right[::-1], spacing,
              [1.0, 2.0, 3.0 - 9.0])
    dose_case(cases, "absolute-descending", dose([3 - v for v in relative]), right[::-1], spacing,
              [1.0, 2.0, 3.0 - 9.0])
    dose_case(cases, "uneven", dose([0, 3, 6, 12]), right, None, warns=[["missing", "varies", "uneven"]])
    thirty_two = patterns(4, dtype=np.uint32) * 1000003
    dose_case(cases, "32-bit", dose(relative, thirty_two, DoseGridScaling="1.5e-8"), thirty_two * 1.5e-8,
              spacing)
    dose_case(cases, "scale-1", dose(relative, DoseGridScaling="1.0"), patterns(4), spacing)
    dose_case(cases, "error-signed", dose(relative, patterns(4, dtype=np.int16) - 200, DoseType="ERROR"),
              (patterns(4, dtype=np.int16) - 200) * DOSE_SCALE, spacing)
    dose_case(cases, "sixteen-digits", dose(relative, DoseGridScaling="3.0517578125e-5"),
              patterns(4) * 3.0517578125e-5, spacing)
    dose_case(cases, "thickness-contradicts", dose(relative, SliceThickness="1"), right, spacing)
    dose_case(cases, "spacing-contradicts", dose(relative, SpacingBetweenSlices="7"), right, spacing)
    tilted = dict(ImageOrientationPatient=[0, 1, 0, 0, 0, 1])
    dose_case(cases, "sagittal", dose(relative, **tilted), right, spacing)
    dose_case(cases, "half-a-millimetre", dose([0, 0.5, 1, 1.5]), right, [0.6, 0.8, 0.5])
    dose_case(cases, "one-frame", dose([0]), patterns(1) * DOSE_SCALE, None)
    dose_case(cases, "relative-in-micrometres", dose([0, 0.003, 0.006, 0.009]), right, [0.6, 0.8, 0.003])
    no_scale = dose(relative, DoseGridScaling=None)
    dose_case(cases, "without-scale", no_scale, patterns(4), spacing)


def nuclear(pixels, **attributes):
    plain = dict(SOPClassUID=NUCLEAR, Modality="NM", PixelSpacing=[0.8, 0.6], SliceThickness="2.5",
                 SpacingBetweenSlices="2.5")
    return multiframe(pixels, **{**plain, **attributes})


def detector(*position, along=(1, 0, 0, 0, 1, 0)):
    return one_item(ImagePositionPatient=list(position or ORIGIN), ImageOrientationPatient=list(along))


def by_time(cases, name, ds, slices, times, spacing=SPACING, origin=None, peer="PS3.3 C.8.4.8", which=None):
    """A case for the first and the last time."""
    for t in sorted({0, times - 1}):
        voxels = patterns(slices, t) if which is None else which(t)
        expected = expected_of(voxels, spacing, origin, time_points=times)
        options = {"time": t + 1}
        if t == 0:
            cases.one(f"{name}-time-1", ds, expected, peer, options=options)
            path = cases.list[-1]["path"]
        else:
            cases.add(f"{name}-time-{t + 1}", path, peer, expected, options=options)


def nuclear_medicine(cases):
    tomo = ["ORIGINAL", "PRIMARY", "RECON TOMO", "EMISSION"]
    gated = ["ORIGINAL", "PRIMARY", "RECON GATED TOMO", "EMISSION"]
    slices = list(range(1, 5))
    right = expected_of(patterns(4), SPACING, ORIGIN)
    cases.one("nm-recon", nuclear(patterns(4), ImageType=tomo, FrameIncrementPointer=0x00540080,
                                  SliceVector=slices, NumberOfSlices=4,
                                  DetectorInformationSequence=detector()), right, "PS3.3 C.8.4.15")
    # The frames go down: the last is the lowest.
    ds = nuclear(patterns(4), ImageType=tomo, SpacingBetweenSlices="-2.5", SliceVector=slices,
                 FrameIncrementPointer=0x00540080, NumberOfSlices=4, DetectorInformationSequence=detector())
    down = expected_of(patterns(4)[::-1], SPACING, [1.0, 2.0, 3.0 - 7.5])
    cases.one("nm-recon-negative-spacing", ds, down, "PS3.3 C.8.4.15")
    ds = nuclear(patterns(4), ImageType=tomo, SliceVector=slices, NumberOfSlices=4,
                 FrameIncrementPointer=0x00540080, ImagePositionPatient=ORIGIN,
                 ImageOrientationPatient=[1, 0, 0, 0, 1, 0])
    cases.one("nm-position-of-object", ds, right, "PS3.3 C.8.4.15")
    ds = nuclear(np.stack([pattern(k) for k in (2, 0, 3, 1)]), ImageType=tomo, SliceVector=[3, 1, 4, 2],
                 FrameIncrementPointer=0x00540080, NumberOfSlices=4, DetectorInformationSequence=detector())
    cases.one("nm-slice-vector-mixed", ds, right, "PS3.3 C.8.4.8")
    two = np.concatenate([patterns(4, 0), patterns(4, 1)])
    vectors = dict(RRIntervalVector=[1] * 8, NumberOfRRIntervals=1, TimeSlotVector=[1] * 4 + [2] * 4,
                   NumberOfTimeSlots=2, SliceVector=slices * 2, NumberOfSlices=4)
    pointers = [0x00540060, 0x00540070, 0x00540080]
    by_time(cases, "nm-gated", nuclear(two, ImageType=gated, FrameIncrementPointer=pointers, **vectors,
                                       DetectorInformationSequence=detector()), 4, 2, origin=ORIGIN)
    by_time(cases, "nm-gated-no-position", nuclear(
        two, ImageType=gated, FrameIncrementPointer=pointers, **vectors), 4, 2)
    inner = np.stack([pattern(k, t) for k in range(4) for t in range(2)])
    ds = nuclear(inner, ImageType=gated, FrameIncrementPointer=pointers, RRIntervalVector=[1] * 8,
                 NumberOfRRIntervals=1, TimeSlotVector=[1, 2] * 4, NumberOfTimeSlots=2,
                 SliceVector=[1, 1, 2, 2, 3, 3, 4, 4], NumberOfSlices=4,
                 DetectorInformationSequence=detector())
    by_time(cases, "nm-gated-slices-outside", ds, 4, 2, origin=ORIGIN)
    ds = nuclear(two, ImageType=gated, SpacingBetweenSlices="-2.5", FrameIncrementPointer=pointers, **vectors,
                 DetectorInformationSequence=detector())
    by_time(cases, "nm-gated-negative-spacing", ds, 4, 2, origin=[1, 2, -4.5],
            which=lambda t: patterns(4, t)[::-1])
    ds = nuclear(two[:, None].reshape(8, 5, 6), ImageType=gated, FrameIncrementPointer=None,
                 **{**vectors, "RRIntervalVector": None})
    by_time(cases, "nm-gated-no-pointer", ds, 4, 2)
    planar = dict(ImageType=["ORIGINAL", "PRIMARY", "STATIC", "EMISSION"],
                  FrameIncrementPointer=[0x00540010, 0x00540020], EnergyWindowVector=[1, 2],
                  NumberOfEnergyWindows=2, DetectorVector=[1, 1], NumberOfDetectors=1)
    energy = np.stack([pattern(0, t) for t in range(2)])
    times_or_series(cases, "nm-energy-windows", nuclear(energy, **planar))
    detectors = {**planar, "EnergyWindowVector": [1, 1], "DetectorVector": [1, 2], "NumberOfDetectors": 2,
                 "NumberOfEnergyWindows": 1}
    times_or_series(cases, "nm-detectors", nuclear(energy, **detectors))
    dynamic = dict(ImageType=["ORIGINAL", "PRIMARY", "DYNAMIC", "EMISSION"],
                   FrameIncrementPointer=[0x00540010, 0x00540020, 0x00540030, 0x00540100],
                   EnergyWindowVector=[1] * 3, DetectorVector=[1] * 3, PhaseVector=[1] * 3,
                   TimeSliceVector=[1, 2, 3], NumberOfPhases=1)
    moving = np.stack([pattern(0, t) for t in range(3)])
    by_time(cases, "nm-dynamic", nuclear(moving, **dynamic), 1, 3, spacing=None)


def times_or_series(cases, name, ds):
    """Two planar images, which are no stack."""
    for n in (1, 2):
        right = expected_of(patterns(1, n - 1))
        either = [{"time_points": 2, "options": {"time": n}}, {"series": 2, "options": {"series": str(n)}}]
        if n == 1:
            cases.one(f"{name}-1", ds, right, "PS3.3 C.8.4.8", either=either)
        else:
            path = cases.where(f"{name}-1", ".dcm")
            cases.add(f"{name}-2", path, "PS3.3 C.8.4.8", right, either=either)


def clip(pixels, **attributes):
    plain = dict(SOPClassUID=ULTRASOUND, Modality="US", PixelSpacing=None, FrameTime="33.3",
                 FrameIncrementPointer=0x00181063)
    return multiframe(pixels, **{**plain, **attributes})


def clips(cases):
    pixels = np.stack([pattern(0, t) for t in range(4)])
    peer = "PS3.3 C.7.6.5, C.7.6.6"
    case = lambda name, ds, spacing=None: by_time(cases, name, ds, 1, 4, spacing, peer=peer)
    case("clip-frame-time", clip(pixels))
    case("clip-frame-time-vector", clip(pixels, FrameTime=None, FrameTimeVector=[0, 30, 33, 31],
                                        FrameIncrementPointer=0x00181065))
    case("clip-cine-rate", clip(pixels, FrameTime=None, CineRate=30, FrameIncrementPointer=None))
    case("clip-no-pointer", clip(pixels, FrameIncrementPointer=None))
    case("clip-xa", clip(pixels, SOPClassUID=XA, Modality="XA", ImagerPixelSpacing=[0.2, 0.2]))
    case("clip-rf", clip(pixels, SOPClassUID="1.2.840.10008.5.1.4.1.1.12.2", Modality="RF"))
    case("clip-secondary-capture", clip(pixels, SOPClassUID="1.2.840.10008.5.1.4.1.1.7.3", Modality="OT"))
    case("clip-with-position", clip(pixels, ImagePositionPatient=ORIGIN, PixelSpacing=[0.8, 0.6],
                                    ImageOrientationPatient=[1, 0, 0, 0, 1, 0]))
    rgb = np.stack([np.stack([pattern(0, 0), pattern(1, 0) - 50, 255 - pattern(0, 0) - 10 * t], axis=-1)
                    for t in range(3)]).astype(np.uint8)
    ds = clip(rgb)
    for t in (0, 2):
        expected = expected_of(rgb[t : t + 1], time_points=3)
        if t == 0:
            cases.one("clip-colour-time-1", ds, expected, peer, options={"time": 1})
        else:
            cases.add("clip-colour-time-3", cases.where("clip-colour-time-1", ".dcm"), peer, expected,
                      options={"time": 3})
    # Frames of a secondary capture without any time are pages.
    ds = multiframe(patterns(4), SOPClassUID="1.2.840.10008.5.1.4.1.1.7.3")
    cases.one("capture-without-time", ds, expected_of(patterns(4)), "PS3.3 C.8.6.3", time_points=1)
    volume = dict(SOPClassUID="1.2.840.10008.5.1.4.1.1.6.2", Modality="US")
    frames = [data_set(PlanePositionVolumeSequence=one_item(ImagePositionVolume=[0.0, 0.0, 2.5 * k]))
              for k in range(4)]
    ds = enhanced(frames, patterns(4), shared={"PlaneOrientationSequence": None}, **volume)
    shared = ds.SharedFunctionalGroupsSequence[0]
    shared.PlaneOrientationVolumeSequence = one_item(ImageOrientationVolume=[1.0, 0, 0, 0, 1.0, 0])
    cases.one("enhanced-ultrasound-volume", ds, expected_of(patterns(4), SPACING), "PS3.3 C.8.24.3",
              time_points=1)


def mosaic(tiles, across, count, **attributes):
    """Tiles [n, j, i] in rows of `across`, the rest of the square black."""
    n, rows, columns = tiles.shape
    sheet = np.zeros((rows * across, columns * across), tiles.dtype)
    for k in range(n):
        y, x = divmod(k, across)
        sheet[y * rows : (y + 1) * rows, x * columns : (x + 1) * columns] = tiles[k]
    middle = [(across - 1) / 2 * columns * 0.6, (across - 1) / 2 * rows * 0.8, 0]
    plain = dict(SOPClassUID=MR, Modality="MR", Manufacturer="SIEMENS", SpacingBetweenSlices="2.5",
                 ImageType=["ORIGINAL", "PRIMARY", "M", "ND", "MOSAIC"],
                 ImagePositionPatient=[o - m for o, m in zip(ORIGIN, middle)])
    return image(pixels=sheet, **{**plain, **attributes})


def private(ds, group, creator, element, vr, value):
    ds.add_new(group << 16 | 0x10, "LO", creator)
    ds.add_new(group << 16 | 0x1000 | element, vr, value)
    return ds


def by_nibabel(ds, expected, step=1):
    """The peer, if nibabel divides a mosaic into the same slices, in this order, at the same place."""
    read = wrapper_from_data(opened(encoded(ds)))
    voxels = np.asarray(read.get_data()).transpose(2, 0, 1)
    first = read.affine @ [0, 0, 0 if step > 0 else len(voxels) - 1, 1]
    same = np.allclose(first[:3], expected["origin_mm"]) and np.isclose(abs(read.affine[2, 2]), SPACING[2])
    return "nibabel" if same and picked(voxels[::step]) == expected["values"] else None


def mosaics(cases):
    # nibabel divides those with a CSA header; dcm2niix goes by the private count, too.
    peer = "by the rule of dcm2niix, which was not run"
    right = expected_of(patterns(4), SPACING, ORIGIN)
    nine = expected_of(patterns(7), SPACING, ORIGIN)
    count = lambda ds, n: private(ds, 0x0019, "SIEMENS MR HEADER", 0x0A, "US", n)
    csa = lambda ds, n, normal=(0, 0, 1): private(
        ds, 0x0029, "SIEMENS CSA HEADER", 0x10, "OB", csa_header(n, normal))
    cases.one("mosaic-private-count", count(mosaic(patterns(4), 2, 4), 4), right, peer)
    cases.one("mosaic-private-count-7-of-9", count(mosaic(patterns(7), 3, 7), 7), nine, peer)
    for name, ds, expected in (
        ("csa", csa(mosaic(patterns(4), 2, 4), 4), right),
        ("csa-7-of-9", csa(mosaic(patterns(7), 3, 7), 7), nine),
        ("both", csa(count(mosaic(patterns(7), 3, 7), 7), 7), nine),
    ):
        cases.one(f"mosaic-{name}", ds, expected, by_nibabel(ds, expected) or peer)
    # The normal of the slices points down: the first tile is the uppermost slice.
    down = expected_of(patterns(4)[::-1], SPACING, [1.0, 2.0, 3.0 - 7.5])
    ds = csa(mosaic(patterns(4), 2, 4), 4, (0, 0, -1))
    cases.one("mosaic-csa-normal-down", ds, down, by_nibabel(ds, down, -1) or peer)
    ds = count(mosaic(patterns(4), 2, 4), 4)
    cases.one("mosaic-implicit", file_of(with_syntax(ds, "1.2.840.10008.1.2"), Style(explicit=False)),
              right, peer)
    ds = csa(mosaic(patterns(4), 2, 4, SpacingBetweenSlices=None, SliceThickness="2.5"), 4)
    cases.one("mosaic-thickness", ds, right, peer)
    ds = csa(mosaic(patterns(4), 2, 4, RescaleSlope="2", RescaleIntercept="-5"), 4)
    cases.one("mosaic-rescale", ds, expected_of(patterns(4) * 2.0 - 5, SPACING, ORIGIN), peer)
    files = [csa(mosaic(patterns(4, t), 2, 4, SOPInstanceUID=f"1.2.3.4.{t}", InstanceNumber=t + 1,
                        AcquisitionTime=f"10000{t}"), 4) for t in range(2)]
    for t in range(2):
        expected = expected_of(patterns(4, t), SPACING, ORIGIN, time_points=2, series=1)
        if t == 0:
            cases.stack("mosaic-two-times-time-1", files, expected, peer, names=["b.dcm", "a.dcm"],
                        options={"time": 1})
        else:
            cases.add("mosaic-two-times-time-2", cases.where("mosaic-two-times-time-1"), peer, expected,
                      options={"time": 2})
    plain = mosaic(patterns(4), 2, 4)
    cases.one("mosaic-without-count", plain, {"size": [12, 10, 1]}, "said, where it cannot be unpacked",
              warns=["mosaic"])


def with_syntax(ds, syntax):
    ds.file_meta.TransferSyntaxUID = syntax
    return ds


def palette(entries, first, bits, tables, **attributes):
    """Descriptors and tables of the three colours."""
    out = {}
    for name, table in zip(("Red", "Green", "Blue"), tables):
        out[f"{name}PaletteColorLookupTableDescriptor"] = [entries, first, bits]
        out[f"{name}PaletteColorLookupTableData"] = table
    return {**out, "PhotometricInterpretation": "PALETTE COLOR", **attributes}


def words(ds):
    """Descriptors of tables, whose representation depends on the pixels."""
    for keyword in [e.keyword for e in ds if e.keyword.endswith("LookupTableDescriptor")]:
        ds[keyword].VR = "US"
    return ds


def palette_case(cases, name, ds, voxels, tolerance=1, peer="PS3.3 C.7.6.3.1.5"):
    read = opened(encoded(words(ds)))
    try:
        colors = apply_color_lut(read.pixel_array, read)
        colors = colors / 257 if colors.max() > 255 else colors
        if np.abs(colors - voxels.astype(float)).max() <= tolerance:
            peer = "pydicom"
    except Exception:
        pass
    cases.one(f"palette-{name}", ds, expected_of(voxels[None].astype(float)), peer, tolerance=tolerance)


def palettes(cases):
    index = pattern(0, dtype=np.uint8)
    eight = np.stack([np.arange(256), 255 - np.arange(256), np.arange(256) * 7 % 256]).astype(np.uint8)
    look = lambda tables, i: np.stack([t[i] for t in tables], axis=-1)
    plain = palette(256, 0, 8, [t.tobytes() for t in eight])
    palette_case(cases, "8-bit", image(0, pixels=index, **plain), look(eight, index))
    sixteen = eight.astype(np.uint16) * 257
    wide = palette(256, 0, 16, [t.tobytes() for t in sixteen])
    palette_case(cases, "16-bit", image(0, pixels=index, **wide), look(eight, index))
    # Eight bits in words of sixteen, as the standard has it for tables of 8 bits written as OW.
    padded = palette(256, 0, 8, [t.astype(np.uint16).tobytes() for t in eight])
    palette_case(cases, "8-bit-in-words", image(0, pixels=index, **padded), look(eight, index))
    first = palette(20, 5, 8, [t[:20].tobytes() for t in eight])
    clipped = np.clip(index.astype(int) - 5, 0, 19)
    palette_case(cases, "first-mapped", image(0, pixels=index, **first), look(eight, clipped))
    few = palette(30, 0, 16, [t[:30].tobytes() for t in sixteen])
    palette_case(cases, "few-entries", image(0, pixels=index, **few), look(eight, np.minimum(index, 29)))
    whole = np.stack([np.arange(65536), 65535 - np.arange(65536), np.full(65536, 257 * 9)])
    whole = whole.astype(np.uint16)
    large = pattern(7, 1) * 30
    segments = [linear(t, np.uint16) for t in whole]
    ds = image(0, pixels=large, **palette(0, 0, 16, [s.tobytes() for s in segments]))
    palette_case(cases, "segmented-65536", segmented(ds), look(whole >> 8, large), peer="PS3.3 C.7.9.2")
    ramp = np.stack([np.linspace(0, 255, 100), np.linspace(255, 0, 100), np.full(100, 9)])
    ramp = ramp.round().astype(np.uint8)
    segments = [linear(t, np.uint8) for t in ramp]
    ds = image(0, pixels=index, **palette(100, 0, 8, [s.tobytes() for s in segments]))
    palette_case(cases, "segmented-8-bit", segmented(ds), look(ramp, index), 2, "PS3.3 C.7.9.2")
    mapped = {k: v for k, v in plain.items() if k != "PhotometricInterpretation"}
    ds = image(0, **mapped, PixelPresentation="MIXED")
    cases.one("palette-supplemental", words(ds), expected_of(pattern(0)[None]),
              "PS3.3 C.7.6.19, the grey values")
    frames = np.stack([index, index + 100])
    ds = multiframe(frames, **plain, FrameTime="40", FrameIncrementPointer=0x00181063)
    second = expected_of(look(eight, frames[1])[None].astype(float), time_points=2)
    cases.one("palette-clip", words(ds), second, "PS3.3 C.7.6.3.1.5", tolerance=1, options={"time": 2})


def linear(table, dtype):
    """A table as a discrete segment of its first entry and a linear one to its last."""
    return np.array([0, 1, table[0], 1, len(table) - 1, table[-1]], dtype)


def segmented(ds):
    """The same tables under the names of segmented ones."""
    for name in ("Red", "Green", "Blue"):
        data = getattr(ds, f"{name}PaletteColorLookupTableData")
        delattr(ds, f"{name}PaletteColorLookupTableData")
        setattr(ds, f"Segmented{name}PaletteColorLookupTableData", data)
    return ds


def counts(cases):
    """Numbers of frames."""
    one = expected_of(patterns(1), None, ORIGIN)
    for name, value in (("zero", 0), ("missing", None), ("empty", ""), ("one", 1)):
        cases.one(f"frames-{name}", image(0, NumberOfFrames=value), one, "pydicom")
    cases.one("frames-negative", image(0, NumberOfFrames=-1), {}, "refused", error=[["frame", "damaged"]])
    cases.one("frames-too-many", image(0, NumberOfFrames=9), {}, "refused",
              error=[["truncated", "damaged", "pixels"]])
    three = multiframe(patterns(4), NumberOfFrames=3)
    cases.one("frames-too-few", three, expected_of(patterns(3)), "pydicom")
    missing = multiframe(patterns(4), NumberOfFrames=None)
    cases.one("frames-unstated-of-four", missing, {"size": [6, 5, 1], "values": [[0, 0, 0, 0]]}, "pydicom")
    single = enhanced([frame_groups(0)], pattern(0)[None])
    cases.one("enhanced-one-frame", single, expected_of(patterns(1), None, ORIGIN), "PS3.3 C.7.6.16")
    position = lambda k: frame_groups(k, PixelValueTransformationSequence=one_item(
        RescaleSlope=1 + 0.5 * k, RescaleIntercept=-10 * k))
    rescaled = np.stack([pattern(k) * (1 + 0.5 * k) - 10 * k for k in range(4)])
    cases.one("enhanced-rescale-by-frame", enhanced([position(k) for k in range(4)], patterns(4)),
              expected_of(rescaled, SPACING, ORIGIN), "PS3.3 C.7.6.16.2.9")
    along = one_item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])
    measures = one_item(PixelSpacing=[0.8, 0.6], SliceThickness=2.5)
    own = [frame_groups(k, PlaneOrientationSequence=along, PixelMeasuresSequence=measures) for k in range(4)]
    nothing = {"PlaneOrientationSequence": None, "PixelMeasuresSequence": None}
    cases.one("enhanced-all-by-frame", enhanced(own, patterns(4), shared=nothing),
              expected_of(patterns(4), SPACING, ORIGIN), "PS3.3 C.7.6.16.2")
    down = [frame_groups(k) for k in (3, 2, 1, 0)]
    cases.one("enhanced-frames-down", enhanced(down, patterns(4)[::-1].copy()),
              expected_of(patterns(4), SPACING, ORIGIN), "PS3.3 C.7.6.16.2.3")
    single_frames = [
        enhanced([frame_groups(k)], pattern(k)[None], SOPInstanceUID=f"1.2.3.4.{k}", InstanceNumber=k + 1)
        for k in range(4)
    ]
    cases.stack("enhanced-file-for-each-slice", single_frames, expected_of(patterns(4), SPACING, ORIGIN),
                "PS3.3 A.36", series=1, time_points=1)


def make(cases):
    cases.kind = "frames"
    doses(cases)
    nuclear_medicine(cases)
    clips(cases)
    mosaics(cases)
    palettes(cases)
    counts(cases)
    segmentations.make(cases)
