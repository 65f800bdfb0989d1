"""Data sets that contradict their transfer syntax, and files without a proper beginning or end."""

import struct
import zlib

import numpy as np
from pydicom.dataset import Dataset
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
)

from .base import agrees, data_set, described, image, one_item, pattern
from .encoding import Style, UNDEFINED, bare, encode, file_of, header, meta, plain, undefined_lengths

EXPLICIT, IMPLICIT, BIG = Style(), Style(explicit=False), Style(big=True)
STANDARD = "PS3.5 7, PS3.10 7"
PREAMBLE = bytes(128) + b"DICM"


def one(cases, name, data, ds=None, ending=".dcm", **more):
    """A file of one slice; `ds` is what it would be if it were right."""
    ds = ds or image(0)
    cases.one(name, data, described([ds]), agrees([data], [ds], STANDARD), ending, **more)


def stack(cases, name, syntax, style, choose=plain):
    """Three slices whose meta group names a syntax, in another one."""
    files, datasets = [], []
    for k in range(3):
        ds = image(k, RescaleSlope="2", RescaleIntercept="-24")
        datasets.append(image(k, RescaleSlope="2", RescaleIntercept="-24"))
        ds.file_meta.TransferSyntaxUID = syntax
        files.append(file_of(ds, style, choose))
    cases.stack(name, files, described(datasets), agrees(files, datasets, STANDARD))


def contradictions(cases):
    stack(cases, "implicit-under-explicit", ExplicitVRLittleEndian, IMPLICIT)
    stack(cases, "explicit-under-implicit", ImplicitVRLittleEndian, EXPLICIT)
    stack(cases, "little-under-big", ExplicitVRBigEndian, EXPLICIT)
    stack(cases, "implicit-under-big", ExplicitVRBigEndian, IMPLICIT)
    stack(cases, "big-under-explicit", ExplicitVRLittleEndian, BIG)
    stack(cases, "big-under-implicit", ImplicitVRLittleEndian, BIG)
    stack(cases, "plain-under-deflated", DeflatedExplicitVRLittleEndian, EXPLICIT)
    # Explicit elements with implicit ones within sequences of the representation SQ.
    ds = image(0, ReferencedImageSequence=one_item(ReferencedSOPInstanceUID="1.2.3.4.0.1"),
               ContentDate="20200101")
    nested = lambda e, depth, s: s.but(explicit=depth == 0)
    one(cases, "implicit-in-sequences", file_of(ds, EXPLICIT, nested), ds)
    both = lambda e, depth, s: s.but(explicit=depth == 0, undefined=True)
    one(cases, "implicit-in-open-sequences", file_of(ds, EXPLICIT, both), ds)
    # An implicit first element whose length looks like the letters of a representation.
    ds = image(0, ImageType=None, SpecificCharacterSet=None)
    text = "X" * struct.unpack("<H", b"DS")[0]
    ds.ImageComments = text
    one(cases, "long-implicit-text", file_of(with_syntax(ds, ImplicitVRLittleEndian), IMPLICIT), image(0))


def with_syntax(ds, syntax):
    ds.file_meta.TransferSyntaxUID = syntax
    return ds


def beginnings(cases):
    whole = file_of(image(0))
    body = encode(image(0))
    group = meta(image(0).file_meta)
    implicit = encode(image(0), IMPLICIT)
    implicit_group = meta(with_syntax(image(0), ImplicitVRLittleEndian).file_meta)
    big_group = meta(with_syntax(image(0), ExplicitVRBigEndian).file_meta)
    one(cases, "dicm-first", b"DICM" + group + body)
    one(cases, "dicm-first-implicit", b"DICM" + implicit_group + implicit)
    one(cases, "meta-first", group + body)
    one(cases, "meta-first-implicit", implicit_group + implicit)
    one(cases, "meta-first-big", big_group + encode(image(0), BIG))
    one(cases, "preamble-without-meta", PREAMBLE + body)
    one(cases, "preamble-without-meta-implicit", PREAMBLE + implicit)
    one(cases, "preamble-without-meta-big", PREAMBLE + encode(image(0), BIG))
    one(cases, "preamble-of-a-tiff", b"II*\0" + whole[4:], ending="")
    one(cases, "preamble-of-letters", b"X" * 128 + whole[128:])
    one(cases, "preamble-alone", bytes(128) + group + body)
    for name, content in (("", body), ("-implicit", implicit)):
        short = meta(image(0).file_meta, without=("TransferSyntaxUID",))
        one(cases, "no-syntax" + name, PREAMBLE + short + content)
    # Without (0002,0000), and with wrong lengths in it.
    one(cases, "no-group-length", PREAMBLE + group[12:] + body)
    one(cases, "no-group-length-implicit", PREAMBLE + implicit_group[12:] + implicit)
    for name, length in (("zero", 0), ("short", 40), ("long", len(group) + 30), ("odd", 999999)):
        wrong = meta(image(0).file_meta, length=length)
        one(cases, f"group-length-{name}", PREAMBLE + wrong + body)
    implicit_meta = encode(image(0).file_meta, IMPLICIT)
    one(cases, "meta-implicit", PREAMBLE + implicit_meta + body)
    padded = image(0)
    padded.file_meta.TransferSyntaxUID = "1.2.840.10008.1.2.1 "
    one(cases, "syntax-padded-with-blanks", file_of(padded), image(0))


def bare_data_sets(cases):
    """Data sets without meta group, their first element of any kind and length."""
    types = {
        "short": ["ORIGINAL", "PRIMARY"],
        "72": ["ORIGINAL", "PRIMARY", "M", "ND", "NORM", "FM", "FIL", "DIS2D", "MFSPLIT", "SUB", "A" * 16],
        "132": ["ORIGINAL", "PRIMARY"] + ["N" * 15] * 7,
        "300": ["ORIGINAL", "PRIMARY"] + ["N" * 15] * 18,
    }
    for name, value in types.items():
        ds = image(0, ImageType=value)
        one(cases, f"bare-type-{name}", encode(ds), ds)
        one(cases, f"bare-type-{name}-implicit", encode(ds, IMPLICIT), ds)
    for name, attributes in {
        "character-set": {"SpecificCharacterSet": "ISO_IR 100"},
        "empty-character-set": {"SpecificCharacterSet": ""},
        "length-to-end": {"LengthToEnd": 0x300},
        "class": {},
        "creation-date": {"InstanceCreationDate": "20200101"},
    }.items():
        ds = image(0, **attributes)
        if "LengthToEnd" in ds:
            ds["LengthToEnd"].VR = "UL"
        for ending, style in (("", EXPLICIT), ("-implicit", IMPLICIT)):
            one(cases, f"bare-{name}{ending}", encode(ds, style), ds)
    one(cases, "bare-big", encode(image(0), BIG))
    ds = image(0)
    body = encode(ds, IMPLICIT)
    length = bare(0x00080000, 4) + struct.pack("<I", 200)
    one(cases, "bare-group-length-implicit", length + body, ds)
    explicit = header(0x00080000, "UL", 4, EXPLICIT) + struct.pack("<I", 200)
    one(cases, "bare-group-length", explicit + encode(ds), ds)
    one(cases, "bare-no-extension", body, ds, ending="")


def deflated(cases):
    def packed(ds, tail=b""):
        group = meta(with_syntax(ds, DeflatedExplicitVRLittleEndian).file_meta)
        deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
        return PREAMBLE + group + deflate.compress(encode(ds)) + deflate.flush() + tail

    one(cases, "deflated", packed(image(0)))
    one(cases, "deflated-padded", packed(image(0), b"\0"))
    one(cases, "deflated-padded-512", packed(image(0), bytes(512)))
    group = meta(with_syntax(image(0), DeflatedExplicitVRLittleEndian).file_meta)
    one(cases, "deflated-with-zlib-header", PREAMBLE + group + zlib.compress(encode(image(0)), 9))


def endings(cases):
    whole = file_of(image(0))
    padding = header(0xFFFCFFFC, "OB", 10, EXPLICIT) + bytes(10)
    one(cases, "trailing-padding", whole + padding)
    one(cases, "trailing-padding-big", whole + header(0xFFFCFFFC, "OB", 2000, EXPLICIT) + bytes(2000))
    one(cases, "trailing-zeros", whole + bytes(512))
    one(cases, "trailing-zero", whole + b"\0")
    one(cases, "trailing-ff", whole + b"\xff" * 37)
    one(cases, "trailing-text", whole + b"\r\n-- end of file --\r\n")
    one(cases, "trailing-signature", whole + encode(data_set(DigitalSignaturesSequence=[data_set()])))
    ds = image(0)
    ds.PixelData += bytes(14)
    one(cases, "pixel-data-padded", file_of(ds), image(0))
    ds = image(0, pixels=pattern(0, columns=5, dtype=np.uint8))
    ds.PixelData = ds.PixelData[:25]
    one(cases, "pixel-data-odd", file_of(ds), image(0, pixels=pattern(0, columns=5, dtype=np.uint8)))
    trailing = encode(data_set(DataSetTrailingPadding=b"\0" * 6))
    ds = image(0, pixels=pattern(0, columns=5, dtype=np.uint8))
    odd = encode(with_pixels(ds, ds.PixelData[:25]))
    start = file_of(ds)[: -len(encode(ds)) or None]
    one(cases, "pixel-data-odd-then-padding", start + odd + trailing, ds_of_odd())
    one(cases, "signed-text-lengths", odd_lengths(), image(0, SeriesDescription="Kopf"))


def with_pixels(ds, data):
    ds.PixelData = data
    return ds


def ds_of_odd():
    return image(0, pixels=pattern(0, columns=5, dtype=np.uint8))


def odd_lengths():
    """Texts of odd length, which the standard forbids."""
    ds = image(0)
    start, rest = Dataset(), Dataset()
    for element in ds:
        (start if element.tag < 0x0008103E else rest).add(element)
    text = header(0x0008103E, "LO", 5, EXPLICIT) + b"Kopf "
    group = meta(ds.file_meta)
    return PREAMBLE + group + encode(start) + text + encode(rest)


def disorder(cases):
    """Elements where they do not belong."""
    ds = image(0)
    command = header(0x00000000, "UL", 4, IMPLICIT) + struct.pack("<I", 10)
    command += header(0x00000100, "US", 2, IMPLICIT) + struct.pack("<H", 1)
    body, implicit = encode(ds), encode(ds, IMPLICIT)
    implicit_group = meta(with_syntax(image(0), ImplicitVRLittleEndian).file_meta)
    one(cases, "command-bare-implicit", command + implicit)
    one(cases, "command-after-meta-implicit", PREAMBLE + implicit_group + command + implicit)
    explicit = header(0x00000000, "UL", 4, EXPLICIT) + struct.pack("<I", 10)
    explicit += header(0x00000100, "US", 2, EXPLICIT) + struct.pack("<H", 1)
    one(cases, "command-after-meta", PREAMBLE + meta(ds.file_meta) + explicit + body)
    one(cases, "group-lengths", grouped(999))
    one(cases, "group-lengths-zero", grouped(0))
    first, second = Dataset(), Dataset()
    for element in ds:
        (first if element.tag.group == 0x28 else second).add(element)
    one(cases, "out-of-order", PREAMBLE + meta(ds.file_meta) + encode(first) + encode(second))
    ds = image(0, ReferencedImageSequence=one_item(ReferencedSOPInstanceUID="1.2.3.4.0.1"))
    data = file_of(ds, EXPLICIT, undefined_lengths)
    end = bare(0xFFFEE0DD, 0)
    assert data.count(end) == 1
    one(cases, "delimiter-with-length", data.replace(end, bare(0xFFFEE0DD, 4)), ds)
    item_end = bare(0xFFFEE00D, 0)
    one(cases, "item-delimiter-with-length", data.replace(item_end, bare(0xFFFEE00D, 8)), ds)
    one(cases, "bytes-of-words", file_of(ds, EXPLICIT, pixel_vr("OB")), ds)
    bytes_ = image(0, pixels=pattern(0, dtype=np.uint8))
    one(cases, "words-of-bytes", file_of(bytes_, EXPLICIT, pixel_vr("OW")), bytes_)
    unknown_syntax = with_syntax(image(0), "1.2.840.113619.5.2")
    pixels = unknown_syntax["PixelData"]
    unknown_syntax.PixelData = np.frombuffer(pixels.value, "<u2").astype(">u2").tobytes()
    data = file_of(unknown_syntax, IMPLICIT)
    cases.one("ge-implicit-big-pixels", data, described([image(0)]),
              agrees([data], [image(0)], "DCMTK"))
    cases.one("encapsulated-uncompressed", encapsulated(), described([image(0)]), "PS3.5 A.4.11")


def pixel_vr(vr):
    return lambda e, depth, s: s.but(vr=vr) if e.keyword == "PixelData" else s


def grouped(length):
    """Every group begins with its length, which is wrong."""
    ds, out = image(0), b""
    for group in sorted({e.tag.group for e in ds}):
        part = Dataset()
        for element in ds:
            if element.tag.group == group:
                part.add(element)
        out += header(group << 16, "UL", 4, EXPLICIT) + struct.pack("<I", length) + encode(part)
    return PREAMBLE + meta(ds.file_meta) + out


def encapsulated():
    ds = with_syntax(image(0), "1.2.840.10008.1.2.1.98")
    data = ds.PixelData
    del ds.PixelData
    pixels = header(0x7FE00010, "OB", UNDEFINED, EXPLICIT) + bare(0xFFFEE000, 0)
    pixels += bare(0xFFFEE000, len(data)) + data + bare(0xFFFEE0DD, 0)
    return file_of(ds) + pixels


def make(cases):
    cases.kind = "syntax"
    contradictions(cases)
    beginnings(cases)
    bare_data_sets(cases)
    deflated(cases)
    endings(cases)
    disorder(cases)
