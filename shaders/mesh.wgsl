// Triangles moved by forward deformers. Counterpart of shade_triangle in src/cpu/surface_shading.rs.

struct Vertex {
    @builtin(position) position: vec4<f32>,
    @location(0) world: vec3<f32>,
    @location(1) normal: vec3<f32>,
}

@vertex
fn vertex(@location(0) position: vec3<f32>, @location(1) normal: vec3<f32>) -> Vertex {
    let moved = deform_vertex(position, normal);
    return Vertex(frame.clip_from_world * vec4<f32>(moved[0], 1.0), moved[0], moved[1]);
}

@fragment
fn fragment(vertex: Vertex, @builtin(front_facing) front: bool) -> Drawn {
    let ray = pixel_ray(vertex.position.xy);
    if object.both != 0u && !is_undeformed(vertex.world) {
        discard;
    }
    let t = dot(vertex.world - ray.origin, ray.direction);
    let normal = normalize_or(vertex.normal, -ray.direction);
    let color = surface_light(
        select(-normal, normal, front),
        vertex.world,
        ray.direction,
        select(object.inside, object.color, front),
    );
    return Drawn(vec4<f32>(color, 1.0), t, depth_of(t));
}
