//! Exports: pictures, clips, baked volumes and fields, maps, tables, reports, command lines. Each
//! runs as a background task, and no input of the scene is overwritten.

use super::files::with_ending;
use super::state::Workstation;
use super::state::files::{ClipForm, ClipMotion, FilePurpose, PictureForm};
use super::state::log::LogLevel;
use super::tasks::report_when_done;
use crate::compare::Report;
use crate::deform::{Stack, saved};
use crate::engine::{Backend, Engine, EngineOptions, RenderRequest};
use crate::export::bake::{self, BakeOptions};
use crate::export::dicom::{self, DicomContent, is_dicom_name};
use crate::export::{clip, protect, protect_folder};
use crate::files::path_text::text_of;
use crate::files::{OutputFile, OutputFolder, input, names_folder};
use crate::picture::MAX_PICTURE_EDGE;
use crate::picture::Picture;
use crate::prepare::measure;
use crate::prepare::{Assets, Deformed};
use crate::scene::{Antialias, Scene};
use crate::transfer::TransferSettings;
use crate::volume::save::Format;
use crate::{Error, Result, Watch};
use eframe::egui::Context;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Points along the longest axis of a map computed from a whole stack.
const MAP_POINTS: usize = 128;

/// Bakes the volume or the field of a scene into a file.
fn bake_to_file(path: &Path, scene: &Scene, assets: &Assets, field: bool, watch: &Watch) -> Result<()> {
    let format = Format::of(path)?;
    let output = OutputFile::create(path)?;
    let exact = Deformed::exact(scene, assets, true, watch)?;
    let deformation = exact.stack_and_cuts();
    let volume = &assets.volume;
    let grid = volume.geometry();
    let progress = |share: f32| (watch.progress)(share);
    output.finish_with(|out| {
        let mut out = CancellableWriter { out, watch };
        if field {
            return bake::field(&deformation, &grid, format, &mut out, &progress).map(drop);
        }
        let options = BakeOptions {
            progress: Some(&progress),
            ..BakeOptions::default()
        };
        bake::volume(volume, &deformation, &grid, format, &mut out, &options)
    })
}

/// Bakes the volume of a scene as a DICOM series in a folder, or as a segmentation; nothing about the
/// patient is written. Returns notices about the values.
fn bake_as_dicom(path: &Path, scene: &Scene, assets: &Assets, watch: &Watch) -> Result<Vec<String>> {
    let volume = &assets.volume;
    let origin = dicom::origin(scene, volume, watch)?;
    let exact = Deformed::exact(scene, assets, true, watch)?;
    let deformation = exact.stack_and_cuts();
    let grid = volume.geometry();
    let progress = |share: f32| (watch.progress)(share);
    if names_folder(path) {
        let files = scene.files();
        protect_folder("export", path, files.iter().map(PathBuf::as_path))?;
        let folder = OutputFolder::create(path)?;
        let derivation = dicom::derivation(scene, DicomContent::Volume, origin.as_ref(), false);
        let options = BakeOptions {
            progress: Some(&progress),
            ..BakeOptions::default()
        };
        return bake::dicom_series(volume, &deformation, &grid, folder, &derivation, &options);
    }
    let output = OutputFile::create(path)?;
    let derivation = dicom::derivation(scene, DicomContent::Labels, origin.as_ref(), false);
    let (bytes, notices) = bake::dicom_segmentation(volume, &deformation, &grid, &derivation, &progress)?;
    output.finish(&bytes)?;
    Ok(notices)
}

impl Workstation {
    /// The form for a picture, initialised from the view.
    pub fn picture_form(&self) -> PictureForm {
        let [w, h] = self.view.size();
        let scale = 3840.0 / f64::from(w.max(1));
        let size = [
            3840,
            ((f64::from(h) * scale).round() as u32).clamp(16, MAX_PICTURE_EDGE),
        ];
        let step = self.doc.as_ref().map_or(1.0, |d| d.scene.render.step.min(0.5));
        PictureForm {
            size,
            antialias: Antialias::Adaptive,
            step,
            transparent: false,
        }
    }

    /// Opens a dialog for the picture's file.
    pub fn choose_picture_file(&mut self, form: PictureForm) {
        self.files.open_dialog(
            FilePurpose::Picture(form),
            "Export picture (.png or .dcm)",
            Some("picture.png"),
            &[],
        );
    }

    /// Renders and writes a picture.
    pub fn export_picture(&mut self, ctx: &Context, path: &Path, form: &PictureForm) {
        let path = if is_dicom_name(path) {
            path.to_owned()
        } else {
            with_ending(path, "png")
        };
        let Some(mut scene) = self.export_scene(&path) else {
            return;
        };
        scene.render.size = form.size;
        scene.render.antialias = form.antialias;
        scene.render.step = form.step;
        if form.transparent {
            scene.render.background = [0.0; 4];
        }
        let Some(assets) = self.doc.as_ref().map(|d| d.assets.clone()) else {
            return;
        };
        let render = self.renderer();
        self.start(ctx, "Exporting a picture", move |watch| {
            let output = OutputFile::create(&path)?;
            if is_dicom_name(&path) && scene.render.background[3] < 1.0 {
                return Err(Error::file(
                    &path,
                    "a DICOM picture has no transparency; choose an opaque background, or write .png",
                ));
            }
            let picture = render(&scene, &assets, watch)?;
            output.finish(&if is_dicom_name(&path) {
                dicom::picture(&scene, &picture, None, false).map_err(|e| Error::file(&path, e))?
            } else {
                picture.png(scene.render.background)?
            })?;
            Ok(report_when_done(format!("Exported {}", path.display())))
        });
    }

    /// The scene as shown, unless the export would overwrite one of its inputs.
    fn export_scene(&mut self, path: &Path) -> Option<Scene> {
        let doc = self.doc.as_ref()?;
        let scene = doc.shown(self.shows_undeformed());
        let files: Vec<PathBuf> = doc.scene.files().into_iter().chain(doc.path.clone()).collect();
        if let Err(error) = protect("export", path, files.iter().map(PathBuf::as_path)) {
            self.report_error(&error);
            return None;
        }
        Some(scene)
    }

    /// A renderer for exports: the backend of the view, on its own device.
    fn renderer(&self) -> impl Fn(&Scene, &Assets, &Watch) -> Result<Picture> + Send + 'static {
        // If the view fell back from the GPU, an export would not find one either.
        let backend = if self.view.facts.device.as_ref().is_some_and(|d| d.is_gpu) {
            self.backend()
        } else {
            Backend::Cpu
        };
        let engine = Mutex::new(None::<Engine>);
        move |scene, assets, watch| {
            let mut engine = engine.lock().unwrap_or_else(PoisonError::into_inner);
            let engine = match &mut *engine {
                Some(engine) => engine,
                none => none.insert(Engine::open(EngineOptions {
                    backend,
                    ..EngineOptions::default()
                })?),
            };
            let request = RenderRequest {
                watch: *watch,
                ..RenderRequest::default()
            };
            Ok(engine.picture(scene, assets, &request)?.rendered.picture)
        }
    }

    /// Opens a dialog for the clip's file.
    pub fn choose_clip_file(&mut self, form: ClipForm) {
        self.files.open_dialog(
            FilePurpose::Clip(form),
            "Export clip: .gif, .png (animated), .mp4, or a folder",
            Some("clip.gif"),
            &[],
        );
    }

    /// Renders and writes a clip.
    pub fn export_clip(&mut self, ctx: &Context, path: &Path, form: &ClipForm) {
        let Some(scene) = self.export_scene(path) else {
            return;
        };
        let Some(assets) = self.doc.as_ref().map(|d| d.assets.clone()) else {
            return;
        };
        let render = self.renderer();
        let (path, form) = (path.to_owned(), form.clone());
        self.start(ctx, "Exporting a clip", move |watch| {
            clip::ClipFormat::of(&path)?;
            let mut frame = |n: usize| {
                let scene = form.frame(&scene, n)?;
                let quiet = Watch {
                    progress: &|_| (),
                    cancel: watch.cancel,
                };
                Ok(render(&scene, &assets, &quiet)?.over(scene.render.background))
            };
            clip::write(&path, form.size, form.rate, form.frames, &mut frame, watch)?;
            Ok(report_when_done(format!("Exported {}", path.display())))
        });
    }

    /// Opens a dialog for a baked volume or field.
    pub fn choose_bake_file(&mut self, field: bool) {
        let (title, name) = if field {
            ("Bake the displacement field", "field.nii.gz")
        } else {
            (
                "Bake the deformed volume to a file or to a new folder of DICOM slices",
                "deformed.nii.gz",
            )
        };
        self.files
            .open_dialog(FilePurpose::Bake { field }, title, Some(name), &[]);
    }

    /// Bakes and writes.
    pub fn export_baked(&mut self, ctx: &Context, path: &Path, field: bool) {
        let Some(scene) = self.export_scene(path) else {
            return;
        };
        let Some(assets) = self.doc.as_ref().map(|d| d.assets.clone()) else {
            return;
        };
        let path = path.to_owned();
        self.start(ctx, "Baking", move |watch| {
            if !assets.has_volume {
                return Err(Error::value(
                    "bake",
                    "there is no volume in this scene; meshes are rendered, not baked",
                ));
            }
            let is_dicom = names_folder(&path) || is_dicom_name(&path);
            if field && is_dicom {
                return Err(Error::file(
                    &path,
                    "DICOM slices cannot hold a displacement field; give a name that ends in .nii.gz, .nrrd, .mha or .vti",
                ));
            }
            let cancelled = |e| if watch.is_cancelled() { Error::Cancelled } else { e };
            let notices = if is_dicom {
                bake_as_dicom(&path, &scene, &assets, watch).map_err(cancelled)?
            } else {
                bake_to_file(&path, &scene, &assets, field, watch).map_err(cancelled)?;
                let notice = Format::of(&path)?.notice(&assets.volume.geometry());
                notice.into_iter().collect()
            };
            let done = format!("Baked {}", path.display());
            Ok(report_when_done(std::iter::once(done).chain(notices).collect::<Vec<_>>().join("; ")))
        });
    }

    /// Opens a dialog for the folder of a report.
    pub fn choose_report_folder(&mut self) {
        self.files
            .open_folder_dialog(FilePurpose::Report, "Folder for the comparison report");
    }

    /// Renders both sides of the comparison at the scene's own size and writes the report.
    pub fn export_report(&mut self, ctx: &Context, folder: &Path) {
        let Some(doc) = &self.doc else { return };
        let assets = doc.assets.clone();
        let scene = doc.shown(self.shows_undeformed());
        let name = doc.name.clone();
        let sides = self.compare.sides;
        let size = self.view.size();
        let folder = folder.to_owned();
        self.start(ctx, "Writing the report", move |watch| {
            let mut runs: Vec<crate::compare::Run> = Vec::new();
            for (n, side) in sides.iter().enumerate() {
                let mut scene = side.scene(&scene);
                scene.render.size = size;
                let report = |share: f32| (watch.progress)((n as f32 + share) / 2.0);
                let part = Watch {
                    progress: &report,
                    cancel: watch.cancel,
                };
                let label = side.words();
                let label = if runs.iter().any(|r| r.name == label) {
                    format!("{label} again")
                } else {
                    label
                };
                let request = RenderRequest {
                    watch: part,
                    ..RenderRequest::default()
                };
                runs.push(crate::compare::run(
                    &mut Engine::cpu(),
                    &scene,
                    &assets,
                    &label,
                    &request,
                )?);
            }
            let report = Report::new(name, scene.to_toml()?, scene.render.background, runs)?;
            report.write(&folder)?;
            Ok(report_when_done(format!(
                "Report written to {}",
                folder.join("index.html").display()
            )))
        });
    }

    /// Opens a dialog for the table of measurements.
    pub fn choose_measures_file(&mut self) {
        self.files.open_dialog(
            FilePurpose::Measures,
            "Export measurements",
            Some("measurements.csv"),
            &[],
        );
    }

    pub(super) fn export_measures(&mut self, path: &Path) {
        let all = self.doc.as_ref().map_or(&[][..], |d| &d.scene.measure);
        if self.measured.len() != all.len()
            || self
                .measured
                .iter()
                .zip(all)
                .any(|(m, now)| m.measure.points != now.points || m.measure.label != now.label)
        {
            self.report(
                LogLevel::Info,
                "Measurements are still being computed; try again in a moment",
            );
            return;
        }
        // A measurement without a result still gets a row.
        let unknown = measure::Quantity {
            what: "not measured",
            value: None,
            unit: "",
        };
        let rows: Vec<_> = self
            .measured
            .iter()
            .zip(all)
            .map(|(m, now)| {
                (
                    now.clone(),
                    m.quantities.clone().unwrap_or_else(|_| vec![unknown.clone()]),
                )
            })
            .collect();
        let path = with_ending(path, "csv");
        match OutputFile::create(&path).and_then(|o| o.finish(measure::csv(&rows).as_bytes())) {
            Ok(()) => self.report(LogLevel::Info, format!("Exported {}", path.display())),
            Err(error) => self.report_error(&error),
        }
    }

    /// Opens a dialog for a transfer function to import.
    pub fn choose_transfer_import(&mut self) {
        self.files.open_dialog(
            FilePurpose::ImportTransfer,
            "Import a transfer function (.toml)",
            None,
            &[("Transfer functions and scenes", &["toml"])],
        );
    }

    /// Opens a dialog for the exported transfer function.
    pub fn choose_transfer_export(&mut self) {
        self.files.open_dialog(
            FilePurpose::ExportTransfer,
            "Export the transfer function",
            Some("transfer.toml"),
            &[],
        );
    }

    /// Reads a transfer function: from its own file, or from a scene.
    pub fn import_transfer(&mut self, path: &Path) {
        let read = || -> Result<TransferSettings> {
            let text = input::text(path, input::MAX_SCENE_BYTES, "transfer function")?;
            let table: toml::Table = text.parse().map_err(|e: toml::de::Error| {
                Error::file(path, format!("is not valid TOML: {}", e.message()))
            })?;
            let section = table
                .get("transfer")
                .cloned()
                .ok_or_else(|| Error::file(path, "has no [transfer] section; export one to see its form"))?;
            section.try_into().map_err(|e: toml::de::Error| {
                Error::file(
                    path,
                    format!("has a [transfer] section that cannot be used: {}", e.message()),
                )
            })
        };
        let Some(doc) = &mut self.doc else { return };
        match read().and_then(|t| t.resolve(&doc.assets.volume, "grey").map(|_| t)) {
            Ok(transfer) => doc.scene.transfer = transfer,
            Err(error) => self.report_error(&error),
        }
    }

    pub(super) fn export_transfer(&mut self, path: &Path) {
        let path = with_ending(path, "toml");
        let Some(doc) = &self.doc else { return };
        let write = || -> Result<()> {
            protect("export", &path, doc.scene.files().iter().map(PathBuf::as_path))?;
            let mut table = toml::Table::new();
            let section = toml::Value::try_from(&doc.scene.transfer)
                .map_err(|e| Error::value("transfer", e.to_string()))?;
            table.insert("transfer".into(), section);
            let text = toml::to_string_pretty(&table).map_err(|e| Error::value("transfer", e.to_string()))?;
            OutputFile::create(&path)?.finish(text.as_bytes())
        };
        match write() {
            Ok(()) => self.report(LogLevel::Info, format!("Exported {}", path.display())),
            Err(error) => self.report_error(&error),
        }
    }

    /// Opens a dialog for a label map.
    pub fn choose_label_map(&mut self) {
        self.files
            .open_dialog(FilePurpose::Labels, "Open a label map for the volume", None, &[]);
    }

    /// Sets a label map for the volume.
    pub fn set_labels(&mut self, path: &Path) {
        if let Some(volume) = self.doc.as_mut().and_then(|d| d.scene.volume.as_mut()) {
            volume.labels = Some(text_of(path));
        }
    }

    /// Saves a deformation, or the whole stack, as a map in the user's library.
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
        self.start(ctx, "Exporting the map", move |watch| {
            // Masks instead of exact shapes, since the file holds only a map.
            let exact = Deformed::exact(&scene, &assets, false, watch)?;
            watch.check()?;
            let maps = exact.stack.maps();
            let mut exactness = String::new();
            let placed = match maps {
                [] => {
                    return Err(Error::value(
                        "map",
                        "there is nothing to combine; add a deformation first",
                    ));
                }
                [one] => one.clone(),
                all => {
                    let stack = Stack::new(all.to_vec());
                    let resolution = crate::deform::compose::Resolution::Fixed(MAP_POINTS);
                    let storage = crate::deform::Storage::F32;
                    let composed = crate::deform::compose::stack(
                        &stack,
                        &assets.scene_box(),
                        resolution,
                        storage,
                        &crate::deform::compose::evaluate,
                    )?;
                    let composed = composed.ok_or_else(|| {
                        Error::value("map", "the deformations move nothing; there is no map to save")
                    })?;
                    exactness = format!(
                        "; composed into one map, its error is up to {:.2} mm (99th percentile: {:.2} mm)",
                        composed.worst_mm, composed.p99_mm
                    );
                    composed.placed
                }
            };
            OutputFile::create(&path)?.finish(&saved::encode(&placed)?)?;
            Ok(report_when_done(format!(
                "Saved to the library: {}{exactness}",
                path.file_stem().unwrap_or_default().to_string_lossy()
            )))
        });
    }

    /// Copies a command line for the scene to the clipboard; the scene is saved first.
    pub fn copy_command(&mut self, ctx: &Context) {
        let Some(doc) = &self.doc else { return };
        let Some(path) = doc.path.clone() else {
            self.report(
                LogLevel::Info,
                "Save the scene first; the command line refers to its file",
            );
            self.choose_save_file(None);
            return;
        };
        let changed = doc.is_changed() || doc.saved.as_ref().is_none_or(|s| s.camera != doc.scene.camera);
        if changed {
            self.save_to(ctx, &path, None);
        }
        let Some(doc) = &self.doc else { return };
        let mut scene = doc.scene.clone();
        scene.render.size = self.view.size();
        ctx.copy_text(crate::scene::command::render_command(
            &scene,
            &path,
            "picture.png",
        ));
        self.report(LogLevel::Info, "Copied the command line of this view");
    }
}

impl ClipForm {
    /// The scene of frame `n`.
    ///
    /// # Errors
    /// The animated deformation does not exist.
    pub fn frame(&self, scene: &Scene, n: usize) -> Result<Scene> {
        let mut scene = scene.clone();
        scene.render.size = self.size;
        let last = self.frames.saturating_sub(1).max(1);
        let share = n as f32 / last as f32;
        // Forwards and backwards: up to the middle and down again.
        let share = if self.back {
            1.0 - (2.0 * share - 1.0).abs()
        } else {
            share
        };
        let value = self.range[0] + (self.range[1] - self.range[0]) * share;
        let of = |scene: &mut Scene, d: usize| -> Result<()> {
            if d < scene.deformation.len() {
                Ok(())
            } else {
                Err(Error::value("clip", "the deformation is no longer there"))
            }
        };
        match &self.travel {
            ClipMotion::Orbit => {
                // The last frame is followed by the first, so the full turn is not reached.
                let turn = 360.0 * n as f32 / self.frames.max(1) as f32;
                let azimuth = scene.camera.view.azimuth_deg + turn;
                scene.camera.view.azimuth_deg = (azimuth + 180.0).rem_euclid(360.0) - 180.0;
            }
            ClipMotion::Progress(d) => {
                of(&mut scene, *d)?;
                scene.deformation[*d].progress = Some(value.clamp(0.0, 1.0));
            }
            ClipMotion::Parameter(d, name) => {
                of(&mut scene, *d)?;
                scene.deformation[*d].parameters.insert(name.clone(), value);
            }
        }
        Ok(scene)
    }
}

/// A writer that fails once the work is cancelled.
struct CancellableWriter<'a> {
    out: &'a mut dyn std::io::Write,
    watch: &'a Watch<'a>,
}

impl std::io::Write for CancellableWriter<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.watch.is_cancelled() {
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
        let mut form = ClipForm {
            travel: ClipMotion::Orbit,
            range: [0.0, 1.0],
            back: true,
            frames: 8,
            rate: 25.0,
            size: [64, 64],
        };
        let azimuths: Vec<f32> = (0..8)
            .map(|n| form.frame(&scene, n).unwrap().camera.view.azimuth_deg)
            .collect();
        assert_eq!(azimuths, [0.0, 45.0, 90.0, 135.0, -180.0, -135.0, -90.0, -45.0]);
        form.travel = ClipMotion::Progress(0);
        form.frames = 5;
        let progress: Vec<f32> = (0..5)
            .map(|n| form.frame(&scene, n).unwrap().deformation[0].progress.unwrap())
            .collect();
        assert_eq!(progress, [0.0, 0.5, 1.0, 0.5, 0.0]);
        form.travel = ClipMotion::Progress(3);
        assert!(form.frame(&scene, 0).is_err());
    }

    #[test]
    fn endings() {
        assert_eq!(with_ending(Path::new("/a/b"), "png"), Path::new("/a/b.png"));
        assert_eq!(with_ending(Path::new("/a/b.v2"), "png"), Path::new("/a/b.v2.png"));
        assert_eq!(with_ending(Path::new("/a/b.PNG"), "png"), Path::new("/a/b.PNG"));
    }
}
