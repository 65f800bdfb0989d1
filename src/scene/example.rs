//! An example scene for one kind of deformation, for galleries and thumbnails.

use super::{Deformation, Scene, Size, View};
use crate::deform::kinds::Kind;
use crate::math::Bounds;
use glam::Vec3;

/// Centre (offset from the volume's centre) and size, as fractions of the volume's extent, of the
/// kinds whose example states positions or control points.
fn place(kind: &str) -> Option<[[f32; 3]; 2]> {
    Some(match kind {
        "elastic" => [[0.1, -0.1, 0.2], [0.8, 0.8, 0.8]],
        "lattice" => [[0.0, 0.0, 0.25], [1.1, 1.1, 1.1]],
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
    if let Some([at, extent]) = place(kind.name) {
        center += bounds.size() * Vec3::from(at);
        size = bounds.size() * Vec3::from(extent);
        deformation.center = Some(center.into());
        deformation.size = Some(Size::Box(size.into()));
    }
    deformation.parameters = kind.example(&Bounds::new(center - size / 2.0, center + size / 2.0));
    scene.deformation.push(deformation);
    if kind.name == "lift" {
        // The lifted layer hides the surface below it; a wedge exposes its section.
        let mut wedge = Deformation::new("wedge");
        wedge.center = Some(bounds.center().into());
        wedge.size = Some(Size::Box((bounds.size() * 2.0).into()));
        wedge.rotate = Some([0.0, 0.0, -10.0]);
        scene.deformation.push(wedge);
    }
    scene
}
