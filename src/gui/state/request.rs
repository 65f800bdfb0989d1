//! Requests from panels and views to the application. Panels and views read the state and change
//! none of it; once they are drawn, the application carries out their requests.

use super::action::Action;
use super::document::{Document, Selection};
use super::layout::Panel;
use super::panels::{Brush, Gallery};
use super::slice_paint::{Overlay, SliceStyle};
use super::slices::Space;
use super::tool::Tool;
use super::worker::ProbePurpose;
use super::{Gesture, Hover};
use crate::cpu::section::SectionPlane;
use crate::engine::Backend;
use eframe::egui::{KeyboardShortcut, Rect, Vec2};
use glam::Vec3;
use std::path::PathBuf;

/// A request from a panel or view.
pub enum Request {
    /// Performs an action, as a key or the palette does.
    Perform(Action),
    /// Selects something and performs an action on it.
    PerformOn(Selection, Action),
    /// Selects something.
    Select(Selection),
    /// Brings a panel to the front.
    Show(Panel),
    /// Changes the open scene.
    Change(Box<dyn FnOnce(&mut Document)>),
    /// Arms a tool, or disarms it if it is armed already.
    Arm(Tool),
    /// Opens a file or a folder.
    Open(PathBuf),
    /// Opens a file that comes with the program.
    OpenBundled(&'static str),
    /// Cancels loading.
    CancelLoading,
    /// Cancels a task, by its index in the list.
    CancelTask(usize),
    /// Selects the backend.
    SetBackend(Backend),
    /// Selects whether slices show the deformed or the source anatomy.
    SetSpace(Space),
    /// Deletes the messages.
    ClearLog,
    /// Binds a key to the action with this label.
    SetKey(String, KeyboardShortcut),
    /// Restores the default keys.
    ResetKeys,
    /// Uses the mouse as in Blender, or as in 3D Slicer.
    SetMouse {
        /// Which.
        blender: bool,
    },
    /// Sets the drag in progress.
    SetGesture(Option<Gesture>),
    /// Sets the tool, without the side effects of [`Self::Arm`].
    SetTool(Tool),
    /// Sets what is under the pointer.
    SetHover(Option<Hover>),
    /// Picks the point under a position of the 3D view.
    Probe([f32; 2], ProbePurpose),
    /// Renders a picture for a pane of the slices, unless the pane already has it.
    Slice(usize, SectionPlane, SliceStyle),
    /// Handles a click on a slice.
    ClickSlice {
        /// Position of the click, mm.
        at: Vec3,
        /// Which of the three views.
        n: usize,
        /// Whether the slice shows the source.
        source: bool,
    },
    /// Begins a brush stroke.
    BeginStroke,
    /// Adds a point to the stroke, mm.
    ExtendStroke(Vec3),
    /// Ends the stroke.
    EndStroke,
    /// Closes a lasso's outline and applies it.
    FinishLasso,
    /// Changes the slices' window and level by a drag, points.
    DragWindow(Vec2),
    /// Changes the transfer function's window and level by a drag, points.
    DragTransfer(Vec2),
    /// Cancels a drag, disarms a tool, or deselects.
    Escape,
    /// Looks from a named direction.
    LookFrom(&'static str),
    /// Rolls the camera, degrees.
    Roll(f32),
    /// Orbits the camera by a drag, points.
    Orbit(Vec2),
    /// Pans the camera by a drag across a view, points.
    Pan(Vec2, Rect),
    /// Zooms by a factor.
    Zoom(f32),
    /// Sets the brush.
    SetBrush(Brush),
    /// Sets what is drawn over the slices.
    SetOverlay(Overlay),
    /// Makes the thumbnails of a gallery that is being shown.
    MakeThumbnails(Gallery),
    /// Opens the dialog that chooses a label map.
    ChooseLabelMap,
    /// Adds a map of the library to the scene.
    UseMap(PathBuf),
    /// Removes a map from the library.
    RemoveMap(PathBuf),
}

/// The requests that one panel makes while it is drawn, in order.
#[derive(Default)]
pub struct Requests(pub Vec<Request>);

impl Requests {
    /// Requests an action.
    pub fn perform(&mut self, action: Action) {
        self.0.push(Request::Perform(action));
    }

    /// Requests the point under a position of the 3D view.
    pub fn probe(&mut self, at: [f32; 2], purpose: ProbePurpose) {
        self.0.push(Request::Probe(at, purpose));
    }

    /// Requests a change of the open scene.
    pub fn change(&mut self, change: impl FnOnce(&mut Document) + 'static) {
        self.0.push(Request::Change(Box::new(change)));
    }
}
