// Counterpart of src/transfer/table.rs.

const TABLE_ENTRIES: i32 = 4096;
const GRADIENT_ENTRIES: i32 = 256;
const SLOPE_STEP: f32 = 0.02;
const LEVEL: f32 = 1.0 - 1e-5;

// Colour (not premultiplied) and optical depth.
fn lookup(value: f32) -> vec4<f32> {
    let x = clamp(value * frame.table_scale + frame.table_offset, 0.0, 1.0) * f32(TABLE_ENTRIES - 1);
    let i = min(i32(x), TABLE_ENTRIES - 2);
    return mix(table_entry(i, 0), table_entry(i + 1, 0), x - f32(i));
}

// The optical depth at a position in entries, its integral up to the entry before, and its integral
// from that entry on.
fn depth_at(x: f32) -> vec3<f32> {
    let i = min(i32(x), TABLE_ENTRIES - 2);
    let t = x - f32(i);
    let tau = table_entry(i, 0).a;
    let here = mix(tau, table_entry(i + 1, 0).a, t);
    return vec3<f32>(here, table_entry(i, 2).r, 0.5 * (tau + here) * t);
}

// Mean optical depth between two table coordinates.
fn segment_depth(ends: vec2<f32>) -> f32 {
    let at = clamp(ends, vec2<f32>(0.0), vec2<f32>(1.0)) * f32(TABLE_ENTRIES - 1);
    let a = min(at.x, at.y);
    let b = max(at.x, at.y);
    if b - a < 1.0 {
        // For short segments a difference of integrals would lose all significant digits.
        return depth_at(0.5 * (a + b)).x;
    }
    let low = depth_at(a);
    let high = depth_at(b);
    return max(((high.y - low.y) + (high.z - low.z)) / (b - a), 0.0);
}

// As lookup, for the segment between two samples.
fn lookup_segment(front: f32, back: f32) -> vec4<f32> {
    let ends = vec2<f32>(front, back) * frame.table_scale + frame.table_offset;
    return vec4<f32>(preintegrated_entry(ends.x, ends.y).rgb, segment_depth(ends));
}

fn opacity_slope_sign(value: f32) -> f32 {
    let step = SLOPE_STEP / frame.table_scale;
    return select(1.0, -1.0, lookup(value + step).a < LEVEL * lookup(value - step).a);
}

fn gradient_factor(magnitude: f32) -> f32 {
    if frame.gradient_top <= 0.0 {
        return 1.0;
    }
    let x = clamp(magnitude / frame.gradient_top, 0.0, 1.0) * f32(GRADIENT_ENTRIES - 1);
    let i = min(i32(x), GRADIENT_ENTRIES - 2);
    return mix(table_entry(i, 1).r, table_entry(i + 1, 1).r, x - f32(i));
}
