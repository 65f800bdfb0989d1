// Evaluates a map's formula at its grid points: D, alpha, and the largest component of D.
// encode.wgsl turns these into texels and bounds.wgsl into bounds. Counterpart of
// MapDefinition::sample in src/deform/field.rs.

struct MapDefinition {
    cube_mm: vec3<f32>,
    ramp_mm: f32,
    // Grid points along x, y, z.
    size: vec3<u32>,
    kind: u32,
    numbers: array<vec4<f32>, 4>,
}

@group(0) @binding(0) var<uniform> definition: MapDefinition;
// D and alpha.
@group(0) @binding(1) var<storage, read_write> samples: array<vec4<f32>>;
// Bits of the largest component of D: the bits of non-negative floats sort as the floats do.
@group(0) @binding(2) var<storage, read_write> largest: atomic<u32>;

var<workgroup> largest_of_group: atomic<u32>;

fn grid_coordinate(i: u32, points: u32) -> f32 {
    return select(0.5, f32(i) / f32(max(points, 2u) - 1u), points > 1u);
}

@compute @workgroup_size(4, 4, 4)
fn sample(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) first: u32) {
    var bits = 0u;
    if all(id < definition.size) {
        let x = vec3<f32>(
            grid_coordinate(id.x, definition.size.x),
            grid_coordinate(id.y, definition.size.y),
            grid_coordinate(id.z, definition.size.z),
        );
        let local = (x - 0.5) * definition.cube_mm;
        let b = backward_of(local);
        var t = vec4<f32>(
            (b.xyz - local) / definition.cube_mm, clamp(0.5 + 0.5 * b.w / definition.ramp_mm, 0.0, 1.0)
        );
        // A value that is not finite becomes no displacement and mask 0. Compared by bits, because
        // a shader need not support infinities.
        if any((bitcast<vec4<u32>>(t) & vec4<u32>(0x7F800000u)) == vec4<u32>(0x7F800000u)) {
            t = vec4<f32>(0.0);
        }
        samples[(id.z * definition.size.y + id.y) * definition.size.x + id.x] = t;
        bits = bitcast<u32>(max(abs(t.x), max(abs(t.y), abs(t.z))));
    }
    atomicMax(&largest_of_group, bits);
    workgroupBarrier();
    if first == 0u {
        atomicMax(&largest, atomicLoad(&largest_of_group));
    }
}
