"""Small images whose values differ from voxel to voxel, the cases made of them, and the readers that
say what is right."""

import os

import nibabel
import nrrd
import numpy as np
import SimpleITK

SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)

SIZE = (5, 6, 4)
LPS_FROM_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


def values(dtype=np.uint16, size=SIZE):
    """Values 100 k + 10 j + i + 7, indexed [i, j, k]; reduced to the range of 8-bit types."""
    i, j, k = np.indices(size)
    v = 100 * k + 10 * j + i + 7
    if np.dtype(dtype).itemsize == 1:
        v = (v * 7) % 120
    return v.astype(dtype)


def in_file(array, order="<"):
    """The bytes of an array indexed [i, j, k]: i fastest."""
    return array.astype(array.dtype.newbyteorder(order)).tobytes(order="F")


def some_values(array):
    """A handful of voxels of an array indexed [i, j, k], as a case lists them."""
    n = np.array(array.shape)
    picks = [[0, 0, 0], [1, 0, 0], [n[0] - 1, 1 % n[1], 0], [2 % n[0], n[1] - 1, n[2] // 2], n - 1]
    out = []
    for at in picks:
        at = [int(a) for a in at]
        if [*at, float(array[tuple(at)])] not in out:
            out.append([*at, float(array[tuple(at)])])
    return out


class Cases:
    """Cases and their files."""

    def __init__(self, folder):
        self.folder, self.list = folder, []
        os.makedirs(folder, exist_ok=True)

    def path(self, name):
        path = os.path.join(self.folder, name)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        return path

    def write(self, name, *parts):
        """Writes a file of texts and bytes; returns its path."""
        with open(self.path(name), "wb") as file:
            for part in parts:
                file.write(part.encode("utf-8") if isinstance(part, str) else part)
        return self.path(name)

    def add(self, kind, name, path, peer, **expected):
        self.list.append({"kind": kind, "name": name, "path": path, "peer": peer, **expected})


def of_itk(path, **more):
    """What SimpleITK reads."""
    image = SimpleITK.ReadImage(path)
    array = SimpleITK.GetArrayFromImage(image)
    out = {}
    if image.GetNumberOfComponentsPerPixel() == 1 and image.GetDimension() == 3:
        out = {"size": list(image.GetSize()), "values": some_values(array.transpose())}
        out |= {"spacing_mm": list(image.GetSpacing()), "origin_mm": list(image.GetOrigin())}
        out["direction"] = np.reshape(image.GetDirection(), (3, 3)).tolist()
    return {"peer": "SimpleITK", **out, **more}


def of_pynrrd(path, **more):
    """What pynrrd reads: the values, and the geometry in LPS."""
    array, header = nrrd.read(path)
    signs = {"right-anterior-superior": [-1, -1, 1], "RAS": [-1, -1, 1], "LAS": [1, -1, 1]}
    sign = np.array(signs.get(header.get("space"), [1, 1, 1]), float)
    out = {"size": list(array.shape), "values": some_values(array)}
    directions = header.get("space directions")
    if directions is not None:
        axes = (
            np.array([d for d in directions if d is not None and np.isfinite(d).all()], float)
            * sign
        )
        lengths = np.linalg.norm(axes, axis=1)
        out["spacing_mm"] = lengths.tolist()
        out["direction"] = (axes / lengths[:, None]).T.tolist()
        out["origin_mm"] = (np.array(header.get("space origin", [0, 0, 0])) * sign).tolist()
    return {"peer": "pynrrd", **out, **more}


def of_nibabel(path, **more):
    """What nibabel reads: scaled values, and the affine in LPS."""
    image = nibabel.load(path)
    array = np.asarray(image.dataobj)
    affine = LPS_FROM_RAS @ image.affine
    lengths = np.linalg.norm(affine[:3, :3], axis=0)
    out = {"size": list(array.shape[:3]), "values": some_values(array)} if array.ndim == 3 else {}
    out |= {"spacing_mm": lengths.tolist(), "origin_mm": affine[:3, 3].tolist()}
    out["direction"] = (affine[:3, :3] / lengths).tolist()
    return {"peer": "nibabel", **out, **more}
