//! The window without a scene: files to open, worked examples.

use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::session::EXAMPLES;
use eframe::egui::{self, RichText, Ui, WidgetInfo, WidgetType, vec2};
use egui_phosphor::regular as icon;

/// Draws the window without a scene.
pub fn ui(state: &Workstation, ui: &mut Ui) -> Requests {
    let mut requests = Requests::default();
    if let Some(loading) = &state.loading {
        let (what, share) = loading.stage();
        ui.vertical_centered(|ui| {
            ui.add_space(ui.available_height() * 0.4);
            ui.label(RichText::new(format!("Opening {}", loading.name)).heading());
            ui.add_space(8.0);
            ui.add(egui::ProgressBar::new(share).desired_width(320.0).text(what));
            ui.add_space(8.0);
            if ui.button("Cancel").clicked() {
                requests.0.push(Request::CancelLoading);
            }
        });
        return requests;
    }
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
                    let response =
                        ui.add(egui::Button::new(format!("{symbol}  {word}")).min_size(vec2(172.0, 36.0)));
                    response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, word));
                    if response.clicked() {
                        requests.perform(a);
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
                        if ui
                            .add(egui::Button::new(*about).min_size(vec2(216.0, 30.0)))
                            .on_hover_text(*file)
                            .clicked()
                        {
                            requests.0.push(Request::OpenBundled(file));
                        }
                    }
                });
            }
            if !state.session.settings.recent.is_empty() {
                ui.add_space(22.0);
                ui.label(RichText::new("Recent").strong());
                for path in &state.session.settings.recent {
                    let name = path.file_name().map_or_else(
                        || path.display().to_string(),
                        |n| n.to_string_lossy().into_owned(),
                    );
                    if ui
                        .add(egui::Button::new(name).frame(false))
                        .on_hover_text(path.display().to_string())
                        .clicked()
                    {
                        requests.0.push(Request::Open(path.clone()));
                    }
                }
            }
            ui.add_space(24.0);
            ui.label(RichText::new("Press Ctrl+K to search all commands").weak());
        });
    });
    requests
}
