//! All interface elements other than the pictures: the toolbar, the panels, the status bar, the
//! empty window.

pub mod compare;
pub mod dialogs;
pub mod editor;
pub mod inspector;
pub mod measures;
mod misplaced;
pub mod palette;
pub mod scene;
pub mod transfer;

use super::state::Workstation;
use super::state::action::{self, Action};
use super::state::document::Selection;
use super::state::session::EXAMPLES;
use super::state::slices::Space;
use super::state::tool::{Placed, Tool, symbol, words};
use super::state::worker::{JobKind, JobTarget};
use super::theme;
use crate::deform::kinds;
use crate::engine::{Backend, Quality};
use crate::gui::state::slice_paint::{self, Overlay};
use crate::scene::measure::MeasureKind;
use crate::scene::{Mode, Scene, example};
use crate::transfer::{TransferSettings, list as presets};
use eframe::egui::{self, Align, Color32, Context, Layout, Response, RichText, TextureHandle, Ui, WidgetInfo, WidgetType, vec2};
use egui_phosphor::regular as icon;
use std::sync::Arc;

/// Edge of a thumbnail, pixels.
const THUMBNAIL: u32 = 112;

/// A button with an icon and a word; assistive technology receives the word alone.
pub fn tool_button(ui: &mut Ui, symbol: &str, word: &str, selected: bool, tip: &str) -> Response {
    let text = if symbol.is_empty() { word.to_owned() } else { format!("{symbol} {word}") };
    let response = ui.add(egui::Button::selectable(selected, text));
    labelled(&response, word, selected);
    if tip.is_empty() { response } else { response.on_hover_text(tip) }
}

/// A button with an icon alone.
pub fn icon_button(ui: &mut Ui, symbol: &str, word: &str) -> Response {
    let response = ui.add(egui::Button::new(symbol).frame(false).min_size(vec2(22.0, 22.0)));
    labelled(&response, word, false);
    response.on_hover_text(word)
}

fn labelled(response: &Response, word: &str, selected: bool) {
    let enabled = response.enabled();
    response.widget_info(|| WidgetInfo::selected(WidgetType::Button, enabled, selected, word));
}

/// A heading within a panel.
pub fn heading(ui: &mut Ui, text: &str) {
    ui.add_space(4.0);
    ui.label(RichText::new(text).strong());
}

impl Workstation {
    /// The selected backend.
    pub fn backend(&self) -> Backend {
        self.forced_backend.unwrap_or(self.session.settings.backend)
    }

    /// Requests thumbnails once the view is at rest.
    pub(super) fn refresh_thumbnails(&mut self) {
        let Some(doc) = &self.doc else { return };
        if !self.view.is_fine || !doc.assets.has_volume {
            return;
        }
        let key = (Arc::as_ptr(&doc.assets) as usize, doc.scene.volume_name().to_owned());
        if self.thumbnails.requested_key.as_ref() != Some(&key) {
            let (presets, kinds) = (self.thumbnails.shows_presets, self.thumbnails.shows_kinds);
            self.thumbnails.forget();
            self.thumbnails.requested_key = Some(key);
            (self.thumbnails.shows_presets, self.thumbnails.shows_kinds) = (presets, kinds);
        }
        let mut jobs = Vec::new();
        let assets = doc.assets.clone();
        let mut plain = Scene { deformation: Vec::new(), mesh: Vec::new(), measure: Vec::new(), ..doc.scene.clone() };
        plain.render = crate::scene::RenderSettings { size: [THUMBNAIL; 2], step: 2.0, ..Default::default() };
        plain.camera = crate::scene::Camera { view: "35,20".parse().unwrap_or(plain.camera.view), ..Default::default() };
        if self.thumbnails.shows_presets {
            for (n, preset) in presets().enumerate() {
                if self.thumbnails.presets.contains_key(&n) || self.thumbnails.open.contains(&JobTarget::Preset(n)) {
                    continue;
                }
                let mut scene = plain.clone();
                scene.transfer = TransferSettings { preset: Some(preset.name.into()), ..Default::default() };
                jobs.push((JobTarget::Preset(n), scene));
            }
        }
        if self.thumbnails.shows_kinds {
            let bounds = assets.volume.bounds_in_world();
            for (n, kind) in kinds::list().enumerate() {
                if self.thumbnails.kinds.contains_key(&n) || self.thumbnails.open.contains(&JobTarget::Kind(n)) {
                    continue;
                }
                let mut scene = plain.clone();
                let shown = example::of_kind(kind, scene.volume_name(), THUMBNAIL, &bounds);
                scene.deformation = shown.deformation;
                scene.camera = shown.camera;
                scene.transfer = doc.scene.transfer.clone();
                jobs.push((JobTarget::Kind(n), scene));
            }
        }
        for (target, scene) in jobs {
            self.thumbnails.open.push(target);
            self.submit(target, Arc::new(scene), assets.clone(), JobKind::Picture { counting: false, with_pixels: false, quality: Quality::Full });
        }
    }

    fn tip(&self, action: Action, about: &str) -> String {
        let key = self.entries.iter().find(|e| e.action == action).and_then(|e| e.key.as_ref());
        match key {
            Some(key) => format!("{about} ({})", action::key_text(key)),
            None => about.to_owned(),
        }
    }

    /// Shows the bar at the top.
    pub(super) fn show_toolbar(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        egui::Panel::top("toolbar").frame(egui::Frame::NONE.fill(ui.visuals().panel_fill).inner_margin(egui::Margin::symmetric(8, 5))).show(
            ui,
            |ui| {
                ui.horizontal(|ui| {
                    ui.spacing_mut().item_spacing.x = 1.0;
                    ui.spacing_mut().button_padding.x = 6.0;
                    ui.menu_button(format!("{} Menu", icon::LIST), |ui| self.show_menu(ui))
                        .response
                        .widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, "Menu"));
                    let mut wanted = Vec::new();
                    let button =
                        |app: &Self, ui: &mut Ui, symbol: &str, word: &str, action: Action, about: &str, selected: bool, wanted: &mut Vec<Action>| {
                            if tool_button(ui, symbol, word, selected, &app.tip(action, about)).clicked() {
                                wanted.push(action);
                            }
                        };
                    button(self, ui, icon::FOLDER_OPEN, "Open", Action::Open, "Open a scene, volume or mesh", false, &mut wanted);
                    if self.doc.is_some() {
                        button(self, ui, icon::FLOPPY_DISK, "Save", Action::Save, "Save the scene", false, &mut wanted);
                        ui.separator();
                        let armed = self.tool;
                        let is = |tool: Tool| armed == tool;
                        button(self, ui, "", "Orbit", Action::Arm(Tool::Navigate), "Orbit the camera; drag handles", is(Tool::Navigate), &mut wanted);
                        button(self, ui, "", "Probe", Action::Arm(Tool::Probe), "Read the value at a point", is(Tool::Probe), &mut wanted);
                        let measure = Tool::Measure(MeasureKind::Distance);
                        button(self, ui, icon::RULER, "Measure", Action::Arm(measure), "Measure a distance", is(measure), &mut wanted);
                        ui.separator();
                        for (kind, word) in [("half-space", "Plane"), ("box", "Box"), ("knife", "Knife"), ("wedge", "Wedge")] {
                            self.kind_button(ui, kind, word, &mut wanted);
                        }
                        button(
                            self,
                            ui,
                            icon::LASSO,
                            "Lasso",
                            Action::Arm(Tool::LassoCut),
                            "Draw around the region to cut away",
                            is(Tool::LassoCut),
                            &mut wanted,
                        );
                        ui.separator();
                        for (kind, word) in [("peel", "Peel"), ("pull", "Pull"), ("twist", "Twist")] {
                            self.kind_button(ui, kind, word, &mut wanted);
                        }
                        let more = ui.menu_button(format!("More {}", icon::CARET_DOWN), |ui| self.show_kinds(ui));
                        more.response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, "More deformations"));
                        ui.separator();
                        let (undo, redo) =
                            self.doc.as_ref().map_or((false, false), |d| (self.history.has_undo(&d.scene), self.history.has_redo(&d.scene)));
                        for (works, symbol, word, action) in
                            [(undo, icon::ARROW_U_UP_LEFT, "Undo", Action::Undo), (redo, icon::ARROW_U_UP_RIGHT, "Redo", Action::Redo)]
                        {
                            let response = ui.add_enabled(works, egui::Button::new(symbol));
                            labelled(&response, word, false);
                            if response.on_hover_text(self.tip(action, word)).clicked() {
                                wanted.push(action);
                            }
                        }
                        ui.separator();
                        let mode = self.doc.as_ref().map(|d| d.scene.render.mode);
                        for (m, word, about) in [
                            (Mode::Slice, "Slice", "View-aligned slices"),
                            (Mode::Raycast, "Ray", "Ray casting"),
                            (Mode::Surface, "Surface", "Surfaces by their distance fields"),
                        ] {
                            button(self, ui, "", word, Action::SetMode(m), about, mode == Some(m), &mut wanted);
                        }
                        button(self, ui, icon::ARROWS_LEFT_RIGHT, "Compare", Action::Compare, "Compare renderers", false, &mut wanted);
                    }
                    for action in wanted {
                        self.perform(&ctx, action);
                    }
                });
            },
        );
    }

    /// A button for a kind: a click arms it, and it can be dragged onto the view.
    fn kind_button(&mut self, ui: &mut Ui, kind: &str, word: &str, wanted: &mut Vec<Action>) {
        let Ok(kind) = kinds::kind(kind) else { return };
        let tool = Tool::Place(Placed(kind));
        let tip = self.tip(Action::Arm(tool), &format!("{}: {}. Click, then click the surface; or drag it there", words(kind.name), kind.about));
        let response = tool_button(ui, symbol(kind.name), word, self.tool == tool, &tip).interact(egui::Sense::click_and_drag());
        if response.clicked() {
            wanted.push(Action::Arm(tool));
        }
        response.dnd_set_drag_payload(Placed(kind));
    }

    /// Shows all kinds with their pictures.
    fn show_kinds(&mut self, ui: &mut Ui) {
        self.thumbnails.shows_kinds = true;
        ui.set_max_width(560.0);
        let mut armed = None;
        egui::ScrollArea::vertical().max_height(470.0).show(ui, |ui| {
            egui::Grid::new("kinds").num_columns(6).spacing(vec2(4.0, 4.0)).show(ui, |ui| {
                for (n, kind) in kinds::list().enumerate() {
                    let word = words(kind.name);
                    let response = gallery_item(ui, self.thumbnails.kind(n), symbol(kind.name), &word, false);
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
            match kind.name {
                "brush" => self.arm(Tool::BrushPush),
                "lasso" => self.arm(Tool::LassoCut),
                _ => self.arm(Tool::Place(Placed(kind))),
            }
            ui.close();
        }
    }

    /// Shows the menu: all groups of actions except Tool, Deform and Transfer.
    fn show_menu(&mut self, ui: &mut Ui) {
        let mut wanted = None;
        let has_scene = self.doc.is_some();
        for group in ["File", "Edit", "View", "Export", "Map", "Window"] {
            ui.menu_button(group, |ui| {
                ui.set_min_width(250.0);
                for entry in self.entries.iter().filter(|e| e.group == group) {
                    let key = entry.key.as_ref().map(action::key_text).unwrap_or_default();
                    let works = has_scene
                        || matches!(group, "Window")
                        || matches!(entry.action, Action::Open | Action::OpenFolder | Action::OpenHead | Action::Quit);
                    if ui.add_enabled(works, egui::Button::new(&entry.label).shortcut_text(key)).clicked() {
                        wanted = Some(entry.action);
                    }
                }
                if group == "File" && !self.session.settings.recent.is_empty() {
                    ui.separator();
                    for path in self.session.settings.recent.clone().iter().take(8) {
                        let name = path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
                        if ui.button(name).on_hover_text(path.display().to_string()).clicked() {
                            let ctx = ui.ctx().clone();
                            self.open(&ctx, path);
                        }
                    }
                }
            });
        }
        let ctx = ui.ctx().clone();
        if let Some(action) = wanted {
            self.perform(&ctx, action);
        }
    }

    /// Shows the bar at the bottom: the point under the pointer, reductions, work in progress.
    pub(super) fn show_status(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        egui::Panel::bottom("status").frame(egui::Frame::NONE.fill(ui.visuals().panel_fill).inner_margin(egui::Margin::symmetric(10, 4))).show(
            ui,
            |ui| {
                ui.horizontal(|ui| {
                    let left = self
                        .hover
                        .as_ref()
                        .map(super::state::Hover::words)
                        .or_else(|| self.doc.as_ref().map(|_| self.title()))
                        .unwrap_or_else(|| "incise".into());
                    ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                        self.show_work(ui, &ctx);
                        if self.doc.is_some() {
                            self.show_backend(ui);
                            self.show_slice_choices(ui);
                        }
                        ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                            ui.add(egui::Label::new(left).truncate());
                        });
                    });
                });
            },
        );
    }

    fn show_work(&mut self, ui: &mut Ui, ctx: &Context) {
        if let Some(loading) = &self.loading {
            let (what, share) = loading.stage();
            if icon_button(ui, icon::X, "Cancel loading").clicked() {
                loading.cancel();
            }
            ui.add(egui::ProgressBar::new(share).desired_width(150.0).text(format!("{what} {}", loading.name)));
        }
        for task in &self.tasks {
            if icon_button(ui, icon::X, &format!("Cancel: {}", task.name)).clicked() {
                task.cancel();
            }
            ui.add(egui::ProgressBar::new(task.progress()).desired_width(150.0).text(&task.name));
        }
        if !self.tasks.is_empty() || self.loading.is_some() {
            ui.separator();
            ctx.request_repaint_after_secs(0.1);
        }
    }

    fn show_backend(&mut self, ui: &mut Ui) {
        let facts = self.view.facts.clone();
        let mut words = format!("{} · step {:.1} · {:.0} ms", facts.device.as_ref().map_or("…", |d| &d.name), facts.step, facts.ms);
        if !self.view.is_current() {
            words += " · out of date";
        } else if !self.view.is_fine {
            words += " · coarse";
        }
        if !facts.notices.is_empty() {
            words += &format!(" · {}", icon::WARNING);
        }
        let chosen = self.backend();
        let mut wanted = None;
        let response = ui.menu_button(words, |ui| {
            for (backend, word) in [(Backend::Auto, "Hardware GPU if there is one"), (Backend::Gpu, "Any GPU"), (Backend::Cpu, "CPU")] {
                if ui.radio(chosen == backend, word).clicked() {
                    wanted = Some(backend);
                    ui.close();
                }
            }
            for notice in &facts.notices {
                ui.label(notice);
            }
        });
        response.response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, "Backend"));
        if let Some(backend) = wanted {
            self.set_backend(backend);
        }
        ui.separator();
    }

    /// Selects the backend.
    pub fn set_backend(&mut self, backend: Backend) {
        self.forced_backend = None;
        self.session.settings.backend = backend;
        self.worker.set_backend(backend);
        self.view.forget();
        self.compare.forget();
    }

    fn show_slice_choices(&mut self, ui: &mut Ui) {
        let overlay = match self.slices.overlay {
            Overlay::None => "no overlay",
            Overlay::Labels => "labels",
            Overlay::Grid => "grid",
            Overlay::Glyphs => "arrows",
            Overlay::Mask => "mask",
            Overlay::Jacobian => "det J",
        };
        let space = match self.slices.space {
            Space::Deformed => "deformed",
            Space::Source => "source",
            Space::Linked => "both",
        };
        let response = ui.menu_button(format!("Slices: {space}, {overlay}"), |ui| {
            ui.set_min_width(280.0);
            for (s, word) in [(Space::Deformed, "Deformed anatomy"), (Space::Source, "Source anatomy"), (Space::Linked, "Both, linked")] {
                if ui.radio(self.slices.space == s, word).clicked() {
                    self.slices.space = s;
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
                if ui.radio(self.slices.overlay == o, word).clicked() {
                    self.slices.overlay = o;
                }
            }
            if self.slices.overlay == Overlay::Jacobian {
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
        response.response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, "Slice display"));
        ui.separator();
    }

    /// Shows the window without a scene.
    pub(super) fn show_empty(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        if let Some(loading) = &self.loading {
            let (what, share) = loading.stage();
            let name = loading.name.clone();
            let mut stop = false;
            ui.vertical_centered(|ui| {
                ui.add_space(ui.available_height() * 0.4);
                ui.label(RichText::new(format!("Opening {name}")).heading());
                ui.add_space(8.0);
                ui.add(egui::ProgressBar::new(share).desired_width(320.0).text(what));
                ui.add_space(8.0);
                stop = ui.button("Cancel").clicked();
            });
            if stop && let Some(loading) = &self.loading {
                loading.cancel();
            }
            return;
        }
        let mut open: Option<std::path::PathBuf> = None;
        let mut bundled = None;
        let mut action = None;
        egui::ScrollArea::vertical().show(ui, |ui| {
            ui.vertical_centered(|ui| {
                ui.add_space(44.0);
                ui.label(RichText::new("incise").size(34.0));
                ui.label("Cut, peel, pull and open CT and MRI volumes at render time");
                ui.add_space(18.0);
                ui.horizontal(|ui| {
                    let width = 3.0 * 178.0;
                    ui.add_space((ui.available_width() - width).max(0.0) / 2.0);
                    for (symbol, word, a) in [
                        (icon::FOLDER_OPEN, "Open a file", Action::Open),
                        (icon::STACK, "Open a folder", Action::OpenFolder),
                        (icon::BRAIN, "Open the bundled head", Action::OpenHead),
                    ] {
                        let response = ui.add(egui::Button::new(format!("{symbol}  {word}")).min_size(vec2(172.0, 36.0)));
                        response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, word));
                        if response.clicked() {
                            action = Some(a);
                        }
                    }
                });
                ui.add_space(6.0);
                ui.label(RichText::new("or drop a file or folder anywhere").weak());
                ui.add_space(22.0);
                ui.label(RichText::new("Worked examples").strong());
                ui.add_space(4.0);
                for row in EXAMPLES.chunks(3) {
                    ui.horizontal(|ui| {
                        ui.add_space((ui.available_width() - 3.0 * 222.0).max(0.0) / 2.0);
                        for (file, about) in row {
                            if ui.add(egui::Button::new(*about).min_size(vec2(216.0, 30.0))).on_hover_text(*file).clicked() {
                                bundled = Some(*file);
                            }
                        }
                    });
                }
                if !self.session.settings.recent.is_empty() {
                    ui.add_space(22.0);
                    ui.label(RichText::new("Recent").strong());
                    for path in &self.session.settings.recent {
                        let name = path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
                        if ui.add(egui::Button::new(name).frame(false)).on_hover_text(path.display().to_string()).clicked() {
                            open = Some(path.clone());
                        }
                    }
                }
                ui.add_space(24.0);
                ui.label(RichText::new("Press Ctrl+K to search all commands").weak());
            });
        });
        if let Some(path) = open {
            self.open(&ctx, &path);
        }
        if let Some(name) = bundled {
            self.open_bundled(&ctx, name);
        }
        if let Some(a) = action {
            self.perform(&ctx, a);
        }
    }

    /// Shows the messages.
    pub(super) fn show_log(&mut self, ui: &mut Ui) {
        ui.horizontal(|ui| {
            if ui.button("Copy all").clicked() {
                ui.ctx().copy_text(self.log.text());
            }
            if ui.button("Clear").clicked() {
                self.log.clear();
            }
        });
        let (warn, error) = (ui.visuals().warn_fg_color, ui.visuals().error_fg_color);
        for entry in self.log.entries().iter().rev() {
            let (symbol, color) = match entry.level {
                super::state::log::LogLevel::Info => (icon::INFO, None),
                super::state::log::LogLevel::Warning => (icon::WARNING, Some(warn)),
                super::state::log::LogLevel::Error => (icon::PROHIBIT, Some(error)),
            };
            let times = if entry.times > 1 { format!(" (×{})", entry.times) } else { String::new() };
            let mut text = RichText::new(format!("{symbol} {}{times}", entry.text));
            if let Some(color) = color {
                text = text.color(color);
            }
            ui.add(egui::Label::new(text).wrap().selectable(true));
            ui.separator();
        }
        if self.log.entries().is_empty() {
            ui.label(RichText::new("No messages").weak());
        }
    }

    /// The name of the selection.
    pub fn selection_words(&self) -> String {
        let Some(doc) = &self.doc else { return String::new() };
        match doc.selected {
            Selection::Nothing => "Picture".into(),
            Selection::Volume => "Volume".into(),
            Selection::Mesh(n) => doc.scene.mesh.get(n).and_then(|m| m.name.clone().or_else(|| m.path.clone())).unwrap_or_else(|| "Surface".into()),
            Selection::Deformation(n) => doc.scene.deformation.get(n).map(scene::title_of).unwrap_or_default(),
            Selection::Measure(n) => doc.scene.measure.get(n).and_then(|m| m.name.clone()).unwrap_or_else(|| "Measurement".into()),
        }
    }
}

/// A picture with a word below it, as a button.
pub fn gallery_item(ui: &mut Ui, texture: Option<&TextureHandle>, symbol: &str, word: &str, selected: bool) -> Response {
    let size = vec2(86.0, 92.0);
    let (rect, response) = ui.allocate_exact_size(size, egui::Sense::click_and_drag());
    response.widget_info(|| WidgetInfo::selected(WidgetType::Button, true, selected, word));
    let visuals = ui.style().interact_selectable(&response, selected);
    let painter = ui.painter();
    painter.rect(rect, 4.0, visuals.weak_bg_fill, visuals.bg_stroke, egui::StrokeKind::Inside);
    let picture = egui::Rect::from_min_size(rect.min + vec2(9.0, 4.0), vec2(68.0, 68.0));
    painter.rect_filled(picture, 3.0, theme::CANVAS);
    match texture {
        Some(texture) => {
            painter.image(texture.id(), picture, egui::Rect::from_min_max(egui::pos2(0.0, 0.0), egui::pos2(1.0, 1.0)), Color32::WHITE);
        }
        None => {
            painter.text(picture.center(), egui::Align2::CENTER_CENTER, symbol, egui::FontId::proportional(24.0), Color32::from_gray(150));
        }
    }
    let font = egui::FontId::proportional(13.0);
    let galley = painter.layout_no_wrap(word.to_owned(), font.clone(), visuals.text_color());
    let text = if galley.size().x > size.x - 6.0 { shortened(ui, word, size.x - 6.0) } else { word.to_owned() };
    ui.painter().text(egui::pos2(rect.center().x, rect.bottom() - 3.0), egui::Align2::CENTER_BOTTOM, text, font, visuals.text_color());
    response
}

/// A word truncated to a width.
fn shortened(ui: &Ui, word: &str, width: f32) -> String {
    let mut chars: Vec<char> = word.chars().collect();
    while chars.len() > 1 {
        chars.pop();
        let text: String = chars.iter().chain(['…'].iter()).collect();
        let galley = ui.painter().layout_no_wrap(text.clone(), egui::FontId::proportional(13.0), Color32::WHITE);
        if galley.size().x <= width {
            return text;
        }
    }
    word.to_owned()
}
