"""NRRD: skips, encodings, data files and fields. pynrrd and SimpleITK (teem) read most of them; what
neither reads follows the format definition (teem, nrrd.sourceforge: "Definition of NRRD File
Format")."""

import bz2
import gzip

import numpy as np

from .base import SIZE, in_file, of_itk, of_pynrrd, some_values, values

SKIPS, FIELDS = "nrrd skips and encodings", "nrrd fields"
LPS = "space: left-posterior-superior\nspace directions: (0.5,0,0) (0,0.75,0) (0,0,2)\nspace origin: (-3,4,5)\n"


def packed(data):
    return gzip.compress(data, mtime=0)


def text(
    extra, sizes=SIZE, kind="ushort", encoding="raw", endian="little", version=4, geometry=LPS
):
    """A header with its usual fields and more."""
    sizes = " ".join(map(str, sizes))
    dimension = len(sizes.split())
    order = f"endian: {endian}\n" if endian else ""
    return (
        f"NRRD000{version}\ntype: {kind}\ndimension: {dimension}\nsizes: {sizes}\n"
        f"{geometry}{order}encoding: {encoding}\n{extra}"
    )


def make(cases):
    make_skips(cases)
    make_pieces(cases)
    make_encodings(cases)
    make_fields(cases)
    make_kinds(cases)
    make_spaces(cases)


def make_skips(cases):
    v = values()
    data = in_file(v)
    junk = b"HEADERJUNK"
    by_format = {"size": list(SIZE), "values": some_values(v), "spacing_mm": [0.5, 0.75, 2.0]}

    def case(name, extra, body, encoding="raw", peer=of_pynrrd, other=None):
        path = f"nrrd/{name}.nrrd"
        full = cases.write(path, text(extra, encoding=encoding), "\n", body)
        expected = (
            peer(full) if peer else {"peer": "NRRD format, byte skip and line skip", **by_format}
        )
        cases.add(SKIPS, name, path, **{**expected, **(other or {})})

    case("gzip-minus-1", "byte skip: -1\n", packed(junk + data), "gzip")
    case("bzip2-minus-1", "byte skip: -1\n", bz2.compress(junk + data), "bzip2")
    case("raw-minus-1", "byte skip: -1\n", junk + data)
    case("raw-positive", "byte skip: 10\n", junk + data)
    case("gzip-positive", "byte skip: 10\n", packed(junk + data), "gzip", peer=of_itk)
    case("bzip2-positive", "byte skip: 10\n", bz2.compress(junk + data), "bzip2", peer=None)
    case("raw-lines", "line skip: 2\n", b"one\ntwo two\n" + data)
    case("gzip-lines-before", "line skip: 2\n", b"one\ntwo\n" + packed(data), "gzip")
    case(
        "gzip-lines-and-bytes",
        "line skip: 1\nbyte skip: 10\n",
        b"one\n" + packed(junk + data),
        "gzip",
        peer=of_itk,
    )
    case(
        "gzip-lines-and-minus-1",
        "line skip: 1\nbyte skip: -1\n",
        b"one\n" + packed(junk + data),
        "gzip",
    )
    case("raw-without-blanks-in-names", "lineskip: 1\nbyteskip: 10\n", b"one\n" + junk + data)
    case("raw-minus-4", "byte skip: -4\n", junk + data + b"end", peer=None)
    case("gzip-minus-4", "byte skip: -4\n", packed(junk + data + b"end"), "gzip", peer=None)
    case("gzip-two-members", "", packed(data[:100]) + packed(data[100:]), "gzip", peer=None)
    case(
        "text-byte-skip",
        "byte skip: 10\n",
        junk + " ".join(map(str, v.ravel(order="F"))).encode(),
        "ascii",
    )
    refusals = [
        ("text-minus-1", "byte skip: -1\n", "ascii", b"1 2 3", ["byte skip", "text"]),
        ("lines-minus-1", "line skip: -1\n", "raw", data, ["line skip"]),
        ("skip-beyond-the-end", "byte skip: 10000\n", "raw", data, ["truncated"]),
        ("minus-1-too-short", "byte skip: -1\n", "gzip", packed(data[:50]), ["truncated"]),
    ]
    for name, extra, encoding, body, fragments in refusals:
        cases.write(f"nrrd/{name}.nrrd", text(extra, encoding=encoding), "\n", body)
        cases.add(SKIPS, name, f"nrrd/{name}.nrrd", "pynrrd refuses it, too", error=fragments)


def make_pieces(cases):
    v = values()
    expected = {"size": list(SIZE), "values": some_values(v), "peer": "NRRD format, data file"}
    slices = [in_file(v[:, :, k]) for k in range(SIZE[2])]
    rows = [in_file(v[:, j, k]) for k in range(SIZE[2]) for j in range(SIZE[1])]

    def case(name, header, files, encoding="raw", **more):
        for file, data in files.items():
            cases.write(f"nrrd/{name}/{file}", data)
        path = f"nrrd/{name}/a.nhdr"
        cases.write(path, text(header, encoding=encoding))
        cases.add(SKIPS, name, path, **{**expected, **more})

    numbered = {f"s{n:02}.raw": s for n, s in enumerate(slices)}
    listed = "data file: LIST\n" + "\n".join(numbered)
    case("list", listed, numbered)
    case("list-2", listed.replace("LIST", "LIST 2"), numbered)
    case("list-crlf", listed.replace("\n", "\r\n"), numbered)
    rowed = {f"r{n}.raw": r for n, r in enumerate(rows)}
    case("list-1-less-than-a-slice", "data file: LIST 1\n" + "\n".join(rowed), rowed)
    case(
        "list-whole-halves",
        "data file: LIST 3\na.raw\nb.raw\n",
        {"a.raw": slices[0] + slices[1], "b.raw": slices[2] + slices[3]},
    )
    case(
        "list-skips",
        "line skip: 1\nbyte skip: 3\n" + listed,
        {f: b"line\nxyz" + d for f, d in numbered.items()},
    )
    case(
        "list-minus-1",
        "byte skip: -1\n" + listed,
        {f: b"x" * (n + 1) + d for n, (f, d) in enumerate(numbered.items())},
    )
    case(
        "list-gzip-minus-1",
        "byte skip: -1\n" + listed,
        {f: packed(b"x" * (n + 1) + d) for n, (f, d) in enumerate(numbered.items())},
        "gzip",
    )
    texts = {f: " ".join(map(str, v[:, :, n].ravel(order="F"))) for n, f in enumerate(numbered)}
    case("list-text", listed, texts, "text")
    case("list-hex", listed, {f: d.hex() for f, d in numbered.items()}, "hex")
    case("pattern", "data file: s%02d.raw 0 3 1\n", numbered)
    case("pattern-2", "data file: s%02d.raw 0 3 1 2\n", numbered)
    case(
        "pattern-backwards",
        "data file: s%02d.raw 3 0 -1\n",
        {f"s{3 - n:02}.raw": s for n, s in enumerate(slices)},
    )
    case("detached-with-a-blank", "data file: a b.raw\n", {"a b.raw": b"".join(slices)})
    case(
        "detached-line-skip",
        "line skip: 2\ndatafile: a.raw\n",
        {"a.raw": b"1\n2\n" + b"".join(slices)},
    )
    path = "nrrd/detached-minus-1/a.nhdr"
    cases.write("nrrd/detached-minus-1/a.raw", b"0123456" + b"".join(slices))
    full = cases.write(path, text("byte skip: -1\ndata file: ./a.raw\n"))
    cases.add(SKIPS, "detached-minus-1", path, **of_pynrrd(full))
    refused = {k: None for k in ("size", "values")}
    three = dict(list(numbered.items())[:3])
    case(
        "list-2-too-few",
        "data file: LIST 2\n" + "\n".join(three),
        three,
        **refused,
        error=["3 data files", "4"],
    )
    case("list-missing-piece", listed, three, **refused, error=["s03.raw"])
    short = {**numbered, "s02.raw": slices[2][:-2]}
    case("list-short-piece", listed, short, **refused, error=["s02.raw", "truncated"])
    for c in cases.list:
        for name in [n for n, e in c.items() if e is None]:
            del c[name]


def make_encodings(cases):
    v = values()
    data = in_file(v)
    written = " ".join(map(str, v.ravel(order="F")))
    right = {"size": list(SIZE), "values": some_values(v)}

    def case(name, encoding, body, endian="little", peer=None, **more):
        path = f"nrrd/{name}.nrrd"
        full = cases.write(path, text("", encoding=encoding, endian=endian), "\n", body)
        cases.add(
            SKIPS,
            name,
            path,
            **(of_pynrrd(full) if peer else {"peer": "NRRD format, encoding", **right}) | more,
        )

    case("big-endian", "raw", in_file(v, ">"), "big", peer=True)
    case("text-without-endian", "text", written, None, peer=True)
    case("txt", "txt", written.replace(" ", "\n"), None, peer=True)
    case("ASCII", "ASCII", written, None, peer=True)
    case("gz", "gz", packed(data), peer=True)
    case("bz2", "bz2", bz2.compress(data), peer=True)
    case("hex", "hex", data.hex().upper())
    case(
        "hex-in-lines",
        "hex",
        "\n".join(data.hex()[n : n + 64] for n in range(0, 2 * len(data), 64)),
    )
    nothing = {"size": None, "values": None}
    refusals = [
        ("zrl", "zrl", data, ["zrl"]),
        ("lz4", "lz4", data, ["lz4"]),
        ("hex-stray", "hex", "0z" + data.hex(), ["hex"]),
        ("hex-short", "hex", data.hex()[:-8], ["truncated"]),
        ("text-short", "text", written[:-8], ["truncated"]),
        ("raw-short", "raw", data[:-3], ["truncated"]),
        ("gzip-not-gzip", "gzip", data, ["compressed stream"]),
    ]
    for name, encoding, body, fragments in refusals:
        case(name, encoding, body, **nothing, error=fragments)
    cases.write("nrrd/endian-missing.nrrd", text("", endian=None), "\n", data)
    cases.add(SKIPS, "endian-missing", "nrrd/endian-missing.nrrd", "pynrrd", error=["endian"])
    for c in cases.list:
        for name in [n for n, e in c.items() if e is None]:
            del c[name]


def make_fields(cases):
    v = values()
    data = in_file(v)

    def case(name, header, body=data, peer=of_pynrrd, **more):
        path = f"nrrd/{name}.nrrd"
        full = cases.write(path, header, "\n", body)
        cases.add(FIELDS, name, path, **peer(full) | more)

    case("crlf", text("").replace("\n", "\r\n") + "\r", peer=of_pynrrd)
    case("no-blank-after-the-colon", text("").replace(": ", ":"))
    case(
        "upper-case-names",
        text("")
        .replace("sizes", "Sizes")
        .replace("type:", "Type:")
        .replace("encoding", "ENCODING"),
        peer=of_itk,
    )
    case("comments", text("").replace("sizes", "# sizes: 1 2 3\nsizes"))
    case("key-with-escapes", text("note:=first\\nsecond \\\\ third\nkey: with colon:=x\n"))
    case("key-named-as-a-field", text("sizes of things:=1 2 3\ntypes:=a: b\n"))
    case("content-with-a-key", text("content: a:=b\n"))
    case(
        "key-looks-like-sizes",
        text("").replace("dimension", "sizes:=9 9 9\ndimension"),
        peer=by_hand(v),
    )
    case(
        "blank-at-line-ends",
        text("").replace("\n", " \n")[:-1].replace(" \n", "  \n") + "\n",
        peer=of_pynrrd,
    )
    case("signed-long-long-int", text("", kind="signed long long int"), in_file(v.astype(np.int64)))
    case("unsigned-short-int", text("", kind="unsigned short int"), peer=of_pynrrd)
    case("uint16_t", text("", kind="uint16_t"))
    case("8-bit-without-endian", text("", kind="uchar", endian=None), in_file(values(np.uint8)))
    case("signed-8-bit", text("", kind="int8", endian=None), in_file(values(np.int8) - 60))
    case("double-big-endian", text("", kind="double", endian="big"), in_file(v / 8.0, ">"))
    for version in (1, 2, 3):
        geometry = "spacings: 0.5 0.75 2\n"
        expected = {"spacing_mm": [0.5, 0.75, 2.0]}
        case(
            f"version-{version}-spacings", text("", version=version, geometry=geometry), **expected
        )
    case("version-5", text("", version=5))
    case("version-6", text("", version=6), peer=by_hand(v), warns=["version 6"])
    mins = "axis mins: 1 2 3\naxis maxs: 5 12 9\n"
    case(
        "axis-mins-node",
        text("centers: node node node\n", version=1, geometry=mins),
        spacing_mm=[1, 2, 2],
        origin_mm=[1, 2, 3],
    )
    case(
        "axis-mins-cell",
        text(
            "centerings: cell cell cell\n",
            version=2,
            geometry="axismins: 1 2 3\naxismaxs: 6 14 11\n",
        ),
        spacing_mm=[1, 2, 2],
        origin_mm=[1.5, 3, 4],
    )
    unknown = ["centerings"]
    case("axis-mins", text("", geometry="axis mins: 1 2 3\nspacings: 0.5 0.75 2\n"), peer=of_itk, warns=unknown)
    case(
        "axis-mins-some-centerings",
        text("centers: cell node ???\n", geometry="axis mins: 1 2 3\nspacings: 0.5 0.75 2\n"),
        peer=of_itk,
        warns=unknown,
    )
    case(
        "axis-mins-node-spacings",
        text("centers: node node node\n", geometry="axis mins: 1 2 3\nspacings: 0.5 0.75 2\n"),
        peer=of_itk,
        not_warns=unknown,
    )
    case(
        "axis-mins-and-maxs",
        text("", geometry="axis mins: 0 0 0\naxis maxs: 10 12 8\n"),
        peer=by_hand(v),
        spacing_mm=[2, 2, 2],
        origin_mm=[1, 1, 1],
        warns=unknown,
        not_warns=["1 mm"],
    )
    made_up, along_k = ["its voxel spacing; 1 mm is assumed"], ["along k; 1 mm is assumed"]
    case("no-geometry", text("", geometry=""), warns=made_up)
    case("space-alone", text("", geometry="space: LPS\nspace origin: (1,2,3)\n"), warns=[*made_up, "space directions"])
    case("spacing-unknown", text("", geometry="spacings: 0.5 0.75 nan\n"), spacing_mm=[0.5, 0.75, 1], warns=along_k)
    case("spacing-0", text("", geometry="spacings: 0.5 0.75 0\n"), peer=by_hand(v), spacing_mm=[0.5, 0.75, 1], warns=along_k)
    case(
        "thickness-for-spacing",
        text("", geometry="spacings: 0.5 0.75 nan\nthicknesses: nan nan 3\n"),
        peer=by_hand(v),
        spacing_mm=[0.5, 0.75, 3],
        warns=["thickness of 3"],
        not_warns=["1 mm"],
    )
    case("spacing-stated", text(""), not_warns=["1 mm", "no space origin"])
    case(
        "unit-no-length",
        text("", geometry='spacings: 0.5 0.75 2\nunits: "mm" "mm" "parsec"\n'),
        peer=of_itk,
        warns=["parsec"],
    )
    case(
        "space-unit-no-length",
        text('space units: "parsec" "parsec" "parsec"\n'),
        peer=of_itk,
        warns=["parsec"],
    )
    case("no-space-origin", text("").replace("space origin: (-3,4,5)\n", ""), peer=of_itk, warns=["no space origin"])
    case(
        "units-micron",
        text("", version=2, geometry='spacings: 500 750 2000\nunits: "um" "um" "um"\n'),
        spacing_mm=[0.5, 0.75, 2.0],
    )
    case(
        "units-with-blanks",
        text("", geometry='spacings: 5 7.5 20\nunits: "mm" "mm" "mm"\nlabels: "a b" "c" "d e f"\n'),
        spacing_mm=[5, 7.5, 20],
    )
    case("spacing-nan", text("", geometry="spacings: nan 0.75 2\n"), spacing_mm=[1, 0.75, 2])
    case(
        "sample-units",
        text('sample units: "mm per second"\nold min: 0\nold max: 9\nmin: 3\nmax: 8\n'),
        peer=of_pynrrd,
    )
    case("thicknesses", text("thicknesses: nan nan 2.5\n"))
    case(
        "same-field-twice-the-same",
        text("").replace("encoding", "sizes: 5 6 4\nencoding"),
        peer=by_hand(v),
    )
    refusals = [
        (
            "field-twice",
            text("").replace("encoding", "sizes: 6 5 4\nencoding"),
            data,
            ["sizes", "twice"],
        ),
        ("block", text("block size: 2\n", kind="block"), data, ["block"]),
        ("unknown-type", text("", kind="float16"), data, ["float16"]),
        (
            "dimension-and-sizes",
            text("").replace("dimension: 3", "dimension: 4"),
            data,
            ["dimension", "4", "3"],
        ),
        ("size-zero", text("").replace("sizes: 5", "sizes: 0"), data, ["sizes"]),
        ("no-type", text("").replace("type: ushort\n", ""), data, ["type"]),
        ("no-encoding", text("").replace("encoding: raw\n", ""), data, ["encoding"]),
        ("endian-middle", text("", endian="middle"), data, ["middle"]),
        ("origin-nan", text("").replace("(-3,4,5)", "(nan,4,5)"), data, ["space origin (nan,4,5)"]),
        ("singular-directions", text("").replace("(0,0.75,0)", "(0.5,0,0)"), data, ["singular"]),
        ("directions-too-few", text("").replace(" (0,0,2)", ""), data, ["space directions"]),
        ("no-empty-line", text("")[:-1], b"", ["truncated"]),
    ]
    for name, header, body, fragments in refusals:
        cases.write(f"nrrd/{name}.nrrd", header, "\n" if body else "", body)
        cases.add(FIELDS, name, f"nrrd/{name}.nrrd", "NRRD format", error=fragments)


def by_hand(v, peer="NRRD format"):
    return lambda path: {"peer": peer, "size": list(v.shape), "values": some_values(v)}


def make_kinds(cases):
    size = list(SIZE)

    def case(name, header, body, **expected):
        path = f"nrrd/{name}.nrrd"
        cases.write(path, header, "\n", body)
        cases.add(FIELDS, name, path, **{"peer": "NRRD format, kinds"} | expected)

    directions = (
        "space: LPS\nspace directions: none (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)\n"
    )
    rgb = (np.indices((3, *SIZE)).sum(axis=0) * 9).astype(np.uint8)
    colors = [[i, j, k, rgb[:, i, j, k].tolist()] for i, j, k in [(0, 0, 0), (4, 5, 3), (2, 1, 1)]]
    kinds = "kinds: RGB-color domain domain domain\n"
    case(
        "rgb",
        text(kinds, (3, *SIZE), "uchar", endian=None, geometry=directions),
        in_file(rgb),
        size=size,
        components=3,
        colors=colors,
    )
    planar = directions.replace("none (1,0,0) (0,1,0) (0,0,1)", "(1,0,0) (0,1,0) (0,0,1) none")
    case(
        "rgb-last",
        text(
            "kinds: domain domain domain RGB-color\n",
            (*SIZE, 3),
            "uchar",
            endian=None,
            geometry=planar,
        ),
        in_file(np.moveaxis(rgb, 0, -1)),
        size=size,
        components=3,
        colors=colors,
    )
    nan = directions.replace("none", "(nan,nan,nan)")
    case(
        "rgb-nan-direction",
        text(kinds, (3, *SIZE), "uchar", endian=None, geometry=nan),
        in_file(rgb),
        size=size,
        components=3,
        colors=colors,
    )
    two = np.stack([values(np.float32), values(np.float32) * 2])
    complex_header = text(
        "kinds: complex space space space\n", (2, *SIZE), "float", geometry=directions
    )
    case("complex", complex_header, in_file(two), size=size, components=2, warns=["complex"])
    cases.add(
        FIELDS,
        "complex-channel-2",
        "nrrd/complex.nrrd",
        "NRRD format, kinds",
        size=size,
        options={"channel": 2},
        values=some_values(two[1]),
    )
    for kind, n in (
        ("3D-symmetric-matrix", 6),
        ("3D-masked-symmetric-matrix", 7),
        ("3D-matrix", 9),
        ("2D-matrix", 4),
    ):
        many = np.stack([values(np.float32) + c for c in range(n)])
        header = text(
            f"kinds: {kind} space space space\n", (n, *SIZE), "float", geometry=directions
        )
        case(kind.lower(), header, in_file(many), error=[kind])
        cases.add(
            FIELDS,
            f"{kind.lower()}-channel-3",
            f"nrrd/{kind.lower()}.nrrd",
            "NRRD format, kinds",
            size=size,
            options={"channel": 3},
            values=some_values(many[2]),
        )
    hsv = text(
        "kinds: HSV-color domain domain domain\n",
        (3, *SIZE),
        "uchar",
        endian=None,
        geometry=directions,
    )
    case("hsv", hsv, in_file(rgb), error=["HSV-color"])
    times = np.stack([values() + 1000 * t for t in range(3)], axis=-1)
    four = "space: LPST\nspace directions: (1,0,0,0) (0,1,0,0) (0,0,2,0) (0,0,0,5)\nspace origin: (1,2,3,0)\n"
    case(
        "time-in-space",
        text("", (*SIZE, 3), geometry=four),
        in_file(times),
        size=size,
        time_points=3,
        spacing_mm=[1, 1, 2],
        origin_mm=[1, 2, 3],
        options={"time": 2},
        values=some_values(times[..., 1]),
    )
    listed = directions.replace("none (1,0,0) (0,1,0) (0,0,1)", "(1,0,0) (0,1,0) (0,0,1) none")
    five = np.stack([values() + 1000 * t for t in range(5)], axis=-1)
    case(
        "list-of-five",
        text("kinds: domain domain domain list\n", (*SIZE, 5), geometry=listed),
        in_file(five),
        size=size,
        time_points=5,
        options={"time": 5},
        values=some_values(five[..., 4]),
    )
    first = np.moveaxis(five, -1, 0)
    case(
        "time-first",
        text("kinds: time domain domain domain\n", (5, *SIZE), geometry=directions),
        in_file(first),
        size=size,
        time_points=5,
        options={"time": 4},
        values=some_values(five[..., 3]),
    )


def make_spaces(cases):
    v = values()

    def case(name, geometry, peer=of_pynrrd, sizes=SIZE, body=None, **more):
        path = f"nrrd/{name}.nrrd"
        full = cases.write(
            path,
            text("", sizes=sizes, geometry=geometry),
            "\n",
            in_file(v) if body is None else body,
        )
        cases.add(FIELDS, name, path, **peer(full) | more)

    oblique = "space directions: (0.4,0.3,0) (-0.45,0.6,0) (0,0,2)\nspace origin: (-3,4,5)\n"
    for space in ("left-posterior-superior", "RAS", "LAS", "right-anterior-superior"):
        case(f"space-{space.lower()}", f"space: {space}\n{oblique}")
    case("space-scanner-xyz", f"space: scanner-xyz\n{oblique}", warns=["scanner-xyz"])
    case("space-3d-right-handed", f"space: 3D-right-handed\n{oblique}", warns=["3d-right-handed"])
    case("space-3d-left-handed", f"space: 3D-left-handed\n{oblique}", warns=["3d-left-handed"])
    case("space-dimension", f"space dimension: 3\n{oblique}", warns=["no orientation"])
    case(
        "left-handed-axes",
        "space: LPS\nspace directions: (1,0,0) (0,1,0) (0,0,-2)\nspace origin: (1,2,3)\n",
    )
    case(
        "permuted-axes",
        "space: LPS\nspace directions: (0,0,2) (1,0,0) (0,1.5,0)\nspace origin: (1,2,3)\n",
    )
    case(
        "vectors-with-blanks",
        "space: LPS\nspace directions: ( 1 , 0, 0 ) (0, 1 ,0)   (0,0, 2)\nspace origin: ( 1, 2 ,3)\n",
        peer=of_itk,
    )
    case(
        "exponents",
        "space: LPS\nspace directions: (5e-1,0,0) (0,7.5E-01,0) (0,0,+2.0)\nspace origin: (-3.0e0,4,5)\n",
    )
    units = 'space: LPS\nspace units: "um" "um" "um"\nspace directions: (500,0,0) (0,750,0) (0,0,2000)\nspace origin: (1000,0,0)\n'
    case("space-units-micron", units, spacing_mm=[0.5, 0.75, 2], origin_mm=[1, 0, 0])
    case(
        "two-axes",
        "space dimension: 2\nspace directions: (0.5,0) (0,0.75)\nspace origin: (1,2)\n",
        peer=by_hand(v[:, :, :1]),
        sizes=SIZE[:2],
        body=in_file(v[:, :, 0]),
        spacing_mm=[0.5, 0.75, 1],
        origin_mm=[1, 2, 0],
        warns=["along k; 1 mm is assumed"],
    )
