//! All actions that need no pointing: one list for menus, keys, the command palette and tests.

use super::tool::{Placed, Tool};
use crate::deform::kinds;
use crate::scene::Mode;
use crate::scene::measure::MeasureKind;
use crate::transfer;
use eframe::egui::{Key, KeyboardShortcut, Modifiers};

/// An action.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "each is described by its label in the list")]
pub enum Action {
    Open,
    OpenFolder,
    OpenHead,
    Close,
    Save,
    SaveAs,
    ExportPicture,
    ExportClip,
    ExportVolume,
    ExportField,
    ExportReport,
    ExportMeasures,
    ExportTransfer,
    ImportTransfer,
    CopyCommand,
    Quit,
    Undo,
    Redo,
    Delete,
    Duplicate,
    Mute,
    Solo,
    MoveUp,
    MoveDown,
    Less,
    More,
    Deselect,
    SelectNext,
    View(&'static str),
    Opposite,
    ResetCamera,
    FrameSelection,
    CameraBack,
    CameraForward,
    ToggleProjection,
    NextMode,
    SetMode(Mode),
    Compare,
    BeforeAfter,
    Layout(super::layout::LayoutPreset),
    ToggleTheme,
    ScaleUp,
    ScaleDown,
    Palette,
    Keys,
    Log,
    Navigation,
    Arm(Tool),
    Preset(&'static str),
    ResetWindow,
    NewMap,
    SaveMap,
    StackToMap,
    CheckField,
    CancelTasks,
    ResetGpu,
}

/// An action with its label, group and key.
pub struct ActionEntry {
    /// The action.
    pub action: Action,
    /// Its label.
    pub label: String,
    /// The group it belongs to.
    pub group: &'static str,
    /// Its default key.
    pub key: Option<KeyboardShortcut>,
}

const CTRL: Modifiers = Modifiers::COMMAND;
const CTRL_SHIFT: Modifiers = Modifiers::COMMAND.plus(Modifiers::SHIFT);
const SHIFT: Modifiers = Modifiers::SHIFT;
const NONE: Modifiers = Modifiers::NONE;

/// Builds the list of actions.
#[derive(Default)]
struct ActionList(Vec<ActionEntry>);

impl ActionList {
    /// Appends an action.
    fn add(&mut self, group: &'static str, action: Action, label: &str, key: Option<(Modifiers, Key)>) {
        self.0.push(ActionEntry {
            action,
            label: label.into(),
            group,
            key: key.map(|(m, k)| KeyboardShortcut::new(m, k)),
        });
    }
}

/// All actions, in menu order.
pub fn list() -> Vec<ActionEntry> {
    let mut all = ActionList::default();
    add_file_actions(&mut all);
    add_export_actions(&mut all);
    add_edit_actions(&mut all);
    add_view_actions(&mut all);
    add_window_actions(&mut all);
    add_tool_actions(&mut all);
    add_deform_actions(&mut all);
    add_map_actions(&mut all);
    add_transfer_actions(&mut all);
    all.0
}

/// Opening, saving and closing.
fn add_file_actions(all: &mut ActionList) {
    all.add("File", Action::Open, "Open…", Some((CTRL, Key::O)));
    all.add(
        "File",
        Action::OpenFolder,
        "Open folder (DICOM)…",
        Some((CTRL_SHIFT, Key::O)),
    );
    all.add("File", Action::OpenHead, "Open the bundled head", None);
    all.add("File", Action::Save, "Save", Some((CTRL, Key::S)));
    all.add("File", Action::SaveAs, "Save as…", Some((CTRL_SHIFT, Key::S)));
    all.add("File", Action::Close, "Close the scene", Some((CTRL, Key::W)));
    all.add("File", Action::Quit, "Quit", Some((CTRL, Key::Q)));
}

/// Import and export of files other than scenes.
fn add_export_actions(all: &mut ActionList) {
    all.add(
        "Export",
        Action::ExportPicture,
        "Export picture…",
        Some((CTRL, Key::E)),
    );
    all.add("Export", Action::ExportClip, "Export clip…", None);
    all.add("Export", Action::ExportVolume, "Bake the deformed volume…", None);
    all.add(
        "Export",
        Action::ExportField,
        "Bake the displacement field…",
        None,
    );
    all.add("Export", Action::ExportReport, "Export comparison report…", None);
    all.add("Export", Action::ExportMeasures, "Export measurements…", None);
    all.add(
        "Export",
        Action::CopyCommand,
        "Copy as incise render …",
        Some((Modifiers::ALT, Key::C)),
    );
    all.add(
        "Export",
        Action::ImportTransfer,
        "Import transfer function…",
        None,
    );
    all.add(
        "Export",
        Action::ExportTransfer,
        "Export transfer function…",
        None,
    );
}

/// Changes to the selection and the stack.
fn add_edit_actions(all: &mut ActionList) {
    all.add("Edit", Action::Undo, "Undo", Some((CTRL, Key::Z)));
    all.add("Edit", Action::Redo, "Redo", Some((CTRL_SHIFT, Key::Z)));
    all.add("Edit", Action::Delete, "Delete", Some((NONE, Key::Delete)));
    all.add("Edit", Action::Duplicate, "Duplicate", Some((CTRL, Key::D)));
    all.add("Edit", Action::Mute, "Mute", Some((NONE, Key::H)));
    all.add("Edit", Action::Solo, "Solo", Some((SHIFT, Key::H)));
    all.add(
        "Edit",
        Action::MoveUp,
        "Move up in the stack",
        Some((CTRL, Key::ArrowUp)),
    );
    all.add(
        "Edit",
        Action::MoveDown,
        "Move down in the stack",
        Some((CTRL, Key::ArrowDown)),
    );
    all.add(
        "Edit",
        Action::Less,
        "Decrease progress",
        Some((NONE, Key::OpenBracket)),
    );
    all.add(
        "Edit",
        Action::More,
        "Increase progress",
        Some((NONE, Key::CloseBracket)),
    );
    all.add(
        "Edit",
        Action::SelectNext,
        "Select the next deformation",
        Some((NONE, Key::N)),
    );
    all.add("Edit", Action::Deselect, "Deselect", Some((NONE, Key::Escape)));
}

/// The camera and how the picture is rendered.
fn add_view_actions(all: &mut ActionList) {
    for (name, label, key) in [
        ("anterior", "View from anterior", Some((NONE, Key::Num1))),
        ("posterior", "View from posterior", Some((SHIFT, Key::Num1))),
        ("left", "View from left", Some((NONE, Key::Num3))),
        ("right", "View from right", Some((SHIFT, Key::Num3))),
        ("superior", "View from superior", Some((NONE, Key::Num7))),
        ("inferior", "View from inferior", Some((SHIFT, Key::Num7))),
    ] {
        all.add("View", Action::View(name), label, key);
    }
    all.add(
        "View",
        Action::Opposite,
        "View from the opposite side",
        Some((NONE, Key::Num9)),
    );
    all.add("View", Action::ResetCamera, "Reset camera", Some((NONE, Key::R)));
    all.add(
        "View",
        Action::FrameSelection,
        "Frame selection",
        Some((NONE, Key::F)),
    );
    all.add(
        "View",
        Action::CameraBack,
        "Camera back",
        Some((Modifiers::ALT, Key::ArrowLeft)),
    );
    all.add(
        "View",
        Action::CameraForward,
        "Camera forward",
        Some((Modifiers::ALT, Key::ArrowRight)),
    );
    all.add(
        "View",
        Action::ToggleProjection,
        "Toggle perspective/orthographic",
        Some((NONE, Key::Num5)),
    );
    all.add("View", Action::NextMode, "Next render mode", Some((NONE, Key::V)));
    all.add("View", Action::SetMode(Mode::Slice), "Render with slices", None);
    all.add(
        "View",
        Action::SetMode(Mode::Raycast),
        "Render with ray casting",
        None,
    );
    all.add("View", Action::SetMode(Mode::Surface), "Render surfaces", None);
    all.add(
        "View",
        Action::Compare,
        "Compare renderers",
        Some((SHIFT, Key::V)),
    );
    all.add(
        "View",
        Action::BeforeAfter,
        "Toggle before/after deformation",
        Some((NONE, Key::Tab)),
    );
}

/// Layout, theme, help and the application itself.
fn add_window_actions(all: &mut ActionList) {
    use super::layout::LayoutPreset as Layout;
    all.add("Window", Action::Layout(Layout::Only3d), "Layout: 3D only", None);
    all.add("Window", Action::Layout(Layout::FourUp), "Layout: four-up", None);
    all.add("Window", Action::Layout(Layout::Compare), "Layout: compare", None);
    all.add("Window", Action::ToggleTheme, "Toggle light/dark theme", None);
    all.add(
        "Window",
        Action::ScaleUp,
        "Larger interface",
        Some((CTRL, Key::Plus)),
    );
    all.add(
        "Window",
        Action::ScaleDown,
        "Smaller interface",
        Some((CTRL, Key::Minus)),
    );
    all.add("Window", Action::Palette, "Command palette", Some((CTRL, Key::K)));
    all.add(
        "Window",
        Action::Keys,
        "Keyboard shortcuts…",
        Some((NONE, Key::F1)),
    );
    all.add("Window", Action::Log, "Show log", None);
    all.add(
        "Window",
        Action::Navigation,
        "Toggle 3D Slicer/Blender navigation",
        None,
    );
    all.add("Window", Action::ResetGpu, "Reconnect to the GPU", None);
    all.add("Window", Action::CancelTasks, "Cancel all background tasks", None);
}

/// Tools to arm.
fn add_tool_actions(all: &mut ActionList) {
    all.add("Tool", Action::Arm(Tool::Navigate), "Orbit", Some((NONE, Key::O)));
    all.add("Tool", Action::Arm(Tool::Probe), "Probe", Some((NONE, Key::I)));
    all.add(
        "Tool",
        Action::Arm(Tool::Measure(MeasureKind::Distance)),
        "Measure a distance",
        Some((NONE, Key::M)),
    );
    all.add(
        "Tool",
        Action::Arm(Tool::Measure(MeasureKind::Angle)),
        "Measure an angle",
        Some((SHIFT, Key::M)),
    );
    all.add(
        "Tool",
        Action::Arm(Tool::LassoCut),
        "Lasso cut",
        Some((NONE, Key::L)),
    );
    all.add(
        "Tool",
        Action::Arm(Tool::LassoRestore),
        "Lasso restore",
        Some((SHIFT, Key::L)),
    );
    all.add(
        "Tool",
        Action::Arm(Tool::BrushPush),
        "Brush: push",
        Some((NONE, Key::G)),
    );
    all.add("Tool", Action::Arm(Tool::BrushSmooth), "Brush: smooth", None);
    all.add("Tool", Action::Arm(Tool::BrushCut), "Brush: cut", None);
    all.add("Tool", Action::Arm(Tool::BrushRestore), "Brush: restore", None);
}

/// Deformations to place: those with keys first, then all others.
fn add_deform_actions(all: &mut ActionList) {
    for (kind, key) in [
        ("peel", Key::P),
        ("knife", Key::K),
        ("wedge", Key::W),
        ("box", Key::B),
        ("half-space", Key::C),
        ("pull", Key::U),
        ("twist", Key::T),
        ("explode", Key::X),
    ] {
        if let Ok(found) = kinds::kind(kind) {
            all.add(
                "Deform",
                Action::Arm(Tool::Place(Placed(found))),
                &format!("Place {}", super::tool::words(kind)),
                Some((NONE, key)),
            );
        }
    }
    for kind in kinds::list() {
        let known = [
            "peel",
            "knife",
            "wedge",
            "box",
            "half-space",
            "pull",
            "twist",
            "explode",
            "lasso",
            "brush",
        ];
        if !known.contains(&kind.name) {
            all.add(
                "Deform",
                Action::Arm(Tool::Place(Placed(kind))),
                &format!("Place {}", super::tool::words(kind.name)),
                None,
            );
        }
    }
}

/// Painted maps, and maps computed from the stack.
fn add_map_actions(all: &mut ActionList) {
    all.add("Map", Action::NewMap, "New painted map", None);
    all.add("Map", Action::StackToMap, "Combine the stack into one map", None);
    all.add(
        "Map",
        Action::SaveMap,
        "Save the selected deformation to the library",
        None,
    );
    all.add("Map", Action::CheckField, "Check the field for folds", None);
}

/// Presets of the transfer function.
fn add_transfer_actions(all: &mut ActionList) {
    for preset in transfer::list() {
        all.add(
            "Transfer",
            Action::Preset(preset.name),
            &format!("Transfer function: {}", preset.name),
            None,
        );
    }
    all.add("Transfer", Action::ResetWindow, "Reset window and level", None);
}

/// The display text of a key.
pub fn key_text(key: &KeyboardShortcut) -> String {
    let mut text = String::new();
    let m = key.modifiers;
    for (on, word) in [
        (m.command || m.ctrl, "Ctrl+"),
        (m.alt, "Alt+"),
        (m.shift, "Shift+"),
    ] {
        if on {
            text.push_str(word);
        }
    }
    let name = match key.logical_key {
        Key::OpenBracket => "[",
        Key::CloseBracket => "]",
        Key::Delete => "Del",
        Key::Escape => "Esc",
        Key::ArrowLeft => "Left",
        Key::ArrowRight => "Right",
        Key::ArrowUp => "Up",
        Key::ArrowDown => "Down",
        other => other.name(),
    };
    text + name
}

/// The key of a text; none if it does not name a key.
pub fn key_from_text(text: &str) -> Option<KeyboardShortcut> {
    let mut modifiers = Modifiers::NONE;
    let mut rest = text;
    loop {
        let (before, mask) = match rest {
            _ if rest.starts_with("Ctrl+") => (5, Modifiers::COMMAND),
            _ if rest.starts_with("Alt+") => (4, Modifiers::ALT),
            _ if rest.starts_with("Shift+") => (6, Modifiers::SHIFT),
            _ => break,
        };
        modifiers = modifiers.plus(mask);
        rest = &rest[before..];
    }
    let key = match rest {
        "[" => Key::OpenBracket,
        "]" => Key::CloseBracket,
        "Del" => Key::Delete,
        "Esc" => Key::Escape,
        "Left" => Key::ArrowLeft,
        "Right" => Key::ArrowRight,
        "Up" => Key::ArrowUp,
        "Down" => Key::ArrowDown,
        name => Key::from_name(name)?,
    };
    Some(KeyboardShortcut::new(modifiers, key))
}

/// Former labels of actions with the current ones: the user's keys are saved by label.
pub const FORMER_LABELS: [(&str, &str); 13] = [
    ("Less progress", "Decrease progress"),
    ("More progress", "Increase progress"),
    ("Perspective or orthographic", "Toggle perspective/orthographic"),
    ("Render by slices", "Render with slices"),
    ("Render by rays", "Render with ray casting"),
    ("Before or after deformation", "Toggle before/after deformation"),
    ("Light or dark theme", "Toggle light/dark theme"),
    ("Keyboard…", "Keyboard shortcuts…"),
    ("Messages", "Show log"),
    (
        "Navigate as in 3D Slicer or as in Blender",
        "Toggle 3D Slicer/Blender navigation",
    ),
    ("Open the GPU anew", "Reconnect to the GPU"),
    (
        "Cancel everything that runs in the background",
        "Cancel all background tasks",
    ),
    ("Make one map of the stack", "Combine the stack into one map"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_is_used_once_and_survives_its_text() {
        let all = list();
        for (n, entry) in all.iter().enumerate() {
            assert!(
                !all[..n].iter().any(|e| e.label == entry.label),
                "{} is there twice",
                entry.label
            );
            let Some(key) = &entry.key else { continue };
            assert_eq!(
                key_from_text(&key_text(key)).as_ref(),
                Some(key),
                "{}",
                key_text(key)
            );
            assert!(
                !all[..n].iter().any(|e| e.key == entry.key),
                "{} has a key that another one has",
                entry.label
            );
        }
        assert!(all.len() > 90);
    }
}
