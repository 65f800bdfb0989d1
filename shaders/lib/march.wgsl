// Counterpart of src/scene/camera.rs (ray), src/scene/macrocells.rs (empty_until) and the helpers of src/cpu/mod.rs.

struct Ray {
    origin: vec3<f32>,
    direction: vec3<f32>,
}

// The ray through a pixel's centre; pixel in 0 .. picture, y downwards.
fn pixel_ray(pixel: vec2<f32>) -> Ray {
    let u = pixel.x / frame.picture.x * 2.0 - 1.0;
    let v = 1.0 - pixel.y / frame.picture.y * 2.0;
    let across = frame.right * u + frame.up * v;
    if frame.perspective > 0.5 {
        return Ray(frame.eye, normalize(frame.forward + across));
    }
    return Ray(frame.eye + across, frame.forward);
}

fn first_sample_after(t: f32, step: f32) -> i32 {
    return i32(max(ceil(t / step - 0.5), 0.0));
}

// In occupied cells, and in those of them where no mask varies and no shape is near.
const OCCUPIED: f32 = -1.0;
const CLEAR: f32 = -2.0;
const CLEAR_CELL: u32 = 255u;

// Parameter at which a ray leaves the block of empty cells around p, or one of the numbers above.
fn empty_until(p: vec3<f32>, origin: vec3<f32>, inverse_direction: vec3<f32>) -> f32 {
    let cell = clamp(floor((p - frame.cells_origin) / frame.cell_mm), vec3<f32>(0.0), vec3<f32>(frame.cells) - 1.0);
    let d = cell_distance(vec3<i32>(cell));
    if d == 0u || d == CLEAR_CELL {
        return select(CLEAR, OCCUPIED, d == 0u);
    }
    let reach = f32(d);
    let low = frame.cells_origin + (cell - (reach - 1.0)) * frame.cell_mm;
    let high = frame.cells_origin + (cell + reach) * frame.cell_mm;
    let far = max((low - origin) * inverse_direction, (high - origin) * inverse_direction);
    return min(far.x, min(far.y, far.z));
}

// Colour of a sample after light, premultiplied by its opacity over `length` reference lengths. `depth` is its own optical depth, if it
// shows anything, and in a clear cell if `clear`; if not, it is near a cut, and what lies between the cut and it is looked for.
fn shaded_sample(at: Look, s: Sample, front: Front, clear: bool, direction: vec3<f32>, step: f32, length: f32) -> vec4<f32> {
    var depth = s.depth;
    var seen: Seen;
    if depth > 0.0 {
        seen = seen_sample(s, front, clear, direction, step);
    } else {
        seen = sliver(s.deformed, at.present, direction, step);
        depth = seen.s.depth;
        if depth <= 0.0 {
            return vec4<f32>(0.0);
        }
    }
    let shaded = shade_seen(seen, direction);
    let alpha = 1.0 - exp2(-depth * shaded.depth_factor * length);
    return vec4<f32>(shaded.color * alpha, alpha);
}

// What hides everything behind it at a sample: the grey face of a cut, or the surface of the volume. Alpha 0: nothing does.
fn opaque_face(at: Look, deformed: vec3<f32>, direction: vec3<f32>, step: f32) -> vec4<f32> {
    if GREY_FACES != 0u && at.present {
        let grey = grey_face(at, deformed, direction, step);
        if grey >= 0.0 {
            return vec4<f32>(vec3<f32>(grey), 1.0);
        }
    }
    if ISO != 0u && at.present && at.value >= frame.iso {
        return vec4<f32>(iso_surface(deformed, direction, step), 1.0);
    }
    return vec4<f32>(0.0);
}

fn near_a_face(at: Look, deformed: vec3<f32>, step: f32) -> bool {
    return at.alpha < 1.0 || (CUTS > 0u && cuts_kept(deformed) < 1.5 * step);
}

fn near_a_cut(at: Look) -> bool {
    return at.alpha > 0.0 && at.alpha < 1.0;
}
