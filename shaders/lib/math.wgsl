// Counterpart of src/math/mod.rs.

fn normalize_or(v: vec3<f32>, fallback: vec3<f32>) -> vec3<f32> {
    let length_squared = dot(v, v);
    if length_squared > 1e-30 {
        return v * inverseSqrt(length_squared);
    }
    return fallback;
}

fn transform_point(m: mat4x4<f32>, p: vec3<f32>) -> vec3<f32> {
    return (m * vec4<f32>(p, 1.0)).xyz;
}

fn linear_part(m: mat4x4<f32>) -> mat3x3<f32> {
    return mat3x3<f32>(m[0].xyz, m[1].xyz, m[2].xyz);
}

// The parameter at which a ray leaves through a face that it never reaches.
const NO_EXIT: f32 = 1e30;
// A ray with a larger reciprocal along an axis runs along that axis's planes: within a block of cells
// it moves across them by less than the margin of a cell (src/prepare/macrocells.rs).
const MAX_RECIPROCAL: f32 = 1e6;

fn reciprocals(direction: vec3<f32>) -> vec3<f32> {
    return select(1.0 / direction, vec3<f32>(NO_EXIT), abs(direction) < vec3<f32>(1e-30));
}

// The parameter at which a ray leaves a box.
fn leaves_box(low: vec3<f32>, high: vec3<f32>, origin: vec3<f32>, inverse_direction: vec3<f32>) -> f32 {
    let faces = max((low - origin) * inverse_direction, (high - origin) * inverse_direction);
    let far = select(faces, vec3<f32>(NO_EXIT), abs(inverse_direction) > vec3<f32>(MAX_RECIPROCAL));
    return min(far.x, min(far.y, far.z));
}
