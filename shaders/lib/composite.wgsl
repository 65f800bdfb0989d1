// Composites the samples of a ray front to back.

const NEVER: f32 = -1e30;

struct RaySamples {
    // Premultiplied.
    color: vec4<f32>,
    // Greatest, smallest or summed value of a projection, and the number of samples in it.
    projected: f32,
    present_count: f32,
}

// Where a ray enters and leaves the box of what is visible; it misses if near > far.
fn proxy_range(origin: vec3<f32>, inverse_direction: vec3<f32>) -> vec2<f32> {
    let a = (frame.proxy_min - origin) * inverse_direction;
    let b = (frame.proxy_max - origin) * inverse_direction;
    let nears = min(a, b);
    let fars = max(a, b);
    return vec2<f32>(max(nears.x, max(nears.y, nears.z)), min(fars.x, min(fars.y, fars.z)));
}

// Composites samples first .. end of a ray, at (i + 1/2) step.
fn composite(pixel: vec2<f32>, ray: Ray, first: i32, end: i32, step: f32) -> RaySamples {
    let inverse_direction = reciprocals(ray.direction);
    let length = step / frame.reference_mm;
    let half = half_vector(ray.direction);
    let needs_gradients = shades_by_gradient();
    var i = first;
    var color = vec4<f32>(0.0);
    var projected = select(0.0, select(-1e30, 1e30, BLEND == BLEND_MINIP), BLEND != BLEND_AVERAGE);
    var present_count = 0.0;
    // Samples taken, skipped, and terminated behind opaque ones.
    var counted = vec3<u32>(0u);
    // Value and index of the last present sample.
    var before = 0.0;
    var before_at = -2;
    // Depth of the last sample (see PreviousSample), and the index after it.
    var last_depth = 0.0;
    var last_at = -2;
    // Whether the ray is in a block of cut-free cells, and up to which t.
    var cut_free = false;
    var cut_free_until = NEVER;
    while i < end {
        // Two loops, not a branch: rays run in lockstep, and shading costs far more than sampling.
        // The rays of a group sample until each has something to shade.
        var stop = false;
        var found: VisibleSample;
        var at: SceneSample;
        var share = 1.0;
        var front: PreviousSample;
        while i < end && !stop {
            let middle = (f32(i) + 0.5) * step;
            if !(middle < cut_free_until) {
                let block = block_around(ray.origin + ray.direction * middle, ray.origin, inverse_direction);
                if block.empty {
                    let next = min(max(first_sample_after(block.until, step), i + 1), end);
                    counted.y += u32(next - i);
                    i = next;
                    continue;
                }
                cut_free = block.cut_free;
                cut_free_until = select(NEVER, block.until, cut_free);
            }
            let part = retained_part(ray.origin, ray.direction, middle, step);
            i += 1;
            counted.x += 1u;
            if part.share <= 0.0 {
                continue;
            }
            share = part.share;
            let sampled = ray.origin + ray.direction * part.t;
            // Visible samples come in runs: the next one is likely to be shaded too.
            at = sample_scene_and_gradient(sampled, needs_gradients && i - 1 == last_at && last_depth > 0.0);
            // The same point, bit for bit, whether or not it was sampled.
            let previous = sampled - ray.direction * step;
            front = PreviousSample(previous, NOT_SAMPLED);
            if share == 1.0 {
                front.point = ray.origin + ray.direction * ((f32(i) - 1.5) * step);
                front.depth = select(NOT_SAMPLED, last_depth, last_at == i - 1);
            }
            if BLEND != BLEND_COMPOSITE {
                if at.present {
                    present_count += 1.0;
                    projected = insert_value(projected, at.value);
                }
                continue;
            }
            if PREINTEGRATED == 0u {
                found = visible_sample(at, sampled);
                if share == 1.0 {
                    last_depth = select(ABSENT, found.depth, at.present);
                    last_at = i;
                }
            } else {
                let front = front_value(at, previous, before, CUTS == 0u && before_at == i - 2);
                if at.present {
                    before = at.value;
                    before_at = i - 1;
                }
                found = visible_segment_sample(at, front, sampled);
            }
            stop = to_be_shaded(at, found.depth, sampled, step);
        }
        if stop {
            let face = opaque_face(at, found.deformed, ray.direction, step);
            if face.a > 0.0 {
                color += face * (1.0 - color.a);
            } else if ISO == ISO_NONE {
                color += shaded_sample(
                    at, found, front, cut_free, ray.direction, half, step, length * share
                ) * (1.0 - color.a);
            }
            let is_opaque = 1.0 - color.a < MIN_TRANSMITTANCE && frame.early_termination != 0u;
            if face.a > 0.0 || is_opaque {
                counted.z += u32(max(end - i, 0));
                break;
            }
        }
    }
    count(pixel, counted);
    return RaySamples(color, projected, present_count);
}
