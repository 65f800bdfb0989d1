//! Axial, coronal and sagittal slices through one crosshair, of the deformed scene, the source, or
//! both side by side.

use super::shown;
use super::{draw_points_of, edge_letters, scale_bar, text};
use crate::cpu::section::SectionPlane;
use crate::gui::state::slice_paint::{Overlay, SliceStyle};
use crate::gui::state::slices::*;
use crate::gui::state::tool::Tool;
use crate::gui::state::worker::{JobKind, JobTarget, SlicePicture};
use crate::gui::state::{Gesture, Hover, Workstation};
use crate::gui::theme::{AXES, CANVAS, ON_CANVAS, SELECTED};
use crate::scene::Scene;
use eframe::egui::{self, Align2, Color32, CursorIcon, Painter, PointerButton, Pos2, Rect, Response, Sense, Stroke, Ui, pos2, vec2};
use glam::Vec3;
use std::sync::Arc;

/// Names, rightward and downward directions: patient left on the right, by radiological convention.
const ORIENTATIONS: [(&str, Vec3, Vec3); 3] = [("Axial", Vec3::X, Vec3::Y), ("Coronal", Vec3::X, Vec3::NEG_Z), ("Sagittal", Vec3::Y, Vec3::NEG_Z)];
/// Wheel movement for one slice, points.
const NOTCH: f32 = 40.0;
/// Spacing of arrows, points.
const ARROWS: f32 = 24.0;

/// The scene reduced to what slices depend on; in particular without the camera.
fn sliced(scene: &Scene) -> Scene {
    let mut plain = super::super::state::history::without_camera(scene);
    // Deformations locked to the view depend on the camera.
    if scene.deformation.iter().any(|d| crate::deform::kinds::kind(&d.kind).is_ok_and(|k| k.locked_to_view)) {
        plain.camera = scene.camera.clone();
    }
    plain.render =
        crate::scene::RenderSettings { step: 1.0, exact_cuts: scene.render.exact_cuts, precompose: scene.render.precompose, ..Default::default() };
    plain.transfer = Default::default();
    plain.light = Default::default();
    plain.measure.clear();
    plain
}

impl Workstation {
    /// Shows one of the three views.
    pub fn show_slice(&mut self, ui: &mut Ui, n: usize) {
        let size = ui.available_size().max(vec2(16.0, 16.0));
        let (rect, _) = ui.allocate_exact_size(size, Sense::hover());
        ui.painter().rect_filled(rect, 0.0, CANVAS);
        if self.doc.as_ref().is_none_or(|d| !d.assets.has_volume) {
            self.slices.panes[n].rect = None;
            self.slices.panes[n + 3].rect = None;
            text(ui.painter(), rect.center(), Align2::CENTER_CENTER, "No volume in this scene", 13.5, ON_CANVAS);
            return;
        }
        if self.slices.space == Space::Linked {
            let middle = rect.center().x;
            let left = Rect::from_min_max(rect.min, pos2(middle - 1.0, rect.bottom()));
            let right = Rect::from_min_max(pos2(middle + 1.0, rect.top()), rect.max);
            self.show_pane(ui, n, left, false);
            self.show_pane(ui, n, right, true);
        } else {
            let source = self.slices.space == Space::Source;
            self.slices.panes[if source { n } else { n + 3 }].rect = None;
            self.show_pane(ui, n, rect, source);
        }
    }

    fn show_pane(&mut self, ui: &mut Ui, n: usize, rect: Rect, source: bool) {
        let pane = n + if source { 3 } else { 0 };
        let (name, right, down) = ORIENTATIONS[n];
        let word = if source { format!("{name} source view") } else { format!("{name} view") };
        let response = ui.interact(rect, ui.id().with(("slice", pane)), Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, &word));
        let Some(doc) = &self.doc else { return };
        let bounds = doc.bounds();
        let assets = doc.assets.clone();
        let cursor = *self.slices.cursor.get_or_insert(bounds.center());
        // In linked mode, through the source point of the crosshair rather than through its current
        // position.
        let through = if source && self.slices.space == Space::Linked { self.slices.source_cursor().unwrap_or(cursor) } else { cursor };
        let ppp = ui.ctx().pixels_per_point();
        let size = [(rect.width() * ppp) as u32, (rect.height() * ppp) as u32].map(|s| s.clamp(8, 4096));
        let extent = bounds.size();
        let (across, along) = (extent.dot(right.abs()), extent.dot(down.abs()));
        let mm_per_pixel = (across / size[0] as f32).max(along / size[1] as f32) * 1.03 / self.slices.zoom;
        let normal = right.cross(down);
        let pan = self.slices.pan[n];
        let center = bounds.center() + normal * (through - bounds.center()).dot(normal) + right * pan.x + down * pan.y;
        let plane = SectionPlane { center, right, down, mm_per_pixel, size };
        let window = assets.volume.window(doc.scene.transfer.window, doc.scene.transfer.level);
        let style = SliceStyle { window: self.slice_window.unwrap_or(window), overlay: self.slices.overlay, source };
        self.request_slice(pane, plane, style);
        let state = &mut self.slices.panes[pane];
        state.rect = Some(rect);
        let current = state.is_current() && state.delay.failure.is_none();
        state.delay.note(current);
        let painter = ui.painter_at(rect);
        let (Some(texture), Some((picture, _))) = (&state.texture, &state.picture) else {
            state.delay.draw(&painter, rect, false);
            return;
        };
        // The picture stays in its own plane until the next one arrives.
        let shown = picture.plane;
        let at = |x: f32, y: f32| {
            let (px, py, _) = plane.pixel(shown.point(x, y));
            rect.min + vec2(px, py) / ppp
        };
        shown::image(&painter, texture, Rect::from_min_max(at(0.0, 0.0), at(shown.size[0] as f32, shown.size[1] as f32)));
        if picture.style.overlay == Overlay::Glyphs && !source {
            draw_glyphs(&painter, rect, &plane, picture, ppp);
        }
        let (x, y, _) = plane.pixel(through);
        let cross = rect.min + vec2(x, y) / ppp;
        draw_crosshair(&painter, rect, cross, n);
        edge_letters(&painter, rect, shown.right, -shown.down);
        scale_bar(&painter, rect, mm_per_pixel * ppp);
        let title = match (self.slices.space, source) {
            (Space::Deformed, _) => format!("{name} {:.1} mm", shown.center.dot(normal.abs())),
            (_, true) => format!("{name} source"),
            (_, false) => format!("{name} deformed"),
        };
        text(&painter, rect.min + vec2(8.0, 6.0), Align2::LEFT_TOP, title, 13.0, ON_CANVAS);
        state.delay.draw(&painter, rect, true);
        if !source && !self.stroke_points.is_empty() {
            let points: Vec<Pos2> = self.stroke_points.iter().map(|p| plane.pixel(*p)).map(|(x, y, _)| rect.min + vec2(x, y) / ppp).collect();
            draw_points_of(&painter, &points, SELECTED);
        }
        if let (Some(radius), Some(pos)) = (self.tool.brush().map(|_| self.brush.radius), response.hover_pos().filter(|_| !source)) {
            painter.circle_stroke(pos, radius / (mm_per_pixel * ppp), Stroke::new(1.5, SELECTED));
        }
        // Positions refer to the plane of the displayed slice.
        let plane = SectionPlane { center: plane.center + normal * (shown.center - plane.center).dot(normal), ..plane };
        self.handle_slice_input(ui, &response, &plane, n, rect, ppp, source);
    }

    fn request_slice(&mut self, pane: usize, plane: SectionPlane, style: SliceStyle) {
        let Some(doc) = &self.doc else { return };
        let assets = doc.assets.clone();
        let scene = sliced(&doc.shown(self.shows_undeformed()));
        let shared = match &self.slices.scene {
            Some(cached) if **cached == scene => cached.clone(),
            _ => {
                let shared = Arc::new(scene);
                self.slices.scene = Some(shared.clone());
                shared
            }
        };
        let requested = SliceRequest { scene: shared.clone(), assets: assets.clone(), plane, style };
        if self.slices.panes[pane].requested.as_ref().is_none_or(|a| !a.is(&requested)) {
            let serial = self.submit(JobTarget::Slice(pane), shared, assets, JobKind::Slice(plane, style));
            let state = &mut self.slices.panes[pane];
            state.open.push((serial, requested.clone()));
            state.requested = Some(requested);
            state.delay.failure = None;
        }
    }

    #[expect(clippy::too_many_arguments, reason = "one call, of what the pane has just worked out")]
    fn handle_slice_input(&mut self, ui: &Ui, response: &Response, plane: &SectionPlane, n: usize, rect: Rect, ppp: f32, source: bool) {
        let world = |pos: Pos2| {
            let d = (pos - rect.min) * ppp;
            plane.point(d.x, d.y)
        };
        if response.hovered() {
            let scroll = ui.input(|i| i.smooth_scroll_delta.y);
            let ctrl = ui.input(|i| i.modifiers.command);
            let pinch = ui.input(|i| i.zoom_delta());
            if pinch != 1.0 || (ctrl && scroll != 0.0) {
                self.slices.zoom = (self.slices.zoom * pinch * (scroll * 0.0025 * f32::from(u8::from(ctrl))).exp()).clamp(0.2, 40.0);
            } else if scroll != 0.0 {
                self.scroll_slice(n, scroll);
            }
            if self.tool != Tool::Navigate {
                ui.ctx().set_cursor_icon(CursorIcon::Crosshair);
            }
            if let Some(pos) = response.hover_pos() {
                self.hover_slice(world(pos), n, source);
            }
        }
        let started = |button| response.drag_started_by(button);
        let origin = ui.input(|i| i.pointer.press_origin()).unwrap_or_default();
        if started(PointerButton::Primary) {
            let windowing = ui.input(|i| i.key_down(egui::Key::W));
            self.gesture = Some(if windowing {
                self.tool = Tool::Navigate;
                Gesture::Window
            } else if self.tool.brush().is_some() && !source {
                self.begin_stroke();
                self.extend_stroke(world(origin));
                Gesture::SliceBrush
            } else if ui.input(|i| i.modifiers.shift) {
                Gesture::SlicePan
            } else {
                Gesture::Crosshair
            });
        } else if started(PointerButton::Middle) {
            self.gesture = Some(Gesture::SlicePan);
        } else if started(PointerButton::Secondary) {
            self.gesture = Some(Gesture::SliceZoom);
        }
        let delta = response.drag_delta();
        if let Some(pos) = response.interact_pointer_pos() {
            match self.gesture {
                Some(Gesture::Crosshair) if !source => self.slices.cursor = Some(self.clamped(world(pos))),
                Some(Gesture::SlicePan) => self.slices.pan[n] -= delta * ppp * plane.mm_per_pixel,
                Some(Gesture::SliceZoom) => self.slices.zoom = (self.slices.zoom * (-delta.y * 0.01).exp()).clamp(0.2, 40.0),
                Some(Gesture::Window) => self.drag_window(delta.x, delta.y),
                Some(Gesture::SliceBrush) => self.extend_stroke(world(pos)),
                _ => {}
            }
        }
        if response.drag_stopped() {
            if matches!(self.gesture, Some(Gesture::SliceBrush)) {
                self.end_stroke();
            }
            self.gesture = None;
        }
        if response.clicked()
            && let Some(pos) = response.interact_pointer_pos()
        {
            self.click_slice(world(pos), n, source);
        }
        if response.double_clicked() {
            self.slices.zoom = 1.0;
            self.slices.pan[n] = egui::Vec2::ZERO;
        }
    }

    fn clamped(&self, p: Vec3) -> Vec3 {
        self.doc.as_ref().map_or(p, |d| p.clamp(d.bounds().min, d.bounds().max))
    }

    /// Scrolls through the slices of a view.
    pub fn scroll_slice(&mut self, n: usize, scroll: f32) {
        let Some(doc) = &self.doc else { return };
        let (_, right, down) = ORIENTATIONS[n];
        let normal = right.cross(down).abs();
        // The slice spacing along the volume axis closest to this direction.
        let (directions, spacing) = (doc.assets.volume.direction(), doc.assets.volume.spacing_mm());
        let along = |a: usize| directions.col(a).as_vec3().dot(normal).abs();
        let axis = (0..3).max_by(|a, b| along(*a).total_cmp(&along(*b))).unwrap_or(2);
        let step = spacing[axis] as f32;
        // One notch of the wheel arrives as many small events.
        self.slices.wheel += scroll;
        let steps = (self.slices.wheel / NOTCH).trunc();
        self.slices.wheel -= steps * NOTCH;
        let bounds = doc.bounds();
        if let Some(cursor) = &mut self.slices.cursor {
            *cursor = (*cursor + normal * steps * step).clamp(bounds.min, bounds.max);
        }
    }

    fn hover_slice(&mut self, at: Vec3, n: usize, source: bool) {
        let from = if source { Some(at) } else { self.slices.source_of(n, at) };
        let Some(doc) = &self.doc else { return };
        self.hover = from.map(|from| Hover::new(&doc.assets, (!source).then_some(at), from, None));
    }

    fn click_slice(&mut self, at: Vec3, n: usize, source: bool) {
        let from = if source { Some(at) } else { self.slices.source_of(n, at) };
        match self.tool {
            Tool::Measure(_) | Tool::Probe => {
                if let Some(from) = from {
                    self.take_point(at, from);
                }
            }
            Tool::Place(kind) if !source => self.place(kind.0, Some((at, Vec3::Z))),
            _ if self.tool.brush().is_some() && !source => {
                self.begin_stroke();
                self.extend_stroke(at);
                self.end_stroke();
            }
            _ if !source => self.slices.cursor = Some(self.clamped(at)),
            _ => {}
        }
    }
}

/// Arrows from the source points to the deformed ones.
fn draw_glyphs(painter: &Painter, rect: Rect, plane: &SectionPlane, picture: &SlicePicture, ppp: f32) {
    let [width, height] = picture.plane.size.map(|n| n as usize);
    let step = (ARROWS * ppp) as usize;
    for y in (step / 2..height).step_by(step.max(1)) {
        for x in (step / 2..width).step_by(step.max(1)) {
            let n = y * width + x;
            if picture.section.mask[n] < 0.5 {
                continue;
            }
            let to = picture.plane.point(x as f32 + 0.5, y as f32 + 0.5);
            let from = picture.section.sources[n];
            if (to - from).length_squared() < 0.04 {
                continue;
            }
            let screen = |p: Vec3| {
                let (x, y, _) = plane.pixel(p);
                rect.min + vec2(x, y) / ppp
            };
            let (a, b) = (screen(from), screen(to));
            painter.arrow(a, b - a, Stroke::new(2.6, Color32::from_black_alpha(150)));
            painter.arrow(a, b - a, Stroke::new(1.2, Color32::from_rgb(250, 215, 110)));
        }
    }
}

fn draw_crosshair(painter: &Painter, rect: Rect, at: Pos2, n: usize) {
    // A line has the colour of the axis perpendicular to its plane: each view shows the other two
    // planes.
    let (vertical, horizontal) = [(0, 1), (0, 2), (1, 2)][n];
    let gap = 7.0;
    let line = |a: Pos2, b: Pos2, axis: usize| {
        painter.line_segment([a, b], Stroke::new(1.0, AXES[axis].gamma_multiply(0.7)));
    };
    line(pos2(at.x, rect.top()), pos2(at.x, at.y - gap), vertical);
    line(pos2(at.x, at.y + gap), pos2(at.x, rect.bottom()), vertical);
    line(pos2(rect.left(), at.y), pos2(at.x - gap, at.y), horizontal);
    line(pos2(at.x + gap, at.y), pos2(rect.right(), at.y), horizontal);
}
