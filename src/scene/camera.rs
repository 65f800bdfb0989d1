//! The camera: a named or free view direction of the scene, and its frame in world space.

use crate::math::Bounds;
use crate::math::lanes::*;
use crate::{Error, Result};
use glam::{Affine3A, Mat4, Vec2, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// A direction of view: azimuth and elevation of the camera as seen from the scene, degrees.
///
/// Azimuth 0 is in front of the patient (anterior), 90 at the patient's left; elevation 90 is above
/// the head. Written as one of the six names or as `AZ,EL`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct View {
    /// Degrees from anterior towards the patient's left.
    pub azimuth_deg: f32,
    /// Degrees above the axial plane, -90..90.
    pub elevation_deg: f32,
}

impl View {
    /// The unit vector from the scene towards the camera: L, P, S.
    pub fn toward_eye(self) -> Vec3 {
        let (sin_az, cos_az) = self.azimuth_deg.to_radians().sin_cos();
        let (sin_el, cos_el) = self.elevation_deg.to_radians().sin_cos();
        Vec3::new(sin_az * cos_el, -cos_az * cos_el, sin_el)
    }
}

const NAMED: [(&str, f32, f32); 6] = [
    ("anterior", 0.0, 0.0),
    ("posterior", 180.0, 0.0),
    ("left", 90.0, 0.0),
    ("right", -90.0, 0.0),
    // With the front of the patient up, as an axial slice is shown.
    ("superior", 180.0, 90.0),
    ("inferior", 0.0, -90.0),
];

impl FromStr for View {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(&(_, azimuth_deg, elevation_deg)) = NAMED.iter().find(|n| n.0 == text) {
            return Ok(Self {
                azimuth_deg,
                elevation_deg,
            });
        }
        let parts: Vec<f32> = text
            .split(',')
            .map_while(|p| p.trim().parse().ok())
            .filter(|v: &f32| v.is_finite())
            .collect();
        match parts[..] {
            [azimuth_deg, elevation_deg] if text.split(',').count() == 2 && elevation_deg.abs() <= 90.0 => {
                Ok(Self {
                    azimuth_deg,
                    elevation_deg,
                })
            }
            _ => Err(format!(
                "\"{text}\" is not a view; use {} or AZ,EL in degrees (elevation within -90..90)",
                NAMED.map(|n| n.0).join(", ")
            )),
        }
    }
}

impl TryFrom<String> for View {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<View> for String {
    fn from(view: View) -> Self {
        match NAMED
            .iter()
            .find(|n| (n.1, n.2) == (view.azimuth_deg, view.elevation_deg))
        {
            Some(n) => n.0.into(),
            None => format!("{},{}", view.azimuth_deg, view.elevation_deg),
        }
    }
}

/// Camera projection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Projection {
    /// Perspective projection: nearer objects appear larger.
    #[default]
    Perspective,
    /// Parallel projection: lengths in the view plane are to scale.
    Orthographic,
}

/// The `[camera]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Camera {
    /// Direction of view.
    pub view: View,
    /// 1 shows the whole volume; larger values zoom in.
    pub zoom: f32,
    /// Perspective or orthographic.
    pub projection: Projection,
    /// Vertical field of view of the perspective camera, degrees.
    pub field_of_view: f32,
    /// Roll about the view direction, degrees, clockwise in the picture.
    pub roll: f32,
    /// The point in the middle of the picture, mm; the volume's centre by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<[f32; 3]>,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            view: View {
                azimuth_deg: 0.0,
                elevation_deg: 0.0,
            },
            zoom: 1.0,
            projection: Projection::Perspective,
            field_of_view: 30.0,
            roll: 0.0,
            target: None,
        }
    }
}

/// A camera resolved for a scene and a picture: the ray of pixel (x, y) runs along `forward + u
/// right + v up` (perspective) or starts at `eye + u right + v up` (orthographic), u and v in -1..1
/// over the picture, v upwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewFrame {
    /// The eye; for the orthographic camera, a point in front of the scene.
    pub eye: Vec3,
    /// Unit direction of view.
    pub forward: Vec3,
    /// Half the picture's width, as a vector to the right: mm (orthographic) or per unit of depth
    /// (perspective).
    pub right: Vec3,
    /// Half the picture's height, as a vector upwards.
    pub up: Vec3,
    /// Perspective or orthographic.
    pub projection: Projection,
}

impl Camera {
    /// Largest ratio of a ray's step between slices to the distance between slices: 1/cos of the
    /// angle to the picture's corners.
    pub fn slant(&self, size: [u32; 2]) -> f32 {
        if self.projection == Projection::Orthographic {
            return 1.0;
        }
        let tan = (self.field_of_view.to_radians() / 2.0).tan() / self.zoom;
        let aspect = size[0] as f32 / size[1] as f32;
        (1.0 + tan * tan * (1.0 + aspect * aspect)).sqrt()
    }

    /// Places the camera so that at zoom 1 the box just fits the picture.
    ///
    /// # Errors
    /// A zoom, field of view or target that is out of range.
    pub fn frame(&self, bounds: &Bounds, size: [u32; 2]) -> Result<ViewFrame> {
        if !(self.zoom.is_finite() && (1e-3..=1e3).contains(&self.zoom)) {
            return Err(Error::value(
                "camera.zoom",
                format!("{} is outside 0.001 to 1000", self.zoom),
            ));
        }
        if !(1.0..=120.0).contains(&self.field_of_view) {
            return Err(Error::value(
                "camera.field_of_view",
                format!("{} is outside 1 to 120 degrees", self.field_of_view),
            ));
        }
        if !(self.roll.is_finite() && self.target.is_none_or(|t| t.iter().all(|v| v.is_finite()))) {
            return Err(Error::value("camera", "roll and target must be finite"));
        }
        let (sin_az, cos_az) = self.view.azimuth_deg.to_radians().sin_cos();
        let (sin_el, cos_el) = self.view.elevation_deg.to_radians().sin_cos();
        let forward = -self.view.toward_eye();
        let up = Vec3::new(-sin_az * sin_el, cos_az * sin_el, cos_el);
        let right = forward.cross(up);
        let (sin_roll, cos_roll) = (-self.roll).to_radians().sin_cos();
        let (right, up) = (right * cos_roll + up * sin_roll, up * cos_roll - right * sin_roll);
        let target = self.target.map_or_else(|| bounds.center(), Vec3::from);
        let aspect = size[0] as f32 / size[1] as f32;
        // A small margin around the volume.
        const MARGIN: f32 = 1.04;
        let corners = bounds.corners().map(|c| {
            let d = c - bounds.center();
            (
                d.dot(right).abs() * MARGIN,
                d.dot(up).abs() * MARGIN,
                d.dot(forward),
            )
        });
        let radius = bounds.size().length() / 2.0;
        Ok(match self.projection {
            Projection::Orthographic => {
                let half_height = corners
                    .iter()
                    .map(|&(x, y, _)| y.max(x / aspect))
                    .fold(0.0, f32::max)
                    / self.zoom;
                let away = 2.0 * radius + (target - bounds.center()).length();
                ViewFrame {
                    eye: target - forward * away,
                    forward,
                    right: right * half_height * aspect,
                    up: up * half_height,
                    projection: self.projection,
                }
            }
            Projection::Perspective => {
                let tan = (self.field_of_view.to_radians() / 2.0).tan();
                let away = corners
                    .iter()
                    .map(|&(x, y, z)| (y / tan).max(x / (tan * aspect)) - z)
                    .fold(0.0, f32::max);
                // Zoom narrows the field of view: the perspective is unchanged, the picture is
                // magnified.
                let tan = tan / self.zoom;
                ViewFrame {
                    eye: target - forward * away,
                    forward,
                    right: right * tan * aspect,
                    up: up * tan,
                    projection: self.projection,
                }
            }
        })
    }
}

impl ViewFrame {
    /// Moves an orthographic eye back until a box lies in front of it: deformations can move parts
    /// of the volume out of its box. (A perspective eye does not move: it does not see what lies
    /// behind it.)
    pub fn step_back_from(&mut self, bounds: &Bounds, margin_mm: f32) {
        let nearest = bounds
            .corners()
            .iter()
            .map(|&c| (c - self.eye).dot(self.forward))
            .fold(f32::INFINITY, f32::min);
        if self.projection == Projection::Orthographic && nearest < margin_mm {
            self.eye -= self.forward * (margin_mm - nearest);
        }
    }

    /// The line of a pixel: its point at depth z is the first plus z times the second.
    pub fn across(&self, u: f32, v: f32) -> (Vec3, Vec3) {
        let across = self.right * u + self.up * v;
        match self.projection {
            Projection::Perspective => (self.eye, self.forward + across),
            Projection::Orthographic => (self.eye + across, self.forward),
        }
    }

    /// Origin and unit direction of the ray through picture coordinates in -1..1.
    #[inline(always)]
    pub fn ray(&self, u: f32, v: f32) -> (Vec3, Vec3) {
        let across = self.right * u + self.up * v;
        match self.projection {
            Projection::Perspective => (self.eye, (self.forward + across).normalize()),
            Projection::Orthographic => (self.eye + across, self.forward),
        }
    }

    /// [`Self::ray`] for eight pixels.
    #[inline(always)]
    pub fn rays<S: Simd>(&self, simd: S, u: f32x8<S>, v: f32x8<S>) -> (Vec3x8<S>, Vec3x8<S>) {
        let across = Vec3x8::splat(simd, self.right) * u + Vec3x8::splat(simd, self.up) * v;
        let (eye, forward) = (Vec3x8::splat(simd, self.eye), Vec3x8::splat(simd, self.forward));
        match self.projection {
            Projection::Perspective => {
                let toward = forward + across;
                (eye, toward * (f32x8::splat(simd, 1.0) / toward.length()))
            }
            Projection::Orthographic => (eye + across, forward),
        }
    }

    /// The range of pixels (first, and one past the last, along x and along y) whose rays can meet
    /// a box; all pixels if the box reaches behind the eye.
    pub fn pixels_of(&self, b: &Bounds, size: [u32; 2]) -> [[usize; 2]; 2] {
        if b.is_empty() {
            return [[0; 2]; 2];
        }
        let size = Vec2::new(size[0] as f32, size[1] as f32);
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        for corner in b.corners() {
            let d = corner - self.eye;
            let depth = match self.projection {
                Projection::Perspective if d.dot(self.forward) <= 1e-3 * d.length() => {
                    return [[0, size.x as usize], [0, size.y as usize]];
                }
                Projection::Perspective => d.dot(self.forward),
                Projection::Orthographic => 1.0,
            };
            let at = Vec2::new(
                d.dot(self.right) / self.right.length_squared(),
                -d.dot(self.up) / self.up.length_squared(),
            ) / depth;
            let pixel = (at + 1.0) * 0.5 * size;
            (low, high) = (low.min(pixel), high.max(pixel));
        }
        // Two more pixels on each side absorb rounding.
        let (low, high) = (
            (low - 2.0).floor().clamp(Vec2::ZERO, size),
            (high + 2.0).ceil().clamp(Vec2::ZERO, size),
        );
        [
            [low.x as usize, high.x as usize],
            [low.y as usize, high.y as usize],
        ]
    }

    /// The highest of 1 / cos of the angle between a pixel's ray and the view direction.
    pub fn longest_slant(&self) -> f32 {
        match self.projection {
            Projection::Perspective => (self.forward + self.right + self.up).length(),
            Projection::Orthographic => 1.0,
        }
    }

    /// The transform to clip space. Every point gets depth 1/2: slices are drawn in order, and are
    /// tested only against the mask of opaque pixels at depth 0.
    pub fn clip_from_world(&self) -> Mat4 {
        let basis = |v: Vec3| v / v.length_squared();
        let (r, u) = (basis(self.right), basis(self.up));
        let view = Affine3A::from_translation(-self.eye);
        let rows = match self.projection {
            Projection::Perspective => [
                r.extend(0.0),
                u.extend(0.0),
                (self.forward * 0.5).extend(0.0),
                self.forward.extend(0.0),
            ],
            Projection::Orthographic => [
                r.extend(0.0),
                u.extend(0.0),
                Vec3::ZERO.extend(0.5),
                Vec3::ZERO.extend(1.0),
            ],
        };
        Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose() * Mat4::from(view)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(view: &str, projection: Projection) -> ViewFrame {
        let view = view.parse().unwrap_or_else(|e| panic!("{e}"));
        let camera = Camera {
            view,
            projection,
            ..Camera::default()
        };
        camera
            .frame(&Bounds::new(Vec3::splat(-50.0), Vec3::splat(50.0)), [200, 100])
            .unwrap_or_else(|e| panic!("{e}"))
    }

    /// No ray outside the returned pixels meets the box, and the range is not much too large; a box
    /// that reaches behind the eye counts as the whole picture.
    #[test]
    fn pixels_of_a_box_are_all_that_meet_it() {
        let size = [200u32, 100];
        for (view, projection) in [
            ("anterior", Projection::Perspective),
            ("37,-20", Projection::Perspective),
            ("37,-20", Projection::Orthographic),
        ] {
            let f = frame(view, projection);
            for n in 0..60 {
                let at = Vec3::new((n % 4) as f32, (n / 4 % 4) as f32, (n / 16) as f32) * 24.0 - 45.0;
                let b = Bounds::new(at, at + Vec3::new(3.0, 17.0, 8.0));
                let [x, y] = f.pixels_of(&b, size);
                let (mut met, mut low, mut high) = (0, [usize::MAX; 2], [0; 2]);
                for (j, i) in (0..100usize).flat_map(|j| (0..200usize).map(move |i| (j, i))) {
                    let (origin, direction) =
                        f.ray((i as f32 + 0.5) / 100.0 - 1.0, 1.0 - (j as f32 + 0.5) / 50.0);
                    if b.intersect_ray(origin, direction)
                        .is_some_and(|(_, far)| far >= 0.0)
                    {
                        assert!(
                            i >= x[0] && i < x[1] && j >= y[0] && j < y[1],
                            "{i},{j} of {b:?}: {x:?} {y:?}"
                        );
                        (low, high) = ([low[0].min(i), low[1].min(j)], [high[0].max(i), high[1].max(j)]);
                        met += 1;
                    }
                }
                assert!(
                    met == 0 || (x[1] - x[0] <= high[0] - low[0] + 8 && y[1] - y[0] <= high[1] - low[1] + 8),
                    "{b:?}: {x:?} {y:?}"
                );
            }
        }
        let f = frame("anterior", Projection::Perspective);
        assert_eq!(
            f.pixels_of(&Bounds::new(f.eye - 1.0, f.eye + 1.0), size),
            [[0, 200], [0, 100]]
        );
        assert_eq!(f.pixels_of(&Bounds::EMPTY, size), [[0, 0], [0, 0]]);
    }

    /// Eight rays at once, and their intersections with a box, equal single rays to the bit, also
    /// for rays along an axis, rays that miss the box, and an empty box.
    #[test]
    fn eight_rays_are_single_rays() {
        struct RaysKernel<'a>(&'a ViewFrame, &'a Bounds, [f32; LANES], [f32; LANES]);
        impl SimdKernel for RaysKernel<'_> {
            type Output = [(Vec3, Vec3, f32, f32); LANES];
            #[inline(always)]
            fn run<S: Simd>(self, simd: S) -> Self::Output {
                let (origin, direction) = self.0.rays(
                    simd,
                    f32x8::load_array(simd, self.2),
                    f32x8::load_array(simd, self.3),
                );
                let one = f32x8::splat(simd, 1.0);
                let inverse = Vec3x8 {
                    x: one / direction.x,
                    y: one / direction.y,
                    z: one / direction.z,
                };
                let (near, far) = self.1.intersect_rays(simd, origin, inverse);
                std::array::from_fn(|n| (origin.lane(n), direction.lane(n), near[n], far[n]))
            }
        }
        let boxes = [
            Bounds::new(Vec3::new(-20.0, -7.0, 1.0), Vec3::new(30.0, 9.0, 40.0)),
            Bounds::EMPTY,
            Bounds::new(Vec3::ZERO, Vec3::ZERO),
        ];
        let (mut met, mut missed) = (0, 0);
        for (view, projection) in [
            ("anterior", Projection::Perspective),
            ("37,-20", Projection::Perspective),
            ("superior", Projection::Orthographic),
        ] {
            let f = frame(view, projection);
            for (n, b) in (0..400).flat_map(|n| boxes.iter().map(move |b| (n, b))) {
                let u: [f32; LANES] =
                    std::array::from_fn(|lane| (n % 20) as f32 * 0.1 - 1.0 + lane as f32 * 0.01);
                let v: [f32; LANES] =
                    std::array::from_fn(|lane| (n / 20) as f32 * 0.1 - 1.0 + lane as f32 * 0.013);
                for (lane, (origin, direction, near, far)) in
                    with_simd(RaysKernel(&f, b, u, v)).into_iter().enumerate()
                {
                    assert_eq!((origin, direction), f.ray(u[lane], v[lane]));
                    let single = b.intersect_ray(origin, direction);
                    assert_eq!(
                        (near <= far).then_some((near, far)),
                        single,
                        "{origin} {direction} {b:?}"
                    );
                    if single.is_some() { met += 1 } else { missed += 1 }
                }
            }
        }
        assert!(met > 300 && missed > 300, "{met} {missed}");
    }

    /// Patient left (+x) is on the right of an anterior and an axial picture, as radiologists see
    /// them.
    #[test]
    fn named_views_have_the_right_sides() {
        let (right, up) = (
            |v: &str| frame(v, Projection::Orthographic).right.normalize(),
            |v: &str| frame(v, Projection::Orthographic).up.normalize(),
        );
        for (view, r, u) in [
            ("anterior", Vec3::X, Vec3::Z),
            ("posterior", Vec3::NEG_X, Vec3::Z),
            ("left", Vec3::Y, Vec3::Z),
            ("right", Vec3::NEG_Y, Vec3::Z),
            ("superior", Vec3::NEG_X, Vec3::NEG_Y),
            ("inferior", Vec3::X, Vec3::NEG_Y),
            ("0,0", Vec3::X, Vec3::Z),
        ] {
            assert!(
                right(view).abs_diff_eq(r, 1e-6) && up(view).abs_diff_eq(u, 1e-6),
                "{view}: {} {}",
                right(view),
                up(view)
            );
        }
    }

    #[test]
    fn the_matrix_projects_points_on_their_rays() {
        for projection in [Projection::Perspective, Projection::Orthographic] {
            let f = frame("30,20", projection);
            let (o, d) = f.ray(0.3, -0.6);
            let clip = f.clip_from_world() * (o + d * 123.0).extend(1.0);
            let ndc = clip / clip.w;
            assert!(
                (ndc.x - 0.3).abs() < 1e-5 && (ndc.y + 0.6).abs() < 1e-5 && (ndc.z - 0.5).abs() < 1e-5,
                "{ndc}"
            );
        }
    }

    #[test]
    fn the_box_fits() {
        for projection in [Projection::Perspective, Projection::Orthographic] {
            let f = frame("30,20", projection);
            let most = Bounds::new(Vec3::splat(-50.0), Vec3::splat(50.0))
                .corners()
                .map(|c| {
                    let clip = f.clip_from_world() * c.extend(1.0);
                    (clip.y / clip.w).abs().max((clip.x / clip.w).abs())
                });
            let most = most.into_iter().fold(0.0, f32::max);
            assert!((0.9..1.0).contains(&most), "{most}");
        }
    }

    #[test]
    fn views_that_are_none() {
        for bad in ["above", "1", "1,2,3", "a,b", "0,91", "nan,0"] {
            assert!(bad.parse::<View>().is_err(), "{bad}");
        }
    }
}
