//! Picks the point under the pointer, on a thread of its own.

use super::pool::quiet_pool;
use crate::cpu::pick::{self, Pick};
use crate::prepare::placement::visible_object;
use crate::prepare::{Assets, Prepared};
use crate::scene::{Scene, VisibleObject};
use crate::{Error, Result};
use eframe::egui;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

/// The purpose of picking the point under the pointer.
#[derive(Clone, Debug, PartialEq)]
pub enum ProbePurpose {
    /// To show it in the status bar.
    Hover,
    /// To centre the view on it.
    Center,
    /// To apply a tool there.
    Tool,
    /// To place a deformation there.
    Place,
    /// To add a point to a brush stroke.
    Brush {
        /// The stroke ends with this point.
        last: bool,
    },
}

/// A request to pick a point of the 3D view.
pub struct ProbeRequest {
    /// The scene at the view's size.
    pub scene: Arc<Scene>,
    /// Its assets.
    pub assets: Arc<Assets>,
    /// Picture coordinates in -1..1, v upwards.
    pub at: [f32; 2],
    /// The purpose.
    pub purpose: ProbePurpose,
}

/// The result of picking.
pub struct ProbeResult {
    /// The position.
    pub at: [f32; 2],
    /// The purpose.
    pub purpose: ProbePurpose,
    /// The picked point.
    pub pick: Result<Option<Pick>>,
    /// What the view shows, if a deformation is to be placed on it.
    pub object: Option<VisibleObject>,
    /// The assets in which it was picked.
    pub assets: Arc<Assets>,
}

/// The thread that picks the point under the pointer.
pub struct Prober {
    /// Requests; none lets go of the scene of the last one.
    ask: Option<Sender<Option<ProbeRequest>>>,
    answers: Receiver<ProbeResult>,
    thread: Option<std::thread::JoinHandle<()>>,
    /// Number of pending requests.
    pub open: usize,
}

impl Prober {
    /// Starts the thread.
    pub fn new(ctx: &egui::Context) -> Self {
        let (ask, questions) = channel::<Option<ProbeRequest>>();
        let (answer, answers) = channel();
        let ctx = ctx.clone();
        let thread = std::thread::Builder::new()
            .name("prober".into())
            .spawn(move || probe(&questions, &answer, &ctx))
            .ok();
        Self {
            ask: Some(ask),
            answers,
            thread,
            open: 0,
        }
    }

    /// Submits a request.
    pub fn ask(&mut self, question: ProbeRequest) {
        if self.ask.as_ref().is_some_and(|a| a.send(Some(question)).is_ok()) {
            self.open += 1;
        }
    }

    /// Lets go of the scene that was last picked in, which is kept prepared for the next request.
    pub fn forget(&self) {
        if let Some(ask) = &self.ask {
            // If the thread has ended, it holds nothing.
            let _sent = ask.send(None);
        }
    }

    /// The next result, if any.
    pub fn poll(&mut self) -> Option<ProbeResult> {
        let answer = self.answers.try_recv().ok()?;
        self.open = self.open.saturating_sub(1);
        Some(answer)
    }
}

impl Drop for Prober {
    fn drop(&mut self) {
        self.ask = None;
        if let Some(thread) = self.thread.take() {
            let _ended = thread.join();
        }
    }
}

/// What a scene shows; none if it shows nothing, or if finding it fails.
fn visible(scene: &Scene, assets: &Assets) -> Option<VisibleObject> {
    let found = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| visible_object(scene, assets)));
    found.ok()?.ok()?
}

fn probe(questions: &Receiver<Option<ProbeRequest>>, answer: &Sender<ProbeResult>, ctx: &egui::Context) {
    let pool = quiet_pool();
    let mut next: Option<ProbeRequest> = None;
    while let Some(received) = next.take().map(Some).or_else(|| questions.recv().ok()) {
        let Some(question) = received else { continue };
        let (scene, assets) = (question.scene.clone(), question.assets.clone());
        let prepare = || Prepared::new(&scene, &assets);
        let fault = || {
            Error::value(
                "picking",
                "failed because of an internal error; the scene is intact",
            )
        };
        let prepared = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| match &pool {
            Some(pool) => pool.install(prepare),
            None => prepare(),
        }))
        .unwrap_or_else(|_| Err(fault()));
        let reply = |question: ProbeRequest, pick: Result<Option<Pick>>| {
            let object = (question.purpose == ProbePurpose::Place && pick.is_ok())
                .then(|| visible(&scene, &assets))
                .flatten();
            let sent = answer
                .send(ProbeResult {
                    at: question.at,
                    purpose: question.purpose,
                    pick,
                    object,
                    assets: question.assets,
                })
                .is_ok();
            ctx.request_repaint();
            sent
        };
        let prepared = match prepared {
            Ok(prepared) => prepared,
            Err(error) => {
                if !reply(question, Err(error)) {
                    return;
                }
                continue;
            }
        };
        let range = assets.volume.range;
        let mut current = Some(question);
        while let Some(question) = current.take() {
            let [u, v] = question.at;
            let found =
                std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| pick::at(&prepared, range, u, v)));
            if !reply(question, found.map_err(|_| fault())) {
                return;
            }
            match questions.recv() {
                Ok(Some(q))
                    if Arc::ptr_eq(&q.assets, &assets)
                        && (Arc::ptr_eq(&q.scene, &scene) || q.scene == scene) =>
                {
                    current = Some(q)
                }
                Ok(q) => next = q,
                Err(_) => return,
            }
        }
    }
}
