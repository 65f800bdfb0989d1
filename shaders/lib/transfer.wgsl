// Counterpart of src/transfer/table.rs.

const TABLE_ENTRIES: i32 = 4096;
const GRADIENT_ENTRIES: i32 = 256;
const SLOPE_STEP: f32 = 0.02;

// Colour (not premultiplied) and optical depth.
fn lookup(value: f32) -> vec4<f32> {
    let x = clamp(value * frame.table_scale + frame.table_offset, 0.0, 1.0) * f32(TABLE_ENTRIES - 1);
    let i = min(i32(x), TABLE_ENTRIES - 2);
    return mix(table_entry(i, 0), table_entry(i + 1, 0), x - f32(i));
}

// As lookup, of the segment between two samples.
fn lookup_segment(front: f32, back: f32) -> vec4<f32> {
    return preintegrated_entry(front * frame.table_scale + frame.table_offset, back * frame.table_scale + frame.table_offset);
}

fn falling_side(value: f32) -> f32 {
    let step = SLOPE_STEP / frame.table_scale;
    return select(1.0, -1.0, lookup(value + step).a < lookup(value - step).a);
}

fn gradient_factor(magnitude: f32) -> f32 {
    if frame.gradient_top <= 0.0 {
        return 1.0;
    }
    let x = clamp(magnitude / frame.gradient_top, 0.0, 1.0) * f32(GRADIENT_ENTRIES - 1);
    let i = min(i32(x), GRADIENT_ENTRIES - 2);
    return mix(table_entry(i, 1).r, table_entry(i + 1, 1).r, x - f32(i));
}
