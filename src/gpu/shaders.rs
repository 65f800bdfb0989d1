//! The table of shaders: the pieces of WGSL that make up each program. Pieces are joined as text;
//! WGSL requires no order of declaration.

/// A program of one or two entry points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Program {
    /// Ray casting by fragments.
    Raycast,
    /// Ray casting by compute invocations.
    RaycastCompute,
    /// Slices.
    Slice,
    /// The second pass of a projection by slices.
    Resolve,
    /// The mask of pixels made opaque by slices.
    Opaque,
    /// Surfaces behind slices.
    SurfacesBehind,
    /// Shared functions at given points, for tests.
    Probe,
    /// A stack at given points, for composing it.
    Compose,
    /// A formula at the grid points of a map.
    Sample,
    /// Those as texels.
    Encode,
    /// Bounds on boxes of a map's texels.
    Bounds,
    /// Empty-space classification.
    Classify,
    /// One surface, by rays through its field.
    Surface,
    /// One surface, in slices.
    SliceSurface,
    /// Triangles.
    Mesh,
    /// Triangles at listed samples.
    Gather,
    /// The mask of pixels that are not sampled again by slices.
    Mask,
}

macro_rules! piece {
    ($path:literal) => {
        include_str!(concat!("../../shaders/", $path))
    };
}

const SHARED: [&str; 10] = [
    piece!("types/frame.wgsl"),
    piece!("bindings.wgsl"),
    piece!("lib/math.wgsl"),
    piece!("lib/light.wgsl"),
    piece!("lib/stack.wgsl"),
    piece!("lib/shape.wgsl"),
    piece!("lib/cut.wgsl"),
    piece!("lib/transfer.wgsl"),
    piece!("lib/volume.wgsl"),
    piece!("lib/shading.wgsl"),
];

/// How values are interpolated between voxels.
const VOXELS: &str = piece!("lib/voxels.wgsl");
const NOISE: &str = piece!("lib/noise.wgsl");
const NODE: &str = piece!("types/bounds.wgsl");
const MARCH: &str = piece!("lib/march.wgsl");
const SLICE_POLYGON: &str = piece!("lib/slice_polygon.wgsl");
const EDGES: &str = piece!("lib/edges.wgsl");
const FOUND: &str = piece!("lib/found.wgsl");
const COMPOSITE: &str = piece!("lib/composite.wgsl");

/// Additional pieces shared by the surface programs.
const SURFACES: [&str; 4] = [
    piece!("types/surface.wgsl"),
    piece!("lib/implicit.wgsl"),
    piece!("lib/formula.wgsl"),
    piece!("lib/surface.wgsl"),
];

impl Program {
    /// All programs.
    pub const ALL: [Self; 17] = [
        Self::Raycast,
        Self::RaycastCompute,
        Self::Slice,
        Self::Resolve,
        Self::Opaque,
        Self::SurfacesBehind,
        Self::Probe,
        Self::Compose,
        Self::Sample,
        Self::Encode,
        Self::Bounds,
        Self::Classify,
        Self::Surface,
        Self::SliceSurface,
        Self::Mesh,
        Self::Gather,
        Self::Mask,
    ];

    /// The program's whole text, `constants` first; `counting` includes the sample counts. The text
    /// of a function replaces the interpolation between voxels.
    pub fn source(self, constants: &str, counting: bool, function: Option<&str>) -> String {
        let count = if counting {
            piece!("lib/count.wgsl")
        } else {
            piece!("lib/count_disabled.wgsl")
        };
        let own: &[&str] = match self {
            Self::Raycast => &[
                MARCH,
                EDGES,
                FOUND,
                COMPOSITE,
                piece!("lib/projection.wgsl"),
                piece!("lib/ray.wgsl"),
                count,
                piece!("raycast.wgsl"),
            ],
            Self::RaycastCompute => &[
                MARCH,
                EDGES,
                FOUND,
                COMPOSITE,
                piece!("lib/projection.wgsl"),
                piece!("lib/ray.wgsl"),
                count,
                piece!("raycast_compute.wgsl"),
            ],
            Self::Slice => &[MARCH, EDGES, FOUND, SLICE_POLYGON, count, piece!("slice.wgsl")],
            Self::Resolve => &[piece!("lib/projection.wgsl"), piece!("resolve.wgsl")],
            Self::Opaque => &[piece!("opaque.wgsl")],
            Self::SurfacesBehind => &[piece!("surfaces_behind.wgsl")],
            Self::Probe => &[piece!("probe.wgsl")],
            Self::Compose => &[piece!("compose.wgsl")],
            Self::Sample => &[
                piece!("lib/shape.wgsl"),
                piece!("lib/kinds.wgsl"),
                piece!("sample.wgsl"),
            ],
            Self::Encode => &[piece!("encode.wgsl")],
            Self::Bounds => &[NODE, piece!("bounds.wgsl")],
            Self::Classify => &[NODE, piece!("classify.wgsl")],
            Self::SliceSurface => &[
                MARCH,
                EDGES,
                FOUND,
                SLICE_POLYGON,
                count,
                piece!("slice_surface.wgsl"),
            ],
            Self::Surface => &[MARCH, count, piece!("surface.wgsl")],
            Self::Mesh => &[MARCH, piece!("lib/deformer.wgsl"), piece!("mesh.wgsl")],
            Self::Gather => &[MARCH, piece!("gather.wgsl")],
            Self::Mask => &[piece!("mask.wgsl")],
        };
        let of_surfaces: &[&str] = match self {
            Self::Surface | Self::SliceSurface | Self::Mesh | Self::Gather => &SURFACES,
            _ => &[],
        };
        // Programs that make maps read no scene.
        let (shared, values): (&[&str], &[&str]) =
            if matches!(self, Self::Sample | Self::Encode | Self::Bounds) {
                (&[], &[])
            } else {
                (&SHARED, &[function.unwrap_or(VOXELS), NOISE])
            };
        std::iter::once(constants)
            .chain(shared.iter().chain(values).chain(of_surfaces).chain(own).copied())
            .collect::<Vec<_>>()
            .join("\n")
    }
}
