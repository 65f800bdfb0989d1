"""Data sets as bytes, each element with any representation, length and byte order."""

import copy
import struct

import numpy as np
from pydicom.charset import convert_encodings
from pydicom.filebase import DicomBytesIO
from pydicom.filewriter import write_data_element
from pydicom.tag import Tag

LONG = {"OB", "OD", "OF", "OL", "OV", "OW", "SQ", "SV", "UC", "UN", "UR", "UT", "UV"}
UNDEFINED = 0xFFFFFFFF


class Style:
    """How an element is written."""

    def __init__(self, explicit=True, big=False, vr=None, undefined=False):
        # vr: instead of the element's own. undefined: sequences and items of undefined length.
        self.explicit, self.big, self.vr, self.undefined = explicit, big, vr, undefined

    def but(self, **changes):
        return Style(**{**vars(self), **changes})


def value_bytes(element, big, encodings):
    """The value of an element that is no sequence."""
    if element.tag == Tag("PixelData") or element.VR in ("OB", "OW") or element.VR == "UN":
        value = bytes(element.value)
        swap = big and element.VR == "OW"
        return np.frombuffer(value, "<u2").astype(">u2").tobytes() if swap else value
    out = DicomBytesIO()
    out.is_little_endian, out.is_implicit_VR = not big, True
    write_data_element(out, element, encodings)
    return out.getvalue()[8:]


def header(tag, vr, length, style):
    order = ">" if style.big else "<"
    start = struct.pack(order + "HH", tag >> 16, tag & 0xFFFF)
    if not style.explicit:
        return start + struct.pack(order + "I", length)
    if vr in LONG:
        return start + vr.encode() + b"\0\0" + struct.pack(order + "I", length)
    return start + vr.encode() + struct.pack(order + "H", length)


def bare(tag, length, big=False):
    """An item or a delimiter."""
    return header(tag, "", length, Style(explicit=False, big=big))


def sequence(items, style, choose, depth):
    out = b""
    for item in items:
        content = encode(item, style, choose, depth + 1)
        if style.undefined:
            out += bare(0xFFFEE000, UNDEFINED, style.big) + content + bare(0xFFFEE00D, 0, style.big)
        else:
            out += bare(0xFFFEE000, len(content), style.big) + content
    return out


def encode(ds, style=Style(), choose=lambda element, depth, style: style, depth=0):
    """A data set's elements; `choose` gives each its style.

    Items of a sequence follow its style, but those of a sequence of the representation UN are
    implicit little-endian (PS3.5 6.2.2).
    """
    out = []
    encodings = convert_encodings(ds.get("SpecificCharacterSet") or "ISO_IR 6")
    for element in ds:
        mine = choose(element, depth, style)
        vr = mine.vr or element.VR
        inner = mine.but(vr=None)
        if element.VR == "SQ":
            if vr == "UN":
                inner = inner.but(explicit=False, big=False)
            content = sequence(element.value, inner, choose if vr != "UN" else plain, depth)
            if mine.undefined:
                content += bare(0xFFFEE0DD, 0, inner.big)
                out.append(header(element.tag, vr, UNDEFINED, mine) + content)
                continue
        else:
            # Values of unknown representation are little-endian.
            content = value_bytes(element, mine.big and vr != "UN", encodings)
        out.append(header(element.tag, vr, len(content), mine) + content)
    return b"".join(out)


def plain(element, depth, style):
    return style


def meta(file_meta, length=None, without=()):
    """The meta group; `length` replaces its true length."""
    elements = copy.deepcopy(file_meta)
    for keyword in ("FileMetaInformationGroupLength", *without):
        if keyword in elements:
            delattr(elements, keyword)
    content = encode(elements)
    length = len(content) if length is None else length
    return header(0x00020000, "UL", 4, Style()) + struct.pack("<I", length) + content


def file_of(ds, style=Style(), choose=plain, preamble=bytes(128) + b"DICM"):
    """A whole file: preamble, meta group in explicit little-endian, data set."""
    return preamble + meta(ds.file_meta) + encode(ds, style, choose)


def undefined_lengths(element, depth, style):
    return style.but(undefined=True)
