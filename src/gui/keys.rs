//! The keyboard: key bindings of actions, and the handling of key events.

use super::gizmos::Mode as GizmoMode;
use super::state::Workstation;
use super::state::action::{self, Action};
use super::state::tool::Tool;
use eframe::egui::{self, Context};

impl Workstation {
    /// Replaces the default keys by the user's.
    pub(super) fn apply_keys(&mut self) {
        self.entries = action::list();
        let keys = &mut self.session.settings.keys;
        for (former, now) in action::FORMER_LABELS {
            if let Some(key) = keys.remove(former) {
                keys.entry(now.to_owned()).or_insert(key);
            }
        }
        for entry in &mut self.entries {
            if let Some(text) = self.session.settings.keys.get(&entry.label) {
                entry.key = action::key_from_text(text);
            }
        }
    }

    /// Handles the keys that are bound to actions.
    pub(super) fn handle_keys(&mut self, ctx: &Context) {
        let typing = ctx.text_edit_focused();
        self.tame_keys(ctx, typing);
        self.space = !typing && self.dialog.is_none() && ctx.input(|i| i.key_down(egui::Key::Space));
        if self.palette.is_some() || self.key_list.is_some() || self.files.is_open() {
            return;
        }
        let menu = egui::Popup::is_any_open(ctx);
        if self.session.settings.blender && !typing && self.selected_deformation().is_some() {
            // As in Blender: keys move, rotate and scale the selection.
            for (key, mode) in [
                (egui::Key::G, GizmoMode::Move),
                (egui::Key::R, GizmoMode::Rotate),
                (egui::Key::S, GizmoMode::Scale),
            ] {
                if ctx.input_mut(|i| i.consume_key(egui::Modifiers::NONE, key)) {
                    self.tool = Tool::Navigate;
                    self.view.gizmo = mode;
                }
            }
        }
        let mut wanted = Vec::new();
        // Keys with more modifiers first: Ctrl+Shift+Z is not Ctrl+Z.
        let mut order: Vec<usize> = (0..self.entries.len()).collect();
        let weight = |m: egui::Modifiers| u8::from(m.command) + u8::from(m.shift) + u8::from(m.alt);
        order.sort_by_key(|n| {
            std::cmp::Reverse(self.entries[*n].key.as_ref().map_or(0, |k| weight(k.modifiers)))
        });
        for n in order {
            let entry = &self.entries[n];
            let Some(key) = &entry.key else { continue };
            let plain = !(key.modifiers.command || key.modifiers.alt);
            // Esc closes a menu before it does anything else.
            if (typing && plain) || (menu && entry.action == Action::Deselect) {
                continue;
            }
            if ctx.input_mut(|i| i.consume_shortcut(key)) {
                wanted.push(entry.action);
            }
        }
        for action in wanted {
            // A drag must end before another action begins.
            let busy = self.dialog.is_some() || self.gesture.is_some() || self.stroke_before.is_some();
            if busy && !matches!(action, Action::Deselect) {
                continue;
            }
            self.perform(ctx, action);
        }
    }

    /// Normalises key events: digits with Shift are digits, + needs no Shift, and holding a key
    /// does not repeat a toggle.
    fn tame_keys(&self, ctx: &Context, typing: bool) {
        use egui::{Event, Key};
        let digit = |key: Key| matches!(key, Key::Num1 | Key::Num3 | Key::Num5 | Key::Num7 | Key::Num9);
        ctx.input_mut(|i| {
            for event in &mut i.events {
                if let Event::Key {
                    key,
                    physical_key,
                    modifiers,
                    ..
                } = event
                {
                    if let Some(physical) = physical_key.filter(|p| modifiers.shift && !typing && digit(*p)) {
                        *key = physical;
                    }
                    if *key == Key::Equals && modifiers.command {
                        *key = Key::Plus;
                    }
                }
            }
            let repeats = |key: &Key| {
                matches!(
                    key,
                    Key::OpenBracket | Key::CloseBracket | Key::Z | Key::Plus | Key::Minus
                )
            };
            i.events.retain(|e| {
                typing || !matches!(e, Event::Key { key, repeat: true, pressed: true, .. } if !repeats(key))
            });
        });
        // Tab toggles before and after here; it does not move the focus to the next widget.
        if !typing && ctx.input(|i| i.key_pressed(Key::Tab)) {
            ctx.memory_mut(|m| {
                if let Some(focus) = m.focused() {
                    m.surrender_focus(focus);
                }
            });
        }
    }
}
