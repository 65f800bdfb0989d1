//! The bar at the top: the menu, tools, deformations, undo, renderers.

use super::{gallery_item, labelled, tool_button};
use crate::deform::kinds;
use crate::gui::state::Workstation;
use crate::gui::state::action::{self, Action};
use crate::gui::state::panels::Gallery;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::tool::{Placed, Tool, symbol, words};
use crate::scene::Mode;
use crate::scene::measure::MeasureKind;
use eframe::egui::{self, Ui, WidgetInfo, WidgetType, vec2};
use egui_phosphor::regular as icon;

/// Draws the bar at the top.
pub fn ui(state: &Workstation, ui: &mut Ui) -> Requests {
    let mut requests = Requests::default();
    egui::Panel::top("toolbar")
        .frame(
            egui::Frame::NONE
                .fill(ui.visuals().panel_fill)
                .inner_margin(egui::Margin::symmetric(8, 5)),
        )
        .show(ui, |ui| {
            ui.horizontal(|ui| {
                ui.spacing_mut().item_spacing.x = 1.0;
                ui.spacing_mut().button_padding.x = 6.0;
                ui.menu_button(format!("{} Menu", icon::LIST), |ui| {
                    show_menu(state, ui, &mut requests)
                })
                .response
                .widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, "Menu"));
                OPEN.show(state, ui, &mut requests);
                if state.doc.is_some() {
                    SAVE.show(state, ui, &mut requests);
                    ui.separator();
                    for button in &TOOLS {
                        button.show(state, ui, &mut requests);
                    }
                    ui.separator();
                    show_deformations(state, ui, &mut requests);
                    ui.separator();
                    show_undo(state, ui, &mut requests);
                    ui.separator();
                    for button in &RENDERERS {
                        button.show(state, ui, &mut requests);
                    }
                }
            });
        });
    requests
}

/// A button that performs an action.
struct ActionButton {
    /// Its icon; empty for none.
    symbol: &'static str,
    word: &'static str,
    about: &'static str,
    action: Action,
}

const OPEN: ActionButton = ActionButton {
    symbol: icon::FOLDER_OPEN,
    word: "Open",
    about: "Open a scene, volume or mesh",
    action: Action::Open,
};
const SAVE: ActionButton = ActionButton {
    symbol: icon::FLOPPY_DISK,
    word: "Save",
    about: "Save the scene",
    action: Action::Save,
};
/// The tools that do not deform.
const TOOLS: [ActionButton; 3] = [
    ActionButton {
        symbol: "",
        word: "Orbit",
        about: "Orbit the camera; drag handles",
        action: Action::Arm(Tool::Navigate),
    },
    ActionButton {
        symbol: "",
        word: "Probe",
        about: "Read the value at a point",
        action: Action::Arm(Tool::Probe),
    },
    ActionButton {
        symbol: icon::RULER,
        word: "Measure",
        about: "Measure a distance",
        action: Action::Arm(Tool::Measure(MeasureKind::Distance)),
    },
];
const LASSO: ActionButton = ActionButton {
    symbol: icon::LASSO,
    word: "Lasso",
    about: "Draw around the region to cut away",
    action: Action::Arm(Tool::LassoCut),
};
/// The renderers, and their comparison.
const RENDERERS: [ActionButton; 4] = [
    ActionButton {
        symbol: "",
        word: "Slice",
        about: "View-aligned slices",
        action: Action::SetMode(Mode::Slice),
    },
    ActionButton {
        symbol: "",
        word: "Ray",
        about: "Ray casting",
        action: Action::SetMode(Mode::Raycast),
    },
    ActionButton {
        symbol: "",
        word: "Surface",
        about: "Surfaces by their distance fields",
        action: Action::SetMode(Mode::Surface),
    },
    ActionButton {
        symbol: icon::ARROWS_LEFT_RIGHT,
        word: "Compare",
        about: "Compare renderers",
        action: Action::Compare,
    },
];

impl ActionButton {
    /// Shows the button, selected if its tool is armed or its renderer is in use.
    fn show(&self, state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
        let selected = match self.action {
            Action::Arm(tool) => state.tool == tool,
            Action::SetMode(mode) => state.doc.as_ref().is_some_and(|d| d.scene.render.mode == mode),
            _ => false,
        };
        if tool_button(
            ui,
            self.symbol,
            self.word,
            selected,
            &state.tip(self.action, self.about),
        )
        .clicked()
        {
            requests.perform(self.action);
        }
    }
}

/// Shows the most common cuts and displacements, and the menu of all kinds.
fn show_deformations(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    for (kind, word) in [
        ("half-space", "Plane"),
        ("box", "Box"),
        ("knife", "Knife"),
        ("wedge", "Wedge"),
    ] {
        kind_button(state, ui, kind, word, requests);
    }
    LASSO.show(state, ui, requests);
    ui.separator();
    for (kind, word) in [("peel", "Peel"), ("pull", "Pull"), ("twist", "Twist")] {
        kind_button(state, ui, kind, word, requests);
    }
    let more = ui.menu_button(format!("More {}", icon::CARET_DOWN), |ui| {
        show_kinds(state, ui, requests)
    });
    more.response
        .widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, "More deformations"));
}

/// Shows the buttons for undo and redo, greyed out if there is nothing to undo or redo.
fn show_undo(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    let (undo, redo) = state.doc.as_ref().map_or((false, false), |d| {
        (state.history.has_undo(&d.scene), state.history.has_redo(&d.scene))
    });
    for (works, symbol, word, action) in [
        (undo, icon::ARROW_U_UP_LEFT, "Undo", Action::Undo),
        (redo, icon::ARROW_U_UP_RIGHT, "Redo", Action::Redo),
    ] {
        let response = ui.add_enabled(works, egui::Button::new(symbol));
        labelled(&response, word, false);
        if response.on_hover_text(state.tip(action, word)).clicked() {
            requests.perform(action);
        }
    }
}

/// A button for a kind: a click arms it, and it can be dragged onto the view.
fn kind_button(state: &Workstation, ui: &mut Ui, kind: &str, word: &str, requests: &mut Requests) {
    let Ok(kind) = kinds::kind(kind) else { return };
    let tool = Tool::Place(Placed(kind));
    let tip = state.tip(
        Action::Arm(tool),
        &format!(
            "{}: {}. Click, then click the surface; or drag it there",
            words(kind.name),
            kind.about
        ),
    );
    let response = tool_button(ui, symbol(kind.name), word, state.tool == tool, &tip)
        .interact(egui::Sense::click_and_drag());
    if response.clicked() {
        requests.perform(Action::Arm(tool));
    }
    response.dnd_set_drag_payload(Placed(kind));
}

/// Shows all kinds with their pictures.
fn show_kinds(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    requests.0.push(Request::MakeThumbnails(Gallery::Kinds));
    ui.set_max_width(560.0);
    let mut armed = None;
    egui::ScrollArea::vertical().max_height(470.0).show(ui, |ui| {
        egui::Grid::new("kinds")
            .num_columns(6)
            .spacing(vec2(4.0, 4.0))
            .show(ui, |ui| {
                for (n, kind) in kinds::list().enumerate() {
                    let word = words(kind.name);
                    let response =
                        gallery_item(ui, state.thumbnails.kind(n), symbol(kind.name), &word, false);
                    response.dnd_set_drag_payload(Placed(kind));
                    if response.on_hover_text(kind.about).clicked() {
                        armed = Some(kind);
                    }
                    if (n + 1).is_multiple_of(6) {
                        ui.end_row();
                    }
                }
            });
    });
    if let Some(kind) = armed {
        let tool = match kind.name {
            "brush" => Tool::BrushPush,
            "lasso" => Tool::LassoCut,
            _ => Tool::Place(Placed(kind)),
        };
        requests.0.push(Request::Arm(tool));
        ui.close();
    }
}

/// Shows the menu: all groups of actions except Tool, Deform and Transfer.
fn show_menu(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    let has_scene = state.doc.is_some();
    for group in ["File", "Edit", "View", "Export", "Map", "Window"] {
        ui.menu_button(group, |ui| {
            ui.set_min_width(250.0);
            for entry in state.entries.iter().filter(|e| e.group == group) {
                let key = entry.key.as_ref().map(action::key_text).unwrap_or_default();
                let works = has_scene
                    || matches!(group, "Window")
                    || matches!(
                        entry.action,
                        Action::Open | Action::OpenFolder | Action::OpenHead | Action::Quit
                    );
                if ui
                    .add_enabled(works, egui::Button::new(&entry.label).shortcut_text(key))
                    .clicked()
                {
                    requests.perform(entry.action);
                }
            }
            if group == "File" && !state.session.settings.recent.is_empty() {
                ui.separator();
                for path in state.session.settings.recent.iter().take(8) {
                    let name = path.file_name().map_or_else(
                        || path.display().to_string(),
                        |n| n.to_string_lossy().into_owned(),
                    );
                    if ui
                        .button(name)
                        .on_hover_text(path.display().to_string())
                        .clicked()
                    {
                        requests.0.push(Request::Open(path.clone()));
                    }
                }
            }
        });
    }
}
