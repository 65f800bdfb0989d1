//! Persistent data of the workstation: settings, recent files, the library of maps, and automatic
//! saves.
//!
//! Every running window writes its unsaved scene to `autosave/NAME.toml` and holds a lock on
//! `NAME.lock` while it runs. A scene without a held lock was left behind by a crash, and the next
//! window offers to recover it. Every file is written under a temporary name and renamed: whenever
//! the program ends, the last complete file is in place.

use crate::files::{OutputFile, input};
use crate::scene::Scene;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Interval of automatic saves.
pub const AUTOSAVE: Duration = Duration::from_secs(60);
/// Most recent files listed.
const RECENT: usize = 12;

/// The bundled files: the head and its labels, a mesh, and the scenes of the examples.
const BUNDLED: [(&str, &[u8]); 9] = [
    (
        "colin27-head-t1.nii.gz",
        include_bytes!("../../../volumes/colin27-head-t1.nii.gz"),
    ),
    (
        "colin27-aal-labels.nii.gz",
        include_bytes!("../../../volumes/colin27-aal-labels.nii.gz"),
    ),
    ("bunny.obj", include_bytes!("../../../volumes/bunny.obj")),
    (
        "head-peel.toml",
        include_bytes!("../../../volumes/head-peel.toml"),
    ),
    (
        "head-quadrant.toml",
        include_bytes!("../../../volumes/head-quadrant.toml"),
    ),
    (
        "head-slabs.toml",
        include_bytes!("../../../volumes/head-slabs.toml"),
    ),
    (
        "brain-labels.toml",
        include_bytes!("../../../volumes/brain-labels.toml"),
    ),
    (
        "bunny-knife.toml",
        include_bytes!("../../../volumes/bunny-knife.toml"),
    ),
    (
        "piggy-bank-2.toml",
        include_bytes!("../../../volumes/piggy-bank-2.toml"),
    ),
];

/// Worked examples: file and description.
pub const EXAMPLES: [(&str, &str); 6] = [
    ("head-peel.toml", "Scalp and skull peeled back"),
    ("head-quadrant.toml", "A quadrant removed"),
    ("head-slabs.toml", "Split into slabs"),
    ("brain-labels.toml", "Regions of the brain"),
    ("bunny-knife.toml", "A mesh cut open"),
    ("piggy-bank-2.toml", "A phantom peeled"),
];

/// The user's settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// Whether the light theme is used.
    pub light: bool,
    /// Scale of the interface.
    pub scale: f32,
    /// The backend for pictures.
    pub backend: crate::engine::Backend,
    /// Navigation as in Blender instead of 3D Slicer.
    pub blender: bool,
    /// Keys by the labels of their actions; empty for none.
    pub keys: BTreeMap<String, String>,
    /// Recently opened files, the newest first.
    pub recent: Vec<PathBuf>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            light: false,
            scale: 1.0,
            backend: crate::engine::Backend::Auto,
            blender: false,
            keys: BTreeMap::new(),
            recent: Vec::new(),
        }
    }
}

/// A scene left behind by a crash.
#[derive(Clone, Debug)]
pub struct Recovered {
    /// Its automatic save.
    pub file: PathBuf,
    /// The file it was opened from or saved to.
    pub original: Option<PathBuf>,
    /// When it was saved.
    pub saved: Option<std::time::SystemTime>,
}

/// The user's folder, and this window's files in it.
pub struct Session {
    folder: PathBuf,
    name: String,
    /// Held while the window runs.
    lock: Option<File>,
    /// Settings.
    pub settings: Settings,
    written: Settings,
    last: Instant,
    /// The last automatic save, as text.
    saved: Option<String>,
}

/// The standard folder for application data.
fn default_folder() -> PathBuf {
    match directories::ProjectDirs::from("", "", "incise") {
        Some(dirs) => dirs.data_dir().to_owned(),
        None => std::env::temp_dir().join("incise"),
    }
}

impl Session {
    /// Opens the user's folder, or another one. Problems are added to `problems`, and the program
    /// runs without the affected parts.
    pub fn open(folder: Option<PathBuf>, problems: &mut Vec<Error>) -> Self {
        let folder = folder.unwrap_or_else(default_folder);
        let mut note = |r: std::io::Result<()>, path: &Path| {
            if let Err(e) = r {
                problems.push(Error::io(path, "making", e));
            }
        };
        for sub in ["autosave", "maps", "examples"] {
            let path = folder.join(sub);
            note(std::fs::create_dir_all(&path), &path);
        }
        let stamp = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .map_or(0, |d| d.as_nanos());
        let name = format!("{}-{stamp}", std::process::id());
        let lock_path = folder.join("autosave").join(format!("{name}.lock"));
        let lock = File::create(&lock_path).and_then(|f| f.lock().map(|()| f)).ok();
        let path = folder.join("settings.toml");
        let settings = match input::text(&path, input::MAX_SCENE_BYTES, "settings") {
            Ok(text) => toml::from_str(&text).unwrap_or_else(|e: toml::de::Error| {
                problems.push(Error::file(
                    &path,
                    format!("cannot be read ({}); defaults are used", e.message()),
                ));
                Settings::default()
            }),
            Err(_) => Settings::default(),
        };
        Self {
            folder,
            name,
            lock,
            written: settings.clone(),
            settings,
            last: Instant::now(),
            saved: None,
        }
    }

    /// The user's folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn autosave_path(&self) -> PathBuf {
        self.folder.join("autosave").join(format!("{}.toml", self.name))
    }

    /// Writes the settings if they changed.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn save_settings(&mut self) -> Result<()> {
        if self.settings == self.written {
            return Ok(());
        }
        let text =
            toml::to_string_pretty(&self.settings).map_err(|e| Error::value("settings", e.to_string()))?;
        self.written = self.settings.clone();
        OutputFile::replacing(&self.folder.join("settings.toml"))?.finish(text.as_bytes())
    }

    /// Adds an opened file to the recent files.
    pub fn opened(&mut self, path: &Path) {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let recent = &mut self.settings.recent;
        recent.retain(|p| *p != path);
        recent.insert(0, path);
        recent.truncate(RECENT);
    }

    /// Whether an automatic save is due.
    pub fn is_due(&self) -> bool {
        self.last.elapsed() >= AUTOSAVE
    }

    /// Saves the scene for recovery by a later window, unless it is unchanged.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn autosave(&mut self, scene: &Scene, original: Option<&Path>) -> Result<()> {
        self.last = Instant::now();
        let path = self.autosave_path();
        let moved = scene.moved_to(&self.folder.join("autosave"))?;
        let mut text = moved.to_toml()?;
        if let Some(original) = original.and_then(|p| std::path::absolute(p).ok()) {
            text = format!(
                "{ORIGINAL}{}\n{text}",
                original.to_string_lossy().replace(['\n', '\r'], " ")
            );
        }
        if self.saved.as_ref() == Some(&text) {
            return Ok(());
        }
        OutputFile::replacing(&path)?.finish(text.as_bytes())?;
        self.saved = Some(text);
        Ok(())
    }

    /// Removes the automatic save: the scene was saved or discarded.
    pub fn forget(&mut self) {
        self.saved = None;
        self.last = Instant::now();
        let _was_none = std::fs::remove_file(self.autosave_path());
    }

    /// Scenes left behind by crashes, the newest first.
    pub fn left_behind(&self) -> Vec<Recovered> {
        let Ok(entries) = std::fs::read_dir(self.folder.join("autosave")) else {
            return Vec::new();
        };
        let mut found = Vec::new();
        for path in entries.flatten().map(|e| e.path()) {
            if path.extension().is_none_or(|e| e != "toml") || path == self.autosave_path() {
                continue;
            }
            if is_held(&path.with_extension("lock")) {
                continue;
            }
            let text = input::text(&path, input::MAX_SCENE_BYTES, "scene").unwrap_or_default();
            let original = text
                .strip_prefix(ORIGINAL)
                .and_then(|t| t.lines().next())
                .map(PathBuf::from);
            let saved = std::fs::metadata(&path).and_then(|m| m.modified()).ok();
            found.push(Recovered {
                file: path,
                original,
                saved,
            });
        }
        found.sort_by_key(|r| std::cmp::Reverse(r.saved));
        found
    }

    /// Discards a scene left behind by a crash.
    pub fn discard(&self, recovered: &Recovered) {
        for path in [recovered.file.clone(), recovered.file.with_extension("lock")] {
            let _was_gone = std::fs::remove_file(path);
        }
    }

    /// Writes a bundled file into the user's folder and returns its path.
    ///
    /// # Errors
    /// There is no bundled file of this name; a folder that cannot be written.
    pub fn bundled(&self, name: &str) -> Result<PathBuf> {
        let folder = self.folder.join("examples");
        for (file, bytes) in BUNDLED {
            let path = folder.join(file);
            // A scene reads the files next to it.
            let same = std::fs::metadata(&path).is_ok_and(|m| m.len() == bytes.len() as u64);
            if !same {
                OutputFile::replacing(&path)?.finish(bytes)?;
            }
        }
        let path = folder.join(name);
        if path.exists() {
            Ok(path)
        } else {
            Err(Error::value(name, "is not a bundled file"))
        }
    }

    /// The user's displacement maps.
    pub fn maps(&self) -> Vec<PathBuf> {
        let Ok(entries) = std::fs::read_dir(self.folder.join("maps")) else {
            return Vec::new();
        };
        let mut maps: Vec<PathBuf> = entries
            .flatten()
            .map(|e| e.path())
            .filter(|p| p.extension().is_some_and(|e| e == "nrrd"))
            .collect();
        maps.sort();
        maps
    }

    /// An unused path for a map with a name.
    pub fn map_path(&self, name: &str) -> PathBuf {
        let plain: String = name
            .trim()
            .chars()
            .map(|c| {
                if c.is_alphanumeric() || " -_".contains(c) {
                    c
                } else {
                    '-'
                }
            })
            .collect();
        let plain = if plain.trim_matches('-').is_empty() {
            "map".to_owned()
        } else {
            plain
        };
        let folder = self.folder.join("maps");
        let numbered = |n: usize| {
            folder.join(if n == 1 {
                format!("{plain}.nrrd")
            } else {
                format!("{plain} {n}.nrrd")
            })
        };
        (1..)
            .map(numbered)
            .find(|p| !p.exists())
            .unwrap_or_else(|| numbered(1))
    }
}

/// Prefix of the first line of an automatic save: a comment in TOML.
const ORIGINAL: &str = "# original: ";

/// Whether a running window holds a lock.
fn is_held(path: &Path) -> bool {
    match File::open(path) {
        Ok(file) => file.try_lock().is_err(),
        Err(_) => false,
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        let _already_reported = self.save_settings();
        drop(self.lock.take());
        let _was_none = std::fs::remove_file(self.autosave_path().with_extension("lock"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(folder: &Path) -> Session {
        let mut problems = Vec::new();
        let session = Session::open(Some(folder.to_owned()), &mut problems);
        assert!(problems.is_empty(), "{problems:?}");
        session
    }

    #[test]
    fn a_scene_is_offered_once_its_window_is_gone() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = open(folder.path());
        let mut scene = Scene::of_volume("scan.nii.gz");
        scene.folder = PathBuf::from("/data");
        first
            .autosave(&scene, Some(Path::new("/data/work.toml")))
            .unwrap();
        let second = open(folder.path());
        assert!(second.left_behind().is_empty(), "a living window's scene");
        drop(first);
        let left = second.left_behind();
        assert_eq!(left.len(), 1);
        assert_eq!(left[0].original.as_deref(), Some(Path::new("/data/work.toml")));
        assert_eq!(Scene::load(&left[0].file).unwrap().files(), scene.files());
        second.discard(&left[0]);
        assert!(second.left_behind().is_empty());
    }

    #[test]
    fn settings_and_recent_files_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = open(folder.path());
        session.settings.light = true;
        session.opened(Path::new("/a"));
        session.opened(Path::new("/b"));
        session.opened(Path::new("/a"));
        drop(session);
        let session = open(folder.path());
        assert!(session.settings.light);
        assert_eq!(
            session.settings.recent,
            [PathBuf::from("/a"), PathBuf::from("/b")]
        );
        std::fs::write(folder.path().join("settings.toml"), "scale = \"x\"").unwrap();
        let mut problems = Vec::new();
        assert_eq!(
            Session::open(Some(folder.path().to_owned()), &mut problems).settings,
            Settings::default()
        );
        assert_eq!(problems.len(), 1);
    }

    #[test]
    fn bundled_scenes_open() {
        let folder = tempfile::tempdir().unwrap();
        let session = open(folder.path());
        for (name, _) in EXAMPLES {
            let scene = Scene::load(&session.bundled(name).unwrap()).unwrap();
            for file in scene.files() {
                assert!(
                    crate::volume::phantom::is_procedural(&file.to_string_lossy()) || file.exists(),
                    "{name}: {}",
                    file.display()
                );
            }
        }
    }
}
