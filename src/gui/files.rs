//! Opening, saving and exporting, and the questions that come with it.

use super::app::Workstation;
use super::document::{AssetKey, Document};
use super::log::Level;
use super::session::Recovered;
use super::tasks::said;
use crate::compare::Report;
use crate::deform::{Stack, saved};
use crate::export::{Output, bake, clip, png, protect};
use crate::scene::{Assets, Deformed, Mode, Prepared, Scene, VolumeSource, measure};
use crate::transfer::TransferSettings;
use crate::volume::load::Choice;
use crate::volume::save::Format;
use crate::{Error, Result, Watch, cpu, mesh};
use eframe::egui::{self, Context};
use egui_file_dialog::{DialogState, FileDialog};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::sync::{Mutex, PoisonError};

/// Largest edge of an exported picture that is offered, pixels.
pub const LARGEST_PICTURE: u32 = 16_384;

/// What is done after a question.
#[derive(Clone, Debug, PartialEq)]
pub enum After {
    /// Open a file.
    Open(PathBuf),
    /// Open an automatic save that a crash left behind.
    Recover(PathBuf, Option<PathBuf>),
    /// Close the scene.
    Close,
    /// Close the window.
    Quit,
}

/// A question or a form.
#[derive(Clone, Debug)]
pub enum Dialog {
    /// The scene has edits that are not saved.
    Unsaved(After),
    /// Scenes that crashed windows left behind.
    Recover(Vec<Recovered>),
    /// A picture to export.
    Picture(PictureForm),
    /// A clip to export.
    Clip(ClipForm),
    /// A file of the scene is not where it was.
    Locate {
        /// The file that is missing.
        missing: PathBuf,
        /// The scene that names it.
        scene: Box<Scene>,
        /// Its file.
        path: Option<PathBuf>,
        /// Its name.
        name: String,
        /// What went wrong.
        problem: String,
    },
    /// A second volume was dropped.
    Second(PathBuf),
    /// A name for a map.
    SaveMap {
        /// The name.
        name: String,
        /// Of the whole stack instead of the selected deformation.
        stack: bool,
    },
}

/// How a picture is exported.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureForm {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Samples averaged along each edge of a pixel.
    pub antialias: u32,
    /// Sampling distance, voxels.
    pub step: f32,
    /// Without a background.
    pub transparent: bool,
}

/// What moves in a clip.
#[derive(Clone, Debug, PartialEq)]
pub enum Travel {
    /// The camera, once around.
    Orbit,
    /// The progress of the selected deformation.
    Progress(usize),
    /// A number of the selected deformation: which deformation, its name.
    Parameter(usize, String),
}

/// How a clip is exported.
#[derive(Clone, Debug, PartialEq)]
pub struct ClipForm {
    /// What moves.
    pub travel: Travel,
    /// From and to, for what is no orbit.
    pub range: [f32; 2],
    /// There and back again.
    pub back: bool,
    /// Frames.
    pub frames: usize,
    /// Frames per second.
    pub rate: f32,
    /// Width and height, pixels.
    pub size: [u32; 2],
}

/// What a file is wanted for.
#[derive(Clone, Debug)]
pub enum Purpose {
    /// To open.
    Open,
    /// To save the scene, and then go on.
    Save(Option<After>),
    /// To export a picture.
    Picture(PictureForm),
    /// To export a clip.
    Clip(ClipForm),
    /// To bake: the field instead of the volume.
    Bake {
        /// The field.
        field: bool,
    },
    /// The folder of a report.
    Report,
    /// A table of measurements.
    Measures,
    /// A transfer function to read.
    ImportTransfer,
    /// A transfer function to write.
    ExportTransfer,
    /// The place of a missing file.
    Locate(Box<Dialog>),
    /// A label map over the volume.
    Labels,
}

/// The file dialog and what it is open for.
pub struct Files {
    dialog: FileDialog,
    purpose: Option<Purpose>,
    folder: Option<PathBuf>,
}

impl Files {
    /// None open.
    pub fn new() -> Self {
        Self { dialog: FileDialog::new(), purpose: None, folder: None }
    }

    /// Whether it is open.
    pub fn is_open(&self) -> bool {
        self.purpose.is_some()
    }

    /// Opens it.
    fn ask(&mut self, purpose: Purpose, title: &str, name: Option<&str>, filters: &[(&str, &'static [&'static str])]) {
        let mut dialog =
            FileDialog::new().title(title).default_size([760.0, 460.0]).as_modal(true).anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0]).movable(false);
        if let Some(folder) = &self.folder {
            dialog = dialog.initial_directory(folder.clone());
        }
        if let Some(name) = name {
            dialog = dialog.default_file_name(name);
        }
        for (label, endings) in filters {
            dialog = dialog.add_file_filter_extensions(label, endings.to_vec());
        }
        let saves = name.is_some();
        self.dialog = dialog;
        match &purpose {
            Purpose::Report => self.dialog.pick_directory(),
            _ if saves => self.dialog.save_file(),
            _ => self.dialog.pick_file(),
        }
        self.purpose = Some(purpose);
    }

    fn ask_folder(&mut self, purpose: Purpose, title: &str) {
        self.ask(purpose, title, None, &[]);
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
    stage: Arc<Mutex<(&'static str, f32)>>,
    cancel: Arc<AtomicBool>,
    result: Receiver<Result<Loaded>>,
    /// What it was asked for.
    key: Option<AssetKey>,
    path: Option<PathBuf>,
    /// It replaces only what is loaded for the open scene.
    same: bool,
    /// The unsaved scene it came from.
    recovered: bool,
}

struct Loaded {
    scene: Scene,
    assets: Assets,
}

impl Loading {
    /// What it does, and the share that is done.
    pub fn stage(&self) -> (&'static str, f32) {
        *self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells it to stop.
    pub fn cancel(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }
}

/// The first file of a scene that is not there.
fn missing(scene: &Scene) -> Option<PathBuf> {
    scene.files().into_iter().find(|p| !p.starts_with("phantom:") && !p.to_string_lossy().starts_with("phantom:") && !p.exists())
}

impl Workstation {
    /// Opens a file or folder, after a question if edits would be lost.
    pub fn open(&mut self, ctx: &Context, path: &Path) {
        self.after(ctx, After::Open(path.to_owned()));
    }

    /// Does something that gives up the open scene, after a question if edits would be lost.
    pub fn after(&mut self, ctx: &Context, after: After) {
        if self.doc.as_ref().is_some_and(Document::is_changed) {
            self.autosave();
            self.dialog = Some(Dialog::Unsaved(after));
        } else {
            self.proceed(ctx, after);
        }
    }

    /// Does it.
    pub fn proceed(&mut self, ctx: &Context, after: After) {
        self.dialog = None;
        match after {
            After::Open(path) => self.load(ctx, &path),
            After::Recover(file, original) => self.load_recovered(ctx, &file, original),
            After::Close => self.close(),
            After::Quit => self.quit(ctx),
        }
    }

    fn close(&mut self) {
        if let Some(loading) = self.loading.take() {
            loading.cancel();
        }
        self.worker.drop_jobs(|_| true);
        self.doc = None;
        self.session.forget();
        self.history = super::history::History::default();
        self.forget_pictures();
    }

    /// Nothing that was shown belongs to the scene any more.
    fn forget_pictures(&mut self) {
        self.view.forget();
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
                let name = path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
                self.files.folder = path.parent().filter(|p| p.is_dir()).map(Path::to_owned).or(self.files.folder.take());
                self.start_loading(ctx, scene, is_scene.then(|| path.to_owned()), name, false, false);
                if !path.to_string_lossy().starts_with("phantom:") {
                    self.session.opened(path);
                }
            }
            Err(error) => self.fail(&error),
        }
    }

    fn load_recovered(&mut self, ctx: &Context, file: &Path, original: Option<PathBuf>) {
        match Scene::load(file) {
            Ok(mut scene) => {
                // Its paths are absolute, or relative to where it was saved; it goes on living where it came from.
                if let Some(folder) = original.as_deref().and_then(Path::parent) {
                    match scene.moved_to(folder) {
                        Ok(moved) => scene = moved,
                        Err(error) => self.fail(&error),
                    }
                }
                let name = original.as_deref().and_then(Path::file_name).map_or_else(|| "recovered".into(), |n| n.to_string_lossy().into_owned());
                self.start_loading(ctx, scene, original, name, false, true);
            }
            Err(error) => self.fail(&error),
        }
    }

    fn start_loading(&mut self, ctx: &Context, scene: Scene, path: Option<PathBuf>, name: String, same: bool, recovered: bool) {
        if let Some(before) = self.loading.take() {
            before.cancel();
        }
        if let Some(gone) = missing(&scene).filter(|_| !same) {
            let problem = format!("{} is not there", gone.display());
            if path.is_none() && !recovered {
                self.say(Level::Error, format!("{problem}; check the path"));
                return;
            }
            self.dialog = Some(Dialog::Locate { missing: gone, scene: Box::new(scene), path, name, problem });
            return;
        }
        let stage = Arc::new(Mutex::new(("reading", 0.0)));
        let cancel = Arc::new(AtomicBool::new(false));
        let (send, result) = channel();
        let before = self.doc.as_ref().map(|d| d.assets.clone());
        let (told, stop, context) = (stage.clone(), cancel.clone(), ctx.clone());
        let key = Some(AssetKey::of(&scene));
        let spawned = std::thread::Builder::new().name("loading".into()).spawn(move || {
            let progress = |what: &'static str, share: f32| *told.lock().unwrap_or_else(PoisonError::into_inner) = (what, share);
            let assets = Assets::load_after(before.as_deref(), &scene, &progress, &stop);
            // A scene that cannot be resolved is no better than a file that cannot be read.
            let loaded = assets.map(|assets| Loaded { scene, assets });
            let _window_closed = send.send(loaded);
            context.request_repaint();
        });
        match spawned {
            Ok(_) => self.loading = Some(Loading { name, stage, cancel, result, key, path, same, recovered }),
            Err(e) => self.say(Level::Error, format!("no thread could be started: {e}")),
        }
    }

    /// Loads what the open scene has come to need.
    pub(super) fn reload(&mut self, ctx: &Context) {
        let Some(doc) = &self.doc else { return };
        let (scene, path, name) = (doc.scene.clone(), doc.path.clone(), doc.name.clone());
        self.start_loading(ctx, scene, path, name, true, false);
    }

    /// Takes over what was loaded.
    pub(super) fn poll_loading(&mut self) {
        let Some(loading) = &self.loading else { return };
        let outcome = match loading.result.try_recv() {
            Err(TryRecvError::Empty) => return,
            Ok(outcome) => outcome,
            Err(TryRecvError::Disconnected) => {
                Err(Error::value(loading.name.clone(), "reading ended by a fault of the program; please report the file"))
            }
        };
        let Some(loading) = self.loading.take() else { return };
        let stopped = loading.cancel.load(Ordering::Relaxed);
        match outcome {
            Ok(_) if stopped => self.fail(&Error::Cancelled),
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
                self.fail(&error);
                if loading.same {
                    // The scene goes on with what it had.
                    self.failed_assets = loading.key;
                }
            }
        }
    }

    fn opened(&mut self, loaded: Loaded, loading: Loading) {
        let Loaded { scene, assets } = loaded;
        if let Err(error) = Prepared::new(&small(&scene), &assets) {
            self.say(Level::Warning, format!("{}: {error}", loading.name));
        }
        for warning in &assets.volume.warnings {
            self.say(Level::Warning, format!("{}: {warning}", loading.name));
        }
        for notice in assets.library.notices() {
            self.say(Level::Info, notice);
        }
        self.worker.drop_jobs(|_| true);
        self.forget_pictures();
        self.history.start(&scene);
        self.cameras = super::history::Cameras::default();
        self.failed_assets = None;
        let mut doc = Document::new(scene, loading.path, loading.name, Arc::new(assets));
        if loading.recovered {
            doc.saved = None;
            self.say(Level::Info, format!("{}: recovered; save it to keep it", doc.name));
        }
        self.doc = Some(doc);
        self.failed_assets = None;
    }

    /// The open scene's name, marked if it has edits.
    pub fn title(&self) -> String {
        self.doc.as_ref().map_or_else(String::new, |d| format!("{}{}", d.name, if d.is_changed() { "*" } else { "" }))
    }

    /// A file was dropped onto the window, or chosen beside an open scene.
    pub fn dropped(&mut self, ctx: &Context, path: &Path) {
        let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        let Some(doc) = &mut self.doc else {
            self.open(ctx, path);
            return;
        };
        let text = path.to_string_lossy().into_owned();
        match ending.as_str() {
            "toml" => self.open(ctx, path),
            _ if mesh::load::is_mesh(path) => {
                doc.scene.mesh.push(mesh_source(&text));
                doc.selected = super::document::Selection::Mesh(doc.scene.mesh.len() - 1);
                self.session.opened(path);
            }
            "mat" | "tfm" | "txt" | "h5" | "lta" | "xfm" => {
                let mut field = crate::scene::Deformation::new("field");
                field.parameters.insert("path", text.as_str());
                doc.add(field);
            }
            _ if doc.assets.has_volume => self.dialog = Some(Dialog::Second(path.to_owned())),
            _ => {
                doc.scene.volume = Some(VolumeSource { path: text, choice: Choice::default(), labels: None, inside: None });
                if doc.scene.render.mode == Mode::Surface {
                    doc.scene.render.mode = Mode::Raycast;
                }
            }
        }
    }

    /// Adds the surface of another volume at the value where its body begins.
    pub fn add_surface_of(&mut self, path: &Path) {
        let Some(doc) = &mut self.doc else { return };
        let text = path.to_string_lossy().into_owned();
        match crate::volume::load::volume(path, &Choice::default(), &Watch::NOBODY) {
            Ok(volume) => {
                let name = path.file_name().map(|n| n.to_string_lossy().into_owned());
                let source = crate::scene::surface::MeshSource { iso: Some(volume.body_threshold()), volume: Some(text), name, ..Default::default() };
                doc.scene.mesh.push(source);
                doc.selected = super::document::Selection::Mesh(doc.scene.mesh.len() - 1);
            }
            Err(error) => self.fail(&error),
        }
    }

    /// Adds a displacement field.
    pub fn add_field(&mut self, path: &Path) {
        let Some(doc) = &mut self.doc else { return };
        let mut field = crate::scene::Deformation::new("field");
        field.parameters.insert("path", path.to_string_lossy().as_ref());
        doc.add(field);
    }

    /// Puts the file dialog away.
    pub fn cancel_files(&mut self) {
        self.files.purpose = None;
    }

    /// Asks for a file to open.
    pub fn ask_open(&mut self) {
        const VOLUMES: &[&str] = &["gz", "nii", "nrrd", "nhdr", "mha", "mhd", "vti", "vtk", "tif", "tiff", "npy", "raw", "dcm", "zip", "hdr"];
        const MESHES: &[&str] = &["stl", "obj", "ply", "off", "gltf", "glb", "gii"];
        self.files.ask(Purpose::Open, "Open a scene, a volume or a mesh", None, &[("Scenes", &["toml"]), ("Volumes", VOLUMES), ("Meshes", MESHES)]);
    }

    /// Asks for a folder to open.
    pub fn ask_open_folder(&mut self) {
        self.files.ask_folder(Purpose::Open, "Open a folder of DICOM files, slices or a Zarr store");
    }

    /// Saves the scene where it belongs, or asks where.
    pub fn save(&mut self, ctx: &Context, after: Option<After>) {
        match self.doc.as_ref().and_then(|d| d.path.clone()) {
            Some(path) => self.save_to(ctx, &path, after),
            None => self.ask_save(after),
        }
    }

    /// Asks where to save the scene.
    pub fn ask_save(&mut self, after: Option<After>) {
        let Some(doc) = &self.doc else { return };
        let stem = doc.name.split('.').next().filter(|s| !s.is_empty()).unwrap_or("scene");
        let name = format!("{}.toml", stem.replace([':', '/'], "-"));
        self.files.ask(Purpose::Save(after), "Save the scene", Some(&name), &[]);
    }

    /// Saves the scene into a file.
    pub fn save_to(&mut self, ctx: &Context, path: &Path, after: Option<After>) {
        let path = with_ending(path, "toml");
        let Some(doc) = &mut self.doc else { return };
        let result = (|| {
            protect("save", &path, doc.scene.files().iter().map(PathBuf::as_path))?;
            let folder = path.parent().unwrap_or(Path::new(""));
            let moved = doc.scene.moved_to(folder)?;
            let text = moved.to_toml()?;
            Output::create(&path)?.finish(text.as_bytes())?;
            Ok::<Scene, Error>(moved)
        })();
        match result {
            Ok(moved) => {
                doc.scene = moved;
                doc.saved = Some(doc.scene.clone());
                doc.name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
                doc.path = Some(path.clone());
                self.history.keep(&doc.scene);
                self.session.forget();
                self.session.opened(&path);
                self.say(Level::Info, format!("Saved {}", path.display()));
                if let Some(after) = after {
                    self.proceed(ctx, after);
                }
            }
            Err(error) => self.fail(&error),
        }
    }

    /// The form for a picture, as the view has it.
    pub fn picture_form(&self) -> PictureForm {
        let [w, h] = self.view.size();
        let scale = 3840.0 / f64::from(w.max(1));
        let size = [3840, ((f64::from(h) * scale).round() as u32).clamp(16, LARGEST_PICTURE)];
        let step = self.doc.as_ref().map_or(1.0, |d| d.scene.render.step.min(0.5));
        PictureForm { size, antialias: 1, step, transparent: false }
    }

    /// Asks where a picture goes.
    pub fn ask_picture(&mut self, form: PictureForm) {
        self.files.ask(Purpose::Picture(form), "Export picture", Some("picture.png"), &[]);
    }

    /// Renders and writes a picture.
    pub fn export_picture(&mut self, ctx: &Context, path: &Path, form: &PictureForm) {
        let path = with_ending(path, "png");
        let Some(mut scene) = self.export_scene(&path) else { return };
        scene.render.size = form.size;
        scene.render.antialias = form.antialias;
        scene.render.step = form.step;
        if form.transparent {
            scene.render.background = [0.0; 4];
        }
        let Some(assets) = self.doc.as_ref().map(|d| d.assets.clone()) else { return };
        let render = self.renderer();
        self.start(ctx, "Exporting a picture", move |watch| {
            let output = Output::create(&path)?;
            let picture = render(&scene, &assets, watch)?;
            output.finish(&png(&picture, scene.render.background)?)?;
            Ok(said(format!("Exported {}", path.display())))
        });
    }

    /// The scene as it is shown, if nothing of it would be overwritten by an export.
    fn export_scene(&mut self, path: &Path) -> Option<Scene> {
        let doc = self.doc.as_ref()?;
        let scene = doc.shown(self.is_before());
        let files: Vec<PathBuf> = doc.scene.files().into_iter().chain(doc.path.clone()).collect();
        if let Err(error) = protect("export", path, files.iter().map(PathBuf::as_path)) {
            self.fail(&error);
            return None;
        }
        Some(scene)
    }

    /// What renders exports: the backend of the view, on a device of its own.
    fn renderer(&self) -> impl Fn(&Scene, &Assets, &Watch) -> Result<crate::scene::Picture> + Send + 'static {
        let on_gpu = self.backend() != super::worker::Backend::Cpu && !self.view.facts.backend.starts_with("CPU");
        let want = if self.backend() == super::worker::Backend::Gpu { crate::gpu::Want::Any } else { crate::gpu::Want::Hardware };
        let renderer = Mutex::new(None::<crate::render::Renderer>);
        move |scene, assets, watch| {
            if on_gpu {
                let mut renderer = renderer.lock().unwrap_or_else(PoisonError::into_inner);
                if renderer.is_none() {
                    *renderer = crate::gpu::Device::open(want).ok().map(crate::render::Renderer::new);
                }
                if let Some(renderer) = renderer.as_mut() {
                    let prepared = Prepared::composed_by(scene, assets, &|stack, points| renderer.evaluate(stack, points))?;
                    match renderer.render_until(&prepared, false, watch) {
                        Ok(rendered) => return Ok(rendered.picture),
                        Err(Error::Gpu(_)) => {}
                        Err(other) => return Err(other),
                    }
                }
            }
            Ok(cpu::render_until(&Prepared::new(scene, assets)?, watch)?.picture)
        }
    }

    /// Asks where a clip goes.
    pub fn ask_clip(&mut self, form: ClipForm) {
        self.files.ask(Purpose::Clip(form), "Export clip: .gif, .png (animated), .mp4, or a folder", Some("clip.gif"), &[]);
    }

    /// Renders and writes a clip.
    pub fn export_clip(&mut self, ctx: &Context, path: &Path, form: &ClipForm) {
        let Some(scene) = self.export_scene(path) else { return };
        let Some(assets) = self.doc.as_ref().map(|d| d.assets.clone()) else { return };
        let render = self.renderer();
        let (path, form) = (path.to_owned(), form.clone());
        self.start(ctx, "Exporting a clip", move |watch| {
            clip::ClipFormat::of(&path)?;
            let mut frame = |n: usize| {
                let scene = form.frame(&scene, n)?;
                let quiet = Watch { progress: &|_| (), cancel: watch.cancel };
                Ok(render(&scene, &assets, &quiet)?.over(scene.render.background))
            };
            clip::write(&path, form.size, form.rate, form.frames, &mut frame, watch)?;
            Ok(said(format!("Exported {}", path.display())))
        });
    }

    /// Asks where a baked volume or field goes.
    pub fn ask_bake(&mut self, field: bool) {
        let (title, name) = if field { ("Bake the displacement field", "field.nii.gz") } else { ("Bake the deformed volume", "deformed.nii.gz") };
        self.files.ask(Purpose::Bake { field }, title, Some(name), &[]);
    }

    /// Bakes and writes.
    pub fn export_baked(&mut self, ctx: &Context, path: &Path, field: bool) {
        let Some(scene) = self.export_scene(path) else { return };
        let Some(assets) = self.doc.as_ref().map(|d| d.assets.clone()) else { return };
        let path = path.to_owned();
        self.start(ctx, "Baking", move |watch| {
            let format = Format::of(&path)?;
            if !assets.has_volume {
                return Err(Error::value("bake", "there is no volume in this scene; meshes are rendered, not baked"));
            }
            let output = Output::create(&path)?;
            let exact = Deformed::exact(&scene, &assets, true)?;
            let deformation = bake::Deformation { stack: &exact.stack, cuts: &exact.cuts };
            let volume = &assets.volume;
            let grid = volume.geometry();
            let interpolation = if volume.labels().is_some() { bake::Interpolation::Nearest } else { bake::Interpolation::Linear };
            let progress = |share: f32| (watch.progress)(share);
            output.finish_with(|out| {
                let mut out = Stoppable { out, watch };
                if field {
                    bake::field(&deformation, &grid, format, &mut out, &progress).map(drop)
                } else {
                    bake::volume(volume, &deformation, &grid, interpolation, volume.range[0], format, &mut out, &progress)
                }
                .map_err(|e| if watch.stopped() { Error::Cancelled } else { e })
            })?;
            Ok(said(format!("Baked {}", path.display())))
        });
    }

    /// Asks for the folder of a report.
    pub fn ask_report(&mut self) {
        self.files.ask_folder(Purpose::Report, "Folder for the comparison report");
    }

    /// Renders both sides of the comparison at the scene's own size and writes the report.
    pub fn export_report(&mut self, ctx: &Context, folder: &Path) {
        let Some(doc) = &self.doc else { return };
        let assets = doc.assets.clone();
        let scene = doc.shown(self.is_before());
        let name = doc.name.clone();
        let sides = self.compare.sides;
        let size = self.view.size();
        let folder = folder.to_owned();
        self.start(ctx, "Writing the report", move |watch| {
            let mut runs: Vec<crate::compare::Run> = Vec::new();
            for (n, side) in sides.iter().enumerate() {
                let mut scene = side.scene(&scene);
                scene.render.size = size;
                let tell = |share: f32| (watch.progress)((n as f32 + share) / 2.0);
                let part = Watch { progress: &tell, cancel: watch.cancel };
                let label = side.words();
                let label = if runs.iter().any(|r| r.name == label) { format!("{label} again") } else { label };
                runs.push(crate::compare::run_on_cpu(&scene, &assets, &label, &part)?);
            }
            let report = Report::new(name, scene.to_toml()?, scene.render.background, runs)?;
            report.write(&folder)?;
            Ok(said(format!("Report written to {}", folder.join("index.html").display())))
        });
    }

    /// Asks where the table of measurements goes.
    pub fn ask_measures(&mut self) {
        self.files.ask(Purpose::Measures, "Export measurements", Some("measurements.csv"), &[]);
    }

    fn export_measures(&mut self, path: &Path) {
        let rows: Vec<_> = self.measured.iter().map(|m| (m.measure.clone(), m.quantities.clone().unwrap_or_default())).collect();
        let path = with_ending(path, "csv");
        match Output::create(&path).and_then(|o| o.finish(measure::csv(&rows).as_bytes())) {
            Ok(()) => self.say(Level::Info, format!("Exported {}", path.display())),
            Err(error) => self.fail(&error),
        }
    }

    /// Asks for a transfer function.
    pub fn ask_import_transfer(&mut self) {
        self.files.ask(Purpose::ImportTransfer, "Import a transfer function (.toml)", None, &[("Transfer functions and scenes", &["toml"])]);
    }

    /// Asks where the transfer function goes.
    pub fn ask_export_transfer(&mut self) {
        self.files.ask(Purpose::ExportTransfer, "Export the transfer function", Some("transfer.toml"), &[]);
    }

    /// Reads a transfer function: a file of its own, or that of a scene.
    pub fn import_transfer(&mut self, path: &Path) {
        let read = || -> Result<TransferSettings> {
            let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "reading", e))?;
            let table: toml::Table = text.parse().map_err(|e: toml::de::Error| Error::file(path, format!("is not valid TOML: {}", e.message())))?;
            let section = table.get("transfer").cloned().ok_or_else(|| Error::file(path, "has no [transfer] section; export one to see its form"))?;
            section
                .try_into()
                .map_err(|e: toml::de::Error| Error::file(path, format!("has a [transfer] section that cannot be used: {}", e.message())))
        };
        let Some(doc) = &mut self.doc else { return };
        match read().and_then(|t| t.resolve(&doc.assets.volume, "grey").map(|_| t)) {
            Ok(transfer) => doc.scene.transfer = transfer,
            Err(error) => self.fail(&error),
        }
    }

    fn export_transfer(&mut self, path: &Path) {
        let path = with_ending(path, "toml");
        let Some(doc) = &self.doc else { return };
        let write = || -> Result<()> {
            protect("export", &path, doc.scene.files().iter().map(PathBuf::as_path))?;
            let mut table = toml::Table::new();
            let section = toml::Value::try_from(&doc.scene.transfer).map_err(|e| Error::value("transfer", e.to_string()))?;
            table.insert("transfer".into(), section);
            let text = toml::to_string_pretty(&table).map_err(|e| Error::value("transfer", e.to_string()))?;
            Output::create(&path)?.finish(text.as_bytes())
        };
        match write() {
            Ok(()) => self.say(Level::Info, format!("Exported {}", path.display())),
            Err(error) => self.fail(&error),
        }
    }

    /// Asks for a label map.
    pub fn ask_labels(&mut self) {
        self.files.ask(Purpose::Labels, "Open a label map over the volume", None, &[]);
    }

    /// Puts a label map over the volume.
    pub fn set_labels(&mut self, path: &Path) {
        if let Some(volume) = self.doc.as_mut().and_then(|d| d.scene.volume.as_mut()) {
            volume.labels = Some(path.to_string_lossy().into_owned());
        }
    }

    /// Writes a deformation, or the stack of all, as a map into the user's library.
    pub fn save_map(&mut self, ctx: &Context, name: &str, whole_stack: bool) {
        let Some(doc) = &self.doc else { return };
        let assets = doc.assets.clone();
        let mut scene = doc.shown(false);
        if !whole_stack {
            let Some(n) = doc.deformation_index() else { return };
            scene.deformation = vec![doc.scene.deformation[n].clone()];
            scene.deformation[0].enabled = true;
        }
        let path = self.session.map_path(name);
        self.start(ctx, "Making a map", move |watch| {
            // Masks, not shapes: a map is all there is of it.
            let exact = Deformed::exact(&scene, &assets, false)?;
            watch.check()?;
            let maps = exact.stack.maps();
            let placed = match maps {
                [] => return Err(Error::value("map", "there is nothing to make a map of; add a deformation first")),
                [one] => one.clone(),
                all => {
                    let stack = Stack::new(all.to_vec());
                    let resolution = crate::deform::compose::Resolution::Fixed(MAP_POINTS);
                    let storage = crate::deform::Storage::F32;
                    let composed =
                        crate::deform::compose::stack(&stack, &assets.scene_box(), resolution, storage, &crate::deform::compose::evaluate)?;
                    composed.ok_or_else(|| Error::value("map", "the stack moves nothing"))?.placed
                }
            };
            Output::create(&path)?.finish(&saved::encode(&placed)?)?;
            Ok(said(format!("Saved to the library: {}", path.file_stem().unwrap_or_default().to_string_lossy())))
        });
    }

    /// Shows the file dialog and does what a chosen file is wanted for.
    pub(super) fn show_files(&mut self, ctx: &Context) {
        if self.files.purpose.is_none() {
            return;
        }
        self.files.dialog.update(ctx);
        let picked = self.files.dialog.take_picked();
        let closed = matches!(self.files.dialog.state(), DialogState::Cancelled | DialogState::Closed);
        if let Some(path) = picked {
            let Some(purpose) = self.files.purpose.take() else { return };
            self.files.folder = path.parent().map(Path::to_owned);
            self.chosen(ctx, &path, purpose);
        } else if closed && let Some(Purpose::Locate(dialog)) = self.files.purpose.take() {
            self.dialog = Some(*dialog);
        }
    }

    /// Does what a file is wanted for.
    pub fn chosen(&mut self, ctx: &Context, path: &Path, purpose: Purpose) {
        match purpose {
            Purpose::Open => self.open(ctx, path),
            Purpose::Save(after) => self.save_to(ctx, path, after),
            Purpose::Picture(form) => self.export_picture(ctx, path, &form),
            Purpose::Clip(form) => self.export_clip(ctx, path, &form),
            Purpose::Bake { field } => self.export_baked(ctx, path, field),
            Purpose::Report => self.export_report(ctx, path),
            Purpose::Measures => self.export_measures(path),
            Purpose::ImportTransfer => self.import_transfer(path),
            Purpose::ExportTransfer => self.export_transfer(path),
            Purpose::Labels => self.set_labels(path),
            Purpose::Locate(dialog) => {
                if let Dialog::Locate { missing, scene, path: file, name, .. } = *dialog {
                    let mut scene = *scene;
                    scene.relocate(&missing, path);
                    self.start_loading(ctx, scene, file, name, false, true);
                }
            }
        }
    }

    /// Asks where a missing file is.
    pub fn ask_locate(&mut self, dialog: Dialog) {
        let title = match &dialog {
            Dialog::Locate { missing, .. } => format!("Where is {}?", missing.file_name().unwrap_or_default().to_string_lossy()),
            _ => "Locate".into(),
        };
        self.files.ask(Purpose::Locate(Box::new(dialog)), &title, None, &[]);
    }

    /// The scene as a command line, for the clipboard; the scene is saved first.
    pub fn copy_command(&mut self, ctx: &Context) {
        let Some(doc) = &self.doc else { return };
        let Some(path) = doc.path.clone() else {
            self.say(Level::Info, "Save the scene first: the command line names its file");
            self.ask_save(None);
            return;
        };
        let changed = doc.is_changed() || doc.saved.as_ref().is_none_or(|s| s.camera != doc.scene.camera);
        if changed {
            self.save_to(ctx, &path, None);
        }
        let Some(doc) = &self.doc else { return };
        let mut scene = doc.scene.clone();
        scene.render.size = self.view.size();
        ctx.copy_text(crate::scene::command::render_command(&scene, &path, "picture.png"));
        self.say(Level::Info, "Copied the command line of this view");
    }
}

/// Points along the longest axis of a map made of a whole stack.
const MAP_POINTS: usize = 128;

/// A mesh with the looks of one that was dropped.
fn mesh_source(path: &str) -> crate::scene::surface::MeshSource {
    crate::scene::surface::MeshSource::of_file(path)
}

/// The scene as small as it can be: enough to find what cannot be used.
fn small(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    scene.render.size = [16, 16];
    scene
}

/// A path with an ending, if it has none.
fn with_ending(path: &Path, ending: &str) -> PathBuf {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending)) {
        return path.to_owned();
    }
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".");
    name.push(ending);
    path.with_file_name(name)
}

impl ClipForm {
    /// The scene of a frame.
    ///
    /// # Errors
    /// A deformation that is no longer there.
    pub fn frame(&self, scene: &Scene, n: usize) -> Result<Scene> {
        let mut scene = scene.clone();
        scene.render.size = self.size;
        let last = self.frames.saturating_sub(1).max(1);
        let share = n as f32 / last as f32;
        // There and back: up to the middle and down again.
        let share = if self.back { 1.0 - (2.0 * share - 1.0).abs() } else { share };
        let value = self.range[0] + (self.range[1] - self.range[0]) * share;
        let of = |scene: &mut Scene, d: usize| -> Result<()> {
            if d < scene.deformation.len() { Ok(()) } else { Err(Error::value("clip", "the deformation is no longer there")) }
        };
        match &self.travel {
            Travel::Orbit => {
                // The last frame is followed by the first.
                let turn = 360.0 * n as f32 / self.frames.max(1) as f32;
                let azimuth = scene.camera.view.azimuth_deg + turn;
                scene.camera.view.azimuth_deg = (azimuth + 180.0).rem_euclid(360.0) - 180.0;
            }
            Travel::Progress(d) => {
                of(&mut scene, *d)?;
                scene.deformation[*d].progress = Some(value.clamp(0.0, 1.0));
            }
            Travel::Parameter(d, name) => {
                of(&mut scene, *d)?;
                scene.deformation[*d].parameters.insert(name.clone(), value);
            }
        }
        Ok(scene)
    }
}

/// A destination that refuses more once it is told to stop.
struct Stoppable<'a> {
    out: &'a mut dyn std::io::Write,
    watch: &'a Watch<'a>,
}

impl std::io::Write for Stoppable<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.watch.stopped() {
            return Err(std::io::Error::other("cancelled"));
        }
        self.out.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orbit_comes_round_and_a_travel_goes_there_and_back() {
        let mut scene = Scene::of_volume("phantom:ball");
        scene.deformation.push(crate::scene::Deformation::new("peel"));
        let mut form = ClipForm { travel: Travel::Orbit, range: [0.0, 1.0], back: true, frames: 8, rate: 25.0, size: [64, 64] };
        let azimuths: Vec<f32> = (0..8).map(|n| form.frame(&scene, n).unwrap().camera.view.azimuth_deg).collect();
        assert_eq!(azimuths, [0.0, 45.0, 90.0, 135.0, -180.0, -135.0, -90.0, -45.0]);
        form.travel = Travel::Progress(0);
        form.frames = 5;
        let progress: Vec<f32> = (0..5).map(|n| form.frame(&scene, n).unwrap().deformation[0].progress.unwrap()).collect();
        assert_eq!(progress, [0.0, 0.5, 1.0, 0.5, 0.0]);
        form.travel = Travel::Progress(3);
        assert!(form.frame(&scene, 0).is_err());
    }

    #[test]
    fn endings() {
        assert_eq!(with_ending(Path::new("/a/b"), "png"), Path::new("/a/b.png"));
        assert_eq!(with_ending(Path::new("/a/b.v2"), "png"), Path::new("/a/b.v2.png"));
        assert_eq!(with_ending(Path::new("/a/b.PNG"), "png"), Path::new("/a/b.PNG"));
    }
}
