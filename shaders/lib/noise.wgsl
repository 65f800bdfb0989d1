// Counterpart of noise in src/volume/function/evaluate.rs.

fn noise_at(cell: vec3<i32>) -> f32 {
    let p = bitcast<vec3<u32>>(cell);
    var h = (p.x * 0x8da6b343u) ^ (p.y * 0xd8163841u) ^ (p.z * 0xcb1ab31fu);
    h = (h ^ (h >> 13u)) * 0x5bd1e995u;
    return f32((h ^ (h >> 15u)) & 0xffffu) / 32767.5 - 1.0;
}

fn noise_along_x(cell: vec3<i32>, f: f32) -> f32 {
    return mix(noise_at(cell), noise_at(cell + vec3<i32>(1, 0, 0)), f);
}

// Smooth value noise in [-1, 1].
fn noise(p: vec3<f32>) -> f32 {
    let cell = vec3<i32>(floor(p));
    let t = p - floor(p);
    let f = t * t * (3.0 - 2.0 * t);
    let near = mix(noise_along_x(cell, f.x), noise_along_x(cell + vec3<i32>(0, 1, 0), f.x), f.y);
    let far = mix(
        noise_along_x(cell + vec3<i32>(0, 0, 1), f.x),
        noise_along_x(cell + vec3<i32>(0, 1, 1), f.x),
        f.y,
    );
    return mix(near, far, f.z);
}
