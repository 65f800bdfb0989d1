"""OFF, OBJ, PLY, STL and GIfTI as programs write them; trimesh and nibabel read them, or the format's
description says what is right."""

import base64
import io
import math
import struct
import zlib

import nibabel
import numpy as np
import trimesh

from .polygons import L, line, prism

TEXTS, SURFACES = "off, obj, ply", "gifti, stl"
# A box of 1 x 2 x 3 mm with its corner at the origin.
POINTS, FACES = prism([(0, 0), (1, 0), (1, 2), (0, 2)], 3)
TRIANGLES = [t for f in FACES for t in ([f[0], f[1], f[2]], [f[0], f[2], f[3]])]
RIGHT = {
    "triangles": 12,
    "vertices": 8,
    "volume_mm3": 6.0,
    "sdf": [[0.5, 1, 1.5, 0.5], [0.75, 1, 1, 0.25]],
}


def make(cases):
    make_off(cases)
    make_obj(cases)
    make_ply(cases)
    make_stl(cases)
    make_gifti(cases)


def adder(cases, kind, ending):
    def case(name, content, peer="trimesh", error=None, **more):
        path = f"meshes/{name}.{ending}"
        full = cases.write(path, content)
        if error:
            cases.add(kind, f"{ending}-{name}", path, peer, error=error)
            return
        if peer == "trimesh":
            mesh = trimesh.load(full, force="mesh", process=True)
            assert abs(mesh.volume - RIGHT["volume_mm3"]) < 1e-4, (name, mesh.volume)
        cases.add(kind, f"{ending}-{name}", path, peer, **RIGHT | more)

    return case


def make_off(cases):
    case = adder(cases, TEXTS, "off")
    spec = "Geomview, OFF"
    points = "".join(line(p) + "\n" for p in POINTS)
    faces = "".join(f"3 {line(t)}\n" for t in TRIANGLES)
    case("plain", f"OFF\n8 12 0\n{points}{faces}")
    case("no-blank", f"OFF8 12 0\n{points}{faces}")
    case("counts-on-the-line", f"OFF 8 12 0\n{points}{faces}")
    case("no-edge-count", f"OFF\n8 12\n{points}{faces}", spec)
    case("no-keyword", f"8 12 0\n{points}{faces}", spec)
    case(
        "comments", f"# first\nOFF # second\n# third\n8 12 0 # fourth\n\n{points}\n# fifth\n{faces}"
    )
    case("latin-1-comment", f"OFF\n# Sch\xe4del\n8 12 0\n{points}{faces}".encode("latin-1"), spec)
    colored = "".join(f"{line(p)} 255 0 0 255\n" for p in POINTS)
    case("coff", f"COFF\n8 12 0\n{colored}{faces}", spec)
    normals = "".join(f"{line(p)} 0 0 1\n" for p in POINTS)
    case("noff", f"NOFF\n8 12 0\n{normals}{faces}", spec)
    textured = "".join(f"{line(p)} 0.5 0.5\n" for p in POINTS)
    case("stoff", f"STOFF\n8 12 0\n{textured}{faces}", spec)
    both = "".join(f"{line(p)} 0 0 1 0.1 0.2 0.3 1 0.5 0.5\n" for p in POINTS)
    case("stcnoff", f"STCNOFF\n8 12 0\n{both}{faces}", spec)
    weighted = "".join(f"{line([2 * c for c in p])} 2\n" for p in POINTS)
    case("4off", f"4OFF\n8 12 0\n{weighted}{faces}", spec)
    case("noff-3", f"nOFF 3\n8 12 0\n{points}{faces}", spec)
    case(
        "face-colours",
        f"OFF\n8 12 0\n{points}" + "".join(f"3 {line(t)} 0.1 0.2 0.3\n" for t in TRIANGLES),
    )
    case(
        "face-colour-index",
        f"OFF\n8 12 0\n{points}" + "".join(f"3 {line(t)} 7\n" for t in TRIANGLES),
    )
    case("crlf", f"OFF\n8 12 0\n{points}{faces}".replace("\n", "\r\n"))
    case("quads", f"OFF\n8 6 0\n{points}" + "".join(f"4 {line(f)}\n" for f in FACES))
    case("edge-count-18", f"OFF\n8 12 18\n{points}{faces}")
    case("trailing-lines", f"OFF\n8 12 0\n{points}{faces}\n\nmore\n", spec)
    case("tabs", f"OFF\n8\t12\t0\n{points}{faces}".replace(" ", "\t"))
    case("lower-case", f"off\n8 12 0\n{points}{faces}", spec)
    case(
        "binary",
        b"OFF BINARY\n" + struct.pack(">3i", 8, 12, 0) + b"\xff" * 99,
        spec,
        error=["binary OFF"],
    )
    case("noff-5", f"nOFF 5\n8 12 0\n{points}{faces}", spec, error=["dimension", "5"])
    case("short", f"OFF\n8 12 0\n{points}{faces}"[:-20], spec, error=["face 9"])
    case(
        "index-too-high",
        f"OFF\n8 12 0\n{points}{faces}".replace("3 7", "3 8"),
        spec,
        error=["vertex 8"],
    )
    case("counts-too-high", f"OFF\n80000 12 0\n{points}{faces}", spec, error=["80000"])
    case("not-off", f"MESH\n8 12 0\n{points}{faces}", spec, error=["OFF"])


def make_obj(cases):
    case = adder(cases, TEXTS, "obj")
    spec = "Wavefront OBJ"
    points = "".join(f"v {line(p)}\n" for p in POINTS)

    def faces(form, base=1, of=TRIANGLES):
        return "".join("f " + " ".join(form.format(c + base) for c in t) + "\n" for t in of)

    case("plain", points + faces("{}"))
    case("negative", points + faces("{}", -8))
    case(
        "negative-between",
        "".join("".join(f"v {line(POINTS[c])}\n" for c in t) + "f -3 -2 -1\n" for t in TRIANGLES),
        spec,
    )
    case("normals", points + "vn 0 0 1\n" + faces("{}//1"))
    case("textures", points + "vt 0 0\n" + faces("{}/1"))
    case("both", points + "vt 0 0\nvn 0 0 1\n" + faces("{}/1/1"))
    case("missing-texture-coordinates", points + faces("{}/9/9"), spec)
    case("malformed-texture-line", points + "vt a\n" + faces("{}"), spec)
    case("quads", points + faces("{}", of=FACES))
    case(
        "continued",
        points + "".join("f " + " \\\n ".join(str(c + 1) for c in t) + "\n" for t in TRIANGLES),
    )
    case(
        "continued-crlf",
        points.replace("\n", "\r\n")
        + "".join("f " + " \\\r\n ".join(str(c + 1) for c in t) + "\r\n" for t in TRIANGLES),
        spec,
    )
    case("vertex-colours", "".join(f"v {line(p)} 0.1 0.2 0.3\n" for p in POINTS) + faces("{}"))
    case("weights", "".join(f"v {line(p)} 1.0\n" for p in POINTS) + faces("{}"), spec)
    case(
        "groups",
        "mtllib none.mtl\no box\n"
        + points
        + "g first\nusemtl a\ns 1\n"
        + faces("{}", of=TRIANGLES[:6])
        + "g second\ns off\nusemtl b\n"
        + faces("{}", of=TRIANGLES[6:]),
    )
    case(
        "two-objects",
        "o a\n" + points + faces("{}", of=TRIANGLES[:6]) + "o b\n" + faces("{}", of=TRIANGLES[6:]),
    )
    case("faces-before-vertices", faces("{}") + points, spec)
    case("lines-and-points", points + "l 1 2 3\np 4\n" + faces("{}"))
    case("empty-faces", points + "f\nf 1\nf 1 2\n" + faces("{}"), spec, warns=["3 faces"])
    case("cr-line-ends", (points + faces("{}")).replace("\n", "\r"), spec)
    case("latin-1-name", b"o Sch\xe4del\n" + (points + faces("{}")).encode(), spec)
    case("comments-at-ends", points.replace("\n", " # a vertex\n") + faces("{}"), spec)
    case(
        "exponents", "".join(f"v {p[0]:.3e} {p[1]:.3E} +{p[2]:.1f}\n" for p in POINTS) + faces("{}")
    )
    case("nan-vertex", points + "v nan 0 0\n" + faces("{}") + "f 1 2 9\n", spec, warns=["finite"])
    case("index-0", points + faces("{}", 0), spec, error=["counted from 1"])
    case("index-too-high", points + faces("{}", 5), spec, error=["vertices"])
    case("index-before-the-first", points + "f -9 -1 -2\n", spec, error=["does not exist"])
    case(
        "decimal-comma",
        points.replace("0 0", "0,5 0") + faces("{}"),
        spec,
        error=["three numbers", "line 1"],
    )
    case("word-in-face", points + "f 1 2 x\n", spec, error=['"x"', "line 9"])
    case(
        "free-form-alone",
        points + "cstype bspline\ndeg 3 3\nsurf 0 1 0 1 1 2 3 4\nend\n",
        spec,
        error=["no triangle"],
    )


def make_ply(cases):
    case = adder(cases, TEXTS, "ply")
    spec = "Turk, The PLY Polygon File Format"
    xyz = "property float x\nproperty float y\nproperty float z\n"

    def header(
        form="ascii",
        vertex=xyz,
        face="property list uchar int vertex_indices\n",
        faces=12,
        extra="",
    ):
        return f"ply\nformat {form} 1.0\n{extra}element vertex 8\n{vertex}element face {faces}\n{face}end_header\n"

    points = "".join(line(p) + "\n" for p in POINTS)
    faces = "".join(f"3 {line(t)}\n" for t in TRIANGLES)
    case("plain", header() + points + faces)
    case("vertex-index", header(face="property list uchar int vertex_index\n") + points + faces)
    case("comments", header(extra="comment made by hand\nobj_info num_cols 5\n") + points + faces)
    case("crlf", (header() + points + faces).replace("\n", "\r\n"))
    case("double", header(vertex=xyz.replace("float", "double")) + points + faces)
    case(
        "float32-names",
        header(
            vertex=xyz.replace("float", "float32"),
            face="property list uint8 int32 vertex_indices\n",
        )
        + points
        + faces,
    )
    case(
        "extra-vertex-properties",
        header(vertex=xyz + "property uchar red\nproperty float quality\n")
        + "".join(f"{line(p)} 255 0.5\n" for p in POINTS)
        + faces,
    )
    case(
        "properties-before",
        header(vertex="property uchar flags\n" + xyz)
        + "".join(f"1 {line(p)}\n" for p in POINTS)
        + faces,
    )
    case(
        "extra-face-properties",
        header(
            face="property uchar flags\nproperty list uchar int vertex_indices\nproperty float area\n"
        )
        + points
        + "".join(f"1 3 {line(t)} 0.5\n" for t in TRIANGLES),
    )
    texcoord = "property list uchar int vertex_indices\nproperty list uchar float texcoord\n"
    case(
        "face-texcoord",
        header(face=texcoord) + points + "".join(f"3 {line(t)} 6 0 0 1 0 1 1\n" for t in TRIANGLES),
    )
    case("quads", header(faces=6) + points + "".join(f"4 {line(f)}\n" for f in FACES))
    case(
        "normals",
        header(vertex=xyz + "property float nx\nproperty float ny\nproperty float nz\n")
        + "".join(f"{line(p)} 0 0 1\n" for p in POINTS)
        + faces,
    )
    edges = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
    case(
        "edges-after",
        header().replace("end_header", edges + "end_header") + points + faces + "0 1\n",
        spec,
    )
    case("edges-before", header(extra=edges) + "0 1\n" + points + faces, spec)
    case(
        "faces-before-vertices",
        f"ply\nformat ascii 1.0\nelement face 12\nproperty list uchar int vertex_indices\nelement vertex 8\n{xyz}end_header\n"
        + faces
        + points,
        spec,
    )
    case(
        "trailing-blanks",
        (header() + points + faces).replace("\n", " \n").replace("ply \n", "ply\n"),
        spec,
    )
    case(
        "all-on-one-line",
        header() + points.replace("\n", " ") + faces.replace("\n", " ") + "\n",
        spec,
    )
    case("blank-lines", header() + points + "\n" + faces, spec)
    for order, name in (("<", "little"), (">", "big")):
        vertices = b"".join(struct.pack(f"{order}3f", *p) for p in POINTS)
        body = b"".join(struct.pack(f"{order}B3i", 3, *t) for t in TRIANGLES)
        case(f"binary-{name}", header(f"binary_{name}_endian").encode() + vertices + body)
        wide = b"".join(struct.pack(f"{order}i3H", 3, *t) for t in TRIANGLES)
        case(
            f"binary-{name}-int-ushort",
            header(
                f"binary_{name}_endian", face="property list int ushort vertex_indices\n"
            ).encode()
            + vertices
            + wide,
        )
        double = b"".join(struct.pack(f"{order}3dB", *p, 9) for p in POINTS)
        case(
            f"binary-{name}-double",
            header(
                f"binary_{name}_endian",
                vertex=xyz.replace("float", "double") + "property uchar red\n",
            ).encode()
            + double
            + body,
        )
    vertices = b"".join(struct.pack("<3f", *p) for p in POINTS)
    crlf = header("binary_little_endian").replace("\n", "\r\n").encode()
    case(
        "binary-crlf-header",
        crlf + vertices + b"".join(struct.pack("<B3i", 3, *t) for t in TRIANGLES),
        spec,
    )
    strips = []
    for t in TRIANGLES:
        strips += [*t, -1]
    strip = f"ply\nformat ascii 1.0\nelement vertex 8\n{xyz}element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    case("tristrips", strip + points + f"{len(strips)} {line(strips)}\n", spec)
    # Corners of a strip turn alternately: the sides of the box are one strip of eight triangles.
    around = [4, 0, 5, 1, 6, 2, 7, 3, 4, 0, -1, 1, 0, 2, 3, -1, 4, 5, 7, 6]
    case("tristrip-long", strip + points + f"{len(around)} {line(around)}\n", spec)
    case(
        "tristrip-binary",
        strip.replace("ascii", "binary_little_endian").encode()
        + vertices
        + struct.pack(f"<i{len(around)}i", len(around), *around),
        spec,
    )
    case(
        "points-alone",
        f"ply\nformat ascii 1.0\nelement vertex 8\n{xyz}end_header\n{points}",
        spec,
        error=["no triangle"],
    )
    case("truncated", header() + points + faces[:-30], spec, error=["PLY"])
    case(
        "negative-index",
        header() + points + faces.replace("3 ", "3 -", 1),
        spec,
        error=["negative"],
    )
    case(
        "format-2",
        (header() + points + faces).replace("ascii 1.0", "ascii 2.0"),
        spec,
        error=["PLY"],
    )


def make_stl(cases):
    case = adder(cases, SURFACES, "stl")
    spec = "StL, StereoLithography Interface Specification"

    def facet(t, indent="  ", normal="0 0 1"):
        loop = "".join(f"{indent * 3}vertex {line(POINTS[c])}\n" for c in t)
        return f"{indent}facet normal {normal}\n{indent * 2}outer loop\n{loop}{indent * 2}endloop\n{indent}endfacet\n"

    text = "".join(map(facet, TRIANGLES))
    case("text", f"solid box\n{text}endsolid box\n")
    case(
        "text-several-solids",
        f"solid a\n{''.join(map(facet, TRIANGLES[:6]))}endsolid a\nsolid b\n{''.join(map(facet, TRIANGLES[6:]))}endsolid b\n",
    )
    case("text-upper-case", f"SOLID BOX\n{text.upper()}ENDSOLID BOX\n", spec)
    case("text-crlf-tabs", f"solid box\n{text}endsolid\n".replace("\n", "\r\n").replace("  ", "\t"))
    case("text-name-with-blanks", f"solid my box, exported 3 times\n{text}endsolid my box\n")
    case("text-no-name", f"solid\n{text}endsolid\n")
    case("text-no-end", f"solid box\n{text}", spec, warns=["endsolid"])
    case(
        "text-nan-normals", f"solid box\n{text.replace('0 0 1', 'nan nan nan')}endsolid box\n", spec
    )
    case(
        "text-exponents",
        f"solid box\n{text.replace('vertex 1', 'vertex 1.000000e+00')}endsolid box\n",
    )
    case("text-leading-blanks", f"  \n solid box\n{text}endsolid box\n", spec)
    case("text-one-line", f"solid box {' '.join(text.split())} endsolid box\n", spec)

    def binary(head=b"", count=12, attribute=0, normal=(0, 0, 1), of=TRIANGLES):
        out = head.ljust(80, b"\0")[:80] + struct.pack("<I", count)
        for t in of:
            out += (
                struct.pack("<3f", *normal)
                + b"".join(struct.pack("<3f", *POINTS[c]) for c in t)
                + struct.pack("<H", attribute)
            )
        return out

    case("binary", binary(b"made by hand"))
    case("binary-solid", binary(b"solid box exported as binary"))
    case("binary-solid-vertex", binary(b"solid facet normal outer loop vertex"), spec)
    case("binary-colours", binary(b"COLOR=\xff\0\0\xff", attribute=0x801F))
    case("binary-nan-normals", binary(normal=(math.nan,) * 3))
    case("binary-trailing", binary() + b"\0" * 20, spec, warns=["20 bytes"])
    case("binary-count-0", binary(count=0), spec, warns=["declares 0"])
    case("binary-count-too-high", binary(count=9999), spec, warns=["declares 9999"])
    truncated = binary()[:-25]
    cases.write("meshes/binary-truncated.stl", truncated)
    cases.add(
        SURFACES,
        "stl-binary-truncated",
        "meshes/binary-truncated.stl",
        spec,
        triangles=11,
        warns=["declares 12"],
    )
    case("binary-header-alone", binary(count=0, of=[]), spec, error=["triangle"])
    case(
        "text-vertex-of-two",
        f"solid box\n{text.replace('vertex 1 2 3', 'vertex 1 2')}endsolid\n",
        spec,
        error=["three numbers"],
    )
    case(
        "text-broken-number",
        f"solid box\n{text.replace('vertex 1 2 3', 'vertex 1 2 3..5')}endsolid\n",
        spec,
        error=["three numbers"],
    )


def array(
    data,
    intent,
    encoding="ASCII",
    order="RowMajorOrder",
    endian="LittleEndian",
    kind=None,
    matrix="",
    attributes="",
):
    kind = kind or ("NIFTI_TYPE_INT32" if data.dtype.kind == "i" else "NIFTI_TYPE_FLOAT32")
    ordered = data if order == "RowMajorOrder" else data.T
    raw = (
        np.ascontiguousarray(ordered)
        .astype(data.dtype.newbyteorder("<" if endian == "LittleEndian" else ">"))
        .tobytes()
    )
    text = {
        "ASCII": lambda: " ".join(f"{x:.9g}" for x in ordered.ravel()),
        "Base64Binary": lambda: base64.b64encode(raw).decode(),
        "GZipBase64Binary": lambda: base64.b64encode(zlib.compress(raw)).decode(),
        "ExternalFileBinary": lambda: "",
    }[encoding]()
    return f'<DataArray Intent="{intent}" DataType="{kind}" ArrayIndexingOrder="{order}" Dimensionality="2" Dim0="{data.shape[0]}" Dim1="{data.shape[1]}" Encoding="{encoding}" Endian="{endian}" {attributes}>{matrix}<Data>{text}</Data></DataArray>'


def make_gifti(cases):
    # x and y are RAS in the file.
    ras = np.array(POINTS, np.float32) * np.array([-1, -1, 1], np.float32)
    corners = np.array(TRIANGLES, np.int32)
    spec = "GIFTI Surface Data Format 1.0"

    def text(*arrays):
        return f'<?xml version="1.0" encoding="UTF-8"?>\n<!DOCTYPE GIFTI SYSTEM "http://www.nitrc.org/frs/download.php/115/gifti.dtd">\n<GIFTI Version="1.0" NumberOfDataArrays="{len(arrays)}"><MetaData><MD><Name><![CDATA[a]]></Name><Value><![CDATA[b]]></Value></MD></MetaData><LabelTable/>{"".join(arrays)}</GIFTI>'

    def pair(**more):
        return array(ras, "NIFTI_INTENT_POINTSET", **more), array(
            corners, "NIFTI_INTENT_TRIANGLE", **more
        )

    def case(name, content, peer="nibabel", error=None, files=(), **more):
        path = f"meshes/{name}.gii"
        for file, data in dict(files).items():
            cases.write(f"meshes/{file}", data)
        full = cases.write(path, content)
        if error:
            cases.add(SURFACES, f"gii-{name}", path, peer, error=error)
            return
        if peer == "nibabel":
            image = nibabel.load(full)
            points = image.agg_data("pointset")
            points = points[0] if isinstance(points, tuple) else points
            assert np.allclose(points, ras), name
        cases.add(SURFACES, f"gii-{name}", path, peer, **RIGHT | more)

    for encoding in ("ASCII", "Base64Binary", "GZipBase64Binary"):
        for endian in ("LittleEndian", "BigEndian"):
            for order in ("RowMajorOrder", "ColumnMajorOrder"):
                if encoding != "ASCII" or endian == "LittleEndian":
                    # nibabel reads column-major arrays in their own way.
                    peer = "nibabel" if order == "RowMajorOrder" else spec
                    case(
                        f"{encoding}-{endian}-{order}".lower(),
                        text(*pair(encoding=encoding, endian=endian, order=order)),
                        peer,
                    )
    for endian, order in (("LittleEndian", "<"), ("BigEndian", ">")):
        at = ras.astype(f"{order}f4").tobytes()
        data = b"HEAD" + at + corners.astype(f"{order}i4").tobytes()
        name = f"external-{endian.lower()}"
        external = [
            array(
                d,
                intent,
                "ExternalFileBinary",
                endian=endian,
                attributes=f'ExternalFileName="{name}.dat" ExternalFileOffset="{offset}"',
            )
            for d, intent, offset in (
                (ras, "NIFTI_INTENT_POINTSET", 4),
                (corners, "NIFTI_INTENT_TRIANGLE", 4 + len(at)),
            )
        ]
        case(name, text(*external), files={f"{name}.dat": data})
    missing = array(
        ras,
        "NIFTI_INTENT_POINTSET",
        "ExternalFileBinary",
        attributes='ExternalFileName="nowhere.dat" ExternalFileOffset="0"',
    )
    case("external-missing", text(missing, pair()[1]), spec, error=["nowhere.dat"])
    short = missing.replace("nowhere.dat", "short.dat")
    case(
        "external-short",
        text(short, pair()[1]),
        spec,
        error=["short.dat"],
        files={"short.dat": b"1234"},
    )
    wide = array(
        ras.astype(np.float64), "NIFTI_INTENT_POINTSET", "Base64Binary", kind="NIFTI_TYPE_FLOAT64"
    )
    case("float64", text(wide, pair()[1]))
    bytes_ = array(
        corners.astype(np.uint8), "NIFTI_INTENT_TRIANGLE", "Base64Binary", kind="NIFTI_TYPE_UINT8"
    )
    case("uint8-triangles", text(pair()[0], bytes_))
    case("triangles-first", text(*pair()[::-1]))
    scalars = array(np.zeros((8, 1), np.float32), "NIFTI_INTENT_SHAPE")
    case("with-a-shape", text(*pair(), scalars))

    def space(data_space, to, matrix):
        numbers = " ".join(f"{x:g}" for x in np.asarray(matrix, float).ravel())
        return f"<CoordinateSystemTransformMatrix><DataSpace><![CDATA[{data_space}]]></DataSpace><TransformedSpace><![CDATA[{to}]]></TransformedSpace><MatrixData>{numbers}</MatrixData></CoordinateSystemTransformMatrix>"

    shift = np.eye(4)
    shift[:3, 3] = [5, 6, 7]
    scanner, unknown, tal = (
        "NIFTI_XFORM_SCANNER_ANAT",
        "NIFTI_XFORM_UNKNOWN",
        "NIFTI_XFORM_TALAIRACH",
    )
    triangles = pair()[1]

    def placed(*matrices):
        return text(array(ras, "NIFTI_INTENT_POINTSET", matrix="".join(matrices)), triangles)

    moved = {"sdf": [[0.5 - 5, 1 - 6, 1.5 + 7, 0.5]]}
    case("scanner-to-talairach", placed(space(scanner, tal, shift)))
    case(
        "unknown-to-scanner",
        placed(space(unknown, scanner, shift)),
        spec,
        **moved,
        warns=["scanner"],
    )
    case(
        "two-spaces",
        placed(space(unknown, tal, 2 * shift), space(unknown, scanner, shift)),
        spec,
        **moved,
    )
    case("unknown-to-unknown", placed(space(unknown, unknown, np.eye(4))), not_warns=["scanner"])
    case(
        "unknown-to-scanner-identity",
        placed(space(unknown, scanner, np.eye(4))),
        not_warns=["scanner"],
    )
    case("talairach-to-talairach", placed(space(tal, tal, shift)))
    second = array(ras + 9, "NIFTI_INTENT_POINTSET")
    case("two-pointsets", text(pair()[0], second, triangles), spec, warns=["2 sets of points"])
    case("points-alone", text(pair()[0]), spec, error=["no triangles"])
    case("triangles-alone", text(triangles), spec, error=["no points"])
    case("shape-alone", text(scalars), spec, error=["no surface"])
    case(
        "short-array",
        text(pair()[0].replace('Dim0="8"', 'Dim0="9"'), triangles),
        spec,
        error=["24 values", "27"],
    )
    case(
        "columns-4",
        text(array(np.zeros((8, 4), np.float32), "NIFTI_INTENT_POINTSET"), triangles),
        spec,
        error=["8 x 4"],
    )
    case("gzip", text(*pair()), "nibabel")
