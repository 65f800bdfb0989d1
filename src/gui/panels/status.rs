//! The bar at the bottom: the point under the pointer, the backend, work in progress.

use super::icon_button;
use crate::engine::Backend;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::slice_paint::{self, Overlay};
use crate::gui::state::slices::Space;
use crate::gui::state::{Hover, Workstation};
use eframe::egui::{self, Align, Layout, Ui, WidgetInfo, WidgetType, vec2};
use egui_phosphor::regular as icon;

/// Draws the bar at the bottom: the point under the pointer, reductions, work in progress.
pub fn ui(state: &Workstation, ui: &mut Ui) -> Requests {
    let mut requests = Requests::default();
    egui::Panel::bottom("status")
        .frame(
            egui::Frame::NONE
                .fill(ui.visuals().panel_fill)
                .inner_margin(egui::Margin::symmetric(10, 4)),
        )
        .show(ui, |ui| {
            ui.horizontal(|ui| {
                let left = state
                    .hover
                    .as_ref()
                    .map(Hover::words)
                    .or_else(|| state.doc.as_ref().map(|_| state.title()))
                    .unwrap_or_else(|| "incise".into());
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    show_work(state, ui, &mut requests);
                    if state.doc.is_some() {
                        show_backend(state, ui, &mut requests);
                        show_slice_choices(state, ui, &mut requests);
                    }
                    ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                        ui.add(egui::Label::new(left).truncate());
                    });
                });
            });
        });
    requests
}

/// Loading and tasks in progress, each with a button that cancels it.
fn show_work(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    if let Some(loading) = &state.loading {
        let (what, share) = loading.stage();
        if icon_button(ui, icon::X, "Cancel loading").clicked() {
            requests.0.push(Request::CancelLoading);
        }
        ui.add(
            egui::ProgressBar::new(share)
                .desired_width(150.0)
                .text(format!("{what} {}", loading.name)),
        );
    }
    for (n, task) in state.tasks.iter().enumerate() {
        if icon_button(ui, icon::X, &format!("Cancel: {}", task.name)).clicked() {
            requests.0.push(Request::CancelTask(n));
        }
        ui.add(
            egui::ProgressBar::new(task.progress())
                .desired_width(150.0)
                .text(&task.name),
        );
    }
    if !state.tasks.is_empty() || state.loading.is_some() {
        ui.separator();
        ui.ctx().request_repaint_after_secs(0.1);
    }
}

/// The backend, to be changed, with what it says of the picture.
fn show_backend(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    let facts = &state.view.facts;
    let mut words = format!(
        "{} · step {:.1} · {:.0} ms",
        facts.device.as_ref().map_or("…", |d| &d.name),
        facts.step,
        facts.ms
    );
    if !state.view.is_current() {
        words += " · out of date";
    } else if !state.view.is_fine {
        words += " · coarse";
    }
    if !facts.notices.is_empty() {
        words += &format!(" · {}", icon::WARNING);
    }
    let chosen = state.backend();
    let response = ui.menu_button(words, |ui| {
        for (backend, word) in [
            (Backend::Auto, "Hardware GPU if there is one"),
            (Backend::Gpu, "Any GPU"),
            (Backend::Cpu, "CPU"),
        ] {
            if ui.radio(chosen == backend, word).clicked() {
                requests.0.push(Request::SetBackend(backend));
                ui.close();
            }
        }
        for notice in &facts.notices {
            ui.label(notice);
        }
    });
    response
        .response
        .widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, "Backend"));
    ui.separator();
}

/// What the slices show.
fn show_slice_choices(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    let overlay = match state.slices.overlay {
        Overlay::None => "no overlay",
        Overlay::Labels => "labels",
        Overlay::Grid => "grid",
        Overlay::Glyphs => "arrows",
        Overlay::Mask => "mask",
        Overlay::Jacobian => "det J",
    };
    let space = match state.slices.space {
        Space::Deformed => "deformed",
        Space::Source => "source",
        Space::Linked => "both",
    };
    let response = ui.menu_button(format!("Slices: {space}, {overlay}"), |ui| {
        ui.set_min_width(280.0);
        for (s, word) in [
            (Space::Deformed, "Deformed anatomy"),
            (Space::Source, "Source anatomy"),
            (Space::Linked, "Both, linked"),
        ] {
            if ui.radio(state.slices.space == s, word).clicked() {
                requests.0.push(Request::SetSpace(s));
            }
        }
        ui.separator();
        for (o, word) in [
            (Overlay::None, "No overlay"),
            (Overlay::Labels, "Labels"),
            (Overlay::Grid, "Deformation grid (10 mm)"),
            (Overlay::Glyphs, "Displacement arrows"),
            (Overlay::Mask, "Alpha mask (removed regions)"),
            (Overlay::Jacobian, "Jacobian determinant (det J)"),
        ] {
            if ui.radio(state.slices.overlay == o, word).clicked() {
                requests.0.push(Request::SetOverlay(o));
            }
        }
        if state.slices.overlay == Overlay::Jacobian {
            ui.horizontal(|ui| {
                for (det, word) in [(3.0, "compressed"), (0.3, "stretched"), (-1.0, "folded")] {
                    let (color, _) = slice_paint::determinant_color(det);
                    let (rect, _) = ui.allocate_exact_size(vec2(12.0, 12.0), egui::Sense::hover());
                    ui.painter().rect_filled(rect, 2.0, color);
                    ui.label(word);
                }
            });
        }
    });
    response
        .response
        .widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, "Slice display"));
    ui.separator();
}
