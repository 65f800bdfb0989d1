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

// How far a ray has come.
struct Advance {
    // Index of the next sample.
    i: i32,
    // Whether samples were skipped before it, or none is left.
    skipped: bool,
    // Whether the ray is in a block of cut-free cells, and up to which t.
    cut_free: bool,
    cut_free_until: f32,
}

// Skips the rest of the block of empty cells around the next sample, if it lies in one.
fn advanced(way: Advance, ray: Ray, inverse_direction: vec3<f32>, end: i32, step: f32) -> Advance {
    var next = way;
    let middle = (f32(way.i) + 0.5) * step;
    next.skipped = way.i >= end;
    if next.skipped || middle < way.cut_free_until {
        return next;
    }
    let block = block_around(ray.origin + ray.direction * middle, ray.origin, inverse_direction);
    if block.empty {
        next.i = min(max(first_sample_after(block.until, step), way.i + 1), end);
        next.skipped = true;
    } else {
        next.cut_free = block.cut_free;
        next.cut_free_until = select(NEVER, block.until, block.cut_free);
    }
    return next;
}

// Composites samples first .. end of a ray, at (i + 1/2) step; `hidden`: something opaque lies in front
// of the next one.
fn composite(pixel: vec2<f32>, ray: Ray, first: i32, end: i32, step: f32, hidden: bool) -> RaySamples {
    let inverse_direction = reciprocals(ray.direction);
    let length = step / frame.reference_mm;
    let half = half_vector(ray.direction);
    let needs_gradients = shades_by_gradient();
    var color = vec4<f32>(0.0);
    var projected = select(0.0, select(-1e30, 1e30, BLEND == BLEND_MINIP), BLEND != BLEND_AVERAGE);
    var present_count = 0.0;
    // Samples taken, skipped, and terminated behind opaque ones.
    var counted = vec3<u32>(0u);
    // The last sample, and the index after it. If it has something to shade, it waits for the next
    // one, since what it represents depends on both of its neighbours.
    var last: FoundSample;
    var before = EMPTY_NEIGHBOUR;
    var last_at = -2;
    var waiting = false;
    // Whether a thin layer may lie in front of it that has not been searched for.
    var layered = false;
    var way = Advance(first, false, false, NEVER);
    while way.i < end || waiting || layered {
        // Two loops, not a branch: rays run in lockstep, and shading costs far more than sampling.
        // The rays of a group sample until each has something to shade.
        var stop = layered;
        var found = last;
        found.thin = true;
        layered = false;
        while (way.i < end || waiting) && !stop {
            let middle = (f32(way.i) + 0.5) * step;
            let reached = way.i;
            way = advanced(way, ray, inverse_direction, end, step);
            counted.y += u32(way.i - reached);
            if way.skipped {
                // The next sample lies in an empty cell, or past the end of the ray.
                if waiting {
                    found = last;
                    found.next = EMPTY_NEIGHBOUR;
                    found.hidden = hidden && last_at >= end;
                    waiting = false;
                    stop = true;
                }
                continue;
            }
            let sampled = ray.origin + ray.direction * middle;
            var previous = EMPTY_NEIGHBOUR;
            if last_at == way.i {
                previous = before;
            }
            let is_first = way.i == 0;
            // Visible samples come in runs: the next one is likely to be shaded too.
            let with_gradient = needs_gradients && last_at == way.i && before.depth > 0.0;
            let at = sample_scene_and_gradient(sampled, with_gradient);
            way.i += 1;
            counted.x += 1u;
            if BLEND != BLEND_COMPOSITE {
                if at.present {
                    present_count += 1.0;
                    projected = insert_value(projected, at.value);
                }
                continue;
            }
            if PREINTEGRATED != 0u && !is_first && previous.state != SAMPLED && at.present {
                previous = as_neighbour(sample_scene(ray.origin + ray.direction * (middle - step)));
            }
            before = as_neighbour(at);
            if is_first {
                // Behind the eye lies what lies before it.
                previous = before;
            }
            if waiting {
                found = last;
                found.next = before;
                waiting = false;
                stop = true;
            }
            let s = found_sample(at, sampled, previous);
            last = FoundSample(s, at.present, at.alpha, false, way.cut_free, false, previous, before);
            last_at = way.i;
            waiting = to_be_shaded(at, s.depth, sampled, step);
            if may_hide_a_layer(before, previous) && near_edge(at, sampled, step) {
                layered = stop;
                if !stop {
                    found = last;
                    found.thin = true;
                    stop = true;
                }
            }
        }
        if stop {
            let shaded = shaded_sample(found, ray.direction, half, step, length);
            color += shaded.color * (1.0 - color.a);
            let is_opaque = 1.0 - color.a < MIN_TRANSMITTANCE && frame.early_termination != 0u;
            if shaded.is_face || is_opaque {
                counted.z += u32(max(end - way.i, 0));
                break;
            }
        }
    }
    count(pixel, counted);
    return RaySamples(color, projected, present_count);
}
