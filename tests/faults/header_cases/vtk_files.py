"""VTK's legacy and XML files. What must come out follows the format: "VTK file formats" (VTK User's
Guide), vtkDataReader and vtkXMLDataParser."""

import struct

import numpy as np

from .base import SIZE, in_file, some_values, values

LEGACY, XML = "vtk", "vti"
GRID = f"DIMENSIONS {SIZE[0]} {SIZE[1]} {SIZE[2]}\nSPACING 0.5 0.75 2\nORIGIN 1 2 3\n"
COUNT = int(np.prod(SIZE))
CELLS = int(np.prod(np.array(SIZE) - 1))
V = values(np.int16)
SCALARS = "SCALARS s short\nLOOKUP_TABLE default\n"
PLAIN = {"size": list(SIZE), "values": some_values(V), "spacing_mm": [0.5, 0.75, 2], "origin_mm": [1, 2, 3]}


def ascii_of(array):
    """Values as text, a row a line."""
    flat = array.ravel(order="F").tolist()
    return "\n".join(" ".join(map(str, flat[n : n + 9])) for n in range(0, len(flat), 9)) + "\n"


def binary(array):
    return in_file(array, ">") + b"\n"


def make(cases):
    make_legacy(cases)
    make_xml(cases)


def make_legacy(cases):
    def case(name, *parts, form="BINARY", grid=GRID, expected=PLAIN, peer="vtkDataReader", **more):
        path = f"vtk/{name}.vtk"
        head = f"# vtk DataFile Version 3.0\na title\n{form}\nDATASET STRUCTURED_POINTS\n{grid}"
        cases.write(path, head, *parts)
        cases.add(LEGACY, name, path, peer, **expected | more)

    points, cells = f"POINT_DATA {COUNT}\n", f"CELL_DATA {CELLS}\n"
    three = np.stack([V, V + 1, V + 2]).astype(np.float32)
    nine = np.zeros((9, *SIZE), np.float32)
    scalars = (SCALARS, binary(V))
    case("scalars", points, *scalars, not_warns=["also holds", "1 mm"])
    case("normals-first", points, "NORMALS n float\n", binary(three), *scalars, components=1, warns=["n (NORMALS)"])
    case("vectors-first", points, "VECTORS v float\n", binary(three), *scalars, components=1, warns=["v (VECTORS)"])
    case("tensors-first", points, "TENSORS t float\n", binary(nine), *scalars, warns=["t (TENSORS)"])
    case("textures-first", points, "TEXTURE_COORDINATES u 2 float\n", binary(three[:2]), *scalars, warns=["u (TEXTURE"])
    field = (f"FIELD FieldData 2\np 1 {COUNT} float\n", binary(three[0]), f"q 1 {COUNT} double\n", binary(V / 8))
    case("field-first", points, *field, *scalars, warns=["p (FIELD), q (FIELD)"])
    case("two-fields", points, *field, values=some_values(V), warns=["q (FIELD)"])
    case("second-scalars", points, *scalars, SCALARS.replace(" s ", " t "), binary(V + 1), warns=["t (SCALARS)"])
    case(
        "scalars-with-table",
        points,
        "SCALARS s short\nLOOKUP_TABLE mine\n",
        binary(V),
        "LOOKUP_TABLE mine 2\n",
        bytes(8),
        "\nVECTORS v float\n",
        binary(three),
        warns=["v (VECTORS)"],
    )
    metadata = "METADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 1 2\n\n"
    case("metadata-between", points, "VECTORS v float\n", binary(three), metadata, *scalars, warns=["v (VECTORS)"])
    of_cells = ("SCALARS c short\nLOOKUP_TABLE default\n", binary(V[:-1, :-1, :-1] + 5))
    case("cells-first", cells, *of_cells, points, *scalars, warns=["c (SCALARS of cells)"])
    case("cells-last", points, *scalars, cells, *of_cells, warns=["c (SCALARS of cells)"])
    case(
        "cells-alone",
        cells,
        *of_cells,
        expected={"size": [4, 5, 3], "values": some_values(V[:-1, :-1, :-1] + 5)},
        origin_mm=[1.25, 2.375, 4],
        not_warns=["also holds"],
    )
    case(
        "text-normals-first",
        points,
        "NORMALS n float\n",
        ascii_of(three),
        SCALARS,
        ascii_of(V),
        form="ASCII",
        warns=["n (NORMALS)"],
    )
    case(
        "text-field-first",
        points,
        f"FIELD FieldData 1\np 1 {COUNT} float\n",
        ascii_of(three[0]),
        SCALARS,
        ascii_of(V),
        form="ASCII",
        warns=["p (FIELD)"],
    )
    time = ("FIELD FieldData 1\nTIME 1 1 double\n", struct.pack(">d", 3.5), "\n")
    case("field-of-the-data-set", *time, points, *scalars, not_warns=["TIME"])
    index = "SCALARS s vtkIdType\nLOOKUP_TABLE default\n"
    case("indices", points, index, binary(V.astype(np.int32)))
    no_spacing = GRID.replace("SPACING 0.5 0.75 2\n", "")
    case("no-spacing", points, *scalars, grid=no_spacing, spacing_mm=[1, 1, 1], warns=["1 mm is assumed"])
    case("aspect-ratio", points, *scalars, grid=GRID.replace("SPACING", "ASPECT_RATIO"), not_warns=["1 mm"])
    case("tensors-alone", points, "TENSORS t float\n", binary(nine), expected={}, error=["TENSORS"])
    case("truncated", points, "NORMALS n float\n", binary(three), SCALARS, binary(V)[:-9], expected={}, error=["truncated"])


def make_xml(cases):
    extent = " ".join(f"0 {n - 1}" for n in SIZE)

    def case(name, array, spacing='Spacing="0.5 0.75 2"', expected=PLAIN, **more):
        path = f"vtk/{name}.vti"
        cases.write(
            path,
            f'<?xml version="1.0"?>\n<VTKFile type="ImageData" version="0.1" byte_order="LittleEndian">\n'
            f'<ImageData WholeExtent="{extent}" Origin="1 2 3" {spacing}>\n<Piece Extent="{extent}">\n'
            f"<PointData>{array}</PointData>\n</Piece></ImageData></VTKFile>\n",
        )
        cases.add(XML, name, path, "vtkXMLDataParser", **expected | more)

    tag = '<DataArray type="Int16" Name="s" format="ascii">'
    numbers = " ".join(map(str, V.ravel(order="F").tolist()))
    case("text", f"{tag}\n{numbers}\n</DataArray>", not_warns=["1 mm"])
    case("text-touches-the-tag", f"{tag}{numbers}</DataArray>")
    real = tag.replace("Int16", "Float64")
    case("text-of-reals", f"{real}{numbers}</DataArray>")
    case("text-too-short", f"{tag}{numbers[:-4]}</DataArray>", expected={}, error=["contains 119 of 120"])
    case("no-spacing", f"{tag}{numbers}</DataArray>", spacing="", spacing_mm=[1, 1, 1], warns=["1 mm is assumed"])
