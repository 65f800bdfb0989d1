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
use eframe::egui::{
    self, Align2, Color32, CursorIcon, Painter, PointerButton, Pos2, Rect, Response, Sense, Stroke, Ui, pos2,
    vec2,
};
use glam::Vec3;

/// Spacing of arrows, points.
const ARROWS: f32 = 24.0;

impl Slices {
    /// Draws one of the three views and handles pointer input on it.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ui: &mut Ui, n: usize) -> Requests {
        let mut requests = Requests::default();
        let size = ui.available_size().max(vec2(16.0, 16.0));
        let (rect, _) = ui.allocate_exact_size(size, Sense::hover());
        ui.painter().rect_filled(rect, 0.0, CANVAS);
        let Some(doc) = state.doc.as_ref().filter(|d| d.assets.has_volume) else {
            self.panes[n].rect = None;
            self.panes[n + 3].rect = None;
            text(
                ui.painter(),
                rect.center(),
                Align2::CENTER_CENTER,
                "No volume in this scene",
                13.5,
                ON_CANVAS,
            );
            return requests;
        };
        let pixels_per_point = ui.ctx().pixels_per_point();
        let area = |source: bool, rect: Rect| PaneArea {
            n,
            source,
            rect,
            pixels_per_point,
        };
        if self.space == Space::Linked {
            let middle = rect.center().x;
            let left = Rect::from_min_max(rect.min, pos2(middle - 1.0, rect.bottom()));
            let right = Rect::from_min_max(pos2(middle + 1.0, rect.top()), rect.max);
            self.show_pane(state, doc, ui, area(false, left), &mut requests);
            self.show_pane(state, doc, ui, area(true, right), &mut requests);
        } else {
            let source = self.space == Space::Source;
            self.panes[if source { n } else { n + 3 }].rect = None;
            self.show_pane(state, doc, ui, area(source, rect), &mut requests);
        }
        requests
    }

    /// Draws one pane and handles pointer input on it.
    fn show_pane(
        &mut self,
        state: &Workstation,
        doc: &Document,
        ui: &mut Ui,
        area: PaneArea,
        requests: &mut Requests,
    ) {
        let PaneArea { n, source, rect, .. } = area;
        let (name, right, down) = ORIENTATIONS[n];
        let word = if source {
            format!("{name} source view")
        } else {
            format!("{name} view")
        };
        let response = ui.interact(
            rect,
            ui.id().with(("slice", area.pane())),
            Sense::click_and_drag(),
        );
        response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, &word));
        let cursor = *self.cursor.get_or_insert(doc.bounds().center());
        // In linked mode, through the source point of the crosshair rather than through its current
        // position.
        let through = if source && self.space == Space::Linked {
            self.source_cursor().unwrap_or(cursor)
        } else {
            cursor
        };
        let plane = self.plane(doc, &area, through);
        let window = doc
            .assets
            .volume
            .window(doc.scene.transfer.window, doc.scene.transfer.level);
        let style = SliceStyle {
            window: state.slice_window.unwrap_or(window),
            overlay: self.overlay,
            source,
        };
        requests.0.push(Request::Slice(area.pane(), plane, style));
        let pane = &mut self.panes[area.pane()];
        pane.rect = Some(rect);
        let current = pane.is_current() && pane.delay.failure.is_none();
        pane.delay.note(current);
        let painter = ui.painter_at(rect);
        let Some(shown) = self.draw_picture(&painter, &area, &plane, through) else {
            return;
        };
        if !source && !state.stroke_points.is_empty() {
            let points: Vec<Pos2> = state
                .stroke_points
                .iter()
                .map(|p| area.screen(&plane, *p))
                .collect();
            draw_points_of(&painter, &points, SELECTED);
        }
        if let (Some(radius), Some(pos)) = (
            state.tool.brush().map(|_| state.brush.radius),
            response.hover_pos().filter(|_| !source),
        ) {
            painter.circle_stroke(
                pos,
                radius / (plane.mm_per_pixel * area.pixels_per_point),
                Stroke::new(1.5, SELECTED),
            );
        }
        // Positions refer to the plane of the displayed slice.
        let normal = right.cross(down);
        let plane = SectionPlane {
            center: plane.center + normal * (shown.center - plane.center).dot(normal),
            ..plane
        };
        let on = PaneInput {
            area,
            response: &response,
            plane: &plane,
        };
        self.handle_input(state, doc, ui, &on, requests);
    }

    /// The plane through a point that a pane shows at its zoom and pan.
    fn plane(&self, doc: &Document, area: &PaneArea, through: Vec3) -> SectionPlane {
        let (_, right, down) = ORIENTATIONS[area.n];
        let (rect, ppp) = (area.rect, area.pixels_per_point);
        let bounds = doc.bounds();
        let size = [(rect.width() * ppp) as u32, (rect.height() * ppp) as u32].map(|s| s.clamp(8, 4096));
        let extent = bounds.size();
        let (across, along) = (extent.dot(right.abs()), extent.dot(down.abs()));
        let mm_per_pixel = (across / size[0] as f32).max(along / size[1] as f32) * 1.03 / self.zoom;
        let normal = right.cross(down);
        let pan = self.pan[area.n];
        let center =
            bounds.center() + normal * (through - bounds.center()).dot(normal) + right * pan.x + down * pan.y;
        SectionPlane {
            center,
            right,
            down,
            mm_per_pixel,
            size,
        }
    }

    /// Draws the latest picture of a pane, with crosshair, orientation letters, scale bar and
    /// title. Returns the picture's plane; none without a picture.
    fn draw_picture(
        &self,
        painter: &Painter,
        area: &PaneArea,
        plane: &SectionPlane,
        through: Vec3,
    ) -> Option<SectionPlane> {
        let PaneArea {
            n,
            source,
            rect,
            pixels_per_point: ppp,
        } = *area;
        let pane = &self.panes[area.pane()];
        let (Some(texture), Some((picture, _))) = (&pane.texture, &pane.picture) else {
            pane.delay.draw(painter, rect, false);
            return None;
        };
        // The picture stays in its own plane until the next one arrives.
        let shown = picture.plane;
        let at = |x: f32, y: f32| area.screen(plane, shown.point(x, y));
        shown::image(
            painter,
            texture,
            Rect::from_min_max(at(0.0, 0.0), at(shown.size[0] as f32, shown.size[1] as f32)),
        );
        if picture.style.overlay == Overlay::Glyphs && !source {
            draw_glyphs(painter, area, plane, picture);
        }
        draw_crosshair(painter, rect, area.screen(plane, through), n);
        edge_letters(painter, rect, shown.right, -shown.down);
        scale_bar(painter, rect, plane.mm_per_pixel * ppp);
        let (name, right, down) = ORIENTATIONS[n];
        let title = match (self.space, source) {
            (Space::Deformed, _) => format!("{name} {:.1} mm", shown.center.dot(right.cross(down).abs())),
            (_, true) => format!("{name} source"),
            (_, false) => format!("{name} deformed"),
        };
        text(
            painter,
            rect.min + vec2(8.0, 6.0),
            Align2::LEFT_TOP,
            title,
            13.0,
            ON_CANVAS,
        );
        pane.delay.draw(painter, rect, true);
        Some(shown)
    }

    /// Handles pointer input on a pane.
    fn handle_input(
        &mut self,
        state: &Workstation,
        doc: &Document,
        ui: &Ui,
        on: &PaneInput,
        requests: &mut Requests,
    ) {
        let PaneInput { response, area, .. } = *on;
        if response.hovered() {
            self.handle_hover(state, doc, ui, on, requests);
        }
        let begun = begin_drag(state, ui, on, requests);
        if begun.is_some() {
            requests.0.push(Request::SetGesture(begun.clone()));
        }
        let gesture = begun.or_else(|| state.gesture.clone());
        if let Some(pos) = response.interact_pointer_pos() {
            self.continue_drag(doc, on, gesture.as_ref(), pos, requests);
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
            requests.0.push(Request::ClickSlice {
                at: on.world(pos),
                n: area.n,
                source: area.source,
            });
        }
        if response.double_clicked() {
            self.zoom = 1.0;
            self.pan[area.n] = egui::Vec2::ZERO;
        }
    }

    /// Zooms or scrolls with the wheel, and reports the point under the pointer.
    fn handle_hover(
        &mut self,
        state: &Workstation,
        doc: &Document,
        ui: &Ui,
        on: &PaneInput,
        requests: &mut Requests,
    ) {
        let PaneArea { n, source, .. } = on.area;
        let scroll = ui.input(|i| i.smooth_scroll_delta.y);
        let ctrl = ui.input(|i| i.modifiers.command);
        let pinch = ui.input(|i| i.zoom_delta());
        if pinch != 1.0 || (ctrl && scroll != 0.0) {
            self.zoom =
                (self.zoom * pinch * (scroll * 0.0025 * f32::from(u8::from(ctrl))).exp()).clamp(0.2, 40.0);
        } else if scroll != 0.0 {
            self.scroll(doc, n, scroll);
        }
        if state.tool != Tool::Navigate {
            ui.ctx().set_cursor_icon(CursorIcon::Crosshair);
        }
        if let Some(pos) = on.response.hover_pos() {
            let from = if source {
                Some(on.world(pos))
            } else {
                self.source_of(n, on.world(pos))
            };
            let hover =
                from.map(|from| Hover::new(&doc.assets, (!source).then_some(on.world(pos)), from, None));
            requests.0.push(Request::SetHover(hover));
        }
    }

    /// Follows the pointer during a drag.
    fn continue_drag(
        &mut self,
        doc: &Document,
        on: &PaneInput,
        gesture: Option<&Gesture>,
        pos: Pos2,
        requests: &mut Requests,
    ) {
        let PaneArea {
            n,
            source,
            pixels_per_point: ppp,
            ..
        } = on.area;
        let delta = on.response.drag_delta();
        match gesture {
            Some(Gesture::Crosshair) if !source => {
                self.cursor = Some(on.world(pos).clamp(doc.bounds().min, doc.bounds().max))
            }
            Some(Gesture::SlicePan) => self.pan[n] -= delta * ppp * on.plane.mm_per_pixel,
            Some(Gesture::SliceZoom) => self.zoom = (self.zoom * (-delta.y * 0.01).exp()).clamp(0.2, 40.0),
            Some(Gesture::Window) => requests.0.push(Request::DragWindow(delta)),
            Some(Gesture::SliceBrush) => requests.0.push(Request::ExtendStroke(on.world(pos))),
            _ => {}
        }
    }
}

/// Where a pane lies on the screen, and what it shows.
#[derive(Clone, Copy)]
struct PaneArea {
    /// Which of the three views.
    n: usize,
    /// Whether it shows the source.
    source: bool,
    rect: Rect,
    pixels_per_point: f32,
}

impl PaneArea {
    /// Index of the pane: 0 to 2 for the views, 3 to 5 for the same views of the source.
    fn pane(&self) -> usize {
        self.n + if self.source { 3 } else { 0 }
    }

    /// The screen position of a world point, projected onto a plane.
    fn screen(&self, plane: &SectionPlane, world: Vec3) -> Pos2 {
        let (x, y, _) = plane.pixel(world);
        self.rect.min + vec2(x, y) / self.pixels_per_point
    }
}

/// A pane and the pointer input on it.
struct PaneInput<'a> {
    area: PaneArea,
    response: &'a Response,
    /// The plane of the displayed slice.
    plane: &'a SectionPlane,
}

impl PaneInput<'_> {
    /// The world point at a screen position, mm.
    fn world(&self, pos: Pos2) -> Vec3 {
        let d = (pos - self.area.rect.min) * self.area.pixels_per_point;
        self.plane.point(d.x, d.y)
    }
}

/// The gesture of a drag that has just started, if any.
fn begin_drag(state: &Workstation, ui: &Ui, on: &PaneInput, requests: &mut Requests) -> Option<Gesture> {
    if on.response.drag_started_by(PointerButton::Primary) {
        let windowing = ui.input(|i| i.key_down(egui::Key::W));
        Some(if windowing {
            requests.0.push(Request::SetTool(Tool::Navigate));
            Gesture::Window
        } else if state.tool.brush().is_some() && !on.area.source {
            let origin = ui.input(|i| i.pointer.press_origin()).unwrap_or_default();
            requests.0.push(Request::BeginStroke);
            requests.0.push(Request::ExtendStroke(on.world(origin)));
            Gesture::SliceBrush
        } else if ui.input(|i| i.modifiers.shift) {
            Gesture::SlicePan
        } else {
            Gesture::Crosshair
        })
    } else if on.response.drag_started_by(PointerButton::Middle) {
        Some(Gesture::SlicePan)
    } else if on.response.drag_started_by(PointerButton::Secondary) {
        Some(Gesture::SliceZoom)
    } else {
        None
    }
}

/// Arrows from the source points to the deformed ones.
fn draw_glyphs(painter: &Painter, area: &PaneArea, plane: &SectionPlane, picture: &SlicePicture) {
    let [width, height] = picture.plane.size.map(|n| n as usize);
    let step = (ARROWS * area.pixels_per_point) as usize;
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
            let (a, b) = (area.screen(plane, from), area.screen(plane, to));
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
