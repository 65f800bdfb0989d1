// Counterpart of src/volume/gradient.rs and of value_at in src/cpu/mod.rs.

struct Value {
    in_voxel: vec3<f32>,
    // Normalised; only meaningful where matter is.
    value: f32,
    present: bool,
}

// xyz: where a point came from, in voxels; w: 1 unless it is cut away or outside the volume.
fn voxel_at(deformed: vec3<f32>) -> vec4<f32> {
    let source = source_from_deformed(deformed);
    let in_voxel = transform_point(frame.voxel_from_world, source.xyz);
    if source.w < 0.5 || any(in_voxel < vec3<f32>(-0.5)) || any(in_voxel > frame.grid_size - 0.5) {
        return vec4<f32>(in_voxel, 0.0);
    }
    return vec4<f32>(in_voxel, 1.0);
}

fn is_present(deformed: vec3<f32>) -> bool {
    return voxel_at(deformed).w > 0.5;
}

fn value_at(deformed: vec3<f32>) -> Value {
    let at = voxel_at(deformed);
    if at.w < 0.5 {
        return Value(at.xyz, 0.0, false);
    }
    let value = sample_volume(at.xyz);
    return Value(at.xyz, value, frame.has_holes == 0u || value >= -1e-4);
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

// Gradient of the normalised value per voxel along i, j, k.
fn gradient(p: vec3<f32>) -> vec3<f32> {
    if GRADIENT == 0u {
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
