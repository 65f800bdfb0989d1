//! A bar over the views, shown while slices are displayed at positions other than their true ones;
//! it offers to resample them.

use crate::gui::state::Workstation;
use eframe::egui::{self, RichText, Ui};
use egui_phosphor::regular as icon;

impl Workstation {
    /// Shows the bar if it applies.
    pub(in crate::gui) fn show_misplaced(&mut self, ui: &mut Ui) {
        let Some(misplaced) = self.doc.as_ref().and_then(|d| d.assets.volume.misplaced) else { return };
        let by = misplaced.by_mm;
        let words = if misplaced.resampling_helps {
            format!("Slice spacing is uneven but shown as even; positions and lengths are off by up to {by:.1} mm.")
        } else {
            format!("The slices do not lie on a regular grid; positions and lengths are off by up to {by:.1} mm. This cannot be corrected here.")
        };
        let mut resample = false;
        let frame = egui::Frame::NONE.fill(ui.visuals().extreme_bg_color).inner_margin(egui::Margin::symmetric(10, 5));
        egui::Panel::top("misplaced").frame(frame).show(ui, |ui| {
            ui.horizontal_wrapped(|ui| {
                let color = ui.visuals().warn_fg_color;
                ui.label(RichText::new(format!("{}  {words}", icon::WARNING)).color(color));
                if misplaced.resampling_helps {
                    resample = ui
                        .button("Resample")
                        .on_hover_text("Resample the slices onto a regular grid. Existing measurements will be flagged")
                        .clicked();
                }
            });
        });
        if resample {
            self.resample();
        }
    }

    /// Resamples the slices onto a regular grid; earlier measurements may then refer to other
    /// anatomy.
    pub fn resample(&mut self) {
        let Some(doc) = &mut self.doc else { return };
        let Some(volume) = &mut doc.scene.volume else { return };
        volume.choice.resample = true;
        for measure in &mut doc.scene.measure {
            // A measurement without points is recomputed from the voxels.
            measure.before_resampling = !measure.points.is_empty();
        }
    }
}
