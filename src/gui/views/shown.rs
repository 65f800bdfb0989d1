//! Drawing a picture that may be out of date with the scene ([`crate::gui::state::shown`] tracks
//! this).
//!
//! Pictures arrive late, and some never arrive. Letters, cube, scale bar, handles and measurements
//! that are drawn over a picture, and every query about a position in it, use the scene from which
//! that picture was rendered. A picture that is out of date is dimmed, with the reason.

use crate::gui::state::shown::OutdatedNotice;
use crate::gui::theme::{CANVAS, ON_CANVAS};
use eframe::egui::{Align, Color32, FontId, Painter, Pos2, Rect, TextureHandle, pos2, vec2};

/// Below this width a view shows only that it is out of date, points.
const SMALL: f32 = 380.0;

impl OutdatedNotice {
    /// Dims a picture that is out of date.
    pub fn draw(&self, painter: &Painter, rect: Rect, there: bool) {
        let thickness = self.thickness();
        if there && thickness > 0.0 {
            let most = if self.failure.is_some() { 150.0 } else { 110.0 };
            painter.rect_filled(rect, 0.0, Color32::from_black_alpha((most * thickness) as u8));
        }
        if let Some(mut words) = self.words(there) {
            if there && rect.width() < SMALL {
                words = "Out of date".to_owned();
            }
            let color = ON_CANVAS.gamma_multiply(if there { thickness } else { 1.0 });
            boxed(painter, rect, &words, color);
        }
        if self.since.is_some() && self.failure.is_none() && thickness < 1.0 {
            painter.ctx().request_repaint_after_secs(0.1);
        }
    }
}

/// Draws a message in the centre of a view.
pub fn draw_message(painter: &Painter, rect: Rect, sentence: &str) {
    boxed(painter, rect, &crate::gui::text::capital(sentence), ON_CANVAS);
}

/// Lines of text on a dark box in the centre of a view.
fn boxed(painter: &Painter, rect: Rect, words: &str, color: Color32) {
    let width = (rect.width() - 60.0).clamp(60.0, 460.0);
    let mut job =
        eframe::egui::text::LayoutJob::simple(words.to_owned(), FontId::proportional(14.0), color, width);
    job.halign = Align::Center;
    let galley = painter.layout_job(job);
    let size = galley.rect.size();
    let middle = rect.center();
    let around = Rect::from_center_size(middle, size + vec2(24.0, 16.0));
    painter.rect_filled(
        around,
        5.0,
        CANVAS.gamma_multiply(f32::from(color.a()) / 255.0 * 0.9),
    );
    painter.galley(pos2(middle.x, middle.y - size.y / 2.0), galley, color);
}

/// Draws a texture into a rectangle.
pub fn image(painter: &Painter, texture: &TextureHandle, place: Rect) {
    painter.image(
        texture.id(),
        place,
        Rect::from_min_max(Pos2::ZERO, pos2(1.0, 1.0)),
        Color32::WHITE,
    );
}
