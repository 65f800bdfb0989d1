// Counterpart of src/deform/cut.rs.

fn shape_signed_distance_mm(k: u32, world: vec3<f32>) -> f32 {
    let q = transform_point(cuts[k].local_from_world, world);
    return outside_shape(cuts[k].shape, q, cuts[k].half, cuts[k].half_angle) * cuts[k].sense;
}

// Signed distance to what is removed, mm, positive where the volume is retained.
fn cuts_signed_distance_mm(world: vec3<f32>) -> f32 {
    var all = 1e30;
    var group = 1e30;
    for (var k = 0u; k < CUTS; k += 1u) {
        let d = shape_signed_distance_mm(k, world);
        if cuts[k].joins_previous == 0u {
            all = min(all, group);
            group = d;
        } else if cuts[k].intersects_group != 0u {
            group = max(group, d);
        } else {
            group = min(group, d);
        }
    }
    return min(all, group);
}

fn cuts_gradient(world: vec3<f32>, h: f32) -> vec3<f32> {
    let x = vec3<f32>(h, 0.0, 0.0);
    let y = vec3<f32>(0.0, h, 0.0);
    let z = vec3<f32>(0.0, 0.0, h);
    return vec3<f32>(
        cuts_signed_distance_mm(world + x) - cuts_signed_distance_mm(world - x),
        cuts_signed_distance_mm(world + y) - cuts_signed_distance_mm(world - y),
        cuts_signed_distance_mm(world + z) - cuts_signed_distance_mm(world - z),
    ) / (2.0 * h);
}
