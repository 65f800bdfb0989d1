// Evaluates the shared functions at given points, for tests that compare numbers before pictures.

struct Probe {
    source: vec3<f32>,
    alpha: f32,
    column_x: vec3<f32>,
    cut_distance_mm: f32,
    column_y: vec3<f32>,
    value: f32,
    column_z: vec3<f32>,
    depth: f32,
    cut_normal: vec3<f32>,
    gradient_x: f32,
    gradient_yz: vec2<f32>,
    padding: vec2<f32>,
}

@group(1) @binding(0) var<storage, read> points: array<vec4<f32>>;
@group(1) @binding(1) var<storage, read_write> probes: array<Probe>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&points) {
        return;
    }
    let j = jet(points[id.x].xyz);
    let in_voxel = transform_point(frame.voxel_from_world, j.source);
    let value = sample_volume(in_voxel);
    let g = gradient(in_voxel);
    let m = j.d_source_d_deformed;
    probes[id.x] = Probe(
        j.source,
        j.alpha,
        m[0],
        j.cut.distance_mm,
        m[1],
        value,
        m[2],
        lookup(value).a,
        j.cut.normal,
        g.x,
        g.yz,
        vec2<f32>(0.0),
    );
}
