// Bounds on boxes of a map's texels: first of 4 x 4 x 4 cells from the texels, then of 2 x 2 x 2
// boxes from those. Counterpart of src/math/pyramid.rs and of slopes_of in src/deform/map.rs.

const CELLS: u32 = 4u;

struct Level {
    // Nodes along each axis, and the index of the first node, for the level being built and for the
    // level it is built from.
    size: vec3<u32>,
    first: u32,
    below_size: vec3<u32>,
    below_first: u32,
}

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read_write> nodes: array<NodeBounds>;
@group(0) @binding(2) var map: texture_3d<f32>;

fn nothing() -> NodeBounds {
    let high = vec4<f32>(3e38);
    return NodeBounds(
        high, -high, array<vec4<f32>, 3>(high, high, high), array<vec4<f32>, 3>(-high, -high, -high)
    );
}

@compute @workgroup_size(4, 4, 4)
fn leaves(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= level.size) {
        return;
    }
    let points = textureDimensions(map);
    let first = id * CELLS;
    let last = min(first + CELLS, points - 1u);
    var all = nothing();
    for (var k = first.z; k <= last.z; k += 1u) {
        for (var j = first.y; j <= last.y; j += 1u) {
            for (var i = first.x; i <= last.x; i += 1u) {
                let at = vec3<u32>(i, j, k);
                let t = textureLoad(map, at, 0);
                all.low = min(all.low, t);
                all.high = max(all.high, t);
                for (var axis = 0u; axis < 3u; axis += 1u) {
                    var change = vec4<f32>(0.0);
                    if points[axis] > 1u {
                        // The last point on an axis uses the difference to the point before it.
                        var low = at;
                        low[axis] = min(at[axis], points[axis] - 2u);
                        var high = low;
                        high[axis] += 1u;
                        change = (textureLoad(map, high, 0) - textureLoad(map, low, 0))
                            * f32(points[axis] - 1u);
                    }
                    all.slope_low[axis] = min(all.slope_low[axis], change);
                    all.slope_high[axis] = max(all.slope_high[axis], change);
                }
            }
        }
    }
    nodes[level.first + (id.z * level.size.y + id.y) * level.size.x + id.x] = all;
}

@compute @workgroup_size(4, 4, 4)
fn halve(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= level.size) {
        return;
    }
    let last = min(id * 2u + 1u, level.below_size - 1u);
    var all = nothing();
    for (var k = id.z * 2u; k <= last.z; k += 1u) {
        for (var j = id.y * 2u; j <= last.y; j += 1u) {
            for (var i = id.x * 2u; i <= last.x; i += 1u) {
                let node = nodes[level.below_first + (k * level.below_size.y + j) * level.below_size.x + i];
                all.low = min(all.low, node.low);
                all.high = max(all.high, node.high);
                for (var axis = 0u; axis < 3u; axis += 1u) {
                    all.slope_low[axis] = min(all.slope_low[axis], node.slope_low[axis]);
                    all.slope_high[axis] = max(all.slope_high[axis], node.slope_high[axis]);
                }
            }
        }
    }
    nodes[level.first + (id.z * level.size.y + id.y) * level.size.x + id.x] = all;
}
