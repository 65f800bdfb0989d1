#!/usr/bin/env python3
"""Makes RT Structure Sets with small CT series, and `cases.json`: what must come out of each.

    make_contours.py FOLDER

pydicom writes the files. What is right comes from an even-odd test of every voxel's centre in this
script, plane by plane, and between planes from closed forms (cones, prisms, boxes). Contours avoid
voxel centres, except where a case says so. The same files come from every run.
"""

import json
import os
import sys

import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, ImplicitVRLittleEndian

ROOT = "1.2.826.0.1.3680043.8.498.77."
CT = "1.2.840.10008.5.1.4.1.1.2"
RTSTRUCT = "1.2.840.10008.5.1.4.1.1.481.3"
SIZE = (32, 28, 10)
EVEN_ODD = "even-odd test of every voxel's centre (NumPy)"


class Grid:
    """Voxels of a CT series; `axes` are the columns of its direction."""

    def __init__(self, spacing=(1.5, 2.0, 3.0), origin=(-20.0, 11.0, -30.0), axes=np.eye(3), at=None):
        self.spacing, self.origin, self.axes = np.array(spacing), np.array(origin), np.array(axes)
        # Positions of the slices, in slices.
        self.at = np.arange(SIZE[2]) if at is None else np.array(at)

    def world(self, voxels):
        """Positions of voxels [..., 3] in millimetres."""
        voxels = np.asarray(voxels, float)
        return self.origin + (voxels * self.spacing) @ self.axes.T


def inside(ring, grid_size=SIZE):
    """Which pixel centres [j, i] an odd number of a ring's edges separates from the right."""
    i, j = np.meshgrid(np.arange(grid_size[0]), np.arange(grid_size[1]))
    odd = np.zeros(i.shape, bool)
    for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0)):
        crosses = (y0 > j) != (y1 > j)
        with np.errstate(divide="ignore", invalid="ignore"):
            odd ^= crosses & (i < (x1 - x0) * (j - y0) / (y1 - y0) + x0)
    return odd


def filled(planes, depth=SIZE[2]):
    """The mask [k, j, i] of rings by slice: {k: [ring, ...]}."""
    mask = np.zeros((depth, SIZE[1], SIZE[0]), bool)
    for k, rings in planes.items():
        for ring in rings:
            mask[k] ^= inside(np.asarray(ring))
    return mask


def circle(x, y, radius, corners=90):
    """A ring in pixels."""
    angle = (np.arange(corners) + 0.3) / corners * 2 * np.pi
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1)


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)


def on_slices(grid, planes):
    """Contours in millimetres from rings in pixels by slice."""
    return [
        grid.world(np.column_stack([ring, np.full(len(ring), k)]))
        for k, rings in sorted(planes.items())
        for ring in rings
    ]


class Folder:
    """A folder of one case: a CT series, and a structure set."""

    count = 0

    def __init__(self, base, name):
        Folder.count += 1
        self.number, self.name, self.path = Folder.count, name, os.path.join(base, name)
        os.makedirs(self.path)
        self.images, self.sets = [], 0

    def uid(self, *parts):
        return ROOT + ".".join(str(p) for p in (self.number, *parts))

    def start(self, sop_class, instance, series, modality):
        ds = Dataset()
        ds.file_meta = FileMetaDataset()
        ds.file_meta.MediaStorageSOPClassUID = sop_class
        ds.file_meta.MediaStorageSOPInstanceUID = instance
        ds.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        ds.file_meta.ImplementationClassUID = ROOT + "0"
        ds.SOPClassUID, ds.SOPInstanceUID = sop_class, instance
        ds.StudyInstanceUID, ds.SeriesInstanceUID = self.uid(1), series
        ds.FrameOfReferenceUID = self.uid(2)
        ds.Modality = modality
        ds.PatientName, ds.PatientID = "Contours^Test", "contours"
        return ds

    def save(self, ds, *name):
        path = os.path.join(self.path, *name)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        ds.save_as(path, enforce_file_format=True)

    def ct(self, grid, folder="", series=3):
        """A series whose values are 10 i + j - 100 k."""
        i, j = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
        for k, at in enumerate(grid.at):
            ds = self.start(CT, self.uid(series, k + 1), self.uid(series), "CT")
            ds.SeriesNumber, ds.InstanceNumber = series, k + 1
            ds.SeriesDescription = "axial"
            ds.Rows, ds.Columns = SIZE[1], SIZE[0]
            ds.PixelSpacing = [grid.spacing[1], grid.spacing[0]]
            ds.ImageOrientationPatient = [f"{v:.12f}"[:16] for v in [*grid.axes[:, 0], *grid.axes[:, 1]]]
            ds.ImagePositionPatient = [f"{v:.9f}"[:16] for v in grid.world([0, 0, at])]
            ds.SliceThickness = grid.spacing[2]
            ds.SamplesPerPixel, ds.PhotometricInterpretation = 1, "MONOCHROME2"
            ds.BitsAllocated, ds.BitsStored, ds.HighBit, ds.PixelRepresentation = 16, 16, 15, 1
            ds.RescaleSlope, ds.RescaleIntercept = 1, 0
            ds.PixelData = (10 * i + j - 100 * k).astype("<i2").tobytes()
            self.save(ds, folder, f"ct{k + 1:02d}.dcm")
            self.images.append(ds.SOPInstanceUID)

    def structures(self, rois, name="rs.dcm", label="plan", implicit=False, refer=True, series=3):
        """A structure set of ROIs (number, name, contours); a contour is an array [n, 3] in
        millimetres, text, or a pair (type, array). Returns its path."""
        self.sets += 1
        ds = self.start(RTSTRUCT, self.uid(9, self.sets), self.uid(8, self.sets), "RTSTRUCT")
        ds.SpecificCharacterSet = "ISO_IR 192"
        ds.SeriesNumber = 8
        ds.StructureSetLabel, ds.StructureSetDate, ds.StructureSetTime = label, "20240101", "120000"
        frame, study, image_series = Dataset(), Dataset(), Dataset()
        frame.FrameOfReferenceUID = self.uid(2)
        if refer:
            image_series.SeriesInstanceUID = self.uid(series)
            image_series.ContourImageSequence = [self.image(uid) for uid in self.images]
            study.ReferencedSOPClassUID = "1.2.840.10008.3.1.2.3.1"
            study.ReferencedSOPInstanceUID = self.uid(1)
            study.RTReferencedSeriesSequence = [image_series]
            frame.RTReferencedStudySequence = [study]
        ds.ReferencedFrameOfReferenceSequence = [frame]
        ds.StructureSetROISequence, ds.ROIContourSequence, ds.RTROIObservationsSequence = [], [], []
        for n, (number, roi_name, contours) in enumerate(rois):
            roi, contour_item, observation = Dataset(), Dataset(), Dataset()
            roi.ROINumber, roi.ROIName = number, roi_name
            roi.ReferencedFrameOfReferenceUID, roi.ROIGenerationAlgorithm = self.uid(2), "MANUAL"
            contour_item.ROIDisplayColor = [255, 40 * n % 256, 0]
            contour_item.ReferencedROINumber = number
            contour_item.ContourSequence = [self.contour(c) for c in contours]
            observation.ObservationNumber, observation.ReferencedROINumber = n + 1, number
            observation.RTROIInterpretedType, observation.ROIInterpreter = "ORGAN", ""
            ds.StructureSetROISequence.append(roi)
            ds.ROIContourSequence.append(contour_item)
            ds.RTROIObservationsSequence.append(observation)
        if implicit:
            ds.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian
        self.save(ds, name)
        return f"{self.name}/{name}"

    @staticmethod
    def image(uid):
        ds = Dataset()
        ds.ReferencedSOPClassUID, ds.ReferencedSOPInstanceUID = CT, uid
        return ds

    @staticmethod
    def contour(contour):
        kind, points = contour if isinstance(contour, tuple) else ("CLOSED_PLANAR", contour)
        ds = Dataset()
        ds.ContourGeometricType = kind
        if isinstance(points, str):
            text = points.split("\\")
        else:
            text = [f"{v + 0.0:.6f}" for v in np.asarray(points).ravel()]
        ds.NumberOfContourPoints = max(len(text) // 3, 1)
        with pydicom.config.disable_value_validation():
            # Coordinates as they are, even if they are no numbers.
            ds.add_new("ContourData", "LO", text)
            ds["ContourData"].VR = "DS"
        return ds


CASES = []
COMMON = []


def common(base):
    """One series for many structure sets, each opened as a file."""
    if not COMMON:
        COMMON.append(Folder(base, "common"))
        COMMON[0].ct(Grid())
    return COMMON[0]


def add(name, path, peer, **expected):
    CASES.append({"kind": "contours", "name": name, "path": path, "peer": peer, **expected})


def voxels(labels):
    """A handful of voxels of labels [k, j, i]: both sides of boundaries along i, spread over the
    slices; and how many voxels every label has."""
    k, j, i = np.nonzero(labels[:, :, 1:] != labels[:, :, :-1])
    chosen = np.linspace(0, len(k) - 1, 24).astype(int) if len(k) else []
    places = [(int(k[n]), int(j[n]), int(i[n]) + side) for n in chosen for side in (0, 1)]
    places += [(0, 0, 0), tuple(n - 1 for n in labels.shape), (labels.shape[0] // 2, 14, 16)]
    values = [[i, j, k, int(labels[k, j, i])] for k, j, i in dict.fromkeys(places)]
    numbers, counts = np.unique(labels[labels > 0], return_counts=True)
    return {"values": values, "count": {str(n): int(c) for n, c in zip(numbers, counts)}}


def simple(base, name, planes, expected_planes=None, peer=EVEN_ODD, grid=None, labels=None, warns=(),
           **options):
    """A structure "organ" of rings by slice on a grid, opened as a file beside its images."""
    folder = common(base) if grid is None else Folder(base, name)
    if grid is None:
        grid = Grid()
    else:
        folder.ct(grid)
    path = folder.structures([(1, "organ", on_slices(grid, planes))], f"{name}.dcm", **options)
    mask = filled(planes if expected_planes is None else expected_planes)
    add(name, path, peer, size=list(SIZE), spacing_mm=grid.spacing.tolist(),
        origin_mm=grid.origin.tolist(), direction=grid.axes.tolist(), labels={"1": "organ"},
        modality="RTSTRUCT", warns=list(warns), **voxels((mask if labels is None else labels).astype(int)))


def turned():
    """A rotation about two axes, to nine digits."""
    a, b = 0.4, -0.3
    x = np.array([np.cos(a), np.sin(a), 0.0])
    y = np.array([-np.sin(a) * np.cos(b), np.cos(a) * np.cos(b), np.sin(b)])
    return np.stack([x, y, np.cross(x, y)], axis=1)


def make_planes(base):
    """Contours on the slices of their images."""
    disc = {k: [circle(15.2, 13.1, 8.3)] for k in range(2, 8)}
    simple(base, "disc-beside-its-images", disc)
    ring = {k: [circle(15.2, 13.1, 9.4), circle(14.1, 12.3, 4.2)] for k in range(2, 8)}
    simple(base, "hole-as-inner-contour", ring)
    keyhole = np.concatenate([
        circle(15.2, 13.1, 9.4), circle(15.2, 13.1, 9.4)[:1],
        circle(15.2, 13.1, 4.2)[:1], circle(15.2, 13.1, 4.2)[::-1],
    ])
    simple(base, "hole-as-keyhole", {4: [keyhole], 5: [keyhole]})
    nested = [circle(15.2, 13.1, 11.4), circle(15.2, 13.1, 8.2), circle(15.2, 13.1, 4.3)]
    simple(base, "island-in-a-hole", {k: nested for k in range(3, 6)})
    simple(base, "two-parts-in-a-plane",
           {k: [circle(8.2, 8.3, 5.1), box(18.3, 12.4, 27.7, 22.2)] for k in range(1, 4)})
    star = np.array([[15.3 + 11 * np.cos(a), 13.6 + 11 * np.sin(a)]
                     for a in np.arange(5) * 4 * np.pi / 5 - np.pi / 2 + 0.05])
    simple(base, "contour-that-crosses-itself", {k: [star] for k in range(3, 6)})
    simple(base, "contour-beyond-the-image", {k: [circle(2.1, 25.2, 9.3)] for k in range(3, 6)})
    simple(base, "images-turned-about-two-axes", ring, grid=Grid(axes=turned()))
    sagittal = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    simple(base, "sagittal-images", ring, grid=Grid(axes=sagittal))
    long = {k: [circle(15.2, 13.1, 9.4, 2600)] for k in (4,)}
    simple(base, "contour-of-80-kilobytes", long)
    simple(base, "implicit-vr", disc, implicit=True)
    simple(base, "contour-repeats-its-first-point",
           {k: [np.concatenate([r, r[:1]]) for r in rings] for k, rings in ring.items()})
    # Corners on voxel centres: as many voxels as the area, whichever side they are on.
    name, grid = "corners-on-voxel-centres", Grid()
    rectangle = on_slices(grid, {k: [box(6, 5, 16, 17)] for k in (4, 5, 6)})
    path = common(base).structures([(1, "organ", rectangle)], f"{name}.dcm")
    add(name, path, "area of a rectangle between voxel centres", size=list(SIZE),
        values=[[10, 10, 5, 1], [7, 6, 5, 1], [15, 16, 5, 1], [17, 10, 5, 0], [5, 10, 5, 0],
                [10, 18, 5, 0], [10, 4, 5, 0], [10, 10, 3, 0], [10, 10, 7, 0]],
        count={"1": 3 * 10 * 12})


def make_between(base):
    """Contours that are not on the slices."""
    shape = [circle(15.2, 13.1, 8.3)]
    half = "half a distance of planes beyond the outermost ones"
    simple(base, "every-second-slice", {k: shape for k in (2, 4, 6)},
           {k: shape for k in range(1, 7)}, peer=f"a prism, {half}", warns=["interpolated"])
    cone = {1: [circle(15.2, 13.1, 4.2, 720)], 4: [circle(15.2, 13.1, 7.2, 720)],
            7: [circle(15.2, 13.1, 10.2, 720)]}
    ends = {0: 4.2, 1: 4.2, 2: 5.2, 3: 6.2, 4: 7.2, 5: 8.2, 6: 9.2, 7: 10.2, 8: 10.2}
    simple(base, "every-third-slice-of-a-cone", cone,
           {k: [circle(15.2, 13.1, r, 720)] for k, r in ends.items()},
           peer=f"closed form of a cone, {half}", grid=Grid(spacing=(1.5, 1.5, 3.0)),
           warns=["interpolated"])
    simple(base, "planes-between-the-slices", {k + 0.5: shape for k in range(2, 7)},
           {k: shape for k in range(2, 7)}, peer=f"a prism of five planes, {half}")
    simple(base, "planes-finer-than-the-slices", {k / 3: shape for k in range(6, 19)},
           {k: shape for k in range(2, 7)}, peer="a prism")
    simple(base, "one-plane", {4: shape})
    simple(base, "gap-between-two-parts", {k: shape for k in (1, 2, 3, 6, 7)})
    CASES[-1]["warns"] = ["slices without contours"]
    # Slices 3 and 4 of an uneven series are where their contours are.
    at = [0, 1, 2, 3.5, 5, 6, 7, 8, 9, 10]
    uneven = Grid(at=at)
    name, folder = "uneven-slices", Folder(base, "uneven-slices")
    folder.ct(uneven)
    sizes = {3: 8.3, 4: 6.1, 5: 4.4}
    planes = {k: [circle(15.2, 13.1, r)] for k, r in sizes.items()}
    folder.structures([(1, "organ", on_slices(uneven, {at[k]: rings for k, rings in planes.items()}))])
    add(name, f"{name}/rs.dcm", EVEN_ODD, size=list(SIZE), warns=["slice spacing varies"],
        **voxels(filled(planes).astype(int)))
    # A box drawn in sagittal planes, on axial images: x 4.5 to 22.5 mm from the origin in steps of
    # 3 mm, from half a step before the first plane to half a step behind the last one.
    name, grid = "sagittal-contours-on-axial-images", Grid()
    contours = []
    for x in np.arange(6.1, 24, 3.0):
        y0, y1, z0, z1 = 9.1, 40.9, 4.4, 22.3
        corners = [[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]]
        contours.append(grid.origin + np.array(corners))
    path = common(base).structures([(1, "organ", contours)], f"{name}.dcm")
    k, j, i = np.meshgrid(*(np.arange(n) for n in SIZE[::-1]), indexing="ij")
    x, y, z = 1.5 * i, 2.0 * j, 3.0 * k
    mask = (x > 4.6) & (x < 22.6) & (y > 9.1) & (y < 40.9) & (z > 4.4) & (z < 22.3)
    add(name, path, "closed form of a box", size=list(SIZE),
        **voxels(mask.astype(int)))


def make_sets(base):
    """Several structures, and what a structure set holds beside closed contours."""
    grid = Grid()
    disc = {k: [circle(15.2, 13.1, 8.3)] for k in range(2, 8)}
    body = {k: [circle(15.2, 13.1, 12.3)] for k in range(1, 9)}
    small = {k: [circle(18.2, 13.1, 3.3)] for k in range(3, 6)}
    mask = filled

    name = "body-around-its-organs"
    path = common(base).structures([
        (3, "Körper", on_slices(grid, body)), (1, "nodule", on_slices(grid, small)),
        (2, "organ", on_slices(grid, disc)),
    ], f"{name}.dcm")
    labels = 3 * mask(body)
    labels[mask(disc)] = 2
    labels[mask(small)] = 1
    overlap = int((mask(body).astype(int) + mask(disc) + mask(small) > 1).sum())
    add(name, path, EVEN_ODD + ", smaller structures last", size=list(SIZE),
        labels={"1": "nodule", "2": "organ", "3": "Körper"},
        warns=[f"overlap in {overlap} voxels"], **voxels(labels))

    name, folder = "in-a-folder-with-images", Folder(base, "in-a-folder-with-images")
    folder.ct(grid)
    folder.structures([(1, "organ", on_slices(grid, disc))], label="first plan")
    add(name, name, "the CT series is the default", size=list(SIZE), series=2, modality="CT",
        values=[[3, 5, 2, 30 + 5 - 200], [31, 27, 9, 310 + 27 - 900]], warns=["2 series"])
    for wanted, case in (
        ("2", "chosen-by-number"), ("first", "chosen-by-label"), ("RTSTRUCT", "chosen-by-modality"),
    ):
        add(case, name, EVEN_ODD, options={"series": wanted}, size=list(SIZE), series=2,
            modality="RTSTRUCT", labels={"1": "organ"}, **voxels(mask(disc).astype(int)))

    name, folder = "images-in-a-subfolder", Folder(base, "images-in-a-subfolder")
    folder.ct(grid, "images")
    folder.structures([(1, "organ", on_slices(grid, disc))])
    add(name, f"{name}/rs.dcm", EVEN_ODD, size=list(SIZE), **voxels(mask(disc).astype(int)))

    name, folder = "refers-to-one-of-two-series", Folder(base, "refers-to-one-of-two-series")
    folder.ct(Grid(spacing=(3, 3, 3)), "first", series=4)
    folder.images.clear()
    folder.ct(grid, "second")
    folder.structures([(1, "organ", on_slices(grid, disc))])
    add(name, f"{name}/rs.dcm", EVEN_ODD, size=list(SIZE), spacing_mm=[1.5, 2.0, 3.0],
        **voxels(mask(disc).astype(int)))

    name, folder = "only-the-frame-of-reference", Folder(base, "only-the-frame-of-reference")
    folder.ct(grid)
    folder.structures([(1, "organ", on_slices(grid, disc))], refer=False)
    add(name, f"{name}/rs.dcm", EVEN_ODD, size=list(SIZE), warns=["frame of reference"],
        **voxels(mask(disc).astype(int)))

    name = "points-and-open-contours"
    line = grid.world([[2, 2, 4], [9, 3, 4], [9, 20, 4], [3, 20, 4]])
    path = common(base).structures([
        (1, "organ", on_slices(grid, disc)), (2, "isocentre", [("POINT", grid.world([[16, 14, 5]]))]),
        (3, "wire", [("OPEN_PLANAR", line)]), (4, "empty", []),
    ], f"{name}.dcm")
    add(name, path, EVEN_ODD, size=list(SIZE), labels={"1": "organ"},
        warns=["isocentre", "wire", "1 point", "1 open contour", "empty"],
        **voxels(mask(disc).astype(int)))

    name = "only-points"
    path = common(base).structures([(2, "isocentre", [("POINT", grid.world([[16, 14, 5]]))])], f"{name}.dcm")
    add(name, path, "PS3.3 C.8.8.6.3", error=["closed contours", "isocentre"])

    name = "damaged-contours"
    good = on_slices(grid, disc)
    path = common(base).structures([(1, "organ", [
        *good, good[0][:2], "1\\2\\3\\4\\5\\6\\7\\8\\9\\10", "1\\2\\3\\NaN\\5\\6\\7\\8\\9",
        "1\\2\\3\\1e300\\5\\6\\7\\8\\9", "a\\b\\c\\d\\e\\f\\g\\h\\i", good[0][[0, 0, 0]],
    ])], f"{name}.dcm")
    add(name, path, EVEN_ODD, size=list(SIZE), warns=["5 contours"],
        **voxels(mask(disc).astype(int)))

    name = "xor-contours"
    crossing = {k: [circle(12.2, 13.1, 7.3), circle(19.1, 14.2, 6.4)] for k in range(2, 8)}
    contours = [("CLOSEDPLANAR_XOR", c) for c in on_slices(grid, crossing)]
    path = common(base).structures([(1, "organ", contours)], f"{name}.dcm")
    add(name, path, "PS3.3 C.8.8.6.3, " + EVEN_ODD, size=list(SIZE),
        **voxels(mask(crossing).astype(int)))

    name = "every-contour-twice"
    path = common(base).structures([(1, "organ", [*good, *good])], f"{name}.dcm")
    add(name, path, EVEN_ODD, size=list(SIZE), warns=["twice"],
        **voxels(mask(disc).astype(int)))

    name = "roi-number-0"
    path = common(base).structures([
        (0, "organ", on_slices(grid, disc)), (1, "nodule", on_slices(grid, small)),
    ], f"{name}.dcm")
    labels = mask(disc).astype(int)
    labels[mask(small)] = 2
    add(name, path, EVEN_ODD, size=list(SIZE), labels={"1": "organ", "2": "nodule"},
        warns=["numbered from 1"], **voxels(labels))

    name = "more-than-255-labels"
    path = common(base).structures([
        (300, "organ", on_slices(grid, disc)), (7, "nodule", on_slices(grid, small)),
    ], f"{name}.dcm")
    labels = 300 * mask(disc)
    labels[mask(small)] = 7
    add(name, path, EVEN_ODD, size=list(SIZE), labels={"7": "nodule", "300": "organ"},
        **voxels(labels))


def make_alone(base):
    """Structure sets without images: a prism of 5 planes, 3 mm apart, 40 x 150 mm."""
    grid = Grid()
    coronal = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    for name, axes in (("no-images", np.eye(3)), ("no-images-coronal", coronal)):
        folder = Folder(base, name)
        corners = box(0.2, 0.3, 40.2, 150.3)
        contours = [
            np.column_stack([corners, np.full(4, 3.0 * k)]) @ axes.T + grid.origin for k in range(5)
        ]
        folder.structures([(1, "organ", contours)])
        add(name, f"{name}/rs.dcm", "volume of a prism", labels={"1": "organ"},
            spacing_mm=[1.0, 1.0, 3.0], modality="RTSTRUCT", count={"1": 40 * 150 * 5},
            warns=["images", "1 x 1 x 3 mm"])
    CASES[-2]["origin_mm"] = [-20.8, 10.3, -30.0]
    CASES[-2]["size"] = [44, 154, 5]
    CASES[-2]["values"] = [[20, 70, 2, 1], [0, 70, 2, 0], [1, 1, 0, 1], [42, 70, 2, 0], [20, 152, 2, 0]]


def main():
    base = sys.argv[1]
    if os.path.exists(base) and os.listdir(base):
        sys.exit(f"{base} is not empty")
    os.makedirs(base, exist_ok=True)
    for make in (make_planes, make_between, make_sets, make_alone):
        make(base)
    with open(os.path.join(base, "cases.json"), "w", encoding="utf-8") as file:
        lines = ",\n".join(json.dumps(case, ensure_ascii=False) for case in CASES)
        file.write(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()
