//! All properties of the selection, as numbers with their units. A double-click on a name resets
//! its value to the default.

use super::{heading, icon_button};
use crate::deform::kinds::{DefaultSize, Kind, Setting, SettingFormat, Unit};
use crate::deform::quality::FieldQuality;
use crate::deform::{Argument, Storage};
use crate::files::path_text::path_of;
use crate::gui::gizmos::{self, BoxPlacement};
use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::state::document::{Document, Selection};
use crate::gui::state::panels::Inspector;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::tool::{tidy, words};
use crate::gui::text::capital;
use crate::scene::surface::{CutModel, Look};
use crate::scene::{CutFaces, Deformation, Mode, Normals, Projection, Size};
use crate::volume::GradientFilter;
use eframe::egui::{self, DragValue, RichText, Slider, Ui};
use egui_phosphor::regular as icon;
use std::path::Path;

/// Whether a field folds, and its metrics as text.
pub fn health_words(health: &FieldQuality) -> (bool, String) {
    let folds = health.folds_percent > 0.0;
    let verdict = if folds { format!("folds at {:.2} % of points", health.folds_percent) } else { "no folds".into() };
    let text = format!("{verdict}; det J {:.2} to {:.2}; max displacement {:.1} mm", health.det_min, health.det_max, health.largest_mm);
    (folds, text)
}

/// A name whose double-click resets its value to the default.
fn label(ui: &mut Ui, text: &str, about: &str) -> egui::Response {
    let label = ui.add(egui::Label::new(text).sense(egui::Sense::click()));
    label.on_hover_text(format!("{about}\nDouble-click: back to the default"))
}

/// The same; returns whether the reset was requested.
fn name(ui: &mut Ui, text: &str, about: &str) -> bool {
    label(ui, text, about).double_clicked()
}

/// A row of three numbers.
fn three(ui: &mut Ui, values: &mut [f32; 3], speed: f32, suffix: &str, label: &str) -> bool {
    let mut changed = false;
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        for (axis, v) in ["x", "y", "z"].into_iter().zip(values) {
            let response = ui.add(DragValue::new(v).speed(speed).max_decimals(2).suffix(suffix).range(-1e5..=1e5).clamp_existing_to_range(false));
            response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::DragValue, true, format!("{label} {axis}")));
            changed |= response.changed();
        }
    });
    changed
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
        let Some(before) = doc.scene.deformation.get(n) else { return };
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
            let field = ui.add(egui::TextEdit::singleline(&mut text).hint_text(words(&d.kind)).desired_width(ui.available_width() - 10.0));
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
        let slider = ui.add(Slider::new(&mut percent, 0.0..=100.0).clamping(egui::SliderClamping::Edits).suffix(" %").max_decimals(0).step_by(1.0));
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
    egui::Grid::new("volume").num_columns(2).spacing([10.0, 3.0]).show(ui, |ui| {
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
        line("Range", format!("{:.1} to {:.1}", volume.range[0], volume.range[1]));
        if let Some(count) = volume.labels() {
            line("Labels", count.to_string());
        }
        for (what, value) in &volume.details {
            line(what, value.as_str().map_or_else(|| value.to_string(), str::to_owned));
        }
    });
    for warning in &volume.warnings {
        ui.label(RichText::new(format!("{} {warning}", icon::WARNING)).color(ui.visuals().warn_fg_color));
    }
    ui.add_space(6.0);
    if ui.button("Add label map…").on_hover_text("Names the region under the pointer and colours the slices").clicked() {
        requests.0.push(Request::ChooseLabelMap);
    }
}

/// A mesh's look and place.
fn show_mesh(ui: &mut Ui, doc: &Document, n: usize, requests: &mut Requests) {
    let general = doc.scene.surface.appearance.clone();
    let mesh_box = doc.assets.mesh_box;
    let Some(before) = doc.scene.mesh.get(n) else { return };
    let mut mesh = before.clone();
    ui.horizontal(|ui| {
        let mut shown = !mesh.hidden;
        if ui.checkbox(&mut shown, "Visible").changed() {
            mesh.hidden = !shown;
        }
        if icon_button(ui, icon::TRASH, "Delete").clicked() {
            requests.0.push(Request::PerformOn(Selection::Mesh(n), Action::Delete));
        }
    });
    ui.checkbox(&mut mesh.rigid, "Not deformed");
    let look: Option<Look> = mesh.appearance.resolve(&general).ok();
    ui.horizontal(|ui| {
        ui.label("Look");
        let now = mesh.appearance.look.clone().unwrap_or_else(|| "default".into());
        egui::ComboBox::from_id_salt("look").selected_text(now).show_ui(ui, |ui| {
            for look in crate::scene::surface::look_names() {
                if ui.selectable_label(mesh.appearance.look.as_deref() == Some(look), look).clicked() {
                    let a = &mut mesh.appearance;
                    (a.look, a.color, a.inside_color, a.cut_color) = (Some(look.to_owned()), None, None, None);
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
            color(ui, "Outside", look.color, &mut mesh.appearance.color);
            color(ui, "Inside", look.inside, &mut mesh.appearance.inside_color);
            color(ui, "Cut", look.cut, &mut mesh.appearance.cut_color);
        });
    }
    ui.horizontal(|ui| {
        ui.label("Interior");
        for (model, word) in [(CutModel::Hollow, "hollow"), (CutModel::Thick, "thick"), (CutModel::Solid, "solid")] {
            if ui.selectable_label(mesh.appearance.model == Some(model), word).clicked() {
                mesh.appearance.model = Some(model);
            }
        }
    });
    heading(ui, "Placement");
    if name(ui, "Centre (mm)", "Centre of the mesh, patient LPS") {
        mesh.place.center = None;
    }
    match &mut mesh.place.center {
        Some(center) => {
            three(ui, center, 0.5, "", "Centre");
        }
        None if ui.button("Move").on_hover_text("Currently placed by its file").clicked() => mesh.place.center = Some(tidy(mesh_box.center())),
        None => {}
    }
    if name(ui, "Turned (degrees)", "About x, then y, then z") {
        mesh.place.rotate = None;
    }
    let mut rotate = mesh.place.rotate.unwrap_or_default();
    if three(ui, &mut rotate, 0.5, "°", "Turned") {
        mesh.place.rotate = Some(rotate);
    }
    if mesh != *before {
        requests.change(move |doc| {
            if let Some(m) = doc.scene.mesh.get_mut(n) {
                *m = mesh;
            }
        });
    }
}

/// How the picture is made: sampling, shading, light, camera.
fn show_picture_settings(ui: &mut Ui, doc: &Document, requests: &mut Requests) {
    let assets = &doc.assets;
    let mut scene = doc.scene.clone();
    let has_volume = assets.has_volume;
    let render = &mut scene.render;
    ui.spacing_mut().slider_width = (ui.available_width() - 128.0).max(60.0);
    let slider = |ui: &mut Ui, v: &mut f32, range: std::ops::RangeInclusive<f32>, word: &str, tip: &str| {
        ui.add(Slider::new(v, range).clamping(egui::SliderClamping::Edits).text(word).max_decimals(2)).on_hover_text(tip);
    };
    ui.add(Slider::new(&mut render.step, 0.1..=4.0).clamping(egui::SliderClamping::Edits).logarithmic(true).text("step").max_decimals(2))
        .on_hover_text("Step length: distance between samples, in voxels");
    let mut antialias = render.antialias;
    ui.add(Slider::new(&mut antialias, 1..=4).clamping(egui::SliderClamping::Edits).text("antialias"))
        .on_hover_text("Samples averaged along each edge of a pixel");
    render.antialias = antialias;
    if has_volume {
        choice(
            ui,
            "Shading",
            &mut render.normals,
            &[
                (Normals::Blended, "gradients, blended into cut normals"),
                (Normals::Transformed, "transformed gradients"),
                (Normals::Source, "source gradients"),
                (Normals::None, "none (unshaded)"),
            ],
        );
        choice(ui, "Gradients", &mut render.gradient, &[(GradientFilter::Central, "central differences"), (GradientFilter::Sobel, "Sobel")]);
        choice(
            ui,
            "Cut faces",
            &mut render.cut_faces,
            &[(CutFaces::Lit, "shaded by the transfer function"), (CutFaces::Grey, "grey values, unshaded")],
        );
        let mut iso = render.iso.is_some();
        ui.horizontal(|ui| {
            if ui.checkbox(&mut iso, "Iso-surface at").changed() {
                render.iso = iso.then(|| assets.volume.body_threshold());
            }
            if let Some(v) = &mut render.iso {
                let speed = (assets.volume.range[1] - assets.volume.range[0]) / 400.0;
                ui.add(DragValue::new(v).speed(speed).max_decimals(2));
            }
        });
        ui.checkbox(&mut render.exact_cuts, "Exact cuts").on_hover_text("Cuts at the end of the stack as formulas instead of masks");
    }
    if render.mode == Mode::Surface && has_volume {
        ui.horizontal(|ui| {
            ui.label("Iso-value");
            let mut v = scene.surface.iso.unwrap_or_else(|| assets.volume.body_threshold());
            if ui.add(DragValue::new(&mut v).max_decimals(2)).changed() {
                scene.surface.iso = Some(v);
            }
        });
    }
    heading(ui, "Light");
    slider(ui, &mut scene.light.ambient, 0.0..=1.0, "ambient", "Ambient light");
    slider(ui, &mut scene.light.diffuse, 0.0..=1.0, "diffuse", "Diffuse reflection of the light");
    slider(ui, &mut scene.light.specular, 0.0..=1.0, "specular", "Strength of the specular highlight");
    slider(ui, &mut scene.light.shininess, 1.0..=200.0, "shininess", "Specular exponent; higher is tighter");
    ui.checkbox(&mut scene.light.follows_camera, "Headlight (moves with the camera)");
    heading(ui, "Camera");
    choice(ui, "Projection", &mut scene.camera.projection, &[(Projection::Perspective, "perspective"), (Projection::Orthographic, "orthographic")]);
    slider(ui, &mut scene.camera.field_of_view, 5.0..=100.0, "field of view", "Vertical field of view in degrees");
    ui.horizontal(|ui| {
        ui.label("Background");
        let [r, g, b, a] = scene.render.background;
        let mut color = [r, g, b];
        if ui.color_edit_button_rgb(&mut color).changed() {
            scene.render.background = [color[0], color[1], color[2], a];
        }
        let mut clear = a < 1.0;
        if ui.checkbox(&mut clear, "transparent").changed() {
            scene.render.background[3] = if clear { 0.0 } else { 1.0 };
        }
    });
    if scene != doc.scene {
        requests.change(move |doc| doc.scene = scene);
    }
}

fn choice<T: PartialEq + Copy>(ui: &mut Ui, word: &str, value: &mut T, all: &[(T, &str)]) {
    ui.horizontal(|ui| {
        ui.label(word);
        let now = all.iter().find(|(v, _)| v == value).map_or("", |(_, w)| w);
        let combo = egui::ComboBox::from_id_salt(word).selected_text(now).show_ui(ui, |ui| {
            for (v, w) in all {
                ui.selectable_value(value, *v, *w);
            }
        });
        combo.response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::ComboBox, true, word));
    });
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
        let slider =
            ui.add(Slider::new(&mut v, min..=max).clamping(egui::SliderClamping::Edits).suffix(unit).max_decimals(if p.unit == Unit::None {
                2
            } else {
                1
            }));
        slider.widget_info(|| egui::WidgetInfo::slider(true, f64::from(v), capital(p.name)));
        if slider.changed() {
            d.parameters.insert(p.name, v.max(min).min(max));
        }
    }
}

/// A setting as text: numbers, lists or words.
fn setting_text(argument: Option<&Argument>) -> String {
    let joined = |v: &[f32]| v.iter().map(f32::to_string).collect::<Vec<_>>().join(", ");
    match argument {
        None => String::new(),
        Some(Argument::Flag(v)) => v.to_string(),
        Some(Argument::Number(v)) => v.to_string(),
        Some(Argument::Text(t)) => t.clone(),
        Some(Argument::Numbers(v)) => joined(v),
        Some(Argument::Texts(t)) => t.join(", "),
        Some(Argument::Rows(rows)) => rows.iter().map(|r| joined(r)).collect::<Vec<_>>().join("; "),
    }
}

/// Invalid text typed into a field.
#[derive(Clone)]
struct RejectedInput {
    text: String,
    problem: String,
    /// The setting's value at that time: the rejection is cleared if the setting changes by other
    /// means.
    current_text: String,
}

/// Parses the text of a setting; files are looked for in the scene's folder.
fn typed(setting: &Setting, text: &str, folder: &Path) -> Result<Option<Argument>, String> {
    let argument = setting.parse(text)?;
    for file in argument.iter().flat_map(|a| setting.files(a)).filter(|f| !f.starts_with("phantom:")) {
        if !folder.join(path_of(file)).exists() {
            return Err(format!(
                "{file}: file not found in {}",
                if folder.as_os_str().is_empty() { "the current folder".into() } else { folder.display().to_string() }
            ));
        }
    }
    Ok(argument)
}

/// A setting: a checkbox, a list, or a text field that is applied when it loses focus. Invalid text
/// is rejected with the reason next to it.
fn setting(ui: &mut Ui, d: &mut Deformation, place: usize, setting: &Setting, folder: &Path) {
    let key = setting.name;
    match setting.form {
        SettingFormat::Flag => {
            let mut on = d.parameters.flag(key).unwrap_or(false);
            if ui.checkbox(&mut on, capital(key)).on_hover_text(setting.about).changed() {
                d.parameters.0.remove(key);
                if on {
                    d.parameters.insert(key, Argument::Flag(true));
                }
            }
        }
        SettingFormat::Choice(all) | SettingFormat::OneOf(all) => {
            let default = matches!(setting.form, SettingFormat::Choice(_)).then(|| all[0]);
            let now = setting_text(d.parameters.0.get(key));
            let shown = if now.is_empty() { default.unwrap_or("from the file") } else { &now };
            ui.horizontal(|ui| {
                if name(ui, &capital(key), setting.about) {
                    d.parameters.0.remove(key);
                }
                let combo = egui::ComboBox::from_id_salt((place, key)).selected_text(shown).show_ui(ui, |ui| {
                    if default.is_none() && ui.selectable_label(now.is_empty(), "from the file").clicked() {
                        d.parameters.0.remove(key);
                    }
                    for word in all {
                        if ui.selectable_label(shown == *word, *word).clicked() {
                            d.parameters.0.remove(key);
                            if default != Some(*word) {
                                d.parameters.insert(key, *word);
                            }
                        }
                    }
                });
                combo.response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::ComboBox, true, capital(key)));
            });
        }
        _ => text_setting(ui, d, place, setting, folder),
    }
}

fn text_setting(ui: &mut Ui, d: &mut Deformation, place: usize, setting: &Setting, folder: &Path) {
    let key = setting.name;
    let id = ui.id().with(("setting", place, &d.kind, key));
    let refused_id = id.with("refused");
    let current_text = setting_text(d.parameters.0.get(key));
    let refused = ui.data(|m| m.get_temp::<RejectedInput>(refused_id)).filter(|r| r.current_text == current_text);
    let typed_before = ui.data(|m| m.get_temp::<String>(id));
    let mut text = typed_before.or_else(|| refused.as_ref().map(|r| r.text.clone())).unwrap_or_else(|| current_text.clone());
    ui.horizontal(|ui| {
        let name = label(ui, &capital(key), setting.about);
        if name.double_clicked() {
            d.parameters.0.remove(key);
            ui.data_mut(|m| m.remove::<RejectedInput>(refused_id));
            text.clear();
        }
        let mut edit = egui::TextEdit::singleline(&mut text).desired_width((ui.available_width() - 10.0).max(30.0));
        if refused.is_some() {
            edit = edit.text_color(ui.visuals().error_fg_color);
        }
        let field = ui.add(edit).labelled_by(name.id);
        if field.has_focus() {
            ui.data_mut(|m| m.insert_temp(id, text.clone()));
        } else {
            ui.data_mut(|m| m.remove::<String>(id));
        }
        if field.lost_focus() {
            ui.data_mut(|m| m.remove::<RejectedInput>(refused_id));
            match typed(setting, &text, folder) {
                _ if text == current_text => {}
                Ok(Some(argument)) => d.parameters.insert(key, argument),
                Ok(None) => {
                    d.parameters.0.remove(key);
                }
                Err(problem) => {
                    let refused = RejectedInput { text, problem, current_text: current_text.clone() };
                    ui.data_mut(|m| m.insert_temp(refused_id, refused));
                }
            }
        }
    });
    if let Some(RejectedInput { problem, .. }) = refused {
        let again = if current_text.is_empty() { "The setting is empty.".to_owned() } else { format!("The setting is still {current_text}.") };
        ui.label(RichText::new(format!("{problem}. {again}")).color(ui.visuals().error_fg_color));
    }
}

fn show_settings(ui: &mut Ui, d: &mut Deformation, place: usize, kind: &Kind, folder: &Path) {
    if kind.name == "brush" {
        let strokes = d.parameters.texts("strokes").ok().flatten().unwrap_or_default();
        ui.label(format!("{} strokes; brushes are in the Maps panel", strokes.len()));
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
        egui::CollapsingHeader::new("Settings").default_open(!kind.own_settings().is_empty()).show(ui, |ui| {
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
    let kind = crate::deform::file_kinds::FILE_KINDS.iter().find(|k| k.name == d.kind);
    for s in kind.iter().flat_map(|k| k.settings) {
        setting(ui, d, place, s, folder);
    }
}

fn show_placement(ui: &mut Ui, d: &mut Deformation, kind: &Kind, scene_box: &crate::math::Bounds) {
    egui::CollapsingHeader::new("Placement").default_open(true).show(ui, |ui| {
        if d.matrix.is_some() {
            ui.label("Placed by a matrix");
            if ui.button("Use centre, size and rotation instead").clicked() {
                d.matrix = None;
            }
            return;
        }
        let place = BoxPlacement::of(d, kind, scene_box);
        if name(ui, "Centre (mm)", "Centre of the box, patient LPS") {
            d.center = None;
        }
        let mut center = tidy(place.center);
        if three(ui, &mut center, 0.5, "", "Centre") {
            d.center = Some(center);
        }
        if !matches!(kind.size, DefaultSize::Across(_)) {
            if name(ui, "Size (mm)", "Extents of the box") {
                d.size = None;
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
        if ui.add(DragValue::new(&mut n).range(0..=256).custom_formatter(|v, _| if v < 8.0 { "default".into() } else { v.to_string() })).changed() {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The text that a field shows can be parsed back.
    #[test]
    fn settings_survive_their_text() {
        for (form, argument) in [
            (SettingFormat::Flag, Argument::Flag(true)),
            (SettingFormat::Number, Argument::Number(2.5)),
            (SettingFormat::Whole, Argument::Numbers(vec![1.0, 2.0])),
            (SettingFormat::Rows(3), Argument::Numbers(vec![1.0, 2.0, -3.5])),
            (SettingFormat::Words, Argument::Text("left side".into())),
            (SettingFormat::File, Argument::Text("labels.nii.gz".into())),
            (SettingFormat::Files, Argument::Texts(vec!["a.mat".into(), "b.nii".into()])),
        ] {
            let setting = Setting { name: "x", form, about: "" };
            assert_eq!(setting.parse(&setting_text(Some(&argument))), Ok(Some(argument)));
        }
    }

    #[test]
    fn files_are_looked_for() {
        let folder = tempfile::tempdir().unwrap();
        let setting = Setting { name: "labels", form: SettingFormat::File, about: "" };
        assert!(typed(&setting, "labels.nii", folder.path()).is_err_and(|e| e.contains("file not found")));
        std::fs::write(folder.path().join("labels.nii"), "").unwrap();
        assert_eq!(typed(&setting, "labels.nii", folder.path()), Ok(Some(Argument::Text("labels.nii".into()))));
        assert!(typed(&setting, "phantom:octants", folder.path()).is_ok());
    }
}
