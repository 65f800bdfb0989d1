#!/usr/bin/env python3
"""Draws the artefact of [RVD01] figure 5 the way that paper describes it, for comparison with
tapered-block.toml (PAPERS.md): a tapered block of twelve triangles, cut in half, by slices whose
texture coordinates are interpolated over the triangles of each contour.

    python3 volumes/slice-contours.py AZIMUTH,ELEVATION OUT.png

Needs numpy and Pillow.
"""

import sys

import numpy as np
from PIL import Image

HALF, TAPER, CUT, CELL = 65.0, 0.35, 5.0, 16.0  # mm, as tapered-block.toml
SIZE, WIDTH, SLICES = 360, 194.0, 400  # pixels, mm, number of slices

corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * HALF
triangles = [(0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4)]
triangles += [(2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5)]
edges = sorted({tuple(sorted((t[i], t[i - 1]))) for t in triangles for i in range(3)})
# Only the vertices are deformed; what is inside follows by interpolation.
moved = corners * np.where(corners[:, 2:] > 0, [[TAPER, TAPER, 1]], 1)

az, el = np.radians([float(a) for a in sys.argv[1].split(",")])
right = np.array([np.cos(az), np.sin(az), 0])
back = np.array([np.sin(az) * np.cos(el), -np.cos(az) * np.cos(el), np.sin(el)])  # to the viewer
up = np.cross(back, right)
x = ((np.arange(SIZE) + 0.5) / SIZE - 0.5) * WIDTH
px, py = np.meshgrid(x, -x)
picture = np.full((SIZE, SIZE, 3), [0.08, 0.085, 0.1])


def contour(depth):
    """The section of the mesh with a slice: points in the picture's plane and in the texture."""
    d = moved @ back - depth
    at, texture = [], []
    for a, b in edges:
        if (d[a] > 0) != (d[b] > 0):
            t = d[a] / (d[a] - d[b])
            p = moved[a] + t * (moved[b] - moved[a])
            at.append([p @ right, p @ up])
            texture.append(corners[a] + t * (corners[b] - corners[a]))
    at, texture = np.array(at), np.array(texture)
    if len(at) < 3:
        return None
    v = at - at.mean(0)
    order = np.argsort(np.arctan2(v[:, 1], v[:, 0]))
    return at[order], texture[order]


for depth in np.linspace((moved @ back).min(), (moved @ back).max(), SLICES):
    section = contour(depth)
    if section is None:
        continue
    at, texture = section
    for k in range(1, len(at) - 1):
        o, a, b = at[0], at[k] - at[0], at[k + 1] - at[0]
        det = a[0] * b[1] - a[1] * b[0]
        if abs(det) < 1e-9:
            continue
        u = ((px - o[0]) * b[1] - (py - o[1]) * b[0]) / det
        v = ((py - o[1]) * a[0] - (px - o[0]) * a[1]) / det
        world_y = px * right[1] + py * up[1] + depth * back[1]
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (world_y > CUT)
        w = np.stack([1 - u - v, u, v], -1)[hit]
        q = w @ texture[[0, k, k + 1]]
        odd = np.floor(q / CELL).astype(int).sum(1) % 2 == 1
        face = np.abs(world_y[hit] - CUT) < 2.5 * WIDTH / SLICES
        shade = np.where(face, 0.8, 0.62)[:, None]
        picture[hit] = np.where(odd[:, None], [0.25, 0.38, 0.65], [0.98, 0.93, 0.8]) * shade

Image.fromarray((picture.clip(0, 1) * 255).astype(np.uint8)).save(sys.argv[2])
