// Replaces count.wgsl when no counts are requested.

fn count(pixel: vec2<f32>, n: vec3<u32>) {
}
