// Counterpart of src/cpu/edges.rs.

const EDGE_RATIO: f32 = 0.65;
const EDGE_STEPS: i32 = 4;
const THIN_LAYER_SAMPLES: i32 = 8;
const OPAQUE_DEPTH: f32 = 9.0;
const LN_2: f32 = 0.6931472;

// What is known of a neighbour: it lies where nothing is visible; it has been sampled; it has not.
const EMPTY: u32 = 0u;
const SAMPLED: u32 = 1u;
const UNKNOWN: u32 = 2u;

// The sample one step in front of another, or behind it.
struct Neighbour {
    state: u32,
    present: bool,
    // Optical depth; 0 where nothing is visible.
    depth: f32,
    value: f32,
    alpha: f32,
}

const EMPTY_NEIGHBOUR: Neighbour = Neighbour(EMPTY, false, 0.0, 0.0, 0.0);
const UNKNOWN_NEIGHBOUR: Neighbour = Neighbour(UNKNOWN, false, 0.0, 0.0, 0.0);

fn as_neighbour(at: SceneSample) -> Neighbour {
    return Neighbour(SAMPLED, at.present, own_depth(at), at.value, at.alpha);
}

// Optical depth of a sample itself, as opposed to that of the segment in front of it.
fn own_depth(at: SceneSample) -> f32 {
    return select(0.0, lookup(at.value).a, at.present);
}

// A sample that has something to shade, or a layer in front of it.
struct FoundSample {
    s: VisibleSample,
    present: bool,
    alpha: f32,
    // It stands for a thin layer in front of it, if there is one.
    thin: bool,
    // No cut except the volume's faces can be near.
    cut_free: bool,
    // Something opaque lies between it and the next sample.
    hidden: bool,
    previous: Neighbour,
    next: Neighbour,
}

// What a sample represents, and where it is shaded.
struct SampleExtent {
    // The sample, or the first of a thin layer; if none was found, `spacing` is still the step.
    at: FoundSample,
    // Where the ray enters the material, else the sample itself.
    entry: VisibleSample,
    entered: bool,
    through_cut: bool,
    // Optical depth of what it represents, over a step of its own density.
    share: f32,
    // Density that the samples around a thin layer represent.
    floor: f32,
    // Distance to the neighbours, mm.
    spacing: f32,
}

// Whether something is visible with that value.
fn shows(present: bool, value: f32, depth: f32) -> bool {
    if ISO != ISO_NONE {
        return present && value >= frame.iso;
    }
    return depth > 0.0;
}

// The mean depth to which one sees into a uniform stretch of an optical depth (powers of e), as a
// share of its length: 1/2 if it is thin, near 0 if it is opaque.
fn mean_depth_seen(optical_depth: f32) -> f32 {
    if optical_depth < 0.1 {
        return 0.5 - optical_depth / 12.0;
    }
    let passed = exp2(min(optical_depth, 60.0) / LN_2) - 1.0;
    return (passed - optical_depth) / (optical_depth * passed);
}

// Whether the step between two samples is bisected.
fn differs(depth: f32, other: f32) -> bool {
    return min(depth, other) < EDGE_RATIO * max(depth, other);
}

fn within_mask(alpha: f32) -> bool {
    return alpha > 0.0 && alpha < 0.5;
}

// The length of a bisected stretch that a sample represents, by its own density. The thinner
// neighbour represents what lies on its side of the crossing, and the denser one the rest of the
// optical depth.
fn represented(x: ExtentSearch, of_neighbour: f32) -> f32 {
    let depth = x.e.at.s.depth;
    let drop = x.near_depth - x.far_depth;
    let width = x.far - x.near;
    var part = 0.5;
    var near_end = min(x.near_depth, x.cap);
    var far_end = min(x.far_depth, x.cap);
    if x.far_present && x.far < x.e.spacing && abs(drop) > 1e-6 {
        part = clamp((x.near_depth - x.enough) / drop, 0.0, 1.0);
        near_end = 0.5 * (near_end + x.enough);
        far_end = 0.5 * (far_end + x.enough);
    }
    let distance = x.near + width * part;
    if !x.dense_here || depth <= 1e-20 {
        return distance;
    }
    let integral = x.integral + width * (part * near_end + (1.0 - part) * far_end);
    return max(integral - of_neighbour * (x.e.spacing - distance), 0.0) / depth;
}

// Whether a cut or a face of the volume passes between a sample and the previous one, and both are
// so thin that a layer thinner than a step may lie between them.
fn may_hide_a_layer(at: Neighbour, previous: Neighbour) -> bool {
    var thin = max(at.depth, previous.depth) < frame.thin_depth;
    if ISO != ISO_NONE {
        thin = !shows(previous.present, previous.value, 0.0) && !shows(at.present, at.value, 0.0);
    }
    return thin && previous.state == SAMPLED && (at.present != previous.present
        || (!at.present && within_mask(at.alpha) && within_mask(previous.alpha)));
}

// Whether a mask's edge, a cut shape or a face of the volume is near.
fn near_edge(at: SceneSample, sampled: vec3<f32>, step: f32) -> bool {
    let reached = all(at.in_voxel >= -0.5 - frame.face) && all(at.in_voxel <= frame.grid_size - 0.5 + frame.face);
    // What a shape removes has no source position.
    return is_near_mask_edge(at) || (at.alpha > 0.0 && reached && !far_from_faces(at.in_voxel))
        || (CUTS > 0u && abs(cuts_signed_distance_mm(sampled)) <= frame.blend_far_mm + 2.2 * step);
}

// The samples that a search takes, in this order; each kind begins with n = 0.
const FRONT_SAMPLE: i32 = 0;
const LAYER: i32 = 1;
const FRONT: i32 = 2;
const CUT: i32 = 3;
const BEHIND_CUT: i32 = 4;
const NEXT_SAMPLE: i32 = 5;
const BACK: i32 = 6;
const SEEN: i32 = 7;
const DONE: i32 = 8;

// A search for what a sample represents.
struct ExtentSearch {
    e: SampleExtent,
    // It represents the pre-integrated segment in front of it.
    segment: bool,
    // The density of the sample found.
    own_depth: f32,
    turn: i32,
    n: i32,
    // Lengths in front of the sample, of a thin layer from it on, and behind it, mm.
    before: f32,
    layer: f32,
    behind: f32,
    // A bisection: distances of its ends, mm, and the threshold and whether the density at the near
    // end exceeds it.
    near: f32,
    far: f32,
    enough: f32,
    dense_here: bool,
    // The ray comes out of a cut.
    from_cut: bool,
    // The integral of the density over what is bisected, mm times density. What is denser than both
    // ends is a layer of its own.
    cap: f32,
    integral: f32,
    // The densities found nearest to the crossing on both sides.
    near_depth: f32,
    far_depth: f32,
    // Whether the first point on the far side is present, and whether it is known.
    far_present: bool,
    far_found: bool,
}

// What a sample found represents of its ray: one loop around one sample, whatever it is for.
fn extent(found: FoundSample, direction: vec3<f32>, step: f32) -> SampleExtent {
    var x: ExtentSearch;
    x.e = SampleExtent(found, found.s, false, false, 0.0, 0.0, step);
    x.own_depth = select(0.0, found.s.depth, found.present);
    x.segment = PREINTEGRATED != 0u && !found.thin;
    x.turn = select(select(FRONT, LAYER, found.thin), FRONT_SAMPLE, found.previous.state == UNKNOWN);
    loop {
        x = begun(x, step);
        if x.turn == SEEN && !x.e.entered {
            x.turn = DONE;
        }
        if x.turn == DONE {
            break;
        }
        let q = searched_point(x, found.s.deformed, direction, step);
        let at = sample_scene(q);
        x = taken(x, at, q, direction, found.present, step);
    }
    x.e.share = (x.before + x.layer + x.behind) / step;
    return x.e;
}

// Begins a bisection, or passes on to what follows.
fn begun(search: ExtentSearch, step: f32) -> ExtentSearch {
    var x = search;
    let depth = x.e.at.s.depth;
    if x.turn == FRONT && x.n == 0 {
        let other = x.e.at.previous;
        x.e.entered = other.depth < 0.5 * depth;
        x.before = select(0.5 * x.e.spacing, x.e.spacing, x.segment);
        x.near = 0.0;
        x.far = x.e.spacing;
        x.from_cut = x.e.entered && other.state == SAMPLED && !other.present;
        x.enough = select(0.5 * (depth + other.depth), -1.0, x.from_cut);
        x.dense_here = other.depth < depth;
        x.integral = 0.0;
        x.cap = max(depth, other.depth);
        x.near_depth = depth;
        x.far_depth = other.depth;
        x.far_present = other.present;
        x.far_found = other.state == SAMPLED;
        if !x.e.entered && (x.segment || !differs(depth, other.depth)) {
            x.turn = NEXT_SAMPLE;
        }
    }
    let hidden = x.e.at.hidden || !sees_behind(depth, step);
    if x.turn == NEXT_SAMPLE && (hidden || x.e.at.next.state != UNKNOWN) {
        x.turn = BACK;
    }
    if x.turn == BACK && x.n == 0 {
        let other = x.e.at.next;
        x.behind = select(0.5 * x.e.spacing, 0.0, x.segment);
        x.near = 0.0;
        x.far = x.e.spacing;
        x.enough = 0.5 * (depth + other.depth);
        x.dense_here = x.segment || other.depth < depth;
        x.integral = 0.0;
        x.cap = max(depth, other.depth);
        x.near_depth = depth;
        x.far_depth = other.depth;
        x.far_present = other.present;
        let ends = x.segment && other.state == SAMPLED && !other.present;
        if hidden || !(ends || (!x.segment && differs(depth, other.depth))) {
            x.turn = SEEN;
        }
    }
    return x;
}

// Where a search samples next.
fn searched_point(x: ExtentSearch, deformed: vec3<f32>, direction: vec3<f32>, step: f32) -> vec3<f32> {
    let middle = select(0.5 * (x.near + x.far), x.e.spacing, x.n == EDGE_STEPS);
    switch x.turn {
        case FRONT_SAMPLE: { return deformed - direction * step; }
        case LAYER: {
            return deformed - direction * (step - (f32(x.n) + 0.5) * step / f32(THIN_LAYER_SAMPLES));
        }
        case FRONT, BEHIND_CUT: { return x.e.at.s.deformed - direction * middle; }
        case CUT: { return x.e.entry.deformed + direction * (0.5 * frame.reference_mm); }
        case NEXT_SAMPLE: { return deformed + direction * step; }
        case SEEN: {
            // The mean depth to which one sees into the material that the ray enters.
            let length = x.before + x.layer + x.behind;
            let optical_depth = x.e.at.s.depth * length * LN_2 / frame.reference_mm;
            return x.e.entry.deformed + direction * (length * mean_depth_seen(optical_depth));
        }
        default: { return x.e.at.s.deformed + direction * (x.layer + middle); }
    }
}

// Evaluates the sample of a search.
fn taken(
    search: ExtentSearch, at: SceneSample, q: vec3<f32>, direction: vec3<f32>, present: bool, step: f32
) -> ExtentSearch {
    var x = search;
    let there = visible_sample(at, q);
    if x.turn == FRONT_SAMPLE {
        x.e.at.previous = as_neighbour(at);
        x.turn = select(FRONT, LAYER, x.e.at.thin);
        let own = Neighbour(SAMPLED, present, x.own_depth, x.e.at.s.value, x.e.at.alpha);
        if x.e.at.thin && !may_hide_a_layer(own, x.e.at.previous) {
            x.turn = DONE;
        }
    } else if x.turn == LAYER {
        x = layer_taken(x, at, there, present, step);
    } else if x.turn == CUT {
        // Directly behind a cut lies its face, or thinner material in front of a surface.
        x.e.through_cut = !(x.e.entry.depth < 0.5 * there.depth);
        x.turn = select(BEHIND_CUT, NEXT_SAMPLE, x.e.through_cut);
        x.near = 0.0;
        x.far = dot(x.e.at.s.deformed - x.e.entry.deformed, direction);
        x.enough = 0.5 * x.e.at.s.depth;
        x.near_depth = x.e.at.s.depth;
        x.far_depth = x.e.entry.depth;
        x.far_present = true;
        if !x.e.through_cut {
            x.e.entry = x.e.at.s;
        }
    } else if x.turn == NEXT_SAMPLE {
        x.e.at.next = as_neighbour(at);
        x.turn = BACK;
    } else if x.turn == SEEN {
        // At a cut only the material is that of this depth; the light is that of the face.
        let face = x.e.entry.deformed;
        if at.present {
            x.e.entry = there;
            x.e.entry.deformed = select(q, face, x.e.through_cut);
        }
        x.turn = DONE;
    } else if x.n == EDGE_STEPS {
        // What lies in front of a ray that enters the material at the very start of its step.
        x.far_present = at.present;
        x.far_found = true;
    } else {
        x.n += 1;
        let middle = 0.5 * (x.near + x.far);
        // The half without the crossing is integrated by the trapezoidal rule.
        let quarter = 0.25 * (x.far - x.near);
        if (at.present && there.depth >= x.enough) == x.dense_here {
            x.integral += quarter * (min(x.near_depth, x.cap) + min(there.depth, x.cap));
            x.near = middle;
            x.near_depth = there.depth;
            if x.turn != BACK && x.e.entered {
                x.e.entry = there;
            }
        } else {
            x.integral += quarter * (min(x.far_depth, x.cap) + min(there.depth, x.cap));
            x.far = middle;
            x.far_depth = there.depth;
            x.far_present = at.present;
            x.far_found = true;
        }
    }
    if x.turn == BACK && x.n == EDGE_STEPS {
        x.behind = represented(x, x.e.at.next.depth);
        x.turn = SEEN;
    }
    if x.turn == FRONT && x.n == EDGE_STEPS && (x.far_found || !x.e.entered) {
        x.e.through_cut = x.e.entered && !x.far_present;
        if !(x.segment && x.e.at.previous.present) {
            x.before = represented(x, x.e.at.previous.depth);
        }
        x.turn = select(NEXT_SAMPLE, CUT, x.from_cut);
        x.n = 0;
    }
    if x.turn == BEHIND_CUT && x.n == EDGE_STEPS {
        x.turn = NEXT_SAMPLE;
        x.n = 0;
    }
    return x;
}

// Evaluates one of the samples that search a step for a layer thinner than it.
fn layer_taken(
    search: ExtentSearch, at: SceneSample, there: VisibleSample, present: bool, step: f32
) -> ExtentSearch {
    var x = search;
    let floor = max(x.own_depth, x.e.at.previous.depth);
    let seen = shows(at.present, at.value, there.depth - 2.0 * floor);
    let spacing = step / f32(THIN_LAYER_SAMPLES);
    let inside = x.e.spacing < step;
    x.n += 1;
    if seen && inside {
        x.layer += spacing;
    } else if seen {
        x.e.at.s = there;
        x.e.entry = there;
        x.e.at.alpha = at.alpha;
        x.e.at.present = true;
        x.e.spacing = spacing;
        x.e.floor = floor;
        x.e.at.previous.depth = floor;
    } else if !inside {
        x.e.at.previous.present = at.present;
    }
    if x.n == THIN_LAYER_SAMPLES || (inside && !seen) {
        x.e.at.next = Neighbour(SAMPLED, select(at.present, present, seen), floor, at.value, at.alpha);
        x.turn = select(DONE, FRONT, x.e.spacing < step);
        x.n = 0;
    }
    return x;
}

// Whether anything behind a sample can be seen: half a step of it is not opaque.
fn sees_behind(depth: f32, step: f32) -> bool {
    return uses_gradient_opacity() || depth * 0.5 * step / frame.reference_mm < OPAQUE_DEPTH;
}
