#!/usr/bin/env python3
"""Makes brain-hull.obj: a closed mesh round the brain of colin27-head-t1.nii.gz.

The labelled regions of colin27-aal-labels.nii.gz are joined, closed and filled, grown by GROW mm
and smoothed; the surface is taken by surface nets on a grid of CELL mm. Needs numpy and nibabel:

    python3 volumes/brain-hull.py
"""

from pathlib import Path

import nibabel
import numpy as np

CLOSE = 9  # mm
GROW = 0  # mm, beyond the labels
BLUR = 1.6  # mm
CELL = 5  # mm

folder = Path(__file__).parent


def ball(mask, steps, grow):
    """Dilation (or erosion) by `steps` mm; faces and edges in turn make the ball rounder."""
    m = mask if grow else ~mask
    for n in range(steps):
        out = m.copy()
        for a in range(3):
            for s in (-1, 1):
                out |= np.roll(m, s, a)
                if n % 2:
                    b = (a + 1) % 3
                    for t in (-1, 1):
                        out |= np.roll(np.roll(m, s, a), t, b)
        m = out
    return m if grow else ~m


def blur(f, sigma):
    x = np.arange(-int(3 * sigma + 1), int(3 * sigma + 1) + 1)
    k = np.exp(-0.5 * (x / sigma) ** 2)
    k /= k.sum()
    for a in range(3):
        f = np.apply_along_axis(np.convolve, a, f, k, "same")
    return f


def outside(mask):
    """What can be reached from the corner without crossing the mask."""
    out = np.zeros_like(mask)
    out[0, 0, 0] = True
    while True:
        n = out.sum()
        for a in range(3):
            for view in (out, np.flip(out, a)):
                free = ~mask if view is out else np.flip(~mask, a)
                v, f = np.moveaxis(view, a, 0), np.moveaxis(free, a, 0)
                for i in range(1, v.shape[0]):
                    v[i] |= v[i - 1] & f[i]
        if out.sum() == n:
            return out


def surface_nets(f):
    """Vertices (indices of f) and triangles of the surface f = 0, f positive inside."""
    inside = f > 0
    cells = tuple(n - 1 for n in f.shape)
    total, count = np.zeros(cells + (3,)), np.zeros(cells)
    corner = lambda d: tuple(slice(d[a], d[a] + cells[a]) for a in range(3))
    grid = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), -1)
    for a in range(3):
        for u in (0, 1):
            for v in (0, 1):
                p = [0, 0, 0]
                p[(a + 1) % 3], p[(a + 2) % 3] = u, v
                q = list(p)
                q[a] = 1
                f0, f1 = f[corner(p)], f[corner(q)]
                cross = (f0 > 0) != (f1 > 0)
                t = np.where(cross, f0 / np.where(cross, f0 - f1, 1), 0)
                at = grid + np.array(p, float)
                at[..., a] += t
                total += at * cross[..., None]
                count += cross
    mixed = count > 0
    index = np.full(cells, -1)
    index[mixed] = np.arange(mixed.sum())
    vertices = total[mixed] / count[mixed][:, None]
    triangles = []
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        s0, s1 = [slice(1, -1)] * 3, [slice(1, -1)] * 3
        s0[a], s1[a] = slice(0, -1), slice(1, None)
        i0, i1 = inside[tuple(s0)], inside[tuple(s1)]
        for flip, edges in ((False, i0 & ~i1), (True, ~i0 & i1)):
            e = np.argwhere(edges) + np.where(np.arange(3) == a, 0, 1)
            quad = []
            for db, dc in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
                o = e.copy()
                o[:, b] += db
                o[:, c] += dc
                quad.append(index[tuple(o.T)])
            q = np.stack(quad[::-1] if flip else quad, 1)
            triangles += [q[:, [0, 1, 2]], q[:, [0, 2, 3]]]
    return vertices, np.concatenate(triangles)


image = nibabel.load(folder / "colin27-aal-labels.nii.gz")
mask = np.pad(np.asarray(image.dataobj) > 0, 24)
mask = ball(ball(mask, CLOSE, True), CLOSE, False)
mask = ~outside(mask)
field = blur(ball(mask, int(GROW), True).astype(float), BLUR) - 0.5
step = int(CELL)
vertices, triangles = surface_nets(np.where(field == 0, 1e-9, field)[::step, ::step, ::step])
ras = (vertices * step - 24) @ image.affine[:3, :3].T + image.affine[:3, 3]
lps = ras * [-1, -1, 1]
if np.linalg.det(image.affine[:3, :3]) < 0:
    triangles = triangles[:, ::-1]

with open(folder / "brain-hull.obj", "w") as f:
    f.write("# A closed mesh round the brain of colin27-head-t1.nii.gz, LPS mm; made by brain-hull.py.\n")
    f.writelines("v %.2f %.2f %.2f\n" % tuple(v) for v in lps)
    f.writelines("f %d %d %d\n" % tuple(t + 1) for t in triangles)
print(len(vertices), "vertices,", len(triangles), "triangles")
