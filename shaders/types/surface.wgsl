// Mirrored by src/render/uniforms.rs; a test compares names, offsets and sizes.

struct SurfaceObject {
    // For a field: world to grid indices and back. Affine; the last row is unused.
    grid_from_world: mat4x4<f32>,
    world_from_grid: mat4x4<f32>,
    // Grid points of the field; or texels of the depth maps, and their number.
    size: vec3<f32>,
    // 0 distance field, 1 formulas, 2 depth maps.
    kind: u32,
    cells_origin: vec3<f32>,
    // Resolution of f, mm.
    resolution_mm: f32,
    cell_mm: vec3<f32>,
    step_mm: f32,
    cells: vec3<u32>,
    thickness_mm: f32,
    occupied_min: vec3<f32>,
    // 0 hollow, 1 solid or thick.
    solid: u32,
    occupied_max: vec3<f32>,
    // 0 uniform, 1 threshold, 2 Jacobian, 3 Jacobian by a bound, 4 sphere.
    steps: u32,
    color: vec3<f32>,
    highlight: f32,
    inside: vec3<f32>,
    shininess: f32,
    cut: vec3<f32>,
    threshold_mm: f32,
    // The box of the depth maps.
    low: vec3<f32>,
    solids: u32,
    high: vec3<f32>,
    // The face of a single depth map.
    face: u32,
    seam_mm: f32,
    rigid: u32,
    // Triangles are drawn only outside the boxes of deformations.
    both: u32,
    deformers: u32,
    // 0 inverse transpose, 1 tangent and binormal, 2 neighbouring points.
    normal_method: u32,
    vertex_offset_mm: f32,
    padding: vec2<f32>,
}

struct PlacedSolid {
    // Rigid; the last row is unused.
    local_from_world: mat4x4<f32>,
    numbers: vec4<f32>,
    // 0 sphere, 1 box, 2 torus, 3 cylinder, 4 gyroid.
    solid: u32,
    // 0 union, 1 intersect, 2 subtract.
    join: u32,
    // For a gyroid.
    period: f32,
    wall: f32,
}

struct Deformer {
    // Rigid; the last row is unused.
    local_from_world: mat4x4<f32>,
    numbers: vec4<f32>,
    half: vec3<f32>,
    // 0 twist, 1 bend, 2 taper, 3 shear, 4 bulge, 5 wave, 6 lattice.
    kind: u32,
    // For a lattice, x varies fastest.
    offsets: array<vec4<f32>, 64>,
}
