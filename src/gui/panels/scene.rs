//! The scene as a tree: the volume, surfaces, the stack of deformations, measurements.

use super::{heading, icon_button};
use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::state::document::{Document, Selection};
use crate::gui::state::layout::Panel;
use crate::gui::state::panels::ScenePanel;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::tool::symbol;
use eframe::egui::{self, Align, Layout, RichText, Sense, Ui, WidgetInfo, WidgetType, vec2};
use egui_phosphor::regular as icon;

/// The index of a dragged deformation.
#[derive(Clone, Copy)]
struct Dragged(usize);

/// A row of the tree: a name to select, with buttons at its right end.
fn row(
    ui: &mut Ui,
    selected: bool,
    text: RichText,
    label: &str,
    buttons: impl FnOnce(&mut Ui),
) -> egui::Response {
    let height = 24.0;
    let (rect, response) =
        ui.allocate_exact_size(vec2(ui.available_width(), height), Sense::click_and_drag());
    response.widget_info(|| WidgetInfo::selected(WidgetType::SelectableLabel, true, selected, label));
    let visuals = ui.style().interact_selectable(&response, selected);
    if selected || response.hovered() {
        ui.painter().rect_filled(rect, 3.0, visuals.weak_bg_fill);
    }
    let mut child = ui.new_child(
        egui::UiBuilder::new()
            .max_rect(rect.shrink2(vec2(4.0, 0.0)))
            .layout(Layout::right_to_left(Align::Center)),
    );
    buttons(&mut child);
    let color = visuals.text_color();
    child.with_layout(Layout::left_to_right(Align::Center), |ui| {
        ui.add(egui::Label::new(text.color(color)).truncate().selectable(false));
    });
    response
}

/// Selects an item of the tree and shows the panel for it.
fn select(requests: &mut Requests, selection: Selection) {
    requests.0.push(Request::Select(selection));
    let panel = if matches!(selection, Selection::Measure(_)) {
        Panel::Measure
    } else {
        Panel::Inspector
    };
    requests.0.push(Request::Show(panel));
}

impl ScenePanel {
    /// Draws the tree.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ui: &mut Ui) -> Requests {
        let mut requests = Requests::default();
        let Some(doc) = &state.doc else { return requests };
        let picture = row(
            ui,
            doc.selected == Selection::Nothing,
            RichText::new(format!("{} Picture and light", icon::CAMERA)),
            "Picture and light",
            |_| (),
        );
        if picture.clicked() {
            select(&mut requests, Selection::Nothing);
        }
        show_volume(ui, doc, &mut requests);
        heading(ui, "Deformations");
        show_deformations(ui, doc, &mut requests);
        heading(ui, "Surfaces");
        show_surfaces(ui, doc, &mut requests);
        show_measurements(ui, doc, &mut requests);
        requests
    }
}

/// The rows of the volume and its label map.
fn show_volume(ui: &mut Ui, doc: &Document, requests: &mut Requests) {
    let Some(volume) = &doc.scene.volume else { return };
    let name = std::path::Path::new(&volume.path)
        .file_name()
        .map_or_else(|| volume.path.clone(), |n| n.to_string_lossy().into_owned());
    let text = RichText::new(format!("{} {name}", icon::CUBE));
    if row(ui, doc.selected == Selection::Volume, text, &name, |_| ()).clicked() {
        select(requests, Selection::Volume);
    }
    if let Some(labels) = volume.labels.clone() {
        let name = std::path::Path::new(&labels)
            .file_name()
            .map_or(labels.clone(), |n| n.to_string_lossy().into_owned());
        let mut remove = false;
        row(
            ui,
            false,
            RichText::new(format!("    {} {name}", icon::BRAIN)),
            &name,
            |ui| remove = icon_button(ui, icon::X, "Remove the label map").clicked(),
        );
        if remove {
            requests.change(|doc| {
                if let Some(volume) = &mut doc.scene.volume {
                    volume.labels = None;
                }
            });
        }
    }
}

/// The rows of the stack, which can be reordered by dragging.
fn show_deformations(ui: &mut Ui, doc: &Document, requests: &mut Requests) {
    let count = doc.scene.deformation.len();
    let mut moved = None;
    for n in 0..count {
        let response = deformation_row(ui, doc, n, requests);
        if response.clicked() {
            select(requests, Selection::Deformation(n));
        }
        if let Some(from) = dropped_on(ui, &response, n) {
            moved = Some((from, n));
        }
        deformation_menu(&response, n, requests);
    }
    if count == 0 {
        ui.label(RichText::new("None yet: choose Peel above and click the picture").weak());
    }
    if let Some((from, to)) = moved {
        requests.change(move |doc| {
            let _moved = doc.reorder(from, to);
        });
    }
}

/// A deformation's row with its buttons.
fn deformation_row(ui: &mut Ui, doc: &Document, n: usize, requests: &mut Requests) -> egui::Response {
    let d = &doc.scene.deformation[n];
    let title = Document::title_of(d);
    let shown = d.enabled && doc.solo.is_none_or(|s| s == n);
    let mut text = RichText::new(format!("{} {} {title}", n + 1, symbol(&d.kind)));
    if !shown {
        text = text.weak();
    }
    let enabled = d.enabled;
    let solo = doc.solo == Some(n);
    row(
        ui,
        doc.selected == Selection::Deformation(n),
        text,
        &format!("{} {title}", n + 1),
        |ui| {
            let eye = if enabled { icon::EYE } else { icon::EYE_SLASH };
            if icon_button(ui, eye, &format!("Mute {title}")).clicked() {
                requests
                    .0
                    .push(Request::PerformOn(Selection::Deformation(n), Action::Mute));
            }
            if solo || enabled {
                let star = RichText::new(icon::STAR).color(if solo {
                    super::super::theme::accent(ui)
                } else {
                    ui.visuals().weak_text_color()
                });
                let response = ui.add(egui::Button::new(star).frame(false).min_size(vec2(20.0, 22.0)));
                response.widget_info(|| {
                    WidgetInfo::selected(WidgetType::Button, true, solo, format!("Solo {title}"))
                });
                if response
                    .on_hover_text("Solo: show only this deformation")
                    .clicked()
                {
                    requests
                        .0
                        .push(Request::PerformOn(Selection::Deformation(n), Action::Solo));
                }
            }
        },
    )
}

/// Makes a deformation's row a drag source and a drop target; returns the index of a row dropped on
/// it.
fn dropped_on(ui: &Ui, response: &egui::Response, n: usize) -> Option<usize> {
    response.dnd_set_drag_payload(Dragged(n));
    if let Some(dragged) = response.dnd_hover_payload::<Dragged>() {
        let y = if dragged.0 > n {
            response.rect.top()
        } else {
            response.rect.bottom()
        };
        ui.painter().hline(
            response.rect.x_range(),
            y,
            egui::Stroke::new(2.0, super::super::theme::accent(ui)),
        );
    }
    response.dnd_release_payload::<Dragged>().map(|dragged| dragged.0)
}

/// The context menu of a deformation's row.
fn deformation_menu(response: &egui::Response, n: usize, requests: &mut Requests) {
    response.context_menu(|ui| {
        for (action, word) in [
            (Action::Duplicate, "Duplicate"),
            (Action::MoveUp, "Move up"),
            (Action::MoveDown, "Move down"),
            (Action::SaveMap, "Save to the library"),
            (Action::Delete, "Delete"),
        ] {
            if ui.button(word).clicked() {
                requests
                    .0
                    .push(Request::PerformOn(Selection::Deformation(n), action));
                ui.close();
            }
        }
    });
}

/// The surfaces' rows.
fn show_surfaces(ui: &mut Ui, doc: &Document, requests: &mut Requests) {
    for n in 0..doc.scene.mesh.len() {
        let mesh = &doc.scene.mesh[n];
        let named = mesh.name.clone().or_else(|| {
            mesh.path
                .as_ref()
                .map(|p| p.rsplit(['/', '\\']).next().unwrap_or(p).to_owned())
        });
        let name = named.unwrap_or_else(|| format!("Surface {}", n + 1));
        let hidden = mesh.hidden;
        let text = RichText::new(format!("{} {name}", icon::POLYGON));
        let response = row(
            ui,
            doc.selected == Selection::Mesh(n),
            if hidden { text.weak() } else { text },
            &name,
            |ui| {
                let eye = if hidden { icon::EYE_SLASH } else { icon::EYE };
                if icon_button(ui, eye, &format!("Hide {name}")).clicked() {
                    requests
                        .0
                        .push(Request::PerformOn(Selection::Mesh(n), Action::Mute));
                }
            },
        );
        if response.clicked() {
            select(requests, Selection::Mesh(n));
        }
    }
    if doc.scene.mesh.is_empty() {
        ui.label(RichText::new("Drop a mesh to add one").weak());
    }
}

/// The measurements' rows, under a heading if there are any.
fn show_measurements(ui: &mut Ui, doc: &Document, requests: &mut Requests) {
    if doc.scene.measure.is_empty() {
        return;
    }
    heading(ui, "Measurements");
    for n in 0..doc.scene.measure.len() {
        let name = doc.scene.measure[n]
            .name
            .clone()
            .unwrap_or_else(|| doc.scene.measure[n].kind.name().to_owned());
        if row(
            ui,
            doc.selected == Selection::Measure(n),
            RichText::new(format!("{} {name}", icon::RULER)),
            &name,
            |_| (),
        )
        .clicked()
        {
            select(requests, Selection::Measure(n));
        }
    }
}
