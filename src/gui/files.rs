//! Opening and saving with the related questions, and the handling of a file returned by the
//! dialog.

use super::state::Workstation;
use super::state::document::Document;
use super::state::files::*;
use super::state::log::LogLevel;
use super::state::session::Recovered;
use super::state::tool::tidy;
use crate::export::protect;
use crate::files::OutputFile;
use crate::files::path_text::text_of;
use crate::prepare::placement::placed;
use crate::prepare::{AssetKey, Assets, LoadOptions, Prepared};
use crate::scene::{Deformation, Mode, Scene, Size, VolumeSource};
use crate::volume::load::ReadOptions;
use crate::volume::phantom::is_procedural;
use crate::{Error, mesh};
use eframe::egui::Context;
use egui_file_dialog::DialogState;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{TryRecvError, channel};
use std::sync::{Mutex, PoisonError};

/// The first file of a scene that does not exist.
fn missing(scene: &Scene) -> Option<PathBuf> {
    scene
        .files()
        .into_iter()
        .find(|p| !is_procedural(&p.to_string_lossy()) && !p.exists())
}

impl Workstation {
    /// Opens a file or folder, after a question if edits would be lost.
    pub fn open(&mut self, ctx: &Context, path: &Path) {
        self.after(ctx, NextStep::Open(path.to_owned()));
    }

    /// Takes a step that closes the open scene, after a question if edits would be lost.
    pub fn after(&mut self, ctx: &Context, after: NextStep) {
        if self.doc.as_ref().is_some_and(Document::is_changed) {
            self.autosave();
            self.dialog = Some(Dialog::Unsaved(after));
        } else {
            self.proceed(ctx, after);
        }
    }

    /// Takes the step.
    pub fn proceed(&mut self, ctx: &Context, after: NextStep) {
        self.dialog = None;
        match after {
            NextStep::Open(path) => self.load(ctx, &path),
            NextStep::Recover(file, original) => self.load_recovered(ctx, &file, original),
            NextStep::Close => self.close(),
            NextStep::Quit => self.quit(ctx),
        }
    }

    fn close(&mut self) {
        if let Some(loading) = self.loading.take() {
            loading.cancel();
        }
        self.worker.forget_scene();
        self.doc = None;
        self.session.forget();
        self.history = super::state::history::History::default();
        self.forget_pictures();
    }

    /// Discards pictures and results of the previous scene.
    fn forget_pictures(&mut self) {
        self.view.clear();
        self.prober.forget();
        self.slices.forget();
        self.compare.forget();
        self.thumbnails.forget();
        self.transfer.forget();
        self.hover = None;
        self.measured.clear();
        self.pending_points.clear();
        self.stroke_points.clear();
        self.stroke_before = None;
        self.slice_window = None;
        self.gesture = None;
        self.before = false;
    }

    fn load(&mut self, ctx: &Context, path: &Path) {
        let is_scene = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
        match Scene::of_input(path) {
            Ok(scene) => {
                let name = path.file_name().map_or_else(
                    || path.display().to_string(),
                    |n| n.to_string_lossy().into_owned(),
                );
                self.files.folder = path
                    .parent()
                    .filter(|p| p.is_dir())
                    .map(Path::to_owned)
                    .or(self.files.folder.take());
                self.start_loading(ctx, scene, is_scene.then(|| path.to_owned()), name, false, None);
                if !is_procedural(&path.to_string_lossy()) {
                    self.session.opened(path);
                }
            }
            Err(error) => self.report_error(&error),
        }
    }

    fn load_recovered(&mut self, ctx: &Context, file: &Path, original: Option<PathBuf>) {
        match Scene::load(file) {
            Ok(mut scene) => {
                // A recovered scene's paths are absolute, or relative to where it was saved; it
                // stays associated with its original file.
                if let Some(folder) = original.as_deref().and_then(Path::parent) {
                    match scene.moved_to(folder) {
                        Ok(moved) => scene = moved,
                        Err(error) => self.report_error(&error),
                    }
                }
                let name = original
                    .as_deref()
                    .and_then(Path::file_name)
                    .map_or_else(|| "recovered".into(), |n| n.to_string_lossy().into_owned());
                let recovered = Recovered {
                    file: file.to_owned(),
                    original: original.clone(),
                    saved: None,
                };
                self.start_loading(ctx, scene, original, name, false, Some(recovered));
            }
            Err(error) => self.report_error(&error),
        }
    }

    fn start_loading(
        &mut self,
        ctx: &Context,
        scene: Scene,
        path: Option<PathBuf>,
        name: String,
        same: bool,
        recovered: Option<Recovered>,
    ) {
        if let Some(before) = self.loading.take() {
            before.cancel();
        }
        if let Some(gone) = missing(&scene).filter(|_| !same) {
            let problem = format!("{} does not exist", gone.display());
            if path.is_none() && recovered.is_none() {
                self.report(LogLevel::Error, format!("{problem}; check the path"));
                return;
            }
            self.dialog = Some(Dialog::Locate {
                missing: gone,
                scene: Box::new(scene),
                path,
                name,
                problem,
            });
            return;
        }
        let stage = Arc::new(Mutex::new(("reading", 0.0)));
        let cancel = Arc::new(AtomicBool::new(false));
        let (send, result) = channel();
        let before = self.doc.as_ref().map(|d| d.assets.clone());
        let (shared_stage, stop, context) = (stage.clone(), cancel.clone(), ctx.clone());
        let key = Some(AssetKey::of(&scene));
        let spawned = std::thread::Builder::new().name("loading".into()).spawn(move || {
            let progress = |what: &'static str, share: f32| {
                *shared_stage.lock().unwrap_or_else(PoisonError::into_inner) = (what, share)
            };
            let assets = Assets::load_with(
                &scene,
                &LoadOptions {
                    progress: Some(&progress),
                    cancel: Some(&stop),
                    previous: before.as_deref(),
                },
            );
            // A scene that cannot be resolved is rejected like a file that cannot be read.
            let loaded = assets.map(|assets| {
                // Numbers that the file leaves out are chosen once, from its own camera. An error
                // is reported with the picture's.
                let scene = match placed(&scene, &assets) {
                    Ok(placed) => placed.into_owned(),
                    Err(_) => scene,
                };
                // Values that every frame needs are computed here.
                let problem = Prepared::new(&small(&scene), &assets).err();
                assets.volume.histogram(super::state::panels::BINS);
                assets.volume.window(None, None);
                assets.volume.labels();
                Loaded {
                    scene,
                    assets,
                    problem,
                }
            });
            let _window_closed = send.send(loaded);
            context.request_repaint();
        });
        match spawned {
            Ok(_) => {
                self.loading = Some(Loading {
                    name,
                    stage,
                    cancel,
                    result,
                    key,
                    path,
                    same,
                    recovered,
                })
            }
            Err(e) => self.report(LogLevel::Error, format!("no thread could be started: {e}")),
        }
    }

    /// Loads the files that the open scene newly requires.
    pub(super) fn reload(&mut self, ctx: &Context) {
        let Some(doc) = &self.doc else { return };
        let (scene, path, name) = (doc.scene.clone(), doc.path.clone(), doc.name.clone());
        self.start_loading(ctx, scene, path, name, true, None);
    }

    /// Takes over a finished load.
    pub(super) fn poll_loading(&mut self) {
        let Some(loading) = &self.loading else { return };
        let outcome = match loading.result.try_recv() {
            Err(TryRecvError::Empty) => return,
            Ok(outcome) => outcome,
            Err(TryRecvError::Disconnected) => Err(Error::value(
                loading.name.clone(),
                "reading failed because of an internal error; please report the file",
            )),
        };
        let Some(loading) = self.loading.take() else {
            return;
        };
        let stopped = loading.cancel.load(Ordering::Relaxed);
        match outcome {
            Ok(_) if stopped => self.report_error(&Error::Cancelled),
            Ok(loaded) if loading.same => {
                if let Some(doc) = &mut self.doc {
                    doc.assets = Arc::new(loaded.assets);
                    if let Some(key) = loading.key {
                        doc.loaded = key;
                    }
                    self.failed_assets = None;
                    self.transfer.forget();
                    self.thumbnails.forget();
                }
            }
            Ok(loaded) => self.opened(loaded, loading),
            Err(error) => {
                self.report_error(&error);
                if loading.same {
                    // The scene continues with its previous assets.
                    self.failed_assets = loading.key;
                }
            }
        }
    }

    fn opened(&mut self, loaded: Loaded, loading: Loading) {
        let Loaded {
            scene,
            assets,
            problem,
        } = loaded;
        if let Some(error) = problem {
            self.report(LogLevel::Warning, format!("{}: {error}", loading.name));
        }
        for warning in &assets.volume.warnings {
            self.report(LogLevel::Warning, format!("{}: {warning}", loading.name));
        }
        for notice in assets.library.notices() {
            self.report(LogLevel::Info, notice);
        }
        self.worker.forget_scene();
        self.forget_pictures();
        self.history.start(&scene);
        self.cameras = super::state::history::CameraHistory::default();
        self.failed_assets = None;
        let mut doc = Document::new(scene, loading.path, loading.name, Arc::new(assets));
        let recovered = loading.recovered;
        if recovered.is_some() {
            doc.saved = None;
            self.report(
                LogLevel::Info,
                format!("{}: recovered; save it to keep it", doc.name),
            );
        }
        self.doc = Some(doc);
        if let Some(recovered) = recovered.filter(|r| r.file.exists()) {
            // The old automatic save is removed only once there is a new one.
            match self
                .doc
                .as_ref()
                .map(|d| self.session.autosave(&d.scene, d.path.as_deref()))
            {
                Some(Ok(())) => self.session.discard(&recovered),
                Some(Err(error)) => self.report_error(&error),
                None => {}
            }
        }
        self.failed_assets = None;
    }

    /// The open scene's name, marked if it has unsaved edits.
    pub fn title(&self) -> String {
        self.doc.as_ref().map_or_else(String::new, |d| {
            format!("{}{}", d.name, if d.is_changed() { "*" } else { "" })
        })
    }

    /// Handles a file that was dropped onto the window, or chosen in addition to an open scene.
    pub fn dropped(&mut self, ctx: &Context, path: &Path) {
        let ending = path
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase())
            .unwrap_or_default();
        let Some(doc) = &mut self.doc else {
            self.open(ctx, path);
            return;
        };
        let text = text_of(path);
        match ending.as_str() {
            "toml" => self.open(ctx, path),
            _ if mesh::load::is_mesh(path) => {
                doc.scene
                    .mesh
                    .push(crate::scene::surface::MeshSource::of_file(text));
                doc.selected = super::state::document::Selection::Mesh(doc.scene.mesh.len() - 1);
                self.session.opened(path);
            }
            "mat" | "tfm" | "txt" | "h5" | "lta" | "xfm" => {
                let mut field = crate::scene::Deformation::new("field");
                field.parameters.insert("path", text.as_str());
                doc.add(field);
            }
            _ if doc.assets.has_volume => self.dialog = Some(Dialog::Second(path.to_owned())),
            _ => {
                doc.scene.volume = Some(VolumeSource {
                    path: text,
                    choice: ReadOptions::default(),
                    labels: None,
                    inside: None,
                });
                if doc.scene.render.mode == Mode::Surface {
                    doc.scene.render.mode = Mode::Raycast;
                }
            }
        }
    }

    /// Adds the surface of another volume, at the threshold of its body.
    pub fn add_surface_of(&mut self, ctx: &Context, path: &Path) {
        let path = path.to_owned();
        self.start(ctx, "Reading a volume", move |watch| {
            let iso = crate::volume::load::volume(&path, &ReadOptions::default(), watch)?.body_threshold();
            Ok(Box::new(move |app: &mut Workstation, _: &Context| {
                let Some(doc) = &mut app.doc else { return };
                let name = path.file_name().map(|n| n.to_string_lossy().into_owned());
                let volume = Some(text_of(&path));
                doc.scene.mesh.push(crate::scene::surface::MeshSource {
                    iso: Some(iso),
                    volume,
                    name,
                    ..Default::default()
                });
                doc.selected = super::state::document::Selection::Mesh(doc.scene.mesh.len() - 1);
            }))
        });
    }

    /// Adds a displacement field.
    pub fn add_field(&mut self, path: &Path) {
        let Some(doc) = &mut self.doc else { return };
        let mut field = crate::scene::Deformation::new("field");
        field.parameters.insert("path", text_of(path).as_str());
        doc.add(field);
    }

    /// Adds a map from the library, centred and rescaled if its placement does not suit this scene.
    pub fn use_map(&mut self, ctx: &Context, path: &Path) {
        let path = path.to_owned();
        self.start(ctx, "Reading a map", move |watch| {
            let image = crate::volume::load::image(&path, &Default::default(), watch)?;
            let placement = crate::deform::compose::placement_of(&crate::volume::GridGeometry {
                size: image.size,
                world_from_voxel: image.world_from_voxel,
            })?;
            Ok(Box::new(move |app: &mut Workstation, _: &Context| {
                let Some(doc) = &mut app.doc else { return };
                let bounds = doc.bounds();
                let mut d = Deformation::new("map");
                d.name = path.file_stem().map(|s| s.to_string_lossy().into_owned());
                d.parameters.insert("path", text_of(&path).as_str());
                // A map whose centre lies in the scene and whose size is comparable keeps its
                // placement; otherwise it is centred and scaled to fit.
                let own = placement.world_from_map.transform_point3(glam::Vec3::splat(0.5));
                let inside = own.cmpge(bounds.min).all() && own.cmple(bounds.max).all();
                let size = placement.size_mm();
                let ratio = size.max_element() / bounds.size().max_element().max(1e-3);
                if !inside || !(0.2..=2.5).contains(&ratio) {
                    d.center = Some(tidy(bounds.center()));
                    d.size = Some(Size::Box(tidy(
                        size / size.max_element() * bounds.size().max_element(),
                    )));
                }
                doc.add(d);
            }))
        });
    }

    /// Removes a map from the library. A scene may still refer to it, so its file is renamed rather
    /// than deleted.
    pub(super) fn remove_map(&mut self, path: &Path) {
        if let Err(e) = std::fs::rename(path, path.with_extension("nrrd.removed")) {
            self.report_error(&Error::io(path, "removing", e));
        }
    }

    /// Closes the file dialog.
    pub fn cancel_files(&mut self) {
        self.files.purpose = None;
    }

    /// Opens a dialog for a file to open.
    pub fn choose_file_to_open(&mut self) {
        const VOLUMES: &[&str] = &[
            "gz", "nii", "nrrd", "nhdr", "mha", "mhd", "vti", "vtk", "tif", "tiff", "png", "jpg", "jpeg",
            "npy", "npz", "raw", "dcm", "dicom", "ima", "zip", "hdr", "img",
        ];
        self.files.open_dialog(
            FilePurpose::Open,
            "Open a scene, a volume or a mesh",
            None,
            &[
                ("Scenes", &["toml"]),
                ("Volumes", VOLUMES),
                ("Meshes", &mesh::load::ENDINGS),
            ],
        );
    }

    /// Opens a dialog for a folder to open.
    pub fn choose_folder_to_open(&mut self) {
        self.files.open_folder_dialog(
            FilePurpose::Open,
            "Open a folder of DICOM files, slices or a Zarr store",
        );
    }

    /// Saves the scene to its file, or asks for one.
    pub fn save(&mut self, ctx: &Context, after: Option<NextStep>) {
        match self.doc.as_ref().and_then(|d| d.path.clone()) {
            Some(path) => self.save_to(ctx, &path, after),
            None => self.choose_save_file(after),
        }
    }

    /// Opens a dialog for the scene's file.
    pub fn choose_save_file(&mut self, after: Option<NextStep>) {
        let Some(doc) = &self.doc else { return };
        let stem = doc
            .name
            .split('.')
            .next()
            .filter(|s| !s.is_empty())
            .unwrap_or("scene");
        let name = format!("{}.toml", stem.replace([':', '/'], "-"));
        self.files
            .open_dialog(FilePurpose::Save(after), "Save the scene", Some(&name), &[]);
    }

    /// Saves the scene to a file.
    pub fn save_to(&mut self, ctx: &Context, path: &Path, after: Option<NextStep>) {
        let path = with_ending(path, "toml");
        let Some(doc) = &mut self.doc else { return };
        let result = (|| {
            protect("save", &path, doc.scene.files().iter().map(PathBuf::as_path))?;
            let folder = path.parent().unwrap_or(Path::new(""));
            let moved = doc.scene.moved_to(folder)?;
            let text = moved.to_toml()?;
            // The scene's own file is an input that is written again; the files it names are not.
            OutputFile::replacing(&path)?.finish(text.as_bytes())?;
            Ok::<Scene, Error>(moved)
        })();
        match result {
            Ok(moved) => {
                doc.scene = moved;
                doc.saved = Some(doc.scene.clone());
                doc.name = path
                    .file_name()
                    .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
                doc.path = Some(path.clone());
                self.history.take_snapshot(&doc.scene);
                self.session.forget();
                self.session.opened(&path);
                self.report(LogLevel::Info, format!("Saved {}", path.display()));
                if let Some(after) = after {
                    self.proceed(ctx, after);
                }
            }
            Err(error) => self.report_error(&error),
        }
    }

    /// Shows the file dialog and handles a chosen file.
    pub(super) fn show_files(&mut self, ctx: &Context) {
        if self.files.purpose.is_none() {
            return;
        }
        self.files.dialog.update(ctx);
        let picked = self.files.dialog.take_picked();
        let closed = matches!(
            self.files.dialog.state(),
            DialogState::Cancelled | DialogState::Closed
        );
        if let Some(path) = picked {
            let Some(purpose) = self.files.purpose.take() else {
                return;
            };
            self.files.folder = path.parent().map(Path::to_owned);
            self.chosen(ctx, &path, purpose);
        } else if closed && let Some(FilePurpose::Locate(dialog)) = self.files.purpose.take() {
            self.dialog = Some(*dialog);
        }
    }

    /// Handles a chosen file according to its purpose.
    pub fn chosen(&mut self, ctx: &Context, path: &Path, purpose: FilePurpose) {
        match purpose {
            FilePurpose::Open => self.open(ctx, path),
            FilePurpose::Save(after) => self.save_to(ctx, path, after),
            FilePurpose::Picture(form) => self.export_picture(ctx, path, &form),
            FilePurpose::Clip(form) => self.export_clip(ctx, path, &form),
            FilePurpose::Bake { field } => self.export_baked(ctx, path, field),
            FilePurpose::Report => self.export_report(ctx, path),
            FilePurpose::Measures => self.export_measures(path),
            FilePurpose::ImportTransfer => self.import_transfer(path),
            FilePurpose::ExportTransfer => self.export_transfer(path),
            FilePurpose::Labels => self.set_labels(path),
            FilePurpose::Locate(dialog) => {
                if let Dialog::Locate {
                    missing,
                    scene,
                    path: file,
                    name,
                    ..
                } = *dialog
                {
                    let mut scene = *scene;
                    scene.relocate(&missing, path);
                    // With the relocated file the scene counts as never saved.
                    let recovered = Recovered {
                        file: PathBuf::new(),
                        original: file.clone(),
                        saved: None,
                    };
                    self.start_loading(ctx, scene, file, name, false, Some(recovered));
                }
            }
        }
    }

    /// Opens a dialog to locate a missing file.
    pub fn choose_missing_file(&mut self, dialog: Dialog) {
        let title = match &dialog {
            Dialog::Locate { missing, .. } => format!(
                "Locate {}",
                missing.file_name().unwrap_or_default().to_string_lossy()
            ),
            _ => "Locate".into(),
        };
        self.files
            .open_dialog(FilePurpose::Locate(Box::new(dialog)), &title, None, &[]);
    }
}

/// The scene at the smallest size, which suffices to find invalid settings.
fn small(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    scene.render.size = [16, 16];
    scene
}

/// A path with an extension, added if it has none.
pub(super) fn with_ending(path: &Path, ending: &str) -> PathBuf {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending)) {
        return path.to_owned();
    }
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".");
    name.push(ending);
    path.with_file_name(name)
}
