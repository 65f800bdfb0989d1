//! The open scene, its loaded assets, and edits of it.

use super::tool::words;
use crate::deform::kinds::brush::Stroke;
use crate::deform::{Argument, Arguments};
use crate::math::Bounds;
use crate::prepare::{AssetKey, Assets};
use crate::scene::{Deformation, Scene};
use std::path::PathBuf;
use std::sync::Arc;

/// The selection, which the inspector shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Selection {
    /// Nothing; the inspector shows the render settings.
    #[default]
    Nothing,
    /// The volume.
    Volume,
    /// A surface.
    Mesh(usize),
    /// A deformation.
    Deformation(usize),
    /// A measurement.
    Measure(usize),
}

/// The open scene.
pub struct Document {
    /// The scene.
    pub scene: Scene,
    /// The scene file that it is saved in.
    pub path: Option<PathBuf>,
    /// Its display name: the file that was opened.
    pub name: String,
    /// The scene as last saved or opened; none if never saved.
    pub saved: Option<Scene>,
    /// The loaded assets.
    pub assets: Arc<Assets>,
    /// The key for which they were loaded.
    pub loaded: AssetKey,
    /// The selection.
    pub selected: Selection,
    /// The only deformation that is applied, if one is soloed.
    pub solo: Option<usize>,
}

impl Document {
    /// A deformation's name in the tree.
    pub fn title_of(d: &Deformation) -> String {
        d.name
            .clone()
            .filter(|n| !n.is_empty())
            .unwrap_or_else(|| words(&d.kind))
    }

    /// Resamples the volume's slices onto a regular grid; earlier measurements may then refer to
    /// other anatomy.
    pub fn resample(&mut self) {
        let Some(volume) = &mut self.scene.volume else {
            return;
        };
        volume.choice.resample = true;
        for measure in &mut self.scene.measure {
            // A measurement without points is recomputed from the voxels.
            measure.before_resampling = !measure.points.is_empty();
        }
    }

    /// A document for a scene that was just loaded.
    pub fn new(scene: Scene, path: Option<PathBuf>, name: String, assets: Arc<Assets>) -> Self {
        let loaded = AssetKey::of(&scene);
        Self {
            saved: Some(scene.clone()),
            scene,
            path,
            name,
            assets,
            loaded,
            selected: Selection::Nothing,
            solo: None,
        }
    }

    /// Whether there are unsaved edits. Turning the camera does not count.
    pub fn is_changed(&self) -> bool {
        self.saved
            .as_ref()
            .is_none_or(|saved| !super::history::same(saved, &self.scene))
    }

    /// The scene's box, mm.
    pub fn bounds(&self) -> Bounds {
        self.assets.scene_box()
    }

    /// The selected deformation.
    pub fn deformation(&mut self) -> Option<&mut Deformation> {
        match self.selected {
            Selection::Deformation(n) => self.scene.deformation.get_mut(n),
            _ => None,
        }
    }

    /// The index of the selected deformation.
    pub fn deformation_index(&self) -> Option<usize> {
        match self.selected {
            Selection::Deformation(n) if n < self.scene.deformation.len() => Some(n),
            _ => None,
        }
    }

    /// Clears a selection that no longer exists.
    pub fn check_selection(&mut self) {
        let gone = match self.selected {
            Selection::Deformation(n) => n >= self.scene.deformation.len(),
            Selection::Mesh(n) => n >= self.scene.mesh.len(),
            Selection::Measure(n) => n >= self.scene.measure.len(),
            Selection::Volume => self.scene.volume.is_none(),
            Selection::Nothing => false,
        };
        if gone {
            self.selected = Selection::Nothing;
        }
        if self.solo.is_some_and(|n| n >= self.scene.deformation.len()) {
            self.solo = None;
        }
    }

    /// Adds a deformation at the end and selects it.
    pub fn add(&mut self, deformation: Deformation) -> usize {
        let at = self.scene.deformation.len();
        self.scene.deformation.push(deformation);
        self.selected = Selection::Deformation(at);
        at
    }

    /// Removes the selected item.
    pub fn delete(&mut self) -> bool {
        match self.selected {
            Selection::Deformation(n) if n < self.scene.deformation.len() => {
                self.scene.deformation.remove(n);
                self.solo = None;
                self.selected = match self.scene.deformation.len() {
                    0 => Selection::Nothing,
                    len => Selection::Deformation(n.min(len - 1)),
                };
            }
            // The last of the volume and the meshes cannot be removed.
            Selection::Mesh(n)
                if n < self.scene.mesh.len()
                    && (self.scene.mesh.len() > 1 || self.scene.volume.is_some()) =>
            {
                self.scene.mesh.remove(n);
                self.selected = Selection::Nothing;
            }
            Selection::Volume if !self.scene.mesh.is_empty() => {
                self.scene.volume = None;
                self.selected = Selection::Nothing;
            }
            Selection::Measure(n) if n < self.scene.measure.len() => {
                self.scene.measure.remove(n);
                self.selected = Selection::Nothing;
            }
            _ => return false,
        }
        true
    }

    /// Inserts a copy of the selected deformation after it.
    pub fn duplicate(&mut self) -> bool {
        let Some(n) = self.deformation_index() else {
            return false;
        };
        let mut copy = self.scene.deformation[n].clone();
        copy.name = copy.name.map(|name| format!("{name} copy"));
        self.scene.deformation.insert(n + 1, copy);
        self.selected = Selection::Deformation(n + 1);
        self.solo = None;
        true
    }

    /// Moves a deformation to another index in the stack.
    pub fn reorder(&mut self, from: usize, to: usize) -> bool {
        let len = self.scene.deformation.len();
        if from >= len || to >= len || from == to {
            return false;
        }
        let moved = self.scene.deformation.remove(from);
        self.scene.deformation.insert(to, moved);
        self.selected = Selection::Deformation(to);
        self.solo = None;
        true
    }

    /// The scene as displayed: with a soloed deformation alone, or without any.
    pub fn shown(&self, undeformed: bool) -> Scene {
        let mut scene = self.scene.clone();
        if undeformed {
            scene.deformation.clear();
        } else if let Some(solo) = self.solo {
            for (n, d) in scene.deformation.iter_mut().enumerate() {
                d.enabled = n == solo;
            }
        }
        scene
    }

    /// The index of the painted map that receives strokes: the last deformation if it is a painted
    /// map, else a new one at the end.
    pub fn painted(&mut self) -> usize {
        let last = self.scene.deformation.len();
        if let Some(n) = last
            .checked_sub(1)
            .filter(|n| self.scene.deformation[*n].kind == "brush" && self.scene.deformation[*n].enabled)
        {
            self.selected = Selection::Deformation(n);
            return n;
        }
        self.add(Deformation::new("brush"))
    }

    /// Sets the strokes of a painted map.
    pub fn set_strokes(&mut self, n: usize, strokes: &[String]) {
        if let Some(d) = self.scene.deformation.get_mut(n) {
            match strokes {
                [] => {
                    d.parameters.0.remove("strokes");
                }
                _ => d.parameters.insert("strokes", Argument::Texts(strokes.to_vec())),
            }
        }
    }

    /// The strokes of a painted map.
    pub fn strokes(&self, n: usize) -> Vec<String> {
        let of = |p: &Arguments| p.texts("strokes").ok().flatten().unwrap_or_default();
        self.scene
            .deformation
            .get(n)
            .map(|d| of(&d.parameters))
            .unwrap_or_default()
    }

    /// Adds a stroke to the painted map at the end of the stack.
    pub fn stroke(&mut self, stroke: &Stroke) {
        let n = self.painted();
        let mut strokes = self.strokes(n);
        strokes.push(stroke.to_string());
        self.set_strokes(n, &strokes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn document() -> Document {
        let scene = Scene::of_volume("phantom:ball:size=8");
        let assets = Arc::new(Assets::load(&scene).unwrap());
        Document::new(scene, None, "ball".into(), assets)
    }

    #[test]
    fn the_stack_is_edited() {
        let mut d = document();
        for kind in ["twist", "peel", "box"] {
            d.add(Deformation::new(kind));
        }
        let kinds = |d: &Document| {
            d.scene
                .deformation
                .iter()
                .map(|x| x.kind.clone())
                .collect::<Vec<_>>()
        };
        assert!(d.reorder(2, 0) && !d.reorder(0, 3) && !d.reorder(1, 1));
        assert_eq!(
            (kinds(&d), d.selected),
            (
                vec!["box".into(), "twist".into(), "peel".into()],
                Selection::Deformation(0)
            )
        );
        assert!(d.duplicate());
        assert_eq!(kinds(&d).len(), 4);
        d.solo = Some(1);
        assert_eq!(d.shown(false).deformation.iter().filter(|x| x.enabled).count(), 1);
        assert!(d.shown(true).deformation.is_empty());
        assert!(d.delete() && d.delete());
        assert_eq!(kinds(&d), ["box".to_owned(), "peel".into()]);
        assert!(d.is_changed());
        d.selected = Selection::Volume;
        assert!(!d.delete(), "a scene shows something");
    }
}
