// Implicit surfaces: distance grids, depth maps, formulas; and the bindings of one object.

@group(2) @binding(0) var<uniform> object: SurfaceObject;
@group(2) @binding(1) var field: texture_3d<f32>;
@group(2) @binding(2) var object_cells: texture_3d<f32>;
@group(2) @binding(3) var<uniform> solids: array<PlacedSolid, 16>;
@group(2) @binding(4) var<uniform> deformers: array<Deformer, 4>;

fn grid_distance(world: vec3<f32>) -> f32 {
    let p = transform_point(object.grid_from_world, world);
    let nearest = clamp(p, vec3<f32>(0.0), object.size - 1.0);
    let f = sample_texture(field, nearest, object.size, 1.0 / object.size).r;
    let beyond = p - nearest;
    if all(beyond == vec3<f32>(0.0)) {
        return f;
    }
    let away = length(linear_part(object.world_from_grid) * beyond);
    return select(f - away, -sqrt(f * f + away * away), f < 0.0);
}

// f of depth map number n on a face; x is the position in 0..1 over the box.
fn depth_height(n: f32, face: u32, world: vec3<f32>, x: vec3<f32>) -> f32 {
    let axis = face / 2u;
    let uv = select(select(x.xy, x.xz, axis == 1u), x.yz, axis == 0u);
    let depth = select(object.high[axis] - world[axis], world[axis] - object.low[axis], face % 2u == 0u);
    let p = vec3<f32>(clamp(uv, vec2<f32>(0.0), vec2<f32>(1.0)) * (object.size.xy - 1.0), n);
    return depth - sample_texture(field, p, object.size, 1.0 / object.size).r;
}

fn depth_value(world: vec3<f32>) -> f32 {
    let x = (world - object.low) / (object.high - object.low);
    let outside = max(object.low - world, world - object.high);
    let beyond = max(outside.x, max(outside.y, outside.z));
    if beyond > 0.0 {
        return -max(beyond, 1e-3);
    }
    var least = 1e30;
    var inside = true;
    let count = u32(object.size.z + 0.5);
    for (var n = 0u; n < count; n += 1u) {
        let f = depth_height(f32(n), select(n, object.face, count == 1u), world, x);
        least = min(least, abs(f));
        inside = inside && f > 0.0;
    }
    return select(-least, least, inside);
}

fn implicit_value(world: vec3<f32>) -> f32 {
    switch object.kind {
        case IMPLICIT_GRID: { return grid_distance(world); }
        case IMPLICIT_FORMULA: { return formula_distance(world); }
        default: { return depth_value(world); }
    }
}

fn implicit_gradient(world: vec3<f32>, h: f32) -> vec3<f32> {
    let x = vec3<f32>(h, 0.0, 0.0);
    let y = vec3<f32>(0.0, h, 0.0);
    let z = vec3<f32>(0.0, 0.0, h);
    return vec3<f32>(
        implicit_value(world + x) - implicit_value(world - x),
        implicit_value(world + y) - implicit_value(world - y),
        implicit_value(world + z) - implicit_value(world - z),
    ) / (2.0 * h);
}
