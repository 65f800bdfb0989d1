// Counterpart of src/deform/cut.rs.

const ROOT_STEPS: i32 = 4;

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

// The retained part of a step: where its sample lies, and its fraction of the step.
struct RetainedPart {
    t: f32,
    share: f32,
}

fn retained_part(origin: vec3<f32>, direction: vec3<f32>, t: f32, step: f32) -> RetainedPart {
    if CUTS == 0u {
        return RetainedPart(t, 1.0);
    }
    let half = 0.5 * step;
    let middle = vec2<f32>(t, cuts_signed_distance_mm(origin + direction * t));
    if abs(middle.y) > half {
        return RetainedPart(t, select(0.0, 1.0, middle.y > 0.0));
    }
    let low = vec2<f32>(t - half, cuts_signed_distance_mm(origin + direction * (t - half)));
    let high = vec2<f32>(t + half, cuts_signed_distance_mm(origin + direction * (t + half)));
    if middle.y >= 0.0 {
        var a = low.x;
        var b = high.x;
        if low.y < 0.0 {
            a = cut_root(origin, direction, middle, low);
        }
        if high.y < 0.0 {
            b = cut_root(origin, direction, middle, high);
        }
        return RetainedPart(0.5 * (a + b), (b - a) / step);
    }
    var a = low.x;
    var b = high.x;
    if low.y >= 0.0 {
        a = cut_root(origin, direction, low, middle);
    }
    if high.y >= 0.0 {
        b = cut_root(origin, direction, high, middle);
    }
    if low.y >= 0.0 && high.y >= 0.0 {
        // If both ends are retained, the nearer one is sampled; the fraction counts both.
        return RetainedPart(0.5 * (low.x + a), (a - low.x + high.x - b) / step);
    }
    if low.y >= 0.0 {
        return RetainedPart(0.5 * (low.x + a), (a - low.x) / step);
    }
    if high.y >= 0.0 {
        return RetainedPart(0.5 * (b + high.x), (high.x - b) / step);
    }
    return RetainedPart(t, 0.0);
}

fn cut_root(origin: vec3<f32>, direction: vec3<f32>, outside_start: vec2<f32>, cut_start: vec2<f32>) -> f32 {
    var outside = outside_start;
    var cut = cut_start;
    for (var n = 0; n < ROOT_STEPS; n += 1) {
        let t = outside.x + (cut.x - outside.x) * clamp(outside.y / (outside.y - cut.y), 0.0, 1.0);
        let v = cuts_signed_distance_mm(origin + direction * t);
        if abs(v) < 1e-4 {
            return t;
        }
        if v >= 0.0 {
            outside = vec2<f32>(t, v);
        } else {
            cut = vec2<f32>(t, v);
        }
    }
    return outside.x + (cut.x - outside.x) * clamp(outside.y / (outside.y - cut.y), 0.0, 1.0);
}
