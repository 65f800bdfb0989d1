"""Texts in the character sets of PS3.3 C.12.1.1.2, and bytes that contradict their set."""

import numpy as np
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence

from .base import data_set, described, encoded, frame_groups, image, multiframe, one_item, opened
from .encoding import Style, encode, file_of, header, meta

# Name, character set, text.
TEXTS = (
    ("latin-1", "ISO_IR 100", "Schädel nativ, Übersicht"),
    ("latin-2", "ISO_IR 101", "Wątroba żółć"),
    ("latin-3", "ISO_IR 109", "Ĉapo ŝultro"),
    ("latin-4", "ISO_IR 110", "Galvas ķermeņi"),
    ("cyrillic", "ISO_IR 144", "Голова без контраста"),
    ("arabic", "ISO_IR 127", "رأس"),
    ("greek", "ISO_IR 126", "Κεφαλή"),
    ("hebrew", "ISO_IR 138", "ראש"),
    ("turkish", "ISO_IR 148", "Beyin ışığı"),
    ("thai", "ISO_IR 166", "ศีรษะ"),
    ("katakana", "ISO_IR 13", "ｱﾀﾏ"),
    ("utf-8", "ISO_IR 192", "頭部 Kopf Голова ศีรษะ"),
    ("utf-8-beyond-the-plane", "ISO_IR 192", "骨 𠮷 🦴"),
    ("gb18030", "GB18030", "头部平扫"),
    ("gb18030-four-bytes", "GB18030", "头 Ä 㐀"),
    ("gbk", "GBK", "头部增强"),
    ("jis-x-0208", ["", "ISO 2022 IR 87"], "頭部"),
    ("jis-x-0208-mixed", ["", "ISO 2022 IR 87"], "CT 頭部 plain 骨条件"),
    ("jis-x-0212", ["", "ISO 2022 IR 87", "ISO 2022 IR 159"], "頭 丂 侄"),
    ("katakana-and-kanji", ["ISO 2022 IR 13", "ISO 2022 IR 87"], "ｱﾀﾏ 頭部"),
    ("korean", ["", "ISO 2022 IR 149"], "머리 CT"),
    ("latin-and-greek", ["ISO 2022 IR 100", "ISO 2022 IR 126"], "Schädel Κεφαλή"),
    ("latin-and-cyrillic", ["ISO 2022 IR 100", "ISO 2022 IR 144"], "Schädel Голова"),
    ("ascii-and-latin-2", ["ISO 2022 IR 6", "ISO 2022 IR 101"], "Wątroba"),
    ("ascii-and-hebrew", ["", "ISO 2022 IR 138"], "CT ראש"),
    ("cyrillic-2022-alone", "ISO 2022 IR 144", "Голова"),
    ("latin-1-2022-alone", "ISO 2022 IR 100", "Schädel"),
)
# Name, character set as written, the bytes of the description.
BYTES = (
    ("latin-1-unstated", None, "Schädel".encode("latin-1")),
    ("latin-1-empty-set", "", "Schädel".encode("latin-1")),
    ("misspelt-utf-8", "ISO IR 192", "頭部".encode()),
    ("misspelt-latin-1", "ISO-IR 100", "Schädel".encode("latin-1")),
    ("misspelt-cyrillic", "ISO-IR 144", "Голова".encode("iso8859_5")),
    ("misspelt-2022", "ISO 2022-IR 100", "Schädel".encode("latin-1")),
    ("padded-set", "ISO_IR 100 ", "Schädel".encode("latin-1")),
    ("unknown-set", "ISO_IR 999", b"Head"),
    ("utf-8-with-latin-2", "ISO_IR 192\\ISO 2022 IR 101", "Schädel".encode()),
    ("padding", "ISO_IR 100", b"Head nativ   \0"),
    ("padding-zeros", "ISO_IR 100", b"Head\0\0\0\0"),
    ("leading-blank", "ISO_IR 100", b"  Head"),
    ("empty", "ISO_IR 100", b""),
    ("blank", "ISO_IR 100", b"    "),
)
# Name, character set, bytes and text, where pydicom writes or reads them wrongly.
WRITTEN = (
    ("latin-9", "ISO_IR 203", "Cœur 5 €".encode("iso8859_15"), "Cœur 5 €"),
    ("chinese-2022", "\\ISO 2022 IR 58", b"\x1b$)A" + "头部 CT".encode("gb2312"), "头部 CT"),
    ("chinese-2022-late", "\\ISO 2022 IR 58", b"CT \x1b$)A" + "头部".encode("gb2312"), "CT 头部"),
)
# Bytes whose text the standard does not say; only control characters must not come out.
CONTROL = (
    ("escape", "ISO_IR 100", b"\x1b[31mHead\x1b[0m"),
    ("return", "ISO_IR 100", b"Head\rNeck"),
    ("line-feed", "ISO_IR 192", b"Head\nNeck"),
    ("bell", "ISO_IR 100", b"Head\x07"),
    ("backspace", "ISO_IR 192", b"Head\x08\x08\x08\x08Foot"),
    ("title-of-terminal", "ISO_IR 192", b"\x1b]0;owned\x07Head"),
    ("delete", "ISO_IR 100", b"Head\x7f"),
    ("c1-control", "ISO_IR 100", b"Head\x9b31m"),
    ("utf-8-c1-control", "ISO_IR 192", "Head\u009b31m".encode()),
    ("zero-within", "ISO_IR 100", b"He\0ad"),
    ("utf-8-invalid", "ISO_IR 192", b"Head \xff\xfe\xc3"),
    ("escape-undeclared", "ISO_IR 100", b"\x1b$B\x46\x2c\x49\x74\x1b(B"),
    ("escape-unfinished", "\\ISO 2022 IR 87", b"Head \x1b$"),
    ("escape-unknown", "\\ISO 2022 IR 87", b"Head \x1b*Z\x1b"),
    ("utf-8-under-latin-1", "ISO_IR 100", "頭部 Schädel".encode()),
    ("utf-8-unstated", None, "頭部 Schädel".encode()),
    ("shift-jis", "ISO_IR 13", "頭部".encode("shift_jis")),
    ("kanji-unfinished", "\\ISO 2022 IR 87", b"\x1b$B\x46\x2c\x49"),
)
LABELS = (
    ("labels-latin-1", "ISO_IR 100", ("Schädel", "Leber")),
    ("labels-utf-8", "ISO_IR 192", ("肝臓", "Печень")),
    ("labels-kanji", ["", "ISO 2022 IR 87"], ("肝臓", "CT 骨")),
    ("labels-korean", ["", "ISO 2022 IR 149"], ("간", "머리")),
    ("labels-gb18030", "GB18030", ("肝脏", "骨")),
    ("labels-greek", "ISO_IR 126", ("ήπαρ", "οστό")),
)


def with_bytes(charset, text):
    """A file whose character set and description are given in bytes."""
    ds = image(0)
    part = lambda keep: sub(ds, keep)
    pad = lambda b, by: b + by * (len(b) % 2)
    set_bytes = b""
    if charset is not None:
        value = pad(charset.encode(), b" ")
        set_bytes = header(0x00080005, "CS", len(value), Style()) + value
    value = pad(text, b" ")
    description = header(0x0008103E, "LO", len(value), Style()) + value
    before, after = part(lambda tag: tag < 0x0008103E), part(lambda tag: tag > 0x0008103E)
    group = meta(image(0).file_meta)
    return bytes(128) + b"DICM" + group + set_bytes + encode(before) + description + encode(after)


def sub(ds, keep):
    out = Dataset()
    for element in ds:
        if keep(element.tag):
            out.add(element)
    return out


def segmentation(charset, names):
    """A segmentation of two segments, a frame each, beside one another."""
    pixels = np.zeros((2, 8, 8), np.uint8)
    pixels[0, 2:4, 2:4] = 1
    pixels[1, 5:7, 5:7] = 1
    frames = [
        frame_groups(0, SegmentIdentificationSequence=one_item(ReferencedSegmentNumber=n + 1))
        for n in range(2)
    ]
    ds = multiframe(pixels, SOPClassUID="1.2.840.10008.5.1.4.1.1.66.4", Modality="SEG",
                    SegmentationType="BINARY", BitsAllocated=1, BitsStored=1, HighBit=0,
                    SpecificCharacterSet=charset, PixelSpacing=None)
    ds.PixelData = np.packbits(pixels.ravel(), bitorder="little").tobytes()
    ds.SegmentSequence = Sequence(
        data_set(SegmentNumber=n + 1, SegmentLabel=name, SegmentAlgorithmType="MANUAL")
        for n, name in enumerate(names)
    )
    shared = data_set(
        PixelMeasuresSequence=one_item(PixelSpacing=[0.8, 0.6], SliceThickness=2.5),
        PlaneOrientationSequence=one_item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0]),
    )
    ds.SharedFunctionalGroupsSequence = Sequence([shared])
    ds.PerFrameFunctionalGroupsSequence = Sequence(frames)
    return ds


def make(cases):
    cases.kind = "characters"
    for name, charset, text in TEXTS:
        ds = image(0, SpecificCharacterSet=charset, SeriesDescription=text)
        data = encoded(ds)
        peer = "pydicom" if opened(data).SeriesDescription == text else "PS3.3 C.12.1.1.2"
        cases.one(name, data, described([ds]), peer, description=text)
    for name, charset, text in BYTES:
        data = with_bytes(charset, text)
        cases.one(name, data, described([image(0)]), "pydicom",
                  description=str(opened(data).get("SeriesDescription") or "").strip(" \0"))
    for name, charset, value, text in WRITTEN:
        data = with_bytes(charset, value)
        right = opened(data).SeriesDescription == text
        cases.one(name, data, described([image(0)]), "pydicom" if right else "PS3.3 C.12.1.1.2",
                  description=text)
    for name, charset, text in CONTROL:
        cases.one(name, with_bytes(charset, text), described([image(0)]), "no control characters")
    # Explicit elements in implicit files, and several series told apart by their descriptions.
    ds = image(0, SpecificCharacterSet=["", "ISO 2022 IR 87"], SeriesDescription="頭部")
    ds.file_meta.TransferSyntaxUID = "1.2.840.10008.1.2"
    cases.one("kanji-implicit", file_of(ds, Style(explicit=False)), described([ds]), description="頭部")
    series = [image(0, t, SeriesInstanceUID=f"1.2.3.4.{t}", SpecificCharacterSet="ISO_IR 144",
                    SeriesDescription=text) for t, text in enumerate(("Голова", "Печень"))]
    for n, text in enumerate(("Голова", "печень")):
        options = {"series": text}
        expected = {**described([series[n]]), "description": series[n].SeriesDescription, "series": 2}
        if n == 0:
            cases.stack("series-by-text", series, expected, options=options)
        else:
            cases.add("series-by-text-in-small", cases.where("series-by-text"), "pydicom", expected,
                      options=options)
    for name, charset, names in LABELS:
        data = encoded(segmentation(charset, names))
        read = [str(s.SegmentLabel) for s in opened(data).SegmentSequence]
        assert read == list(names), read
        values = [[2, 2, 0, 1], [5, 5, 0, 2], [0, 0, 0, 0]]
        cases.one(name, data, {"size": [8, 8, 1], "values": values}, "pydicom", modality="SEG",
                  labels={str(n + 1): text for n, text in enumerate(names)})
