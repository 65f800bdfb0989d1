// Ray marching: rays, empty blocks, opaque faces, and samples with their opacity correction.

struct Ray {
    origin: vec3<f32>,
    direction: vec3<f32>,
}

// The ray through a pixel's centre; pixel in 0 .. picture, y pointing down.
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

// The block of cells of one kind around a point.
struct MacrocellBlock {
    // Nothing in it is visible.
    empty: bool,
    // Something may be visible, but no mask varies and no shape is near.
    cut_free: bool,
    // Parameter at which the ray leaves the block, if either flag is set.
    until: f32,
}

const CUT_FREE_FLAG: u32 = 128u;

fn block_around(p: vec3<f32>, origin: vec3<f32>, inverse_direction: vec3<f32>) -> MacrocellBlock {
    let cell = clamp(
        floor((p - frame.cells_origin) / frame.cell_mm), vec3<f32>(0.0), vec3<f32>(frame.cells) - 1.0
    );
    let d = cell_block(vec3<i32>(cell));
    let reach = f32(d & (CUT_FREE_FLAG - 1u));
    let low = frame.cells_origin + (cell - (reach - 1.0)) * frame.cell_mm;
    let high = frame.cells_origin + (cell + reach) * frame.cell_mm;
    let far = max((low - origin) * inverse_direction, (high - origin) * inverse_direction);
    let cut_free = d >= CUT_FREE_FLAG;
    return MacrocellBlock(d > 0u && !cut_free, cut_free, min(far.x, min(far.y, far.z)));
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
