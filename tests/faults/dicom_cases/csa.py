"""The private header of Siemens MR images, in its second form ("SV10")."""

import struct


def tag(name, vr, values):
    """An element: its name, representation and values as text."""
    out = name.encode().ljust(64, b"\0")
    out += struct.pack("<i4siii", len(values), vr.encode().ljust(4, b"\0"), 0, 6, 77)
    for position in range(6):
        text = (values[position] if position < len(values) else "").encode()
        text = text + b"\0" if text else text
        out += struct.pack("<4i", len(text), len(text), 77, len(text))
        out += text.ljust(-(-len(text) // 4) * 4, b"\0")
    return out


def csa_header(images, normal, matrix="5p*6"):
    """A header with the number of images in a mosaic, the normal and the size of its slices."""
    tags = [
        tag("EchoLinePosition", "IS", ["32"]),
        tag("AcquisitionMatrixText", "SH", [matrix]),
        tag("SliceNormalVector", "FD", [f"{v:.8f}" for v in normal]),
        tag("NumberOfImagesInMosaic", "US", [str(images)]),
        tag("PhaseEncodingDirectionPositive", "IS", []),
    ]
    data = b"SV10\4\3\2\1" + struct.pack("<ii", len(tags), 77) + b"".join(tags)
    return data + b"\0" * (len(data) % 2)
