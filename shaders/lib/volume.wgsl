// Counterpart of src/volume/gradient.rs and of look in src/cpu/mod.rs.

struct Look {
    in_voxel: vec3<f32>,
    // Normalised; only meaningful where matter is present.
    value: f32,
    // Neither cut away, nor outside the volume, nor in a hole.
    present: bool,
    // Smallest mask on the way: strictly between 0 and 1 near a cut.
    alpha: f32,
}

fn look(deformed: vec3<f32>) -> Look {
    if CUTS > 0u && cuts_kept(deformed) < 0.0 {
        return Look(vec3<f32>(0.0), 0.0, false, 0.0);
    }
    let source = walk(deformed);
    let in_voxel = transform_point(frame.voxel_from_world, source.xyz);
    if source.w < 0.5 || any(in_voxel < vec3<f32>(-0.5)) || any(in_voxel > frame.grid_size - 0.5) {
        return Look(in_voxel, 0.0, false, source.w);
    }
    let value = sample_volume(in_voxel);
    return Look(in_voxel, value, frame.has_holes == 0u || value >= -1e-4, source.w);
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
        // Beside the volume's faces a difference is taken at the face.
        if frame.gradient_scale != 0.0 && all(p >= vec3<f32>(0.0)) && all(p <= frame.grid_size - 1.0) {
            return sample_gradients(p) * frame.gradient_scale;
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
