// Counterpart of src/cpu/surface.rs and of light in src/cpu/surface_shading.rs.

const BISECTION_STEPS: i32 = 14;
const MIN_SPHERE_STEP: f32 = 0.25;
const THRESHOLD_STEP: f32 = 0.25;
const MAX_JACOBIAN_STEP: f32 = 8.0;
const MIN_BLIND_STEP: f32 = 1.0 / 64.0;
const SLOPE_MARGIN: f32 = 1.1;
const MIN_ADVANCE: f32 = 1e-6;
const MIN_CELL_ADVANCE: f32 = 2e-4;
const MIN_STEP: f32 = 1.0 / 65536.0;
const MAX_SAMPLES: u32 = 100000u;

const OUTSIDE: u32 = 0u;
const INSIDE: u32 = 1u;
const CUT_FACE: u32 = 2u;

struct SurfaceSample {
    t: f32,
    // f, or that of a thick skin; positive inside.
    f: f32,
    // Positive in a cut.
    cut: f32,
}

struct SurfaceEvent {
    // Negative: no hit.
    t: f32,
    side: u32,
}

struct Drawn {
    @location(0) color: vec4<f32>,
    @location(1) t: f32,
    @builtin(frag_depth) depth: f32,
}

// Increases with t, within 0..1.
fn depth_of(t: f32) -> f32 {
    return t / (t + 100.0 * frame.reference_mm);
}

fn depth_in_boxes(p: vec3<f32>) -> f32 {
    if object.rigid != 0u {
        return -1e30;
    }
    var depth = -1e30;
    for (var k = 0u; k < MAPS; k += 1u) {
        let x = transform_point(maps[k].map_from_world, p);
        let m = linear_part(maps[k].map_from_world);
        // Edge lengths of the box: map space is the unit cube, and its axes are the rows of the
        // inverse.
        let inverse = transpose(m);
        let size = 1.0 / vec3<f32>(length(inverse[0]), length(inverse[1]), length(inverse[2]));
        let inside = min(x + maps[k].reach, 1.0 + maps[k].reach - x) * size;
        depth = max(depth, min(inside.x, min(inside.y, inside.z)));
    }
    if CUTS > 0u {
        depth = max(depth, 2.0 * object.seam_mm - cuts_signed_distance_mm(p));
    }
    return depth;
}

fn is_undeformed(p: vec3<f32>) -> bool {
    let depth = depth_in_boxes(p);
    if depth <= 0.0 {
        return true;
    }
    if depth >= object.seam_mm {
        return false;
    }
    let s = source_and_alpha_unclipped(p);
    return s.w >= 0.5 && cuts_signed_distance_mm(p) >= 0.0
        && distance(s.xyz, p) < 0.25 * object.resolution_mm;
}

fn apply_cut_model(f: f32) -> f32 {
    return select(f, object.thickness_mm - f, object.thickness_mm > 0.0 && f > 0.5 * object.thickness_mm);
}

fn surface_sample(ray: Ray, t: f32) -> SurfaceSample {
    let p = ray.origin + ray.direction * t;
    if object.rigid != 0u {
        return SurfaceSample(t, apply_cut_model(implicit_value(p)), -1.0);
    }
    let s = source_and_alpha_unclipped(p);
    return SurfaceSample(
        t, apply_cut_model(implicit_value(s.xyz)), max(0.5 - s.w, -cuts_signed_distance_mm(p))
    );
}

// The parameter just beyond the end of a cell.
fn advanced(t: f32) -> f32 {
    let smallest = min(object.cell_mm.x, min(object.cell_mm.y, object.cell_mm.z));
    return t + MIN_CELL_ADVANCE * smallest + MIN_ADVANCE * t;
}

// Follows a ray to the first hit; counts the samples in `taken`.
fn trace(ray: Ray, taken: ptr<function, u32>) -> SurfaceEvent {
    let inverse = reciprocals(ray.direction);
    let low = (object.occupied_min - ray.origin) * inverse;
    let high = (object.occupied_max - ray.origin) * inverse;
    let nears = min(low, high);
    let fars = max(low, high);
    let near = max(nears.x, max(nears.y, nears.z));
    let far = min(fars.x, min(fars.y, fars.z));
    var event = SurfaceEvent(-1.0, OUTSIDE);
    var interval = 0.0;
    if object.steps == STEPS_UNIFORM || object.steps == STEPS_THRESHOLD {
        interval = object.step_mm;
    } else if object.steps == STEPS_JACOBIAN {
        interval = MAX_JACOBIAN_STEP * object.step_mm;
    }
    let finest = MIN_STEP * length(vec3<f32>(object.cells) * object.cell_mm);
    var walked_to = max(near, 0.0);
    var next_interval = 0.0;
    var before = SurfaceSample(FAR_AWAY, -1.0, -1.0);
    var stop = -FAR_AWAY;
    var slope = 1.0;
    var longest_blind = FAR_AWAY;
    var count = 0u;
    // No early return for a ray that misses: llvmpipe of Mesa 22.3 crashes on a return in front of
    // nested loops.
    var ended = near > far;
    while !ended && event.t < 0.0 {
        // Two loops instead of a branch: each ray of a group searches for a sign change, then all
        // refine together.
        var here = before;
        var last = before;
        var changed = false;
        while !ended && !changed {
            if count >= MAX_SAMPLES {
                ended = true;
                continue;
            }
            if before.t >= stop {
                if walked_to >= far {
                    ended = true;
                    continue;
                }
                let cell = object_cell(ray.origin + ray.direction * walked_to);
                let c = textureLoad(object_cells, vec3<i32>(cell), 0);
                if c.r > 0.5 {
                    walked_to = advanced(max(leaves(cell, c.r, ray, inverse), walked_to));
                    continue;
                }
                var begin = walked_to;
                if interval > 0.0 {
                    let number = max(floor(walked_to / interval + 0.5), next_interval);
                    next_interval = number + 1.0;
                    // Nothing is seen behind the eye.
                    begin = max((number - 0.5) * interval, 0.0);
                    stop = (number + 0.5) * interval;
                } else {
                    slope = max(c.g, 1e-3);
                    stop = advanced(max(leaves(cell, 1.0, ray, inverse), walked_to));
                }
                walked_to = stop;
                if before.t != begin {
                    before = surface_sample(ray, begin);
                    count += 1u;
                }
                longest_blind = FAR_AWAY;
            }
            let least = max(finest, MIN_ADVANCE * before.t);
            let length = max(min(step_length(ray, before, slope), longest_blind), least);
            here = surface_sample(ray, min(before.t + length, stop));
            count += 1u;
            last = before;
            changed = changes(before, here);
            let blind = here.t - before.t;
            if !changed && object.steps == STEPS_SPHERE && may_hide_a_surface(before, here, slope)
                && blind > 2.0 * max(least, MIN_BLIND_STEP * object.resolution_mm / max(slope, 1.0)) {
                longest_blind = 0.5 * blind;
                continue;
            }
            longest_blind = FAR_AWAY;
            before = here;
        }
        if changed {
            event = first_event(ray, last, here);
        }
    }
    *taken = count;
    return event;
}

fn changes(a: SurfaceSample, b: SurfaceSample) -> bool {
    return (a.f > 0.0) != (b.f > 0.0) || (object.solid != 0u && a.cut > 0.0 && b.cut <= 0.0);
}

fn may_hide_a_surface(a: SurfaceSample, b: SurfaceSample, slope: f32) -> bool {
    return object.kind != IMPLICIT_DEPTH
        && abs(a.f) + abs(b.f) < SLOPE_MARGIN * slope * (b.t - a.t);
}

fn step_length(ray: Ray, here: SurfaceSample, slope: f32) -> f32 {
    let even = object.step_mm;
    switch object.steps {
        case STEPS_UNIFORM: { return even; }
        case STEPS_THRESHOLD: {
            return select(even, even * THRESHOLD_STEP, abs(here.f) < object.threshold_mm);
        }
        case STEPS_JACOBIAN: {
            var stretch = 1.0;
            if object.rigid == 0u {
                stretch = length(jet(ray.origin + ray.direction * here.t).d_source_d_deformed * ray.direction);
            }
            return even / clamp(stretch, 1.0 / MAX_JACOBIAN_STEP, MAX_JACOBIAN_STEP);
        }
        case STEPS_JACOBIAN_BOUND: { return even / slope; }
        default: {
            if object.kind == IMPLICIT_DEPTH {
                return even;
            }
            let shortest = MIN_SPHERE_STEP * even / max(slope, 1.0);
            if here.cut > 0.0 && here.f > 0.0 && object.solid != 0u {
                return max(min(even, even / slope), shortest);
            }
            return max(0.9 * abs(here.f) / slope, shortest);
        }
    }
}

fn object_cell(p: vec3<f32>) -> vec3<f32> {
    return clamp(
        floor((p - object.cells_origin) / object.cell_mm), vec3<f32>(0.0), vec3<f32>(object.cells) - 1.0
    );
}

// Parameter at which a ray leaves the block of `reach` cells around the cell with this low corner.
fn leaves(cell: vec3<f32>, reach: f32, ray: Ray, inverse: vec3<f32>) -> f32 {
    let low = object.cells_origin + (cell - (reach - 1.0)) * object.cell_mm;
    let high = object.cells_origin + (cell + reach) * object.cell_mm;
    return leaves_box(low, high, ray.origin, inverse);
}

fn first_event(ray: Ray, a: SurfaceSample, b: SurfaceSample) -> SurfaceEvent {
    var best = SurfaceEvent(-1.0, OUTSIDE);
    if (a.f > 0.0) != (b.f > 0.0) {
        let s = bisect(ray, a, b, false);
        let entering = s[0].f <= 0.0;
        if max(s[0].cut, s[1].cut) <= 0.0 && (object.solid == 0u || entering) {
            var inner = false;
            if object.thickness_mm > 0.0 {
                let p = ray.origin + ray.direction * s[1].t;
                var source = p;
                if object.rigid == 0u {
                    source = source_and_alpha_unclipped(p).xyz;
                }
                inner = implicit_value(source) > 0.5 * object.thickness_mm;
            }
            best = SurfaceEvent(s[1].t, select(INSIDE, OUTSIDE, entering && !inner));
        }
    }
    if object.solid != 0u && a.cut > 0.0 && b.cut <= 0.0 {
        let s = bisect(ray, a, b, true);
        if s[1].f > 0.0 && (best.t < 0.0 || s[1].t < best.t) {
            best = SurfaceEvent(s[1].t, CUT_FACE);
        }
    }
    return best;
}

// The last sample before a sign change and the first one after it, of the surface or of the cut.
fn bisect(ray: Ray, a_start: SurfaceSample, b_start: SurfaceSample, of_cut: bool) -> array<SurfaceSample, 2> {
    var a = a_start;
    var b = b_start;
    let first = select(a.f > 0.0, a.cut > 0.0, of_cut);
    for (var n = 0; n < BISECTION_STEPS; n += 1) {
        let middle = surface_sample(ray, 0.5 * (a.t + b.t));
        if select(middle.f > 0.0, middle.cut > 0.0, of_cut) == first {
            a = middle;
        } else {
            b = middle;
        }
    }
    return array<SurfaceSample, 2>(a, b);
}

fn surface_normal(p: vec3<f32>, side: u32) -> vec3<f32> {
    var j = Jet(p, 1.0, mat3x3<f32>(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), NO_CUT);
    if object.rigid == 0u {
        j = jet(p);
    }
    if side == CUT_FACE {
        var cut = j.cut;
        let distance_mm = cuts_signed_distance_mm(p);
        if distance_mm < object.step_mm {
            cut = nearer_of(cut, abs(distance_mm), cuts_gradient(p, 0.05 * object.resolution_mm));
        }
        return cut.normal;
    }
    let outward = normalize_or(
        -(transpose(j.d_source_d_deformed) * implicit_gradient(j.source, object.resolution_mm)),
        vec3<f32>(0.0),
    );
    return select(outward, -outward, side == INSIDE);
}

fn surface_light(
    normal_in: vec3<f32>, at: vec3<f32>, direction: vec3<f32>, color: vec3<f32>
) -> vec3<f32> {
    let away = max(dot(normal_in, direction), 0.0);
    let normal = normalize_or(normal_in - direction * away, -direction);
    let shone = lit(
        color,
        dot(normal, frame.to_light),
        dot(normal, half_vector(direction)),
        object.highlight,
        object.shininess,
        light_shares(normal, 1.0, SOLID_DEPTH, at, direction),
    );
    return clamp(shone, vec3<f32>(0.0), vec3<f32>(1.0));
}
