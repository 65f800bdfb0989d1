//! The state of the workstation: the open scene, requests and their results, the selection, the
//! armed tool and the current drag. It depends on no panel and no view; those read it, and the
//! application changes it.

pub mod action;
pub mod comparison;
pub mod document;
pub mod files;
pub mod history;
pub mod layout;
pub mod log;
pub mod panels;
pub mod request;
pub mod session;
pub mod shown;
pub mod slice_paint;
pub mod slices;
pub mod tasks;
pub mod tool;
pub mod view;
pub mod worker;

use self::action::{Action, ActionEntry};
use self::comparison::ComparePanel;
use self::document::{Document, Selection};
use self::files::{Dialog, Files, Loading};
use self::history::{CameraHistory, History};
use self::layout::{LayoutPreset, Panel};
use self::log::Log;
use self::panels::{
    Brush, Inspector, KeyList, MapEditor, MeasurePanel, Palette, ScenePanel, Thumbnails, TransferPanel,
};
use self::session::Session;
use self::slice_paint::Regions;
use self::slices::Slices;
use self::tasks::Task;
use self::tool::Tool;
use self::view::View3d;
use self::worker::{MeasureResult, Prober, Worker};
use super::gizmos::Drag;
use super::text::number;
use crate::engine::Backend;
use crate::prepare::measure::value_at;
use crate::prepare::{AssetKey, Assets};
use crate::scene::Scene;
use crate::scene::measure::Measure;
use egui_dock::DockState;
use glam::Vec3;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

/// Start options of a workstation.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The file to open.
    pub file: Option<PathBuf>,
    /// Folder for settings, automatic saves and maps; the user's own folder by default.
    pub folder: Option<PathBuf>,
    /// The backend, overriding the settings.
    pub backend: Option<Backend>,
}

/// A drag in a view.
#[derive(Clone, Debug)]
#[allow(missing_docs, reason = "each is what the pointer does")]
pub enum Gesture {
    Orbit,
    Pan,
    Zoom,
    Roll,
    Gizmo(Box<Drag>),
    Lasso,
    Brush,
    Window3d,
    Crosshair,
    SlicePan,
    SliceZoom,
    Window,
    SliceBrush,
}

/// The point under the pointer.
#[derive(Clone, Debug)]
pub struct Hover {
    /// Its deformed position, mm; none in a view of the source.
    pub deformed: Option<Vec3>,
    /// Its source position, mm.
    pub source: Vec3,
    /// The volume's value there.
    pub value: Option<f64>,
    /// The label's name there.
    pub region: Option<String>,
}

impl Hover {
    /// A point of a picture; its value is taken from the picture if available, else from the
    /// nearest voxel.
    pub fn new(assets: &Assets, deformed: Option<Vec3>, source: Vec3, value: Option<f64>) -> Self {
        let value = value.or_else(|| {
            assets
                .has_volume
                .then(|| value_at(&assets.volume, source.as_dvec3()))
                .flatten()
        });
        let region = Regions::new(assets).and_then(|r| r.label(source).filter(|l| *l > 0).map(|l| r.name(l)));
        Self {
            deformed,
            source,
            value,
            region,
        }
    }

    /// The text for the status bar.
    pub fn words(&self) -> String {
        let place = |p: Vec3| {
            let side = |v: f32, high: char, low: char| {
                format!("{:.1} {}", v.abs(), if v > -0.05 { high } else { low })
            };
            format!(
                "{} {} {}",
                side(p.x, 'L', 'R'),
                side(p.y, 'P', 'A'),
                side(p.z, 'S', 'I')
            )
        };
        let mut words = match self.deformed {
            Some(deformed) if deformed.distance(self.source) > 0.05 => {
                format!(
                    "{} mm {} source {}",
                    place(deformed),
                    egui_phosphor::regular::ARROW_RIGHT,
                    place(self.source)
                )
            }
            _ => format!("{} mm", place(self.source)),
        };
        if let Some(value) = self.value {
            words += &format!(" · {}", number(value, ""));
        }
        if let Some(region) = &self.region {
            words += &format!(" · {region}");
        }
        words
    }
}

/// A clicked point.
#[derive(Clone, Copy, Debug)]
pub struct PickedPoint {
    /// Its deformed position, mm.
    pub deformed: Vec3,
    /// Its source position, mm.
    pub source: Vec3,
}

/// The application.
pub struct Workstation {
    /// The open scene.
    pub doc: Option<Document>,
    pub(in crate::gui) history: History,
    pub(in crate::gui) cameras: CameraHistory,
    pub(in crate::gui) worker: Worker,
    pub(in crate::gui) prober: Prober,
    /// The user's settings and automatic saves.
    pub session: Session,
    /// The messages.
    pub log: Log,
    pub(in crate::gui) toasts: egui_notify::Toasts,
    pub(in crate::gui) dock: DockState<Panel>,
    pub(in crate::gui) layout: LayoutPreset,
    /// Panels to bring to the front, and whether to open closed ones.
    pub(in crate::gui) panels_to_show: Vec<(Panel, bool)>,
    /// The armed tool.
    pub tool: Tool,
    pub(in crate::gui) gesture: Option<Gesture>,
    /// The 3D view.
    pub view: View3d,
    /// The slice views.
    pub slices: Slices,
    pub(in crate::gui) slice_window: Option<[f64; 2]>,
    pub(in crate::gui) transfer: TransferPanel,
    /// The comparison.
    pub compare: ComparePanel,
    pub(in crate::gui) inspector: Inspector,
    pub(in crate::gui) brush: Brush,
    pub(in crate::gui) map_editor: MapEditor,
    pub(in crate::gui) scene_panel: ScenePanel,
    pub(in crate::gui) measure_panel: MeasurePanel,
    pub(in crate::gui) thumbnails: Thumbnails,
    /// The measurements, with their values.
    pub measured: Vec<MeasureResult>,
    pub(in crate::gui) measured_of: Option<(Vec<Measure>, Arc<Scene>, usize)>,
    pub(in crate::gui) pending_points: Vec<PickedPoint>,
    pub(in crate::gui) stroke_points: Vec<Vec3>,
    pub(in crate::gui) stroke_before: Option<Vec<String>>,
    /// The scene on which the current stroke is drawn.
    pub(in crate::gui) stroke_scene: Option<Arc<Scene>>,
    /// Files dropped together, waiting to be opened one after the other.
    pub(in crate::gui) dropped: Vec<PathBuf>,
    /// The point under the pointer.
    pub hover: Option<Hover>,
    /// The file being loaded.
    pub loading: Option<Loading>,
    /// Background tasks.
    pub tasks: Vec<Task>,
    /// The open dialog.
    pub dialog: Option<Dialog>,
    pub(in crate::gui) files: Files,
    pub(in crate::gui) palette: Option<Palette>,
    pub(in crate::gui) key_list: Option<KeyList>,
    /// All actions, with the user's keys.
    pub entries: Vec<ActionEntry>,
    pub(in crate::gui) before: bool,
    pub(in crate::gui) space: bool,
    pub(in crate::gui) serial: u64,
    /// Counts changes of the scene.
    pub edits: u64,
    pub(in crate::gui) last_scene: Option<Arc<Scene>>,
    /// Assets that failed to load; they are not requested again until the scene changes.
    pub(in crate::gui) failed_assets: Option<AssetKey>,
    /// Times of the most recent frames, ms.
    pub frame_ms: VecDeque<f32>,
    pub(in crate::gui) quitting: bool,
    /// The last failure of a picture, so that it is reported once.
    pub(in crate::gui) failure: Option<String>,
    pub(in crate::gui) forced_backend: Option<Backend>,
    /// The window's title.
    pub(in crate::gui) title: String,
}

impl Workstation {
    /// Whether the undeformed volume is shown.
    pub fn shows_undeformed(&self) -> bool {
        self.before != self.space
    }

    /// Whether work is in progress: loading, tasks, pictures.
    pub fn is_busy(&self) -> bool {
        let waits = !self.view.is_fine && self.view.failure().is_none();
        let views = self.doc.is_some()
            && self.view.rect.width() > 8.0
            && waits
            && self.dock.find_tab(&Panel::View3d).is_some();
        self.loading.is_some()
            || !self.tasks.is_empty()
            || !self.worker.is_idle()
            || self.prober.open > 0
            || views
    }

    /// Whether no request for the point under the pointer is pending.
    pub fn prober_is_idle(&self) -> bool {
        self.prober.open == 0
    }

    /// The index of the selected deformation, if any.
    pub fn selected_deformation(&self) -> Option<usize> {
        self.doc.as_ref().and_then(Document::deformation_index)
    }

    /// Selects something.
    pub fn select(&mut self, selection: Selection) {
        if let Some(doc) = &mut self.doc {
            doc.selected = selection;
        }
    }

    /// The selected backend.
    pub fn backend(&self) -> Backend {
        self.forced_backend.unwrap_or(self.session.settings.backend)
    }

    /// The name of the selection.
    pub fn selection_words(&self) -> String {
        let Some(doc) = &self.doc else {
            return String::new();
        };
        match doc.selected {
            Selection::Nothing => "Picture".into(),
            Selection::Volume => "Volume".into(),
            Selection::Mesh(n) => doc
                .scene
                .mesh
                .get(n)
                .and_then(|m| m.name.clone().or_else(|| m.path.clone()))
                .unwrap_or_else(|| "Surface".into()),
            Selection::Deformation(n) => doc
                .scene
                .deformation
                .get(n)
                .map(Document::title_of)
                .unwrap_or_default(),
            Selection::Measure(n) => doc
                .scene
                .measure
                .get(n)
                .and_then(|m| m.name.clone())
                .unwrap_or_else(|| "Measurement".into()),
        }
    }

    pub(in crate::gui) fn tip(&self, action: Action, about: &str) -> String {
        let key = self
            .entries
            .iter()
            .find(|e| e.action == action)
            .and_then(|e| e.key.as_ref());
        match key {
            Some(key) => format!("{about} ({})", action::key_text(key)),
            None => about.to_owned(),
        }
    }
}
