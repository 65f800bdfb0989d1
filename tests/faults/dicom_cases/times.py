"""Several volumes in one series: what tells them apart, and in which order they come."""

import random

import numpy as np

from pydicom.sequence import Sequence

from .base import MR, ORIGIN, PET, SPACING, apply, data_set, described, enhanced
from .base import expected_of, frame_groups, image, one_item, pattern, patterns

MAGNITUDE = ["ORIGINAL", "PRIMARY", "M", "ND"]
PHASE = ["ORIGINAL", "PRIMARY", "P", "ND"]


def shuffled(count, seed):
    """File names whose order says nothing."""
    names = [f"{n:03}.dcm" for n in range(count)]
    random.Random(seed).shuffle(names)
    return names


def instance_numbers(how, times, slices, seed):
    """Instance numbers [t][k]."""
    if how == "repeated":
        return [[k + 1 for k in range(slices)] for _ in range(times)]
    if how == "one":
        return [[1] * slices for _ in range(times)]
    if how == "by slice":
        return [[1 + k * times + t for k in range(slices)] for t in range(times)]
    if how == "by slice, backwards":
        return [[1 + k * times + times - 1 - t for k in range(slices)] for t in range(times)]
    numbers = list(range(1, times * slices + 1))
    if how == "random":
        random.Random(seed).shuffle(numbers)
    return [numbers[t * slices : (t + 1) * slices] for t in range(times)]


def stack(cases, name, by_time, how="repeated", slices=4, seed=1, peer=None, ordered=True):
    """Volumes told apart by attributes; `by_time` gives those of each, or a function of k does.

    Those without an order may come in any, but not mixed.
    """
    times = len(by_time)
    numbers = instance_numbers(how, times, slices, seed)
    datasets = []
    for t, attributes in enumerate(by_time):
        for k in range(slices):
            ds = image(k, t, SOPClassUID=MR, Modality="MR", InstanceNumber=numbers[t][k])
            attributes_of = attributes(k) if callable(attributes) else dict(attributes)
            for tag, vr, value in attributes_of.pop("private", ()):
                ds.add_new(tag, vr, value)
            apply(ds, attributes_of)
            datasets.append((t, ds))
    names = shuffled(len(datasets), seed)
    peer = peer or "pydicom, by " + ", ".join(sorted(
        a for a in (by_time[0](0) if callable(by_time[0]) else by_time[0])))
    for t in sorted({0, times - 1}):
        right = [described([ds for time, ds in datasets if time == u]) for u in range(times)]
        expected = {**(right[t] if ordered else {"either": right}), "time_points": times, "series": 1}
        options = {"time": t + 1}
        if t == 0:
            cases.stack(f"{name} time 1".replace(" ", "-"), [ds for _, ds in datasets], expected, peer,
                        names=names, options=options)
            path = cases.list[-1]["path"]
        else:
            cases.add(f"{name} time {t + 1}".replace(" ", "-"), path, peer, expected, options=options)


def private(group, creator, element, vr, value):
    return {"private": [(group << 16 | 0x10, "LO", creator), (group << 16 | 0x1000 | element, vr, value)]}


def each(name, *values):
    return [{name: v} for v in values]


def by_attribute(cases):
    stack(cases, "acquisition-time", each("AcquisitionTime", "100000.00", "100001.50"))
    stack(cases, "acquisition-time-random", each("AcquisitionTime", "100000", "100001"), "random")
    stack(cases, "acquisition-time-by-slice",
          [lambda k, t=t: {"AcquisitionTime": f"10{t:02}{k:02}.250000"} for t in range(3)], "random",
          peer="pydicom, by AcquisitionTime")
    stack(cases, "acquisition-time-interleaved",
          [lambda k, t=t: {"AcquisitionTime": f"10{t:02}{(k * 2 % 5):02}"} for t in range(2)], "repeated",
          peer="pydicom, by AcquisitionTime")
    stack(cases, "acquisition-over-midnight",
          [{"AcquisitionDate": "20200101", "AcquisitionTime": "235959.5"},
           {"AcquisitionDate": "20200102", "AcquisitionTime": "000001.0"}], "random")
    stack(cases, "acquisition-date-time",
          each("AcquisitionDateTime", "20200101100000.000000", "20200101100030.000000"), "random")
    stack(cases, "content-time", each("ContentTime", "100000", "100010"), "random", seed=3)
    stack(cases, "content-time-3", each("ContentTime", "095959", "100000", "100010"))
    stack(cases, "b-value", each("DiffusionBValue", 0.0, 1000.0), "random")
    stack(cases, "b-value-3", each("DiffusionBValue", 0.0, 50.0, 1000.0), "one")
    stack(cases, "b-value-missing-once", [{"AcquisitionNumber": 1}, {"DiffusionBValue": 1000.0}], "repeated")
    stack(cases, "siemens-b-value", [private(0x0019, "SIEMENS MR HEADER", 0x0C, "IS", b) for b in (0, 800)],
          "repeated", peer="pydicom, by (0019,xx0C)")
    stack(cases, "ge-b-value", [private(0x0043, "GEMS_PARM_01", 0x39, "IS", [b, 8, 0, 0])
                                for b in (0, 1000000800)], "repeated", peer="pydicom, by (0043,xx39)")
    directions = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    stack(cases, "diffusion-directions",
          [{"DiffusionBValue": 1000.0, "DiffusionGradientOrientation": d, "AcquisitionNumber": n}
           for n, d in enumerate(directions)], "repeated")
    stack(cases, "echo-time", each("EchoTime", "4.6", "9.2"), "random")
    stack(cases, "echo-numbers", each("EchoNumbers", 1, 2), "repeated")
    stack(cases, "inversion-time", each("InversionTime", "100", "900"), "repeated")
    stack(cases, "inversion-time-random", each("InversionTime", "90", "1000"), "random")
    stack(cases, "flip-angle", each("FlipAngle", "5", "26"), "repeated")
    stack(cases, "repetition-time", each("RepetitionTime", "500", "2000"), "repeated")
    stack(cases, "trigger-time", each("TriggerTime", "0", "45.5", "912"), "random")
    stack(cases, "temporal-position", each("TemporalPositionIdentifier", 1, 2), "random")
    stack(cases, "temporal-position-11", each("TemporalPositionIdentifier", 2, 11), "one")
    stack(cases, "acquisition-number", each("AcquisitionNumber", 1, 2), "random")
    stack(cases, "cardiac-phase", each("NominalPercentageOfCardiacPhase", 0.0, 75.0), "repeated")
    stack(cases, "image-type", each("ImageType", MAGNITUDE, PHASE), "repeated")
    stack(cases, "image-type-random", each("ImageType", MAGNITUDE, PHASE), "random")
    real = [["ORIGINAL", "PRIMARY", x, "NONE"] for x in ("IMAGINARY", "REAL")]
    stack(cases, "complex-parts", each("ImageType", *real), "repeated", ordered=False)
    pet = {"SOPClassUID": PET, "Modality": "PT"}
    stack(cases, "frame-reference-time", [{"FrameReferenceTime": v, **pet} for v in ("0", "30000")], "random")
    stack(cases, "frame-reference-time-3",
          [{"FrameReferenceTime": v, **pet} for v in ("500", "5000", "30000")], "repeated")
    stack(cases, "image-index", [
        lambda k, t=t: {"ImageIndex": 1 + k + 4 * t, "NumberOfTimeSlices": 2, "NumberOfSlices": 4,
                        "FrameReferenceTime": f"{1000 + 30000 * t}", **pet} for t in range(2)], "one",
          peer="pydicom, by FrameReferenceTime; PS3.3 C.8.9.4.1.9")
    stack(cases, "temporal-position-time", [
        {"TriggerTime": str(100 * t), "AcquisitionTime": f"1000{t:02}", "TemporalPositionIdentifier": t + 1}
        for t in range(3)], "random")


def by_order(cases):
    """Nothing but instance numbers, or names, tells the volumes apart."""
    stack(cases, "instance-numbers", [{}, {}], "running", peer="PS3.3 C.7.6.1, InstanceNumber")
    stack(cases, "instance-numbers-by-slice", [{}, {}], "by slice", peer="PS3.3 C.7.6.1, InstanceNumber")
    stack(cases, "time-against-numbers", each("ContentTime", "100000", "100010"), "by slice, backwards")
    stack(cases, "trigger-against-numbers", each("TriggerTime", "0", "500"), "by slice, backwards")
    stack(cases, "one-slice-in-time", each("AcquisitionTime", "100000", "100001", "100002"), "random",
          slices=1)
    # A time for every slice, in the order of acquisition, and echoes.
    stack(cases, "echoes-with-times",
          [lambda k, t=t: {"EchoTime": f"{5 + 5 * t}", "AcquisitionTime": f"1000{k:02}"} for t in range(2)],
          "by slice", peer="pydicom, by EchoTime")
    stack(cases, "b-values-with-times",
          [lambda k, t=t: {"DiffusionBValue": 500.0 * t, "ContentTime": f"10{(k * 7 + t * 3) % 10:02}00"}
           for t in range(2)], "random", peer="pydicom, by DiffusionBValue")


def incomplete(cases):
    """The last volume, or the first, lacks slices."""
    for name, how, missing in (
        ("last-slice-missing", "repeated", {(1, 3)}),
        ("middle-slice-missing", "random", {(1, 1)}),
        ("half-missing", "running", {(2, 2), (2, 3)}),
    ):
        times = 3 if "half" in name else 2
        by_time = each("AcquisitionTime", *[f"10000{t}" for t in range(times)])
        numbers = instance_numbers(how, times, 4, 5)
        datasets = [
            (t, apply(image(k, t, SOPClassUID=MR, Modality="MR", InstanceNumber=numbers[t][k]), by_time[t]))
            for t in range(times) for k in range(4) if (t, k) not in missing
        ]
        expected = described([ds for t, ds in datasets if t == 0])
        cases.stack(name, [ds for _, ds in datasets], expected, "pydicom, by AcquisitionTime",
                    names=shuffled(len(datasets), 5), series=1, time_points=times, options={"time": 1})


def frame(k, index=None, **content):
    more = {}
    if index is not None:
        content["DimensionIndexValues"] = index
    if content:
        more["FrameContentSequence"] = one_item(**content)
    return frame_groups(k, **more)


def dimensions(*tags):
    return Sequence(
        data_set(DimensionIndexPointer=t, FunctionalGroupPointer=g, DimensionOrganizationUID="1.2.3.8")
        for t, g in tags
    )


STACK = (0x00209056, 0x00209111)
IN_STACK = (0x00209057, 0x00209111)
TEMPORAL = (0x00209128, 0x00209111)
ECHO = (0x00189082, 0x00189114)
B_VALUE = (0x00189087, 0x00189117)


def enhanced_case(cases, name, order, make, index, times=2, slices=3, peer="PS3.3 C.7.6.17", **shared):
    """One object of frames (t, k) in an order; `make` gives the groups of one."""
    pixels = np.stack([pattern(k, t) for t, k in order])
    ds = enhanced([make(t, k) for t, k in order], pixels, **shared)
    if index:
        ds.DimensionOrganizationSequence = one_item(DimensionOrganizationUID="1.2.3.8")
        ds.DimensionIndexSequence = dimensions(*index)
    for t in sorted({0, times - 1}):
        expected = expected_of(patterns(slices, t), SPACING, ORIGIN, time_points=times, series=1)
        options = {"time": t + 1}
        if t == 0:
            cases.one(f"{name}-time-1", ds, expected, peer, options=options)
            path = cases.list[-1]["path"]
        else:
            cases.add(f"{name}-time-{t + 1}", path, peer, expected, options=options)


def multi_frame(cases):
    by_time = [(t, k) for t in range(2) for k in range(3)]
    by_slice = [(t, k) for k in range(3) for t in range(2)]
    mixed = [(1, 2), (0, 0), (1, 0), (0, 2), (1, 1), (0, 1)]
    index = lambda t, k: frame(k, [1, k + 1, t + 1], StackID="1", InStackPositionNumber=k + 1)
    enhanced_case(cases, "enhanced-stack-time", by_time,
                  lambda t, k: frame(k, [1, k + 1, t + 1], StackID="1", InStackPositionNumber=k + 1,
                                     TemporalPositionIndex=t + 1), (STACK, IN_STACK, TEMPORAL))
    enhanced_case(cases, "enhanced-by-slice", by_slice,
                  lambda t, k: frame(k, [t + 1, k + 1], InStackPositionNumber=k + 1,
                                     TemporalPositionIndex=t + 1), (TEMPORAL, IN_STACK))
    enhanced_case(cases, "enhanced-mixed", mixed,
                  lambda t, k: frame(k, [1, k + 1, t + 1], StackID="1", InStackPositionNumber=k + 1,
                                     TemporalPositionIndex=t + 1), (STACK, IN_STACK, TEMPORAL))
    enhanced_case(cases, "enhanced-index-alone", mixed, index, (STACK, IN_STACK, TEMPORAL))
    # The order of the dimension index, against that of the frames.
    enhanced_case(cases, "enhanced-index-backwards", [(1 - t, k) for t, k in by_time], index,
                  (STACK, IN_STACK, TEMPORAL))
    echo = lambda t, k: apply(
        frame(k, [k + 1, t + 1], StackID="1", InStackPositionNumber=k + 1),
        {"MREchoSequence": one_item(EffectiveEchoTime=5.0 + 5 * t)})
    enhanced_case(cases, "enhanced-echo", mixed, echo, (IN_STACK, ECHO))
    echo_plain = lambda t, k: apply(frame(k), {"MREchoSequence": one_item(EffectiveEchoTime=5.0 + 5 * t)})
    enhanced_case(cases, "enhanced-echo-without-index", mixed, echo_plain, (), peer="PS3.3 C.8.13.5.4")
    b = lambda t, k: apply(
        frame(k, [k + 1, t + 1]), {"MRDiffusionSequence": one_item(DiffusionBValue=1000.0 * t)})
    enhanced_case(cases, "enhanced-b-value", mixed, b, (IN_STACK, B_VALUE))
    b_plain = lambda t, k: apply(frame(k), {"MRDiffusionSequence": one_item(DiffusionBValue=1000.0 * t)})
    enhanced_case(cases, "enhanced-b-value-without-index", mixed, b_plain, (), peer="PS3.3 C.8.13.5.9")
    moment = lambda t, k: frame(k, FrameAcquisitionDateTime=f"2020010110000{t}.{k}",
                                FrameReferenceDateTime=f"2020010110000{t}.{k}")
    enhanced_case(cases, "enhanced-acquisition-time", mixed, moment, (), peer="PS3.3 C.7.6.16.2.2")
    phase = lambda t, k: apply(frame(k), {"CardiacSynchronizationSequence": one_item(
        NominalPercentageOfCardiacPhase=50.0 * t, NominalCardiacTriggerDelayTime=400.0 * t)})
    enhanced_case(cases, "enhanced-cardiac-phase", mixed, phase, (), peer="PS3.3 C.7.6.16.2.7")
    kind = lambda t, k: apply(frame(k), {"MRImageFrameTypeSequence": one_item(
        FrameType=["ORIGINAL", "PRIMARY", "M" if t == 0 else "P", "NONE"])})
    enhanced_case(cases, "enhanced-magnitude-phase", mixed, kind, (), peer="PS3.3 C.8.13.5.1")
    enhanced_case(cases, "enhanced-temporal-3", random.Random(9).sample(
        [(t, k) for t in range(3) for k in range(3)], 9),
        lambda t, k: frame(k, TemporalPositionIndex=t + 1), (), times=3, peer="PS3.3 C.7.6.16.2.2")
    two_stacks(cases)
    several_objects(cases)


def two_stacks(cases):
    """Two stacks of one object are two volumes: PS3.3 C.7.6.16.2.2.4."""
    turned = one_item(ImageOrientationPatient=[0, 1, 0, 0, 0, -1])
    frames, pixels = [], []
    for k in range(4):
        frames.append(frame(k, [1, k + 1], StackID="1", InStackPositionNumber=k + 1))
        pixels.append(pattern(k, 0))
    for k in range(3):
        at = frame_groups(position=[2.0 * k, 0.0, 0.0], FrameContentSequence=one_item(
            DimensionIndexValues=[2, k + 1], StackID="2", InStackPositionNumber=k + 1))
        frames.append(apply(at, {"PlaneOrientationSequence": turned}))
        pixels.append(pattern(k, 5))
    ds = enhanced(frames, np.stack(pixels))
    group = ds.SharedFunctionalGroupsSequence[0]
    plain = group.PlaneOrientationSequence
    del group.PlaneOrientationSequence
    for f in frames[:4]:
        f.PlaneOrientationSequence = plain
    ds.DimensionIndexSequence = dimensions(STACK, IN_STACK)
    expected = expected_of(patterns(4), SPACING, ORIGIN, series=2, time_points=1)
    cases.one("enhanced-two-stacks", ds, expected, "PS3.3 C.7.6.16.2.2.4")


def several_objects(cases):
    """Enhanced objects of one series, each a volume."""
    objects = [
        enhanced([frame(k) for k in range(3)], patterns(3, t), SOPInstanceUID=f"1.2.3.4.{t}",
                 InstanceNumber=t + 1, AcquisitionDateTime=f"2020010110000{t}")
        for t in range(2)
    ]
    for t in range(2):
        expected = expected_of(patterns(3, t), SPACING, ORIGIN, time_points=2, series=1)
        if t == 0:
            cases.stack("enhanced-objects-time-1", objects, expected, "PS3.3 A.36", names=["b.dcm", "a.dcm"],
                        options={"time": 1})
        else:
            cases.add("enhanced-objects-time-2", cases.where("enhanced-objects-time-1"), "PS3.3 A.36",
                      expected, options={"time": 2})


def make(cases):
    cases.kind = "times"
    by_attribute(cases)
    by_order(cases)
    incomplete(cases)
    multi_frame(cases)
