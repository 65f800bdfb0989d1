//! SVG elements that all plots share, and escaped text.

/// Width of a plot, in its own units; a page may scale it.
pub(super) const WIDTH: f64 = 640.0;
/// Margins to the left, to the right (for the legend), above and below.
pub(super) const LEFT: f64 = 66.0;
pub(super) const RIGHT: f64 = 150.0;
pub(super) const TOP: f64 = 30.0;
pub(super) const BOTTOM: f64 = 48.0;
/// Approximate width of a character in the plots' font size.
pub(super) const CHARACTER: f64 = 6.3;
/// Number of colours for curves and parts of bars.
pub(super) const COLORS: usize = 10;

/// The opening tag of a plot of this height, and its title.
pub(super) fn opening_tag(title: &str, height: f64) -> String {
    let title = escaped(title);
    format!(
        "<svg class=\"plot\" viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" aria-label=\"{title}\">\
         <text x=\"0\" y=\"14\" font-weight=\"600\">{title}</text>"
    )
}

/// The attribute that dashes a line; empty for a solid line.
pub(super) fn dash(dashed: bool) -> &'static str {
    if dashed { " stroke-dasharray=\"6 4\"" } else { "" }
}

/// A disc or a square, with its tooltip.
pub(super) fn dot(x: f64, y: f64, square: bool, tooltip: &str) -> String {
    let tooltip = if tooltip.is_empty() {
        String::new()
    } else {
        format!("<title>{}</title>", escaped(tooltip))
    };
    if square {
        return format!(
            "<rect class=\"dot\" x=\"{:.1}\" y=\"{:.1}\" width=\"8\" height=\"8\">{tooltip}</rect>",
            x - 4.0,
            y - 4.0
        );
    }
    format!("<circle class=\"dot\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\">{tooltip}</circle>")
}

/// Text escaped for HTML and XML, in an element or a quoted attribute.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            _ => out.push(c),
        }
    }
    out
}
