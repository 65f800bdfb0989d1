"""MetaImage with unusual headers; SimpleITK (MetaIO) reads most of them."""

import gzip
import zlib

import numpy as np

from .base import SIZE, in_file, of_itk, some_values, values

KIND = "metaimage"
GEOMETRY = "Offset = -3 4 5\nElementSpacing = 0.5 0.75 2\n"


def text(
    more="",
    data="LOCAL",
    sizes=SIZE,
    kind="MET_USHORT",
    geometry=GEOMETRY,
    dimensions=None,
    order="BinaryDataByteOrderMSB = False\n",
):
    sizes = " ".join(map(str, sizes))
    return (
        f"ObjectType = Image\nNDims = {dimensions or len(sizes.split())}\nBinaryData = True\n{order}{geometry}"
        f"DimSize = {sizes}\n{more}ElementType = {kind}\nElementDataFile = {data}\n"
    )


def make(cases):
    v = values()
    data = in_file(v)
    by_hand = {"peer": "MetaIO", "size": list(SIZE), "values": some_values(v)}

    def case(name, header, body=data, files=(), peer=of_itk, ending=".mha", **more):
        path = f"meta/{name}{ending}"
        for file, content in dict(files).items():
            cases.write(f"meta/{file}", content)
        full = cases.write(path, header, body)
        expected = peer(full) if callable(peer) else dict(peer)
        cases.add(KIND, name, path, **expected | more)

    case("plain", text())
    case("msb", text(order="BinaryDataByteOrderMSB = True\n"), in_file(v, ">"))
    case("element-byte-order-msb", text(order="ElementByteOrderMSB = True\n"), in_file(v, ">"))
    case("no-byte-order", text(order=""))
    case(
        "header-size-minus-1",
        text("HeaderSize = -1\n", "m1.raw"),
        b"",
        {"m1.raw": b"junk!" + data},
        ending=".mhd",
    )
    case(
        "header-size-5",
        text("HeaderSize = 5\n", "m2.raw"),
        b"",
        {"m2.raw": b"junk!" + data},
        ending=".mhd",
    )
    case("header-size-minus-1-local", text("HeaderSize = -1\n"), b"junk!" + data)
    case(
        "compressed",
        text(f"CompressedData = True\nCompressedDataSize = {len(zlib.compress(data))}\n"),
        zlib.compress(data),
    )
    case(
        "compressed-without-size",
        text("CompressedData = True\n"),
        zlib.compress(data),
        peer=by_hand,
    )
    case(
        "compressed-beside",
        text("CompressedData = True\n", "z.zraw"),
        b"",
        {"z.zraw": zlib.compress(data)},
        ending=".mhd",
    )
    case(
        "compressed-gzip",
        text("CompressedData = True\n", "g.raw.gz"),
        b"",
        {"g.raw.gz": gzip.compress(data, mtime=0)},
        peer=by_hand,
        ending=".mhd",
    )
    case("crlf", text().replace("\n", "\r\n"))
    case("comment", text("Comment = a = b\nAcquisitionDate = 2000.01.01\nModality = MET_MOD_CT\n"))
    case(
        "text",
        text().replace("BinaryData = True", "BinaryData = False"),
        " ".join(map(str, v.ravel(order="F"))).encode(),
        peer=by_hand,
    )
    case("local-lower-case", text(data="Local"))
    case("no-blanks-around-equals", text().replace(" = ", "="))

    slices = {f"s{k:02}.raw": in_file(v[:, :, k]) for k in range(SIZE[2])}
    listed = "\n".join(slices) + "\n"
    case("list", text(data="LIST") + listed, b"", slices, ending=".mhd")
    case("list-2", text(data="LIST 2D") + listed, b"", peer=by_hand, ending=".mhd")
    case("pattern", text(data="s%02d.raw 0 3 1"), b"", ending=".mhd")
    skipped = {f"h{k:02}.raw": b"1234" + in_file(v[:, :, k]) for k in range(SIZE[2])}
    case(
        "pattern-header-size",
        text("HeaderSize = 4\n", "h%02d.raw 0 3 1"),
        b"",
        skipped,
        ending=".mhd",
    )
    ends = {f"e{k:02}.raw": b"x" * k + in_file(v[:, :, k]) for k in range(SIZE[2])}
    case(
        "pattern-header-size-minus-1",
        text("HeaderSize = -1\n", "e%02d.raw 0 3 1"),
        b"",
        ends,
        ending=".mhd",
    )
    zipped = {f"z{k:02}.raw": zlib.compress(in_file(v[:, :, k])) for k in range(SIZE[2])}
    case(
        "list-compressed",
        text("CompressedData = True\n", "LIST") + "\n".join(zipped) + "\n",
        b"",
        zipped,
        peer=by_hand,
        ending=".mhd",
    )

    matrix = "TransformMatrix = 0 1 0 -1 0 0 0 0 1\n"
    case("transform-matrix", text(matrix))
    case("rotation", text(matrix.replace("TransformMatrix", "Rotation")))
    case("orientation", text(matrix.replace("TransformMatrix", "Orientation")))
    case("position", text(geometry=GEOMETRY.replace("Offset", "Position")))
    case("origin", text(geometry=GEOMETRY.replace("Offset", "Origin")))
    case("center-of-rotation", text("CenterOfRotation = 7 8 9\n" + matrix))
    case("element-size-alone", text(geometry="Offset = 0 0 0\nElementSize = 0.5 0.75 2\n"))
    case("element-size-and-spacing", text("ElementSize = 3 3 3\n"))
    case("anatomical-orientation-and-matrix", text(matrix + "AnatomicalOrientation = LPI\n"))
    case("anatomical-orientation-alone", text("AnatomicalOrientation = LPI\n"), warns=["LPI"])
    case("anatomical-orientation-rai", text("AnatomicalOrientation = RAI\n"), not_warns=["RAI"])
    oblique = "TransformMatrix = 0.8 0.6 0 -0.6 0.8 0 0 0 1\n"
    case("oblique", text(oblique))

    for kind, dtype in (
        ("UCHAR", "u1"),
        ("CHAR", "i1"),
        ("SHORT", "i2"),
        ("INT", "i4"),
        ("UINT", "u4"),
        ("LONG", "i4"),
        ("ULONG", "u4"),
        ("LONG_LONG", "i8"),
        ("ULONG_LONG", "u8"),
        ("FLOAT", "f4"),
        ("DOUBLE", "f8"),
    ):
        array = values(np.dtype(dtype))
        case(
            f"type-{kind.lower()}",
            text(kind=f"MET_{kind}"),
            in_file(array),
            peer={**by_hand, "values": some_values(array)},
        )
    array = values(np.uint8)
    rgb = np.stack([array, array + 60, array * 2], axis=0)
    colors = [[i, j, k, rgb[:, i, j, k].tolist()] for i, j, k in ((0, 0, 0), (4, 5, 3), (2, 1, 1))]
    case(
        "three-channels",
        text("ElementNumberOfChannels = 3\n", kind="MET_UCHAR"),
        in_file(rgb),
        peer={"peer": "SimpleITK", "size": list(SIZE)},
        components=3,
        colors=colors,
    )
    case(
        "type-array",
        text("ElementNumberOfChannels = 3\n", kind="MET_UCHAR_ARRAY"),
        in_file(rgb),
        peer={"peer": "MetaIO", "size": list(SIZE)},
        components=3,
        colors=colors,
    )
    two = v[:, :, 0]
    case(
        "two-axes",
        text(
            sizes=SIZE[:2],
            geometry="Offset = 1 2\nElementSpacing = 0.5 0.75\nTransformMatrix = 1 0 0 1\n",
        ),
        in_file(two),
        peer={"peer": "SimpleITK"},
        size=[5, 6, 1],
        values=some_values(v[:, :, :1]),
        spacing_mm=[0.5, 0.75, 1],
        origin_mm=[1, 2, 0],
    )
    case(
        "two-axes-thickness",
        text(sizes=SIZE[:2], geometry="ElementSpacing = 0.5 0.75\n"),
        in_file(two),
        peer={"peer": "SimpleITK"},
        spacing_mm=[0.5, 0.75, 1],
        warns=["spacing along k; 1 mm is assumed"],
    )
    case("no-spacing", text(geometry="Offset = 1 2 3\n"), warns=["1 mm is assumed"])
    case("spacing-stated", text(), not_warns=["1 mm"])
    case("element-size-stated", text(geometry="ElementSize = 1 1 1\n"), not_warns=["1 mm"])
    case("distance-units", text("DistanceUnits = um\n"), warns=["DistanceUnits"])
    case("distance-units-mm", text("DistanceUnits = mm\n"), not_warns=["DistanceUnits"])
    four = np.stack([v + 1000 * t for t in range(3)], axis=-1)
    matrix4 = "TransformMatrix = 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n"
    header = text(
        matrix4, sizes=(*SIZE, 3), geometry="Offset = 1 2 3 0\nElementSpacing = 0.5 0.75 2 1\n"
    )
    case(
        "four-axes",
        header,
        in_file(four),
        peer={"peer": "SimpleITK", "size": list(SIZE)},
        time_points=3,
        options={"time": 3},
        values=some_values(four[..., 2]),
        origin_mm=[1, 2, 3],
    )
    make_refusals(case, data, text, slices)


def make_refusals(case, data, text, slices):
    nothing = {"peer": "MetaIO"}
    for name, header, body, fragments in [
        ("type-other", text(kind="MET_OTHER"), data, ["MET_OTHER"]),
        ("type-string", text(kind="MET_STRING"), data, ["MET_STRING"]),
        ("dimensions-and-sizes", text(dimensions=4), data, ["NDims", "DimSize"]),
        ("five-axes", text(sizes=(5, 6, 4, 1, 1), geometry=""), data, ["5 axes"]),
        ("spacing-0", text(geometry="ElementSpacing = 0.5 0 2\n"), data, ["spacing of 0"]),
        (
            "singular-matrix",
            text("TransformMatrix = 1 0 0 1 0 0 0 0 1\n"),
            data,
            ["TransformMatrix"],
        ),
        ("truncated", text(), data[:-4], ["truncated"]),
        ("header-size-minus-2", text("HeaderSize = -2\n"), data, ["HeaderSize"]),
        ("no-data-file", text().split("ElementDataFile")[0], b"", ["ElementDataFile"]),
        ("missing-file", text(data="nowhere.raw"), b"", ["nowhere.raw"]),
        ("not-compressed", text("CompressedData = True\n"), data, ["compressed stream"]),
    ]:
        case(name, header, body, peer=nothing, error=fragments)
    short = {f"t{k:02}.raw": d if k != 2 else d[:-2] for k, d in enumerate(slices.values())}
    case(
        "short-piece",
        text(data="t%02d.raw 0 3 1"),
        b"",
        short,
        peer=nothing,
        ending=".mhd",
        error=["t02.raw", "truncated"],
    )
