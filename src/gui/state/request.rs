//! What panels and views ask of the application. They read the state and change none of it; the
//! application carries out what they asked for once they are drawn.

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

/// One of the things that can be asked for.
pub enum Request {
    /// An action, as a key or the palette would.
    Perform(Action),
    /// An action on something, which is selected first.
    PerformOn(Selection, Action),
    /// To select something.
    Select(Selection),
    /// To bring a panel to the front.
    Show(Panel),
    /// A change of the open scene.
    Change(Box<dyn FnOnce(&mut Document)>),
    /// To arm a tool, even if it is armed already.
    Arm(Tool),
    /// To open a file or a folder.
    Open(PathBuf),
    /// To open a file that comes with the program.
    OpenBundled(&'static str),
    /// To stop loading.
    CancelLoading,
    /// To stop a task, by its place in the list.
    CancelTask(usize),
    /// Another backend.
    SetBackend(Backend),
    /// Whether slices show the deformed or the source anatomy.
    SetSpace(Space),
    /// To delete the messages.
    ClearLog,
    /// Another key for the action of a label.
    SetKey(String, KeyboardShortcut),
    /// The default keys.
    ResetKeys,
    /// The mouse as in Blender, or as in 3D Slicer.
    SetMouse {
        /// Which.
        blender: bool,
    },
    /// The drag that is under way.
    SetGesture(Option<Gesture>),
    /// Another tool, without more.
    SetTool(Tool),
    /// What is under the pointer.
    SetHover(Option<Hover>),
    /// What lies under a position of the 3D view.
    Probe([f32; 2], ProbePurpose),
    /// A picture for a pane of the slices, unless it is there.
    Slice(usize, SectionPlane, SliceStyle),
    /// A click into a slice.
    ClickSlice {
        /// Where, mm.
        at: Vec3,
        /// Which of the three views.
        n: usize,
        /// It shows the source.
        source: bool,
    },
    /// The beginning of a brush stroke.
    BeginStroke,
    /// A point of the stroke, mm.
    ExtendStroke(Vec3),
    /// The end of the stroke.
    EndStroke,
    /// The end of a lasso's outline.
    FinishLasso,
    /// A change of the slices' window and level, points.
    DragWindow(Vec2),
    /// A change of the transfer function's window and level, points.
    DragTransfer(Vec2),
    /// To interrupt what is under way.
    Escape,
    /// A named direction of view.
    LookFrom(&'static str),
    /// To roll the camera, degrees.
    Roll(f32),
    /// To turn the camera, points.
    Orbit(Vec2),
    /// To move the camera across a view, points.
    Pan(Vec2, Rect),
    /// To zoom by a factor.
    Zoom(f32),
    /// Another brush.
    SetBrush(Brush),
    /// What is drawn over the slices.
    SetOverlay(Overlay),
    /// The thumbnails of a gallery that is being shown.
    MakeThumbnails(Gallery),
    /// The choice of a label map.
    ChooseLabelMap,
    /// A map of the library, for this scene.
    UseMap(PathBuf),
    /// To take a map out of the library.
    RemoveMap(PathBuf),
}

/// What one panel asked for while it was drawn, in order.
#[derive(Default)]
pub struct Requests(pub Vec<Request>);

impl Requests {
    /// Asks for an action.
    pub fn perform(&mut self, action: Action) {
        self.0.push(Request::Perform(action));
    }

    /// Asks what lies under a position of the 3D view.
    pub fn ask(&mut self, at: [f32; 2], purpose: ProbePurpose) {
        self.0.push(Request::Probe(at, purpose));
    }

    /// Asks for a change of the open scene.
    pub fn change(&mut self, change: impl FnOnce(&mut Document) + 'static) {
        self.0.push(Request::Change(Box::new(change)));
    }
}
