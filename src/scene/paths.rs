//! The files that a scene names: which are read, which must not be overwritten, and how their paths
//! change when a scene moves.

use super::{Deformation, Scene};
use crate::deform::Argument;
use crate::files::path_text::{path_of, text_of};
use crate::volume::phantom::is_procedural;
use crate::{Error, Result, mesh};
use std::path::{Component, Path, PathBuf};

/// Settings of deformations that may name files.
const FILE_SETTINGS: [&str; 10] = [
    "path",
    "moving",
    "reference",
    "labels",
    "mask",
    "pairs",
    "from",
    "to",
    "offsets",
    "points",
];

impl Scene {
    /// The scene of an input: a scene file, or a scene with all defaults for a volume, a mesh or a
    /// phantom.
    ///
    /// # Errors
    /// A scene file that is invalid.
    pub fn of_input(input: &Path) -> Result<Self> {
        let text = text_of(input);
        match input
            .extension()
            .and_then(|e| e.to_str())
            .map(str::to_ascii_lowercase)
            .as_deref()
        {
            Some("toml") => Self::load(input),
            _ if mesh::load::is_mesh(input) => Ok(Self::of_mesh(text)),
            _ => Ok(Self::of_volume(text)),
        }
    }

    /// Files that the scene reads: its volume, its labels, its meshes and the files of its
    /// deformations.
    pub fn files(&self) -> Vec<PathBuf> {
        let named = self.deformation.iter().flat_map(|d| {
            FILE_SETTINGS
                .iter()
                .flat_map(|n| d.parameters.texts(n).ok().flatten().unwrap_or_default())
        });
        let holder = self.volume.iter().flat_map(|v| &v.inside).map(|i| &i.path);
        let labels = self.volume.iter().flat_map(|v| &v.labels);
        let at = |p: &str| {
            if is_procedural(p) {
                PathBuf::from(p)
            } else {
                self.folder.join(path_of(p))
            }
        };
        let meshes = self
            .mesh
            .iter()
            .flat_map(|m| m.path.iter().chain(&m.volume))
            .chain(holder)
            .chain(labels)
            .map(|p| at(p));
        self.volume_path()
            .into_iter()
            .chain(meshes)
            .chain(named.map(|p| at(&p)))
            .collect()
    }

    /// The same scene as a file in `folder` would state it: paths relative where they lie below it,
    /// else absolute.
    ///
    /// # Errors
    /// The current folder cannot be determined.
    pub fn moved_to(&self, folder: &Path) -> Result<Self> {
        let mut scene = self.clone();
        let from = std::path::absolute(if self.folder.as_os_str().is_empty() {
            Path::new(".")
        } else {
            &self.folder
        })
        .map_err(|e| Error::io(&self.folder, "reading", e))?;
        let to = std::path::absolute(if folder.as_os_str().is_empty() {
            Path::new(".")
        } else {
            folder
        })
        .map_err(|e| Error::io(folder, "reading", e))?;
        let to = plain(&to);
        let moved = |path: &mut String| {
            if !is_procedural(path) {
                let absolute = plain(&from.join(path_of(path)));
                // In the path syntax of the current system.
                *path = text_of(absolute.strip_prefix(&to).unwrap_or(&absolute));
            }
        };
        scene.folder = from.clone();
        scene.each_path(&moved);
        scene.folder = folder.to_owned();
        Ok(scene)
    }
}

impl Scene {
    /// Replaces `missing` by `found`; other missing files of the same folder are looked for next to
    /// it.
    pub fn relocate(&mut self, missing: &Path, found: &Path) {
        let (old, new) = (
            missing.parent().map(Path::to_owned),
            found.parent().map(Path::to_owned),
        );
        let folder = self.folder.clone();
        let moved = |path: &mut String| {
            let full = folder.join(path_of(path));
            if full == missing {
                *path = text_of(found);
            } else if let (Some(old), Some(new)) = (&old, &new)
                && !is_procedural(path)
                && !full.exists()
                && let Ok(rest) = full.strip_prefix(old)
                && new.join(rest).exists()
            {
                *path = text_of(&new.join(rest));
            }
        };
        self.each_path(&moved);
    }

    /// Applies a function to every path in the scene.
    fn each_path(&mut self, change: &impl Fn(&mut String)) {
        let from = self.folder.clone();
        if let Some(volume) = &mut self.volume {
            change(&mut volume.path);
            volume.labels.iter_mut().for_each(change);
            volume.inside.iter_mut().for_each(|i| change(&mut i.path));
        }
        for mesh in &mut self.mesh {
            mesh.path.iter_mut().chain(&mut mesh.volume).for_each(change);
        }
        for deformation in &mut self.deformation {
            move_settings(deformation, &from, change);
        }
    }
}

/// Moves those settings of a deformation that are file paths: some settings take either a keyword
/// or a file.
fn move_settings(deformation: &mut Deformation, from: &Path, moved: &impl Fn(&mut String)) {
    for name in FILE_SETTINGS {
        let is_file = |text: &str| name == "path" || is_procedural(text) || from.join(text).exists();
        match deformation.parameters.0.get_mut(name) {
            Some(Argument::Text(text)) if is_file(text) => moved(text),
            Some(Argument::Texts(all)) => all.iter_mut().filter(|t| is_file(t)).for_each(moved),
            _ => {}
        }
    }
}

/// A path without `.` and, where only plain names precede it, without `..`.
fn plain(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if matches!(out.components().next_back(), Some(Component::Normal(_))) => {
                out.pop();
            }
            other => out.push(other),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_that_moves_names_the_same_files() {
        let folder = tempfile::tempdir().unwrap();
        let (a, b) = (folder.path().join("a"), folder.path().join("b"));
        std::fs::create_dir_all(&a).unwrap();
        std::fs::create_dir_all(&b).unwrap();
        let mut scene = Scene::of_volume("scan.nii.gz");
        scene.folder = a.clone();
        scene
            .mesh
            .push(super::super::surface::MeshSource::of_file("../b/model.stl"));
        let mut field = Deformation::new("field");
        field.parameters.insert("path", "warp.nii.gz");
        scene.deformation.push(field);
        let files = |s: &Scene| s.files().iter().map(|p| plain(p)).collect::<Vec<_>>();
        let moved = scene.moved_to(&b).unwrap();
        assert_eq!(files(&moved), files(&scene));
        assert_eq!(moved.mesh[0].path.as_deref(), Some("model.stl"));
        assert_eq!(files(&moved.moved_to(&a).unwrap()), files(&scene));
        assert_eq!(moved.moved_to(&a).unwrap().volume_name(), "scan.nii.gz");
        assert_eq!(
            Scene::of_volume("phantom:ball")
                .moved_to(&b)
                .unwrap()
                .volume_name(),
            "phantom:ball"
        );
    }
}
