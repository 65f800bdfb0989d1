// Samples that have something to shade, and their shading: what slices and rays share of a sample.
// Counterpart of src/cpu/found.rs.

const MIN_TRANSMITTANCE: f32 = 1.0 / 512.0;

// A pixel's shift of its samples, in steps, -1/2 .. 1/2: a hash by multiplications and shifts, with
// the same integers on every device.
fn pixel_shift(pixel: vec2<u32>) -> f32 {
    if frame.jitter == 0u {
        return 0.0;
    }
    var h = pixel.x * 0x9E3779B1u ^ pixel.y * 0x85EBCA77u;
    h = (h ^ (h >> 16u)) * 0x7FEB352Du;
    h = (h ^ (h >> 15u)) * 0x846CA68Bu;
    h ^= h >> 16u;
    return f32(h >> 8u) / 16777216.0 - 0.5;
}

// Adds a value to a projection.
fn insert_value(projected: f32, value: f32) -> f32 {
    switch BLEND {
        case BLEND_MIP: { return max(projected, value); }
        case BLEND_MINIP: { return min(projected, value); }
        default: { return projected + value; }
    }
}

// Whether a sample is visible or may lie at a cut face.
fn to_be_shaded(at: SceneSample, depth: f32, sampled: vec3<f32>, step: f32) -> bool {
    if GREY_FACES != 0u && at.present && is_near_cut_face(at, sampled, step) {
        return true;
    }
    if ISO != ISO_NONE {
        return at.present && at.value >= frame.iso;
    }
    return depth > 0.0 || is_near_mask_edge(at);
}

// The value at the front end of a sample's segment: that of the previous sample if there is one,
// otherwise the sample's own.
fn front_value(at: SceneSample, previous: vec3<f32>, before: f32, is_known: bool) -> f32 {
    if !at.present {
        return at.value;
    }
    if is_known {
        return before;
    }
    let earlier = sample_scene(previous);
    return select(at.value, earlier.value, earlier.present);
}

// Whether visible samples are shaded by a gradient.
fn shades_by_gradient() -> bool {
    return BLEND == BLEND_COMPOSITE && ISO == ISO_NONE && (is_lit() || uses_gradient_opacity());
}

// Colour of a sample after lighting, premultiplied by its opacity over `length` reference lengths.
// `depth` is its own optical depth if it is visible, and `cut_free` states whether it lies in a
// cut-free cell. An invisible sample is near a cut; then a thin layer between it and the cut is
// searched for.
fn shaded_sample(
    at: SceneSample,
    s: VisibleSample,
    front: PreviousSample,
    cut_free: bool,
    direction: vec3<f32>,
    half: vec3<f32>,
    step: f32,
    length: f32,
) -> vec4<f32> {
    var depth = s.depth;
    var point: ShadingPoint;
    if depth > 0.0 {
        point = shading_point(s, front, cut_free, direction, step);
    } else {
        point = thin_layer_at_cut(s.deformed, at.present, direction, step);
        depth = point.s.depth;
        if depth <= 0.0 {
            return vec4<f32>(0.0);
        }
    }
    let shaded = shade_point(point, direction, half);
    // Opacity correction: τ per Δ₀ times the sample's length in Δ₀.
    let alpha = 1.0 - exp2(-depth * shaded.depth_factor * length);
    return vec4<f32>(shaded.color * alpha, alpha);
}

// An opaque face at a sample: the grey face of a cut, or the iso-surface. Alpha 0: there is none.
fn opaque_face(at: SceneSample, deformed: vec3<f32>, direction: vec3<f32>, step: f32) -> vec4<f32> {
    if GREY_FACES != 0u && at.present {
        let grey = grey_face(at, deformed, direction, step);
        if grey >= 0.0 {
            return vec4<f32>(vec3<f32>(grey), 1.0);
        }
    }
    if ISO != ISO_NONE && at.present && at.value >= frame.iso {
        return vec4<f32>(iso_surface(deformed, direction, step), 1.0);
    }
    return vec4<f32>(0.0);
}

fn is_near_cut_face(at: SceneSample, deformed: vec3<f32>, step: f32) -> bool {
    return at.alpha < 1.0 || (CUTS > 0u && cuts_signed_distance_mm(deformed) < 1.5 * step);
}

fn is_near_mask_edge(at: SceneSample) -> bool {
    return at.alpha > 0.0 && at.alpha < 1.0;
}
