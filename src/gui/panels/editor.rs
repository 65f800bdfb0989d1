//! The editor of displacement maps: paint, place primitives, set control points, save to the
//! library and reuse (future work in \[DDM06\] section 9).

use super::{heading, tool_button};
use crate::deform::Argument;
use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::state::panels::MapEditor;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::slice_paint::Overlay;
use crate::gui::state::tool::{Placed, Tool, symbol, tidy, words};
use crate::scene::Deformation;
use eframe::egui::{self, RichText, Slider, Ui};
use egui_phosphor::regular as icon;

impl MapEditor {
    /// Draws the panel.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ui: &mut Ui) -> Requests {
        let mut requests = Requests::default();
        heading(ui, "Paint");
        show_paint_tools(state, ui, &mut requests);
        show_brush(state, ui, &mut requests);
        ui.label(
            RichText::new("Brush on a slice, or on the surface in the 3D view. Strokes go into the painted map at the end of the stack.").weak(),
        );
        ui.horizontal(|ui| {
            if ui.button("New painted map").clicked() {
                requests.perform(Action::NewMap);
            }
            let mut grid = state.slices.overlay == Overlay::Grid;
            if ui.checkbox(&mut grid, "Grid on slices").changed() {
                requests.0.push(Request::SetOverlay(if grid {
                    Overlay::Grid
                } else {
                    Overlay::None
                }));
            }
        });
        heading(ui, "Primitives");
        show_primitives(state, ui, &mut requests);
        heading(ui, "Library");
        ui.horizontal_wrapped(|ui| {
            if ui
                .button("Save the selected one")
                .on_hover_text("The selected deformation, as a map of its own")
                .clicked()
            {
                requests.perform(Action::SaveMap);
            }
            if ui
                .button("Save the stack")
                .on_hover_text("All deformations, composed into one map")
                .clicked()
            {
                requests.perform(Action::StackToMap);
            }
        });
        show_library(ui, state, &mut requests);
        requests
    }
}

/// Buttons for the brushes and lassos.
fn show_paint_tools(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    ui.horizontal_wrapped(|ui| {
        for (tool, word, symbol) in [
            (Tool::BrushPush, "Push", icon::HAND_POINTING),
            (Tool::BrushSmooth, "Smooth", icon::WAVES),
            (Tool::BrushCut, "Cut", icon::SCISSORS),
            (Tool::BrushRestore, "Restore", icon::ERASER),
            (Tool::LassoCut, "Lasso cut", icon::LASSO),
            (Tool::LassoRestore, "Lasso restore", icon::LASSO),
        ] {
            if tool_button(ui, symbol, word, state.tool == tool, &tool.hint()).clicked() {
                requests.perform(Action::Arm(tool));
            }
        }
    });
}

/// Radius and strength of the brush.
fn show_brush(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    ui.spacing_mut().slider_width = (ui.available_width() - 128.0).max(60.0);
    let mut brush = state.brush;
    let largest = state
        .doc
        .as_ref()
        .map_or(100.0, |d| 0.5 * d.bounds().size().max_element());
    ui.add(
        Slider::new(&mut brush.radius, 1.0..=largest.max(2.0))
            .clamping(egui::SliderClamping::Edits)
            .text("radius")
            .suffix(" mm")
            .max_decimals(1),
    );
    ui.add(
        Slider::new(&mut brush.strength, 0.05..=1.0)
            .clamping(egui::SliderClamping::Edits)
            .text("strength")
            .max_decimals(2),
    );
    if brush != state.brush {
        requests.0.push(Request::SetBrush(brush));
    }
}

/// Buttons for the kinds that maps are made of; each can also be dragged onto the view.
fn show_primitives(state: &Workstation, ui: &mut Ui, requests: &mut Requests) {
    ui.horizontal_wrapped(|ui| {
        for name in [
            "pull", "bulge", "twist", "bend", "slab", "explode", "sphere", "box", "lattice", "points",
            "elastic",
        ] {
            if let Ok(kind) = crate::deform::kinds::kind(name) {
                let tool = Tool::Place(Placed(kind));
                let word = if name == "points" {
                    "Control points"
                } else {
                    &words(name)
                };
                let button = tool_button(ui, symbol(name), word, state.tool == tool, kind.about);
                button
                    .interact(egui::Sense::drag())
                    .dnd_set_drag_payload(Placed(kind));
                if button.clicked() {
                    if name == "points" {
                        add_control_points(requests);
                    } else {
                        requests.perform(Action::Arm(tool));
                    }
                }
            }
        }
    });
}

/// Adds an empty set of control points over the whole scene.
fn add_control_points(requests: &mut Requests) {
    requests.change(|doc| {
        let mut d = Deformation::new("points");
        // A point that stays in place, so that the first point to be dragged has a neighbour.
        let c = tidy(doc.bounds().center());
        d.parameters.insert("pairs", Argument::Numbers([c, c].concat()));
        doc.add(d);
    });
    requests.0.push(Request::SetTool(Tool::Navigate));
}

/// The saved maps, each to be used or removed.
fn show_library(ui: &mut Ui, state: &Workstation, requests: &mut Requests) {
    let maps = state.session.maps();
    if maps.is_empty() {
        ui.label(RichText::new("No saved maps yet. A saved map can be used on any volume.").weak());
    }
    for path in &maps {
        let name = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        ui.horizontal(|ui| {
            if ui
                .button(format!("{} {name}", icon::PLUS))
                .on_hover_text("Add to this scene, scaled to fit")
                .clicked()
            {
                requests.0.push(Request::UseMap(path.clone()));
            }
            if super::icon_button(ui, icon::TRASH, &format!("Remove {name} from the library")).clicked() {
                requests.0.push(Request::RemoveMap(path.clone()));
            }
        });
    }
}
