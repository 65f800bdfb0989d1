#!/usr/bin/env python3
"""Writes `listed/cases.json`: what must come out of the small files in `listed/`.

Every folder there is a file that a public report describes; its name says what is special about it.
What is right comes from pydicom, tifffile, SimpleITK, pynrrd, trimesh or the standard.
"""

import json
import os
import warnings

import nrrd
import numpy as np
import pydicom
import tifffile
import zarr
from pydicom.dataset import FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian

HERE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "listed")
CASES = []


def add(name, path, peer, **expected):
    CASES.append({"kind": "listed", "name": name, "path": path, "peer": peer, **expected})


def picked(voxels):
    """A handful of the voxels of an array [k, j, i]."""
    n = np.array(voxels.shape)
    places = [(0, 0, 0), (0, 0, 1), (0, 1, 0), *[(k, 0, 0) for k in range(1, n[0])], tuple(n - 1)]
    return [[int(i), int(j), int(k), float(voxels[k, j, i])] for k, j, i in places]


def dicom(path):
    ds = pydicom.dcmread(os.path.join(HERE, path), force=True)
    if "TransferSyntaxUID" not in ds.file_meta:
        ds.file_meta = FileMetaDataset()
        ds.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    if ds.get("NumberOfFrames") == 0:
        ds.NumberOfFrames = 1
    slope, intercept = float(ds.get("RescaleSlope", 1)), float(ds.get("RescaleIntercept", 0))
    return ds, ds.pixel_array * slope + intercept


def stack(names, **expected):
    """A stack of slices in order, as pydicom reads them."""
    read = [dicom(name) for name in names]
    voxels = np.stack([pixels for _, pixels in read])
    ds = read[0][0]
    down, across = (float(v) for v in ds.PixelSpacing)
    out = {"size": list(voxels.shape[::-1]), "values": picked(voxels)}
    if "ImagePositionPatient" in ds:
        out["origin_mm"] = [float(v) for v in ds.ImagePositionPatient]
        if len(names) > 1:
            last = np.array(read[-1][0].ImagePositionPatient, float)
            step = np.linalg.norm(last - out["origin_mm"]) / (len(names) - 1)
            out["spacing_mm"] = [across, down, float(step)]
    return {**out, **expected}


def slices(folder, count, ending=".dcm"):
    return [f"{folder}/{n}{ending}" for n in range(count)]


def add_dicom():
    folder = "F01a-un-undefined-length"
    for name in ("un", "un-item-length"):
        add(f"F01a {name}", f"{folder}/{name}.dcm", "pydicom", **stack([f"{folder}/{name}.dcm"]))
    for folder, count, more in (
        ("F01b-un-known-tags", 5, {}),
        ("F03a-iop-jitter-1e-9", 6, {"series": 1}),
        ("F03b-pixelspacing-jitter", 6, {"series": 1}),
        ("F04-same-sop-instance-uid", 5, {}),
        ("F09-intercept-without-slope", 2, {}),
        ("F11a-slices-half-a-micrometre-apart", 8, {"time_points": 1}),
        ("F12-slice-distance-made-up-files", 4, {"warns": ["1 mm"]}),
    ):
        add(folder.split("-")[0], folder, "pydicom", **stack(slices(folder, count), **more))
    folder = "F02a-times-mixed-repeated-instance-numbers"
    for time, names in ((1, "dacf"), (2, "behg")):
        read = stack([f"{folder}/{n}.dcm" for n in names], time_points=2, options={"time": time})
        add(f"F02a time {time}", folder, "pydicom, by AcquisitionTime", **read)
    folder = "F02b-times-mixed-random-instance-numbers"
    for time in (1, 2):
        names = slices(folder, 8)[4 * time - 4 : 4 * time]
        read = stack(names, time_points=2, options={"time": time})
        add(f"F02b time {time}", folder, "pydicom, by ContentTime", **read)
    for name, order in (("dose", 1), ("dose-abs", 1), ("dose-desc", -1)):
        path = f"F06-rt-dose/{name}.dcm"
        ds, voxels = dicom(path)
        voxels = voxels[::order] * float(ds.DoseGridScaling)
        origin = [-10.0, -20.0, -30.0 - (12.0 if order < 0 else 0.0)]
        add(
            f"F06 {name}", path, "PS3.3 C.8.8.3", size=[5, 6, 5], spacing_mm=[2.0, 2.5, 3.0],
            values=[] if order < 0 else picked(voxels), origin_mm=None if order < 0 else origin,
        )
    path = "F12-slice-distance-made-up/y.dcm"
    add("F12 one file", path, "pydicom", size=[5, 6, 4], values=picked(dicom(path)[1]), warns=["1 mm"])
    folder = "F15-order-of-names"
    add("F15", folder, "pydicom, by the numbers", **stack([f"{folder}/IM{n}" for n in range(1, 13)]))
    for name, path in (
        ("F19", "F19-number-of-frames-0/x.dcm"),
        ("F22", "F22-implicit-under-explicit/wrong-ts.dcm"),
        ("F23 bare", "F23-no-preamble/bare-long-imagetype.dcm"),
        ("F23 meta", "F23-no-preamble/meta-only.dcm"),
        ("F26", "F26-description-escapes/x.dcm"),
    ):
        more = {"description": dicom(path)[0].SeriesDescription} if name == "F26" else {}
        add(name, path, "pydicom", **stack([path], **more))
    add_questions()


def add_questions():
    path = "Q02-gated-spect/nm.dcm"
    voxels = dicom(path)[1]
    for time in (1, 2):
        half = voxels[4 * time - 4 : 4 * time]
        # Frames are consecutive along the normal: PS3.3 C.8.4.14.
        add(
            f"Q02 time {time}", path, "PS3.3 C.8.4.8", options={"time": time}, size=[5, 6, 4],
            spacing_mm=[4.0, 4.0, 4.0], time_points=2, values=picked(half),
        )
    path = "Q03-mosaic/x.dcm"
    tiles = dicom(path)[1].reshape(2, 6, 2, 5).transpose(0, 2, 1, 3).reshape(4, 6, 5)
    add(
        "Q03", path, "dcm2niix, nii_dicom.cpp", size=[5, 6, 4], spacing_mm=[0.6, 0.8, 3.0],
        origin_mm=[-5 + 2.5 * 0.6, -6 + 3 * 0.8, 0], values=picked(tiles),
    )
    path = "Q04-ultrasound-clip/x.dcm"
    voxels = dicom(path)[1]
    for time in (1, 4):
        add(
            f"Q04 time {time}", path, "PS3.3 C.7.6.5", options={"time": time}, size=[5, 6, 1],
            time_points=4, values=picked(voxels[time - 1 : time]),
        )
    path = "Q05-jpeg-labelled-rgb/x.dcm"
    pixels = dicom(path)[1]
    colors = [[i, j, 0, [float(v) for v in pixels[j, i]]] for i, j in ((0, 0), (3, 12), (15, 15))]
    add("Q05", path, "pydicom; JFIF is YCbCr", size=[16, 16, 1], colors=colors, tolerance=3)


def add_others():
    path = "F07-nrrd-gzip-byte-skip/bs.nrrd"
    voxels = nrrd.read(os.path.join(HERE, path), index_order="C")[0]
    add("F07", path, "pynrrd", size=[5, 6, 4], values=picked(voxels))
    path = "F08-seg-nrrd-layers/x.seg.nrrd"
    layers = nrrd.read(os.path.join(HERE, path), index_order="C")[0]
    for layer, labels in ((1, {"1": "liver", "2": "spleen"}), (2, {"1": "tumour"})):
        add(
            f"F08 layer {layer}", path, "pynrrd, Segment*_Layer", options={"channel": layer},
            size=[5, 6, 4], values=picked(layers[..., layer - 1]), labels=labels,
        )
    # Dividing a face of the prism otherwise changes neither its volume nor its distances.
    for name in ("o07_0.obj", "o07_1.obj", "o07_1.off", "o07_1.ply"):
        add(
            f"F10 {name}", f"F10-concave-faces/{name}", "trimesh; distances by the formula",
            triangles=20, volume_mm3=5.0,
            sdf=[[1.4, 1.4, 0.0, -0.4], [0.5, 0.5, 0.5, 0.5], [2.0, 2.0, 0.5, -1.0]],
        )
    for name in ("bit_None.tif", "bit_group4.tif"):
        path = f"F16-tiff-1-bit/{name}"
        voxels = tifffile.imread(os.path.join(HERE, path))
        add(f"F16 {name}", path, "tifffile", size=[16, 8, 3], values=picked(voxels))
    # Indices (tifffile) and colours (SimpleITK) are both right.
    add("F17", "F17-tiff-palette/palij.tif", "tifffile, SimpleITK", size=[5, 6, 4])
    add("F18", "F18-off-without-blank/f02.off", "trimesh", triangles=12, vertices=8, volume_mm3=48.0)
    add_flirt()
    path = "F24-zarr-bool/z09-bool.zarr"
    voxels = zarr.open(os.path.join(HERE, path), mode="r")["0"][:].astype(float)
    add("F24", path, "zarr", size=[11, 9, 7], spacing_mm=[0.001] * 3, values=picked(voxels))
    for name in ("miw_f4", "miw_i2", "miw_u2"):
        path = f"Q01-white-is-zero/{name}.tif"
        add(f"Q01 {name}", path, "tifffile", size=[5, 6, 4], warns=[["white", "invert"]])
    folder = "Q06-ome-multi-file/tiff-omemulti"
    for name in ("z0", "z1", "z2"):
        path = f"{folder}/{name}.ome.tif"
        voxels = tifffile.imread(os.path.join(HERE, path))
        add(f"Q06 {name}", path, "tifffile", size=[5, 6, 3], values=picked(voxels))


def add_flirt():
    """A FLIRT matrix maps FSL's millimetres of the moving image to those of the reference."""
    path, volume = "F21-flirt-hex/hexfloat-axi.mat", "F07-nrrd-gzip-byte-skip/bs.nrrd"
    with open(os.path.join(HERE, path), encoding="ascii") as file:
        matrix = np.array([[float.fromhex(v) for v in line.split()] for line in file])
    # The volume's axes are right-handed: FSL counts x from its other end.
    fsl_from_world = np.diag([-1.0, 1, 1, 1])
    fsl_from_world[0, 3] = nrrd.read_header(os.path.join(HERE, volume))["sizes"][0] - 1
    source_from_deformed = np.linalg.inv(matrix @ fsl_from_world) @ fsl_from_world
    points = [[*p, *(source_from_deformed @ [*p, 1])[:3].round(6)] for p in ((1, 2, 1), (3, 4, 2))]
    add("F21", path, "float.fromhex, FSL's convention", options={"volume": volume}, points=points)


def main():
    warnings.simplefilter("ignore")
    add_dicom()
    add_others()
    cases = [{name: v for name, v in c.items() if v is not None} for c in CASES]
    with open(os.path.join(HERE, "cases.json"), "w", encoding="utf-8") as file:
        lines = ",\n".join(json.dumps(c, ensure_ascii=False) for c in cases)
        file.write(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()
