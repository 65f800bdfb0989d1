//! The tools for clicks and drags in a view.

use crate::deform::kinds::{DefaultSize, Kind};
use crate::math::Bounds;
use crate::scene::measure::MeasureKind;
pub use crate::scene::placement::{angles_of, matrix_of, tidy};
use crate::scene::{Deformation, Size, VisibleObject};
use egui_phosphor::regular as icon;
use glam::Vec3;

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

/// A deformation of a kind placed on a visible object, at the object's point. Kinds whose settings
/// state positions in the world lie about the centre of the scene.
pub fn dropped(kind: &'static Kind, scene_box: &Bounds, object: &VisibleObject) -> Deformation {
    let mut deformation = Deformation::new(kind.name);
    deformation.place(kind, object);
    let across = matches!(kind.size, DefaultSize::Across(_));
    let center = *deformation.center.get_or_insert_with(|| tidy(scene_box.center()));
    if !across {
        let size = kind.default_size(scene_box);
        deformation.size.get_or_insert(Size::Box(tidy(size)));
    }
    if matches!(
        kind.name,
        "peel" | "surface-peel" | "strip" | "knife" | "retractor" | "seam" | "book"
    ) {
        // Half open, to be adjusted with its handle.
        deformation.progress = Some(0.5);
    }
    let half = deformation
        .size
        .map_or_else(|| kind.default_size(scene_box), Size::xyz)
        / 2.0;
    let center = Vec3::from(center);
    let example = kind.example(&Bounds::new(center - half, center + half));
    deformation.parameters.0.extend(example.0);
    deformation
}
