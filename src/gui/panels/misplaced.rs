//! A bar over the views, shown while slices are displayed at positions other than their true ones;
//! it offers to resample them.

use crate::gui::state::Workstation;
use crate::gui::state::document::Document;
use crate::gui::state::request::Requests;
use eframe::egui::{self, RichText, Ui};
use egui_phosphor::regular as icon;

/// Draws the bar if it applies.
pub fn ui(state: &Workstation, ui: &mut Ui) -> Requests {
    let mut requests = Requests::default();
    let Some(misplaced) = state.doc.as_ref().and_then(|d| d.assets.volume.misplaced) else {
        return requests;
    };
    let by = misplaced.by_mm;
    let words = if misplaced.resampling_helps {
        format!(
            "Slice spacing is uneven but shown as even; positions and lengths are off by up to {by:.1} mm."
        )
    } else {
        format!(
            "The slices do not lie on a regular grid; positions and lengths are off by up to {by:.1} mm. This cannot be corrected here."
        )
    };
    let frame = egui::Frame::NONE
        .fill(ui.visuals().extreme_bg_color)
        .inner_margin(egui::Margin::symmetric(10, 5));
    egui::Panel::top("misplaced").frame(frame).show(ui, |ui| {
        ui.horizontal_wrapped(|ui| {
            let color = ui.visuals().warn_fg_color;
            ui.label(RichText::new(format!("{}  {words}", icon::WARNING)).color(color));
            let about = "Resample the slices onto a regular grid. Existing measurements will be flagged";
            if misplaced.resampling_helps && ui.button("Resample").on_hover_text(about).clicked() {
                requests.change(Document::resample);
            }
        });
    });
    requests
}
