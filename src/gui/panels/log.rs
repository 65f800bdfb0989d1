//! The messages.

use crate::gui::state::Workstation;
use crate::gui::state::log::LogLevel;
use crate::gui::state::request::{Request, Requests};
use eframe::egui::{self, RichText, Ui};
use egui_phosphor::regular as icon;

/// Draws the messages.
pub fn ui(state: &Workstation, ui: &mut Ui) -> Requests {
    let mut requests = Requests::default();
    ui.horizontal(|ui| {
        if ui.button("Copy all").clicked() {
            ui.ctx().copy_text(state.log.text());
        }
        if ui.button("Clear").clicked() {
            requests.0.push(Request::ClearLog);
        }
    });
    let (warn, error) = (ui.visuals().warn_fg_color, ui.visuals().error_fg_color);
    for entry in state.log.entries().iter().rev() {
        let (symbol, color) = match entry.level {
            LogLevel::Info => (icon::INFO, None),
            LogLevel::Warning => (icon::WARNING, Some(warn)),
            LogLevel::Error => (icon::PROHIBIT, Some(error)),
        };
        let times = if entry.times > 1 {
            format!(" (×{})", entry.times)
        } else {
            String::new()
        };
        let mut text = RichText::new(format!("{symbol} {}{times}", entry.text));
        if let Some(color) = color {
            text = text.color(color);
        }
        ui.add(egui::Label::new(text).wrap().selectable(true));
        ui.separator();
    }
    if state.log.entries().is_empty() {
        ui.label(RichText::new("No messages").weak());
    }
    requests
}
