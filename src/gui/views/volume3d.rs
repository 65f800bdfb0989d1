//! The 3D view: picture, camera, handles, tools.
//!
//! The view always shows the newest picture available: a coarse one during interaction, a fine one
//! at rest. The resolution of coarse pictures follows the time of the previous ones. Overlays and
//! clicks refer to the displayed picture ([`super::shown`]).

use super::shown;
use super::{cube, edge_letters, scale_bar, text};
use crate::engine::Quality;
use crate::gui::gizmos::{self, Gizmo, Handle, Mode as GizmoMode};
use crate::gui::projector::Projector;
use crate::gui::state::document::Selection;
use crate::gui::state::shown::{DisplayedPicture, PictureRequest};
use crate::gui::state::tool::{Placed, Tool};
use crate::gui::state::view::*;
use crate::gui::state::worker::{Job, JobKind, JobTarget, ProbePurpose, ProbeRequest};
use crate::gui::state::{Gesture, Workstation};
use crate::gui::theme::{CANVAS, ON_CANVAS, SELECTED};
use crate::math::Bounds;
use crate::scene::{Camera, Deformation, Projection, Scene};
use eframe::egui::{self, Align2, Color32, CursorIcon, Painter, PointerButton, Pos2, Rect, Response, Sense, Shape, Stroke, Ui, pos2, vec2};
use glam::{Vec2, Vec3};
use std::sync::Arc;
use std::time::Instant;

/// A fine picture is requested after this time without a change, seconds.
const REST: f64 = 0.12;
/// Rotation of the camera per point of a drag, degrees.
const ORBIT: f32 = 0.4;

impl Workstation {
    /// The scene as the 3D view shows it, at the view's size.
    pub fn scene_of_view(&self) -> Option<Scene> {
        let doc = self.doc.as_ref()?;
        let mut scene = doc.shown(self.shows_undeformed());
        scene.render.size = self.view.size();
        Some(scene)
    }

    /// The projector for the displayed picture's camera.
    pub fn projector(&self) -> Option<Projector> {
        Some(self.view.picture()?.projector(self.view.rect, self.view.size()))
    }

    /// Requests new pictures after a change.
    pub fn refresh_view(&mut self, ctx: &egui::Context) {
        let Some(doc) = &self.doc else { return };
        if self.view.rect.width() < 8.0 || self.view.rect.height() < 8.0 {
            return;
        }
        let assets = doc.assets.clone();
        let Some(scene) = self.scene_of_view() else { return };
        let wanted = PictureRequest { scene: Arc::new(scene), assets: assets.clone(), undeformed: self.shows_undeformed() };
        let wanted = match &self.view.requested {
            Some(requested) if requested.is(&wanted) => requested.clone(),
            _ => {
                self.changed(&wanted);
                wanted
            }
        };
        let current = self.view.is_current();
        self.view.delay.note(current && self.view.delay.failure.is_none());
        let waits = !self.view.is_fine && self.view.fine_serial.is_none() && self.view.delay.failure.is_none();
        let rested = self.view.changed_at.elapsed().as_secs_f64() >= REST;
        let at_once = self.view.fine_ms <= COARSE_MS;
        let held = ctx.input(|i| i.pointer.any_down()) && !at_once;
        if waits && !held && (at_once || (rested && !self.view.coarse_open)) {
            let serial = self.submit(
                JobTarget::Fine,
                wanted.scene.clone(),
                assets,
                JobKind::Picture { counting: false, with_pixels: false, quality: Quality::Full },
            );
            self.view.fine_serial = Some(serial);
            self.view.open.push((serial, wanted));
        } else if waits {
            ctx.request_repaint_after_secs(REST as f32);
        }
    }

    /// Handles a change of the picture to show.
    fn changed(&mut self, wanted: &PictureRequest) {
        self.view.requested = Some(wanted.clone());
        self.view.delay.failure = None;
        self.view.changed_at = Instant::now();
        self.view.is_fine = false;
        self.view.fine_serial = None;
        self.worker.drop_jobs(|t| t == JobTarget::Fine);
        // If fine pictures are fast enough, coarse ones are not needed.
        if self.view.fine_ms > COARSE_MS {
            let quality = Quality::Draft { scale: self.view.scale };
            self.view.coarse_open = true;
            let serial = self.submit(
                JobTarget::Coarse,
                wanted.scene.clone(),
                wanted.assets.clone(),
                JobKind::Picture { counting: false, with_pixels: false, quality },
            );
            self.view.open.push((serial, wanted.clone()));
        }
    }

    /// Submits a job to the worker; returns its number.
    pub fn submit(&mut self, target: JobTarget, scene: Arc<Scene>, assets: Arc<crate::prepare::Assets>, what: JobKind) -> u64 {
        self.serial += 1;
        self.worker.submit(Job { target, serial: self.serial, scene, assets, what });
        self.serial
    }

    /// Requests the point under a position of the view.
    pub fn ask(&mut self, at: [f32; 2], purpose: ProbePurpose) {
        let Some(picture) = &self.view.picture else { return };
        let PictureRequest { scene, assets, .. } = picture.of.clone();
        // A stroke is drawn on the scene as it was when the stroke began.
        let scene = match (&purpose, &self.stroke_scene) {
            (ProbePurpose::Brush { .. }, Some(frozen)) if frozen.camera == scene.camera => frozen.clone(),
            (ProbePurpose::Brush { .. }, Some(frozen)) => Arc::new(Scene { camera: scene.camera.clone(), ..(**frozen).clone() }),
            _ => scene,
        };
        self.prober.ask(ProbeRequest { scene, assets, at, purpose });
    }

    /// Shows the view.
    pub fn show_view3d(&mut self, ui: &mut Ui) {
        let (rect, response) = ui.allocate_exact_size(ui.available_size().max(vec2(16.0, 16.0)), Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, "3D view"));
        self.view.rect = rect;
        self.view.pixels_per_point = ui.ctx().pixels_per_point();
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 0.0, CANVAS);
        if self.doc.is_none() {
            return;
        }
        let Some(projector) = self.projector() else {
            self.view.delay.draw(&painter, rect, false);
            self.gizmo_bar(ui, rect);
            return;
        };
        let pointer = response.hover_pos().filter(|p| rect.contains(*p));
        let mut on_cube = None;
        if let Some(picture) = &self.view.picture {
            if picture.of.scene.render.background[3] < 1.0 {
                checkerboard(&painter, rect);
            }
            shown::image(&painter, &picture.texture, projector.rect);
            on_cube = cube::draw(&painter, rect, &projector, pointer.filter(|_| self.gesture.is_none()));
            edge_letters(&painter, rect, projector.frame.right.normalize_or_zero(), projector.frame.up.normalize_or_zero());
            let target = picture.of.scene.camera.target.map_or_else(|| picture.of.assets.scene_box().center(), Vec3::from);
            scale_bar(&painter, rect, projector.mm_per_point(target));
            self.draw_measures(&painter, &projector, picture);
        }
        let hot = self.draw_gizmo(&painter, &projector, pointer);
        if let (Some(why), None) = (&self.view.facts.blank, self.view.delay.words(true)) {
            shown::draw_message(&painter, rect, why);
        }
        self.view.delay.draw(&painter, rect, true);
        self.draw_progress(&painter, rect);
        self.draw_hint(&painter, rect);
        if !self.view.lasso.is_empty() {
            let mut points = self.view.lasso.clone();
            points.extend(self.view.lasso.first().copied());
            painter.add(Shape::line(points.clone(), Stroke::new(4.0, Color32::from_black_alpha(160))));
            painter.add(Shape::line(points, Stroke::new(1.8, SELECTED)));
        }
        self.gizmo_bar(ui, rect);
        if let Some(view) = on_cube.filter(|_| response.clicked()) {
            self.look_from(view);
            return;
        }
        self.drop_on_view(&response, &projector);
        self.handle_view_input(ui, &response, &projector, hot);
    }

    /// Handles a kind that was dragged from the palette and dropped on the view.
    fn drop_on_view(&mut self, response: &Response, projector: &Projector) {
        if let Some(kind) = response.dnd_release_payload::<Placed>()
            && let Some(pos) = response.ctx.pointer_latest_pos()
        {
            self.tool = Tool::Place(*kind);
            self.ask(projector.at(pos), ProbePurpose::Tool);
        }
    }

    fn handle_view_input(&mut self, ui: &Ui, response: &Response, projector: &Projector, hot: Option<Handle>) {
        let pos = response.interact_pointer_pos().or_else(|| response.hover_pos());
        let modifiers = ui.input(|i| i.modifiers);
        if response.hovered() {
            let scroll = ui.input(|i| i.smooth_scroll_delta.y + 300.0 * (i.zoom_delta() - 1.0));
            if scroll != 0.0 {
                self.zoom((scroll * 0.0025).exp());
            }
            let cursor = match self.tool {
                _ if hot.is_some() => CursorIcon::Grab,
                Tool::Navigate => CursorIcon::Default,
                _ => CursorIcon::Crosshair,
            };
            ui.ctx().set_cursor_icon(cursor);
            self.request_hover(projector, response.hover_pos());
        }
        if response.double_clicked() && self.tool == Tool::Navigate && hot.is_none() {
            if let Some(pos) = pos {
                self.ask(projector.at(pos), ProbePurpose::Center);
            }
            return;
        }
        if self.gesture.is_some() && !matches!(self.gesture, Some(Gesture::Zoom)) && ui.input(|i| i.pointer.button_pressed(PointerButton::Secondary))
        {
            self.escape();
            return;
        }
        for button in [PointerButton::Primary, PointerButton::Middle, PointerButton::Secondary] {
            if response.drag_started_by(button)
                && let Some(origin) = ui.input(|i| i.pointer.press_origin())
            {
                let windowing = ui.input(|i| i.key_down(egui::Key::W)) && button == PointerButton::Primary;
                if windowing {
                    // The key that armed the wedge tool is being held for windowing.
                    self.tool = Tool::Navigate;
                    self.gesture = Some(Gesture::Window3d);
                } else {
                    self.begin_drag(button, modifiers, origin, projector);
                }
            }
        }
        if response.clicked()
            && let Some(pos) = pos
        {
            self.click(pos, modifiers, projector);
        }
        let Some(pos) = pos else { return };
        let delta = response.drag_delta();
        match self.gesture.clone() {
            Some(Gesture::Orbit) => self.orbit(delta.x, delta.y),
            Some(Gesture::Pan) => self.pan(delta.x, delta.y, self.view.rect),
            Some(Gesture::Zoom) => self.zoom((-delta.y * 0.01).exp()),
            Some(Gesture::Roll) => {
                let center = projector.rect.center();
                let (a, b) = ((pos - delta) - center, pos - center);
                let turned = b.angle() - a.angle();
                if let Some(doc) = &mut self.doc {
                    let wrapped = (turned + std::f32::consts::PI).rem_euclid(std::f32::consts::TAU) - std::f32::consts::PI;
                    doc.scene.camera.roll = wrap(doc.scene.camera.roll + wrapped.to_degrees());
                }
            }
            Some(Gesture::Gizmo(drag)) => {
                if let Some(moved) = self.gizmo(projector).and_then(|g| g.dragged(&drag, pos))
                    && let Some(d) = self.doc.as_mut().and_then(super::super::state::document::Document::deformation)
                {
                    self.view.dragged = Some(moved.clone());
                    *d = moved;
                }
            }
            Some(Gesture::Window3d) => self.drag_transfer(delta.x, delta.y),
            Some(Gesture::Lasso) if self.view.lasso.last().is_none_or(|l| l.distance(pos) > 3.0) => self.view.lasso.push(pos),
            Some(Gesture::Brush) if delta.length() > 0.0 && self.prober.open < 2 => self.ask(projector.at(pos), ProbePurpose::Brush { last: false }),
            _ => {}
        }
        if response.drag_stopped() {
            match self.gesture.take() {
                Some(Gesture::Lasso) => self.finish_lasso(),
                Some(Gesture::Brush) => self.ask(projector.at(pos), ProbePurpose::Brush { last: true }),
                _ => {}
            }
        }
    }

    fn begin_drag(&mut self, button: PointerButton, modifiers: egui::Modifiers, origin: Pos2, projector: &Projector) {
        let left = button == PointerButton::Primary;
        let plain = !modifiers.any();
        if left && plain {
            // The handle at the position of the press: a fast drag has moved on by the time it is
            // recognised.
            let grabbed = self.tool == Tool::Navigate && !self.shows_undeformed();
            if let Some((gizmo, handle)) = self.gizmo(projector).filter(|_| grabbed).and_then(|g| g.under(origin).map(|h| (g, h))) {
                // If the deformation has changed since the picture was rendered, the handle is not
                // where it is drawn.
                if self.is_as_shown(gizmo.deformation) {
                    self.gesture = Some(Gesture::Gizmo(Box::new(gizmo.grab(handle, origin))));
                }
                return;
            }
            if self.tool.is_lasso() {
                self.view.lasso = vec![origin];
                self.view.lasso_on = Some(*projector);
                self.gesture = Some(Gesture::Lasso);
                return;
            }
            if self.tool.brush().is_some() {
                self.begin_stroke();
                self.ask(projector.at(origin), ProbePurpose::Brush { last: false });
                self.gesture = Some(Gesture::Brush);
                return;
            }
        }
        let blender = self.session.settings.blender;
        self.gesture = Some(match button {
            PointerButton::Middle if blender && plain => Gesture::Orbit,
            PointerButton::Middle if blender && modifiers.command => Gesture::Zoom,
            PointerButton::Middle => Gesture::Pan,
            PointerButton::Secondary => Gesture::Zoom,
            _ if modifiers.command => Gesture::Roll,
            _ if modifiers.shift => Gesture::Pan,
            _ => Gesture::Orbit,
        });
    }

    fn click(&mut self, pos: Pos2, modifiers: egui::Modifiers, projector: &Projector) {
        match self.tool {
            Tool::Navigate => {
                // With control points selected, Ctrl+click adds one on the surface.
                let points = self.doc.as_mut().and_then(|d| d.deformation().map(|x| x.kind == "points")).unwrap_or(false);
                if modifiers.command && points {
                    self.ask(projector.at(pos), ProbePurpose::Tool);
                }
            }
            Tool::LassoCut | Tool::LassoRestore => {}
            _ if self.tool.brush().is_some() => {
                self.begin_stroke();
                self.ask(projector.at(pos), ProbePurpose::Brush { last: true });
            }
            _ => self.ask(projector.at(pos), ProbePurpose::Tool),
        }
    }

    fn request_hover(&mut self, projector: &Projector, pos: Option<Pos2>) {
        let Some(pos) = pos else { return };
        // At most one request at a time, and none during a drag.
        if self.gesture.is_some() || self.prober.open > 0 {
            return;
        }
        let at = projector.at(pos);
        let requested = (at, self.view.pictures);
        if self.view.hover_requested != Some(requested) {
            self.view.hover_requested = Some(requested);
            self.ask(at, ProbePurpose::Hover);
        }
    }

    /// Rotates the camera by a drag.
    pub fn orbit(&mut self, dx: f32, dy: f32) {
        let Some(doc) = &mut self.doc else { return };
        let camera = &mut doc.scene.camera;
        let (sin, cos) = camera.roll.to_radians().sin_cos();
        let (dx, dy) = (dx * cos + dy * sin, dy * cos - dx * sin);
        camera.view.azimuth_deg = wrap(camera.view.azimuth_deg - dx * ORBIT);
        camera.view.elevation_deg = (camera.view.elevation_deg + dy * ORBIT).clamp(-90.0, 90.0);
    }

    /// Pans the camera by a drag in a view: the scene's camera, which the displayed picture may not
    /// match yet.
    pub fn pan(&mut self, dx: f32, dy: f32, rect: Rect) {
        let size = self.view.size();
        let Some(doc) = &mut self.doc else { return };
        let Ok(frame) = doc.scene.camera.frame(&doc.bounds(), size) else { return };
        let projector = Projector { frame, rect };
        let bounds = doc.bounds();
        let target = doc.scene.camera.target.map_or_else(|| bounds.center(), Vec3::from);
        let mm = projector.mm_per_point(target);
        let f = &projector.frame;
        let moved = target + (f.up.normalize_or_zero() * dy - f.right.normalize_or_zero() * dx) * mm;
        let reach = 4.0 * bounds.size().length();
        if (moved - bounds.center()).length() < reach {
            doc.scene.camera.target = Some(moved.into());
        }
    }

    /// Zooms the camera.
    pub fn zoom(&mut self, factor: f32) {
        if let Some(doc) = &mut self.doc {
            doc.scene.camera.zoom = (doc.scene.camera.zoom * factor).clamp(0.05, 100.0);
        }
    }

    /// Sets a named view direction.
    pub fn look_from(&mut self, view: &str) {
        if let (Some(doc), Ok(view)) = (&mut self.doc, view.parse()) {
            doc.scene.camera.view = view;
            doc.scene.camera.roll = 0.0;
        }
    }

    /// Fits a box into the view.
    pub fn frame_box(&mut self, bounds: &Bounds) {
        let Some(doc) = &mut self.doc else { return };
        let all = doc.bounds().size().length().max(1e-3);
        let camera = &mut doc.scene.camera;
        camera.target = Some(bounds.center().into());
        camera.zoom = (all / bounds.size().length().max(1e-3)).clamp(0.05, 20.0);
    }

    /// Resets the camera, keeping its projection.
    pub fn reset_camera(&mut self) {
        if let Some(doc) = &mut self.doc {
            let camera = &doc.scene.camera;
            doc.scene.camera = Camera { projection: camera.projection, field_of_view: camera.field_of_view, ..Camera::default() };
        }
    }

    /// The handles of the selected deformation as displayed. While dragged they follow the pointer,
    /// and after release they stay in place until the picture is up to date.
    fn gizmo(&self, projector: &Projector) -> Option<Gizmo<'_>> {
        let doc = self.doc.as_ref()?;
        let picture = self.view.picture.as_ref()?;
        let n = doc.deformation_index()?;
        let (own, seen) = (&doc.scene.deformation, &picture.of.scene.deformation);
        let let_go = self.view.delay.failure.is_none() && self.view.dragged.as_ref() == own.get(n);
        let deformation = match &self.gesture {
            Some(Gesture::Gizmo(_)) => own.get(n)?,
            _ if let_go => own.get(n)?,
            // Deformations added, removed or moved since then have other indices in the list.
            _ if own.len() == seen.len() && own.iter().zip(seen).all(|(a, b)| a.kind == b.kind) => seen.get(n)?,
            _ => return None,
        };
        let kind = gizmos::kind_of(deformation).filter(|k| k.name != "brush" && !k.locked_to_view)?;
        Some(Gizmo { projector: *projector, kind, deformation, scene_box: picture.of.assets.scene_box(), mode: self.view.gizmo })
    }

    /// Whether the selected deformation is unchanged since the displayed picture.
    fn is_as_shown(&self, seen: &Deformation) -> bool {
        let own = self.doc.as_ref().and_then(|d| d.scene.deformation.get(d.deformation_index()?));
        own.is_some_and(|own| *own == Deformation { enabled: own.enabled, ..seen.clone() })
    }

    /// Draws the selected deformation's handles; returns the one under the pointer.
    fn draw_gizmo(&self, painter: &Painter, projector: &Projector, pointer: Option<Pos2>) -> Option<Handle> {
        if self.shows_undeformed() || !matches!(self.tool, Tool::Navigate) {
            return None;
        }
        let dragged = match &self.gesture {
            Some(Gesture::Gizmo(drag)) => Some(drag.handle),
            _ => None,
        };
        let gizmo = self.gizmo(projector)?;
        let hot = dragged.or_else(|| pointer.filter(|_| self.gesture.is_none()).and_then(|p| gizmo.under(p)));
        gizmo.draw(painter, hot);
        hot
    }

    /// The selector for the kind of handles, in the lower left corner.
    fn gizmo_bar(&mut self, ui: &mut Ui, rect: Rect) {
        let shown = self.doc.as_ref().is_some_and(|d| d.deformation_index().is_some()) && self.tool == Tool::Navigate;
        if !shown {
            return;
        }
        let bar = Rect::from_min_size(pos2(rect.left() + 10.0, rect.bottom() - 34.0), vec2(260.0, 24.0));
        let mut child = ui.new_child(egui::UiBuilder::new().max_rect(bar).layout(egui::Layout::left_to_right(egui::Align::Center)));
        child.visuals_mut().widgets.inactive.weak_bg_fill = Color32::from_black_alpha(150);
        for (mode, word, tip) in [
            (GizmoMode::Shape, "Shape", "Handles for every parameter"),
            (GizmoMode::Move, "Move", "Arrows along the box's axes"),
            (GizmoMode::Rotate, "Rotate", "Rings about the box's axes"),
            (GizmoMode::Scale, "Scale", "The box's faces"),
        ] {
            let button = egui::Button::selectable(self.view.gizmo == mode, word).frame(true).frame_when_inactive(true);
            if child.add(button).on_hover_text(tip).clicked() {
                self.view.gizmo = mode;
            }
        }
    }

    fn draw_progress(&self, painter: &Painter, rect: Rect) {
        if let Some((JobTarget::Fine, share)) = self.worker.progress().filter(|_| !self.view.is_fine) {
            let bar = Rect::from_min_size(rect.min, vec2(rect.width() * share.clamp(0.0, 1.0), 2.0));
            painter.rect_filled(bar, 0.0, SELECTED);
        }
    }

    fn draw_hint(&self, painter: &Painter, rect: Rect) {
        let undeformed = self.view.picture.as_ref().is_some_and(|p| p.of.undeformed);
        let hint = if undeformed { "Undeformed".to_owned() } else { self.tool.hint() };
        if !hint.is_empty() {
            text(painter, pos2(rect.left() + 12.0, rect.top() + 10.0), Align2::LEFT_TOP, hint, 13.5, ON_CANVAS);
        }
    }

    fn draw_measures(&self, painter: &Painter, projector: &Projector, picture: &DisplayedPicture) {
        let selected = self.doc.as_ref().and_then(|d| match d.selected {
            Selection::Measure(n) => d.scene.measure.get(n),
            _ => None,
        });
        for measured in picture.measured.iter().flatten() {
            let points: Vec<Pos2> = measured.seen.iter().flatten().filter_map(|p| projector.screen(*p)).collect();
            let color = if selected == Some(&measured.measure) { SELECTED } else { Color32::from_rgb(250, 225, 120) };
            draw_points(painter, &points, color);
            let words = measured.quantities.as_ref().ok().and_then(|q| q.first()).and_then(|q| q.value.map(|v| crate::gui::text::number(v, q.unit)));
            if let (Some(last), Some(words)) = (points.last().filter(|_| points.len() == measured.measure.points.len()), words) {
                text(painter, *last + vec2(8.0, -8.0), Align2::LEFT_BOTTOM, words, 13.5, color);
            }
        }
        // Points of an incomplete measurement.
        let points: Vec<Pos2> = self.pending_points.iter().filter_map(|p| projector.screen(p.deformed)).collect();
        draw_points(painter, &points, SELECTED);
        let stroke: Vec<Pos2> = self.stroke_points.iter().filter_map(|p| projector.screen(*p)).collect();
        if stroke.len() > 1 {
            painter.add(Shape::line(stroke, Stroke::new(2.0, SELECTED)));
        }
    }

    /// Turns the drawn outline into a cut, or restores the region inside it.
    fn finish_lasso(&mut self) {
        let outline = std::mem::take(&mut self.view.lasso);
        let (Some(doc), Some(projector)) = (&self.doc, self.view.lasso_on.take()) else { return };
        if outline.len() < 3 || area(&outline) < 25.0 {
            return;
        }
        let frame = projector.frame;
        let middle = doc.bounds().center();
        let (right, up) = (frame.right.normalize_or_zero(), frame.up.normalize_or_zero());
        let points: Vec<Vec2> = outline
            .iter()
            .filter_map(|p| projector.on_plane(*p, middle, frame.forward))
            .map(|p| Vec2::new((p - middle).dot(right), (p - middle).dot(up)))
            .collect();
        let apex = match frame.projection {
            // The apex lies on the view line through the plane's origin, so the origin is moved
            // onto the eye's axis.
            Projection::Perspective => Some((middle - frame.eye).dot(frame.forward)),
            Projection::Orthographic => None,
        };
        let (origin, shift) = match apex {
            Some(depth) => {
                let origin = frame.eye + frame.forward * depth;
                (origin, Vec2::new((middle - origin).dot(right), (middle - origin).dot(up)))
            }
            None => (middle, Vec2::ZERO),
        };
        if points.len() < 3 || apex.is_some_and(|depth| depth <= 1.0) {
            self.report(crate::gui::state::log::LogLevel::Info, "The outline is behind the camera; reset the camera (R) and redraw it");
            return;
        }
        let restore = self.tool == Tool::LassoRestore;
        let points: Vec<Vec2> = points.into_iter().map(|p| p + shift).collect();
        self.lasso(restore, apex.unwrap_or(0.0), origin, right, up, points);
    }
}

fn wrap(degrees: f32) -> f32 {
    let wrapped = (degrees + 180.0).rem_euclid(360.0) - 180.0;
    if wrapped.is_finite() { wrapped } else { 0.0 }
}

/// Area of an outline, square points.
fn area(outline: &[Pos2]) -> f32 {
    let n = outline.len();
    (0..n).map(|i| (outline[i].x * outline[(i + 1) % n].y) - (outline[(i + 1) % n].x * outline[i].y)).sum::<f32>().abs() / 2.0
}

/// Points connected by lines.
pub fn draw_points(painter: &Painter, points: &[Pos2], color: Color32) {
    for pair in points.windows(2) {
        painter.line_segment([pair[0], pair[1]], Stroke::new(3.5, Color32::from_black_alpha(170)));
        painter.line_segment([pair[0], pair[1]], Stroke::new(1.6, color));
    }
    for p in points {
        painter.circle(*p, 4.0, color, Stroke::new(1.5, Color32::from_black_alpha(220)));
    }
}

/// A checkerboard that indicates a transparent background.
fn checkerboard(painter: &Painter, rect: Rect) {
    const EDGE: f32 = 14.0;
    let (nx, ny) = ((rect.width() / EDGE).ceil() as i32, (rect.height() / EDGE).ceil() as i32);
    let mut mesh = egui::Mesh::default();
    for y in 0..ny {
        for x in (y % 2..nx).step_by(2) {
            let square = Rect::from_min_size(rect.min + vec2(x as f32 * EDGE, y as f32 * EDGE), vec2(EDGE, EDGE));
            mesh.add_colored_rect(square.intersect(rect), Color32::from_gray(44));
        }
    }
    painter.add(mesh);
}
