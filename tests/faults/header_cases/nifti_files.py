"""NIfTI-1, NIfTI-2 and Analyze 7.5 with unusual headers, read by nibabel."""

import gzip
import io
import struct

import nibabel
import numpy as np

from .base import SIZE, of_nibabel, some_values, values

KIND = "analyze and nifti"
AFFINE = np.array([[0.5, 0, 0, -3], [0, 0.75, 0, 4], [0, 0, 2, 5], [0, 0, 0, 1]], float)
OBLIQUE = np.array([[0.4, -0.45, 0, -3], [0.3, 0.6, 0, 4], [0, 0, 2, 5], [0, 0, 0, 1]], float)


def nifti(array, affine=AFFINE, kind=nibabel.Nifti1Image, sform=1, qform=1, dtype=None, **fields):
    """The bytes of an image; `fields` are set in its header."""
    image = kind(array, affine, dtype=dtype or array.dtype)
    if hasattr(image.header, "set_sform"):
        image.header.set_sform(affine, sform)
        image.header.set_qform(affine, qform)
    for name, value in fields.items():
        image.header[name] = value
    return (
        image.to_bytes()
        if hasattr(image, "to_bytes") and kind in (nibabel.Nifti1Image, nibabel.Nifti2Image)
        else image
    )


def patched(data, *changes):
    """Bytes with some replaced: (offset, struct format, values...)."""
    data = bytearray(data)
    for at, form, *new in changes:
        struct.pack_into(form, data, at, *new)
    return bytes(data)


def parts(image):
    """The bytes of a pair: header and image."""
    files = image.make_file_map()
    for holder in files.values():
        holder.fileobj, holder.filename = io.BytesIO(), None
    files.pop("mat", None)
    nibabel.AnalyzeImage.to_file_map(image, files)
    return files["header"].fileobj.getvalue(), files["image"].fileobj.getvalue()


def make(cases):
    make_nifti(cases)
    make_types(cases)
    make_times(cases)
    make_analyze(cases)
    make_refusals(cases)


def make_nifti(cases):
    v = values(np.int16)

    def case(name, data, ending=".nii", peer=of_nibabel, **more):
        path = f"nifti/{name}{ending}"
        full = cases.write(path, data)
        cases.add(KIND, name, path, **peer(full) | more)

    def right(affine):
        moved = np.diag([-1.0, -1, 1, 1]) @ affine
        lengths = np.linalg.norm(moved[:3, :3], axis=0)
        expected = {"peer": "nifti1.h", "size": list(SIZE), "values": some_values(v)}
        expected |= {"spacing_mm": lengths.tolist(), "origin_mm": moved[:3, 3].tolist()}
        return lambda path: expected | {"direction": (moved[:3, :3] / lengths).tolist()}

    plain = nifti(v)
    case("plain", plain)
    case("nifti-2", nifti(v, OBLIQUE, nibabel.Nifti2Image))
    case("qform-only", nifti(v, OBLIQUE, sform=0))
    case("sform-only", nifti(v, OBLIQUE, qform=0))
    case(
        "neither",
        patched(plain, (252, "<2h", 0, 0)),
        peer=right(np.diag([0.5, 0.75, 2, 1])),
        warns=["no orientation"],
    )
    flat = patched(nifti(v[:, :, :1]), (40, "<h", 2), (88, "<f", 0), (252, "<2h", 0, 0))
    expected = {"peer": "nifti1.h", "size": [5, 6, 1], "spacing_mm": [0.5, 0.75, 1]}
    thickness = ["along k; 1 mm is assumed"]
    case("picture-without-thickness", flat, peer=lambda path: expected, warns=thickness)
    thick = patched(flat, (88, "<f", 3))
    case("picture-with-thickness", thick, peer=lambda path: expected | {"spacing_mm": [0.5, 0.75, 3]}, not_warns=["1 mm"])
    sheared = OBLIQUE.copy()
    sheared[0, 2] = 0.5
    case("sheared-sform", nifti(v, sheared, qform=0))
    case("left-handed", nifti(v, np.diag([-0.5, 0.75, 2, 1])))
    case("qfac-minus-1", nifti(v, np.diag([-0.5, 0.75, 2, 1]), sform=0))
    other = nibabel.Nifti1Image(v, AFFINE)
    other.header.set_sform(AFFINE, 2)
    other.header.set_qform(OBLIQUE, 1)
    case("sform-and-qform-differ", other.to_bytes(), warns=["sform and qform"])
    case("sform-and-qform-agree", plain, not_warns=["qform"])
    near = nibabel.Nifti1Image(v, AFFINE)
    moved = AFFINE.copy()
    moved[:3, 3] += 0.05
    near.header.set_sform(AFFINE, 2)
    near.header.set_qform(moved, 1)
    case("sform-and-qform-nearly-agree", near.to_bytes(), not_warns=["qform"])
    case(
        "sform-pixdim-zero",
        patched(plain, (80, "<3f", 0, 0, 0), (252, "<h", 0)),
        peer=right(AFFINE),
        not_warns=["spacing along axis"],
    )
    case(
        "qform-pixdim-negative",
        patched(nifti(v, AFFINE, sform=0), (84, "<f", -0.75)),
        peer=right(AFFINE),
    )
    nan = nifti(v, np.diag([1, 0.75, 2, 1.0]), sform=0)
    case(
        "qform-pixdim-nan",
        patched(nan, (80, "<f", float("nan"))),
        peer=right(np.diag([1, 0.75, 2, 1.0])),
        warns=["spacing along axis 1"],
    )
    case(
        "pixdim-zero-no-form",
        patched(plain, (252, "<2h", 0, 0), (80, "<3f", 0, 0, 0)),
        peer=right(np.eye(4)),
        warns=["1 mm"],
    )
    case(
        "singular-sform",
        patched(plain, (280, "<12f", *[0] * 12)),
        peer=right(AFFINE),
        warns=["singular"],
    )
    case(
        "non-unit-quaternion",
        patched(nifti(v, AFFINE, sform=0), (256, "<3f", 0, 0, 1.2)),
        peer=right(np.array([[-0.5, 0, 0, -3], [0, -0.75, 0, 4], [0, 0, 2, 5], [0, 0, 0, 1.0]])),
        warns=["quaternion"],
    )
    case(
        "micrometres",
        patched(nifti(v, OBLIQUE * [[1000], [1000], [1000], [1]]), (123, "<B", 3)),
        peer=right(OBLIQUE),
    )
    case(
        "metres",
        patched(nifti(v, OBLIQUE / [[1000], [1000], [1000], [1]]), (123, "<B", 1)),
        peer=right(OBLIQUE),
    )
    extended = nibabel.Nifti1Image(v, AFFINE)
    extended.header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", b"a comment" * 9))
    case("extension", extended.to_bytes())
    case("extension-damaged-size", patched(extended.to_bytes(), (352, "<i", 7)), peer=right(AFFINE))
    case("vox-offset-0", patched(plain, (108, "<f", 0)), peer=right(AFFINE))
    case(
        "vox-offset-too-low", patched(plain, (108, "<f", 40)), peer=right(AFFINE), warns=["byte 40"]
    )
    later = patched(plain[:352], (108, "<f", 400)) + bytes(48) + plain[352:]
    case("vox-offset-400", later)
    case("vox-offset-not-16", patched(plain[:352], (108, "<f", 357)) + bytes(5) + plain[352:])
    case("header-size-0", patched(plain, (0, "<i", 0)), warns=["header size"])
    big = nibabel.Nifti1Header(endianness=">")
    big.set_data_dtype(np.int16)
    swapped = nibabel.Nifti1Image(v, AFFINE, big)
    case("big-endian", swapped.to_bytes())
    case("gz-without-gzip", plain, ".nii.gz", peer=right(AFFINE))
    case("gzip-without-gz", gzip.compress(plain, mtime=0), peer=right(AFFINE))
    case("gzip", gzip.compress(plain, mtime=0), ".nii.gz")
    case("no-ending-for-nifti", plain, ".image", peer=right(AFFINE))
    trailing = plain + b"more"
    case("trailing-bytes", trailing)
    label = np.minimum(v, 3).astype(np.int16)
    full = nifti(label, AFFINE, intent_code=1002)
    case("labels", full, ".nii")
    case("dim-4-is-0", patched(plain, (40, "<h", 4), (48, "<h", 0)), peer=right(AFFINE))
    case(
        "two-axes",
        patched(nifti(v[:, :, :1], AFFINE), (40, "<h", 2), (88, "<f", 0)),
        peer=lambda p: {"peer": "nifti1.h", "size": [5, 6, 1], "values": some_values(v[:, :, :1])},
        not_warns=["spacing along axis 3"],
    )
    pair = nibabel.Nifti1Pair(v, AFFINE)
    for data, ending in zip(parts(pair), (".hdr", ".img")):
        cases.write(f"nifti/pair{ending}", data)
    for ending in (".hdr", ".img"):
        cases.add(
            KIND,
            f"pair{ending}",
            f"nifti/pair{ending}",
            **of_nibabel(cases.path(f"nifti/pair{ending}")),
        )


def make_types(cases):
    for dtype in ("u1", "i1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"):
        v = values(np.dtype(dtype))
        path = f"nifti/type-{dtype}.nii"
        full = cases.write(path, nifti(v, dtype=np.dtype(dtype)))
        cases.add(KIND, f"type-{dtype}", path, **of_nibabel(full))
    v = values(np.int16)

    def case(name, data, **expected):
        path = f"nifti/{name}.nii"
        cases.write(path, data)
        cases.add(KIND, name, path, **{"peer": "nifti1.h", "size": list(SIZE)} | expected)

    scaled = patched(nifti(v), (112, "<2f", 0.5, -10))
    case("scaled", scaled, values=some_values(v * 0.5 - 10))
    case("slope-0", patched(scaled, (112, "<2f", 0, -10)), values=some_values(v))
    case(
        "slope-0-intercept-nan",
        patched(scaled, (112, "<2f", 0, float("nan"))),
        values=some_values(v),
        not_warns=["finite"],
    )
    case(
        "slope-nan",
        patched(scaled, (112, "<2f", float("nan"), 0)),
        values=some_values(v),
        warns=["finite"],
    )
    case(
        "bitpix-8-for-int16",
        patched(nifti(v), (72, "<h", 8)),
        values=some_values(v),
        warns=["8 bits"],
    )
    bits = (values() % 3 == 0).astype(np.uint8)
    head = nifti(np.zeros(SIZE, np.uint8))[:352]
    packed = np.packbits(bits.ravel(order="F"), bitorder="little").tobytes()
    case(
        "one-bit",
        patched(head, (70, "<2h", 1, 1)) + packed,
        values=some_values(bits),
        warns=["bit"],
    )
    rgb = np.zeros(SIZE, [("R", "u1"), ("G", "u1"), ("B", "u1")])
    rgb["R"], rgb["G"], rgb["B"] = values(np.uint8), values(np.uint8) + 50, 9
    colors = [
        [i, j, k, [int(c) for c in rgb[i, j, k]]] for i, j, k in ((0, 0, 0), (4, 5, 3), (2, 1, 1))
    ]
    case("rgb24", nifti(rgb), components=3, colors=colors)
    rgba = np.zeros(SIZE, [("R", "u1"), ("G", "u1"), ("B", "u1"), ("A", "u1")])
    rgba["R"], rgba["G"], rgba["B"], rgba["A"] = values(np.uint8), 20, 30, 255
    colors = [
        [i, j, k, [int(c) for c in rgba[i, j, k]][:3]]
        for i, j, k in ((0, 0, 0), (4, 5, 3), (2, 1, 1))
    ]
    case("rgba32", nifti(rgba), components=4, colors=colors)
    for dtype, word in ((np.complex64, "complex"), (np.complex128, "complex")):
        name = np.dtype(dtype).name
        path = f"nifti/{name}.nii"
        cases.write(path, nifti(v.astype(dtype)))
        cases.add(KIND, name, path, "nifti1.h", error=[word])
    for code, word in ((1536, "128-bit"), (2048, "complex"), (77, "77"), (0, "type 0")):
        path = f"nifti/type-code-{code}.nii"
        cases.write(path, patched(nifti(v), (70, "<h", code)))
        cases.add(KIND, f"type-code-{code}", path, "nifti1.h", error=[word])


def make_times(cases):
    four = np.stack([values(np.int16) + 1000 * t for t in range(3)], axis=-1)

    def case(name, array, fields=(), **expected):
        path = f"nifti/{name}.nii"
        cases.write(path, patched(nifti(array), *fields))
        cases.add(KIND, name, path, **{"peer": "nibabel", "size": list(SIZE)} | expected)

    case("times", four, time_points=3, values=some_values(four[..., 0]), warns=["3 volumes"])
    case("time-3", four, time_points=3, options={"time": 3}, values=some_values(four[..., 2]))
    five = np.stack([four, four + 20000], axis=-1).astype(np.int16)
    intent = [(68, "<h", 1007)]
    vector = np.stack([values(np.float32) * (c + 1) for c in range(3)], axis=-1)[:, :, :, None, :]
    case(
        "vector",
        vector,
        intent,
        components=3,
        options={"channel": 2},
        values=some_values(vector[:, :, :, 0, 1]),
    )
    case(
        "time-and-component",
        five,
        components=2,
        time_points=3,
        options={"time": 2, "channel": 2},
        values=some_values(five[:, :, :, 1, 1]),
    )
    case(
        "time-and-component-1",
        five,
        time_points=3,
        options={"time": 3, "channel": 1},
        values=some_values(five[:, :, :, 2, 0]),
    )
    time = np.stack([four[..., t] for t in range(3)], axis=-1).reshape(*SIZE, 1, 1, 3)
    case("sixth-axis", time, time_points=3, options={"time": 2}, values=some_values(four[..., 1]))


def make_analyze(cases):
    v = values(np.int16)

    def case(
        name,
        *changes,
        kind=nibabel.AnalyzeImage,
        matrix=False,
        order="<",
        peer=None,
        endings=(".hdr", ".img"),
        array=v,
        **more,
    ):
        header = kind.header_class(endianness=order)
        header.set_data_dtype(array.dtype)
        image = kind(array, np.diag([0.5, 0.75, 2, 1.0]), header)
        head, body = parts(image)
        head = patched(head, *[(a, order + f, *w) for a, f, *w in changes])
        for data, ending in zip((head, body), endings):
            cases.write(
                f"analyze/{name}{ending}",
                gzip.compress(data, mtime=0) if ending.endswith(".gz") else data,
            )
        path = f"analyze/{name}{endings[0]}"
        full = cases.path(path)
        expected = (
            {"peer": "nibabel"}
            if peer == ()
            else {
                k: x
                for k, x in of_nibabel(full).items()
                if k in (peer or ("size", "values", "spacing_mm", "direction", "peer"))
            }
        )
        if matrix:
            # nibabel would read it with scipy.
            cases.write(f"analyze/{name}.mat", b"MATLAB 5.0 MAT-file")
        cases.add(KIND, f"analyze-{name}", path, **expected | more)

    everything = ("size", "values", "spacing_mm", "direction", "peer", "origin_mm")
    case("plain", peer=everything, warns=["left and right", "no position"])
    case("big-endian", order=">")
    case("origin", (253, "3h", 3, 2, 4), peer=everything, not_warns=["no position"])
    case("origin-big-endian", (253, "3h", 3, 2, 4), order=">", peer=everything)
    case("origin-outside", (253, "3h", -2, 9, 7), peer=everything)
    case("origin-absurd", (253, "3h", 3000, 2, 4), peer=everything)
    case("slope", (112, "f", 0.25), warns=["slope 0.25"])
    case("slope-and-intercept", (112, "2f", 0.25, -3), warns=["intercept -3"])
    case("slope-intercept-nan", (112, "2f", 0.25, float("nan")))
    case("slope-1", (112, "f", 1), not_warns=["slope"])
    case("calibrated", (140, "2i", 400, 0), (124, "2f", 200, 0), warns=["slope 0.5"])
    case("minimum-in-the-magic", (340, "2i", 7, 3))
    case("vox-offset", (108, "f", 0))
    case("pixdim-0", (88, "f", 0), warns=["axis 3"], spacing_mm=[0.5, 0.75, 1])
    case(
        "matrix-beside",
        matrix=True,
        warns=["plain.mat".replace("plain", "matrix-beside")],
        values=some_values(v),
    )
    case("gz", endings=(".hdr.gz", ".img.gz"))
    case("img-gz", endings=(".hdr", ".img.gz"), peer=(), size=list(SIZE), values=some_values(v))
    case("spm99", kind=nibabel.Spm99AnalyzeImage, peer=everything)
    case("spm2", kind=nibabel.Spm2AnalyzeImage, peer=everything)
    case("uint8", array=values(np.uint8))
    case("double", array=values(np.float64))


def make_refusals(cases):
    v = values(np.int16)
    plain = nifti(v)
    for name, data, ending, fragments in [
        ("dim-0", patched(plain, (40, "<h", 0)), ".nii", ["0 dimensions"]),
        ("dim-8", patched(plain, (40, "<h", 8)), ".nii", ["8 dimensions"]),
        ("dim-negative", patched(plain, (44, "<h", -6)), ".nii", ["-6", "axis 2"]),
        ("dim-huge", patched(plain, (42, "<3h", 32000, 32000, 32000)), ".nii", ["truncated"]),
        ("truncated", plain[:-40], ".nii", ["truncated"]),
        ("truncated-gzip", gzip.compress(plain, mtime=0)[:-40], ".nii.gz", ["truncated"]),
        ("truncated-header", plain[:300], ".nii", ["truncated"]),
        ("magic", patched(plain, (344, "<4s", b"abcd")), ".nii", ["magic", "abcd"]),
        ("pair-as-single", patched(plain, (344, "<4s", b"ni1\0")), ".nii", [".hdr"]),
    ]:
        cases.write(f"nifti/{name}{ending}", data)
        cases.add(KIND, name, f"nifti/{name}{ending}", "nibabel refuses it, too", error=fragments)
    head = patched(plain[:348], (344, "<4s", b"ni1\0"))
    cases.write("nifti/alone.hdr", head)
    cases.add(
        KIND,
        "header-without-image",
        "nifti/alone.hdr",
        "nibabel refuses it, too",
        error=["alone.img"],
    )
