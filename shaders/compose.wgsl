// Source and smallest mask of given points under the stack, evaluated through every map whatever
// the masks are. Counterpart of source_and_alpha_unclipped in src/deform/stack.rs.

@group(1) @binding(0) var<storage, read> points: array<vec4<f32>>;
@group(1) @binding(1) var<storage, read_write> composed: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&points) {
        return;
    }
    composed[id.x] = source_and_alpha_unclipped(points[id.x].xyz);
}
