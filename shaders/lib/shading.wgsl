// Counterpart of src/cpu/shading.rs.

const SURFACE_GRADIENT_LOW: f32 = 0.004;
const SURFACE_GRADIENT_HIGH: f32 = 0.04;
const ISOTROPIC_DIFFUSE: f32 = 0.6;

struct Shaded {
    color: vec3<f32>,
    depth_factor: f32,
}

struct VisibleSample {
    deformed: vec3<f32>,
    in_voxel: vec3<f32>,
    color: vec3<f32>,
    depth: f32,
    value: f32,
    // As in SceneSample.
    gradient: vec3<f32>,
    has_gradient: bool,
}

struct Normal {
    normal: vec3<f32>,
    confidence: f32,
}

fn is_lit() -> bool {
    return NORMALS != NORMALS_NONE;
}

fn uses_gradient_opacity() -> bool {
    return frame.gradient_top > 0.0;
}

// The visible sample at a sampled point; depth 0 if it is invisible.
fn visible_sample(at: SceneSample, deformed: vec3<f32>) -> VisibleSample {
    if !at.present {
        return VisibleSample(deformed, at.in_voxel, vec3<f32>(0.0), 0.0, 0.0, NOT_FETCHED, false);
    }
    let t = lookup(at.value);
    return VisibleSample(deformed, at.in_voxel, t.rgb, t.a, at.value, at.gradient, at.has_gradient);
}

// The nearer of a cut and the volume's two faces across an axis.
fn nearer_volume_face(cut: NearestCut, j: Jet, in_voxel: vec3<f32>, axis: vec3<f32>) -> NearestCut {
    let at = dot(in_voxel, axis) + 0.5;
    let beyond = dot(frame.grid_size, axis) - at;
    return nearer_of(
        cut,
        min(at, beyond),
        transpose(j.d_source_d_deformed) * world_from_voxel_covector(axis * select(-1.0, 1.0, at < beyond)),
    );
}

// A cut near a sample inside the material, if the ray came out of it; none if the ray has passed
// another surface since, or heads towards the cut.
fn cut_in_front(cut: NearestCut, s: VisibleSample, direction: vec3<f32>) -> NearestCut {
    if NORMALS != NORMALS_BLENDED || cut.distance_mm >= frame.blend_far_mm {
        return cut;
    }
    let facing = -dot(cut.normal, direction);
    if facing <= 0.0 {
        return NO_CUT;
    }
    var way = min(
        CUT_LOOKBACK_SHARE * max(cut.distance_mm, 0.0) / facing, MAX_CUT_LOOKBACK * frame.blend_far_mm
    );
    for (var n = 0; n < CUT_LOOKBACK_STEPS; n += 1) {
        let back = sample_scene(s.deformed - direction * way);
        if back.present && lookup(back.value).a < 0.5 * s.depth {
            return NO_CUT;
        }
        if back.present {
            return cut;
        }
        way *= 0.5;
    }
    return cut;
}

// The colour of the label with the largest interpolated margin. Counterpart: Colors::sample in
// src/volume/colors.rs.
fn elected_color(in_voxel: vec3<f32>) -> vec3<f32> {
    let size = vec3<f32>(textureDimensions(colors));
    let texels_per_voxel = size / frame.texture_size;
    let q = clamp((in_voxel + 0.5) * texels_per_voxel - 0.5, vec3<f32>(0.0), size - 1.0);
    let base = floor(q);
    let f = q - base;
    var texels: array<vec4<f32>, 8>;
    for (var n = 0; n < 8; n += 1) {
        let at = vec3<i32>(n & 1, (n >> 1u) & 1, n >> 2u);
        let texel = textureLoad(colors, min(vec3<i32>(base) + at, vec3<i32>(size) - 1), 0);
        let weights = select(1.0 - f, f, at == vec3<i32>(1));
        texels[n] = vec4<f32>(texel.rgb, texel.a * weights.x * weights.y * weights.z);
    }
    var color = vec3<f32>(0.0);
    var most = 0.0;
    for (var n = 0; n < 8; n += 1) {
        var sum = 0.0;
        for (var m = 0; m < 8; m += 1) {
            sum += select(0.0, texels[m].a, all(texels[m].rgb == texels[n].rgb));
        }
        if texels[n].a > 0.0 && sum > most {
            color = texels[n].rgb;
            most = sum;
        }
    }
    if most > 0.0 {
        return color;
    }
    return nearest_label(q);
}

// The colour of the labelled texel nearest to a position, the first of several, among the 64 around
// it. Counterpart: Colors::nearest_label in src/volume/colors.rs.
fn nearest_label(q: vec3<f32>) -> vec3<f32> {
    let last = vec3<i32>(textureDimensions(colors)) - 1;
    var color = vec3<f32>(0.0);
    var nearest = 64.0;
    for (var n = 0; n < 64; n += 1) {
        let texel = vec3<i32>(floor(q)) + vec3<i32>(n & 3, (n >> 2u) & 3, n >> 4u) - 1;
        let c = textureLoad(colors, clamp(texel, vec3<i32>(0), last), 0);
        let away = vec3<f32>(texel) - q;
        if c.a > 0.0 && dot(away, away) < nearest {
            color = c.rgb;
            nearest = dot(away, away);
        }
    }
    return color;
}

// The voxel's own colour if it has one, else `otherwise`.
fn own_color(in_voxel: vec3<f32>, otherwise: vec3<f32>) -> vec3<f32> {
    if COLORS == COLORS_NONE {
        return otherwise;
    }
    if COLORS == COLORS_ELECTED {
        return elected_color(in_voxel);
    }
    let c = sample_colors(in_voxel);
    return clamp(c.rgb / max(c.a, 1.0 / 1024.0), vec3<f32>(0.0), vec3<f32>(1.0));
}

// Shades the point at which a sample is seen. `through_cut`: if the ray enters material there, it
// does through a cut; `cut_free`: no cut except the volume's faces can be near; half: the result of
// half_vector, constant along a ray.
fn shade_point(
    s: VisibleSample,
    entered: bool,
    through_cut: bool,
    cut_free: bool,
    direction: vec3<f32>,
    half: vec3<f32>,
) -> Shaded {
    let color = own_color(s.in_voxel, s.color);
    if !is_lit() && !uses_gradient_opacity() {
        return Shaded(color, 1.0);
    }
    var per_voxel = s.gradient;
    if !s.has_gradient {
        per_voxel = gradient(s.in_voxel);
    }
    let gradient_in_source = world_from_voxel_covector(per_voxel);
    var depth_factor = 1.0;
    if uses_gradient_opacity() {
        depth_factor = gradient_factor(length(gradient_in_source));
    }
    if !is_lit() {
        return Shaded(color, depth_factor);
    }
    let far = cut_free && far_from_faces(s.in_voxel);
    var j = identity_jet(s.deformed);
    // Far from every cut the deformation affects only points that have a normal.
    if !(far && surface_confidence(gradient_in_source) <= 0.0) {
        j = jet(s.deformed);
    }
    var cut = NO_CUT;
    if (!entered || through_cut) && !far {
        cut = nearer_cut_shape(nearest_cut(j, s.in_voxel), s.deformed);
        if !entered {
            cut = cut_in_front(cut, s, direction);
        }
    }
    var falling = 1.0;
    if frame.two_sided == 0u {
        falling = opacity_slope_sign(s.value);
    }
    let n = shaded_normal(j.d_source_d_deformed, gradient_in_source * falling, cut, direction);
    return Shaded(light(n, s.depth, s.deformed, direction, half, color), depth_factor);
}

// How reliably a gradient in the source is that of a surface, 0 .. 1.
fn surface_confidence(gradient_in_source: vec3<f32>) -> f32 {
    return smoothstep(
        SURFACE_GRADIENT_LOW,
        SURFACE_GRADIENT_HIGH,
        length(gradient_in_source) * abs(frame.table_scale) * frame.reference_mm,
    );
}

fn world_from_voxel_covector(per_voxel: vec3<f32>) -> vec3<f32> {
    return transpose(linear_part(frame.voxel_from_world)) * per_voxel;
}

fn nearest_cut(j: Jet, in_voxel: vec3<f32>) -> NearestCut {
    let x = nearer_volume_face(j.cut, j, in_voxel, vec3<f32>(1.0, 0.0, 0.0));
    let y = nearer_volume_face(x, j, in_voxel, vec3<f32>(0.0, 1.0, 0.0));
    return nearer_volume_face(y, j, in_voxel, vec3<f32>(0.0, 0.0, 1.0));
}

// The nearer of a cut and the surface of the analytic cut shapes.
fn nearer_cut_shape(cut: NearestCut, deformed: vec3<f32>) -> NearestCut {
    if CUTS == 0u {
        return cut;
    }
    let distance_mm = cuts_signed_distance_mm(deformed);
    if distance_mm > frame.blend_far_mm {
        return cut;
    }
    return nearer_of(cut, distance_mm, cuts_gradient(deformed, 0.05 * frame.reference_mm));
}

const FACE_STEPS: i32 = 10;

fn is_cut(deformed: vec3<f32>) -> bool {
    return (CUTS > 0u && cuts_signed_distance_mm(deformed) < 0.0) || source_and_alpha(deformed).w < 0.5;
}

// The scan's grey value on the cut face that the ray came out of within the last step; negative if
// there is none.
fn grey_face(alpha: f32, deformed: vec3<f32>, direction: vec3<f32>, step_mm: f32) -> f32 {
    let near = alpha < 1.0 || (CUTS > 0u && cuts_signed_distance_mm(deformed) < 1.5 * step_mm);
    var outside = deformed - direction * step_mm;
    if !near || !is_cut(outside) {
        return -1.0;
    }
    var inside = deformed;
    for (var n = 0; n < FACE_STEPS; n += 1) {
        let middle = (inside + outside) * 0.5;
        if is_cut(middle) {
            outside = middle;
        } else {
            inside = middle;
        }
    }
    let face = sample_scene(inside);
    if !face.present || face.value <= frame.grey_low {
        return -1.0;
    }
    return clamp((face.value - frame.grey_low) / max(frame.grey_high - frame.grey_low, 1e-6), 0.0, 1.0);
}

fn value_or_zero(p: vec3<f32>) -> f32 {
    let at = sample_scene(p);
    return select(0.0, at.value, at.present);
}

fn light_cosine_by_derivative(at: vec3<f32>) -> f32 {
    let h = frame.reference_mm;
    let n = frame.to_light;
    // As glam's any_orthonormal_pair (Duff et al. 2017).
    let s = select(-1.0, 1.0, n.z >= 0.0);
    let a = -1.0 / (s + n.z);
    let b = n.x * n.y * a;
    let u = vec3<f32>(1.0 + s * n.x * n.x * a, s * b, -s * n.x);
    let v = vec3<f32>(b, s + n.y * n.y * a, -n.y);
    let d = vec3<f32>(
        value_or_zero(at - n * h) - value_or_zero(at + n * h),
        value_or_zero(at - u * h) - value_or_zero(at + u * h),
        value_or_zero(at - v * h) - value_or_zero(at + v * h),
    );
    let facing = d.x / max(length(d), 1e-6);
    return select(max(facing, 0.0), abs(facing), frame.two_sided != 0u);
}

// Colour of the surface where the volume has the value frame.iso, crossed within the step before
// `deformed`.
fn iso_surface(deformed: vec3<f32>, direction: vec3<f32>, step_mm: f32) -> vec3<f32> {
    var inside = deformed;
    var outside = deformed - direction * step_mm;
    var through_cut = false;
    let before = sample_scene(outside);
    if !(before.present && before.value >= frame.iso) {
        through_cut = !before.present;
        for (var n = 0; n < FACE_STEPS; n += 1) {
            let middle = (inside + outside) * 0.5;
            let at = sample_scene(middle);
            if at.present && at.value >= frame.iso {
                inside = middle;
            } else {
                outside = middle;
                through_cut = !at.present;
            }
        }
    }
    let hit = sample_scene(inside);
    let color = own_color(hit.in_voxel, lookup(select(frame.iso, hit.value, through_cut)).rgb);
    if !is_lit() {
        return color;
    }
    if ISO == ISO_DERIVATIVE && !through_cut {
        let shares = light_shares(-direction, 0.0, SOLID_DEPTH, inside, direction);
        return clamp(
            color * even_light(light_cosine_by_derivative(inside), shares),
            vec3<f32>(0.0),
            vec3<f32>(1.0),
        );
    }
    let j = jet(inside);
    var cut = NO_CUT;
    if through_cut {
        cut = nearer_cut_shape(nearest_cut(j, hit.in_voxel), inside);
    }
    var per_voxel = vec3<f32>(0.0);
    if FILTER == FILTER_CUBIC {
        per_voxel = sample_cubic(hit.in_voxel).xyz;
    } else {
        per_voxel = gradient(hit.in_voxel);
    }
    let n = shaded_normal(j.d_source_d_deformed, world_from_voxel_covector(per_voxel), cut, direction);
    return light(n, SOLID_DEPTH, inside, direction, half_vector(direction), color);
}

const CUT_LOOKBACK_SHARE: f32 = 0.9;
const MAX_CUT_LOOKBACK: f32 = 4.0;
const CUT_LOOKBACK_STEPS: i32 = 4;

fn shaded_normal(
    d_source_d_deformed: mat3x3<f32>, gradient_in_source: vec3<f32>, cut: NearestCut, direction: vec3<f32>
) -> Normal {
    var g = gradient_in_source;
    if NORMALS == NORMALS_TRANSFORMED || NORMALS == NORMALS_BLENDED {
        g = transpose(d_source_d_deformed) * g;
    }
    var confidence = surface_confidence(gradient_in_source);
    var normal = normalize_or(-g, vec3<f32>(0.0));
    if frame.two_sided != 0u && dot(normal, direction) > 0.0 {
        normal = -normal;
    }
    if NORMALS == NORMALS_BLENDED && cut.distance_mm < frame.blend_far_mm {
        let own = smoothstep(frame.blend_near_mm, frame.blend_far_mm, cut.distance_mm);
        normal = normalize_or(normal * (own * confidence) + cut.normal * (1.0 - own), cut.normal);
        confidence = max(own * confidence, 1.0 - own);
    }
    return Normal(normal, confidence);
}

// Whether no face of the volume can be near.
fn far_from_faces(in_voxel: vec3<f32>) -> bool {
    return all(in_voxel > frame.face - 0.5) && all(in_voxel < frame.grid_size - 0.5 - frame.face);
}

fn light(
    n: Normal,
    depth: f32,
    at: vec3<f32>,
    direction: vec3<f32>,
    half: vec3<f32>,
    color: vec3<f32>,
) -> vec3<f32> {
    let normal = facing_the_eye(n.normal, direction);
    let shares = light_shares(normal, n.confidence, depth, at, direction);
    let even = even_light(ISOTROPIC_DIFFUSE, shares);
    let shone = lit(
        color, dot(normal, frame.to_light), dot(normal, half), frame.specular, frame.shininess, shares
    );
    return clamp(mix(color * even, shone, n.confidence), vec3<f32>(0.0), vec3<f32>(1.0));
}
