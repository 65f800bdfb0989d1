"""Transforms of FSL, FreeSurfer, AFNI, MRtrix, MINC, elastix and SPM. The points are mapped by the
definitions that these programs publish, from the deformed point to its source, in LPS; vector images
by SimpleITK."""

import nibabel
import numpy as np
import SimpleITK

from .itk import POINTS, mapped, wave

KIND = "fsl and other transforms"
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
M = np.array([[1, 0.1, 0, 2], [-0.1, 1.1, 0.05, -3], [0, 0.02, 0.9, 4], [0, 0, 0, 1]], float)
# Grids of the moving and the reference image (one volume): RAS.
RIGHT_HANDED = np.array([[2, 0, 0, -30], [0, 2.5, 0, -40], [0, 0, 3, -20], [0, 0, 0, 1]], float)
LEFT_HANDED = np.diag([-1.0, 1, 1, 1]) @ RIGHT_HANDED
SIZE = (31, 33, 15)
NEAR = [(0.0, 0.0, 0.0), (10.0, -20.0, 5.0), (-15.0, 12.0, -8.0)]


def applied(matrix, points=POINTS):
    """Points and their images under a matrix of LPS."""
    return [[*p, *map(float, (matrix @ np.array([*p, 1.0]))[:3])] for p in points]


def rows(matrix, form="{:.9g}", between=" ", n=4):
    return "\n".join(between.join(form.format(x) for x in row) for row in matrix[:n]) + "\n"


def make(cases):
    make_fsl(cases)
    make_freesurfer(cases)
    make_matrices(cases)
    make_elastix(cases)
    make_fields(cases)
    make_refusals(cases)


def volume(cases, name, affine):
    image = nibabel.Nifti1Image(np.zeros(SIZE, np.uint8), affine)
    image.header.set_sform(affine, 1)
    cases.write(f"others/{name}.nii", image.to_bytes())
    return f"others/{name}.nii"


def fsl_from_voxel(affine):
    """FSL's millimetres: x from the other end where the axes are right-handed (newimage, sampling)."""
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    out = np.diag([*spacing, 1.0])
    if np.linalg.det(affine[:3, :3]) > 0:
        out[0, 0], out[0, 3] = -spacing[0], (SIZE[0] - 1) * spacing[0]
    return out


def make_fsl(cases):
    for handed, affine in (("right", RIGHT_HANDED), ("left", LEFT_HANDED)):
        image = volume(cases, f"volume-{handed}", affine)
        world_from_fsl = FLIP @ affine @ np.linalg.inv(fsl_from_voxel(affine))
        right = applied(world_from_fsl @ np.linalg.inv(M) @ np.linalg.inv(world_from_fsl), NEAR)
        hexadecimal = "\n".join("  ".join(float(x).hex() for x in row) for row in M) + "\n"
        for name, content in [
            ("decimal", rows(M)),
            ("hexadecimal", hexadecimal),
            ("hexadecimal-upper-case", hexadecimal.upper()),
            ("extra-blanks", rows(M, between="   \t ") + "\n\n"),
            ("commas", rows(M, between=", ")),
            ("crlf", rows(M).replace("\n", "\r\n")),
            ("exponents", rows(M, "{:.8e}")),
            ("one-line", rows(M).replace("\n", " ")),
        ]:
            if handed == "left" and name not in ("decimal", "hexadecimal"):
                continue
            path = f"others/flirt-{name}-{handed}.mat"
            cases.write(path, content)
            cases.add(
                KIND,
                f"flirt-{name}-{handed}",
                path,
                "FSL, FLIRT",
                points=right,
                options={"volume": image},
            )
    cases.write("others/flirt.mat", rows(M))
    cases.add(
        KIND, "flirt-without-volume", "others/flirt.mat", "FSL, FLIRT", error=["FSL", "moving=FILE"]
    )
    cases.add(
        KIND,
        "matrix-in-ras",
        "others/flirt.mat",
        "NiftyReg, reg_aladin",
        points=applied(FLIP @ M @ FLIP),
        options={"convention": "ras"},
    )
    cases.add(
        KIND,
        "matrix-in-lps",
        "others/flirt.mat",
        "LPS",
        points=applied(M),
        options={"convention": "lps"},
    )


def make_freesurfer(cases):
    def lta(kind, matrix, affine, size=SIZE):
        spacing = np.linalg.norm(affine[:3, :3], axis=0)
        axes = affine[:3, :3] / spacing
        center = affine @ np.array([*(np.array(size) / 2), 1.0])
        info = f"valid = 1  # volume info valid\nfilename = a.mgz\nvolume = {size[0]} {size[1]} {size[2]}\nvoxelsize = {' '.join(f'{s:.15e}' for s in spacing)}\n"
        for n, name in enumerate(("xras  ", "yras  ", "zras  ")):
            info += f"{name} = {' '.join(f'{x:.15e}' for x in axes[:, n])}\n"
        info += f"cras   = {' '.join(f'{x:.15e}' for x in center[:3])}\n"
        return f"# transform file a.lta\n# created by hand\n\ntype      = {kind} # LINEAR\nnxforms   = 1\nmean      = 0.0 0.0 0.0\nsigma     = 1.0\n1 4 4\n{rows(matrix, '{:.15e}')}src volume info\n{info}dst volume info\n{info}subject fsaverage\nfscale 0.1\n"

    right = applied(FLIP @ np.linalg.inv(M) @ FLIP)
    vox = np.linalg.inv(RIGHT_HANDED) @ M @ RIGHT_HANDED
    cases.write("others/ras.lta", lta(1, M, RIGHT_HANDED))
    cases.add(KIND, "lta-ras", "others/ras.lta", "FreeSurfer, lta_convert", points=right)
    cases.write("others/voxels.lta", lta(0, vox, RIGHT_HANDED))
    cases.add(KIND, "lta-voxels", "others/voxels.lta", "FreeSurfer, lta_convert", points=right)
    for name, content, fragments in [
        ("physical", lta(2, M, RIGHT_HANDED), ["type 2"]),
        ("register", lta(14, M, RIGHT_HANDED), ["type 14"]),
        (
            "two",
            lta(1, M, RIGHT_HANDED).replace("nxforms   = 1", "nxforms   = 2"),
            ["2 transforms"],
        ),
        ("no-matrix", lta(1, M[:0], RIGHT_HANDED), ["4 x 4"]),
    ]:
        cases.write(f"others/{name}.lta", content)
        cases.add(KIND, f"lta-{name}", f"others/{name}.lta", "FreeSurfer", error=fragments)
    image = volume(cases, "volume-tk", RIGHT_HANDED)
    spacing = np.linalg.norm(RIGHT_HANDED[:3, :3], axis=0)
    half = np.array(SIZE) * spacing / 2
    tk_from_voxel = np.array(
        [
            [-spacing[0], 0, 0, half[0]],
            [0, 0, spacing[2], -half[2]],
            [0, -spacing[1], 0, half[1]],
            [0, 0, 0, 1],
        ]
    )
    world_from_tk = FLIP @ RIGHT_HANDED @ np.linalg.inv(tk_from_voxel)
    dat = f"subject\n2.0\n3.0\n0.15\n{rows(M)}round\n"
    cases.write("others/register.dat", dat)
    cases.add(
        KIND,
        "register-dat-without-volume",
        "others/register.dat",
        "FreeSurfer, tkregister",
        points=[],
        error=["register.dat", "moving=FILE"],
    )
    cases.add(
        KIND,
        "register-dat",
        "others/register.dat",
        "FreeSurfer, tkregister",
        points=applied(world_from_tk @ M @ np.linalg.inv(world_from_tk), NEAR),
        options={"volume": image},
    )


def make_matrices(cases):
    def case(name, content, ending, right, peer, **more):
        path = f"others/{name}.{ending}"
        cases.write(path, content)
        cases.add(KIND, name, path, peer, points=right, **more)

    afni = "AFNI, 3dAllineate -1Dmatrix_save"
    one = rows(M, n=3).replace("\n", " ") + "\n"
    case(
        "afni-aff12",
        "# 3dAllineate matrices (DICOM-to-DICOM, row-by-row):\n" + one,
        "aff12.1D",
        applied(M),
        afni,
    )
    case("afni-three-rows", rows(M, n=3), "1D", applied(M), afni)
    case(
        "afni-matrix-expression",
        "MATRIX(" + ",".join(f"{x:.9g}" for x in M[:3].ravel()) + ")\n",
        "1D",
        applied(M),
        afni,
    )
    mrtrix = "# mrtrix_version: 3.0.4\n# command_history: transformcalc a b\n" + rows(M)
    case("mrtrix", mrtrix, "txt", applied(FLIP @ M @ FLIP), "MRtrix, mrtransform -linear")
    case(
        "mrtrix-centre",
        "#centre: 1 2 3\n# command_history: mrregister a b\n" + rows(M),
        "txt",
        applied(FLIP @ M @ FLIP),
        "MRtrix, mrtransform -linear",
    )
    xfm = (
        "MNI Transform File\n%Created by mritotal\n\nTransform_Type = Linear;\nLinear_Transform =\n"
        + rows(M, n=3).strip()
        + ";\n"
    )
    inverse = applied(FLIP @ np.linalg.inv(M) @ FLIP)
    case("minc", xfm, "xfm", inverse, "MNI, mincresample")
    one_line = xfm.replace("Linear_Transform =\n", "Linear_Transform = ").replace(
        "\n%Cr", "\n% a = b;\n%Cr"
    )
    case("minc-one-line", one_line, "xfm", inverse, "MNI, mincresample")
    case(
        "minc-inverted",
        xfm.replace("= Linear;", "= Linear;\nInvert_Flag = True;"),
        "xfm",
        applied(FLIP @ M @ FLIP),
        "MNI, mincresample",
    )
    twice = xfm + xfm.split("\n\n", 1)[1]
    case("minc-two", twice, "xfm", applied(FLIP @ np.linalg.inv(M @ M) @ FLIP), "MNI, mincresample")
    affine = SimpleITK.AffineTransform(
        [float(x) for x in M[:3, :3].ravel()], [float(x) for x in M[:3, 3]], (0, 0, 0)
    )
    path = cases.path("others/itk-writer.xfm")
    SimpleITK.WriteTransform(affine, path)
    cases.add(
        KIND,
        "minc-written-by-itk",
        "others/itk-writer.xfm",
        "SimpleITK",
        points=mapped(SimpleITK.ReadTransform(path), POINTS),
    )


def make_elastix(cases):
    def text(name, parameters, center=(4, 5, 6), **more):
        fields = {
            "Transform": name,
            "NumberOfParameters": len(parameters),
            "TransformParameters": parameters,
            "InitialTransformParametersFileName": "NoInitialTransform",
            "HowToCombineTransforms": "Compose",
            "FixedImageDimension": 3,
            "MovingImageDimension": 3,
            "FixedInternalImagePixelType": "float",
            "Size": SIZE,
            "Spacing": (2, 2.5, 3),
            "CenterOfRotationPoint": center,
            **more,
        }
        out = ""
        for key, value in fields.items():
            if isinstance(value, str):
                out += f'({key} "{value}")\n'
            elif value is not None:
                numbers = value if isinstance(value, (list, tuple)) else [value]
                out += f"({key} {' '.join(f'{x:.9g}' for x in numbers)})\n"
        return f'// elastix\n\n{out}\n// ResampleInterpolator specific\n(ResampleInterpolator "FinalBSplineInterpolator")\n'

    def case(name, content, right, **more):
        path = f"elastix/{name}.txt"
        cases.write(path, content)
        cases.add(
            KIND, f"elastix-{name}", path, "elastix 5, by ITK's classes", points=right, **more
        )

    angles = [0.1, 0.2, 0.3]
    euler = SimpleITK.Euler3DTransform((4, 5, 6), *angles, (1, 2, 3))
    case(
        "euler",
        text("EulerTransform", angles + [1, 2, 3], ComputeZYX="false"),
        mapped(euler, POINTS),
    )
    euler.SetComputeZYX(True)
    case(
        "euler-zyx",
        text("EulerTransform", angles + [1, 2, 3], ComputeZYX="true"),
        mapped(euler, POINTS),
    )
    linear = [float(x) for x in M[:3, :3].ravel()]
    affine = SimpleITK.AffineTransform(linear, (1, 2, 3), (4, 5, 6))
    case("affine", text("AffineTransform", linear + [1, 2, 3]), mapped(affine, POINTS))
    case(
        "translation",
        text("TranslationTransform", [1, 2, 3], center=None),
        mapped(SimpleITK.TranslationTransform(3, (1, 2, 3)), POINTS),
    )
    similarity = SimpleITK.Similarity3DTransform()
    similarity.SetCenter((4, 5, 6))
    similarity.SetParameters(angles + [1, 2, 3, 1.2])
    case(
        "similarity",
        text("SimilarityTransform", angles + [1, 2, 3, 1.2]),
        mapped(similarity, POINTS),
    )
    direction = [0.8, -0.6, 0, 0.6, 0.8, 0, 0, 0, 1]
    fixed = [5, 4, 6, -20, -10, -30, 10, 12, 11, *direction]
    spline = SimpleITK.BSplineTransform(3, 3)
    spline.SetFixedParameters(fixed)
    spline.SetParameters(wave(3 * 120))
    by_columns = [direction[3 * r + c] for c in range(3) for r in range(3)]
    grid = {
        "GridSize": (5, 4, 6),
        "GridIndex": (0, 0, 0),
        "GridSpacing": (10, 12, 11),
        "GridOrigin": (-20, -10, -30),
        "GridDirection": by_columns,
        "BSplineTransformSplineOrder": 3,
        "UseCyclicTransform": "false",
    }
    m = np.array(direction).reshape(3, 3) @ np.diag(fixed[6:9])
    inside = [
        tuple(float(x) for x in np.array(fixed[3:6]) + m @ np.array(v))
        for v in ([1.5, 1.5, 2], [2.2, 1.9, 4], [3, 1.1, 1.2])
    ]
    case(
        "bspline",
        text("BSplineTransform", wave(3 * 120), center=None, **grid),
        mapped(spline, inside),
        tolerance=0.02,
    )
    case(
        "recursive-bspline",
        text("RecursiveBSplineTransform", wave(3 * 120), center=None, **grid),
        mapped(spline, inside),
        tolerance=0.02,
    )
    chain = SimpleITK.CompositeTransform([affine, SimpleITK.TranslationTransform(3, (1, 2, 3))])
    case(
        "chain",
        text(
            "AffineTransform",
            linear + [1, 2, 3],
            InitialTransformParametersFileName="/home/a/run/translation.txt",
        ),
        mapped(chain, POINTS),
    )
    for name, content, fragments in [
        ("stack", text("AffineLogStackTransform", [1]), ["AffineLogStackTransform"]),
        ("spline-kernel", text("SplineKernelTransform", [1]), ["SplineKernelTransform"]),
        (
            "two-dimensions",
            text("EulerTransform", [0.1, 1, 2], FixedImageDimension=2),
            ["2 dimensions"],
        ),
        (
            "added",
            text(
                "TranslationTransform",
                [1, 2, 3],
                InitialTransformParametersFileName="euler.txt",
                HowToCombineTransforms="Add",
            ),
            ["Compose"],
        ),
        (
            "missing-file",
            text(
                "TranslationTransform", [1, 2, 3], InitialTransformParametersFileName="nowhere.txt"
            ),
            ["nowhere.txt"],
        ),
        (
            "loop",
            text("TranslationTransform", [1, 2, 3], InitialTransformParametersFileName="loop.txt"),
            ["16"],
        ),
    ]:
        cases.write(f"elastix/{name}.txt", content)
        cases.add(KIND, f"elastix-{name}", f"elastix/{name}.txt", "elastix", error=fragments)


def make_fields(cases):
    size = (3, 4, 5)
    affine = np.array([[8, 0, 0, -16], [0, 9, 0, -18], [0, 0, 10, -20], [0, 0, 0, 1]], float)
    vectors = np.array(wave(3 * 60)).reshape(*size, 1, 3).astype(np.float32)
    at = [(1, 1, 1), (2, 3, 4), (0, 2, 3)]

    def field(vectors, intent, name=""):
        image = nibabel.Nifti1Image(vectors, affine)
        image.header.set_sform(affine, 1)
        image.header.set_intent(intent, name=name)
        return image.to_bytes()

    def right(lps_from_vector, positions=False):
        out = []
        for v in at:
            p = (FLIP @ affine @ np.array([*v, 1.0]))[:3]
            d = lps_from_vector @ vectors[v][0].astype(float)
            out.append([*map(float, p), *map(float, d if positions else p + d)])
        return out

    ras = FLIP[:3, :3]
    cases.write("others/ants-warp.nii", field(vectors, 1007))
    cases.add(KIND, "ants-warp", "others/ants-warp.nii", "ITK", points=right(np.eye(3)))
    cases.write("others/displacement.nii", field(vectors, 1006))
    cases.add(
        KIND,
        "displacement-in-ras",
        "others/displacement.nii",
        "nifti1.h, DISPVECT",
        points=right(ras),
    )
    grid = np.stack(
        [*np.meshgrid(*[np.arange(n) for n in size], indexing="ij"), np.ones(size)], axis=-1
    )
    mapping = (grid @ affine.T)[..., None, :3] + vectors
    cases.write("others/y_spm.nii", field(mapping.astype(np.float32), 1007, "Mapping"))
    cases.add(
        KIND, "spm-deformation", "others/y_spm.nii", "SPM 12, deformation fields", points=right(ras)
    )
    image = SimpleITK.GetImageFromArray(
        np.moveaxis(vectors[..., 0, :], (0, 1, 2), (2, 1, 0)).astype(np.float64), isVector=True
    )
    image.SetSpacing((8, 9, 10))
    image.SetOrigin((-16, -18, -20))
    for ending in ("mha", "nrrd"):
        path = cases.path(f"others/field.{ending}")
        SimpleITK.WriteImage(image, path)
        transform = SimpleITK.DisplacementFieldTransform(
            SimpleITK.ReadImage(path, SimpleITK.sitkVectorFloat64)
        )
        cases.add(
            KIND,
            f"field-{ending}",
            f"others/field.{ending}",
            "SimpleITK",
            points=mapped(transform, [(0.0, 0.0, 0.0), (-8.0, -9.0, -10.0), (-2.0, 5.0, 17.0)]),
        )
    plain = SimpleITK.Image(image)
    plain.SetSpacing((1, 1, 1))
    plain.SetOrigin((0, 0, 0))
    path = cases.path("others/field-no-spacing.mha")
    SimpleITK.WriteImage(plain, path)
    with open(path, "rb") as file:
        lines = file.read().split(b"\n")
    lines = [line for line in lines if not line.startswith(b"ElementSpacing")]
    cases.write("others/field-no-spacing.mha", b"\n".join(lines))
    transform = SimpleITK.DisplacementFieldTransform(
        SimpleITK.ReadImage(path, SimpleITK.sitkVectorFloat64)
    )
    cases.add(
        KIND,
        "field-no-spacing",
        "others/field-no-spacing.mha",
        "SimpleITK",
        points=mapped(transform, [(1.0, 2.0, 1.0), (2.0, 1.0, 3.0)]),
        warns=["1 mm is assumed"],
    )
    four = vectors[..., 0, :]
    for code, word in ((2007, "cubic spline"), (2008, "cosine"), (2009, "quadratic")):
        image = nibabel.Nifti1Image(four, affine)
        data = bytearray(image.to_bytes())
        data[68:70] = code.to_bytes(2, "little")
        cases.write(f"others/fnirt-{code}.nii", bytes(data))
        cases.add(
            KIND,
            f"fnirt-{code}",
            f"others/fnirt-{code}.nii",
            "FSL, fnirt",
            points=[],
            error=[word, "fnirtfileutils"],
        )
    cases.write("others/velocities.nii", field(vectors, 1007, "Velocities"))
    cases.add(
        KIND,
        "velocities",
        "others/velocities.nii",
        "SPM 12, Dartel",
        points=[],
        error=["velocities"],
    )
    cases.write("others/no-convention.nii", field(vectors, 0))
    cases.add(
        KIND,
        "no-convention",
        "others/no-convention.nii",
        "nifti1.h",
        points=[],
        error=["convention"],
    )
    cases.write("others/scalar.nii", nibabel.Nifti1Image(four[..., 0].copy(), affine).to_bytes())
    cases.add(
        KIND,
        "scalar-image",
        "others/scalar.nii",
        "nifti1.h",
        points=[],
        error=["1 values per voxel"],
    )


def make_refusals(cases):
    for name, content, fragments in [
        (
            "spm_sn.mat",
            b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(128) + b"\0" * 64,
            ["SPM", "_sn.mat"],
        ),
        ("morph.m3z", b"\x1f\x8b\x08" + b"\0" * 60, [".m3z", "mri_warp_convert"]),
        ("warp.mgz", b"\x1f\x8b\x08" + b"\0" * 60, [".mgz"]),
        (
            "grid.xfm",
            "MNI Transform File\nTransform_Type = Grid_Transform;\nDisplacement_Volume = a_grid_0.mnc;\n",
            ["Grid_Transform"],
        ),
        (
            "thin-plate.xfm",
            "MNI Transform File\nTransform_Type = Thin_Plate_Spline_Transform;\nNumber_Dimensions = 3;\n",
            ["Thin_Plate_Spline_Transform"],
        ),
        ("nothing.xfm", "MNI Transform File\n", ["Linear_Transform"]),
        ("many.aff12.1D", (rows(M, n=3).replace("\n", " ") + "\n") * 5, ["5 matrices"]),
        ("last-row.mat", rows(M).replace("0 0 0 1", "0 0 1 1"), ["last row"]),
        ("three-by-three.mat", rows(M[:3, :3]), ["9 numbers"]),
        ("singular.1D", "0 0 0 1 " * 3, ["singular"]),
        ("words.txt", "this is no transform\n", ["supported"]),
        ("register.dat2.dat", "subject\n1\n2\n3\nround\n", ["4 x 4"]),
    ]:
        cases.write(f"refused/{name}", content)
        cases.add(
            KIND,
            name,
            f"refused/{name}",
            "what the program that writes it says",
            points=[],
            error=fragments,
        )
