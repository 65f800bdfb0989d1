// Stands in for count.wgsl where nobody asked.

fn count(pixel: vec2<f32>, n: vec3<u32>) {
}
