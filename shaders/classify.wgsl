// Classifies the cells of a grid over the deformed scene: which show anything, and in which of
// those cuts can be ignored. Counterpart of VisibilityCriteria in src/prepare/macrocells.rs and of
// src/deform/bounds.rs. One difference: a box that lies partly in a map's cube is carried back as
// one box, not split into the parts inside and outside. Every bound holds; a cell classified as
// occupied may still show nothing.

struct Classification {
    // Affine; the last row is unused.
    voxel_from_world: mat4x4<f32>,
    origin: vec3<f32>,
    // How far back along the ray a sample reads, how far a sample near a cut does, and the distance
    // within which a shape affects a sample.
    lookback_mm: f32,
    cell_mm: vec3<f32>,
    cut_lookback_mm: f32,
    size: vec3<u32>,
    cut_margin_mm: f32,
    // The volume's box in voxels.
    voxel_low: vec3<f32>,
    // A sample on a cell's face may be assigned to either cell.
    margin_mm: f32,
    voxel_high: vec3<f32>,
    iso: f32,
    table_scale: f32,
    table_offset: f32,
    // 1: only the surface at iso is visible.
    has_iso: u32,
    grey_faces: u32,
    // 1: only what has opacity is visible.
    composite: u32,
    // 1: at least one mask removes something.
    stack_has_cuts: u32,
    // log2 of a node's voxels along each axis, and the number of levels.
    value_shift: u32,
    value_levels: u32,
    value_size: vec3<u32>,
    // Error bound of the precomposed map; 0 without one.
    precompose_error_mm: f32,
    // Nodes along each axis, and the index of the first.
    values: array<vec4<u32>, 12>,
    // For each map: the number of levels, and whether its mask removes anything.
    maps: array<vec4<u32>, 64>,
    // For each map, eight levels: nodes along each axis, and the index of the first.
    levels: array<vec4<u32>, 512>,
}

@group(1) @binding(0) var<uniform> grid: Classification;
// Smallest and largest normalised value.
@group(1) @binding(1) var<storage, read> value_nodes: array<vec2<f32>>;
@group(1) @binding(2) var<storage, read> map_nodes: array<NodeBounds>;
// Prefix counts of the visible entries of the table.
@group(1) @binding(3) var<storage, read> visible_entries: array<u32>;
// 0 empty, 1 occupied, 2 occupied and unaffected by any cut.
@group(1) @binding(4) var<storage, read_write> flags: array<u32>;

// As FLAT_DISPLACEMENT in src/deform/bounds.rs: where displacements differ by less than this
// fraction of a box, a bound by slopes is no tighter.
const FLAT_DISPLACEMENT: f32 = 0.25;
const LAST_ENTRY: f32 = 4095.0;

struct Box {
    low: vec3<f32>,
    high: vec3<f32>,
}

// The effect of a map, or of several maps added to each other, on the points of a box; as
// AffineEnclosure in src/deform/bounds.rs.
struct AffineEnclosure {
    all: Box,
    mask: vec2<f32>,
    at_center: vec3<f32>,
    slope: mat3x3<f32>,
    spread: mat3x3<f32>,
    remainder: vec3<f32>,
}

struct BoxContents {
    something: bool,
    // A mask varies there, or a face of the volume lies there.
    is_near_cut: bool,
}

fn grown(b: Box, by: vec3<f32>) -> Box {
    return Box(b.low - by, b.high + by);
}

fn overlap(a: Box, b: Box) -> Box {
    return Box(max(a.low, b.low), min(a.high, b.high));
}

fn is_empty(b: Box) -> bool {
    return any(b.low > b.high);
}

fn largest(v: vec3<f32>) -> f32 {
    return max(v.x, max(v.y, v.z));
}

fn absolute(m: mat3x3<f32>) -> mat3x3<f32> {
    return mat3x3<f32>(abs(m[0]), abs(m[1]), abs(m[2]));
}

fn transformed(m: mat4x4<f32>, b: Box) -> Box {
    let center = transform_point(m, (b.low + b.high) * 0.5);
    let half = absolute(linear_part(m)) * ((b.high - b.low) * 0.5);
    return Box(center - half, center + half);
}

fn no_displacement() -> AffineEnclosure {
    let none = mat3x3<f32>(vec3<f32>(0.0), vec3<f32>(0.0), vec3<f32>(0.0));
    return AffineEnclosure(
        Box(vec3<f32>(0.0), vec3<f32>(0.0)), vec2<f32>(1.0), vec3<f32>(0.0), none, none, vec3<f32>(0.0)
    );
}

fn reach_of(k: u32) -> Box {
    return Box(-maps[k].reach, 1.0 + maps[k].reach);
}

// Bounds on the texels of a map that samples in a box, in map coordinates, can interpolate.
fn texels_within(k: u32, b: Box) -> NodeBounds {
    let last_cell = max(maps[k].size - 2.0, vec3<f32>(0.0));
    let low = vec3<u32>(clamp(floor(b.low * (maps[k].size - 1.0)), vec3<f32>(0.0), last_cell)) / 4u;
    let high = vec3<u32>(clamp(floor(b.high * (maps[k].size - 1.0)), vec3<f32>(0.0), last_cell)) / 4u;
    let wide = high - low;
    var level = 0u;
    while (max(wide.x, max(wide.y, wide.z)) >> level) > 2u && level + 1u < grid.maps[k].x {
        level += 1u;
    }
    let nodes = grid.levels[k * 8u + level];
    let first = low >> vec3<u32>(level);
    let last = min(high >> vec3<u32>(level), nodes.xyz - 1u);
    var all = map_nodes[nodes.w + (first.z * nodes.y + first.y) * nodes.x + first.x];
    for (var z = first.z; z <= last.z; z += 1u) {
        for (var y = first.y; y <= last.y; y += 1u) {
            for (var x = first.x; x <= last.x; x += 1u) {
                let at = nodes.w + (z * nodes.y + y) * nodes.x + x;
                all.low = min(all.low, map_nodes[at].low);
                all.high = max(all.high, map_nodes[at].high);
                for (var axis = 0u; axis < 3u; axis += 1u) {
                    all.slope_low[axis] = min(all.slope_low[axis], map_nodes[at].slope_low[axis]);
                    all.slope_high[axis] = max(all.slope_high[axis], map_nodes[at].slope_high[axis]);
                }
            }
        }
    }
    return all;
}

// A box in the map coordinates of a cylinder around a box of the cube, grown by `texels`; as
// Cylinder::range in src/deform/mapping.rs. Empty if it lies outside the cylinder.
struct CylinderRange {
    u: Box,
    outside: bool,
}

fn cylinder_range(k: u32, cube: Box, texels: f32) -> CylinderRange {
    let low = (cube.low.xy - 0.5) * maps[k].box_mm.xy;
    let high = (cube.high.xy - 0.5) * maps[k].box_mm.xy;
    let texel = texels / max(maps[k].size - 1.0, vec3<f32>(1.0));
    let nearest = clamp(vec2<f32>(0.0), low, high);
    let farthest = max(abs(low), abs(high));
    let radius_mm = vec2<f32>(
        max(length(nearest) - texel.z * maps[k].radius_mm, 0.0),
        length(farthest) + texel.z * maps[k].radius_mm,
    );
    var turn = vec2<f32>(0.0, 1.0);
    if !(low.x <= 0.0 && high.x >= 0.0 && high.y >= 0.0) {
        let a = turn_of(low);
        let b = turn_of(high);
        let c = turn_of(vec2<f32>(low.x, high.y));
        let d = turn_of(vec2<f32>(high.x, low.y));
        turn = vec2<f32>(min(min(a, b), min(c, d)) - texel.x, max(max(a, b), max(c, d)) + texel.x);
        if turn.x < 0.0 || turn.y > 1.0 {
            turn = vec2<f32>(0.0, 1.0);
        }
    }
    let height = vec2<f32>(cube.low.z - texel.y, cube.high.z + texel.y);
    return CylinderRange(
        Box(
            vec3<f32>(turn.x, max(height.x, 0.0), radius_mm.x / maps[k].radius_mm),
            vec3<f32>(turn.y, min(height.y, 1.0), min(radius_mm.y / maps[k].radius_mm, 1.0)),
        ),
        height.x < 0.0 || height.y > 1.0 || radius_mm.y > maps[k].radius_mm,
    );
}

// Smallest and largest of cos over a range of angles.
fn cosine_range(angles: vec2<f32>) -> vec2<f32> {
    let a = cos(angles.x);
    let b = cos(angles.y);
    let whole = angles.y - angles.x >= TURN;
    let top = floor(angles.y / TURN) > floor(angles.x / TURN) || whole;
    let bottom = floor(angles.y / TURN - 0.5) > floor(angles.x / TURN - 0.5) || whole;
    return vec2<f32>(select(min(a, b), -1.0, bottom), select(max(a, b), 1.0, top));
}

fn product_range(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    let all = vec4<f32>(a.x * b, a.y * b);
    return vec2<f32>(min(min(all.x, all.y), min(all.z, all.w)), max(max(all.x, all.y), max(all.z, all.w)));
}

// A box around the vectors a (sin, cos) for lengths a and angles in ranges.
fn vectors(lengths: vec2<f32>, angles: vec2<f32>) -> Box {
    let x = product_range(lengths, cosine_range(angles - 0.25 * TURN));
    let y = product_range(lengths, cosine_range(angles));
    return Box(vec3<f32>(x.x, y.x, 0.0), vec3<f32>(x.y, y.y, 0.0));
}

// A box around the displacements, world mm, of points of a cylinder whose D lies between two bounds.
fn cylinder_displacements(k: u32, u: Box, low: vec3<f32>, high: vec3<f32>) -> Box {
    let radius = vec2<f32>(u.low.z, u.high.z) * maps[k].radius_mm;
    let outward = vectors(
        vec2<f32>(max(low.z * maps[k].radius_mm, -radius.y), high.z * maps[k].radius_mm),
        vec2<f32>(u.low.x + low.x, u.high.x + high.x) * TURN,
    );
    let half = vec2<f32>(low.x, high.x) * 0.5 * TURN;
    let reach = 2.0 * cosine_range(half - 0.25 * TURN);
    let around = vectors(
        vec2<f32>(
            min(reach.x * radius.x, reach.x * radius.y), max(reach.y * radius.x, reach.y * radius.y)
        ),
        vec2<f32>(u.low.x, u.high.x) * TURN + half + 0.25 * TURN,
    );
    let height = maps[k].box_mm.z;
    let local = Box(
        outward.low + around.low + vec3<f32>(0.0, 0.0, low.y * height),
        outward.high + around.high + vec3<f32>(0.0, 0.0, high.y * height),
    );
    let linear = world_from_local(k);
    let middle = linear * ((local.low + local.high) * 0.5);
    let size = absolute(linear) * ((local.high - local.low) * 0.5);
    return Box(middle - size, middle + size);
}

// As affine_enclosure, for a map wrapped around an axis: no bound by slopes is known.
fn cylinder_enclosure(k: u32, b: Box) -> AffineEnclosure {
    let range = cylinder_range(k, transformed(maps[k].map_from_world, b), 0.01);
    if is_empty(range.u) {
        return no_displacement();
    }
    let texels = texels_within(k, range.u);
    var m = no_displacement();
    m.all = cylinder_displacements(k, range.u, texels.low.xyz * maps[k].scale, texels.high.xyz * maps[k].scale);
    m.mask = vec2<f32>(texels.low.w, texels.high.w);
    if range.outside {
        m.all = Box(min(m.all.low, vec3<f32>(0.0)), max(m.all.high, vec3<f32>(0.0)));
        m.mask.y = 1.0;
    }
    m.at_center = (m.all.low + m.all.high) * 0.5;
    m.remainder = (m.all.high - m.all.low) * 0.5;
    return m;
}

fn affine_enclosure(k: u32, b: Box) -> AffineEnclosure {
    if maps[k].radius_mm > 0.0 {
        return cylinder_enclosure(k, b);
    }
    // A hundredth of a texel as a margin for rounding.
    let texel = 0.01 / max(maps[k].size, vec3<f32>(2.0));
    let in_map = grown(transformed(maps[k].map_from_world, b), texel);
    let inside = overlap(in_map, reach_of(k));
    if is_empty(inside) {
        return no_displacement();
    }
    let outside = any(in_map.low < inside.low) || any(in_map.high > inside.high);
    let texels = texels_within(k, inside);
    let linear = linear_part(maps[k].world_from_stored);
    let middle = linear * ((texels.low.xyz + texels.high.xyz) * 0.5);
    let half = absolute(linear) * ((texels.high.xyz - texels.low.xyz) * 0.5);
    var all = Box(middle - half, middle + half);
    var mask = vec2<f32>(texels.low.w, texels.high.w);
    if outside {
        // Points outside the cube are not displaced.
        all = Box(min(all.low, vec3<f32>(0.0)), max(all.high, vec3<f32>(0.0)));
        mask.y = 1.0;
    }
    var m = no_displacement();
    m.all = all;
    m.mask = mask;
    if outside || largest(all.high - all.low) < FLAT_DISPLACEMENT * largest(b.high - b.low) {
        m.at_center = (all.low + all.high) * 0.5;
        m.remainder = (all.high - all.low) * 0.5;
        return m;
    }
    var slopes = mat3x3<f32>(vec3<f32>(0.0), vec3<f32>(0.0), vec3<f32>(0.0));
    var spreads = slopes;
    // Beyond the cube the outermost texels are clamped.
    let flat_too = any(in_map.low < vec3<f32>(0.0)) || any(in_map.high > vec3<f32>(1.0));
    for (var axis = 0u; axis < 3u; axis += 1u) {
        var low = texels.slope_low[axis].xyz;
        var high = texels.slope_high[axis].xyz;
        if flat_too {
            low = min(low, vec3<f32>(0.0));
            high = max(high, vec3<f32>(0.0));
        }
        slopes[axis] = (low + high) * 0.5;
        spreads[axis] = (high - low) * 0.5;
    }
    let map_from_world = linear_part(maps[k].map_from_world);
    m.at_center = linear * fetch(k, transform_point(maps[k].map_from_world, (b.low + b.high) * 0.5)).xyz;
    m.slope = linear * slopes * map_from_world;
    m.spread = absolute(linear) * spreads * absolute(map_from_world);
    m.remainder = (absolute(m.slope) + m.spread) * (absolute(linear) * texel / maps[k].scale);
    return m;
}

fn sum(a: AffineEnclosure, b: AffineEnclosure) -> AffineEnclosure {
    return AffineEnclosure(
        Box(a.all.low + b.all.low, a.all.high + b.all.high),
        min(a.mask, b.mask),
        a.at_center + b.at_center,
        a.slope + b.slope,
        a.spread + b.spread,
        a.remainder + b.remainder,
    );
}

// The source box of a box of points: the intersection of both bounds.
fn source_of(m: AffineEnclosure, b: Box) -> Box {
    let one = mat3x3<f32>(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    let center = (b.low + b.high) * 0.5 + m.at_center;
    let half = (absolute(one + m.slope) + m.spread) * ((b.high - b.low) * 0.5) + m.remainder;
    return overlap(Box(b.low + m.all.low, b.high + m.all.high), Box(center - half, center + half));
}

fn values_within(low: vec3<f32>, high: vec3<f32>) -> vec2<f32> {
    let last_cell = max(vec3<f32>(grid.value_size) - 2.0, vec3<f32>(0.0));
    let a = vec3<u32>(clamp(floor(low), vec3<f32>(0.0), last_cell)) >> vec3<u32>(grid.value_shift);
    let b = vec3<u32>(clamp(floor(high), vec3<f32>(0.0), last_cell)) >> vec3<u32>(grid.value_shift);
    let wide = b - a;
    var level = 0u;
    while (max(wide.x, max(wide.y, wide.z)) >> level) > 1u && level + 1u < grid.value_levels {
        level += 1u;
    }
    let nodes = grid.values[level];
    let first = a >> vec3<u32>(level);
    let last = min(b >> vec3<u32>(level), nodes.xyz - 1u);
    var range = vec2<f32>(3e38, -3e38);
    for (var z = first.z; z <= last.z; z += 1u) {
        for (var y = first.y; y <= last.y; y += 1u) {
            for (var x = first.x; x <= last.x; x += 1u) {
                let node = value_nodes[nodes.w + (z * nodes.y + y) * nodes.x + x];
                range = vec2<f32>(min(range.x, node.x), max(range.y, node.y));
            }
        }
    }
    return range;
}

// Whether any table entry that values in this range can reach is visible. No margin is added: the
// background's value often is the last invisible entry.
fn any_visible(range: vec2<f32>) -> bool {
    let at = clamp(range * grid.table_scale + grid.table_offset, vec2<f32>(0.0), vec2<f32>(1.0)) * LAST_ENTRY;
    let first = u32(floor(min(at.x, at.y)));
    let last = u32(ceil(max(at.x, at.y)));
    return visible_entries[last + 1u] > visible_entries[first];
}

// A box of the source in voxels, a little larger.
fn box_in_voxel(source: Box) -> Box {
    return grown(transformed(grid.voxel_from_world, source), vec3<f32>(0.01));
}

// Whether anything in a source box is visible; `whole` if nothing of it is cut away.
fn source_is_visible(source: Box, whole: bool, max_alpha: f32) -> bool {
    if max_alpha < 0.5 {
        return false;
    }
    let inside = overlap(box_in_voxel(source), Box(grid.voxel_low, grid.voxel_high));
    if is_empty(inside) {
        return false;
    }
    if grid.composite == 0u || (grid.grey_faces != 0u && !whole) {
        return true;
    }
    let range = values_within(inside.low, inside.high);
    if grid.has_iso != 0u {
        return range.y >= grid.iso;
    }
    return any_visible(range);
}

// Smallest and largest signed distance to what the shapes remove.
fn signed_distance_range(b: Box) -> vec2<f32> {
    if CUTS == 0u {
        return vec2<f32>(1e30);
    }
    let middle = cuts_signed_distance_mm((b.low + b.high) * 0.5);
    let radius = length(b.high - b.low) * 0.5;
    return vec2<f32>(middle - radius, middle + radius);
}

fn box_visibility(b: Box) -> BoxContents {
    let distance_range = signed_distance_range(b);
    if distance_range.y < 0.0 {
        return BoxContents(false, false);
    }
    var at = b;
    var together = no_displacement();
    var alpha = vec2<f32>(1.0);
    for (var i = MAPS; i > 0u; i -= 1u) {
        let m = affine_enclosure(i - 1u, at);
        alpha = min(alpha, m.mask);
        together = sum(together, m);
        if maps[i - 1u].added < 0.5 {
            at = source_of(together, at);
            together = no_displacement();
        }
    }
    let source = grown(at, vec3<f32>(grid.precompose_error_mm));
    let whole = distance_range.x >= 0.0 && alpha.x >= 0.5;
    let in_voxel = box_in_voxel(source);
    let at_face = any(in_voxel.low < grid.voxel_low) || any(in_voxel.high > grid.voxel_high);
    return BoxContents(source_is_visible(source, whole, alpha.y), alpha.x < 1.0 || at_face);
}

fn cell_is_visible(cell: Box) -> bool {
    let own = box_visibility(grown(cell, vec3<f32>(grid.lookback_mm)));
    if own.something || grid.cut_lookback_mm <= grid.lookback_mm {
        return own.something;
    }
    let reached = grown(cell, vec3<f32>(grid.cut_lookback_mm));
    let distance_range = signed_distance_range(reached);
    let near_shape = distance_range.x < 0.0 && distance_range.y >= 0.0;
    return (own.is_near_cut || near_shape || mask_varies(reached)) && box_visibility(reached).something;
}

// Whether some texel within one texel of a box, in world coordinates, has a mask below 1.
fn mask_of_map_varies(k: u32, b: Box) -> bool {
    if grid.maps[k].y == 0u {
        return false;
    }
    if maps[k].radius_mm > 0.0 {
        let range = cylinder_range(k, transformed(maps[k].map_from_world, b), 1.01);
        return !is_empty(range.u) && texels_within(k, range.u).low.w < 1.0;
    }
    let texel = 1.01 / max(maps[k].size - 1.0, vec3<f32>(1.0));
    let around = overlap(grown(transformed(maps[k].map_from_world, b), texel), reach_of(k));
    return !is_empty(around) && texels_within(k, around).low.w < 1.0;
}

fn mask_varies(deformed: Box) -> bool {
    if grid.stack_has_cuts == 0u {
        return false;
    }
    var b = deformed;
    var at = deformed;
    for (var i = MAPS; i > 0u; i -= 1u) {
        if mask_of_map_varies(i - 1u, at) {
            return true;
        }
        let m = affine_enclosure(i - 1u, at);
        b = Box(b.low + m.all.low, b.high + m.all.high);
        if maps[i - 1u].added < 0.5 {
            at = b;
        }
    }
    return false;
}

@compute @workgroup_size(4, 4, 4)
fn classify(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= grid.size) {
        return;
    }
    let low = grid.origin + vec3<f32>(id) * grid.cell_mm;
    let cell = grown(Box(low, low + grid.cell_mm), vec3<f32>(grid.margin_mm));
    var flag = 0u;
    if cell_is_visible(cell) {
        let reached = grown(cell, vec3<f32>(grid.cut_lookback_mm));
        flag = select(2u, 1u, mask_varies(reached) || signed_distance_range(reached).x < grid.cut_margin_mm);
    }
    flags[(id.z * grid.size.y + id.y) * grid.size.x + id.x] = flag;
}
