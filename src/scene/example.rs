//! An example scene for one kind of deformation, for galleries and thumbnails.

use super::{Deformation, Scene, Size, View};
use crate::deform::kinds::Kind;
use crate::math::Bounds;
use glam::Vec3;

/// Placement that shows a kind well: centre (offset from the volume's centre) and size as fractions
/// of the volume's extent; rotation in degrees.
type ExamplePlacement = ([f32; 3], [f32; 3], [f32; 3]);

/// On top, slightly to the front and left, facing the camera.
const ON_TOP: ExamplePlacement = ([0.05, -0.05, 0.38], [0.75, 0.6, 0.5], [0.0, 0.0, 0.0]);
const CORNER: ExamplePlacement = ([0.25, -0.28, 0.28], [0.5, 0.5, 0.5], [0.0, 0.0, 0.0]);

fn place(kind: &str) -> Option<ExamplePlacement> {
    Some(match kind {
        "pull" | "spline-pull" => ([0.0, 0.0, 0.25], [0.7, 0.7, 0.7], [0.0; 3]),
        "peel" => ON_TOP,
        "knife" | "retractor" => ([0.12, -0.12, 0.18], [0.75, 0.6, 0.5], [10.0, 20.0, 30.0]),
        "seam" => ([0.0, 0.0, 0.12], [1.2, 0.8, 0.8], [0.0, 0.0, 30.0]),
        "bulge" => CORNER,
        "box" | "sphere" | "view-sphere" => CORNER,
        "cylinder" => ([0.2, -0.2, 0.1], [0.4, 0.4, 1.2], [0.0; 3]),
        "wedge" => ([0.0, 0.0, 0.3], [1.3, 1.3, 0.8], [0.0, 0.0, -55.0]),
        "elastic" => ([0.1, -0.1, 0.2], [0.8, 0.8, 0.8], [0.0; 3]),
        "lattice" => ([0.0, 0.0, 0.25], [1.1, 1.1, 1.1], [0.0; 3]),
        "strip" => ([0.2, -0.2, 0.25], [0.8, 0.8, 0.7], [0.0; 3]),
        _ => return None,
    })
}

/// The example scene of a kind: its defaults, at full progress, in view of the camera.
pub fn of_kind(kind: &Kind, volume: &str, edge: u32, bounds: &Bounds) -> Scene {
    let mut scene = Scene::of_volume(volume);
    scene.render.size = [edge, edge];
    scene.camera.view = View {
        azimuth_deg: 35.0,
        elevation_deg: 30.0,
    };
    let mut deformation = Deformation::new(kind.name);
    let (mut center, mut size) = (bounds.center(), kind.default_size(bounds));
    if let Some((at, extent, rotate)) = place(kind.name) {
        center += bounds.size() * Vec3::from(at);
        size = bounds.size() * Vec3::from(extent);
        deformation.center = Some(center.into());
        deformation.size = Some(Size::Box(size.into()));
        deformation.rotate = Some(rotate);
    }
    deformation.parameters = kind.example(&Bounds::new(center - size / 2.0, center + size / 2.0));
    scene.deformation.push(deformation);
    if kind.name == "lift" {
        // The lifted layer hides the surface below it; a wedge exposes it.
        let mut wedge = Deformation::new("wedge");
        wedge.size = Some(Size::Box((bounds.size() * 2.0).into()));
        wedge.rotate = Some([0.0, 0.0, -55.0]);
        scene.deformation.push(wedge);
    }
    scene
}
