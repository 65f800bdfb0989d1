//! Explains why a picture is empty. An empty picture is valid but never intended: one sentence
//! states the problem and the remedy.
//!
//! The scene is tested at the points of a grid over it: whether a point is left by the cuts,
//! whether it would be visible, whether it is in view. The first test that fails at every point is
//! the reason.

use super::prepared::Prepared;
use crate::deform::StackAndCuts;
use crate::math::Bounds;
use crate::picture::{Picture, RenderStats, Rendered, StageTimes};
use crate::scene::{Mode, Projection};
use glam::Vec3;
use rayon::prelude::*;

/// Points along each axis of the grid.
const POINTS: usize = 40;

/// The combined tests of some points of the grid.
#[derive(Clone, Copy, Default)]
struct PointVisibility {
    /// Something would be visible without deformations and cuts.
    visible_before: bool,
    /// Something is left by the deformations and cuts.
    left: bool,
    /// Something is left and would be visible.
    visible: bool,
    /// Something visible is in view.
    in_view: bool,
}

impl PointVisibility {
    fn or(self, o: Self) -> Self {
        Self {
            visible_before: self.visible_before || o.visible_before,
            left: self.left || o.left,
            visible: self.visible || o.visible,
            in_view: self.in_view || o.in_view,
        }
    }
}

impl Prepared<'_> {
    /// A picture of the scene with notices for the user: from the renderer, from resolving the
    /// scene, and why the picture is blank.
    pub fn rendered(
        &self,
        picture: Picture,
        stats: Option<RenderStats>,
        stages: StageTimes,
        mut notices: Vec<String>,
    ) -> Rendered {
        let blank = self.why_blank(&picture);
        notices.extend(self.notices.iter().chain(&blank).cloned());
        Rendered {
            picture,
            stats,
            stages,
            notices,
            blank,
        }
    }

    /// Why a picture of the scene is blank, and the remedy; none if it is not blank.
    fn why_blank(&self, picture: &Picture) -> Option<String> {
        if !picture.is_blank() {
            return None;
        }
        let shows_volume = self.shows_volume();
        if !shows_volume && self.surfaces.objects.is_empty() {
            return Some("the picture is empty: every surface is hidden; show one".into());
        }
        if let Some(problem) = self.surfaces_without_inside() {
            return Some(problem);
        }
        if shows_volume && self.volume().has_no_values && self.surfaces.objects.is_empty() {
            return Some(
                "the picture is empty: no voxel of the volume is a finite number; check the file".into(),
            );
        }
        let found = self.search(shows_volume);
        let reason = if !found.visible_before && shows_volume {
            self.why_invisible()
        } else if !found.left {
            "everything is cut away; make the cuts smaller, move them, or switch one off".to_owned()
        } else if !found.visible {
            "everything visible is cut away; make the cuts smaller, move them, or switch one off".to_owned()
        } else if !found.in_view {
            "nothing of the scene is in view; reset camera.target, or lower camera.zoom".to_owned()
        } else if shows_volume && self.volume().iso.is_none() {
            let factors = if self.uses_gradient_opacity() {
                " and the factors of transfer.gradient_opacity"
            } else {
                ""
            };
            let step = if self.settings.step > 1.0 {
                ", reduce render.step"
            } else {
                ""
            };
            format!(
                "everything in view is too transparent or too small to be seen; raise the opacity (transfer.density){factors}, adjust the window{step}, or zoom in"
            )
        } else {
            "everything in view is too small to be seen; zoom in, or reduce render.step".to_owned()
        };
        Some(format!("the picture is empty: {reason}"))
    }

    /// Whether the volume is shown, rather than surfaces alone.
    pub fn shows_volume(&self) -> bool {
        self.volume().is_present && self.settings.mode != Mode::Surface
    }

    /// The first surface, if every surface encloses nothing.
    fn surfaces_without_inside(&self) -> Option<String> {
        let empty = |o: &super::objects::SurfaceObject| {
            o.triangles.is_none()
                && o.implicit
                    .as_ref()
                    .is_some_and(|i| !points_over(&i.bounds()).any(|p| i.value(p) > 0.0))
        };
        let first = self
            .surfaces
            .objects
            .first()
            .filter(|_| self.surfaces.objects.iter().all(empty) && !self.shows_volume())?;
        Some(format!(
            "the picture is empty: {} has no interior (a subtracted shape covers it, intersected shapes do not overlap, or the volume has no such value); change it",
            first.name
        ))
    }

    /// Why nothing of the volume is visible, even without deformations.
    fn why_invisible(&self) -> String {
        let [low, high] = self.volume().value_range;
        let range = format!("the volume's values range from {low} to {high}");
        if let Some(iso) = self.settings.iso {
            return format!("the volume has no surface at {iso} (iso): {range}; choose a value between them");
        }
        if self.density == Some(0.0) {
            return "transfer.density is 0, which makes everything transparent; raise it".into();
        }
        format!(
            "the transfer function makes every value of the volume transparent ({range}); set window and level to this range, or choose another preset"
        )
    }

    /// Tests the points of a grid.
    fn search(&self, shows_volume: bool) -> PointVisibility {
        let mut found = PointVisibility::default();
        if shows_volume {
            let voxel_box = Bounds::new(Vec3::splat(-0.5), self.volume().grid_size - 0.5);
            let undeformed = voxel_box.transformed(&self.volume().voxel_from_world.inverse());
            let value = |source: Vec3| -> Option<f32> {
                let v = self.volume().voxel_from_world.transform_point3(source);
                let inside = v.cmpge(voxel_box.min).all() && v.cmple(voxel_box.max).all();
                inside.then(|| self.volume().grid.value_near(v))
            };
            let shows = |v: f32| match self.volume().iso {
                Some(iso) => v >= iso,
                None => self.volume().table.lookup(v)[3] > 0.0,
            };
            // Every voxel counts for what could be visible at all: a thin sheet may lie between the
            // points.
            let visible_before = self.volume().iso.is_some_and(|iso| (0.0..=1.0).contains(&iso))
                || self.volume().iso.is_none() && self.shows_any_value();
            found = self.of_points(&self.stack.deformed_bounds(&undeformed), |source| {
                value(source).map(shows)
            });
            found.visible_before = visible_before;
        }
        for object in &self.surfaces.objects {
            let inside = |source: Vec3| match (&object.implicit, &object.triangles) {
                (Some(implicit), _) => (implicit.value(source) > -object.cell_mm).then_some(true),
                (None, Some(t)) => Some(
                    t.mesh
                        .bounds()
                        .grown(object.cell_mm)
                        .contains(&Bounds::new(source, source)),
                ),
                (None, None) => None,
            };
            let bounds = match (&object.implicit, &object.triangles) {
                (Some(implicit), _) => implicit.bounds(),
                (None, Some(t)) => t.mesh.bounds(),
                (None, None) => continue,
            };
            let more = if object.rigid || object.implicit.is_none() {
                let all = points_over(&bounds)
                    .filter(|p| inside(*p) == Some(true))
                    .map(|p| PointVisibility {
                        left: true,
                        visible: true,
                        in_view: self.is_in_view(p),
                        visible_before: true,
                    });
                all.fold(PointVisibility::default(), PointVisibility::or)
            } else {
                PointVisibility {
                    visible_before: true,
                    ..self.of_points(&self.stack.deformed_bounds(&bounds), inside)
                }
            };
            found = found.or(more);
        }
        found
    }

    /// The combined tests of the points of a box of the deformed scene; `shows` returns whether a
    /// source point is visible, none where nothing is present.
    fn of_points(&self, deformed: &Bounds, shows: impl Fn(Vec3) -> Option<bool> + Sync) -> PointVisibility {
        let points: Vec<Vec3> = points_over(deformed).collect();
        let deformation = StackAndCuts {
            stack: &self.stack,
            cuts: &self.cuts,
        };
        let of_point = |p: &Vec3| {
            let shown = deformation.source(*p).and_then(&shows);
            let visible = shown == Some(true);
            PointVisibility {
                visible_before: false,
                left: shown.is_some(),
                visible,
                in_view: visible && self.is_in_view(*p),
            }
        };
        points
            .par_iter()
            .map(of_point)
            .reduce(PointVisibility::default, PointVisibility::or)
    }

    /// Whether the transfer function shows any value that the volume has.
    fn shows_any_value(&self) -> bool {
        self.volume().table.max_depth(0.0, 1.0) > 0.0
    }

    /// Whether a point lies in the picture.
    fn is_in_view(&self, p: Vec3) -> bool {
        let view = &self.frame.view;
        let d = p - view.eye;
        let depth = d.dot(view.forward);
        let scale = if view.projection == Projection::Perspective {
            depth
        } else {
            1.0
        };
        let across = [view.right, view.up].map(|axis| (d.dot(axis) / axis.length_squared() / scale).abs());
        (depth > 0.0 || view.projection == Projection::Orthographic) && across.iter().all(|a| *a <= 1.0)
    }
}

/// Points of a grid over a box, without its faces.
fn points_over(bounds: &Bounds) -> impl Iterator<Item = Vec3> + use<> {
    let (low, step) = (bounds.min, bounds.size() / POINTS as f32);
    (0..POINTS * POINTS * POINTS).map(move |n| {
        low + (Vec3::new(
            (n % POINTS) as f32,
            (n / POINTS % POINTS) as f32,
            (n / (POINTS * POINTS)) as f32,
        ) + 0.5)
            * step
    })
}
