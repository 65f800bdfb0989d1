"""Faces with more than three corners, most of them not convex: prisms over polygons in every format
that has polygons. Their volume and distances are closed forms."""

import math
import struct

import numpy as np

KIND = "polygons"

L = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
ARROW = [(0, 0), (4, 0), (1, 1), (0, 4)]
COMB = [(0, -1), (12, -1)] + [(x, 0 if x % 2 == 0 else 3) for x in range(12, -1, -1)]
STAR = [
    (
        math.cos(n * math.pi / 5) * (3 if n % 2 == 0 else 1),
        math.sin(n * math.pi / 5) * (3 if n % 2 == 0 else 1),
    )
    for n in range(10)
]
U = [(0, 0), (5, 0), (5, 4), (4, 4), (4, 1), (1, 1), (1, 4), (0, 4)]
EDGES = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
L_EDGES = [(0, 0), (1.5, 0), (3, 0), (3, 1), (2, 1), (1, 1), (1, 2), (1, 3), (0, 3), (0, 1)]
RING = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]


def area(polygon):
    p = np.array(polygon, float)
    q = np.roll(p, -1, axis=0)
    return float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum() / 2)


def prism(polygon, height=1.0, turn=0):
    """Vertices and faces of a prism; the faces at its ends begin with another corner."""
    n = len(polygon)
    polygon = polygon[turn:] + polygon[:turn]
    points = [(x, y, 0.0) for x, y in polygon] + [(x, y, height) for x, y in polygon]
    faces = [list(range(n))[::-1], list(range(n, 2 * n))]
    edges = {(polygon[k], polygon[(k + 1) % n]) for k in range(n)}
    for k in range(n):
        # The bridge to a hole has no sides.
        if (polygon[(k + 1) % n], polygon[k]) not in edges:
            faces.append([k, (k + 1) % n, n + (k + 1) % n, n + k])
    return points, faces


def turned(points, angle=0.7, tilt=0.4):
    """Points under a rotation about z, then about x."""
    c, s, d, t = math.cos(angle), math.sin(angle), math.cos(tilt), math.sin(tilt)
    m = np.array([[c, -s, 0], [s * d, c * d, -t], [s * t, c * t, d]])
    return [tuple(float(x) for x in m @ np.array(p)) for p in points]


def line(numbers):
    return " ".join(f"{x:.9g}" for x in numbers)


def obj(points, faces):
    return "".join(f"v {line(p)}\n" for p in points) + "".join(
        "f " + " ".join(str(c + 1) for c in f) + "\n" for f in faces
    )


def off(points, faces):
    return (
        f"OFF\n{len(points)} {len(faces)} 0\n"
        + "".join(line(p) + "\n" for p in points)
        + "".join(f"{len(f)} {line(f)}\n" for f in faces)
    )


def ply(points, faces, form="ascii"):
    header = f"ply\nformat {form} 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    if form == "ascii":
        return (
            header
            + "".join(line(p) + "\n" for p in points)
            + "".join(f"{len(f)} {line(f)}\n" for f in faces)
        )
    order = "<" if "little" in form else ">"
    body = b"".join(struct.pack(f"{order}3f", *p) for p in points)
    return (
        header.encode()
        + body
        + b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
    )


def make(cases):
    def case(name, content, ending, volume, triangles, peer="closed form", **more):
        path = f"polygons/{name}.{ending}"
        cases.write(path, content)
        cases.add(KIND, name, path, peer, triangles=triangles, volume_mm3=volume, **more)

    # Signed distances are positive inside.
    notch = [[1.4, 1.4, 0, -0.4], [0.5, 0.5, 0.5, 0.5], [2, 2, 0.5, -1], [0.5, 2, 0.5, 0.5]]
    for turn in range(6):
        points, faces = prism(L, turn=turn)
        case(f"l-obj-{turn}", obj(points, faces), "obj", 5.0, 20, sdf=notch[:2])
    points, faces = prism(L, turn=1)
    case("l-off", off(points, faces), "off", 5.0, 20, sdf=notch)
    case("l-ply", ply(points, faces), "ply", 5.0, 20, sdf=notch)
    case("l-ply-little", ply(points, faces, "binary_little_endian"), "ply", 5.0, 20, sdf=notch[:1])
    case("l-ply-big", ply(points, faces, "binary_big_endian"), "ply", 5.0, 20, sdf=notch[:1])
    shapes = [
        ("arrow", ARROW, [[1.5, 1.5, 0.5, -2 / math.sqrt(10)], [0.5, 0.5, 0.5, 0.5]]),
        ("comb", COMB, [[6, 2.9, 0.5, -2.9 / math.sqrt(10)], [6, -0.5, 0.5, 0.5]]),
        ("star", STAR, [[0, 0, 0.5, 0.5]]),
        ("u", U, [[2.5, 2.5, 0.5, -1.5], [0.5, 3, 0.5, 0.5], [2.5, 0.6, 0.5, 0.4]]),
        ("edges", EDGES, [[1, 1, 0.5, 0.5], [1, 1.8, 0.5, 0.2]]),
        ("l-edges", L_EDGES, notch),
        ("ring", RING, [[2, 2, 0.5, -1], [0.5, 2, 0.5, 0.5]]),
    ]
    for name, polygon, distances in shapes:
        for turn in (0, 3):
            points, faces = prism(polygon, turn=turn)
            triangles = 4 * len(polygon) - 4 - (4 if name == "ring" else 0)
            case(
                f"{name}-{turn}", obj(points, faces), "obj", area(polygon), triangles, sdf=distances
            )
    points, faces = prism(L, turn=4)
    moved = turned(points)
    case("l-turned", obj(moved, faces), "obj", 5.0, 20, sdf=[[*turned([(1.4, 1.4, 0)])[0], -0.4]])
    far = [(x + 1000, y - 2000, z + 500) for x, y, z in points]
    case("l-far-away", obj(far, faces), "obj", 5.0, 20, sdf=[[1001.4, -1998.6, 500, -0.4]])
    doubled = [f[:1] + f if len(f) > 4 else f for f in faces]
    case("corner-twice", obj(points, doubled), "obj", 5.0, 20, sdf=notch[:1])
    closed = [f + f[:1] if len(f) > 4 else f for f in faces]
    case("closed-faces", obj(points, closed), "obj", 5.0, 20, sdf=notch[:1])
    cube = prism([(0, 0), (2, 0), (2, 2), (0, 2)], 2)
    case("quads", obj(*cube), "obj", 8.0, 12, peer="trimesh", sdf=[[1, 1, 1, 1.0]])
    hexagon = [(math.cos(n * math.pi / 3), math.sin(n * math.pi / 3)) for n in range(6)]
    case("hexagon", off(*prism(hexagon)), "off", area(hexagon), 20, peer="trimesh")
    many = [
        (
            math.cos(n * math.pi / 50) * (5 if n % 2 else 4),
            math.sin(n * math.pi / 50) * (5 if n % 2 else 4),
        )
        for n in range(100)
    ]
    case("star-of-100", obj(*prism(many)), "obj", area(many), 4 * 100 - 4, sdf=[[0, 0, 0.5, 0.5]])
