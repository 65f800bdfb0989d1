//! The settings of a kind, each as a checkbox, a list or a text field.

use crate::deform::Argument;
use crate::deform::kinds::{Setting, SettingFormat};
use crate::files::path_text::path_of;
use crate::gui::panels::rows::{label, name};
use crate::gui::text::capital;
use crate::scene::Deformation;
use crate::volume::phantom::is_procedural;
use eframe::egui::{self, RichText, Ui};
use std::path::Path;

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
    for file in argument
        .iter()
        .flat_map(|a| setting.files(a))
        .filter(|f| !is_procedural(f))
    {
        if !folder.join(path_of(file)).exists() {
            return Err(format!(
                "{file}: file not found in {}",
                if folder.as_os_str().is_empty() {
                    "the current folder".into()
                } else {
                    folder.display().to_string()
                }
            ));
        }
    }
    Ok(argument)
}

/// A setting: a checkbox, a list, or a text field that is applied when it loses focus. Invalid text
/// is rejected with the reason next to it.
pub(super) fn setting(ui: &mut Ui, d: &mut Deformation, place: usize, setting: &Setting, folder: &Path) {
    let key = setting.name;
    match setting.form {
        SettingFormat::Flag => {
            let mut on = d.parameters.flag(key).unwrap_or(false);
            if ui
                .checkbox(&mut on, capital(key))
                .on_hover_text(setting.about)
                .changed()
            {
                d.parameters.0.remove(key);
                if on {
                    d.parameters.insert(key, Argument::Flag(true));
                }
            }
        }
        SettingFormat::Choice(all) | SettingFormat::OneOf(all) => {
            let default = matches!(setting.form, SettingFormat::Choice(_)).then(|| all[0]);
            let now = setting_text(d.parameters.0.get(key));
            let shown = if now.is_empty() {
                default.unwrap_or("from the file")
            } else {
                &now
            };
            ui.horizontal(|ui| {
                if name(ui, &capital(key), setting.about) {
                    d.parameters.0.remove(key);
                }
                let combo = egui::ComboBox::from_id_salt((place, key))
                    .selected_text(shown)
                    .show_ui(ui, |ui| {
                        if default.is_none() && ui.selectable_label(now.is_empty(), "from the file").clicked()
                        {
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
                combo.response.widget_info(|| {
                    egui::WidgetInfo::labeled(egui::WidgetType::ComboBox, true, capital(key))
                });
            });
        }
        _ => text_setting(ui, d, place, setting, folder),
    }
}

/// A setting as a text field. Invalid text stays in the field, with the problem below it.
fn text_setting(ui: &mut Ui, d: &mut Deformation, place: usize, setting: &Setting, folder: &Path) {
    let key = setting.name;
    let id = ui.id().with(("setting", place, &d.kind, key));
    let refused_id = id.with("refused");
    let current_text = setting_text(d.parameters.0.get(key));
    let refused = ui
        .data(|m| m.get_temp::<RejectedInput>(refused_id))
        .filter(|r| r.current_text == current_text);
    let typed_before = ui.data(|m| m.get_temp::<String>(id));
    let mut text = typed_before
        .or_else(|| refused.as_ref().map(|r| r.text.clone()))
        .unwrap_or_else(|| current_text.clone());
    ui.horizontal(|ui| {
        let name = label(ui, &capital(key), setting.about);
        if name.double_clicked() {
            d.parameters.0.remove(key);
            ui.data_mut(|m| m.remove::<RejectedInput>(refused_id));
            text.clear();
        }
        let mut edit =
            egui::TextEdit::singleline(&mut text).desired_width((ui.available_width() - 10.0).max(30.0));
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
                    let refused = RejectedInput {
                        text,
                        problem,
                        current_text: current_text.clone(),
                    };
                    ui.data_mut(|m| m.insert_temp(refused_id, refused));
                }
            }
        }
    });
    if let Some(RejectedInput { problem, .. }) = refused {
        let again = if current_text.is_empty() {
            "The setting is empty.".to_owned()
        } else {
            format!("The setting is still {current_text}.")
        };
        ui.label(RichText::new(format!("{problem}. {again}")).color(ui.visuals().error_fg_color));
    }
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
            (
                SettingFormat::Files,
                Argument::Texts(vec!["a.mat".into(), "b.nii".into()]),
            ),
        ] {
            let setting = Setting {
                name: "x",
                form,
                about: "",
            };
            assert_eq!(setting.parse(&setting_text(Some(&argument))), Ok(Some(argument)));
        }
    }

    #[test]
    fn files_are_looked_for() {
        let folder = tempfile::tempdir().unwrap();
        let setting = Setting {
            name: "labels",
            form: SettingFormat::File,
            about: "",
        };
        assert!(typed(&setting, "labels.nii", folder.path()).is_err_and(|e| e.contains("file not found")));
        std::fs::write(folder.path().join("labels.nii"), "").unwrap();
        assert_eq!(
            typed(&setting, "labels.nii", folder.path()),
            Ok(Some(Argument::Text("labels.nii".into())))
        );
        assert!(typed(&setting, "phantom:octants", folder.path()).is_ok());
    }
}
