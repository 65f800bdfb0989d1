//! Rendering the two sides of a comparison, and their difference.

use super::state::Workstation;
use super::state::comparison::{AMPLIFY, REST};
use super::state::worker::{JobKind, JobTarget, RenderedView};
use crate::compare::{difference, difference_picture};
use crate::engine::Quality;
use crate::prepare::Assets;
use crate::scene::Scene;
use eframe::egui::{ColorImage, Context, TextureOptions};
use std::sync::Arc;
use std::time::Instant;

impl Workstation {
    pub(in crate::gui) fn compare_arrived(
        &mut self,
        ctx: &Context,
        side: usize,
        serial: u64,
        ms: f64,
        shown: RenderedView,
    ) {
        let panel = &mut self.compare;
        if panel.serials.get(side) != Some(&serial) {
            return;
        }
        let result = &mut panel.results[side];
        match &mut result.texture {
            Some(texture) => texture.set(shown.image, TextureOptions::LINEAR),
            None => {
                result.texture =
                    Some(ctx.load_texture(format!("compare {side}"), shown.image, TextureOptions::LINEAR))
            }
        }
        result.picture = shown.picture.map(Arc::new);
        result.side = panel.requested_sides[side];
        result.delay.note(true);
        (result.stats, result.ms, result.backend, result.serial) =
            (shown.stats, ms, shown.device.name, serial);
        self.compare_numbers(ctx);
    }

    /// Computes the difference of the pair on another thread: it takes about as long as a frame.
    fn compare_numbers(&mut self, ctx: &Context) {
        let panel = &mut self.compare;
        let pair = (panel.results[0].serial, panel.results[1].serial);
        let current = (0..2).all(|n| panel.results[n].serial == panel.serials[n]);
        let (Some(a), Some(b)) = (panel.results[0].picture.clone(), panel.results[1].picture.clone()) else {
            return;
        };
        if panel.difference_open
            || pair == panel.difference_of
            || !current
            || (a.width, a.height) != (b.width, b.height)
        {
            return;
        }
        panel.difference_open = true;
        self.start(ctx, "Comparing", move |_| {
            let found =
                difference(&a, &b).and_then(|numbers| Ok((numbers, difference_picture(&a, &b, AMPLIFY)?)));
            Ok(Box::new(move |app: &mut Workstation, ctx: &Context| {
                let panel = &mut app.compare;
                panel.difference_open = false;
                panel.difference_of = pair;
                match found {
                    Ok((numbers, picture)) => {
                        let size = [picture.width as usize, picture.height as usize];
                        let image =
                            ColorImage::from_rgba_unmultiplied(size, &picture.over([0.0, 0.0, 0.0, 1.0]));
                        panel.difference = Some(numbers);
                        panel.difference_texture =
                            Some(ctx.load_texture("difference", image, TextureOptions::LINEAR));
                    }
                    Err(error) => {
                        panel.difference = None;
                        app.report_error(&error);
                    }
                }
                app.compare_numbers(ctx);
            }))
        });
    }

    /// Requests the pair once the scene is at rest.
    pub(in crate::gui) fn refresh_compare(&mut self) {
        if !std::mem::take(&mut self.compare.was_drawn) || self.compare.pane[0] < 16 {
            return;
        }
        let Some(doc) = &self.doc else { return };
        let assets: Arc<Assets> = doc.assets.clone();
        let mut scene = doc.shown(self.shows_undeformed());
        scene.render.size = self.compare.pane;
        scene.measure.clear();
        let panel = &mut self.compare;
        let same_assets = panel.assets.as_ref().is_some_and(|a| Arc::ptr_eq(a, &assets));
        let wanted: [Scene; 2] = std::array::from_fn(|n| panel.sides[n].scene(&scene));
        let changed =
            (0..2).any(|n| !same_assets || panel.requested[n].as_deref().is_none_or(|a| *a != wanted[n]));
        panel.behind = changed;
        if !changed {
            return;
        }
        let pending: Vec<usize> = (0..2)
            .filter(|n| !same_assets || panel.requested[*n].as_deref().is_none_or(|a| *a != wanted[*n]))
            .collect();
        // During a drag the last pair is kept.
        if self.gesture.is_some() {
            self.compare.changed_at = Instant::now();
            return;
        }
        if self.compare.changed_at.elapsed().as_secs_f64() < REST {
            return;
        }
        self.compare.assets = Some(assets.clone());
        self.compare.behind = false;
        for n in pending {
            let shared = Arc::new(wanted[n].clone());
            self.compare.requested[n] = Some(shared.clone());
            let serial = self.submit(
                JobTarget::Compare(n),
                shared,
                assets.clone(),
                JobKind::Picture {
                    counting: true,
                    with_pixels: true,
                    quality: Quality::Full,
                },
            );
            let panel = &mut self.compare;
            (
                panel.serials[n],
                panel.requested_sides[n],
                panel.results[n].delay.failure,
            ) = (serial, Some(panel.sides[n]), None);
        }
    }
}
