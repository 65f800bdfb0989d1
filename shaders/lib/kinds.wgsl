// Counterpart of the formulas in src/deform/kinds: the source of a deformed point in local
// millimetres (xyz), and the signed distance to the nearest cut (w, mm, positive where the volume
// is retained). The numbers are in the order of each field's `formula`.

const NO_CUT_DISTANCE_MM: f32 = 1e6;
const TURN: f32 = 6.2831855;

fn n(i: u32) -> f32 {
    return definition.numbers[i / 4u][i % 4u];
}

fn with_sign(size: f32, sign_of: f32) -> f32 {
    return select(-size, size, sign_of >= 0.0);
}

// atan2 is not defined at the origin.
fn angle_of(y: f32, x: f32) -> f32 {
    return select(atan2(y, x), 0.0, x == 0.0 && y == 0.0);
}

fn turned(angle: f32, v: vec2<f32>) -> vec2<f32> {
    let c = cos(angle);
    let s = sin(angle);
    return vec2<f32>(c * v.x - s * v.y, s * v.x + c * v.y);
}

fn ease(low: f32, high: f32, x: f32) -> f32 {
    let t = clamp((x - low) / (high - low), 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
}

// 1 in the middle, 0 at `half`, eased over a fraction of it.
fn window(x: f32, half: f32, share: f32) -> f32 {
    return ease(0.0, share, 1.0 - abs(x) / half);
}

// Gaps that the map can resolve: one that narrows below a texel closes.
fn gap_distance(to_wall: f32, half_width: f32, ramp_mm: f32, texel_mm: f32) -> f32 {
    return to_wall + 2.0 * ramp_mm * clamp(1.0 - half_width / texel_mm, 0.0, 1.0);
}

fn pull(q: vec3<f32>) -> vec4<f32> {
    let factor = 1.0 - n(1u) * exp(-dot(q.xy, q.xy) / (n(2u) * n(2u)));
    return vec4<f32>(q.xy, (q.z + n(0u)) * factor - n(0u), NO_CUT_DISTANCE_MM);
}

fn spline(x: f32) -> f32 {
    let t = 1.5 * abs(x);
    if t < 0.5 {
        return (0.75 - t * t) / 0.75;
    }
    let u = max(1.5 - t, 0.0);
    return 0.5 * u * u / 0.75;
}

fn spline_pull(q: vec3<f32>) -> vec4<f32> {
    let across = n(0u) * spline(q.x / n(1u)) * spline(q.y / n(2u));
    let third = 2.0 * n(3u) / 3.0;
    let from_peak = q.z + n(3u) - third;
    return vec4<f32>(
        q.xy,
        q.z - across * spline(from_peak / select(2.0 * third, third, from_peak < 0.0)),
        NO_CUT_DISTANCE_MM,
    );
}

fn wave(q: vec3<f32>) -> vec4<f32> {
    let half = vec3<f32>(n(3u), n(4u), n(5u));
    var along = q.x;
    var fade = window(q.x, half.x, 0.3) * window(q.y, half.y, 0.3);
    if n(6u) > 0.5 {
        along = length(q.xy);
        fade = window(along, min(half.x, half.y), 0.3);
    }
    let rise = n(0u) * sin(n(1u) * along + n(2u)) * fade;
    return vec4<f32>(q.xy, q.z - rise * window(q.z, half.z, 0.5), NO_CUT_DISTANCE_MM);
}

fn twist(q: vec3<f32>) -> vec4<f32> {
    let height = clamp(q.z / n(2u) + 0.5, 0.0, 1.0);
    return vec4<f32>(
        turned(-n(0u) * height * window(length(q.xy), n(3u), n(1u)), q.xy), q.z, NO_CUT_DISTANCE_MM
    );
}

fn bend(q: vec3<f32>) -> vec4<f32> {
    let curvature = n(0u);
    if curvature < 1e-7 {
        return vec4<f32>(q, NO_CUT_DISTANCE_MM);
    }
    let radius = 1.0 / curvature;
    let v = vec2<f32>(radius - n(1u) * q.x, q.z + n(2u));
    let turn = clamp(angle_of(v.y, v.x), 0.0, n(3u) * curvature);
    let back = turned(-turn, v);
    let x = radius - back.x;
    return vec4<f32>(n(1u) * x, q.y, turn * radius + back.y - n(2u), 0.98 * radius - x);
}

fn taper(q: vec3<f32>) -> vec4<f32> {
    let scale = 1.0 + n(0u) * clamp(q.z / n(1u) + 0.5, 0.0, 1.0);
    return vec4<f32>(q.xy / scale, q.z, NO_CUT_DISTANCE_MM);
}

fn shear(q: vec3<f32>) -> vec4<f32> {
    return vec4<f32>(q.xy - vec2<f32>(n(0u), n(1u)) * (q.z + n(2u)), q.z, NO_CUT_DISTANCE_MM);
}

fn bulge(q: vec3<f32>) -> vec4<f32> {
    let rho = length(q / vec3<f32>(n(1u), n(2u), n(3u)));
    let within = max(1.0 - rho * rho, 0.0);
    return vec4<f32>(q * (1.0 - n(0u) * within * within), NO_CUT_DISTANCE_MM);
}

// Distance to a side of the roll, at an angle from it.
fn edge_distance(rho: f32, angle: f32) -> f32 {
    return select(with_sign(rho, angle), rho * sin(angle), abs(angle) < HALF_PI);
}

fn peel(q: vec3<f32>) -> vec4<f32> {
    let floor_z = n(0u);
    let depth = n(1u);
    let radius = n(2u);
    let hinge = n(3u);
    let end = n(4u);
    let flap = n(5u);
    let slot_half_y = n(6u);
    let texel = n(7u);
    if flap < texel {
        return vec4<f32>(q, NO_CUT_DISTANCE_MM);
    }
    let v = vec2<f32>(q.x - hinge, floor_z + radius - q.z);
    let rho = length(v);
    let last = flap / radius;
    var theta = angle_of(v.x, v.y);
    if theta < 0.0 {
        theta += TURN;
    }
    if theta > (last + TURN) / 2.0 {
        theta -= TURN;
    }
    let height = radius - rho;
    let from_roll = min(
        min(height, depth - height), min(edge_distance(rho, theta), edge_distance(rho, last - theta))
    );
    let along = clamp(theta * radius, 0.0, flap);
    let rolled_height = clamp(height, 0.0, depth);

    let above_floor = q.z - floor_z;
    let in_roll = min(from_roll, slot_half_y - 2.5 * texel - abs(q.y));
    let in_layer = select(-NO_CUT_DISTANCE_MM, min(above_floor, depth - above_floor), q.x <= hinge);
    let in_strip = max(in_roll, in_layer);
    let over_slot = min(min(q.x - hinge, end - q.x), min(slot_half_y - abs(q.y), above_floor));
    let in_slot = min(over_slot, depth - above_floor);
    let in_band = min(in_roll + n(8u), max(over_slot, above_floor - depth));
    let undisplaced = -max(in_slot, in_band);
    let continued = vec3<f32>(hinge + along, q.y, floor_z + rolled_height) - q;
    let to_roll = max(-in_roll, 0.0);
    let to_undisplaced = max(-undisplaced, 0.0);
    let between = to_roll + to_undisplaced;
    var weight = 0.0;
    if in_roll >= 0.0 {
        weight = 1.0;
    } else if undisplaced < 0.0 {
        let margin = min(texel * 1.5 / between, 0.45);
        weight = clamp((to_undisplaced / between - margin) / (1.0 - 2.0 * margin), 0.0, 1.0);
    }
    return vec4<f32>(q + continued * weight, max(in_strip, undisplaced));
}

fn slab(q: vec3<f32>) -> vec4<f32> {
    let t = n(0u);
    let g = n(1u);
    let z = q.z - n(2u) + t / 2.0;
    let piece = floor(z / (t + g));
    let within = z - piece * (t + g);
    let source_z = piece * t + min(within, t) - t / 2.0 + n(2u);
    let cut = select(-min(within - t, t + g - within), min(within, t - within), within <= t);
    return vec4<f32>(q.xy, source_z, gap_distance(cut, g / 2.0, n(3u), n(4u)));
}

// Source coordinate and distance to the nearest gap along one axis, from the count, gap and piece
// lengths.
fn pieces(x: f32, count: f32, gap: f32, piece: f32) -> vec2<f32> {
    let pitch = piece + gap;
    let from_low = x + 0.5 * (pitch * count - gap);
    let i = clamp(floor(from_low / pitch), 0.0, count - 1.0);
    let within = from_low - i * pitch;
    let last = i == count - 1.0;
    let source = i * piece + select(min(within, piece), within, last) - 0.5 * piece * count;
    let below = select(within, NO_CUT_DISTANCE_MM, i == 0.0);
    let above = select(piece - within, NO_CUT_DISTANCE_MM, last);
    return vec2<f32>(source, select(min(below, above), -min(-above, gap + above), above < 0.0));
}

fn explode(q: vec3<f32>) -> vec4<f32> {
    var all = vec4<f32>(q, NO_CUT_DISTANCE_MM);
    for (var a = 0u; a < 3u; a += 1u) {
        let count = n(2u + 3u * a);
        let gap = n(3u + 3u * a);
        let own = pieces(q[a], count, gap, n(4u + 3u * a));
        all[a] = own.x;
        if count > 1.0 {
            all.w = min(all.w, gap_distance(own.y, gap / 2.0, n(0u), n(1u)));
        }
    }
    return all;
}

fn seam(q: vec3<f32>) -> vec4<f32> {
    let last = n(0u);
    let v = vec2<f32>(q.x, q.z - n(3u));
    let r = length(v);
    let beta = angle_of(abs(v.x), v.y);
    let open = n(1u) * (1.0 - ease(0.75 * n(4u), n(4u), r)) * window(q.y, n(2u), 0.8);
    let source = with_sign(select(last * max(beta - open, 0.0) / (last - open), beta, beta >= last), v.x);
    return vec4<f32>(
        r * sin(source), q.y, r * cos(source) + n(3u), gap_distance(r * (beta - open), r * open, n(5u), n(6u))
    );
}

fn book(q: vec3<f32>) -> vec4<f32> {
    let angle = n(0u);
    let v = vec2<f32>(q.x, q.z - n(1u));
    let r = length(v);
    let beta = angle_of(abs(v.x), v.y);
    let rigid_end = HALF_PI + angle;
    let beyond_rigid = HALF_PI + (beta - rigid_end) * HALF_PI / (2.0 * HALF_PI - rigid_end);
    let source = with_sign(select(beyond_rigid, max(beta - angle, 0.0), beta <= rigid_end), v.x);
    let cut = edge_distance(r, beta - angle);
    return vec4<f32>(
        r * sin(source), q.y, r * cos(source) + n(1u), gap_distance(cut, r * sin(angle), n(2u), n(3u))
    );
}

fn knife(q: vec3<f32>) -> vec4<f32> {
    let y = q.y / n(0u);
    let along = max(1.0 - y * y, 0.0);
    let above_floor = clamp((q.z - n(4u)) / n(1u) + 1.0, 0.0, 1.0);
    let down = 1.0 - above_floor;
    let open = n(2u) * along * sqrt(max(1.0 - down * down, 0.0)) * above_floor;
    let x = abs(q.x);
    let half_x = n(3u);
    let source = select(half_x * max(x - open, 0.0) / (half_x - open), x, x >= half_x);
    return vec4<f32>(with_sign(source, q.x), q.yz, gap_distance(x - open, open, n(5u), n(6u)));
}

fn retractor(q: vec3<f32>) -> vec4<f32> {
    let focus = n(0u);
    let last = n(1u);
    let open = n(2u) * ease(0.0, 1.0, (q.z - n(4u)) / n(3u) + 1.0);
    if open <= 1e-5 {
        return vec4<f32>(q, NO_CUT_DISTANCE_MM);
    }
    let x = q.x / focus;
    let y = q.y / focus;
    let b = x * x + y * y - 1.0;
    let root = sqrt(b * b + 4.0 * y * y);
    let sinh_mu = select(sqrt(0.5 * (b + root)), sqrt(2.0 * y * y / max(root - b, 1e-30)), b < 0.0);
    let mu = asinh(sinh_mu);
    let nu = with_sign(
        select(
            acos(clamp(x, -1.0, 1.0)), angle_of(abs(y) / max(sinh_mu, 1e-30), x / cosh(mu)), sinh_mu > 1e-6
        ),
        y,
    );
    let scale = focus * max(sqrt(sinh_mu * sinh_mu + sin(nu) * sin(nu)), 0.05);
    let cut = gap_distance((mu - open) * scale, focus * sinh(open), n(5u), n(6u));
    if mu >= last {
        return vec4<f32>(q, cut);
    }
    let before = max((mu - open) * last / (last - open), 0.0);
    return vec4<f32>(focus * cosh(before) * cos(nu), focus * sinh(before) * sin(nu), q.z, cut);
}

fn removal(q: vec3<f32>) -> vec4<f32> {
    if n(0u) < 0.0 {
        return vec4<f32>(q, NO_CUT_DISTANCE_MM);
    }
    return vec4<f32>(q, outside_shape(u32(n(0u)), q, vec3<f32>(n(1u), n(2u), n(3u)), n(4u)));
}

fn backward_of(q: vec3<f32>) -> vec4<f32> {
    switch definition.kind {
        case FORMULA_PULL: { return pull(q); }
        case FORMULA_SPLINE_PULL: { return spline_pull(q); }
        case FORMULA_WAVE: { return wave(q); }
        case FORMULA_TWIST: { return twist(q); }
        case FORMULA_BEND: { return bend(q); }
        case FORMULA_TAPER: { return taper(q); }
        case FORMULA_SHEAR: { return shear(q); }
        case FORMULA_BULGE: { return bulge(q); }
        case FORMULA_PEEL: { return peel(q); }
        case FORMULA_SLAB: { return slab(q); }
        case FORMULA_EXPLODE: { return explode(q); }
        case FORMULA_SEAM: { return seam(q); }
        case FORMULA_BOOK: { return book(q); }
        case FORMULA_KNIFE: { return knife(q); }
        case FORMULA_RETRACTOR: { return retractor(q); }
        default: { return removal(q); }
    }
}
