// Bounds on a box of a map's texels: stored (D, alpha), and the change of stored D per map unit
// along each axis.
struct NodeBounds {
    low: vec4<f32>,
    high: vec4<f32>,
    slope_low: array<vec4<f32>, 3>,
    slope_high: array<vec4<f32>, 3>,
}
