//! Everything that can be done without pointing at something: one list for menus, keys, the command palette and tests.

use super::tool::{Placed, Tool};
use crate::deform::kinds;
use crate::scene::Mode;
use crate::scene::measure::MeasureKind;
use crate::transfer;
use eframe::egui::{Key, KeyboardShortcut, Modifiers};

/// One thing to do.
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

/// An action as people find it.
pub struct ActionEntry {
    /// What it is.
    pub action: Action,
    /// Its words.
    pub label: String,
    /// Where it belongs.
    pub group: &'static str,
    /// Its key by default.
    pub key: Option<KeyboardShortcut>,
}

const CTRL: Modifiers = Modifiers::COMMAND;
const CTRL_SHIFT: Modifiers = Modifiers::COMMAND.plus(Modifiers::SHIFT);
const SHIFT: Modifiers = Modifiers::SHIFT;
const NONE: Modifiers = Modifiers::NONE;

/// All of them, in the order of menus.
pub fn list() -> Vec<ActionEntry> {
    use super::layout::LayoutPreset as Layout;
    let mut all = Vec::new();
    let mut add = |group: &'static str, action: Action, label: &str, key: Option<(Modifiers, Key)>| {
        all.push(ActionEntry { action, label: label.into(), group, key: key.map(|(m, k)| KeyboardShortcut::new(m, k)) });
    };
    add("File", Action::Open, "Open…", Some((CTRL, Key::O)));
    add("File", Action::OpenFolder, "Open folder (DICOM)…", Some((CTRL_SHIFT, Key::O)));
    add("File", Action::OpenHead, "Open the bundled head", None);
    add("File", Action::Save, "Save", Some((CTRL, Key::S)));
    add("File", Action::SaveAs, "Save as…", Some((CTRL_SHIFT, Key::S)));
    add("File", Action::Close, "Close the scene", Some((CTRL, Key::W)));
    add("File", Action::Quit, "Quit", Some((CTRL, Key::Q)));
    add("Export", Action::ExportPicture, "Export picture…", Some((CTRL, Key::E)));
    add("Export", Action::ExportClip, "Export clip…", None);
    add("Export", Action::ExportVolume, "Bake the deformed volume…", None);
    add("Export", Action::ExportField, "Bake the displacement field…", None);
    add("Export", Action::ExportReport, "Export comparison report…", None);
    add("Export", Action::ExportMeasures, "Export measurements…", None);
    add("Export", Action::CopyCommand, "Copy as incise render …", Some((Modifiers::ALT, Key::C)));
    add("Export", Action::ImportTransfer, "Import transfer function…", None);
    add("Export", Action::ExportTransfer, "Export transfer function…", None);
    add("Edit", Action::Undo, "Undo", Some((CTRL, Key::Z)));
    add("Edit", Action::Redo, "Redo", Some((CTRL_SHIFT, Key::Z)));
    add("Edit", Action::Delete, "Delete", Some((NONE, Key::Delete)));
    add("Edit", Action::Duplicate, "Duplicate", Some((CTRL, Key::D)));
    add("Edit", Action::Mute, "Mute", Some((NONE, Key::H)));
    add("Edit", Action::Solo, "Solo", Some((SHIFT, Key::H)));
    add("Edit", Action::MoveUp, "Move up in the stack", Some((CTRL, Key::ArrowUp)));
    add("Edit", Action::MoveDown, "Move down in the stack", Some((CTRL, Key::ArrowDown)));
    add("Edit", Action::Less, "Decrease progress", Some((NONE, Key::OpenBracket)));
    add("Edit", Action::More, "Increase progress", Some((NONE, Key::CloseBracket)));
    add("Edit", Action::SelectNext, "Select the next deformation", Some((NONE, Key::N)));
    add("Edit", Action::Deselect, "Deselect", Some((NONE, Key::Escape)));
    for (name, label, key) in [
        ("anterior", "View from anterior", Some((NONE, Key::Num1))),
        ("posterior", "View from posterior", Some((SHIFT, Key::Num1))),
        ("left", "View from left", Some((NONE, Key::Num3))),
        ("right", "View from right", Some((SHIFT, Key::Num3))),
        ("superior", "View from superior", Some((NONE, Key::Num7))),
        ("inferior", "View from inferior", Some((SHIFT, Key::Num7))),
    ] {
        add("View", Action::View(name), label, key);
    }
    add("View", Action::Opposite, "View from the opposite side", Some((NONE, Key::Num9)));
    add("View", Action::ResetCamera, "Reset camera", Some((NONE, Key::R)));
    add("View", Action::FrameSelection, "Frame selection", Some((NONE, Key::F)));
    add("View", Action::CameraBack, "Camera back", Some((Modifiers::ALT, Key::ArrowLeft)));
    add("View", Action::CameraForward, "Camera forward", Some((Modifiers::ALT, Key::ArrowRight)));
    add("View", Action::ToggleProjection, "Toggle perspective/orthographic", Some((NONE, Key::Num5)));
    add("View", Action::NextMode, "Next render mode", Some((NONE, Key::V)));
    add("View", Action::SetMode(Mode::Slice), "Render with slices", None);
    add("View", Action::SetMode(Mode::Raycast), "Render with ray casting", None);
    add("View", Action::SetMode(Mode::Surface), "Render surfaces", None);
    add("View", Action::Compare, "Compare renderers", Some((SHIFT, Key::V)));
    add("View", Action::BeforeAfter, "Toggle before/after deformation", Some((NONE, Key::Tab)));
    add("Window", Action::Layout(Layout::Only3d), "Layout: 3D only", None);
    add("Window", Action::Layout(Layout::FourUp), "Layout: four-up", None);
    add("Window", Action::Layout(Layout::Compare), "Layout: compare", None);
    add("Window", Action::ToggleTheme, "Toggle light/dark theme", None);
    add("Window", Action::ScaleUp, "Larger interface", Some((CTRL, Key::Plus)));
    add("Window", Action::ScaleDown, "Smaller interface", Some((CTRL, Key::Minus)));
    add("Window", Action::Palette, "Command palette", Some((CTRL, Key::K)));
    add("Window", Action::Keys, "Keyboard shortcuts…", Some((NONE, Key::F1)));
    add("Window", Action::Log, "Show log", None);
    add("Window", Action::Navigation, "Toggle 3D Slicer/Blender navigation", None);
    add("Window", Action::ResetGpu, "Reconnect to the GPU", None);
    add("Window", Action::CancelTasks, "Cancel all background tasks", None);
    add("Tool", Action::Arm(Tool::Navigate), "Orbit", Some((NONE, Key::O)));
    add("Tool", Action::Arm(Tool::Probe), "Probe", Some((NONE, Key::I)));
    add("Tool", Action::Arm(Tool::Measure(MeasureKind::Distance)), "Measure a distance", Some((NONE, Key::M)));
    add("Tool", Action::Arm(Tool::Measure(MeasureKind::Angle)), "Measure an angle", Some((SHIFT, Key::M)));
    add("Tool", Action::Arm(Tool::LassoCut), "Lasso cut", Some((NONE, Key::L)));
    add("Tool", Action::Arm(Tool::LassoRestore), "Lasso restore", Some((SHIFT, Key::L)));
    add("Tool", Action::Arm(Tool::BrushPush), "Brush: push", Some((NONE, Key::G)));
    add("Tool", Action::Arm(Tool::BrushSmooth), "Brush: smooth", None);
    add("Tool", Action::Arm(Tool::BrushCut), "Brush: cut", None);
    add("Tool", Action::Arm(Tool::BrushRestore), "Brush: restore", None);
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
            add("Deform", Action::Arm(Tool::Place(Placed(found))), &format!("Place {}", super::tool::words(kind)), Some((NONE, key)));
        }
    }
    for kind in kinds::list() {
        let known = ["peel", "knife", "wedge", "box", "half-space", "pull", "twist", "explode", "lasso", "brush"];
        if !known.contains(&kind.name) {
            add("Deform", Action::Arm(Tool::Place(Placed(kind))), &format!("Place {}", super::tool::words(kind.name)), None);
        }
    }
    add("Map", Action::NewMap, "New painted map", None);
    add("Map", Action::StackToMap, "Combine the stack into one map", None);
    add("Map", Action::SaveMap, "Save the selected deformation to the library", None);
    add("Map", Action::CheckField, "Check the field for folds", None);
    for preset in transfer::list() {
        add("Transfer", Action::Preset(preset.name), &format!("Transfer function: {}", preset.name), None);
    }
    add("Transfer", Action::ResetWindow, "Reset window and level", None);
    all
}

/// A key as people read it.
pub fn key_text(key: &KeyboardShortcut) -> String {
    let mut text = String::new();
    let m = key.modifiers;
    for (on, word) in [(m.command || m.ctrl, "Ctrl+"), (m.alt, "Alt+"), (m.shift, "Shift+")] {
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

/// A key from its text; none if it names no key.
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

/// Labels that actions had before, with what they are called now: the user's keys are saved by label.
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
    ("Navigate as in 3D Slicer or as in Blender", "Toggle 3D Slicer/Blender navigation"),
    ("Open the GPU anew", "Reconnect to the GPU"),
    ("Cancel everything that runs in the background", "Cancel all background tasks"),
    ("Make one map of the stack", "Combine the stack into one map"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_is_used_once_and_survives_its_text() {
        let all = list();
        for (n, entry) in all.iter().enumerate() {
            assert!(!all[..n].iter().any(|e| e.label == entry.label), "{} is there twice", entry.label);
            let Some(key) = &entry.key else { continue };
            assert_eq!(key_from_text(&key_text(key)).as_ref(), Some(key), "{}", key_text(key));
            assert!(!all[..n].iter().any(|e| e.key == entry.key), "{} has a key that another one has", entry.label);
        }
        assert!(all.len() > 90);
    }
}
