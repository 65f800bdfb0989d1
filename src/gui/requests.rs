//! Draws panels and carries out their requests.

use super::state::Workstation;
use super::state::action;
use super::state::files::Loading;
use super::state::panels::Gallery;
use super::state::request::{Request, Requests};
use eframe::egui::{Context, KeyboardShortcut, Ui};

impl Workstation {
    /// Draws a panel, which reads the state, and carries out what it asks for.
    pub(super) fn draw<P: Default>(
        &mut self,
        ui: &mut Ui,
        panel: impl Fn(&mut Self) -> &mut P,
        draw: impl FnOnce(&mut P, &Self, &mut Ui) -> Requests,
    ) {
        let mut drawn = std::mem::take(panel(self));
        let requests = draw(&mut drawn, self, ui);
        *panel(self) = drawn;
        self.carry_out_all(&ui.ctx().clone(), requests);
    }

    /// Carries out the requests of a panel, in order.
    pub(super) fn carry_out_all(&mut self, ctx: &Context, requests: Requests) {
        for request in requests.0 {
            self.carry_out(ctx, request);
        }
    }

    fn carry_out(&mut self, ctx: &Context, request: Request) {
        match request {
            Request::Perform(action) => self.perform(ctx, action),
            Request::PerformOn(selection, action) => {
                self.select(selection);
                self.perform(ctx, action);
            }
            Request::Select(selection) => self.select(selection),
            Request::Show(panel) => self.show_panel(panel),
            Request::Change(change) => {
                if let Some(doc) = &mut self.doc {
                    change(doc);
                }
            }
            Request::Arm(tool) => self.arm(tool),
            Request::Open(path) => self.open(ctx, &path),
            Request::OpenBundled(name) => self.open_bundled(ctx, name),
            Request::CancelLoading => self.loading.iter().for_each(Loading::cancel),
            Request::CancelTask(n) => self.tasks.get(n).iter().for_each(|task| task.cancel()),
            Request::SetBackend(backend) => self.set_backend(backend),
            Request::SetSpace(space) => self.slices.space = space,
            Request::ClearLog => self.log.clear(),
            Request::SetGesture(gesture) => self.gesture = gesture,
            Request::SetTool(tool) => self.tool = tool,
            Request::SetHover(hover) => self.hover = hover,
            Request::Probe(at, purpose) => self.probe(at, purpose),
            Request::Slice(pane, plane, style) => self.request_slice(pane, plane, style),
            Request::ClickSlice { at, n, source } => self.click_slice(at, n, source),
            Request::BeginStroke => self.begin_stroke(),
            Request::ExtendStroke(at) => self.extend_stroke(at),
            Request::EndStroke => self.end_stroke(),
            Request::FinishLasso => self.finish_lasso(),
            Request::DragWindow(by) => self.drag_window(by.x, by.y),
            Request::DragTransfer(by) => self.drag_transfer(by.x, by.y),
            Request::Escape => self.escape(),
            Request::LookFrom(view) => self.look_from(view),
            Request::Roll(degrees) => self.roll(degrees),
            Request::Orbit(by) => self.orbit(by.x, by.y),
            Request::Pan(by, view) => self.pan(by.x, by.y, view),
            Request::Zoom(factor) => self.zoom(factor),
            Request::SetKey(label, key) => self.set_key(&label, key),
            Request::ResetKeys => {
                self.session.settings.keys.clear();
                self.entries = action::list();
            }
            Request::SetMouse { blender } => self.session.settings.blender = blender,
            Request::SetBrush(brush) => self.brush = brush,
            Request::SetOverlay(overlay) => self.slices.overlay = overlay,
            Request::MakeThumbnails(Gallery::Presets) => self.thumbnails.shows_presets = true,
            Request::MakeThumbnails(Gallery::Kinds) => self.thumbnails.shows_kinds = true,
            Request::ChooseLabelMap => self.choose_label_map(),
            Request::UseMap(path) => self.use_map(ctx, &path),
            Request::RemoveMap(path) => self.remove_map(&path),
        }
    }

    /// Gives an action another key, which any other action loses.
    fn set_key(&mut self, label: &str, key: KeyboardShortcut) {
        for entry in self
            .entries
            .iter()
            .filter(|e| e.label != label && e.key == Some(key))
        {
            self.session
                .settings
                .keys
                .insert(entry.label.clone(), String::new());
        }
        self.session
            .settings
            .keys
            .insert(label.to_owned(), action::key_text(&key));
        self.apply_keys();
    }
}
