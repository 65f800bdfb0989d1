"""Transforms of ITK in its formats; SimpleITK maps the points, from the deformed point to its source,
in LPS. Types that SimpleITK reads only within a composite are wrapped in one for that."""

import math
import os
import struct
import tempfile

import h5py
import numpy as np
import SimpleITK

KIND = "itk transforms"
POINTS = [(0.0, 0.0, 0.0), (10.0, -20.0, 30.0), (-40.0, 25.0, -15.0)]
MATRIX = [1, 0.1, 0, -0.1, 1.1, 0.05, 0, 0.02, 0.9]
CENTER = [4, 5, 6]
GRID = [4, 4, 4, 0, 0, 0, 10, 10, 10, 1, 0, 0, 0, 1, 0, 0, 0, 1]


def text(*transforms):
    """ITK's text format: (type, parameters, fixed parameters)."""
    out = "#Insight Transform File V1.0\n"
    for n, (kind, parameters, fixed) in enumerate(transforms):
        out += f"#Transform {n}\nTransform: {kind}\n"
        if not kind.startswith("Composite"):
            out += f"Parameters: {' '.join(f'{p:.9g}' for p in parameters)}\nFixedParameters: {' '.join(f'{p:.9g}' for p in fixed)}\n"
    return out


def matlab(*transforms):
    """MATLAB 4: a matrix named by the type, and one of the fixed parameters."""
    out = b""
    for kind, parameters, fixed in transforms:
        for name, numbers in ((kind, parameters), ("fixed", fixed)):
            name = name.encode() + b"\0"
            out += (
                struct.pack("<5i", 0, len(numbers), 1, 0, len(name))
                + name
                + struct.pack(f"<{len(numbers)}d", *numbers)
            )
    return out


def mapped(transform, points):
    return [[*p, *map(float, transform.TransformPoint(p))] for p in points]


def of_itk(content, points):
    """What SimpleITK maps the points to, by a composite of the transforms in a text."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "a.tfm")
        if "Composite" not in content:
            first, rest = content.split("\n", 1)
            kind = rest.split("Transform: ")[1].split("\n")[0]
            precision = "float" if "_float" in kind else "double"
            content = (
                f"{first}\n#Transform 0\nTransform: CompositeTransform_{precision}_3_3\n{rest}"
            )
        with open(path, "w") as file:
            file.write(content)
        return mapped(SimpleITK.ReadTransform(path), points)


def wave(n, seed=1):
    return [round(2 * math.sin(0.7 * k + seed), 6) for k in range(n)]


def slow_wave(n):
    """Numbers that change little from point to point: a chain is sampled on one grid."""
    return [round(2 * math.sin(0.01 * k + 1), 6) for k in range(n)]


def affines():
    d = "_double_3_3"
    versor = [0.1, 0.2, 0.3]
    return [
        ("identity", "IdentityTransform" + d, [], []),
        ("affine", "AffineTransform" + d, MATRIX + [1, 2, 3], CENTER),
        ("affine-float", "AffineTransform_float_3_3", MATRIX + [1, 2, 3], CENTER),
        ("matrix-offset", "MatrixOffsetTransformBase" + d, MATRIX + [1, 2, 3], CENTER),
        ("fixed-center", "FixedCenterOfRotationAffineTransform" + d, MATRIX + [1, 2, 3], CENTER),
        ("scalable", "ScalableAffineTransform" + d, MATRIX + [1, 2, 3], CENTER),
        ("centered-affine", "CenteredAffineTransform" + d, MATRIX + CENTER + [1, 2, 3], CENTER),
        ("translation", "TranslationTransform" + d, [1, 2, 3], []),
        ("scale", "ScaleTransform" + d, [1.1, 1.2, 0.9], CENTER),
        ("scale-logarithmic", "ScaleLogarithmicTransform" + d, [0.1, 0.2, -0.1], CENTER),
        ("euler", "Euler3DTransform" + d, [0.1, 0.2, 0.3, 1, 2, 3], CENTER),
        ("euler-float", "Euler3DTransform_float_3_3", [0.1, 0.2, 0.3, 1, 2, 3], CENTER),
        ("euler-zxy", "Euler3DTransform" + d, [0.1, 0.2, 0.3, 1, 2, 3], CENTER + [0]),
        ("euler-zyx", "Euler3DTransform" + d, [0.1, 0.2, 0.3, 1, 2, 3], CENTER + [1]),
        (
            "centered-euler",
            "CenteredEuler3DTransform" + d,
            [0.1, 0.2, 0.3] + CENTER + [1, 2, 3],
            CENTER,
        ),
        (
            "centered-euler-zyx",
            "CenteredEuler3DTransform" + d,
            [0.1, 0.2, 0.3] + CENTER + [1, 2, 3],
            CENTER + [1],
        ),
        ("versor", "VersorTransform" + d, versor, CENTER),
        ("versor-rigid", "VersorRigid3DTransform" + d, versor + [1, 2, 3], CENTER),
        (
            "quaternion-rigid",
            "QuaternionRigidTransform" + d,
            [0.1, 0.2, 0.3, math.sqrt(0.86), 1, 2, 3],
            CENTER,
        ),
        (
            "quaternion-not-unit",
            "QuaternionRigidTransform" + d,
            [0.1, 0.2, 0.3, 0.9, 1, 2, 3],
            CENTER,
        ),
        ("similarity", "Similarity3DTransform" + d, versor + [1, 2, 3, 1.2], CENTER),
        ("scale-versor", "ScaleVersor3DTransform" + d, versor + [1, 2, 3, 1.1, 1.2, 1.3], CENTER),
        (
            "scale-skew-versor",
            "ScaleSkewVersor3DTransform" + d,
            versor + [1, 2, 3, 1.1, 1.2, 1.3, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06],
            CENTER,
        ),
        (
            "compose-scale-skew-versor",
            "ComposeScaleSkewVersor3DTransform" + d,
            versor + [1, 2, 3, 1.1, 1.2, 1.3, 0.01, 0.02, 0.03],
            CENTER,
        ),
    ]


def make(cases):
    def add(name, content, points, ending="tfm", right=None, **more):
        path = f"itk/{name}.{ending}"
        cases.write(path, content)
        cases.add(KIND, name, path, "SimpleITK", points=right or of_itk(content, points), **more)

    for name, *entry in affines():
        add(name, text(entry), POINTS)
    for name, *entry in affines()[1:3] + affines()[10:11]:
        add(f"{name}-matlab", matlab(entry), [], "mat", of_itk(text(entry), POINTS))
        add(f"{name}-txt", text(entry), POINTS, "txt")
    # SimpleITK writes an empty matrix where a type has no numbers.
    add("translation-matlab", matlab(affines()[7][1:]), [], "mat", of_itk(text(affines()[7][1:]), POINTS))
    add("identity-matlab", matlab(affines()[0][1:]), [], "mat", of_itk(text(affines()[0][1:]), POINTS))
    long = [0.8, 0.7, 0.3]
    for name, kind, more in (
        ("versor-rigid", "VersorRigid3DTransform", []),
        ("similarity", "Similarity3DTransform", [1.2]),
        ("scale-versor", "ScaleVersor3DTransform", [1.1, 1.2, 1.3]),
        ("scale-skew-versor", "ScaleSkewVersor3DTransform", [1.1, 1.2, 1.3] + [0.1] * 6),
        ("compose-scale-skew", "ComposeScaleSkewVersor3DTransform", [1.1, 1.2, 1.3] + [0.1] * 3),
    ):
        entry = (f"{kind}_double_3_3", long + [1, 2, 3] + more, CENTER)
        add(f"{name}-too-long", text(entry), POINTS, warns=["length 1.10"])
    half = ("VersorRigid3DTransform_double_3_3", [0.6, 0.8, 0, 1, 2, 3], CENTER)
    add("versor-rigid-half-turn", text(half), POINTS)
    crlf = text(affines()[1][1:]).replace("\n", "\r\n")
    add("crlf", crlf, [], right=of_itk(crlf.replace("\r", ""), POINTS))
    make_composites(add)
    make_grids(add)
    make_files(cases, add)
    make_refusals(cases)


def make_composites(add):
    composite = ("CompositeTransform_double_3_3", [], [])
    _, *affine = affines()[1]
    _, *euler = affines()[10]
    _, *scale = affines()[8]
    add("composite", text(composite, affine, euler), POINTS)
    add("composite-of-three", text(composite, euler, scale, affine), POINTS)
    add("composite-of-one", text(composite, euler), POINTS)
    field = ("DisplacementFieldTransform_double_3_3", slow_wave(3 * 64), GRID)
    inside = [(3.0, 4.0, 5.0), (10.0, 20.0, 7.0), (25.0, 11.0, 16.0)]
    shift = ("TranslationTransform_double_3_3", [1, 2, 3], [])
    add(
        "composite-field-after-translation",
        text(composite, field, shift),
        [(10.0, 16.0, 12.0), (14.0, 8.0, 20.0)],
        tolerance=0.05,
    )
    two = text(affine, euler)
    add(
        "two-without-composite", two, [], right=of_itk(text(affine), POINTS), warns=["2 transforms"]
    )


def make_grids(add):
    inside = [(12.0, 13.0, 14.0), (10.0, 20.0, 15.0), (17.5, 11.0, 16.0)]
    for order in (1, 2, 3):
        suffix = "" if order == 3 else f"_{order}"
        entry = (f"BSplineTransform_double_3_3{suffix}", wave(3 * 64), GRID)
        add(f"bspline-order-{order}", text(entry), inside, tolerance=0.02)
    # ITK's class moves nothing at order 0.
    add(
        "bspline-order-0",
        text(("BSplineTransform_double_3_3_0", wave(3 * 64), GRID)),
        inside,
        warns=["order 0"],
    )
    fine = [5, 4, 6, -20, -10, -30, 10, 12, 11, 0.8, -0.6, 0, 0.6, 0.8, 0, 0, 0, 1]
    entry = ("BSplineTransform_double_3_3", wave(3 * 120), fine)
    m = np.array(fine[9:18]).reshape(3, 3) @ np.diag(fine[6:9])
    points = [
        tuple(float(x) for x in np.array(fine[3:6]) + m @ np.array(v))
        for v in ([1.5, 1.5, 2], [2.2, 1.9, 4], [3, 1.1, 1.2])
    ]
    add("bspline-oblique", text(entry), points, tolerance=0.02)
    add(
        "bspline-float",
        text(("BSplineTransform_float_3_3", wave(3 * 120), fine)),
        points,
        tolerance=0.02,
    )
    old = ("BSplineDeformableTransform_double_3_3", wave(3 * 64), GRID)
    add(
        "bspline-deformable",
        text(old),
        [],
        right=of_itk(text(("BSplineTransform_double_3_3", *old[1:])), inside),
        tolerance=0.02,
    )
    composite = ("CompositeTransform_double_3_3", [], [])
    shift = ("TranslationTransform_double_3_3", [1, 2, 3], [])
    add(
        "bspline-in-a-composite",
        text(composite, shift, ("BSplineTransform_double_3_3", slow_wave(3 * 64), GRID)),
        [(14.0, 14.5, 15.0), (13.0, 16.0, 12.0)],
        tolerance=0.05,
    )
    small = [3, 2, 2, *GRID[3:]]
    for kind in (
        "DisplacementFieldTransform",
        "GaussianSmoothingOnUpdateDisplacementFieldTransform",
        "BSplineSmoothingOnUpdateDisplacementFieldTransform",
    ):
        for precision in ("double", "float"):
            entry = (f"{kind}_{precision}_3_3", wave(3 * 12), small)
            add(
                f"{kind[:12].lower()}-{precision}",
                text(entry),
                [(0.0, 10.0, 0.0), (3.0, 4.0, 5.0), (19.0, 9.0, 6.0)],
            )


def make_files(cases, add):
    def h5(name, entries, precision="f8", misspelt=False):
        path = cases.path(f"itk/{name}.h5")
        with h5py.File(path, "w", libver=("earliest", "v108")) as file:
            group = file.create_group("TransformGroup", track_order=False)
            for n, (kind, parameters, fixed) in enumerate(entries):
                one = group.create_group(str(n))
                text_type = h5py.string_dtype("ascii")
                one.create_dataset(
                    "TransformType", data=np.array([kind.encode()], object), dtype=text_type
                )
                if not kind.startswith("Composite"):
                    word = "Tranform" if misspelt else "Transform"
                    one.create_dataset(f"{word}FixedParameters", data=np.array(fixed, precision))
                    one.create_dataset(f"{word}Parameters", data=np.array(parameters, precision))
        return f"itk/{name}.h5"

    composite = ("CompositeTransform_double_3_3", [], [])
    _, *affine = affines()[1]
    _, *euler = affines()[10]
    for name, entries, more in [
        ("hdf5-affine", [affine], {}),
        ("hdf5-misspelt", [affine], {"misspelt": True}),
        ("hdf5-composite", [composite, affine, euler], {}),
        ("hdf5-float", [("AffineTransform_float_3_3", *affine[1:])], {"precision": "f4"}),
    ]:
        path = h5(name, entries, **more)
        cases.add(
            KIND,
            name,
            path,
            "SimpleITK",
            points=of_itk(text(*entries), POINTS),
            note="needs the feature hdf5",
        )
    add(
        "matlab-float",
        matlab(("AffineTransform_float_3_3", *affine[1:])),
        [],
        "mat",
        of_itk(text(affine), POINTS),
    )
    chain = SimpleITK.CompositeTransform(
        [
            SimpleITK.TranslationTransform(3, (1, 2, 3)),
            SimpleITK.Euler3DTransform(CENTER, 0.1, 0.2, 0.3),
        ]
    )
    SimpleITK.WriteTransform(chain, cases.path("itk/composite.mat"))
    cases.add(
        KIND,
        "matlab-composite",
        "itk/composite.mat",
        "SimpleITK refuses it, too",
        error=["composite", ".h5"],
    )


def make_refusals(cases):
    d = "_double_3_3"
    landmarks = [0, 0, 0, 10, 0, 0, 0, 10, 0, 0, 0, 10]
    for name, content, fragments in [
        (
            "versor-too-long",
            text(("VersorTransform" + d, [0.8, 0.7, 0.3], CENTER)),
            ["versor", "longer than 1"],
        ),
        (
            "azimuth",
            text(("AzimuthElevationToCartesianTransform" + d, MATRIX + [0, 0, 0], CENTER)),
            ["AzimuthElevation"],
        ),
        (
            "thin-plate",
            text(("ThinPlateSplineKernelTransform" + d, landmarks, landmarks)),
            ["ThinPlateSplineKernelTransform", "landmarks"],
        ),
        (
            "elastic-body",
            text(("ElasticBodySplineKernelTransform" + d, landmarks, landmarks)),
            ["ElasticBodySplineKernelTransform"],
        ),
        (
            "velocity",
            text(("ConstantVelocityFieldTransform" + d, [0] * 3, GRID)),
            ["ConstantVelocityFieldTransform"],
        ),
        (
            "euler-2d",
            text(("Euler2DTransform_double_2_2", [0.1, 1, 2], [0, 0])),
            ["Euler2DTransform", "three-dimensional"],
        ),
        (
            "affine-2d",
            text(("AffineTransform_double_2_2", [1, 0, 0, 1, 1, 2], [0, 0])),
            ["three-dimensional"],
        ),
        (
            "bspline-order-5",
            text((f"BSplineTransform{d}_5", wave(3 * 64), GRID)),
            ["orders 1 to 3"],
        ),
        ("bspline-short", text(("BSplineTransform" + d, wave(3 * 64 - 1), GRID)), ["191", "192"]),
        (
            "too-few-parameters",
            text(("AffineTransform" + d, MATRIX, CENTER)),
            ["9 parameters", "12"],
        ),
        ("singular", text(("AffineTransform" + d, [0] * 9 + [1, 2, 3], CENTER)), ["singular"]),
        (
            "not-numbers",
            text(("AffineTransform" + d, MATRIX + [1, 2, 3], CENTER)).replace("0.1", "one", 1),
            ["not numbers"],
        ),
        ("no-transform", "#Insight Transform File V1.0\n", ["no transform"]),
        ("unknown", text(("FancyTransform" + d, [1], [])), ["FancyTransform"]),
    ]:
        cases.write(f"itk/{name}.tfm", content)
        cases.add(
            KIND,
            name,
            f"itk/{name}.tfm",
            "SimpleITK refuses it or is not three-dimensional",
            error=fragments,
        )
