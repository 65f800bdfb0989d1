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

// Whether a sample is visible or may lie at a grey cut face.
fn to_be_shaded(at: SceneSample, depth: f32, sampled: vec3<f32>, step: f32) -> bool {
    if GREY_FACES != 0u && at.present && is_near_cut_face(at, sampled, step) {
        return true;
    }
    return shows(at.present, at.value, depth);
}

// Whether visible samples are shaded by a gradient.
fn shades_by_gradient() -> bool {
    return BLEND == BLEND_COMPOSITE && ISO == ISO_NONE && FILTER == FILTER_LINEAR
        && (is_lit() || uses_gradient_opacity());
}

// The visible sample at a point, by the segment in front of it where segments are pre-integrated;
// `previous` lies one step in front of it.
fn found_sample(at: SceneSample, sampled: vec3<f32>, previous: Neighbour) -> VisibleSample {
    if PREINTEGRATED == 0u || !at.present {
        return visible_sample(at, sampled);
    }
    let front = select(at.value, previous.value, previous.state == SAMPLED && previous.present);
    let t = lookup_segment(front, at.value);
    return VisibleSample(sampled, at.in_voxel, t.rgb, t.a, at.value, at.gradient, at.has_gradient);
}

// A sample after lighting.
struct ShadedSample {
    // Premultiplied by its opacity.
    color: vec4<f32>,
    // An opaque face: everything behind it is hidden.
    is_face: bool,
}

// Shades a sample found; `length`: a step in reference lengths.
fn shaded_sample(
    found: FoundSample, direction: vec3<f32>, half: vec3<f32>, step: f32, length: f32
) -> ShadedSample {
    let nothing = ShadedSample(vec4<f32>(0.0), false);
    var e = SampleExtent(found, found.s, false, false, 1.0, 0.0, step);
    if ISO == ISO_NONE || found.thin {
        e = extent(found, direction, step);
        if found.thin && e.spacing == step {
            return nothing;
        }
    }
    let at = e.at;
    if GREY_FACES != 0u && at.present {
        let grey = grey_face(at.alpha, at.s.deformed, direction, e.spacing);
        if grey >= 0.0 {
            return ShadedSample(vec4<f32>(vec3<f32>(grey), 1.0), true);
        }
    }
    if ISO != ISO_NONE {
        if !(at.present && at.s.value >= frame.iso) {
            return nothing;
        }
        return ShadedSample(vec4<f32>(iso_surface(at.s.deformed, direction, e.spacing), 1.0), true);
    }
    if at.s.depth <= 0.0 {
        return nothing;
    }
    var s = e.entry;
    s.depth = at.s.depth;
    if FILTER == FILTER_CUBIC {
        let there = sample_cubic(s.in_voxel);
        s.value = there.w;
        s.color = lookup(there.w).rgb;
        s.gradient = there.xyz;
        s.has_gradient = true;
    }
    if PREINTEGRATED != 0u && !found.thin {
        // The colour is that of the whole segment.
        s.color = found.s.color;
    }
    let shaded = shade_point(s, e.entered, e.through_cut, found.cut_free && !found.thin, direction, half);
    // Opacity correction: τ per Δ₀ times the sample's length in Δ₀.
    let alpha = 1.0 - exp2(-(s.depth - e.floor) * shaded.depth_factor * e.share * length);
    return ShadedSample(vec4<f32>(shaded.color * alpha, alpha), false);
}

fn is_near_cut_face(at: SceneSample, deformed: vec3<f32>, step: f32) -> bool {
    return at.alpha < 1.0 || (CUTS > 0u && cuts_signed_distance_mm(deformed) < 1.5 * step);
}

fn is_near_mask_edge(at: SceneSample) -> bool {
    return at.alpha > 0.0 && at.alpha < 1.0;
}
