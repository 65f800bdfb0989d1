//! The command palette, and the list of keys.

use crate::gui::state::Workstation;
use crate::gui::state::action::{self, Action};
use crate::gui::state::panels::{KeyList, Palette};
use crate::gui::state::request::{Request, Requests};
use eframe::egui::{self, Align2, Context, Key, RichText, vec2};

/// How well a label matches a query: all its words must occur; lower is better.
fn rank(label: &str, query: &str) -> Option<usize> {
    let label = label.to_lowercase();
    let mut sum = 0;
    for word in query.to_lowercase().split_whitespace() {
        let at = label.find(word)?;
        // A match at the beginning of a word ranks higher.
        let start = at == 0 || !label.as_bytes()[at - 1].is_ascii_alphanumeric();
        sum += at + if start { 0 } else { 50 };
    }
    Some(sum)
}

impl Palette {
    /// Draws the palette; whether it stays open.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ctx: &Context) -> (Requests, bool) {
        let mut requests = Requests::default();
        let palette = self;
        let mut found: Vec<(usize, usize)> = state
            .entries
            .iter()
            .enumerate()
            .filter_map(|(n, e)| {
                rank(&format!("{} {} {:?}", e.label, e.group, e.action), &palette.query).map(|r| (r, n))
            })
            .collect();
        if !palette.query.is_empty() {
            found.sort();
        }
        let (up, down, enter, escape) = ctx.input_mut(|i| {
            (
                i.consume_key(egui::Modifiers::NONE, Key::ArrowUp),
                i.consume_key(egui::Modifiers::NONE, Key::ArrowDown),
                i.consume_key(egui::Modifiers::NONE, Key::Enter),
                i.consume_key(egui::Modifiers::NONE, Key::Escape),
            )
        });
        if up {
            palette.row = palette.row.saturating_sub(1);
        }
        if down {
            palette.row += 1;
        }
        palette.row = palette.row.min(found.len().saturating_sub(1));
        let mut chosen: Option<Action> = enter
            .then(|| found.get(palette.row).map(|f| state.entries[f.1].action))
            .flatten();
        let mut close = escape || (enter && chosen.is_some());
        let response = egui::Window::new("Command palette")
            .title_bar(false)
            .collapsible(false)
            .resizable(false)
            .anchor(Align2::CENTER_TOP, vec2(0.0, 90.0))
            .fixed_size(vec2(460.0, 380.0))
            .show(ctx, |ui| {
                let field = ui.add(
                    egui::TextEdit::singleline(&mut palette.query)
                        .hint_text("Type a command")
                        .desired_width(f32::INFINITY),
                );
                field.widget_info(|| egui::WidgetInfo::text_edit(true, "", "", "Command"));
                if !palette.shown {
                    field.request_focus();
                    palette.shown = true;
                }
                if field.changed() {
                    palette.row = 0;
                }
                egui::ScrollArea::vertical()
                    .max_height(336.0)
                    .auto_shrink([false, false])
                    .show(ui, |ui| {
                        for (n, (_, entry)) in found.iter().enumerate() {
                            let entry = &state.entries[*entry];
                            let key = entry.key.as_ref().map(action::key_text).unwrap_or_default();
                            let button = egui::Button::selectable(n == palette.row, &entry.label)
                                .shortcut_text(key)
                                .min_size(vec2(ui.available_width(), 24.0));
                            let row = ui.add(button);
                            row.widget_info(|| {
                                egui::WidgetInfo::selected(
                                    egui::WidgetType::Button,
                                    true,
                                    n == palette.row,
                                    format!("Command: {}", entry.label),
                                )
                            });
                            if row.clicked() {
                                chosen = Some(entry.action);
                                close = true;
                            }
                            if n == palette.row && (up || down) {
                                row.scroll_to_me(None);
                            }
                        }
                        if found.is_empty() {
                            ui.label(RichText::new("No such command").weak());
                        }
                    });
            });
        if ctx.input(|i| i.pointer.any_click())
            && let (Some(window), Some(pos)) = (response, ctx.pointer_latest_pos())
            && !window.response.rect.contains(pos)
        {
            close = true;
        }
        if let Some(action) = chosen {
            requests.perform(action);
        }
        (requests, !close)
    }
}

impl KeyList {
    /// Draws the list of keys; whether it stays open.
    pub(in crate::gui) fn ui(&mut self, state: &Workstation, ctx: &Context) -> (Requests, bool) {
        let mut requests = Requests::default();
        let waiting = &mut self.waiting;
        let mut open = true;
        if waiting.is_empty() && ctx.input_mut(|i| i.consume_key(egui::Modifiers::NONE, Key::Escape)) {
            return (requests, false);
        }
        if !waiting.is_empty() {
            let pressed = ctx.input(|i| {
                i.events.iter().find_map(|e| match e {
                    egui::Event::Key {
                        key,
                        pressed: true,
                        modifiers,
                        ..
                    } => Some((*key, *modifiers)),
                    _ => None,
                })
            });
            if let Some((key, modifiers)) = pressed {
                if key != Key::Escape {
                    let mut pressed = egui::Modifiers::NONE;
                    pressed.command = modifiers.command;
                    pressed.alt = modifiers.alt;
                    pressed.shift = modifiers.shift;
                    requests.0.push(Request::SetKey(
                        waiting.clone(),
                        egui::KeyboardShortcut::new(pressed, key),
                    ));
                }
                waiting.clear();
            }
        }
        egui::Window::new("Keyboard shortcuts")
            .open(&mut open)
            .collapsible(false)
            .default_size(vec2(480.0, 460.0))
            .anchor(Align2::CENTER_CENTER, vec2(0.0, 0.0))
            .show(ctx, |ui| {
                ui.label("Click a key to change it; press Esc to keep it.");
                ui.horizontal(|ui| {
                    ui.label("Mouse:");
                    let mut blender = state.session.settings.blender;
                    ui.radio_value(&mut blender, false, "3D Slicer style");
                    ui.radio_value(&mut blender, true, "Blender style");
                    if blender != state.session.settings.blender {
                        requests.0.push(Request::SetMouse { blender });
                    }
                    if ui.button("Reset to defaults").clicked() {
                        requests.0.push(Request::ResetKeys);
                    }
                });
                egui::ScrollArea::vertical()
                    .max_height(360.0)
                    .auto_shrink([false, false])
                    .show(ui, |ui| {
                        egui::Grid::new("keys")
                            .num_columns(2)
                            .striped(true)
                            .show(ui, |ui| {
                                for entry in &state.entries {
                                    ui.label(&entry.label);
                                    let text = if *waiting == entry.label {
                                        "press a key…".to_owned()
                                    } else {
                                        entry.key.as_ref().map_or_else(|| "–".into(), action::key_text)
                                    };
                                    let button = ui.add(egui::Button::new(text).min_size(vec2(110.0, 20.0)));
                                    button.widget_info(|| {
                                        egui::WidgetInfo::labeled(
                                            egui::WidgetType::Button,
                                            true,
                                            format!("Key of {}", entry.label),
                                        )
                                    });
                                    if button.clicked() {
                                        waiting.clone_from(&entry.label);
                                    }
                                    ui.end_row();
                                }
                            });
                    });
            });
        (requests, open)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_found_in_any_order_and_beginnings_first() {
        assert!(rank("Place Peel", "peel place").is_some());
        assert!(rank("Place Peel", "pull").is_none());
        assert!(rank("Peel", "pe") < rank("Open", "pe"));
    }
}
