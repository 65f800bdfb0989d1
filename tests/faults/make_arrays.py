"""Writes small TIFF, Zarr, NumPy and picture files that readers get wrong, and cases.json.

    make_arrays.py OUTDIR

Needs numpy, tifffile, imagecodecs, zarr 3, numcodecs, Pillow and SimpleITK. Files are written by these; where none can write
a fault, tags or bytes are edited afterwards. What must come out is read from the very files by the
peer that each case names. Every run writes the same bytes.
"""

import gzip
import io
import json
import shutil
import struct
import sys
import zipfile
import zlib
from pathlib import Path

import imagecodecs
import numcodecs
import numpy
import tifffile
import zarr
from PIL import Image as Picture
import zarr.codecs.numcodecs as numcodecs_of
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec, GzipCodec, TransposeCodec, ZstdCodec

CASES = []
OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "arrays")


def case(kind, name, path, peer, volume=None, colors=None, **expected):
    """One case; `volume` is indexed (k, j, i), `colors` (k, j, i, channel)."""
    entry = {"kind": kind, "name": f"{kind.replace(' ', '-')}-{name}", "path": str(path), "peer": peer}
    shape = volume.shape if volume is not None else colors.shape[:3] if colors is not None else None
    if shape is not None:
        nk, nj, ni = shape
        entry["size"] = [ni, nj, nk]
        spread = [(0, 0, 0), (ni - 1, nj - 1, nk - 1), (ni - 1, 0, 0), (0, nj - 1, 0), (0, 0, nk - 1), (ni // 2, nj // 3, nk // 2), (ni // 3, nj // 2, nk // 3)]
        places = list(dict.fromkeys(spread))
        if volume is not None:
            if "options" not in expected:
                entry["components"] = 1
            entry["values"] = [[i, j, k, float(volume[k, j, i])] for i, j, k in places]
        else:
            entry["colors"] = [[i, j, k, [int(c) for c in colors[k, j, i][:3]]] for i, j, k in places]
    entry.update(expected)
    CASES.append(entry)


def volume(dtype, shape=(3, 6, 7), top=None):
    """A volume without symmetry."""
    n = numpy.arange(int(numpy.prod(shape))).reshape(shape)
    values = (n * 37 + (n // 7) * 11 + 5) % (top or 251)
    return values.astype(dtype)


def at(*parts):
    path = OUT.joinpath(*parts)
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def relative(path):
    return path.relative_to(OUT)


def tiff(name, data, **options):
    """A TIFF by tifffile."""
    path = at("tiff", name)
    options.setdefault("metadata", None)
    options.setdefault("photometric", "minisblack")
    tifffile.imwrite(path, data, **options)
    return path


def retagged(path, **tags):
    """Overwrites values of tags of every page."""
    with tifffile.TiffFile(path, mode="r+b") as file:
        for page in file.pages:
            for tag, value in tags.items():
                page.tags[tag].overwrite(value)
    return path


def renumbered(path, old, new):
    """Gives a tag of every page another number: tifffile writes only some by itself."""
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        for page in file.pages:
            struct.pack_into(file.byteorder + "H", data, page.tags[old].offset, new)
    path.write_bytes(data)
    return path


def packed(values, bits):
    """Rows of samples of some bits, each in whole bytes, the most significant bit first."""
    rows = values.reshape(-1, values.shape[-1])
    out = []
    for row in rows:
        text = "".join(format(int(v) & ((1 << bits) - 1), f"0{bits}b") for v in row)
        text += "0" * (-len(text) % 8)
        out.append([int(text[n : n + 8], 2) for n in range(0, len(text), 8)])
    return numpy.array(out, dtype=numpy.uint8).reshape(*values.shape[:-1], -1)


def pages(path):
    """All pages as tifffile reads them, one after the other."""
    with tifffile.TiffFile(path) as file:
        return numpy.stack([page.asarray() for page in file.pages])


NO_SPACING = ["does not state voxel spacing"]


def tiff_bits():
    kind = "tiff bits"

    def odd(name, values, bits, byteorder="<"):
        stored = packed(values, bits)
        path = tiff(name + ".tif", stored, byteorder=byteorder, rowsperstrip=values.shape[1], software=False)
        retagged(path, ImageWidth=values.shape[-1], BitsPerSample=bits)
        return path

    masks = volume(numpy.uint8, (3, 8, 21), 7) < 3
    fax = {"compression": "group3"}
    for name, options in (("none", {}), ("packbits", {"compression": "packbits"}), ("group-3", fax), ("group-3-2d", {**fax, "tiffinfo": {292: 1}}), ("group-3-fill", {**fax, "tiffinfo": {292: 4}}), ("group-3-fill-order-2", {**fax, "tiffinfo": {266: 2}}), ("group-4", {"compression": "group4"}), ("group-4-fill-order-2", {"compression": "group4", "tiffinfo": {266: 2}}), ("huffman", {"compression": "tiff_ccitt"}), ("lzw", {"compression": "tiff_lzw"})):
        frames = [Picture.fromarray(m) for m in masks]
        path = at("tiff", f"bit-{name}.tif")
        frames[0].save(path, save_all=True, append_images=frames[1:], **options)
        case(kind, f"1-{name}", relative(path), "Pillow", numpy.stack([numpy.array(f) for f in masks]).astype(int), warns=NO_SPACING, not_warns=["differ"])
    path = at("tiff", "bit-bool.tif")
    tifffile.imwrite(path, masks, photometric="minisblack", metadata=None)
    case(kind, "1-tifffile", relative(path), "tifffile", tifffile.imread(path).astype(int))
    path = tiff("bit-fill-order-2.tif", numpy.array([[[int(f"{b:08b}"[::-1], 2) for b in row] for row in m] for m in packed(masks.astype(int), 1)], dtype=numpy.uint8), extratags=[(265, "H", 1, 2, False)], rowsperstrip=8)
    renumbered(path, 265, 266)
    retagged(path, ImageWidth=21, BitsPerSample=1)
    case(kind, "1-fill-order-2", relative(path), "tifffile", pages(path).astype(int))
    for bits in (2, 4, 6, 10, 12, 14):
        values = volume(numpy.uint32, (2, 5, 9), 1 << bits)
        path = odd(f"depth-{bits}", values, bits)
        case(kind, f"{bits}", relative(path), "tifffile", pages(path), not_warns=["damaged"])
    values = volume(numpy.uint32, (2, 5, 9), 1 << 12)
    path = odd("depth-12-big-endian", values, 12, byteorder=">")
    case(kind, "12-big-endian", relative(path), "tifffile", pages(path))
    stored = numpy.frombuffer(b"".join(struct.pack("<I", v)[:3] for v in [0x3F0000, 0xC08000, 0, 0x400000, 0xBF0000, 0x3E8000] * 4), numpy.uint8).reshape(1, 4, 18)
    path = tiff("float-24.tif", stored[0], extratags=[(337, "H", 1, 3, False)])
    renumbered(path, 337, 339)
    retagged(path, ImageWidth=6, BitsPerSample=24)
    case(kind, "float-24", relative(path), "tifffile", pages(path))
    for dtype in ("float16", "int8", "int16", "uint32", "int32", "uint64", "int64", "float64"):
        values = volume("int64")
        values = (values - 100 if not dtype.startswith("u") else values).astype(dtype)
        for order, sign in (("little", "<"), ("big", ">")):
            if order == "big" and dtype not in ("float16", "int16", "float64"):
                continue
            path = tiff(f"type-{dtype}-{order}.tif", values, byteorder=sign, bigtiff=dtype == "int64")
            case(kind, f"{dtype}-{order}", relative(path), "tifffile", pages(path))
    path = tiff("type-complex64.tif", volume("complex64"))
    case(kind, "complex", relative(path), "TIFF 6.0 section 19", error=["complex"])


def palette(count, grey=False):
    n = numpy.arange(count)
    # Of 65536 colours only a few differ, so that the file stays small.
    n = n // 4096 * 4096 if count > 256 else n
    ramp = (n * 65535 // (count - 1)).astype(numpy.uint16)
    return numpy.stack([ramp, ramp, ramp] if grey else [ramp, ramp[::-1], (n * 65535 // (count - 1) // 3 * 2).astype(numpy.uint16)])


def tiff_palette():
    kind, notice = "tiff palette", ["colour table"]
    masks = volume(numpy.uint8, top=5)
    for name, data, count, options in (
        ("8", volume(numpy.uint8), 256, {}),
        ("8-labels", masks, 256, {}),
        ("16", volume(numpy.uint16, top=60001), 65536, {"compression": "deflate"}),
        ("8-lzw", volume(numpy.uint8), 256, {"compression": "lzw", "predictor": 2}),
        ("8-tiles", volume(numpy.uint8, (3, 20, 21)), 256, {"tile": (16, 16)}),
        ("8-big-endian", volume(numpy.uint8), 256, {"byteorder": ">"}),
        ("8-single", volume(numpy.uint8)[:1], 256, {}),
    ):
        path = tiff(f"palette-{name}.tif", data, photometric="palette", colormap=palette(count), **options)
        if name == "16":
            data = data[:1]
            path = tiff(f"palette-{name}.tif", data, photometric="palette", colormap=palette(count), **options)
        case(kind, name, relative(path), "tifffile", pages(path), warns=notice)
    path = tiff("palette-grey.tif", volume(numpy.uint8), photometric="palette", colormap=palette(256, True))
    case(kind, "8-grey-ramp", relative(path), "tifffile", pages(path), not_warns=notice)
    for bits in (1, 2, 4):
        values = volume(numpy.uint8, (2, 5, 9), 1 << bits)
        path = tiff(f"palette-{bits}.tif", packed(values, bits), photometric="palette", colormap=palette(256))
        with tifffile.TiffFile(path, mode="r+b") as file:
            for page in file.pages:
                page.tags["ImageWidth"].overwrite(9)
                page.tags["BitsPerSample"].overwrite(bits)
                page.tags["ColorMap"].overwrite(tuple(int(v) for v in palette(1 << bits).ravel()))
        case(kind, f"{bits}", relative(path), "tifffile", numpy.stack([p.asarray() for p in tifffile.TiffFile(path).pages]), warns=notice)
    frames = [Picture.fromarray(m).convert("P") for m in masks]
    for f in frames:
        f.putpalette([(n * 7) % 256 for n in range(768)])
    path = at("tiff", "palette-pillow.tif")
    frames[0].save(path, save_all=True, append_images=frames[1:])
    case(kind, "8-pillow", relative(path), "tifffile", pages(path), warns=notice)
    path = at("tiff", "palette-imagej.tif")
    tifffile.imwrite(path, volume(numpy.uint8), imagej=True, photometric="palette", colormap=palette(256), resolution=(2, 2), metadata={"unit": "mm", "spacing": 3.0, "axes": "ZYX"})
    case(kind, "8-imagej", relative(path), "tifffile", pages(path), warns=notice, spacing_mm=[0.5, 0.5, 3.0])


def tiff_planes():
    kind = "tiff planes and photometric"
    rgb = volume(numpy.uint8, (2, 6, 7, 3))
    for name, options in (("chunky", {}), ("planar", {"planarconfig": "separate"}), ("planar-tiles", {"planarconfig": "separate", "tile": (16, 16)}), ("planar-deflate", {"planarconfig": "separate", "compression": "deflate", "predictor": 2})):
        data = numpy.moveaxis(rgb, -1, 1) if "planar" in name else rgb
        path = tiff(f"rgb-{name}.tif", data, photometric="rgb", **options)
        read = pages(path)
        case(kind, f"rgb-{name}", relative(path), "tifffile", colors=numpy.moveaxis(read, 1, -1) if "planar" in name else read, components=3)
    path = tiff("rgba.tif", numpy.concatenate([rgb, numpy.full_like(rgb[..., :1], 255)], -1), photometric="rgb", extrasamples=["unassalpha"])
    case(kind, "rgba", relative(path), "tifffile", colors=pages(path), components=4)
    path = tiff("rgbx.tif", numpy.concatenate([rgb, rgb[..., :1]], -1), photometric="rgb", extrasamples=["unspecified"])
    case(kind, "rgbx", relative(path), "tifffile", colors=pages(path), components=3, warns=["left out"])
    path = tiff("rgb-16-planar.tif", numpy.moveaxis(rgb.astype(numpy.uint16) * 257, -1, 1), photometric="rgb", planarconfig="separate")
    case(kind, "rgb-16-planar", relative(path), "tifffile", colors=numpy.moveaxis(pages(path), 1, -1))
    for dtype in ("uint8", "uint16", "int16", "float32"):
        path = tiff(f"white-is-zero-{dtype}.tif", volume(dtype), photometric="miniswhite")
        case(kind, f"white-is-zero-{dtype}", relative(path), "tifffile", pages(path), warns=["WhiteIsZero"])
    path = tiff("white-is-zero-bit.tif", volume(numpy.uint8, (2, 8, 21), 7) < 3, photometric="miniswhite")
    case(kind, "white-is-zero-bit", relative(path), "tifffile", pages(path).astype(int), warns=["WhiteIsZero"])
    cmyk = volume(numpy.uint8, (1, 6, 7, 4))
    path = tiff("cmyk.tif", cmyk, photometric="separated")
    case(kind, "cmyk", relative(path), "Pillow", colors=numpy.array(Picture.open(path).convert("RGB"))[None], warns=["CMYK"])
    smooth = numpy.add.outer(numpy.arange(24) * 4, numpy.arange(32) * 3).astype("uint8")
    inks = Picture.merge("CMYK", [Picture.fromarray(c) for c in (smooth, smooth[::-1], smooth[:, ::-1], smooth // 4)])
    path = at("tiff", "cmyk-jpeg.tif")
    inks.save(path, compression="jpeg", quality=95)
    case(kind, "cmyk-jpeg", relative(path), "Pillow", colors=numpy.array(Picture.open(path).convert("RGB"))[None], tolerance=6, warns=["CMYK"])
    ycbcr = volume(numpy.uint8, (1, 6, 7, 3))
    path = tiff("ycbcr.tif", ycbcr, photometric="ycbcr", subsampling=(1, 1))
    colors = numpy.array(Picture.frombytes("YCbCr", (7, 6), ycbcr.tobytes()).convert("RGB"))[None]
    case(kind, "ycbcr", relative(path), "Pillow's YCbCr", colors=colors, components=3, tolerance=3)
    path = retagged(tiff("ycbcr-subsampled.tif", ycbcr, photometric="ycbcr", subsampling=(1, 1)), YCbCrSubSampling=(2, 2))
    case(kind, "ycbcr-subsampled", relative(path), "TIFF 6.0 section 21", error=["subsampled YCbCr"])
    path = tiff("cielab.tif", rgb[:1], photometric="cielab")
    case(kind, "cielab", relative(path), "TIFF 6.0 section 23", error=["L*a*b*"])
    path = tiff("grey-alpha.tif", volume(numpy.uint8, (2, 6, 7, 2)), extrasamples=["unassalpha"], planarconfig="contig")
    case(kind, "grey-alpha", relative(path), "tifffile", pages(path)[..., 0], warns=["opacity"])
    path = tiff("grey-planes.tif", volume(numpy.uint16, (2, 2, 6, 7)), planarconfig="separate", extrasamples=["unspecified"])
    case(kind, "channels-in-planes", relative(path), "tifffile", pages(path)[:, 1], options={"channel": 2})
    path = tiff("samples-5.tif", volume(numpy.uint16, (1, 6, 7, 5)), planarconfig="contig", extrasamples=["unspecified"] * 4)
    case(kind, "samples-5", relative(path), "tifffile", pages(path)[..., 3], options={"channel": 4})
    path = retagged(tiff("mixed-depth.tif", rgb[:1], photometric="rgb"), BitsPerSample=(5, 6, 5))
    case(kind, "565", relative(path), "TIFF 6.0 section 6", error=["5, 6, 5 bits"])
    for n in (2, 3, 6):
        path = tiff(f"orientation-{n}.tif", volume(numpy.uint8), extratags=[(272, "H", 1, n, False)])
        renumbered(path, 272, 274)
        case(kind, f"orientation-{n}", relative(path), "tifffile", pages(path), warns=[f"orientation {n}"])
    path = retagged(tiff("cfa.tif", volume(numpy.uint16)), PhotometricInterpretation=32803)
    case(kind, "cfa", relative(path), "tifffile", pages(path), warns=["CFA"])
    for name, tag in (("image-depth", 32997), ("tile-depth", 32998)):
        path = renumbered(tiff(f"{name}.tif", volume("uint8"), extratags=[(65000, "I", 1, 3, False)]), 65000, tag)
        case(kind, name, relative(path), "TIFF, SGI's tags", error=["".join(part.capitalize() for part in name.split("-"))])
    path = renumbered(tiff("image-depth-1.tif", volume("uint8"), extratags=[(65000, "I", 1, 1, False)]), 65000, 32997)
    case(kind, "image-depth-1", relative(path), "tifffile", pages(path).astype(int))


def tiff_compression():
    kind = "tiff compression and predictor"
    data = volume(numpy.uint16, (2, 20, 21), 60013)
    for name, options in (
        ("lzw", {"compression": "lzw"}),
        ("lzw-2", {"compression": "lzw", "predictor": 2}),
        ("deflate", {"compression": "deflate"}),
        ("deflate-2-big-endian", {"compression": "deflate", "predictor": 2, "byteorder": ">"}),
        ("zstd", {"compression": "zstd"}),
        ("zstd-2-tiles", {"compression": "zstd", "predictor": 2, "tile": (16, 16)}),
        ("lzma", {"compression": "lzma"}),
        ("packbits", {"compression": "packbits"}),
        ("jpeg-2000", {"compression": "jpeg2000", "compressionargs": {"level": 0, "reversible": True}}),
        ("tiles", {"tile": (16, 16)}),
        ("strips", {"rowsperstrip": 7, "compression": "deflate"}),
    ):
        path = tiff(f"packed-{name}.tif", data, **options)
        case(kind, name, relative(path), "tifffile", pages(path))
    for dtype in ("float16", "float32", "float64"):
        floats = (volume("int64", (2, 20, 21)) / 8 - 10).astype(dtype)
        for order in "<>":
            path = tiff(f"floats-{dtype}-{'big' if order == '>' else 'little'}.tif", floats, compression="deflate", predictor=3, byteorder=order)
            case(kind, f"{dtype}-3-{'big' if order == '>' else 'little'}", relative(path), "tifffile", pages(path))
    path = tiff("floats-tiles.tif", (volume("int64", (2, 20, 21)) / 8 - 10).astype("float32"), compression="zstd", predictor=3, tile=(16, 16))
    case(kind, "float32-3-tiles", relative(path), "tifffile", pages(path))
    for dtype in ("uint8", "int32", "int64"):
        path = tiff(f"differences-{dtype}.tif", volume(dtype, (2, 20, 21)), compression="deflate", predictor=2)
        case(kind, f"{dtype}-2", relative(path), "tifffile", pages(path))
    smooth = (numpy.add.outer(numpy.arange(24), numpy.arange(24)) * 4).astype(numpy.uint8)[None]
    path = tiff("jpeg-grey.tif", smooth, compression="jpeg", compressionargs={"level": 100})
    case(kind, "jpeg-grey", relative(path), "tifffile", pages(path), tolerance=2)
    rgb = numpy.stack([smooth, smooth[:, ::-1], smooth[..., ::-1]], -1)
    path = tiff("jpeg-rgb.tif", rgb, photometric="rgb", compression="jpeg", compressionargs={"level": 100})
    case(kind, "jpeg-rgb", relative(path), "tifffile", colors=pages(path), components=3, tolerance=4)
    path = tiff("jpeg-ycbcr-tiles.tif", numpy.concatenate([rgb, rgb]), photometric="ycbcr", subsampling=(2, 2), compression="jpeg", tile=(16, 16))
    case(kind, "jpeg-ycbcr-tiles", relative(path), "tifffile", colors=pages(path), components=3, tolerance=12)
    for name, compression, word in (("webp", "webp", "WebP"), ("jpeg-xl", "jpegxl", "JPEG XL"), ("png", "png", "PNG"), ("jpeg-xr", "jpegxr", "JPEG XR")):
        data = rgb if name == "webp" else smooth
        path = tiff(f"refused-{name}.tif", data, photometric="rgb" if name == "webp" else "minisblack", compression=compression)
        case(kind, name, relative(path), "tifffile's name of the compression", error=[word])
    path = retagged(tiff("refused-lerc.tif", smooth), Compression=34887)
    case(kind, "lerc", relative(path), "registered number", error=["LERC"])
    path = retagged(tiff("refused-jbig.tif", smooth), Compression=34661)
    case(kind, "jbig", relative(path), "registered number", error=["JBIG"])
    path = retagged(tiff("refused-number.tif", smooth), Compression=12345)
    case(kind, "number", relative(path), "TIFF 6.0", error=["12345"])
    path = tiff("sparse.tif", volume(numpy.uint8, (1, 20, 21)), tile=(16, 16))
    with tifffile.TiffFile(path, mode="r+b") as file:
        tags = file.pages[0].tags
        tags["TileOffsets"].overwrite((0,) + tags["TileOffsets"].value[1:])
        tags["TileByteCounts"].overwrite((0,) + tags["TileByteCounts"].value[1:])
    case(kind, "sparse", relative(path), "tifffile", pages(path))


def ome_metadata(axes, **more):
    return {"axes": axes, "PhysicalSizeX": 0.5, "PhysicalSizeY": 0.25, "PhysicalSizeZ": 2.0, **more}


def ome_description(path, old, new):
    """Replaces text in the OME-XML of the first page by text of the same length or shorter."""
    data = path.read_bytes()
    assert old in data, old
    path.write_bytes(data.replace(old, new.ljust(len(old), b" "), 1))
    return path


def tiff_ome_imagej():
    kind = "tiff ome and imagej"
    um = 1e-3
    units = {"PhysicalSizeXUnit": "µm", "PhysicalSizeYUnit": "µm", "PhysicalSizeZUnit": "µm"}

    def ome(name, data, axes, **more):
        path = at("tiff", name + ".ome.tif")
        options = {k: more.pop(k) for k in ("planarconfig", "photometric", "tile", "compression") if k in more}
        options.setdefault("photometric", "minisblack")
        tifffile.imwrite(path, data, ome=True, software=False, metadata=ome_metadata(axes, UUID="00000000-0000-0000-0000-000000000001", **more), **options)
        text = path.read_bytes()
        # A UUID that differs from run to run.
        start = text.find(b"urn:uuid:")
        while start >= 0:
            text = text[: start + 9] + b"00000000-0000-0000-0000-000000000001" + text[start + 45 :]
            start = text.find(b"urn:uuid:", start + 9)
        path.write_bytes(text)
        return path

    spacing = [0.5 * um, 0.25 * um, 2 * um]
    path = ome("units-default", volume("uint16"), "ZYX")
    case(kind, "ome-units-default", relative(path), "tifffile", tifffile.imread(path), spacing_mm=spacing)
    path = ome("units-mm", volume("uint16"), "ZYX", PhysicalSizeXUnit="mm", PhysicalSizeYUnit="mm", PhysicalSizeZUnit="mm")
    case(kind, "ome-units-mm", relative(path), "tifffile", tifffile.imread(path), spacing_mm=[0.5, 0.25, 2])
    path = ome("units-nm", volume("uint8"), "ZYX", PhysicalSizeXUnit="nm", PhysicalSizeYUnit="nm", PhysicalSizeZUnit="nm")
    case(kind, "ome-units-nm", relative(path), "OME 6", tifffile.imread(path), spacing_mm=[0.5e-6, 0.25e-6, 2e-6])
    path = ome("units-pixel", volume("uint8"), "ZYX", PhysicalSizeXUnit="pixel", PhysicalSizeYUnit="pixel", PhysicalSizeZUnit="pixel")
    case(kind, "ome-units-pixel", relative(path), "OME 6", tifffile.imread(path), warns=["not a length"])
    five = volume("uint16", (2, 3, 2, 6, 7), 60013)
    for axes in ("TZCYX", "TCZYX", "ZTCYX", "CZTYX"):
        path = ome(f"order-{axes.lower()}", five, axes, **units)
        with tifffile.TiffFile(path) as file:
            series = file.series[0]
            moved = numpy.moveaxis(series.asarray(), [series.axes.index(a) for a in "TCZYX"], range(5))
        case(kind, f"ome-order-{axes.lower()}", relative(path), "tifffile", moved[1, 1], options={"time": 2, "channel": 2}, spacing_mm=spacing, time_points=moved.shape[0])
    path = ome("rgb", volume("uint8", (3, 6, 7, 3)), "ZYXS", photometric="rgb")
    case(kind, "ome-rgb", relative(path), "tifffile", colors=tifffile.imread(path), components=3, spacing_mm=spacing)
    path = ome("rgb-planar", volume("uint8", (2, 3, 6, 7)), "ZSYX", photometric="rgb", planarconfig="separate")
    case(kind, "ome-rgb-planar", relative(path), "tifffile", colors=numpy.moveaxis(tifffile.imread(path), 1, -1), components=3)
    # Several files, of which any may be opened; one of them missing; renamed.
    names = ["z0.ome.tif", "z1.ome.tif", "z2.ome.tif"]
    stack = volume("uint16", (3, 6, 7), 60013)

    def several(folder, written, description=None, blocks=None):
        for n, name in enumerate(names):
            if n not in written:
                continue
            blocks_text = blocks or "".join(f'<TiffData FirstZ="{z}" IFD="0" PlaneCount="1"><UUID FileName="{names[z]}">urn:uuid:00000000-0000-0000-0000-00000000000{z}</UUID></TiffData>' for z in range(3))
            text = description or f'<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:00000000-0000-0000-0000-00000000000{n}"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="7" SizeY="6" SizeZ="3" SizeC="1" SizeT="1" PhysicalSizeX="0.5" PhysicalSizeY="0.25" PhysicalSizeZ="2"><Channel ID="Channel:0:0" SamplesPerPixel="1"/>{blocks_text}</Pixels></Image></OME>'
            tiff(f"{folder}/{name}", stack[n], description=text)
        return at("tiff", folder, names[written[0]])

    for opened in (0, 1, 2):
        several("ome-several", [0, 1, 2])
        path = at("tiff", "ome-several", names[opened])
        case(kind, f"ome-several-{opened}", relative(path), "tifffile", tifffile.imread(path) if opened == 0 else stack, spacing_mm=spacing, not_warns=["missing", "declares"])
    case(kind, "ome-several-folder", "tiff/ome-several", "tifffile", stack, spacing_mm=spacing)
    path = several("ome-missing", [0, 2])
    hole = stack.copy()
    hole[1] = 0
    case(kind, "ome-missing", relative(path), "OME-TIFF 6", hole, warns=["z1.ome.tif"])
    path = several("ome-outside", [0], blocks='<TiffData FirstZ="0" IFD="0"/><TiffData FirstZ="1" IFD="0"><UUID FileName="../../outside.tif">urn:uuid:9</UUID></TiffData><TiffData FirstZ="2" IFD="0"><UUID FileName="b.tif">urn:uuid:8</UUID></TiffData>')
    case(kind, "ome-outside", relative(path), "no file outside of its folder", error=["outside.tif"])
    for c in range(2):
        blocks = "".join(f'<TiffData FirstC="{n}" IFD="0" PlaneCount="3"><UUID FileName="c{n}.ome.tif">urn:uuid:00000000-0000-0000-0000-00000000000{n}</UUID></TiffData>' for n in range(2))
        text = f'<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:00000000-0000-0000-0000-00000000000{c}"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="7" SizeY="6" SizeZ="3" SizeC="2" SizeT="1"><Channel ID="Channel:0:0" SamplesPerPixel="1"/><Channel ID="Channel:0:1" SamplesPerPixel="1"/>{blocks}</Pixels></Image></OME>'
        path = tiff(f"ome-channels/c{c}.ome.tif", stack + 1000 * c, description=text)
    case(kind, "ome-file-per-channel", "tiff/ome-channels/c0.ome.tif", "tifffile", stack + 1000, options={"channel": 2}, not_warns=["is missing;"])
    text = '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYCZT" Type="uint8" SizeX="7" SizeY="6" SizeZ="3" SizeC="3" SizeT="1"><Channel ID="Channel:0:0"/><TiffData/></Pixels></Image></OME>'
    path = tiff("rgb-uncounted.ome.tif", volume("uint8", (3, 6, 7, 3)), photometric="rgb", description=text)
    case(kind, "ome-rgb-uncounted", relative(path), "tifffile's pages", colors=pages(path), components=3, not_warns=["declares"])
    binary = '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:00000000-0000-0000-0000-000000000000"><BinaryOnly MetadataFile="all.companion.ome" UUID="urn:uuid:5"/></OME>'
    # A TIFF among the others holds the description of all.
    described = tifffile.TiffFile(at("tiff", "ome-several", names[0])).pages[0].description
    for n, name in enumerate(names):
        pointing = binary.replace("000000000000\"", f"00000000000{n}\"").replace("all.companion.ome", names[0]).replace("urn:uuid:5", "urn:uuid:00000000-0000-0000-0000-000000000000")
        tiff(f"ome-master/{name}", stack[n], description=pointing if n else described)
    for n, name in enumerate(names):
        case(kind, f"ome-master-{n}", f"tiff/ome-master/{name}", "tifffile", stack, spacing_mm=spacing, not_warns=["missing", "declares"])
    pointing = binary.replace("all.companion.ome", "all.ome.tif").replace("urn:uuid:5", "urn:uuid:1")
    tiff("ome-master-alone/z0.ome.tif", stack[0] + 1, description=pointing)
    alone = '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:1"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="7" SizeY="6" SizeZ="3" SizeC="1" SizeT="1"><Channel ID="Channel:0:0" SamplesPerPixel="1"/><TiffData/></Pixels></Image></OME>'
    tiff("ome-master-alone/all.ome.tif", stack, description=alone)
    case(kind, "ome-master-holds-all", "tiff/ome-master-alone/z0.ome.tif", "OME-TIFF 6", stack)
    path = several("ome-companion", [0, 1, 2], description=binary)
    text = tifffile.TiffFile(at("tiff", "ome-several", names[0])).pages[0].description
    at("tiff", "ome-companion", "all.companion.ome").write_text(text)
    case(kind, "ome-companion", relative(path), "OME-TIFF 6, BinaryOnly", stack, spacing_mm=spacing)
    path = several("ome-no-companion", [0], description=binary)
    case(kind, "ome-no-companion", relative(path), "OME-TIFF 6, BinaryOnly", stack[:1], warns=["all.companion.ome"])
    # Planes in reverse, stated by TiffData.
    blocks = "".join(f'<TiffData IFD="{2 - z}" FirstZ="{z}" PlaneCount="1"/>' for z in range(3))
    text = f'<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="7" SizeY="6" SizeZ="3" SizeC="1" SizeT="1"><Channel ID="Channel:0:0" SamplesPerPixel="1"/>{blocks}</Pixels></Image></OME>'
    path = tiff("reversed.ome.tif", stack, description=text)
    case(kind, "ome-reversed", relative(path), "tifffile", tifffile.imread(path), warns=NO_SPACING)
    # ImageJ.
    for name, unit, mm in (("mm", "mm", 1), ("micron", "micron", um), ("escape", "\\u00B5m", um), ("cm", "cm", 10), ("nm", "nm", 1e-6), ("inch", "inch", 25.4)):
        path = at("tiff", f"imagej-{name}.tif")
        tifffile.imwrite(path, stack, imagej=True, resolution=(2, 4), metadata={"axes": "ZYX", "unit": unit, "spacing": 3.0})
        case(kind, f"imagej-{name}", relative(path), "tifffile", tifffile.imread(path), spacing_mm=[0.5 * mm, 0.25 * mm, 3 * mm], not_warns=["without a unit"])
    path = at("tiff", "imagej-pixel.tif")
    tifffile.imwrite(path, stack, imagej=True, resolution=(2, 4), metadata={"axes": "ZYX", "unit": "pixel", "spacing": 3.0})
    case(kind, "imagej-pixel", relative(path), "tifffile", tifffile.imread(path), warns=["pixel"])
    path = at("tiff", "imagej-no-distance.tif")
    tifffile.imwrite(path, stack, imagej=True, resolution=(2, 4), metadata={"axes": "ZYX", "unit": "micron"})
    case(kind, "imagej-no-distance", relative(path), "ImageJ's TiffDecoder", tifffile.imread(path), spacing_mm=[0.5 * um, 0.25 * um, um], warns=["distance of its slices"])
    path = at("tiff", "imagej-hyperstack.tif")
    tifffile.imwrite(path, five, imagej=True, metadata={"axes": "TZCYX"})
    case(kind, "imagej-hyperstack", relative(path), "tifffile", tifffile.imread(path)[1, :, 0], options={"time": 2, "channel": 1}, time_points=2)
    path = at("tiff", "imagej-rgb.tif")
    tifffile.imwrite(path, volume("uint8", (3, 6, 7, 3)), imagej=True, photometric="rgb", metadata={"axes": "ZYXS"})
    case(kind, "imagej-rgb", relative(path), "tifffile", colors=tifffile.imread(path), components=3)

    def single_directory(name, data, description, **options):
        """As ImageJ writes more than 4 GiB: pixels of all planes behind one directory."""
        path = tiff(name, data[0], description=description, **options)
        with tifffile.TiffFile(path) as file:
            offset = file.pages[0].dataoffsets[0]
            order = file.byteorder
        content = path.read_bytes()[:offset]
        path.write_bytes(content + data.astype(data.dtype.newbyteorder(order)).tobytes())
        return path

    text = "ImageJ=1.53t\nimages=3\nslices=3\nunit=mm\nspacing=2.0\ncf=0\nc0=-32768\nc1=1\nvunit=Gray Value\n"
    path = tiff("imagej-calibrated.tif", stack, description=text, resolution=(1, 1), software=False)
    case(kind, "imagej-calibrated", relative(path), "ImageJ's calibration", stack - 32768.0, warns=["ImageJ calibration"])
    text = "ImageJ=1.53t\nimages=3\nslices=3\nunit=mm\nspacing=3.0\nloop=false\n"
    path = single_directory("imagej-large.tif", stack, text, byteorder=">")
    case(kind, "imagej-large", relative(path), "tifffile", tifffile.imread(path))
    path = single_directory("imagej-large-rgb.tif", volume("uint8", (3, 6, 7, 3)), text, photometric="rgb")
    case(kind, "imagej-large-rgb", relative(path), "tifffile", colors=tifffile.imread(path), components=3)
    # tifffile's shape.
    for name, data, options in (("shaped-4", volume("uint16", (2, 3, 6, 7)), {}), ("shaped-axes", volume("uint16", (3, 2, 6, 7)), {"axes": "ZTYX"}), ("shaped-channels", volume("uint16", (3, 2, 6, 7)), {"axes": "ZCYX"})):
        path = at("tiff", name + ".tif")
        tifffile.imwrite(path, data, photometric="minisblack", metadata=options or {})
        read = tifffile.imread(path)
        if name == "shaped-4":
            case(kind, name, relative(path), "tifffile", read[1], options={"time": 2}, time_points=2)
        elif name == "shaped-axes":
            case(kind, name, relative(path), "tifffile", read[:, 1], options={"time": 2}, time_points=2)
        else:
            case(kind, name, relative(path), "tifffile", read[:, 1], options={"channel": 2})
    # Pages that are no slices; resolution of print.
    path = at("tiff", "thumbnail.tif")
    with tifffile.TiffWriter(path) as writer:
        for n in range(3):
            writer.write(stack[n], photometric="minisblack", metadata=None)
        writer.write(stack[0, ::2, ::2], photometric="minisblack", metadata=None, subfiletype=1)
    case(kind, "thumbnail", relative(path), "TIFF 6.0, NewSubfileType", stack, warns=["thumbnails"])
    path = at("tiff", "pyramid.tif")
    with tifffile.TiffWriter(path) as writer:
        writer.write(stack, photometric="minisblack", metadata=None, subifds=1, tile=(16, 16))
        for n in range(3):
            writer.write(stack[n, ::2, ::2], photometric="minisblack", metadata=None, subfiletype=1, tile=(16, 16))
    path = at("tiff", "resolution-inch.tif")
    tifffile.imwrite(path, stack, photometric="minisblack", metadata=None, resolution=(300, 300), resolutionunit="inch")
    case(kind, "resolution-inch", relative(path), "no invented spacing", tifffile.imread(path), spacing_mm=[1, 1, 1], warns=["300 x 300 pixels per inch", "1 mm is assumed"])
    path = at("tiff", "resolution-cm.tif")
    tifffile.imwrite(path, stack, photometric="minisblack", metadata=None, resolution=(200, 400), resolutionunit="centimeter")
    case(kind, "resolution-cm", relative(path), "no invented spacing", tifffile.imread(path), warns=["0.05 x 0.025 mm"])
    path = at("tiff", "two-images.ome.tif")
    blocks = "".join(f'<Image ID="Image:{n}"><Pixels ID="Pixels:{n}" DimensionOrder="XYZCT" Type="uint16" SizeX="7" SizeY="6" SizeZ="{2 - n}" SizeC="1" SizeT="1"><Channel ID="Channel:{n}:0" SamplesPerPixel="1"/><TiffData IFD="{2 * n}" PlaneCount="{2 - n}"/></Pixels></Image>' for n in range(2))
    path = tiff("two-images.ome.tif", stack, description=f'<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">{blocks}</OME>')
    case(kind, "ome-two-images", relative(path), "tifffile", tifffile.imread(path), warns=["holds 2 images"])
    sizes = at("tiff", "sizes.tif")
    with tifffile.TiffWriter(sizes) as writer:
        for plane in (stack[0], stack[1], stack[2, :3]):
            writer.write(plane, photometric="minisblack", metadata=None)
    case(kind, "sizes", relative(sizes), "tifffile", stack[:2], warns=["1 pages differ in size"])
    lsm = bytearray(512)
    struct.pack_into("<iiiiiiii", lsm, 0, 0x00400494C, 512, 7, 6, 3, 1, 1, 2)
    struct.pack_into("<ddd", lsm, 40, 0.5e-6, 0.25e-6, 2e-6)
    path = tiff("stack.lsm.tif", stack, extratags=[(34412, "B", 512, bytes(lsm), True)])
    case(kind, "lsm", relative(path), "CZ_LSMINFO", stack, spacing_mm=spacing)
    path = single_directory("planes.stk.tif", stack, None, extratags=[(33629, "I", 3, (0, 0, 0), True)])
    case(kind, "stk", relative(path), "MetaMorph UIC2Tag", stack)
    path = tiff("geotiff.tif", stack, extratags=[(33550, "d", 3, (30.0, 30.0, 0.0), True), (33922, "d", 6, (0.0,) * 6, True)])
    case(kind, "geotiff", relative(path), "tifffile", pages(path), spacing_mm=[1, 1, 1], warns=NO_SPACING)


def zarr_array(name, data, axes=None, zarr_format=2, **options):
    """An array, or with `axes` an OME-Zarr image of one resolution."""
    path = at("zarr", name)
    shutil.rmtree(path, ignore_errors=True)
    scale = options.pop("scale", None)
    unit = options.pop("unit", "millimeter")
    extra = options.pop("attributes", {})
    # Few files; several chunks along every axis where the order of axes matters.
    several = name.startswith(("axes", "order"))
    options.setdefault("chunks", tuple(min(4, n) if several or a == 0 else n for a, n in enumerate(data.shape)))
    group = path
    if axes is not None:
        group = zarr.open_group(str(path), mode="w", zarr_format=zarr_format)
        spaces = [{"name": a, "type": {"t": "time", "c": "channel"}.get(a, "space"), **({"unit": unit} if a in "xyz" and unit else {})} for a in axes]
        multiscale = {"version": "0.4" if zarr_format == 2 else "0.5", "axes": spaces, "datasets": [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": scale or [1.0] * len(axes)}]}]}
        if "translation" in extra:
            multiscale["datasets"][0]["coordinateTransformations"].append({"type": "translation", "translation": extra.pop("translation")})
        multiscale.update(extra.pop("multiscale", {}))
        own = {"multiscales": [multiscale], **extra}
        group.attrs.update({"ome": {"version": "0.5", **own}} if zarr_format == 3 else own)
        store, name = str(path), "0"
        array = group.create_array("0", shape=data.shape, dtype=data.dtype, **options)
    else:
        array = zarr.create_array(str(path), shape=data.shape, dtype=data.dtype, zarr_format=zarr_format, **options)
        array.attrs.update(extra)
    array[...] = data
    return path


def zarr_json(path, change, name=".zarray"):
    """Edits metadata."""
    file = path / name
    metadata = json.loads(file.read_text())
    change(metadata)
    file.write_text(json.dumps(metadata))
    return path


def zarr_types():
    kind = "zarr types"
    data = volume("int64", (3, 6, 7))
    for version in (2, 3):
        for dtype in ("bool", "float16", "uint8", "int16", "float64", "uint64"):
            values = (data % 3 == 0) if dtype == "bool" else data.astype(dtype)
            path = zarr_array(f"type-{dtype}-{version}.zarr", values, "zyx", version)
            read = zarr.open_array(str(path / "0"), mode="r")[...].astype(float)
            case(kind, f"{dtype}-{version}", relative(path), "zarr", read, not_warns=["damaged"])
    for dtype in (">u2", ">f4", ">i4", ">f8", ">f2"):
        path = zarr_array(f"big-{dtype[1:]}.zarr", data.astype(dtype), "zyx")
        case(kind, f"big-{dtype[1:]}", relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...].astype(float))
    path = zarr_array("big-3.zarr", data.astype("uint16"), "zyx", 3, serializer=BytesCodec(endian="big"))
    case(kind, "big-3", relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...])
    for dtype, word in (("complex64", "complex"), ("<U4", "texts"), ("S4", "texts"), ("<M8[s]", "dates")):
        values = data.astype("datetime64[s]") if dtype == "<M8[s]" else data.astype(dtype)
        path = zarr_array(f"refused-{word}-{dtype.strip('<')[0]}.zarr", values)
        case(kind, f"refused-{dtype}", relative(path), "Zarr 2, data type encoding", error=[word])
    path = zarr_json(zarr_array("refused-structured.zarr", data.astype("uint8")), lambda m: m.update(dtype=[["a", "<f4"], ["b", "|u1"]]))
    case(kind, "refused-structured", relative(path), "Zarr 2, data type encoding", error=["fields"])
    path = zarr_array("refused-complex-3.zarr", data.astype("complex64"), zarr_format=3)
    case(kind, "refused-complex-3", relative(path), "Zarr 3, data types", error=["complex64"])
    path = zarr_array("empty-shape.zarr", numpy.zeros((0, 6, 7), "uint8"), chunks=(4, 4, 4))
    case(kind, "no-values", relative(path), "Zarr 2", error=["no values"])
    for fill in (7, 0):
        path = zarr_array(f"fill-{fill}.zarr", data.astype("uint8"), "zyx", fill_value=fill, chunks=(1, 6, 7))
        (path / "0" / "1.0.0" if (path / "0" / "1.0.0").exists() else path / "0" / "1" / "0" / "0").unlink()
        case(kind, f"fill-{fill}", relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...])
    path = zarr_array("fill-nan.zarr", data.astype("float32"), "zyx", fill_value=float("nan"), chunks=(1, 6, 7))
    (path / "0" / "1.0.0").unlink()
    read = zarr.open_array(str(path / "0"), mode="r")[...]
    case(kind, "fill-nan", relative(path), "zarr", read[:1], size=[7, 6, 3], warns=["42 voxels are NaN"])
    path = zarr_json(zarr_array("fill-null.zarr", data.astype("uint8"), chunks=(1, 6, 7)), lambda m: m.update(fill_value=None))
    (path / "1.0.0").unlink()
    read = data.astype("uint8").copy()
    read[1] = 0
    case(kind, "fill-null", relative(path), "zarr", read)


def zarr_axes():
    kind = "zarr axes"
    spaces = {"z": 2.0, "y": 0.25, "x": 0.5}
    extents = {"t": 2, "c": 3, "z": 3, "y": 6, "x": 7}
    for axes in ("xyz", "yxz", "zxy", "xy", "yx", "xyzc", "zyxc", "ctzyx", "czyx", "tzyx", "zcyx", "yxc"):
        shape = tuple(extents[a] for a in axes)
        data = volume("uint16", shape, 60013)
        path = zarr_array(f"axes-{axes}.zarr", data, axes, 2 if axes < "y" else 3, scale=[spaces.get(a, 1.0) for a in axes])
        read = zarr.open_array(str(path / "0"), mode="r")[...]
        order, options = axes, {}
        for name, key in (("t", "time"), ("c", "channel")):
            if name in order:
                read = numpy.take(read, 1, axis=order.index(name))
                order = order.replace(name, "")
                options[key] = 2
        read = numpy.transpose(read, [order.index(a) for a in "zyx" if a in order])
        read = read.reshape((1,) * (3 - read.ndim) + read.shape)
        spacing = [0.5, 0.25, 2.0 if "z" in axes else 1.0]
        case(kind, axes, relative(path), "zarr", read, spacing_mm=spacing, **({"options": options} if options else {}), **({} if "z" in axes else {"warns": ["thickness of 1 mm"]}))
    data = volume("uint16", (3, 6, 7), 60013)
    read = data.astype(float)
    path = zarr_array("units-um.zarr", data, "zyx", scale=[2.0, 0.25, 0.5], unit="micrometer")
    case(kind, "micrometre", relative(path), "OME-NGFF 0.4", read, spacing_mm=[0.0005, 0.00025, 0.002])
    path = zarr_array("units-none.zarr", data, "zyx", scale=[2.0, 0.25, 0.5], unit=None)
    case(kind, "no-unit", relative(path), "OME-NGFF 0.4", read, spacing_mm=[0.5, 0.25, 2.0], warns=["without a unit"])
    path = zarr_array("units-pixel.zarr", data, "zyx", scale=[2.0, 0.25, 0.5], unit="pixel")
    case(kind, "unit-pixel", relative(path), "OME-NGFF 0.4", read, warns=["not a length"])
    path = zarr_array("twice.zarr", data, "zyx", scale=[2.0, 0.25, 0.5], attributes={"translation": [10.0, 20.0, 30.0], "multiscale": {"coordinateTransformations": [{"type": "scale", "scale": [2.0, 2.0, 2.0]}]}})
    case(kind, "scale-twice", relative(path), "OME-NGFF 0.4", read, spacing_mm=[1.0, 0.5, 4.0], origin_mm=[60.0, 40.0, 20.0])

    def without(key):
        return lambda m: m["multiscales"][0].pop(key)

    path = zarr_json(zarr_array("no-axes.zarr", data, "zyx"), without("axes"), ".zattrs")
    case(kind, "no-axes", relative(path), "OME-NGFF 0.3", read, warns=["does not name its axes"])
    path = zarr_json(zarr_array("axes-03.zarr", data, "zyx"), lambda m: m["multiscales"][0].update(version="0.3", axes=["z", "y", "x"]), ".zattrs")
    case(kind, "0.3", relative(path), "OME-NGFF 0.3", read)
    path = zarr_json(zarr_array("axes-01.zarr", data[None, None], "tczyx"), lambda m: (m["multiscales"][0].update(version="0.1"), m["multiscales"][0].pop("axes"), m["multiscales"][0]["datasets"][0].pop("coordinateTransformations")), ".zattrs")
    case(kind, "0.1", relative(path), "OME-NGFF 0.1", read, warns=["voxel spacing"])
    path = zarr_array("xarray.zarr", numpy.ascontiguousarray(data.transpose(2, 1, 0)), attributes={"_ARRAY_DIMENSIONS": ["x", "y", "z"]})
    case(kind, "xarray", relative(path), "xarray's _ARRAY_DIMENSIONS", read, warns=["voxel spacing"])
    path = zarr_array("dimension-names.zarr", numpy.ascontiguousarray(data.transpose(2, 1, 0)), zarr_format=3, dimension_names=["x", "y", "z"])
    case(kind, "dimension-names", relative(path), "Zarr 3, dimension_names", read)
    path = zarr_array("angle.zarr", data, "ayx")
    case(kind, "other-axis", relative(path), "OME-NGFF 0.4", read[:1], warns=['axis "a" of 3'])
    colors = {"omero": {"channels": [{"label": "DAPI", "color": "0000FF"}, {"label": "GFP", "color": "00FF00"}]}}
    path = zarr_array("channels.zarr", numpy.stack([data, data[::-1]]), "czyx", attributes=colors)
    case(kind, "channels", relative(path), "OME-NGFF 0.4, omero", data[::-1], options={"channel": 2})
    image_label = {"image-label": {"version": "0.4", "colors": [{"label-value": 1, "rgba": [255, 0, 0, 255]}, {"label-value": 2, "rgba": [0, 255, 0, 255]}], "properties": [{"label-value": 1, "name": "liver"}, {"label-value": 2, "class": "tumour"}]}}
    path = zarr_array("labels.zarr", (data % 3).astype("uint8"), "zyx", attributes=image_label)
    case(kind, "labels", relative(path), "OME-NGFF 0.4, image-label", data % 3, labels={"1": "liver", "2": "tumour"})
    path = zarr_array("group/a", data)
    zarr.open_group(str(path.parent), mode="a", zarr_format=2)
    case(kind, "group-of-one", relative(path.parent), "zarr", read)
    zarr_array("groups/a", data)
    path = zarr_array("groups/b", data)
    zarr.open_group(str(path.parent), mode="a", zarr_format=2)
    case(kind, "group-of-two", relative(path.parent), "zarr", error=["2 arrays", "a, b"])
    path = zarr_array("well/0", data, "zyx")
    zarr.open_group(str(path.parent), mode="a", zarr_format=2).attrs.update({"well": {"version": "0.4", "images": [{"path": "0"}, {"path": "1"}]}})
    case(kind, "well", relative(path.parent), "OME-NGFF 0.4, well", error=["well of 2 images", "(0, 1)"])
    case(kind, "well-image", relative(path), "OME-NGFF 0.4, well", read)
    path = zarr_array("six-axes.zarr", data.reshape(1, 1, 1, 3, 6, 7))
    case(kind, "six-axes", relative(path), "zarr", error=["6 axes"])


def zarr_codecs():
    kind = "zarr codecs"
    data = volume("uint16", (5, 6, 7), 60013)
    for name, compressor in (
        ("none", None),
        ("blosc-lz4", numcodecs.Blosc("lz4", 5, 1)),
        ("blosc-zstd-bits", numcodecs.Blosc("zstd", 5, 2)),
        ("zstd", numcodecs.Zstd(3)),
        ("gzip", numcodecs.GZip(6)),
        ("zlib", numcodecs.Zlib(6)),
        ("bz2", numcodecs.BZ2(6)),
    ):
        path = zarr_array(f"codec-{name}.zarr", data, "zyx", compressors=compressor)
        for file in sorted(path.rglob("*")) if name == "gzip" else []:
            # The time in the header of gzip.
            if file.is_file() and file.read_bytes()[:2] == b"\x1f\x8b":
                content = file.read_bytes()
                file.write_bytes(content[:4] + bytes(4) + content[8:])
        case(kind, name, relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...])
    for name, compressor, word in (("lz4", numcodecs.LZ4(), "lz4"), ("lzma", numcodecs.LZMA(), "lzma")):
        path = zarr_array(f"codec-{name}.zarr", data, "zyx", compressors=compressor)
        case(kind, name, relative(path), "numcodecs", error=[f'"{word}"'])
    for name, filters, read in (
        ("shuffle", [numcodecs.Shuffle(2)], True),
        ("fletcher32", [numcodecs.Fletcher32()], True),
        ("fixedscaleoffset", [numcodecs.FixedScaleOffset(offset=0, scale=1, dtype="<u2", astype="<u2")], True),
        ("delta", [numcodecs.Delta("<u2")], False),
        ("astype", [numcodecs.AsType("<u4", "<u2")], False),
        ("quantize", [numcodecs.Quantize(1, "<f4")], False),
    ):
        values = data.astype("float32") if name == "quantize" else data
        path = zarr_array(f"filter-{name}.zarr", values, "zyx", filters=filters, compressors=None)
        if read:
            case(kind, name, relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...])
        else:
            case(kind, name, relative(path), "numcodecs", error=[f'"{name}"'])
    for separator in "./":
        path = zarr_array(f"separator-{'dot' if separator == '.' else 'slash'}.zarr", data, "zyx", chunk_key_encoding={"name": "v2", "separator": separator})
        case(kind, f"separator-{'dot' if separator == '.' else 'slash'}", relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...])
    path = zarr_array("order-f.zarr", data, "zyx", order="F")
    case(kind, "order-f", relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...])
    for name, options in (
        ("3-zstd", {"compressors": ZstdCodec()}),
        ("3-gzip", {"compressors": GzipCodec()}),
        ("3-blosc", {"compressors": BloscCodec(cname="lz4", shuffle="shuffle", typesize=2)}),
        ("3-crc32c", {"compressors": [ZstdCodec(), Crc32cCodec()]}),
        ("3-sharded", {"shards": (4, 6, 8), "chunks": (2, 3, 4)}),
        ("3-sharded-blosc", {"shards": (4, 6, 8), "chunks": (2, 3, 4), "compressors": BloscCodec(cname="zstd", shuffle="bitshuffle", typesize=2)}),
        ("3-transpose", {"filters": TransposeCodec(order=(2, 0, 1))}),
    ):
        path = zarr_array(f"codec-{name}.zarr", data, "zyx", 3, **options)
        for file in sorted(path.rglob("*")) if name == "3-gzip" else []:
            if file.is_file() and file.read_bytes()[:2] == b"\x1f\x8b":
                content = file.read_bytes()
                file.write_bytes(content[:4] + bytes(4) + content[8:])
        case(kind, name, relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...])
    # zarr-python leaves out what is numcodecs' default.
    for name, codecs in (
        ("zlib", [numcodecs_of.Zlib()]),
        ("zlib-level", [numcodecs_of.Zlib(level=6)]),
        ("bz2", [numcodecs_of.BZ2()]),
        ("zstd", [numcodecs_of.Zstd()]),
        ("shuffle", [numcodecs_of.Shuffle(elementsize=2), numcodecs_of.Zlib()]),
        ("shuffle-4", [numcodecs_of.Shuffle(), numcodecs_of.BZ2()]),
    ):
        values = data.astype("int32") if name == "shuffle-4" else data
        path = zarr_array(f"numcodecs-{name}.zarr", values, "zyx", 3, compressors=codecs)
        case(kind, f"3-numcodecs-{name}", relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...])
    path = zarr_array("numcodecs-sharded.zarr", data, "zyx", 3, shards=(4, 6, 8), chunks=(2, 3, 4), compressors=[numcodecs_of.Zlib()])
    case(kind, "3-numcodecs-sharded", relative(path), "zarr", zarr.open_array(str(path / "0"), mode="r")[...])
    path = zarr_array("codec-3-unknown.zarr", data, "zyx", 3)
    zarr_json(path, lambda m: m["codecs"].append({"name": "numcodecs.lz4", "configuration": {}}), "0/zarr.json")
    case(kind, "3-lz4", relative(path), "numcodecs", error=['"numcodecs.lz4"'])
    path = zarr_array("codec-sharded-lz4.zarr", data, "zyx", 3, shards=(4, 6, 8), chunks=(2, 3, 4))
    zarr_json(path, lambda m: m["codecs"][0]["configuration"]["codecs"].append({"name": "numcodecs.lzma", "configuration": {}}), "0/zarr.json")
    case(kind, "3-sharded-lzma", relative(path), "numcodecs", error=['"numcodecs.lzma"'])
    path = zarr_array("consolidated.zarr", data, "zyx")
    zarr.consolidate_metadata(str(path), zarr_format=2)
    case(kind, "consolidated", relative(path), "zarr", data)
    store = zarr_array("zipped.zarr", data, "zyx")
    path = at("zarr", "zipped.zarr.zip")
    with zipfile.ZipFile(path, "w") as archive:
        for file in sorted(store.rglob("*")):
            if file.is_file():
                archive.writestr(zipfile.ZipInfo(str(file.relative_to(store)), (1980, 1, 1, 0, 0, 0)), file.read_bytes())
    wrapped = at("zarr", "wrapped.zip")
    with zipfile.ZipFile(wrapped, "w") as archive:
        for file in sorted(store.rglob("*")):
            if file.is_file():
                archive.writestr(zipfile.ZipInfo(str(file.relative_to(store.parent)), (1980, 1, 1, 0, 0, 0)), file.read_bytes(), zipfile.ZIP_DEFLATED)
    case(kind, "zip-of-folder", relative(wrapped), "zarr", data)
    shutil.rmtree(store)
    store = zarr_array("zipped-sharded.zarr", data, "zyx", 3, shards=(4, 6, 8), chunks=(2, 3, 4))
    sharded = at("zarr", "zipped-sharded.zip")
    with zipfile.ZipFile(sharded, "w") as archive:
        for file in sorted(store.rglob("*")):
            if file.is_file():
                archive.writestr(zipfile.ZipInfo(str(file.relative_to(store)), (1980, 1, 1, 0, 0, 0)), file.read_bytes())
    shutil.rmtree(store)
    case(kind, "zip-sharded", relative(sharded), "zarr", data)
    case(kind, "zip", relative(path), "zarr", data)


def numpy_types():
    kind = "numpy types"

    def written(name, data, version=None, fortran=False):
        path = at("numpy", name + ".npy")
        data = numpy.asfortranarray(data) if fortran else data
        with open(path, "wb") as file:
            numpy.lib.format.write_array(file, data, version=version, allow_pickle=True)
        return path

    data = volume("int64", (3, 6, 7))
    for dtype in ("bool", "float16", "int8", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64", ">u2", ">f2", ">f4", ">i8"):
        values = (data % 3 == 0) if dtype == "bool" else data.astype(dtype)
        path = written("type-" + dtype.replace(">", "big-"), values)
        case(kind, dtype.replace(">", "big-"), relative(path), "NumPy", numpy.load(path).astype(float), warns=["voxel spacing"])
    for version in ((1, 0), (2, 0), (3, 0)):
        path = written(f"version-{version[0]}", data.astype("uint16"), version)
        case(kind, f"version-{version[0]}", relative(path), "NumPy", numpy.load(path))
    path = written("fortran", data.transpose(2, 1, 0).astype("int16"), fortran=True)
    case(kind, "fortran", relative(path), "NumPy", numpy.load(path).transpose(2, 1, 0))
    path = written("two-axes", data[0].astype("float32"))
    case(kind, "two-axes", relative(path), "NumPy", numpy.load(path)[None])
    path = written("fortran-zyx", data.astype("int16"), fortran=True)
    case(kind, "fortran-zyx", relative(path), "numpy.lib.format", numpy.load(path).transpose(2, 1, 0), warns=["Fortran order; its first axis is taken as i"])
    path = written("c-order", data.astype("int16"))
    case(kind, "c-order", relative(path), "NumPy", numpy.load(path), not_warns=["Fortran"])
    for name, shape in (("rgb", (4, 6, 7, 3)), ("rgba", (5, 6, 7, 4)), ("rgb-of-3", (3, 6, 7, 3))):
        path = written(f"fortran-{name}", volume("uint8", shape), fortran=True)
        case(kind, f"fortran-{name}", relative(path), "numpy.lib.format", colors=numpy.load(path).transpose(2, 1, 0, 3), components=shape[3], warns=["its last one as colours"])
    path = written("fortran-color-first", volume("uint8", (3, 6, 7, 5)), fortran=True)
    case(kind, "fortran-color-first", relative(path), "numpy.lib.format", colors=numpy.load(path).transpose(3, 2, 1, 0), components=3, warns=["its first axis is taken as colours"])
    path = written("fortran-times", volume("int16", (7, 6, 5, 3)), fortran=True)
    case(kind, "fortran-times", relative(path), "numpy.lib.format", numpy.load(path)[..., 1].transpose(2, 1, 0), options={"time": 2}, time_points=3, warns=["its first axis is taken as i"])
    four = volume("uint16", (2, 3, 6, 7), 60013)
    path = written("four-axes", four)
    case(kind, "four-axes", relative(path), "NumPy", numpy.load(path)[1], options={"time": 2}, time_points=2)
    five = volume("uint16", (2, 3, 3, 6, 7), 60013)
    path = written("five-axes", five)
    case(kind, "five-axes", relative(path), "NumPy", numpy.load(path)[1, 2], options={"time": 2, "channel": 3}, time_points=2)
    path = written("rgb", volume("uint8", (3, 6, 7, 3)))
    case(kind, "rgb", relative(path), "NumPy", colors=numpy.load(path), components=3)
    for name, values, word in (
        ("complex", data.astype("complex64"), "complex"),
        ("structured", numpy.zeros((2, 3), [("a", "<f4"), ("b", "|u1")]), "fields"),
        ("object", numpy.array([[1, None]], dtype=object), "pickle"),
        ("text", data.astype("<U4"), "texts"),
        ("dates", data.astype("datetime64[s]"), "dates"),
        ("long-double", numpy.zeros((3, 6, 7), "longdouble"), "more than 64 bits"),
        ("no-axes", numpy.array(3.0), "0 axes"),
        ("no-values", numpy.zeros((0, 6, 7), "uint8"), "no values"),
        ("six-axes", numpy.zeros((2, 2, 2, 2, 2, 2), "uint8"), "6 axes"),
    ):
        path = written("refused-" + name, values)
        case(kind, name, relative(path), "numpy.lib.format", error=[word])

    def archive(name, compression=zipfile.ZIP_STORED, **arrays):
        path = at("numpy", name + ".npz")
        with zipfile.ZipFile(path, "w") as file:
            for key, values in arrays.items():
                content = io.BytesIO()
                numpy.lib.format.write_array(content, values)
                file.writestr(zipfile.ZipInfo(key + ".npy", (1980, 1, 1, 0, 0, 0)), content.getvalue(), compression)
        return path

    path = archive("one", image=data.astype("int16"))
    case(kind, "npz", relative(path), "NumPy", numpy.load(path)["image"])
    path = archive("deflated", zipfile.ZIP_DEFLATED, image=data.astype("float32"))
    case(kind, "npz-deflated", relative(path), "NumPy", numpy.load(path)["image"])
    path = archive("with-spacing", image=data.astype("int16"), spacing=numpy.array([1.0, 2.0, 3.0]))
    case(kind, "npz-with-list", relative(path), "NumPy", numpy.load(path)["image"], warns=["besides image"])
    path = archive("two", image=data.astype("int16"), mask=(data % 2).astype("uint8"))
    case(kind, "npz-two", relative(path), "NumPy", error=["image, mask"])


def pictures():
    kind = "pictures"

    def saved(name, picture, **options):
        path = at("pictures", name)
        picture.save(path, **options)
        return path

    grey = volume("uint8", (1, 6, 7))[0]
    wide = volume("uint16", (1, 6, 7), 60013)[0]
    rgb = volume("uint8", (6, 7, 3))

    def bare(name, size, depth, kind_of_color, rows, interlaced=0, more=()):
        """A PNG of whole rows, as Pillow writes none of 16-bit colours or opacity."""
        def chunk(name, content):
            return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        path = at("pictures", name)
        head = struct.pack(">IIBBBBB", size[0], size[1], depth, kind_of_color, 0, 0, interlaced)
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + b"".join(chunk(*m) for m in more) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))
        return path

    path = saved("grey-8.png", Picture.fromarray(grey))
    case(kind, "png-8", relative(path), "Pillow", numpy.array(Picture.open(path))[None], warns=["voxel spacing"])
    path = saved("grey-16.png", Picture.fromarray(wide))
    case(kind, "png-16", relative(path), "Pillow", numpy.array(Picture.open(path))[None])
    path = saved("bit.png", Picture.fromarray(grey < 100))
    case(kind, "png-1", relative(path), "Pillow", numpy.array(Picture.open(path)).astype(int)[None] * 255)
    path = saved("rgb.png", Picture.fromarray(rgb))
    case(kind, "png-rgb", relative(path), "Pillow", colors=numpy.array(Picture.open(path))[None], components=3)
    rows = b"".join(b"\0" + (rgb[y].astype(">u2") * 257).tobytes() for y in range(6))
    path = bare("rgb-16.png", (7, 6), 16, 2, rows)
    case(kind, "png-rgb-16", relative(path), "ISO 15948", colors=rgb[None].astype(int) * 257, components=3)
    table = Picture.fromarray((grey % 5).astype("uint8")).convert("P")
    table.putpalette([(n * 37) % 256 for n in range(768)])
    path = saved("palette.png", table)
    case(kind, "png-palette", relative(path), "Pillow", colors=numpy.array(Picture.open(path).convert("RGB"))[None], components=3, warns=["colour table"])
    table.putpalette([n // 3 for n in range(768)])
    path = saved("palette-grey.png", table)
    case(kind, "png-palette-grey", relative(path), "Pillow", numpy.array(Picture.open(path).convert("L"))[None])
    opacity = numpy.where(grey > 100, 255, 128).astype("uint8")
    path = saved("grey-alpha.png", Picture.merge("LA", [Picture.fromarray(grey), Picture.fromarray(opacity)]))
    case(kind, "png-grey-alpha", relative(path), "Pillow", numpy.array(Picture.open(path))[None, ..., 0], warns=["opacity"])
    pairs = numpy.stack([wide, numpy.full_like(wide, 30000)], -1)
    path = bare("grey-alpha-16.png", (7, 6), 16, 4, b"".join(b"\0" + pairs[y].astype(">u2").tobytes() for y in range(6)))
    case(kind, "png-grey-alpha-16", relative(path), "ISO 15948", wide[None], warns=["opacity"])
    for bits in (2, 4):
        values = (grey % (1 << bits)).astype("uint8")
        path = bare(f"grey-{bits}.png", (7, 6), bits, 0, b"".join(b"\0" + packed(values[y][None], bits).tobytes() for y in range(6)))
        case(kind, f"png-{bits}", relative(path), "Pillow", numpy.array(Picture.open(path).convert("L"))[None])
    passes = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]
    rows = b""
    for x, y, dx, dy in passes:
        part = grey[y::dy, x::dx]
        rows += b"".join(b"\0" + row.tobytes() for row in part if part.size)
    path = bare("interlaced.png", (7, 6), 8, 0, rows, 1)
    case(kind, "png-interlaced", relative(path), "Pillow", numpy.array(Picture.open(path))[None])
    path = bare("resolution.png", (7, 6), 8, 0, b"".join(b"\0" + r.tobytes() for r in grey), more=[(b"pHYs", struct.pack(">IIB", 11811, 11811, 1))])
    case(kind, "png-resolution", relative(path), "no invented spacing", grey[None], spacing_mm=[1, 1, 1], warns=["voxel spacing"])
    smooth = numpy.add.outer(numpy.arange(16) * 5, numpy.arange(16) * 7).astype("uint8")
    path = saved("grey.jpg", Picture.fromarray(smooth), quality=95)
    case(kind, "jpeg", relative(path), "Pillow", numpy.array(Picture.open(path))[None], tolerance=2)
    cmyk = Picture.merge("CMYK", [Picture.fromarray(c) for c in (smooth, smooth[::-1], smooth[:, ::-1], smooth // 4)])
    path = saved("cmyk.jpg", cmyk, quality=95)
    case(kind, "jpeg-cmyk", relative(path), "Pillow", colors=numpy.array(Picture.open(path).convert("RGB"))[None], components=3, tolerance=4, warns=["CMYK"])
    for name, content, word in (
        ("12-bit", imagecodecs.jpeg8_encode(smooth.astype("uint16") * 8, bitspersample=12, level=95), "12 bits"),
        ("lossless", imagecodecs.ljpeg_encode(smooth.astype("uint16") * 8, bitspersample=16), "lossless"),
        ("jpeg-ls", imagecodecs.jpegls_encode(smooth), "JPEG-LS"),
    ):
        path = at("pictures", f"{name}.jpg")
        path.write_bytes(content)
        case(kind, f"jpeg-{name}", relative(path), "ITU-T T.81 table B.1", error=[word])
    path = at("pictures", "packed.png.gz")
    path.write_bytes(gzip.compress(at("pictures", "grey-16.png").read_bytes(), mtime=0))
    case(kind, "png-gz", relative(path), "gzip", error=["gzip"])
    exif = Picture.Exif()
    exif[0x0112] = 6
    path = saved("turned.jpg", Picture.fromarray(smooth[:, :8]), quality=95, exif=exif)
    case(kind, "jpeg-orientation", relative(path), "Pillow", numpy.array(Picture.open(path))[None], tolerance=2, warns=["orientation 6"])

    def folder(name, files):
        for file, picture in files.items():
            saved(f"{name}/{file}", picture)
        return Path("pictures") / name

    stack = volume("uint16", (3, 6, 7), 60013)
    path = folder("sixteen", {f"s{n}.png": Picture.fromarray(stack[n]) for n in range(3)})
    case(kind, "folder-16", path, "Pillow", stack)
    path = folder("sizes", {"s1.png": Picture.fromarray(stack[0]), "s2.png": Picture.fromarray(stack[1, :4]), "s10.png": Picture.fromarray(stack[2])})
    case(kind, "folder-sizes", path, "Pillow", stack[[0, 2]], warns=["s2.png"])
    path = folder("kinds", {"s1.png": Picture.fromarray(stack[0]), "s2.png": Picture.fromarray(grey)})
    case(kind, "folder-kinds", path, "Pillow", stack[:1], warns=["s2.png"])
    for n in range(3):
        tiff(f"../pictures/white/s{n}.tif", stack[n], photometric="miniswhite")
    case(kind, "folder-white-is-zero", "pictures/white", "tifffile", stack, warns=["WhiteIsZero"])
    for n in range(3):
        Picture.fromarray(stack[n] % 3 == 0).save(at("pictures", "bits", f"s{n}.tif"), compression="group4")
    case(kind, "folder-bits", "pictures/bits", "Pillow", (stack % 3 == 0).astype(int))
    path = at("pictures", "nifti.zip")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(zipfile.ZipInfo("scan/x.nii.gz", (1980, 1, 1, 0, 0, 0)), gzip.compress(bytes(352), mtime=0))
    case(kind, "zip-of-nifti", relative(path), "file names", error=["scan/x.nii.gz", "no DICOM", "unpack it"])


if __name__ == "__main__":
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    tiff_bits()
    tiff_palette()
    tiff_planes()
    tiff_compression()
    tiff_ome_imagej()
    zarr_types()
    zarr_axes()
    zarr_codecs()
    numpy_types()
    pictures()
    (OUT / "cases.json").write_text(json.dumps(CASES, indent=1) + "\n")
