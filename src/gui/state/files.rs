//! State of opening, saving and the related dialogs.

use super::session::Recovered;
use crate::prepare::{AssetKey, Assets};
use crate::scene::{Antialias, Scene};
use crate::{Error, Result};
use eframe::egui;
use egui_file_dialog::FileDialog;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, PoisonError};

/// The step to take after a question.
#[derive(Clone, Debug, PartialEq)]
pub enum NextStep {
    /// Open a file.
    Open(PathBuf),
    /// Open an automatic save left behind by a crash.
    Recover(PathBuf, Option<PathBuf>),
    /// Close the scene.
    Close,
    /// Close the window.
    Quit,
}

/// A question or a form.
#[derive(Clone, Debug)]
pub enum Dialog {
    /// The scene has unsaved edits.
    Unsaved(NextStep),
    /// Scenes left behind by crashes.
    Recover(Vec<Recovered>),
    /// A picture to export.
    Picture(PictureForm),
    /// A clip to export.
    Clip(ClipForm),
    /// A file of the scene is missing.
    Locate {
        /// The missing file.
        missing: PathBuf,
        /// The scene that refers to it.
        scene: Box<Scene>,
        /// Its file.
        path: Option<PathBuf>,
        /// Its name.
        name: String,
        /// The error.
        problem: String,
    },
    /// A second volume was dropped.
    Second(PathBuf),
    /// A request to close the window while exports run.
    Running,
    /// The name of a map to save.
    SaveMap {
        /// The name.
        name: String,
        /// Save the whole stack instead of the selected deformation.
        stack: bool,
    },
}

/// How a picture is exported.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureForm {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Antialiasing.
    pub antialias: Antialias,
    /// Sampling distance, voxels.
    pub step: f32,
    /// Without a background.
    pub transparent: bool,
}

/// What is animated in a clip.
#[derive(Clone, Debug, PartialEq)]
pub enum ClipMotion {
    /// The camera, one full turn.
    Orbit,
    /// The progress of the selected deformation.
    Progress(usize),
    /// A parameter of a deformation: its index, and the parameter's name.
    Parameter(usize, String),
}

/// How a clip is exported.
#[derive(Clone, Debug, PartialEq)]
pub struct ClipForm {
    /// What is animated.
    pub travel: ClipMotion,
    /// Start and end value, except for an orbit.
    pub range: [f32; 2],
    /// Plays forwards, then backwards.
    pub back: bool,
    /// Number of frames.
    pub frames: usize,
    /// Frames per second.
    pub rate: f32,
    /// Width and height, pixels.
    pub size: [u32; 2],
}

/// The purpose of the file dialog.
#[derive(Clone, Debug)]
pub enum FilePurpose {
    /// To open.
    Open,
    /// To save the scene, and then take a step.
    Save(Option<NextStep>),
    /// To export a picture.
    Picture(PictureForm),
    /// To export a clip.
    Clip(ClipForm),
    /// To bake the volume or the field.
    Bake {
        /// The field instead of the volume.
        field: bool,
    },
    /// The folder for a report.
    Report,
    /// A table of measurements.
    Measures,
    /// A transfer function to read.
    ImportTransfer,
    /// A transfer function to write.
    ExportTransfer,
    /// The location of a missing file.
    Locate(Box<Dialog>),
    /// A label map for the volume.
    Labels,
}

impl FilePurpose {
    /// The extension of a saved file, if there is exactly one, and its name.
    pub(in crate::gui) fn ending(&self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Save(_) => Some(("toml", "Scene")),
            Self::ExportTransfer => Some(("toml", "Transfer function")),
            Self::Picture(_) => Some(("png", "Picture")),
            Self::Measures => Some(("csv", "Table")),
            _ => None,
        }
    }
}

/// The file dialog and its purpose.
pub struct Files {
    pub(in crate::gui) dialog: FileDialog,
    pub(in crate::gui) purpose: Option<FilePurpose>,
    pub(in crate::gui) folder: Option<PathBuf>,
}

impl Files {
    /// No open dialog.
    pub fn new() -> Self {
        Self {
            dialog: FileDialog::new(),
            purpose: None,
            folder: None,
        }
    }

    /// Whether the dialog is open.
    pub fn is_open(&self) -> bool {
        self.purpose.is_some()
    }

    /// Opens the dialog.
    pub(in crate::gui) fn open_dialog(
        &mut self,
        purpose: FilePurpose,
        title: &str,
        name: Option<&str>,
        filters: &[(&str, &'static [&'static str])],
    ) {
        let mut dialog = FileDialog::new()
            .title(title)
            .default_size([760.0, 460.0])
            .as_modal(true)
            .anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0])
            .movable(false);
        if let Some(folder) = &self.folder {
            dialog = dialog.initial_directory(folder.clone());
        }
        if let Some(name) = name {
            dialog = dialog.default_file_name(name);
        }
        for (label, endings) in filters {
            dialog = dialog.add_file_filter_extensions(label, endings.to_vec());
        }
        // With the extension added, the dialog checks the file that will actually be written.
        if let Some(ending) = purpose.ending() {
            dialog = dialog
                .add_save_extension(ending.1, ending.0)
                .default_save_extension(ending.1);
        }
        let saves = name.is_some();
        self.dialog = dialog;
        match &purpose {
            FilePurpose::Report => self.dialog.pick_directory(),
            _ if saves => self.dialog.save_file(),
            _ => self.dialog.pick_file(),
        }
        self.purpose = Some(purpose);
    }

    pub(in crate::gui) fn open_folder_dialog(&mut self, purpose: FilePurpose, title: &str) {
        self.open_dialog(purpose, title, None, &[]);
        self.dialog.pick_directory();
    }
}

impl Default for Files {
    fn default() -> Self {
        Self::new()
    }
}

/// A file being loaded.
pub struct Loading {
    /// Its name.
    pub name: String,
    pub(in crate::gui) stage: Arc<Mutex<(&'static str, f32)>>,
    pub(in crate::gui) cancel: Arc<AtomicBool>,
    pub(in crate::gui) result: Receiver<Result<Loaded>>,
    /// The key for which it was requested, if any.
    pub(in crate::gui) key: Option<AssetKey>,
    pub(in crate::gui) path: Option<PathBuf>,
    /// It replaces only the assets of the open scene.
    pub(in crate::gui) same: bool,
    /// The automatic save it is recovered from; the scene counts as never saved.
    pub(in crate::gui) recovered: Option<Recovered>,
}

pub(in crate::gui) struct Loaded {
    pub(in crate::gui) scene: Scene,
    pub(in crate::gui) assets: Assets,
    /// Why the scene cannot be shown as it is.
    pub(in crate::gui) problem: Option<Error>,
}

impl Loading {
    /// The current stage, and the fraction done.
    pub fn stage(&self) -> (&'static str, f32) {
        *self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Cancels the load.
    pub fn cancel(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }
}
