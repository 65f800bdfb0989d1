//! Axial, coronal and sagittal slices through one crosshair, of the deformed scene, the source, or
//! both side by side.

use super::shown;
use super::{draw_points_of, edge_letters, scale_bar, text};
use crate::cpu::section::SectionPlane;
use crate::gui::state::document::Document;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::slice_paint::{Overlay, SliceStyle};
use crate::gui::state::slices::*;
use crate::gui::state::tool::Tool;
use crate::gui::state::worker::SlicePicture;
use crate::gui::state::{Gesture, Hover, Workstation};
use crate::gui::theme::{AXES, CANVAS, ON_CANVAS, SELECTED};
use eframe::egui::{self, Align2, Color32, CursorIcon, Painter, PointerButton, Pos2, Rect, Response, Sense, Stroke, Ui, pos2, vec2};
use glam::Vec3;

/// Spacing of arrows, points.
const ARROWS: f32 = 24.0;

impl Slices {
    /// Draws one of the three views, and handles what the pointer does on it.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ui: &mut Ui, n: usize) -> Requests {
        let mut requests = Requests::default();
        let size = ui.available_size().max(vec2(16.0, 16.0));
        let (rect, _) = ui.allocate_exact_size(size, Sense::hover());
        ui.painter().rect_filled(rect, 0.0, CANVAS);
        let Some(doc) = state.doc.as_ref().filter(|d| d.assets.has_volume) else {
            self.panes[n].rect = None;
            self.panes[n + 3].rect = None;
            text(ui.painter(), rect.center(), Align2::CENTER_CENTER, "No volume in this scene", 13.5, ON_CANVAS);
            return requests;
        };
        if self.space == Space::Linked {
            let middle = rect.center().x;
            let left = Rect::from_min_max(rect.min, pos2(middle - 1.0, rect.bottom()));
            let right = Rect::from_min_max(pos2(middle + 1.0, rect.top()), rect.max);
            self.show_pane(state, doc, ui, n, left, false, &mut requests);
            self.show_pane(state, doc, ui, n, right, true, &mut requests);
        } else {
            let source = self.space == Space::Source;
            self.panes[if source { n } else { n + 3 }].rect = None;
            self.show_pane(state, doc, ui, n, rect, source, &mut requests);
        }
        requests
    }

    #[expect(clippy::too_many_arguments, reason = "one of two calls, of what the view has just worked out")]
    fn show_pane(&mut self, state: &Workstation, doc: &Document, ui: &mut Ui, n: usize, rect: Rect, source: bool, requests: &mut Requests) {
        let pane = n + if source { 3 } else { 0 };
        let (name, right, down) = ORIENTATIONS[n];
        let word = if source { format!("{name} source view") } else { format!("{name} view") };
        let response = ui.interact(rect, ui.id().with(("slice", pane)), Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, &word));
        let bounds = doc.bounds();
        let assets = &doc.assets;
        let cursor = *self.cursor.get_or_insert(bounds.center());
        // In linked mode, through the source point of the crosshair rather than through its current
        // position.
        let through = if source && self.space == Space::Linked { self.source_cursor().unwrap_or(cursor) } else { cursor };
        let ppp = ui.ctx().pixels_per_point();
        let size = [(rect.width() * ppp) as u32, (rect.height() * ppp) as u32].map(|s| s.clamp(8, 4096));
        let extent = bounds.size();
        let (across, along) = (extent.dot(right.abs()), extent.dot(down.abs()));
        let mm_per_pixel = (across / size[0] as f32).max(along / size[1] as f32) * 1.03 / self.zoom;
        let normal = right.cross(down);
        let pan = self.pan[n];
        let center = bounds.center() + normal * (through - bounds.center()).dot(normal) + right * pan.x + down * pan.y;
        let plane = SectionPlane { center, right, down, mm_per_pixel, size };
        let window = assets.volume.window(doc.scene.transfer.window, doc.scene.transfer.level);
        let style = SliceStyle { window: state.slice_window.unwrap_or(window), overlay: self.overlay, source };
        requests.0.push(Request::Slice(pane, plane, style));
        let of_pane = &mut self.panes[pane];
        of_pane.rect = Some(rect);
        let current = of_pane.is_current() && of_pane.delay.failure.is_none();
        of_pane.delay.note(current);
        let painter = ui.painter_at(rect);
        let (Some(texture), Some((picture, _))) = (&of_pane.texture, &of_pane.picture) else {
            of_pane.delay.draw(&painter, rect, false);
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
        let title = match (self.space, source) {
            (Space::Deformed, _) => format!("{name} {:.1} mm", shown.center.dot(normal.abs())),
            (_, true) => format!("{name} source"),
            (_, false) => format!("{name} deformed"),
        };
        text(&painter, rect.min + vec2(8.0, 6.0), Align2::LEFT_TOP, title, 13.0, ON_CANVAS);
        of_pane.delay.draw(&painter, rect, true);
        if !source && !state.stroke_points.is_empty() {
            let points: Vec<Pos2> = state.stroke_points.iter().map(|p| plane.pixel(*p)).map(|(x, y, _)| rect.min + vec2(x, y) / ppp).collect();
            draw_points_of(&painter, &points, SELECTED);
        }
        if let (Some(radius), Some(pos)) = (state.tool.brush().map(|_| state.brush.radius), response.hover_pos().filter(|_| !source)) {
            painter.circle_stroke(pos, radius / (mm_per_pixel * ppp), Stroke::new(1.5, SELECTED));
        }
        // Positions refer to the plane of the displayed slice.
        let plane = SectionPlane { center: plane.center + normal * (shown.center - plane.center).dot(normal), ..plane };
        let on = PaneInput { response: &response, plane: &plane, n, rect, pixels_per_point: ppp, source };
        self.handle_input(state, doc, ui, &on, requests);
    }

    fn handle_input(&mut self, state: &Workstation, doc: &Document, ui: &Ui, on: &PaneInput, requests: &mut Requests) {
        let PaneInput { response, plane, n, rect, pixels_per_point: ppp, source } = *on;
        let world = |pos: Pos2| {
            let d = (pos - rect.min) * ppp;
            plane.point(d.x, d.y)
        };
        if response.hovered() {
            let scroll = ui.input(|i| i.smooth_scroll_delta.y);
            let ctrl = ui.input(|i| i.modifiers.command);
            let pinch = ui.input(|i| i.zoom_delta());
            if pinch != 1.0 || (ctrl && scroll != 0.0) {
                self.zoom = (self.zoom * pinch * (scroll * 0.0025 * f32::from(u8::from(ctrl))).exp()).clamp(0.2, 40.0);
            } else if scroll != 0.0 {
                self.scroll(doc, n, scroll);
            }
            if state.tool != Tool::Navigate {
                ui.ctx().set_cursor_icon(CursorIcon::Crosshair);
            }
            if let Some(pos) = response.hover_pos() {
                let from = if source { Some(world(pos)) } else { self.source_of(n, world(pos)) };
                let hover = from.map(|from| Hover::new(&doc.assets, (!source).then_some(world(pos)), from, None));
                requests.0.push(Request::SetHover(hover));
            }
        }
        let mut gesture = state.gesture.clone();
        let started = |button| response.drag_started_by(button);
        let began = [PointerButton::Primary, PointerButton::Middle, PointerButton::Secondary].into_iter().any(started);
        let origin = ui.input(|i| i.pointer.press_origin()).unwrap_or_default();
        if started(PointerButton::Primary) {
            let windowing = ui.input(|i| i.key_down(egui::Key::W));
            gesture = Some(if windowing {
                requests.0.push(Request::SetTool(Tool::Navigate));
                Gesture::Window
            } else if state.tool.brush().is_some() && !source {
                requests.0.push(Request::BeginStroke);
                requests.0.push(Request::ExtendStroke(world(origin)));
                Gesture::SliceBrush
            } else if ui.input(|i| i.modifiers.shift) {
                Gesture::SlicePan
            } else {
                Gesture::Crosshair
            });
        } else if started(PointerButton::Middle) {
            gesture = Some(Gesture::SlicePan);
        } else if started(PointerButton::Secondary) {
            gesture = Some(Gesture::SliceZoom);
        }
        if began {
            requests.0.push(Request::SetGesture(gesture.clone()));
        }
        let delta = response.drag_delta();
        if let Some(pos) = response.interact_pointer_pos() {
            match gesture {
                Some(Gesture::Crosshair) if !source => self.cursor = Some(world(pos).clamp(doc.bounds().min, doc.bounds().max)),
                Some(Gesture::SlicePan) => self.pan[n] -= delta * ppp * plane.mm_per_pixel,
                Some(Gesture::SliceZoom) => self.zoom = (self.zoom * (-delta.y * 0.01).exp()).clamp(0.2, 40.0),
                Some(Gesture::Window) => requests.0.push(Request::DragWindow(delta)),
                Some(Gesture::SliceBrush) => requests.0.push(Request::ExtendStroke(world(pos))),
                _ => {}
            }
        }
        if response.drag_stopped() {
            if matches!(gesture, Some(Gesture::SliceBrush)) {
                requests.0.push(Request::EndStroke);
            }
            requests.0.push(Request::SetGesture(None));
        }
        if response.clicked()
            && let Some(pos) = response.interact_pointer_pos()
        {
            requests.0.push(Request::ClickSlice { at: world(pos), n, source });
        }
        if response.double_clicked() {
            self.zoom = 1.0;
            self.pan[n] = egui::Vec2::ZERO;
        }
    }
}

/// Where on a pane something happens.
struct PaneInput<'a> {
    response: &'a Response,
    plane: &'a SectionPlane,
    /// Which of the three views.
    n: usize,
    rect: Rect,
    pixels_per_point: f32,
    /// It shows the source.
    source: bool,
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
