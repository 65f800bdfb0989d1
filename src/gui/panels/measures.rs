//! Measurements: tools, the list with its values, labels.

use super::{heading, tool_button};
use crate::gui::state::Workstation;
use crate::gui::state::action::Action;
use crate::gui::state::document::{Document, Selection};
use crate::gui::state::panels::MeasurePanel;
use crate::gui::state::request::{Request, Requests};
use crate::gui::state::tool::Tool;
use crate::gui::state::worker::MeasureResult;
use crate::gui::text::number;
use crate::scene::measure::{Measure, MeasureKind};
use eframe::egui::{self, DragValue, RichText, Ui};
use egui_phosphor::regular as icon;

impl MeasurePanel {
    /// Draws the panel.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ui: &mut Ui) -> Requests {
        let mut requests = Requests::default();
        ui.horizontal_wrapped(|ui| {
            for (tool, word, symbol) in [
                (Tool::Measure(MeasureKind::Distance), "Distance", icon::RULER),
                (Tool::Measure(MeasureKind::Angle), "Angle", icon::ANGLE),
                (Tool::Probe, "Value", icon::EYEDROPPER),
            ] {
                if tool_button(ui, symbol, word, state.tool == tool, &tool.hint()).clicked() {
                    requests.perform(Action::Arm(tool));
                }
            }
        });
        let Some(doc) = &state.doc else { return requests };
        self.show_label_tool(ui, doc, &mut requests);
        heading(ui, "Results");
        let caution = ui.visuals().warn_fg_color;
        if let Some(misplaced) = doc
            .assets
            .volume
            .misplaced
            .filter(|_| !doc.scene.measure.is_empty())
        {
            ui.label(
                RichText::new(format!(
                    "Positions and lengths are off by up to {:.1} mm because the slices are not shown at their acquired positions",
                    misplaced.by_mm
                ))
                .color(caution),
            );
        }
        for (n, measure) in doc.scene.measure.iter().enumerate() {
            show_name(ui, doc, n, measure, &mut requests);
            if measure.before_resampling {
                let mark = format!("    {} made before resampling; measure it again", icon::WARNING);
                ui.label(RichText::new(mark).color(caution)).on_hover_text(
                    "Resampling moved the slices; its points may no longer mark the same anatomy",
                );
            }
            show_values(ui, measure, state.measured.get(n));
        }
        if doc.scene.measure.is_empty() {
            ui.label(
                RichText::new(
                    "No measurements yet. Points stay with the anatomy; values are given for the patient and, if deformed, after deformation.",
                )
                .weak(),
            );
        }
        if !doc.scene.measure.is_empty() && ui.button("Export as CSV…").clicked() {
            requests.perform(Action::ExportMeasures);
        }
        requests
    }

    /// Measures a label; asks for a label map where there is none.
    fn show_label_tool(&mut self, ui: &mut Ui, doc: &Document, requests: &mut Requests) {
        let highest = doc.assets.label_map().ok().map(|m| m.range[1] as u32);
        ui.horizontal(|ui| match highest {
            Some(highest) => {
                ui.label("Label");
                ui.add(DragValue::new(&mut self.label).range(1..=highest.max(1)));
                if ui.button("Volume and surface area").clicked() {
                    let (label, name) = (self.label, Some(format!("Label {}", self.label)));
                    requests.change(move |doc| {
                        doc.scene.measure.push(Measure {
                            kind: MeasureKind::Label,
                            name,
                            points: Vec::new(),
                            label: Some(label),
                            before_resampling: false,
                        });
                        doc.selected = Selection::Measure(doc.scene.measure.len() - 1);
                    });
                }
            }
            None => {
                if ui
                    .button("Label map…")
                    .on_hover_text("Needed to measure volumes and surface areas of regions")
                    .clicked()
                {
                    requests.0.push(Request::ChooseLabelMap);
                }
            }
        });
    }
}

/// A measurement's name, to be edited, and the button that removes it.
fn show_name(ui: &mut Ui, doc: &Document, n: usize, measure: &Measure, requests: &mut Requests) {
    ui.horizontal(|ui| {
        let mut name = measure.name.clone().unwrap_or_default();
        let width = (ui.available_width() - 34.0).max(60.0);
        let field = ui.add(
            egui::TextEdit::singleline(&mut name)
                .desired_width(width)
                .hint_text(measure.kind.name()),
        );
        if field.changed() {
            requests.change(move |doc| doc.scene.measure[n].name = (!name.is_empty()).then_some(name));
        }
        if field.gained_focus() && doc.selected != Selection::Measure(n) {
            requests.0.push(Request::Select(Selection::Measure(n)));
        }
        if super::icon_button(ui, icon::TRASH, &format!("Remove measurement {}", n + 1)).clicked() {
            requests.change(move |doc| {
                doc.selected = Selection::Measure(n);
                doc.delete();
            });
        }
    });
}

/// A measurement's values. They belong to the measurement for which they were computed, which may
/// have changed since.
fn show_values(ui: &mut Ui, measure: &Measure, measured: Option<&MeasureResult>) {
    let is_of = |m: &&MeasureResult| {
        m.measure.points == measure.points
            && m.measure.kind == measure.kind
            && m.measure.label == measure.label
    };
    match measured.filter(is_of).map(|m| &m.quantities) {
        Some(Ok(quantities)) => {
            for q in quantities {
                let value = q
                    .value
                    .map_or_else(|| "not visible".to_owned(), |v| number(v, q.unit));
                ui.label(format!("    {}: {value}", q.what));
            }
        }
        Some(Err(problem)) => {
            ui.label(RichText::new(problem).color(ui.visuals().warn_fg_color));
        }
        None => {
            ui.label("    …");
        }
    }
}
