"""Compressed and packed pixels: colours under a wrong label, bits in unusual places."""

import numpy as np
import imagecodecs
from pydicom.encaps import encapsulate
from pydicom.pixels import convert_color_space

from .base import encoded, expected_of, image, opened, pattern
from .encoding import UNDEFINED, Style, bare, file_of, header

BASELINE, EXTENDED = "1.2.840.10008.1.2.4.50", "1.2.840.10008.1.2.4.51"
LOSSLESS, LOSSLESS_1 = "1.2.840.10008.1.2.4.57", "1.2.840.10008.1.2.4.70"
JPEG_LS, JPEG_LS_NEAR = "1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.81"
JPEG_2000, JPEG_2000_LOSSY = "1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91"
RLE = "1.2.840.10008.1.2.5"
PLANE = {"ImagePositionPatient": [0, 0, 0], "Modality": "US", "SOPClassUID": "1.2.840.10008.5.1.4.1.1.6.1"}


def blocks():
    """Colours in blocks of eight pixels, which baseline JPEG keeps nearly unchanged."""
    out = np.zeros((16, 16, 3), np.uint8)
    out[:8, :8], out[:8, 8:] = (200, 30, 40), (20, 180, 60)
    out[8:, :8], out[8:, 8:] = (40, 50, 220), (128, 128, 128)
    return out


def packed(ds, syntax, stream, **attributes):
    """A data set whose pixels are a compressed stream."""
    for name, value in attributes.items():
        setattr(ds, name, value)
    ds.file_meta.TransferSyntaxUID = syntax
    ds.PixelData = encapsulate([stream])
    ds["PixelData"].VR = "OB"
    ds["PixelData"].is_undefined_length = True
    return ds


def colour(syntax, stream, photometric, pixels=None, **attributes):
    ds = image(0, pixels=blocks() if pixels is None else pixels, **PLANE)
    return packed(ds, syntax, stream, PhotometricInterpretation=photometric, **attributes)


def with_marker(stream, transform=None, jfif=False):
    """A JPEG stream with or without the markers that name its colour space."""
    out, at = stream[:2], 2
    if jfif:
        out += b"\xff\xe0\0\x10JFIF\0\1\1\0\0\1\0\1\0\0"
    if transform is not None:
        out += b"\xff\xee\0\x0eAdobe\0\x64\0\0\0\0" + bytes([transform])
    while stream[at + 1] in (0xE0, 0xEE):
        at += 2 + int.from_bytes(stream[at + 2 : at + 4], "big")
    return out + stream[at:]


def colours(cases):
    """Baseline JPEG: what the label says, and what the stream is."""
    rgb = blocks()
    encode = lambda space, sub="444": imagecodecs.jpeg8_encode(
        rgb, level=98, colorspace="rgb", outcolorspace=space, subsampling=sub)
    ycc, plain = encode("ycbcr"), encode("rgb")
    ycc422 = encode("ycbcr", "422")
    # Within the blocks: decoders differ in how they spread subsampled chroma over an edge.
    inside = ((3, 3), (12, 3), (3, 12), (12, 12))
    right = {"size": [16, 16, 1], "colors": [[i, j, 0, [float(v) for v in rgb[j, i]]] for i, j in inside]}

    def case(name, stream, photometric, peer, syntax=BASELINE):
        ds = colour(syntax, stream, photometric)
        cases.one(name, ds, right, agrees(ds, right, peer), tolerance=6)

    jfif = "JFIF: the stream is YCbCr"
    adobe = "Adobe marker of the stream"
    case("jfif-labelled-rgb", with_marker(ycc, jfif=True), "RGB", jfif)
    case("jfif-labelled-ybr-full", with_marker(ycc, jfif=True), "YBR_FULL", "PS3.3 C.7.6.3.1.2")
    case("jfif-labelled-ybr-full-422", with_marker(ycc, jfif=True), "YBR_FULL_422", "PS3.3 C.7.6.3.1.2")
    case("jfif-422", with_marker(ycc422, jfif=True), "YBR_FULL_422", "PS3.3 C.7.6.3.1.2")
    case("jfif-422-labelled-rgb", with_marker(ycc422, jfif=True), "RGB", jfif)
    case("adobe-ycc-labelled-rgb", with_marker(ycc, transform=1), "RGB", adobe)
    case("adobe-rgb-labelled-ybr", with_marker(plain, transform=0), "YBR_FULL_422", adobe)
    case("adobe-rgb-labelled-rgb", with_marker(plain, transform=0), "RGB", adobe)
    case("unmarked-ycc-labelled-ybr", with_marker(ycc), "YBR_FULL_422", "PS3.3 C.7.6.3.1.2")
    case("unmarked-rgb-labelled-rgb", with_marker(plain), "RGB", "PS3.3 C.7.6.3.1.2")
    case("unmarked-422-labelled-rgb", with_marker(ycc422), "RGB", "chroma is subsampled: YCbCr")
    case("extended-8-bit", with_marker(ycc, jfif=True), "YBR_FULL_422", "PS3.5 8.2.1", EXTENDED)
    grey = imagecodecs.jpeg8_encode(rgb[..., 0].copy(), level=98)
    ds = packed(image(0, pixels=rgb[..., 0].copy()), BASELINE, grey)
    values = {"size": [16, 16, 1], "values": [[3, 3, 0, 200], [12, 3, 0, 20], [3, 12, 0, 40]]}
    cases.one("grey", ds, values, "pydicom", tolerance=3)


def agrees(ds, right, peer):
    """pydicom, if it decodes the same colours."""
    try:
        read = opened(ds if isinstance(ds, bytes) else encoded(ds))
        pixels = read.pixel_array
        pixels = pixels if pixels.ndim == 3 else pixels[0]
        if all(np.abs(pixels[j, i].astype(float) - c).max() <= 6 for i, j, _, c in right["colors"]):
            return "pydicom"
    except Exception:
        pass
    return peer


def other_codecs(cases):
    rgb = blocks()
    right = expected_of(rgb[None].astype(float))
    two = imagecodecs.jpeg2k_encode(rgb, level=0, codecformat="j2k", reversible=True, mct=True)
    two_plain = imagecodecs.jpeg2k_encode(rgb, level=0, codecformat="j2k", reversible=True, mct=False)
    cases.one("jpeg-2000-rct", colour(JPEG_2000, two, "YBR_RCT"), right, "imagecodecs", tolerance=1)
    cases.one("jpeg-2000-rct-labelled-rgb", colour(JPEG_2000, two, "RGB"), right, "imagecodecs", tolerance=1)
    cases.one("jpeg-2000-rgb", colour(JPEG_2000, two_plain, "RGB"), right, "imagecodecs", tolerance=1)
    cases.one("jpeg-2000-rgb-labelled-rct", colour(JPEG_2000, two_plain, "YBR_RCT"), right, "imagecodecs",
              tolerance=1)
    boxed = imagecodecs.jpeg2k_encode(rgb, level=0, codecformat="jp2", reversible=True)
    cases.one("jpeg-2000-boxed", colour(JPEG_2000, boxed, "YBR_RCT"), right, "imagecodecs", tolerance=1)
    signed = pattern(0, dtype=np.int16) - 30
    stream = imagecodecs.jpeg2k_encode(signed, level=0, codecformat="j2k", reversible=True)
    cases.one("jpeg-2000-signed", packed(image(0, pixels=signed), JPEG_2000, stream),
              expected_of(signed[None].astype(float)), "imagecodecs")
    unsigned = pattern(3)
    stream = imagecodecs.jpeg2k_encode(
        unsigned, level=0, codecformat="j2k", reversible=True, bitspersample=12)
    ds = packed(image(3, pixels=unsigned), JPEG_2000, stream, BitsStored=12, HighBit=11)
    cases.one("jpeg-2000-12-bit", ds, expected_of(unsigned[None]), "imagecodecs")
    # Values of two's complement in a stream that calls itself unsigned.
    stream = imagecodecs.jpeg2k_encode(signed.view(np.uint16) & 0xFFFF, level=0, codecformat="j2k",
                                       reversible=True)
    cases.one("jpeg-2000-signed-in-unsigned", packed(image(0, pixels=signed), JPEG_2000, stream),
              expected_of(signed[None].astype(float)), "PS3.5 8.2.4: Pixel Representation")
    for name, pixels in (("12-bit", pattern(3)), ("16-bit", pattern(3) * 37)):
        stream = imagecodecs.ljpeg_encode(pixels, bitspersample=12 if name == "12-bit" else 16)
        ds = packed(image(3, pixels=pixels), LOSSLESS_1, stream)
        if name == "12-bit":
            ds.BitsStored, ds.HighBit = 12, 11
        cases.one(f"jpeg-lossless-{name}", ds, expected_of(pixels[None]), "imagecodecs")
    stream = imagecodecs.ljpeg_encode(signed.view(np.uint16), bitspersample=16)
    cases.one("jpeg-lossless-signed", packed(image(0, pixels=signed), LOSSLESS, stream),
              expected_of(signed[None].astype(float)), "PS3.5 8.2.1")
    stream = imagecodecs.jpegls_encode(pattern(3))
    either = [expected_of(pattern(3)[None]), {"error": ["JPEG-LS"]}]
    cases.one("jpeg-ls", packed(image(3), JPEG_LS, stream), {"either": either},
              "imagecodecs; refused by a build without it")


def run_length(cases):
    """RLE: bytes of a value apart, planes of colours apart."""
    def case(name, ds, voxels, photometric=None, tolerance=None, peer="pydicom"):
        ds.compress(RLE, generate_instance_uid=False)
        ds.SOPInstanceUID = ds.file_meta.MediaStorageSOPInstanceUID
        if photometric:
            ds.PhotometricInterpretation = photometric
        cases.one(name, ds, expected_of(voxels), peer, tolerance=tolerance)

    case("rle-16-bit", image(3), pattern(3)[None])
    signed = pattern(0, dtype=np.int16) - 30
    case("rle-signed", image(0, pixels=signed), signed[None])
    wide = pattern(3, dtype=np.uint32) * 100003
    cases.one("rle-32-bit", packed(image(3, pixels=wide), RLE, literal_runs(wide)),
              expected_of(wide[None].astype(float)), "PS3.5 G")
    frames = np.stack([pattern(k) for k in range(3)])
    case("rle-frames", image(0, pixels=frames, SpacingBetweenSlices="2.5"), frames)
    rgb = blocks()
    case("rle-rgb", image(0, pixels=rgb, **PLANE), rgb[None].astype(float))
    ybr = convert_color_space(rgb, "RGB", "YBR_FULL")
    case("rle-ybr-full", image(0, pixels=ybr, **PLANE), rgb[None].astype(float), "YBR_FULL", 2)


def literal_runs(pixels):
    """An RLE frame without repetitions: a segment for each byte of a value, the highest first."""
    size = pixels.dtype.itemsize
    planes = pixels.view(np.uint8).reshape(-1, size).T[::-1]
    segments = []
    for plane in planes:
        data = plane.tobytes()
        runs = [data[n : n + 128] for n in range(0, len(data), 128)]
        segment = b"".join(bytes([len(run) - 1]) + run for run in runs)
        segments.append(segment + b"\x80" * (len(segment) % 2))
    offsets = np.zeros(16, "<u4")
    offsets[0] = size
    offsets[1 : size + 1] = 64 + np.cumsum([0] + [len(s) for s in segments[:-1]])
    return offsets.tobytes() + b"".join(segments)


def planes(cases):
    """Uncompressed colours."""
    rgb = blocks()
    right = rgb[None].astype(float)
    apart = image(0, pixels=rgb, **PLANE)
    apart.PlanarConfiguration = 1
    apart.PixelData = rgb.transpose(2, 0, 1).tobytes()
    cases.one("planes-apart", apart, expected_of(right), "pydicom")
    ybr = convert_color_space(rgb, "RGB", "YBR_FULL")
    ds = image(0, pixels=ybr, **PLANE)
    ds.PhotometricInterpretation = "YBR_FULL"
    cases.one("ybr-full", ds, expected_of(right), "pydicom", tolerance=2)
    ds = image(0, pixels=ybr, **PLANE)
    ds.PhotometricInterpretation, ds.PlanarConfiguration = "YBR_FULL", 1
    ds.PixelData = ybr.transpose(2, 0, 1).tobytes()
    cases.one("ybr-full-planes-apart", ds, expected_of(right), "pydicom", tolerance=2)
    # Two pixels share their chroma: Y Y Cb Cr.
    half = np.concatenate([ybr[:, 0::2, :1], ybr[:, 1::2, :1], ybr[:, 0::2, 1:]], axis=-1)
    ds = image(0, pixels=ybr, **PLANE)
    ds.PhotometricInterpretation, ds.PixelData = "YBR_FULL_422", half.tobytes()
    cases.one("ybr-full-422", ds, expected_of(right), agrees(ds, expected_of(right), "PS3.3 C.7.6.3.1.2"),
              tolerance=2)
    frames = np.stack([rgb, rgb[::-1]])
    ds = image(0, pixels=frames, **PLANE, SpacingBetweenSlices="2")
    ds.PlanarConfiguration = 1
    ds.PixelData = frames.transpose(0, 3, 1, 2).tobytes()
    cases.one("planes-apart-frames", ds, expected_of(frames.astype(float)), "pydicom")
    wide = rgb.astype(np.uint16) * 257
    ds = image(0, pixels=wide, **PLANE)
    cases.one("rgb-16-bit", ds, {"either": [expected_of(right), {"error": ["16 bit"]}]},
              "the upper byte, or refused", tolerance=1)
    missing = image(0, pixels=rgb, **PLANE)
    del missing.PlanarConfiguration
    cases.one("no-planar-configuration", missing, expected_of(right), "PS3.3 C.7.6.3.1.3: 0")


def bits(cases):
    """Values that do not fill their words."""
    def case(name, words, voxels, stored, high, signed=0, peer="PS3.5 8.1.1", overlay=()):
        ds = image(0, pixels=words, BitsStored=stored, HighBit=high, PixelRepresentation=signed)
        for element in overlay:
            ds.add_new(*element)
        cases.one(name, ds, expected_of(voxels[None].astype(float)), peer)

    values = pattern(3)
    case("12-bit", values, values, 12, 11)
    case("12-bit-high-15", values << 4, values, 12, 15)
    case("10-bit-high-11", values << 2, values, 10, 11)
    case("12-bit-high-15-with-noise", values << 4 | 5, values, 12, 15)
    overlay = [(0x60000010, "US", 5), (0x60000011, "US", 6), (0x60000040, "CS", "G"),
               (0x60000050, "SS", [1, 1]), (0x60000100, "US", 16), (0x60000102, "US", 13)]
    case("12-bit-overlay-above", values | 0xA000, values, 12, 11, overlay=overlay)
    signed = pattern(3, dtype=np.int16) - 330
    words = signed.view(np.uint16) & 0xFFF
    case("12-bit-signed", words, signed, 12, 11, 1)
    case("12-bit-signed-extended", signed.view(np.uint16), signed, 12, 11, 1)
    case("12-bit-signed-high-15", signed.view(np.uint16) << 4, signed, 12, 15, 1)
    case("12-bit-signed-overlay-above", words | 0x5000, signed, 12, 11, 1)
    case("13-bit-signed", signed.view(np.uint16) & 0x1FFF, signed, 13, 12, 1)
    small = pattern(0, dtype=np.uint8)
    case("6-bit-in-8", small | 0x80, small, 6, 5)
    case("8-bit-in-16", small.astype(np.uint16) | 0x700, small, 8, 7)
    case("8-bit-signed", small - 30, (small - 30).view(np.int8), 8, 7, 1)
    wide = pattern(3, dtype=np.uint32) * 1000003
    case("32-bit", wide, wide, 32, 31)
    case("24-bit-in-32", (wide & 0xFFFFFF) | 0x5000000, wide & 0xFFFFFF, 24, 23)
    negative = -(pattern(3, dtype=np.int32) * 100003)
    case("32-bit-signed", negative.view(np.uint32), negative, 32, 31, 1)
    for name, dtype, keyword in (("float", np.float32, "FloatPixelData"),
                                 ("double", np.float64, "DoubleFloatPixelData")):
        ds = image(3)
        numbers = pattern(3).astype(dtype) / 7
        del ds.PixelData
        setattr(ds, keyword, numbers.tobytes())
        ds.BitsAllocated = 8 * numbers.itemsize
        for gone in ("BitsStored", "HighBit", "PixelRepresentation"):
            delattr(ds, gone)
        cases.one(f"{name}-pixels", ds, expected_of(numbers[None]), "PS3.3 C.7.6.24")
    fragments(cases)


def fragments(cases):
    """Frames of odd length, and fragments that are divided otherwise than frames."""
    stream = imagecodecs.jpeg8_encode(blocks(), level=95)
    ds = image(0, pixels=blocks(), **PLANE)
    ds.PhotometricInterpretation = "YBR_FULL_422"
    ds.file_meta.TransferSyntaxUID = BASELINE
    del ds.PixelData
    right = {"size": [16, 16, 1], "colors": [[3, 3, 0, [200, 30, 40]], [12, 12, 0, [128, 128, 128]]]}
    pad = lambda b: b + b"\0" * (len(b) % 2)
    item = lambda b: bare(0xFFFEE000, len(b)) + b
    start = header(0x7FE00010, "OB", UNDEFINED, Style())
    end = bare(0xFFFEE0DD, 0)
    halves = [stream[: len(stream) // 4 * 2], pad(stream[len(stream) // 4 * 2 :])]
    pieces = {
        "two-fragments": item(b"") + b"".join(item(h) for h in halves) + end,
        "with-offset-table": item(bytes(4)) + item(pad(stream)) + end,
        "wrong-offset-table": item(b"\x39\x30\0\0") + item(pad(stream)) + end,
        "without-delimiter": item(b"") + item(pad(stream)),
        "odd-fragment": item(b"") + item(stream[:-2] + b"\0" * (1 - len(stream) % 2) + stream[-2:]) + end,
        "no-end-of-image": item(b"") + item(pad(stream[:-2])) + end,
        "long-padding": item(b"") + item(pad(stream) + bytes(64)) + end,
    }
    for name, content in pieces.items():
        data = file_of(ds) + start + content
        cases.one(f"jpeg-{name}", data, right, agrees(data, right, "PS3.5 A.4"), tolerance=8)


def make(cases):
    cases.kind = "jpeg"
    colours(cases)
    other_codecs(cases)
    run_length(cases)
    planes(cases)
    bits(cases)
