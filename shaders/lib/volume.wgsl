// Counterpart of src/volume/sampler.rs (gradient) and of sample_scene in src/cpu/mod.rs.

struct SceneSample {
    in_voxel: vec3<f32>,
    // Normalised; only meaningful if `present`.
    value: f32,
    // Not cut away, not outside the volume, not in a hole.
    present: bool,
    // Smallest mask along the way: strictly between 0 and 1 near a cut.
    alpha: f32,
    // The result of gradient() here, if it was fetched with the value.
    gradient: vec3<f32>,
    has_gradient: bool,
}

const NOT_FETCHED: vec3<f32> = vec3<f32>(0.0);

fn sample_scene(deformed: vec3<f32>) -> SceneSample {
    return sample_scene_and_gradient(deformed, false);
}

// Also returns the gradient if gradients are stored with the values and requested.
fn sample_scene_and_gradient(deformed: vec3<f32>, with_gradient: bool) -> SceneSample {
    if CUTS > 0u && cuts_signed_distance_mm(deformed) < 0.0 {
        return SceneSample(vec3<f32>(0.0), 0.0, false, 0.0, NOT_FETCHED, false);
    }
    let source = source_and_alpha(deformed);
    let in_voxel = transform_point(frame.voxel_from_world, source.xyz);
    if source.w < 0.5 || any(in_voxel < vec3<f32>(-0.5)) || any(in_voxel > frame.grid_size - 0.5) {
        return SceneSample(in_voxel, 0.0, false, source.w, NOT_FETCHED, false);
    }
    if with_gradient && GRADIENT == GRADIENT_CENTRAL && frame.gradient_scale != 0.0 {
        let both = sample_gradients(in_voxel);
        return SceneSample(
            in_voxel,
            both.w,
            frame.has_holes == 0u || both.w >= -1e-4,
            source.w,
            both.xyz * frame.gradient_scale,
            is_in_grid(in_voxel),
        );
    }
    let value = sample_volume(in_voxel);
    return SceneSample(
        in_voxel, value, frame.has_holes == 0u || value >= -1e-4, source.w, NOT_FETCHED, false
    );
}

// Weights of the texels at -1, 0, 1, 2 around a position f in 0..1 by a cubic B-spline.
fn spline_weights(f: f32) -> vec4<f32> {
    let g = 1.0 - f;
    return vec4<f32>(g * g * g, 4.0 - 3.0 * f * f * (2.0 - f), 4.0 - 3.0 * g * g * (2.0 - g), f * f * f) / 6.0;
}

// Their derivatives.
fn spline_slopes(f: f32) -> vec4<f32> {
    let g = 1.0 - f;
    return vec4<f32>(-g * g, f * (3.0 * f - 4.0), g * (4.0 - 3.0 * g), f * f) / 2.0;
}

// Gradient per voxel and normalised value at a position in voxels by a cubic B-spline. Counterpart
// of src/volume/cubic.rs.
fn sample_cubic(p: vec3<f32>) -> vec4<f32> {
    let size = vec3<f32>(textureDimensions(volume));
    // Larger volumes than a device holds have fewer texels than voxels.
    let texels_per_voxel = size / frame.texture_size;
    let q = (p + 0.5) * texels_per_voxel - 0.5;
    let base = floor(q);
    let f = q - base;
    let last = vec3<i32>(size) - 1;
    var sum = vec4<f32>(0.0);
    // The weights of the voxels that have data.
    var counted = vec4<f32>(0.0);
    let x = spline_weights(f.x);
    let x_slopes = spline_slopes(f.x);
    let y = spline_weights(f.y);
    let y_slopes = spline_slopes(f.y);
    let z = spline_weights(f.z);
    let z_slopes = spline_slopes(f.z);
    for (var n = 0; n < 64; n += 1) {
        let at = vec3<i32>(n & 3, (n >> 2u) & 3, n >> 4u);
        let texel = clamp(vec3<i32>(base) + at - 1, vec3<i32>(0), last);
        let value = textureLoad(volume, texel, 0).r * frame.value_scale + frame.value_offset;
        let weight = vec4<f32>(
            x_slopes[at.x] * y[at.y] * z[at.z],
            x[at.x] * y_slopes[at.y] * z[at.z],
            x[at.x] * y[at.y] * z_slopes[at.z],
            x[at.x] * y[at.y] * z[at.z],
        );
        if value >= -1e-4 {
            sum += weight * value;
            counted += weight;
        }
    }
    if counted.w < 1e-6 {
        return vec4<f32>(0.0, 0.0, 0.0, -1.0);
    }
    let value = sum.w / counted.w;
    return vec4<f32>((sum.xyz - counted.xyz * value) / counted.w * texels_per_voxel, value);
}

fn central(p: vec3<f32>) -> vec3<f32> {
    let x = vec3<f32>(1.0, 0.0, 0.0);
    let y = vec3<f32>(0.0, 1.0, 0.0);
    let z = vec3<f32>(0.0, 0.0, 1.0);
    return vec3<f32>(
        sample_volume(p + x) - sample_volume(p - x),
        sample_volume(p + y) - sample_volume(p - y),
        sample_volume(p + z) - sample_volume(p - z),
    ) * 0.5;
}

// Outside this range a difference is taken at the volume's face.
fn is_in_grid(p: vec3<f32>) -> bool {
    return all(p >= vec3<f32>(0.0)) && all(p <= frame.grid_size - 1.0);
}

// Gradient of the normalised value per voxel along i, j, k.
fn gradient(p: vec3<f32>) -> vec3<f32> {
    if GRADIENT == GRADIENT_CENTRAL {
        if frame.gradient_scale != 0.0 && is_in_grid(p) {
            return sample_gradients(p).xyz * frame.gradient_scale;
        }
        return central(p);
    }
    var g = vec3<f32>(0.0);
    for (var n = 0; n < 4; n += 1) {
        let a = select(-0.5, 0.5, (n & 2) != 0);
        let b = select(-0.5, 0.5, (n & 1) != 0);
        g.x += central(p + vec3<f32>(0.0, a, b)).x;
        g.y += central(p + vec3<f32>(a, 0.0, b)).y;
        g.z += central(p + vec3<f32>(a, b, 0.0)).z;
    }
    return g * 0.25;
}
