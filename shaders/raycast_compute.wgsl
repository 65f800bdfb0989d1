// One ray per invocation: raycast.wgsl without the rasteriser. Server GPUs draw fragments on only a
// small part of their processors.

@group(1) @binding(1) var picture: texture_storage_2d<rgba16float, write>;
// The first row of this dispatch; the other components are unused.
@group(1) @binding(2) var<uniform> band: vec4<u32>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = vec2<u32>(id.x, id.y + band.x);
    if any(pixel >= textureDimensions(picture)) {
        return;
    }
    textureStore(picture, pixel, ray_color(vec2<f32>(pixel) + 0.5));
}
