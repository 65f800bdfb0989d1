//! The editor of displacement maps: paint, place primitives, set control points, save to the
//! library and reuse (future work in \[DDM06\] section 9).

use super::{heading, tool_button};
use crate::deform::{Argument, compose};
use crate::files::path_text::text_of;
use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::state::panels::MapEditor;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::slice_paint::Overlay;
use crate::gui::state::tool::{Placed, Tool, symbol, tidy, words};
use crate::scene::{Deformation, Size};
use eframe::egui::{self, Context, RichText, Slider, Ui};
use egui_phosphor::regular as icon;
use std::path::Path;

impl MapEditor {
    /// Draws the panel.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ui: &mut Ui) -> Requests {
        let mut requests = Requests::default();
        heading(ui, "Paint");
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
        ui.spacing_mut().slider_width = (ui.available_width() - 128.0).max(60.0);
        let mut brush = state.brush;
        let largest = state.doc.as_ref().map_or(100.0, |d| 0.5 * d.bounds().size().max_element());
        ui.add(
            Slider::new(&mut brush.radius, 1.0..=largest.max(2.0)).clamping(egui::SliderClamping::Edits).text("radius").suffix(" mm").max_decimals(1),
        );
        ui.add(Slider::new(&mut brush.strength, 0.05..=1.0).clamping(egui::SliderClamping::Edits).text("strength").max_decimals(2));
        if brush != state.brush {
            requests.0.push(Request::SetBrush(brush));
        }
        ui.label(
            RichText::new("Brush on a slice, or on the surface in the 3D view. Strokes go into the painted map at the end of the stack.").weak(),
        );
        ui.horizontal(|ui| {
            if ui.button("New painted map").clicked() {
                requests.perform(Action::NewMap);
            }
            let mut grid = state.slices.overlay == Overlay::Grid;
            if ui.checkbox(&mut grid, "Grid on slices").changed() {
                requests.0.push(Request::SetOverlay(if grid { Overlay::Grid } else { Overlay::None }));
            }
        });
        heading(ui, "Primitives");
        ui.horizontal_wrapped(|ui| {
            for name in ["pull", "bulge", "twist", "bend", "slab", "explode", "sphere", "box", "lattice", "points", "elastic"] {
                if let Ok(kind) = crate::deform::kinds::kind(name) {
                    let tool = Tool::Place(Placed(kind));
                    let word = if name == "points" { "Control points" } else { &words(name) };
                    let button = tool_button(ui, symbol(name), word, state.tool == tool, kind.about);
                    button.interact(egui::Sense::drag()).dnd_set_drag_payload(Placed(kind));
                    if button.clicked() {
                        if name == "points" {
                            add_control_points(&mut requests);
                        } else {
                            requests.perform(Action::Arm(tool));
                        }
                    }
                }
            }
        });
        heading(ui, "Library");
        ui.horizontal_wrapped(|ui| {
            if ui.button("Save the selected one").on_hover_text("The selected deformation, as a map of its own").clicked() {
                requests.perform(Action::SaveMap);
            }
            if ui.button("Save the stack").on_hover_text("All deformations, composed into one map").clicked() {
                requests.perform(Action::StackToMap);
            }
        });
        show_library(ui, state, &mut requests);
        requests
    }
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
    let mut remove = None;
    for path in &maps {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        ui.horizontal(|ui| {
            if ui.button(format!("{} {name}", icon::PLUS)).on_hover_text("Add to this scene, scaled to fit").clicked() {
                requests.0.push(Request::UseMap(path.clone()));
            }
            if super::icon_button(ui, icon::TRASH, &format!("Remove {name} from the library")).clicked() {
                remove = Some(path.clone());
            }
        });
    }
    if let Some(path) = remove {
        // A scene may still refer to it, so it is renamed rather than deleted.
        let aside = path.with_extension("nrrd.removed");
        if let Err(e) = std::fs::rename(&path, &aside) {
            requests.0.push(Request::Report(crate::Error::io(&path, "removing", e)));
        }
    }
}

impl Workstation {
    /// Adds a map from the library, centred and rescaled if its placement does not suit this scene.
    pub fn use_map(&mut self, ctx: &Context, path: &Path) {
        let path = path.to_owned();
        self.start(ctx, "Reading a map", move |watch| {
            let image = crate::volume::load::image(&path, &Default::default(), watch)?;
            let placement = compose::placement_of(&crate::volume::GridGeometry { size: image.size, world_from_voxel: image.world_from_voxel })?;
            Ok(Box::new(move |app: &mut Workstation, _: &Context| {
                let Some(doc) = &mut app.doc else { return };
                let bounds = doc.bounds();
                let mut d = Deformation::new("map");
                d.name = path.file_stem().map(|s| s.to_string_lossy().into_owned());
                d.parameters.insert("path", text_of(&path).as_str());
                // A map whose centre lies in the scene and whose size is comparable keeps its
                // placement; otherwise it is centred and scaled to fit.
                let own = placement.world_from_map.transform_point3(glam::Vec3::splat(0.5));
                let inside = own.cmpge(bounds.min).all() && own.cmple(bounds.max).all();
                let size = placement.size_mm();
                let ratio = size.max_element() / bounds.size().max_element().max(1e-3);
                if !inside || !(0.2..=2.5).contains(&ratio) {
                    d.center = Some(tidy(bounds.center()));
                    d.size = Some(Size::Box(tidy(size / size.max_element() * bounds.size().max_element())));
                }
                doc.add(d);
            }))
        });
    }
}
