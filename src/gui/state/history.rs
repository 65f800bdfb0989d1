//! Undo and redo: the scene without its camera as a snapshot after every gesture; and the camera's own way back.

use crate::scene::{Camera, Scene};
use eframe::egui::util::undoer::{Settings, Undoer};

/// Steps that are kept.
const STEPS: usize = 200;
/// Cameras that are kept.
const CAMERAS: usize = 100;

/// Snapshots of the scene.
pub struct History {
    undoer: Undoer<Scene>,
    /// The scene as last kept.
    last_snapshot: Option<Scene>,
}

impl Default for History {
    fn default() -> Self {
        Self { undoer: Undoer::with_settings(Settings { max_undos: STEPS, ..Settings::default() }), last_snapshot: None }
    }
}

/// What undo is about: the scene from a camera that does not matter.
pub fn without_camera(scene: &Scene) -> Scene {
    Scene { camera: Camera::default(), ..scene.clone() }
}

impl History {
    /// Begins anew at a scene.
    pub fn start(&mut self, scene: &Scene) {
        *self = Self::default();
        self.take_snapshot(scene);
    }

    /// Keeps a scene if it differs from the last one kept: one step.
    pub fn take_snapshot(&mut self, scene: &Scene) {
        if self.last_snapshot.as_ref().is_some_and(|k| same(k, scene)) {
            return;
        }
        let state = without_camera(scene);
        // Asked for a redo of something new, the undoer forgets what was undone before it: that branch is given up.
        let _none = self.undoer.redo(&state);
        self.undoer.add_undo(&state);
        self.last_snapshot = Some(state);
    }

    /// Whether the scene differs from the one last kept.
    pub fn changed(&self, scene: &Scene) -> bool {
        self.last_snapshot.as_ref().is_none_or(|k| !same(k, scene))
    }

    /// Whether there is a step back.
    pub fn has_undo(&self, scene: &Scene) -> bool {
        self.undoer.has_undo(&without_camera(scene))
    }

    /// Whether there is a step forward.
    pub fn has_redo(&self, scene: &Scene) -> bool {
        self.undoer.has_redo(&without_camera(scene))
    }

    /// One step back.
    pub fn undo(&mut self, scene: &mut Scene) -> bool {
        self.take_snapshot(scene);
        let to = self.undoer.undo(&without_camera(scene)).cloned();
        self.restore(scene, to)
    }

    /// One step forward.
    pub fn redo(&mut self, scene: &mut Scene) -> bool {
        let to = self.undoer.redo(&without_camera(scene)).cloned();
        self.restore(scene, to)
    }

    /// Back to the last kept scene: a drag that was called off.
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

/// Equal but for the camera.
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

/// Where the camera has been.
#[derive(Default)]
pub struct CameraHistory {
    before: Vec<Camera>,
    after: Vec<Camera>,
    /// The camera at rest.
    rest: Option<Camera>,
}

impl CameraHistory {
    /// Notes a camera at rest.
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

    /// The camera at rest, before the drag that is under way.
    pub fn rest(&self) -> Option<&Camera> {
        self.rest.as_ref()
    }

    /// The camera before.
    pub fn back(&mut self, camera: &mut Camera) -> bool {
        self.settle(camera);
        let Some(to) = self.before.pop() else { return false };
        self.after.push(std::mem::replace(camera, to));
        self.rest = Some(camera.clone());
        true
    }

    /// The camera after.
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
            scene.deformation.push(Deformation::new(["twist", "peel", "box"][n]));
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
