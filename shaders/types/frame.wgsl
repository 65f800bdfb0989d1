// Mirrored by src/render/uniforms.rs; a test compares names, offsets and sizes.

struct Frame {
    clip_from_world: mat4x4<f32>,
    // Affine; the last row is unused.
    voxel_from_world: mat4x4<f32>,
    eye: vec3<f32>,
    // 1 for the perspective camera, 0 for the orthographic one.
    perspective: f32,
    forward: vec3<f32>,
    step_mm: f32,
    right: vec3<f32>,
    reference_mm: f32,
    up: vec3<f32>,
    // Distance from a cut up to which its normal is used alone, and distance beyond which it has no
    // effect.
    blend_near_mm: f32,
    to_light: vec3<f32>,
    blend_far_mm: f32,
    proxy_min: vec3<f32>,
    ambient: f32,
    proxy_max: vec3<f32>,
    diffuse: f32,
    grid_size: vec3<f32>,
    specular: f32,
    cells_origin: vec3<f32>,
    shininess: f32,
    cell_mm: vec3<f32>,
    // Normalised value = value_scale * texel + value_offset.
    value_scale: f32,
    cells: vec3<u32>,
    value_offset: f32,
    picture: vec2<f32>,
    // Table coordinate = table_scale * normalised value + table_offset.
    table_scale: f32,
    table_offset: f32,
    // Gradient magnitude at the last entry of the gradient table; 0 for none.
    gradient_top: f32,
    two_sided: u32,
    has_holes: u32,
    early_termination: u32,
    // Normalised values shown as black and white on grey cut faces.
    grey_low: f32,
    grey_high: f32,
    // Normalised value of the iso-surface.
    iso: f32,
    // 1: samples are jittered along each pixel's ray.
    jitter: u32,
    // Voxels spanned by the volume's texture: the grid's size, or slightly more where it was
    // reduced.
    texture_size: vec3<f32>,
    // Gradient of the normalised value per voxel = gradient_scale * texel of the gradient volume;
    // 0: no gradient volume.
    gradient_scale: f32,
    // Distance from the volume's faces, in voxels along each axis, within which a face may act as a
    // cut under any deformation.
    face: vec3<f32>,
    // Normalised value = 2 gradient_scale * first component of such a texel + stored_offset.
    stored_offset: f32,
    // 1 / texture_size.
    per_texture_size: vec3<f32>,
    // Optical depth below which a sample is thin (Prepared::thin_depth).
    thin_depth: f32,
    // Where in its pixel every sample of a pass lies, pixels from the centre.
    sample_offset: vec2<f32>,
    more_padding: vec2<f32>,
    // Colour of the key light and of its highlight.
    key_color: vec3<f32>,
    key_padding: f32,
    sky_color: vec3<f32>,
    sky_padding: f32,
    // Corner of the light volume, mm, and 1 / its edges.
    light_origin: vec3<f32>,
    // How far in front of a surface its light is read.
    light_offset_mm: f32,
    light_per_size: vec3<f32>,
    light_padding: f32,
}

// An analytic cut shape (src/deform/cut.rs).
struct CutShape {
    // Rigid; the last row is unused.
    local_from_world: mat4x4<f32>,
    half: vec3<f32>,
    shape: u32,
    half_angle: f32,
    // 1 or -1.
    sense: f32,
    joins_previous: u32,
    intersects_group: u32,
}

struct PlacedMap {
    // Affine; the last row is unused.
    map_from_world: mat4x4<f32>,
    // Linear part of world_from_map times the map's scale: from stored displacement to mm.
    world_from_stored: mat4x4<f32>,
    // Texels along x, y, z.
    size: vec3<f32>,
    // 1: added to the previous map; 0: applied after it.
    added: f32,
    // How far the outermost texels extend beyond the cube, map units.
    reach: vec3<f32>,
    // Map units per stored unit of displacement.
    scale: f32,
    // The map's first texel in the atlas.
    origin: vec3<f32>,
    // 1: in the single-precision atlas.
    single: f32,
    // 1 / size of that atlas in texels.
    per_atlas: vec3<f32>,
    // Of the cylinder that the map is wrapped around, mm; 0: the map fills its cube.
    radius_mm: f32,
    // Edge lengths of the cube, mm.
    box_mm: vec3<f32>,
    // Smallest radius at which a derivative is taken, mm.
    min_radius_mm: f32,
    // The first of the map's stored slopes in the atlas: blocks of the map's size along z with the
    // derivatives along x, y and z.
    slopes_origin: vec3<f32>,
    // Stored units of displacement per unit of a stored slope; 0: none are stored.
    slopes_scale: f32,
}
