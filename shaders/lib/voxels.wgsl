// The normalised value at a position in voxels, interpolated between voxels. For a volume given by
// a function, the text of src/render/function.rs replaces this file.
fn sample_volume(p: vec3<f32>) -> f32 {
    return sample_texture(volume, p, frame.texture_size, frame.per_texture_size).r * frame.value_scale
        + frame.value_offset;
}
