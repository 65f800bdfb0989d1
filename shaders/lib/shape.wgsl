// Cut shapes, evaluated analytically rather than sampled.

const HALF_PI: f32 = 1.5707964;

// Distance from a shape, mm, positive outside; q in the shape's local millimetres.
fn outside_shape(shape: u32, q: vec3<f32>, half: vec3<f32>, half_angle: f32) -> f32 {
    switch shape {
        case SHAPE_HALF_SPACE: { return half.z - q.z; }
        case SHAPE_BOX: {
            let d = abs(q) - half;
            return length(max(d, vec3<f32>(0.0))) + min(max(d.x, max(d.y, d.z)), 0.0);
        }
        case SHAPE_ELLIPSOID: { return (length(q / half) - 1.0) * min(half.x, min(half.y, half.z)); }
        case SHAPE_CYLINDER: {
            let d = vec2<f32>(length(q.xy) - half.x, abs(q.z) - half.z);
            return length(max(d, vec2<f32>(0.0))) + min(max(d.x, d.y), 0.0);
        }
        case SHAPE_WEDGE: {
            let r = length(q.xy);
            let beyond = atan2(abs(q.y), q.x) - half_angle;
            let side = select(r * sign(beyond), r * sin(beyond), abs(beyond) < HALF_PI);
            return max(max(side, r - half.x), abs(q.z) - half.z);
        }
        default: {
            let v = vec2<f32>(q.z, length(q.xy));
            let axis = vec2<f32>(cos(half_angle), sin(half_angle));
            return select(length(v), axis.x * v.y - axis.y * v.x, dot(v, axis) > 0.0);
        }
    }
}
