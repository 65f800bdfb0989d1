//! The appearance and placement of a mesh.

use crate::gui::panels::rows::{name, three};
use crate::gui::panels::{heading, icon_button};
use crate::gui::state::action::Action;
use crate::gui::state::document::{Document, Selection};
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::tool::tidy;
use crate::math::Bounds;
use crate::scene::surface::{Appearance, CutModel, Look, MeshPlace};
use eframe::egui::{self, Ui};
use egui_phosphor::regular as icon;

/// A mesh's look and place.
pub(super) fn show_mesh(ui: &mut Ui, doc: &Document, n: usize, requests: &mut Requests) {
    let Some(before) = doc.scene.mesh.get(n) else {
        return;
    };
    let mut mesh = before.clone();
    ui.horizontal(|ui| {
        let mut shown = !mesh.hidden;
        if ui.checkbox(&mut shown, "Visible").changed() {
            mesh.hidden = !shown;
        }
        if icon_button(ui, icon::TRASH, "Delete").clicked() {
            requests
                .0
                .push(Request::PerformOn(Selection::Mesh(n), Action::Delete));
        }
    });
    ui.checkbox(&mut mesh.rigid, "Not deformed");
    show_look(ui, &mut mesh.appearance, &doc.scene.surface.appearance);
    show_interior(ui, &mut mesh.appearance);
    show_placement(ui, &mut mesh.place, &doc.assets.mesh_box);
    if mesh != *before {
        requests.change(move |doc| {
            if let Some(m) = doc.scene.mesh.get_mut(n) {
                *m = mesh;
            }
        });
    }
}

/// The preset and the colours; `general` is the scene's default appearance of meshes.
fn show_look(ui: &mut Ui, appearance: &mut Appearance, general: &Appearance) {
    let look: Option<Look> = appearance.resolve(general).ok();
    ui.horizontal(|ui| {
        ui.label("Look");
        let now = appearance.look.clone().unwrap_or_else(|| "default".into());
        egui::ComboBox::from_id_salt("look")
            .selected_text(now)
            .show_ui(ui, |ui| {
                for look in crate::scene::surface::look_names() {
                    if ui
                        .selectable_label(appearance.look.as_deref() == Some(look), look)
                        .clicked()
                    {
                        let a = &mut *appearance;
                        (a.look, a.color, a.inside_color, a.cut_color) =
                            (Some(look.to_owned()), None, None, None);
                    }
                }
            });
    });
    if let Some(look) = look {
        ui.horizontal(|ui| {
            let color = |ui: &mut Ui, word: &str, now: [f32; 3], set: &mut Option<[f32; 3]>| {
                let mut c = now;
                ui.label(word);
                if ui.color_edit_button_rgb(&mut c).changed() {
                    *set = Some(c);
                }
            };
            color(ui, "Outside", look.color, &mut appearance.color);
            color(ui, "Inside", look.inside, &mut appearance.inside_color);
            color(ui, "Cut", look.cut, &mut appearance.cut_color);
        });
    }
}

/// Whether cuts show the mesh as hollow, as a thick wall, or as solid.
fn show_interior(ui: &mut Ui, appearance: &mut Appearance) {
    ui.horizontal(|ui| {
        ui.label("Interior");
        for (model, word) in [
            (CutModel::Hollow, "hollow"),
            (CutModel::Thick, "thick"),
            (CutModel::Solid, "solid"),
        ] {
            if ui
                .selectable_label(appearance.model == Some(model), word)
                .clicked()
            {
                appearance.model = Some(model);
            }
        }
    });
}

/// The centre and rotation of a mesh.
fn show_placement(ui: &mut Ui, place: &mut MeshPlace, mesh_box: &Bounds) {
    heading(ui, "Placement");
    if name(ui, "Centre (mm)", "Centre of the mesh, patient LPS") {
        place.center = None;
    }
    match &mut place.center {
        Some(center) => {
            three(ui, center, 0.5, "", "Centre");
        }
        None if ui
            .button("Move")
            .on_hover_text("Currently placed by its file")
            .clicked() =>
        {
            place.center = Some(tidy(mesh_box.center()))
        }
        None => {}
    }
    if name(ui, "Turned (degrees)", "About x, then y, then z") {
        place.rotate = None;
    }
    let mut rotate = place.rotate.unwrap_or_default();
    if three(ui, &mut rotate, 0.5, "°", "Turned") {
        place.rotate = Some(rotate);
    }
}
