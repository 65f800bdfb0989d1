//! All properties of the selection, as numbers with their units. A double-click on a name resets
//! its value to the default.

mod light;
mod mesh;
mod picture;
mod settings;

use self::mesh::show_mesh;
use self::picture::show_picture_settings;
use self::settings::setting;
use super::icon_button;
use super::rows::{choice, name, three};
use crate::deform::kinds::{DefaultSize, Kind, Unit};
use crate::deform::quality::FieldQuality;
use crate::deform::{Argument, Storage};
use crate::gui::gizmos::{self, BoxPlacement};
use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::state::document::{Document, Selection};
use crate::gui::state::panels::Inspector;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::tool::{tidy, words};
use crate::gui::text::capital;
use crate::scene::{Deformation, Size};
use eframe::egui::{self, DragValue, RichText, Slider, Ui};
use egui_phosphor::regular as icon;
use std::path::Path;

/// Whether a field folds, and its metrics as text.
pub fn health_words(health: &FieldQuality) -> (bool, String) {
    let folds = health.folds_percent > 0.0;
    let verdict = if folds {
        format!("folds at {:.2} % of points", health.folds_percent)
    } else {
        "no folds".into()
    };
    let text = format!(
        "{verdict}; det J {:.2} to {:.2}; max displacement {:.1} mm",
        health.det_min, health.det_max, health.largest_mm
    );
    (folds, text)
}

impl Inspector {
    /// Draws the properties of the selection.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ui: &mut Ui) -> Requests {
        let mut requests = Requests::default();
        let Some(doc) = &state.doc else { return requests };
        ui.label(RichText::new(state.selection_words()).heading());
        match doc.selected {
            Selection::Deformation(n) => self.show_deformation(ui, doc, n, &mut requests),
            Selection::Volume => show_volume(ui, doc, &mut requests),
            Selection::Mesh(n) => show_mesh(ui, doc, n, &mut requests),
            Selection::Measure(_) => {
                ui.label("See the Measure panel for its values.");
            }
            Selection::Nothing => show_picture_settings(ui, doc, &mut requests),
        }
        requests
    }

    fn show_deformation(&self, ui: &mut Ui, doc: &Document, n: usize, requests: &mut Requests) {
        let (scene_box, folder) = (doc.bounds(), doc.scene.folder.clone());
        let Some(before) = doc.scene.deformation.get(n) else {
            return;
        };
        let mut deformation = before.clone();
        let d = &mut deformation;
        let kind = gizmos::kind_of(d);
        ui.horizontal(|ui| {
            ui.checkbox(&mut d.enabled, "Enabled");
            if icon_button(ui, icon::COPY, "Duplicate").clicked() {
                requests.perform(Action::Duplicate);
            }
            if icon_button(ui, icon::TRASH, "Delete").clicked() {
                requests.perform(Action::Delete);
            }
        });
        ui.horizontal(|ui| {
            ui.label("Name");
            let mut text = d.name.clone().unwrap_or_default();
            let field = ui.add(
                egui::TextEdit::singleline(&mut text)
                    .hint_text(words(&d.kind))
                    .desired_width(ui.available_width() - 10.0),
            );
            field.widget_info(|| egui::WidgetInfo::text_edit(true, "", "", "Name"));
            if field.changed() {
                d.name = (!text.is_empty()).then_some(text);
            }
        });
        ui.label(RichText::new(kind.map_or("a file's own deformation", |k| k.about)).weak());
        if name(ui, "Progress", "From none (0 %) to full (100 %)") {
            d.progress = None;
        }
        let mut percent = 100.0 * d.progress.unwrap_or(1.0);
        ui.spacing_mut().slider_width = (ui.available_width() - 72.0).max(60.0);
        let slider = ui.add(
            Slider::new(&mut percent, 0.0..=100.0)
                .clamping(egui::SliderClamping::Edits)
                .suffix(" %")
                .max_decimals(0)
                .step_by(1.0),
        );
        slider.widget_info(|| egui::WidgetInfo::slider(true, f64::from(percent), "Progress"));
        if slider.changed() {
            d.progress = Some(percent / 100.0);
        }
        if let Some(kind) = kind {
            show_numbers(ui, d, kind, &scene_box);
            show_settings(ui, d, n, kind, &folder);
            show_placement(ui, d, kind, &scene_box);
        } else {
            show_file_settings(ui, d, n, &folder);
        }
        egui::CollapsingHeader::new("Map").show(ui, |ui| show_map(ui, d));
        egui::CollapsingHeader::new("Field check").show(ui, |ui| {
            if ui.button("Check for folds").clicked() {
                requests.perform(Action::CheckField);
            }
            if let Some(text) = &self.health {
                ui.label(text);
            }
        });
        if deformation != *before {
            requests.change(move |doc| {
                if let Some(d) = doc.scene.deformation.get_mut(n) {
                    *d = deformation;
                }
            });
        }
    }
}

/// What is known of the volume.
fn show_volume(ui: &mut Ui, doc: &Document, requests: &mut Requests) {
    let volume = &doc.assets.volume;
    egui::Grid::new("volume")
        .num_columns(2)
        .spacing([10.0, 3.0])
        .show(ui, |ui| {
            let mut line = |what: &str, value: String| {
                ui.label(RichText::new(what).weak());
                ui.add(egui::Label::new(value).wrap());
                ui.end_row();
            };
            let [i, j, k] = volume.size;
            let s = volume.spacing_mm();
            line("Format", volume.format.to_owned());
            line("Voxels", format!("{i} × {j} × {k}, {}", volume.source_type));
            line("Spacing", format!("{:.3} × {:.3} × {:.3} mm", s.x, s.y, s.z));
            line("Orientation", volume.orientation());
            line(
                "Range",
                format!("{:.1} to {:.1}", volume.range[0], volume.range[1]),
            );
            if let Some(count) = volume.labels() {
                line("Labels", count.to_string());
            }
            for (what, value) in &volume.details {
                line(
                    what,
                    value.as_str().map_or_else(|| value.to_string(), str::to_owned),
                );
            }
        });
    for warning in &volume.warnings {
        ui.label(RichText::new(format!("{} {warning}", icon::WARNING)).color(ui.visuals().warn_fg_color));
    }
    ui.add_space(6.0);
    if ui
        .button("Add label map…")
        .on_hover_text("Names the region under the pointer and colours the slices")
        .clicked()
    {
        requests.0.push(Request::ChooseLabelMap);
    }
}

/// The kind's numbers with their ranges.
fn show_numbers(ui: &mut Ui, d: &mut Deformation, kind: &Kind, scene_box: &crate::math::Bounds) {
    let size = BoxPlacement::of(d, kind, scene_box).size;
    for (n, p) in kind.parameters.iter().enumerate() {
        let (value, [min, max], _) = gizmos::parameter(d, kind, n, size);
        let unit = match p.unit {
            Unit::Mm => " mm",
            Unit::Degrees => "°",
            Unit::None => "",
        };
        if name(ui, &capital(p.name), p.about) {
            d.parameters.0.remove(p.name);
        }
        let mut v = value;
        ui.spacing_mut().slider_width = (ui.available_width() - 84.0).max(60.0);
        let slider = ui.add(
            Slider::new(&mut v, min..=max)
                .clamping(egui::SliderClamping::Edits)
                .suffix(unit)
                .max_decimals(if p.unit == Unit::None { 2 } else { 1 }),
        );
        slider.widget_info(|| egui::WidgetInfo::slider(true, f64::from(v), capital(p.name)));
        if slider.changed() {
            d.parameters.insert(p.name, v.max(min).min(max));
        }
    }
}

fn show_settings(ui: &mut Ui, d: &mut Deformation, place: usize, kind: &Kind, folder: &Path) {
    if kind.name == "brush" {
        let strokes = d.parameters.texts("strokes").ok().flatten().unwrap_or_default();
        ui.label(format!(
            "{} strokes; brushes are in the Maps panel",
            strokes.len()
        ));
        if !strokes.is_empty() && ui.button("Remove last stroke").clicked() {
            let mut strokes = strokes;
            strokes.pop();
            if strokes.is_empty() {
                d.parameters.0.remove("strokes");
            } else {
                d.parameters.insert("strokes", Argument::Texts(strokes));
            }
        }
        return;
    }
    if kind.settings().next().is_some() {
        egui::CollapsingHeader::new("Settings")
            .default_open(!kind.own_settings().is_empty())
            .show(ui, |ui| {
                for s in kind.settings() {
                    setting(ui, d, place, s, folder);
                }
            });
    }
    if kind.name == "points" {
        ui.label(RichText::new("Ctrl+click the surface to add a control point, then drag it").weak());
    }
}

fn show_file_settings(ui: &mut Ui, d: &mut Deformation, place: usize, folder: &Path) {
    let kind = crate::deform::file_kinds::FILE_KINDS
        .iter()
        .find(|k| k.name == d.kind);
    for s in kind.iter().flat_map(|k| k.settings()) {
        setting(ui, d, place, s, folder);
    }
}

fn show_placement(ui: &mut Ui, d: &mut Deformation, kind: &Kind, scene_box: &crate::math::Bounds) {
    egui::CollapsingHeader::new("Placement")
        .default_open(true)
        .show(ui, |ui| {
            if d.matrix.is_some() {
                ui.label("Placed by a matrix");
                if ui.button("Use centre, size and rotation instead").clicked() {
                    d.matrix = None;
                    d.center = Some(tidy(scene_box.center()));
                }
                return;
            }
            let place = BoxPlacement::of(d, kind, scene_box);
            if name(ui, "Centre (mm)", "Centre of the box, patient LPS") {
                d.center = Some(tidy(scene_box.center()));
            }
            let mut center = tidy(place.center);
            if three(ui, &mut center, 0.5, "", "Centre") {
                d.center = Some(center);
            }
            if !matches!(kind.size, DefaultSize::Across(_)) {
                if name(ui, "Size (mm)", "Extents of the box") {
                    d.size = Some(Size::Box(tidy(kind.default_size(scene_box))));
                }
                let mut size = tidy(place.size);
                if three(ui, &mut size, 0.5, "", "Size") {
                    d.size = Some(Size::Box(size.map(|s| s.max(1.0))));
                }
            }
            if name(ui, "Turned (degrees)", "About x, then y, then z") {
                d.rotate = None;
            }
            let mut rotate = d.rotate.unwrap_or_default();
            if three(ui, &mut rotate, 0.5, "°", "Turned") {
                d.rotate = Some(rotate);
            }
        });
}

fn show_map(ui: &mut Ui, d: &mut Deformation) {
    ui.checkbox(&mut d.add, "Add to previous deformation")
        .on_hover_text("Add its displacement to the previous one's instead of applying it afterwards");
    ui.horizontal(|ui| {
        if name(ui, "Resolution", "Texels along the longest axis") {
            d.resolution = None;
        }
        let mut n = d.resolution.unwrap_or(0);
        if ui
            .add(
                DragValue::new(&mut n)
                    .range(0..=256)
                    .custom_formatter(|v, _| if v < 8.0 { "default".into() } else { v.to_string() }),
            )
            .changed()
        {
            d.resolution = (n >= 8).then_some(n);
        }
    });
    let mut storage = d.storage;
    choice(
        ui,
        "Storage format",
        &mut storage,
        &[
            (None, "default"),
            (Some(Storage::F16), "half floats"),
            (Some(Storage::Snorm16), "16-bit integers"),
            (Some(Storage::Snorm8), "8-bit integers"),
            (Some(Storage::F32), "32-bit floats"),
        ],
    );
    d.storage = storage;
}
