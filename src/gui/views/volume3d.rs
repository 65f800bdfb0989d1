//! The 3D view: picture, camera, handles, tools.
//!
//! The view always shows the newest picture available: a coarse one during interaction, a fine one
//! at rest. The resolution of coarse pictures follows the time of the previous ones. Overlays and
//! clicks refer to the displayed picture ([`super::shown`]).

use super::shown;
use super::{cube, edge_letters, scale_bar, text};
use crate::gui::gizmos::{self, Gizmo, Handle, Mode as GizmoMode};
use crate::gui::projector::Projector;
use crate::gui::state::document::Selection;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::shown::DisplayedPicture;
use crate::gui::state::tool::{Placed, Tool};
use crate::gui::state::view::*;
use crate::gui::state::worker::{JobTarget, ProbePurpose};
use crate::gui::state::{Gesture, Workstation};
use crate::gui::theme::{CANVAS, ON_CANVAS, SELECTED};
use crate::scene::Deformation;
use eframe::egui::{
    self, Align2, Color32, CursorIcon, Painter, PointerButton, Pos2, Rect, Response, Sense, Shape, Stroke,
    Ui, pos2, vec2,
};
use glam::Vec3;

impl View3d {
    /// Draws the view and handles pointer input on it.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ui: &mut Ui) -> Requests {
        let mut requests = Requests::default();
        let (rect, response) =
            ui.allocate_exact_size(ui.available_size().max(vec2(16.0, 16.0)), Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Other, true, "3D view"));
        self.rect = rect;
        self.pixels_per_point = ui.ctx().pixels_per_point();
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 0.0, CANVAS);
        if state.doc.is_none() {
            return requests;
        }
        let Some(projector) = self.projector() else {
            self.delay.draw(&painter, rect, false);
            self.gizmo_bar(state, ui, rect);
            return requests;
        };
        let pointer = response.hover_pos().filter(|p| rect.contains(*p));
        let mut on_cube = None;
        if let Some(picture) = &self.picture {
            if picture.of.scene.render.background[3] < 1.0 {
                checkerboard(&painter, rect);
            }
            shown::image(&painter, &picture.texture, projector.rect);
            on_cube = cube::draw(
                &painter,
                rect,
                &projector,
                pointer.filter(|_| state.gesture.is_none()),
            );
            edge_letters(
                &painter,
                rect,
                projector.frame.right.normalize_or_zero(),
                projector.frame.up.normalize_or_zero(),
            );
            let target = picture
                .of
                .scene
                .camera
                .target
                .map_or_else(|| picture.of.assets.scene_box().center(), Vec3::from);
            scale_bar(&painter, rect, projector.mm_per_point(target));
            draw_measures(state, &painter, &projector, picture);
        }
        let hot = self.draw_gizmo(state, &painter, &projector, pointer);
        if let (Some(why), None) = (&self.facts.blank, self.delay.words(true)) {
            shown::draw_message(&painter, rect, why);
        }
        self.delay.draw(&painter, rect, true);
        self.draw_progress(state, &painter, rect);
        self.draw_hint(state, &painter, rect);
        if !self.lasso.is_empty() {
            let mut points = self.lasso.clone();
            points.extend(self.lasso.first().copied());
            painter.add(Shape::line(
                points.clone(),
                Stroke::new(4.0, Color32::from_black_alpha(160)),
            ));
            painter.add(Shape::line(points, Stroke::new(1.8, SELECTED)));
        }
        self.gizmo_bar(state, ui, rect);
        if let Some(view) = on_cube.filter(|_| response.clicked()) {
            requests.0.push(Request::LookFrom(view));
            return requests;
        }
        drop_on_view(&response, &projector, &mut requests);
        let on = ViewInput {
            response: &response,
            projector: &projector,
            hot,
        };
        self.handle_input(state, ui, &on, &mut requests);
        requests
    }

    /// Handles pointer input.
    fn handle_input(&mut self, state: &Workstation, ui: &Ui, on: &ViewInput, requests: &mut Requests) {
        let ViewInput {
            response,
            projector,
            hot,
        } = *on;
        let pos = response.interact_pointer_pos().or_else(|| response.hover_pos());
        let modifiers = ui.input(|i| i.modifiers);
        if response.hovered() {
            self.handle_hover(state, ui, on, requests);
        }
        if response.double_clicked() && state.tool == Tool::Navigate && hot.is_none() {
            if let Some(pos) = pos {
                requests.probe(projector.at(pos), ProbePurpose::Center);
            }
            return;
        }
        let mut gesture = state.gesture.clone();
        let interrupts = gesture.is_some() && !matches!(gesture, Some(Gesture::Zoom));
        if interrupts && ui.input(|i| i.pointer.button_pressed(PointerButton::Secondary)) {
            requests.0.push(Request::Escape);
            return;
        }
        for button in [
            PointerButton::Primary,
            PointerButton::Middle,
            PointerButton::Secondary,
        ] {
            if response.drag_started_by(button)
                && let Some(origin) = ui.input(|i| i.pointer.press_origin())
            {
                let windowing = ui.input(|i| i.key_down(egui::Key::W)) && button == PointerButton::Primary;
                if windowing {
                    // The key that armed the wedge tool is being held for windowing.
                    requests.0.push(Request::SetTool(Tool::Navigate));
                    gesture = Some(Gesture::Window3d);
                } else {
                    gesture = self
                        .begin_drag(state, button, modifiers, origin, projector, requests)
                        .or(gesture);
                }
                requests.0.push(Request::SetGesture(gesture.clone()));
            }
        }
        if response.clicked()
            && let Some(pos) = pos
        {
            click(state, pos, modifiers, projector, requests);
        }
        let Some(pos) = pos else { return };
        self.continue_drag(state, on, gesture.as_ref(), pos, requests);
        if response.drag_stopped() {
            requests.0.push(Request::SetGesture(None));
            match gesture {
                Some(Gesture::Lasso) => requests.0.push(Request::FinishLasso),
                Some(Gesture::Brush) => requests.probe(projector.at(pos), ProbePurpose::Brush { last: true }),
                _ => {}
            }
        }
    }

    /// Zooms with the wheel, sets the cursor's shape, and requests the point under the pointer.
    fn handle_hover(&mut self, state: &Workstation, ui: &Ui, on: &ViewInput, requests: &mut Requests) {
        let scroll = ui.input(|i| i.smooth_scroll_delta.y + 300.0 * (i.zoom_delta() - 1.0));
        if scroll != 0.0 {
            requests.0.push(Request::Zoom((scroll * 0.0025).exp()));
        }
        let cursor = match state.tool {
            _ if on.hot.is_some() => CursorIcon::Grab,
            Tool::Navigate => CursorIcon::Default,
            _ => CursorIcon::Crosshair,
        };
        ui.ctx().set_cursor_icon(cursor);
        self.request_hover(state, on.projector, on.response.hover_pos(), requests);
    }

    /// Follows the pointer during a drag.
    fn continue_drag(
        &mut self,
        state: &Workstation,
        on: &ViewInput,
        gesture: Option<&Gesture>,
        pos: Pos2,
        requests: &mut Requests,
    ) {
        let projector = on.projector;
        let delta = on.response.drag_delta();
        match gesture {
            Some(Gesture::Orbit) => requests.0.push(Request::Orbit(delta)),
            Some(Gesture::Pan) => requests.0.push(Request::Pan(delta, self.rect)),
            Some(Gesture::Zoom) => requests.0.push(Request::Zoom((-delta.y * 0.01).exp())),
            Some(Gesture::Roll) => {
                let center = projector.rect.center();
                let (a, b) = ((pos - delta) - center, pos - center);
                let turned = b.angle() - a.angle();
                let wrapped =
                    (turned + std::f32::consts::PI).rem_euclid(std::f32::consts::TAU) - std::f32::consts::PI;
                requests.0.push(Request::Roll(wrapped.to_degrees()));
            }
            Some(Gesture::Gizmo(drag)) => {
                if let Some(moved) = self
                    .gizmo(state, gesture, projector)
                    .and_then(|g| g.dragged(drag, pos))
                {
                    self.dragged = Some(moved.clone());
                    requests.change(move |doc| {
                        if let Some(d) = doc.deformation() {
                            *d = moved;
                        }
                    });
                }
            }
            Some(Gesture::Window3d) => requests.0.push(Request::DragTransfer(delta)),
            Some(Gesture::Lasso) if self.lasso.last().is_none_or(|l| l.distance(pos) > 3.0) => {
                self.lasso.push(pos)
            }
            Some(Gesture::Brush) if delta.length() > 0.0 && state.prober.open < 2 => {
                requests.probe(projector.at(pos), ProbePurpose::Brush { last: false });
            }
            _ => {}
        }
    }

    /// The gesture that a drag begins, if any.
    fn begin_drag(
        &mut self,
        state: &Workstation,
        button: PointerButton,
        modifiers: egui::Modifiers,
        origin: Pos2,
        projector: &Projector,
        requests: &mut Requests,
    ) -> Option<Gesture> {
        let left = button == PointerButton::Primary;
        let plain = !modifiers.any();
        if left && plain {
            // The handle at the position of the press: a fast drag has moved on by the time it is
            // recognised.
            let grabbed = state.tool == Tool::Navigate && !state.shows_undeformed();
            if let Some((gizmo, handle)) = self
                .gizmo(state, state.gesture.as_ref(), projector)
                .filter(|_| grabbed)
                .and_then(|g| g.under(origin).map(|h| (g, h)))
            {
                // If the deformation has changed since the picture was rendered, the handle is not
                // where it is drawn.
                return is_as_shown(state, gizmo.deformation)
                    .then(|| Gesture::Gizmo(Box::new(gizmo.grab(handle, origin))));
            }
            if state.tool.is_lasso() {
                self.lasso = vec![origin];
                self.lasso_on = Some(*projector);
                return Some(Gesture::Lasso);
            }
            if state.tool.brush().is_some() {
                requests.0.push(Request::BeginStroke);
                requests.probe(projector.at(origin), ProbePurpose::Brush { last: false });
                return Some(Gesture::Brush);
            }
        }
        let blender = state.session.settings.blender;
        Some(match button {
            PointerButton::Middle if blender && plain => Gesture::Orbit,
            PointerButton::Middle if blender && modifiers.command => Gesture::Zoom,
            PointerButton::Middle => Gesture::Pan,
            PointerButton::Secondary => Gesture::Zoom,
            _ if modifiers.command => Gesture::Roll,
            _ if modifiers.shift => Gesture::Pan,
            _ => Gesture::Orbit,
        })
    }

    fn request_hover(
        &mut self,
        state: &Workstation,
        projector: &Projector,
        pos: Option<Pos2>,
        requests: &mut Requests,
    ) {
        let Some(pos) = pos else { return };
        // At most one request at a time, and none during a drag.
        if state.gesture.is_some() || state.prober.open > 0 {
            return;
        }
        let at = projector.at(pos);
        let requested = (at, self.pictures);
        if self.hover_requested != Some(requested) {
            self.hover_requested = Some(requested);
            requests.probe(at, ProbePurpose::Hover);
        }
    }

    /// The handles of the selected deformation as displayed. While dragged they follow the pointer,
    /// and after release they stay in place until the picture is up to date.
    fn gizmo<'a>(
        &'a self,
        state: &'a Workstation,
        gesture: Option<&Gesture>,
        projector: &Projector,
    ) -> Option<Gizmo<'a>> {
        let doc = state.doc.as_ref()?;
        let picture = self.picture.as_ref()?;
        let n = doc.deformation_index()?;
        let (own, seen) = (&doc.scene.deformation, &picture.of.scene.deformation);
        let let_go = self.delay.failure.is_none() && self.dragged.as_ref() == own.get(n);
        let deformation = match gesture {
            Some(Gesture::Gizmo(_)) => own.get(n)?,
            _ if let_go => own.get(n)?,
            // Deformations added, removed or moved since then have other indices in the list.
            _ if own.len() == seen.len() && own.iter().zip(seen).all(|(a, b)| a.kind == b.kind) => {
                seen.get(n)?
            }
            _ => return None,
        };
        let kind = gizmos::kind_of(deformation).filter(|k| k.name != "brush" && !k.locked_to_view)?;
        Some(Gizmo {
            projector: *projector,
            kind,
            deformation,
            scene_box: picture.of.assets.scene_box(),
            mode: self.gizmo,
        })
    }

    /// Draws the selected deformation's handles; returns the one under the pointer.
    fn draw_gizmo(
        &self,
        state: &Workstation,
        painter: &Painter,
        projector: &Projector,
        pointer: Option<Pos2>,
    ) -> Option<Handle> {
        if state.shows_undeformed() || !matches!(state.tool, Tool::Navigate) {
            return None;
        }
        let dragged = match &state.gesture {
            Some(Gesture::Gizmo(drag)) => Some(drag.handle),
            _ => None,
        };
        let gizmo = self.gizmo(state, state.gesture.as_ref(), projector)?;
        let hot = dragged.or_else(|| {
            pointer
                .filter(|_| state.gesture.is_none())
                .and_then(|p| gizmo.under(p))
        });
        gizmo.draw(painter, hot);
        hot
    }

    /// The selector for the kind of handles, in the lower left corner.
    fn gizmo_bar(&mut self, state: &Workstation, ui: &mut Ui, rect: Rect) {
        let shown = state
            .doc
            .as_ref()
            .is_some_and(|d| d.deformation_index().is_some())
            && state.tool == Tool::Navigate;
        if !shown {
            return;
        }
        let bar = Rect::from_min_size(pos2(rect.left() + 10.0, rect.bottom() - 34.0), vec2(260.0, 24.0));
        let mut child = ui.new_child(
            egui::UiBuilder::new()
                .max_rect(bar)
                .layout(egui::Layout::left_to_right(egui::Align::Center)),
        );
        child.visuals_mut().widgets.inactive.weak_bg_fill = Color32::from_black_alpha(150);
        for (mode, word, tip) in [
            (GizmoMode::Shape, "Shape", "Handles for every parameter"),
            (GizmoMode::Move, "Move", "Arrows along the box's axes"),
            (GizmoMode::Rotate, "Rotate", "Rings about the box's axes"),
            (GizmoMode::Scale, "Scale", "The box's faces"),
        ] {
            let button = egui::Button::selectable(self.gizmo == mode, word)
                .frame(true)
                .frame_when_inactive(true);
            if child.add(button).on_hover_text(tip).clicked() {
                self.gizmo = mode;
            }
        }
    }

    fn draw_progress(&self, state: &Workstation, painter: &Painter, rect: Rect) {
        if let Some((JobTarget::Fine, share)) = state.worker.progress().filter(|_| !self.is_fine) {
            let bar = Rect::from_min_size(rect.min, vec2(rect.width() * share.clamp(0.0, 1.0), 2.0));
            painter.rect_filled(bar, 0.0, SELECTED);
        }
    }

    fn draw_hint(&self, state: &Workstation, painter: &Painter, rect: Rect) {
        let undeformed = self.picture.as_ref().is_some_and(|p| p.of.undeformed);
        let hint = if undeformed {
            "Undeformed".to_owned()
        } else {
            state.tool.hint()
        };
        if !hint.is_empty() {
            text(
                painter,
                pos2(rect.left() + 12.0, rect.top() + 10.0),
                Align2::LEFT_TOP,
                hint,
                13.5,
                ON_CANVAS,
            );
        }
    }
}

/// Pointer input on the view.
struct ViewInput<'a> {
    response: &'a Response,
    projector: &'a Projector,
    /// The handle under the pointer.
    hot: Option<Handle>,
}

/// Handles a kind that was dragged from the palette and dropped on the view.
fn drop_on_view(response: &Response, projector: &Projector, requests: &mut Requests) {
    if let Some(kind) = response.dnd_release_payload::<Placed>()
        && let Some(pos) = response.ctx.pointer_latest_pos()
    {
        requests.0.push(Request::SetTool(Tool::Place(*kind)));
        requests.probe(projector.at(pos), ProbePurpose::Place);
    }
}

/// Handles a click.
fn click(
    state: &Workstation,
    pos: Pos2,
    modifiers: egui::Modifiers,
    projector: &Projector,
    requests: &mut Requests,
) {
    match state.tool {
        Tool::Navigate => {
            // With control points selected, Ctrl+click adds one on the surface.
            let points = state
                .doc
                .as_ref()
                .and_then(|d| d.scene.deformation.get(d.deformation_index()?))
                .is_some_and(|d| d.kind == "points");
            if modifiers.command && points {
                requests.probe(projector.at(pos), ProbePurpose::Tool);
            }
        }
        Tool::LassoCut | Tool::LassoRestore => {}
        _ if state.tool.brush().is_some() => {
            requests.0.push(Request::BeginStroke);
            requests.probe(projector.at(pos), ProbePurpose::Brush { last: true });
        }
        Tool::Place(_) => requests.probe(projector.at(pos), ProbePurpose::Place),
        _ => requests.probe(projector.at(pos), ProbePurpose::Tool),
    }
}

/// Whether the selected deformation is unchanged since the displayed picture.
fn is_as_shown(state: &Workstation, seen: &Deformation) -> bool {
    let own = state
        .doc
        .as_ref()
        .and_then(|d| d.scene.deformation.get(d.deformation_index()?));
    own.is_some_and(|own| {
        *own == Deformation {
            enabled: own.enabled,
            ..seen.clone()
        }
    })
}

/// Draws the picture's measurements, the incomplete one, and the current brush stroke.
fn draw_measures(state: &Workstation, painter: &Painter, projector: &Projector, picture: &DisplayedPicture) {
    let selected = state.doc.as_ref().and_then(|d| match d.selected {
        Selection::Measure(n) => d.scene.measure.get(n),
        _ => None,
    });
    for measured in picture.measured.iter().flatten() {
        let points: Vec<Pos2> = measured
            .seen
            .iter()
            .flatten()
            .filter_map(|p| projector.screen(*p))
            .collect();
        let color = if selected == Some(&measured.measure) {
            SELECTED
        } else {
            Color32::from_rgb(250, 225, 120)
        };
        draw_points(painter, &points, color);
        let words = measured
            .quantities
            .as_ref()
            .ok()
            .and_then(|q| q.first())
            .and_then(|q| q.value.map(|v| crate::gui::text::number(v, q.unit)));
        if let (Some(last), Some(words)) = (
            points
                .last()
                .filter(|_| points.len() == measured.measure.points.len()),
            words,
        ) {
            text(
                painter,
                *last + vec2(8.0, -8.0),
                Align2::LEFT_BOTTOM,
                words,
                13.5,
                color,
            );
        }
    }
    // Points of an incomplete measurement.
    let points: Vec<Pos2> = state
        .pending_points
        .iter()
        .filter_map(|p| projector.screen(p.deformed))
        .collect();
    draw_points(painter, &points, SELECTED);
    let stroke: Vec<Pos2> = state
        .stroke_points
        .iter()
        .filter_map(|p| projector.screen(*p))
        .collect();
    if stroke.len() > 1 {
        painter.add(Shape::line(stroke, Stroke::new(2.0, SELECTED)));
    }
}

/// Points connected by lines.
pub fn draw_points(painter: &Painter, points: &[Pos2], color: Color32) {
    for pair in points.windows(2) {
        painter.line_segment(
            [pair[0], pair[1]],
            Stroke::new(3.5, Color32::from_black_alpha(170)),
        );
        painter.line_segment([pair[0], pair[1]], Stroke::new(1.6, color));
    }
    for p in points {
        painter.circle(*p, 4.0, color, Stroke::new(1.5, Color32::from_black_alpha(220)));
    }
}

/// A checkerboard that indicates a transparent background.
fn checkerboard(painter: &Painter, rect: Rect) {
    const EDGE: f32 = 14.0;
    let (nx, ny) = (
        (rect.width() / EDGE).ceil() as i32,
        (rect.height() / EDGE).ceil() as i32,
    );
    let mut mesh = egui::Mesh::default();
    for y in 0..ny {
        for x in (y % 2..nx).step_by(2) {
            let square = Rect::from_min_size(
                rect.min + vec2(x as f32 * EDGE, y as f32 * EDGE),
                vec2(EDGE, EDGE),
            );
            mesh.add_colored_rect(square.intersect(rect), Color32::from_gray(44));
        }
    }
    painter.add(mesh);
}
