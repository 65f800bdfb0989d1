//! The tools for clicks and drags in a view, and templates for placing deformations on a surface.

use crate::deform::kinds::{DefaultSize, Kind};
use crate::math::Bounds;
use crate::scene::measure::MeasureKind;
use crate::scene::{Deformation, Size};
use egui_phosphor::regular as icon;
use glam::{EulerRot, Mat3, Quat, Vec3};

/// A kind to place.
#[derive(Clone, Copy)]
pub struct Placed(pub &'static Kind);

impl PartialEq for Placed {
    fn eq(&self, other: &Self) -> bool {
        self.0.name == other.0.name
    }
}

impl std::fmt::Debug for Placed {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(self.0.name)
    }
}

/// The armed tool.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum Tool {
    /// Orbits the camera, moves the crosshair, drags handles.
    #[default]
    Navigate,
    /// Records the value at a click.
    Probe,
    /// Takes the points of a measurement.
    Measure(MeasureKind),
    /// Places a deformation.
    Place(Placed),
    /// Cuts out an outline.
    LassoCut,
    /// Restores the inside of an outline.
    LassoRestore,
    /// Drags the volume along.
    BrushPush,
    /// Smooths the displacement.
    BrushSmooth,
    /// Cuts away.
    BrushCut,
    /// Restores what was cut away.
    BrushRestore,
}

impl Tool {
    /// Instructions, one sentence.
    pub fn hint(self) -> String {
        match self {
            Self::Navigate => String::new(),
            Self::Probe => "Click a point to read its value. Press Esc to finish.".into(),
            Self::Measure(kind) => format!("Click {} points. Press Esc to finish.", kind.points()),
            Self::Place(kind) => format!(
                "Click the surface, or drag onto it, to place: {}. Press Esc to finish.",
                words(kind.0.name)
            ),
            Self::LassoCut => "Draw around the region to cut away. Press Esc to finish.".into(),
            Self::LassoRestore => "Draw around the region to restore. Press Esc to finish.".into(),
            Self::BrushPush => "Drag tissue on a slice or on the surface. Press Esc to finish.".into(),
            Self::BrushSmooth => "Brush over the region to smooth. Press Esc to finish.".into(),
            Self::BrushCut => "Brush over the region to cut away. Press Esc to finish.".into(),
            Self::BrushRestore => "Brush over the region to restore. Press Esc to finish.".into(),
        }
    }

    /// The brush of a painting tool.
    pub fn brush(self) -> Option<&'static str> {
        match self {
            Self::BrushPush => Some("push"),
            Self::BrushSmooth => Some("smooth"),
            Self::BrushCut => Some("cut"),
            Self::BrushRestore => Some("restore"),
            _ => None,
        }
    }

    /// Whether it is a lasso tool.
    pub fn is_lasso(self) -> bool {
        matches!(self, Self::LassoCut | Self::LassoRestore)
    }
}

/// The display name of a kind.
pub fn words(kind: &str) -> String {
    let mut text = match kind {
        "half-space" => "clip plane".to_owned(),
        "retractor" => "retractor".into(),
        "lift" => "window".into(),
        "surface-peel" => "skin flap".into(),
        "book" => "book-open".into(),
        "seam" => "split".into(),
        "slab" => "slabs".into(),
        "explode-labels" => "explode labels".into(),
        "points" => "control points".into(),
        "brush" => "painted map".into(),
        other => other.replace('-', " "),
    };
    if let Some(first) = text.get_mut(0..1) {
        first.make_ascii_uppercase();
    }
    text
}

/// The icon of a kind.
pub fn symbol(kind: &str) -> &'static str {
    match kind {
        "peel" | "surface-peel" | "strip" => icon::ORANGE_SLICE,
        "knife" | "retractor" => icon::KNIFE,
        "wedge" => icon::CHART_PIE_SLICE,
        "box" | "lift" => icon::CUBE,
        "half-space" => icon::DIVIDE,
        "sphere" | "view-sphere" => icon::SPHERE,
        "cylinder" | "view-cone" => icon::CYLINDER,
        "lasso" => icon::LASSO,
        "pull" | "spline-pull" => icon::HAND_GRABBING,
        "twist" => icon::TORNADO,
        "wave" | "planar-wave" => icon::WAVE_SINE,
        "slab" => icon::STACK,
        "explode" | "explode-labels" => icon::ARROWS_OUT,
        "seam" | "book" => icon::BOOK_OPEN,
        "points" | "lattice" | "elastic" => icon::GRID_FOUR,
        "brush" => icon::PAINT_BRUSH,
        "field" | "map" => icon::WAVES,
        _ => icon::SPIRAL,
    }
}

/// How a kind is placed on a surface: orientation and depth relative to its extents.
struct Template {
    /// Fractions of the scene's extents, if a size other than the kind's default suits placement on
    /// a surface.
    share: Option<[f32; 3]>,
    /// Depth of the centre below the surface, as a fraction of the extent along z.
    depth: f32,
    /// Whether z is aligned with the normal.
    turns: bool,
}

fn template(kind: &Kind) -> Template {
    let on = |share: [f32; 3], depth: f32| Template {
        share: Some(share),
        depth,
        turns: true,
    };
    match kind.name {
        // The peeled layer lies low in the box, with its outer side on the surface.
        "peel" => on([0.62, 0.55, 0.45], -0.07),
        "surface-peel" | "strip" => on([0.5, 0.42, 0.6], 0.15),
        "knife" | "retractor" => on([0.45, 0.45, 0.4], 0.32),
        "pull" | "spline-pull" => on([0.5, 0.5, 0.5], 0.2),
        "bulge" => on([0.4, 0.4, 0.4], 0.25),
        "box" | "sphere" => on([0.35, 0.35, 0.35], 0.15),
        "cylinder" => on([0.3, 0.3, 0.5], 0.25),
        "lift" | "offset" => on([0.5, 0.5, 0.6], 0.1),
        "half-space" => Template {
            share: None,
            depth: 0.0,
            turns: true,
        },
        "wave" | "planar-wave" => on([0.5, 0.5, 0.4], 0.2),
        "elastic" => on([0.6, 0.6, 0.6], 0.25),
        // Kinds that affect the whole scene stay about its centre.
        _ => Template {
            share: None,
            depth: 0.0,
            turns: false,
        },
    }
}

/// Rotation angles about x, then y, then z, degrees, of the matrix `m`.
pub fn angles_of(m: Mat3) -> Vec3 {
    let (z, y, x) = Quat::from_mat3(&m).to_euler(EulerRot::ZYX);
    Vec3::new(x.to_degrees(), y.to_degrees(), z.to_degrees())
}

/// The matrix of rotations about x, then y, then z, degrees.
pub fn matrix_of(degrees: Vec3) -> Mat3 {
    let r = degrees * (std::f32::consts::PI / 180.0);
    Mat3::from_rotation_z(r.z) * Mat3::from_rotation_y(r.y) * Mat3::from_rotation_x(r.x)
}

/// Rounded to a precision that suffices for a length in mm or an angle.
pub fn tidy(v: Vec3) -> [f32; 3] {
    v.to_array().map(|x| (x * 100.0).round() / 100.0)
}

/// A deformation of a kind placed at a drop: on a surface point with its normal, or (if `None`)
/// about the centre of the scene. A kind that opens does so towards `viewer`, a direction in the
/// world.
pub fn dropped(
    kind: &'static Kind,
    scene_box: &Bounds,
    at: Option<(Vec3, Vec3)>,
    viewer: Vec3,
) -> Deformation {
    let template = template(kind);
    let mut deformation = Deformation::new(kind.name);
    let size = template.share.map_or_else(
        || kind.default_size(scene_box),
        |s| scene_box.size() * Vec3::from(s),
    );
    let across = matches!(kind.size, DefaultSize::Across(_));
    let mut center = scene_box.center();
    if let Some((point, normal)) = at {
        if template.turns {
            // A flap's hinge lies at -x: away from the viewer.
            let across = viewer - normal * viewer.dot(normal);
            let x = if across.length() > 1e-3 {
                across.normalize()
            } else {
                normal.any_orthonormal_vector()
            };
            let turn = Mat3::from_cols(x, normal.cross(x), normal);
            deformation.rotate = Some(tidy(angles_of(turn)));
            center = point - normal * (template.depth * size.z);
        } else if kind.shape.is_some() {
            center = point;
        }
    }
    deformation.center = Some(tidy(center));
    if matches!(
        kind.name,
        "peel" | "surface-peel" | "strip" | "knife" | "retractor" | "seam" | "book"
    ) {
        // Half open, to be adjusted with its handle.
        deformation.progress = Some(0.5);
    }
    if !across {
        deformation.size = Some(Size::Box(tidy(size)));
    }
    let bounds = Bounds::new(center - size / 2.0, center + size / 2.0);
    deformation.parameters = kind.example(&bounds);
    if kind.name == "peel" {
        // As thick as the box allows: the surface is curved, and the peeled part is a cap of it.
        deformation
            .parameters
            .insert("depth", tidy(Vec3::splat(0.35 * size.z))[0]);
        deformation
            .parameters
            .insert("radius", tidy(Vec3::splat(0.43 * size.z))[0]);
    }
    deformation
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::kinds;

    #[test]
    fn angles_and_matrices_are_inverse() {
        for degrees in [
            Vec3::new(10.0, 20.0, 30.0),
            Vec3::new(-80.0, 45.0, 170.0),
            Vec3::ZERO,
        ] {
            let m = matrix_of(degrees);
            assert!(matrix_of(angles_of(m)).abs_diff_eq(m, 1e-5), "{degrees}");
        }
    }

    /// The box's z axis is the surface normal, and the point lies inside the box.
    #[test]
    fn templates_lie_on_the_surface() {
        let scene_box = Bounds::new(Vec3::splat(-100.0), Vec3::splat(100.0));
        for normal in [
            Vec3::X,
            Vec3::Y,
            Vec3::Z,
            Vec3::NEG_Z,
            Vec3::new(0.6, -0.48, 0.64),
        ] {
            for name in ["peel", "knife", "pull", "box", "half-space", "elastic"] {
                let point = normal * 80.0;
                let viewer = Vec3::new(0.3, -0.9, 0.2);
                let d = dropped(
                    kinds::kind(name).unwrap(),
                    &scene_box,
                    Some((point, normal)),
                    viewer,
                );
                let turn = matrix_of(Vec3::from(d.rotate.unwrap()));
                assert!((turn * Vec3::Z).abs_diff_eq(normal, 1e-3), "{name} {normal}");
                assert!(
                    (turn * Vec3::X).dot(viewer) > -1e-3,
                    "{name} {normal}: the hinge is nearer than the free end"
                );
                if let Some(size) = d.size {
                    let local = turn.transpose() * (point - Vec3::from(d.center.unwrap()));
                    assert!(
                        local.abs().cmple(size.xyz() / 2.0).all(),
                        "{name} {normal} {local}"
                    );
                }
            }
        }
    }
}
