//! Measurements: tools, the list with its values, labels.

use super::{heading, tool_button};
use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::state::document::Selection;
use crate::gui::state::tool::Tool;
use crate::gui::text::number;
use crate::scene::measure::{Measure, MeasureKind};
use eframe::egui::{self, DragValue, RichText, Ui};
use egui_phosphor::regular as icon;

impl Workstation {
    /// The panel.
    pub(in crate::gui) fn show_measures(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let mut act = None;
        ui.horizontal_wrapped(|ui| {
            for (tool, word, symbol) in [
                (Tool::Measure(MeasureKind::Distance), "Distance", icon::RULER),
                (Tool::Measure(MeasureKind::Angle), "Angle", icon::ANGLE),
                (Tool::Probe, "Value", icon::EYEDROPPER),
            ] {
                if tool_button(ui, symbol, word, self.tool == tool, &tool.hint()).clicked() {
                    act = Some(Action::Arm(tool));
                }
            }
        });
        self.show_label_tool(ui);
        heading(ui, "Results");
        let Some(doc) = &mut self.doc else { return };
        let caution = ui.visuals().warn_fg_color;
        if let Some(misplaced) = doc.assets.volume.misplaced.filter(|_| !doc.scene.measure.is_empty()) {
            ui.label(
                RichText::new(format!(
                    "Positions and lengths are off by up to {:.1} mm because the slices are not shown at their acquired positions",
                    misplaced.by_mm
                ))
                .color(caution),
            );
        }
        let mut remove = None;
        for (n, measure) in doc.scene.measure.iter_mut().enumerate() {
            ui.horizontal(|ui| {
                let mut name = measure.name.clone().unwrap_or_default();
                let selected = doc.selected == Selection::Measure(n);
                let field = ui
                    .add(egui::TextEdit::singleline(&mut name).desired_width((ui.available_width() - 34.0).max(60.0)).hint_text(measure.kind.name()));
                if field.changed() {
                    measure.name = (!name.is_empty()).then_some(name);
                }
                if field.gained_focus() && !selected {
                    doc.selected = Selection::Measure(n);
                }
                if super::icon_button(ui, icon::TRASH, &format!("Remove measurement {}", n + 1)).clicked() {
                    remove = Some(n);
                }
            });
            if measure.before_resampling {
                let mark = format!("    {} made before resampling; measure it again", icon::WARNING);
                ui.label(RichText::new(mark).color(caution))
                    .on_hover_text("Resampling moved the slices; its points may no longer mark the same anatomy");
            }
            // Values belong to the measurement for which they were computed, which may have changed
            // since.
            match self
                .measured
                .get(n)
                .filter(|m| m.measure.points == measure.points && m.measure.kind == measure.kind && m.measure.label == measure.label)
            {
                Some(measured) => match &measured.quantities {
                    Ok(quantities) => {
                        for q in quantities {
                            let value = q.value.map_or_else(|| "not visible".to_owned(), |v| number(v, q.unit));
                            ui.label(format!("    {}: {value}", q.what));
                        }
                    }
                    Err(problem) => {
                        ui.label(RichText::new(problem).color(ui.visuals().warn_fg_color));
                    }
                },
                None => {
                    ui.label("    …");
                }
            }
        }
        if doc.scene.measure.is_empty() {
            ui.label(
                RichText::new(
                    "No measurements yet. Points stay with the anatomy; values are given for the patient and, if deformed, after deformation.",
                )
                .weak(),
            );
        }
        if let Some(n) = remove {
            doc.selected = Selection::Measure(n);
            doc.delete();
        }
        if !doc.scene.measure.is_empty() && ui.button("Export as CSV…").clicked() {
            act = Some(Action::ExportMeasures);
        }
        if let Some(action) = act {
            self.perform(&ctx, action);
        }
    }

    fn show_label_tool(&mut self, ui: &mut Ui) {
        let mut add = None;
        let mut ask = false;
        if let Some(doc) = &self.doc {
            let highest = doc.assets.label_map().ok().map(|m| m.range[1] as u32);
            ui.horizontal(|ui| match highest {
                Some(highest) => {
                    ui.label("Label");
                    ui.add(DragValue::new(&mut self.editor.label).range(1..=highest.max(1)));
                    if ui.button("Volume and surface area").clicked() {
                        add = Some(self.editor.label);
                    }
                }
                None => ask = ui.button("Label map…").on_hover_text("Needed to measure volumes and surface areas of regions").clicked(),
            });
        }
        if let (Some(label), Some(doc)) = (add, &mut self.doc) {
            let name = Some(format!("Label {label}"));
            doc.scene.measure.push(Measure { kind: MeasureKind::Label, name, points: Vec::new(), label: Some(label), before_resampling: false });
            doc.selected = Selection::Measure(doc.scene.measure.len() - 1);
        }
        if ask {
            self.choose_label_map();
        }
    }
}
