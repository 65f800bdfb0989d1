//! Undo and redo: a snapshot of the scene without its camera after every gesture; and a separate
//! history of the camera.

use crate::scene::{Camera, Scene};
use eframe::egui::util::undoer::{Settings, Undoer};

/// Most undo steps.
const STEPS: usize = 200;
/// Most camera positions.
const CAMERAS: usize = 100;

/// Snapshots of the scene.
pub struct History {
    undoer: Undoer<Scene>,
    /// The last snapshot.
    last_snapshot: Option<Scene>,
}

impl Default for History {
    fn default() -> Self {
        Self {
            undoer: Undoer::with_settings(Settings {
                max_undos: STEPS,
                ..Settings::default()
            }),
            last_snapshot: None,
        }
    }
}

/// The scene without its camera, which undo ignores.
pub fn without_camera(scene: &Scene) -> Scene {
    Scene {
        camera: Camera::default(),
        ..scene.clone()
    }
}

impl History {
    /// Starts a new history at a scene.
    pub fn start(&mut self, scene: &Scene) {
        *self = Self::default();
        self.take_snapshot(scene);
    }

    /// Takes a snapshot of a scene if it differs from the last one: one step.
    pub fn take_snapshot(&mut self, scene: &Scene) {
        if self.last_snapshot.as_ref().is_some_and(|k| same(k, scene)) {
            return;
        }
        let state = without_camera(scene);
        // A redo with a new state makes the undoer discard its redo steps.
        let _none = self.undoer.redo(&state);
        self.undoer.add_undo(&state);
        self.last_snapshot = Some(state);
    }

    /// Whether the scene differs from the last snapshot.
    pub fn changed(&self, scene: &Scene) -> bool {
        self.last_snapshot.as_ref().is_none_or(|k| !same(k, scene))
    }

    /// Whether undo is possible.
    pub fn has_undo(&self, scene: &Scene) -> bool {
        self.undoer.has_undo(&without_camera(scene))
    }

    /// Whether redo is possible.
    pub fn has_redo(&self, scene: &Scene) -> bool {
        self.undoer.has_redo(&without_camera(scene))
    }

    /// Undoes one step.
    pub fn undo(&mut self, scene: &mut Scene) -> bool {
        self.take_snapshot(scene);
        let to = self.undoer.undo(&without_camera(scene)).cloned();
        self.restore(scene, to)
    }

    /// Redoes one step.
    pub fn redo(&mut self, scene: &mut Scene) -> bool {
        let to = self.undoer.redo(&without_camera(scene)).cloned();
        self.restore(scene, to)
    }

    /// Restores the last snapshot, after a cancelled drag.
    pub fn revert(&mut self, scene: &mut Scene) -> bool {
        let to = self.last_snapshot.clone();
        self.restore(scene, to)
    }

    fn restore(&mut self, scene: &mut Scene, to: Option<Scene>) -> bool {
        let Some(to) = to else { return false };
        let camera = std::mem::take(&mut scene.camera);
        *scene = Scene { camera, ..to.clone() };
        self.last_snapshot = Some(to);
        true
    }
}

/// Whether two scenes are equal except for the camera.
pub fn same(last_snapshot: &Scene, scene: &Scene) -> bool {
    last_snapshot.deformation == scene.deformation
        && last_snapshot.transfer == scene.transfer
        && last_snapshot.render == scene.render
        && last_snapshot.light == scene.light
        && last_snapshot.volume == scene.volume
        && last_snapshot.mesh == scene.mesh
        && last_snapshot.surface == scene.surface
        && last_snapshot.measure == scene.measure
        && last_snapshot.folder == scene.folder
}

/// The history of the camera.
#[derive(Default)]
pub struct CameraHistory {
    before: Vec<Camera>,
    after: Vec<Camera>,
    /// The camera at rest.
    rest: Option<Camera>,
}

impl CameraHistory {
    /// Records a camera at rest.
    pub fn settle(&mut self, camera: &Camera) {
        match &self.rest {
            Some(rest) if rest == camera => {}
            Some(rest) => {
                self.before.push(rest.clone());
                if self.before.len() > CAMERAS {
                    self.before.remove(0);
                }
                self.after.clear();
                self.rest = Some(camera.clone());
            }
            None => self.rest = Some(camera.clone()),
        }
    }

    /// The camera at rest, before the drag in progress.
    pub fn rest(&self) -> Option<&Camera> {
        self.rest.as_ref()
    }

    /// Returns to the previous camera.
    pub fn back(&mut self, camera: &mut Camera) -> bool {
        self.settle(camera);
        let Some(to) = self.before.pop() else { return false };
        self.after.push(std::mem::replace(camera, to));
        self.rest = Some(camera.clone());
        true
    }

    /// Returns to the next camera.
    pub fn forward(&mut self, camera: &mut Camera) -> bool {
        let Some(to) = self.after.pop() else { return false };
        self.before.push(std::mem::replace(camera, to));
        self.rest = Some(camera.clone());
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Deformation;

    #[test]
    fn steps_go_back_and_forth_and_leave_the_camera() {
        let mut history = History::default();
        let mut scene = Scene::of_volume("phantom:ball");
        history.start(&scene);
        for n in 0..3 {
            scene
                .deformation
                .push(Deformation::new(["twist", "peel", "box"][n]));
            history.take_snapshot(&scene);
        }
        scene.camera.zoom = 2.0;
        assert!(!history.changed(&scene));
        assert!(history.undo(&mut scene) && history.undo(&mut scene));
        assert_eq!((scene.deformation.len(), scene.camera.zoom), (1, 2.0));
        assert!(history.redo(&mut scene));
        assert_eq!(scene.deformation.len(), 2);
        scene.deformation.clear();
        assert!(history.changed(&scene));
        history.take_snapshot(&scene);
        assert!(!history.has_redo(&scene));
        assert!(history.undo(&mut scene));
        assert_eq!(scene.deformation.len(), 2);
    }

    #[test]
    fn cameras_go_back_and_forth() {
        let mut cameras = CameraHistory::default();
        let mut camera = Camera::default();
        cameras.settle(&camera);
        camera.zoom = 2.0;
        cameras.settle(&camera);
        camera.zoom = 3.0;
        assert!(cameras.back(&mut camera));
        assert_eq!(camera.zoom, 2.0);
        assert!(cameras.back(&mut camera) && !cameras.back(&mut camera));
        assert_eq!(camera.zoom, 1.0);
        assert!(cameras.forward(&mut camera) && cameras.forward(&mut camera));
        assert_eq!(camera.zoom, 3.0);
    }
}
