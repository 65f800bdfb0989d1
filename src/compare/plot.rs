//! Plots as SVG, embedded in the page: curves over one or two logarithmic axes, and stacked bars.
//!
//! *Theory*: cost and error of a renderer are powers of its step, so that on two logarithmic axes a
//! curve is nearly straight and its slope is the order of convergence. Lengths on a logarithmic
//! axis are meaningless, so bars use a linear one.
//!
//! *How to call it*: [`curves`] and [`bars`] return one `<svg>` each, for a page that includes
//! [`STYLE`]. Series differ by shape and dash as well as by colour, and text has the page's colour,
//! so that a plot is readable in light, in dark, and without colours. Values that an axis cannot
//! show (not finite; not positive on a logarithmic one) are left out.

mod axis;
mod bar;
mod svg;

pub use axis::{number, tick_label, ticks};
pub use bar::{Bar, bars};
pub use svg::escaped;

use axis::{Span, is_shown};
use std::fmt::Write;
use svg::{BOTTOM, COLORS, LEFT, RIGHT, TOP, WIDTH, dash, dot, opening_tag};

/// Height of a plot of curves.
const HEIGHT: f64 = 330.0;

/// Colours on light and on dark, adjacent ones distinguishable with every kind of colour vision
/// (after Okabe and Ito, "Color Universal Design", 2008).
pub const STYLE: &str = "
.plot{display:block;width:100%;max-width:52em;height:auto;margin:.4em 0;font:12px system-ui,sans-serif}
.plot text{fill:var(--text)}.plot .grid{stroke:var(--line);stroke-width:1;fill:none}
.plot .frame{stroke:var(--quiet);fill:none}.plot .mark{stroke:var(--quiet);stroke-dasharray:2 3;fill:none}
.plot .curve{stroke:var(--c);stroke-width:2;fill:none}.plot .dot{fill:var(--c);stroke:var(--page)}.plot .part{fill:var(--c)}
.plot .spread{stroke:var(--c);stroke-width:1}
.c0{--c:#0072b2}.c1{--c:#c44e00}.c2{--c:#007f5c}.c3{--c:#a8477f}.c4{--c:#7a6a00}
.c5{--c:#3a9ad9}.c6{--c:#e08a2e}.c7{--c:#33a880}.c8{--c:#d38ab5}.c9{--c:#8a8a8a}
@media (prefers-color-scheme:dark){
.c0{--c:#56a9e8}.c1{--c:#f08a45}.c2{--c:#2fc597}.c3{--c:#e08fbd}.c4{--c:#d9c53a}
.c5{--c:#2f6f9f}.c6{--c:#a85f1c}.c7{--c:#1f7d5c}.c8{--c:#95557a}.c9{--c:#9a9a9a}}
";

/// One axis of a plot of curves, logarithmic.
#[derive(Clone, Debug, Default)]
pub struct PlotAxis {
    /// Quantity and unit.
    pub label: String,
    /// Tick positions; round numbers if empty.
    pub ticks: Vec<f64>,
}

/// A point of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dot {
    /// Along the horizontal axis.
    pub x: f64,
    /// Along the vertical axis.
    pub y: f64,
    /// Least and greatest measured y, if there were several.
    pub spread: Option<[f64; 2]>,
}

impl Dot {
    fn is_shown(&self) -> bool {
        is_shown(self.x) && is_shown(self.y)
    }
}

/// A curve with its name.
#[derive(Clone, Debug)]
pub struct PlotSeries {
    /// Label in the legend.
    pub name: String,
    /// Colour index, from 0; colours repeat.
    pub color: usize,
    /// Drawn with dashes and squares instead of solid lines and discs.
    pub dashed: bool,
    /// Its points, in order.
    pub dots: Vec<Dot>,
}

/// Right and bottom edges of the frame around curves, in SVG units.
const FRAME_RIGHT: f64 = WIDTH - RIGHT;
const FRAME_BOTTOM: f64 = HEIGHT - BOTTOM;

/// The ranges of the two axes of a plot of curves.
struct PlotSpans {
    across: Span,
    upwards: Span,
}

impl PlotSpans {
    /// Ranges that contain every dot and spread that can be shown, and the mark.
    fn around(series: &[PlotSeries], mark: Option<f64>) -> Self {
        let dots = || series.iter().flat_map(|s| &s.dots).filter(|d| d.is_shown());
        let ends = dots()
            .flat_map(|d| d.spread.unwrap_or([d.y; 2]))
            .filter(|v| is_shown(*v));
        Self {
            across: Span::around(dots().map(|d| d.x).chain(mark)),
            upwards: Span::around(dots().map(|d| d.y).chain(ends)),
        }
    }

    /// Horizontal position of a value, in SVG units.
    fn x(&self, value: f64) -> f64 {
        LEFT + self.across.share(value) * (FRAME_RIGHT - LEFT)
    }

    /// Vertical position of a value, in SVG units.
    fn y(&self, value: f64) -> f64 {
        FRAME_BOTTOM - self.upwards.share(value) * (FRAME_BOTTOM - TOP)
    }
}

/// A plot of curves over two logarithmic axes; `mark` is a dotted line at a value of x.
pub fn curves(title: &str, x: &PlotAxis, y: &PlotAxis, series: &[PlotSeries], mark: Option<f64>) -> String {
    let mark = mark.filter(|m| is_shown(*m));
    let spans = PlotSpans::around(series, mark);
    let mut svg = opening_tag(title, HEIGHT);
    write_axes(&mut svg, &spans, x, y);
    if let Some(m) = mark {
        let _ = write!(
            svg,
            "<path class=\"mark\" d=\"M{:.1} {TOP}V{FRAME_BOTTOM}\"/>",
            spans.x(m)
        );
    }
    for (n, s) in series.iter().enumerate() {
        let _ = write!(svg, "<g class=\"c{}\">", s.color % COLORS);
        write_curve(&mut svg, &spans, x, y, s);
        let (lx, ly) = (FRAME_RIGHT + 14.0, TOP + 8.0 + 18.0 * n as f64);
        let _ = write!(
            svg,
            "<path class=\"curve\"{} d=\"M{lx} {ly}h26\"/>{}",
            dash(s.dashed),
            dot(lx + 13.0, ly, s.dashed, "")
        );
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\">{}</text></g>",
            lx + 32.0,
            ly + 4.0,
            escaped(&s.name)
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// Writes the frame, and the ticks and the label of both axes.
fn write_axes(svg: &mut String, spans: &PlotSpans, x: &PlotAxis, y: &PlotAxis) {
    for value in ticks_of(x, &spans.across) {
        let px = spans.x(value);
        let _ = write!(svg, "<path class=\"grid\" d=\"M{px:.1} {TOP}V{FRAME_BOTTOM}\"/>");
        let _ = write!(
            svg,
            "<text x=\"{px:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            FRAME_BOTTOM + 16.0,
            tick_label(value)
        );
    }
    for value in ticks_of(y, &spans.upwards) {
        let py = spans.y(value);
        let _ = write!(svg, "<path class=\"grid\" d=\"M{LEFT} {py:.1}H{FRAME_RIGHT}\"/>");
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LEFT - 7.0,
            py + 4.0,
            tick_label(value)
        );
    }
    let _ = write!(
        svg,
        "<path class=\"frame\" d=\"M{LEFT} {TOP}V{FRAME_BOTTOM}H{FRAME_RIGHT}\"/>"
    );
    let middle = [0.5 * (LEFT + FRAME_RIGHT), 0.5 * (TOP + FRAME_BOTTOM)];
    let _ = write!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
        middle[0],
        HEIGHT - 10.0,
        escaped(&x.label)
    );
    let _ = write!(
        svg,
        "<text transform=\"translate(15 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        middle[1],
        escaped(&y.label)
    );
}

/// Writes the line of a series, and its dots with their spreads and tooltips.
fn write_curve(svg: &mut String, spans: &PlotSpans, x: &PlotAxis, y: &PlotAxis, s: &PlotSeries) {
    // A dot that cannot be shown interrupts the line.
    for stretch in s
        .dots
        .split(|d| !d.is_shown())
        .filter(|stretch| stretch.len() > 1)
    {
        let path: Vec<String> = stretch
            .iter()
            .map(|d| format!("{:.1} {:.1}", spans.x(d.x), spans.y(d.y)))
            .collect();
        let _ = write!(
            svg,
            "<path class=\"curve\"{} d=\"M{}\"/>",
            dash(s.dashed),
            path.join("L")
        );
    }
    for d in s.dots.iter().filter(|d| d.is_shown()) {
        let [px, py] = [spans.x(d.x), spans.y(d.y)];
        if let Some(spread) = d.spread.filter(|s| s.iter().all(|v| is_shown(*v))) {
            let [low, high] = spread.map(|y| spans.y(y));
            let _ = write!(svg, "<path class=\"spread\" d=\"M{px:.1} {low:.1}V{high:.1}\"/>");
        }
        let tooltip = format!(
            "{}: {} {}, {} {}",
            s.name,
            number(d.x),
            x.label,
            number(d.y),
            y.label
        );
        svg.push_str(&dot(px, py, s.dashed, &tooltip));
    }
}

/// The ticks set for an axis, or round ones.
fn ticks_of(axis: &PlotAxis, span: &Span) -> Vec<f64> {
    if axis.ticks.is_empty() {
        return ticks(span.low, span.high);
    }
    axis.ticks
        .iter()
        .copied()
        .filter(|v| *v >= span.low && *v <= span.high)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_is_a_straight_line() {
        let dots: Vec<Dot> = [1.0, 10.0, 100.0]
            .map(|x| Dot {
                x,
                y: 5.0 * x * x,
                spread: None,
            })
            .into();
        let series = PlotSeries {
            name: "a < b".into(),
            color: 3,
            dashed: false,
            dots,
        };
        let svg = curves(
            "t",
            &PlotAxis::default(),
            &PlotAxis::default(),
            std::slice::from_ref(&series),
            Some(10.0),
        );
        let path = svg
            .split("class=\"curve\" d=\"M")
            .nth(1)
            .and_then(|p| p.split('"').next())
            .unwrap_or_default()
            .to_owned();
        let at: Vec<Vec<f64>> = path
            .split('L')
            .map(|p| p.split(' ').filter_map(|v| v.parse().ok()).collect())
            .collect();
        assert!(
            at.len() == 3
                && (at[2][0] - 2.0 * at[1][0] + at[0][0]).abs() < 0.3
                && (at[2][1] - 2.0 * at[1][1] + at[0][1]).abs() < 0.3,
            "{at:?}"
        );
        assert!(at[0][1] > at[2][1], "upwards is more");
        assert!(
            svg.contains("a &lt; b")
                && !svg.contains("a < b")
                && svg.contains("class=\"mark\"")
                && svg.contains("class=\"c3\"")
        );
        assert_eq!(svg.matches("<svg").count(), svg.matches("</svg>").count());
    }

    #[test]
    fn what_cannot_be_shown_is_left_out() {
        let dot = |x: f64, y: f64| Dot {
            x,
            y,
            spread: Some([0.0, f64::NAN]),
        };
        let dots = vec![
            dot(1.0, 0.0),
            dot(f64::NAN, 1.0),
            dot(2.0, f64::INFINITY),
            dot(-1.0, 3.0),
            dot(1.0, 4.0),
        ];
        let series = [PlotSeries {
            name: String::new(),
            color: 99,
            dashed: true,
            dots,
        }];
        let svg = curves(
            "",
            &PlotAxis::default(),
            &PlotAxis::default(),
            &series,
            Some(f64::NAN),
        );
        assert!(
            !svg.contains("NaN") && !svg.contains("inf") && svg.matches("class=\"dot\"").count() == 2,
            "{svg}"
        );
        let none = curves("", &PlotAxis::default(), &PlotAxis::default(), &[], None);
        assert!(!none.contains("NaN") && !none.contains("inf"));
        let svg = bars(
            "",
            "ms",
            &["a"],
            &[Bar {
                name: "x".into(),
                parts: vec![(0, f64::NAN), (0, -1.0)],
            }],
        );
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }

    #[test]
    fn a_gap_breaks_the_line() {
        let dots: Vec<Dot> = [1.0, 2.0, f64::NAN, 4.0, 5.0, 6.0]
            .map(|y| Dot {
                x: y.max(3.0),
                y,
                spread: None,
            })
            .into();
        let svg = curves(
            "",
            &PlotAxis::default(),
            &PlotAxis::default(),
            &[PlotSeries {
                name: String::new(),
                color: 0,
                dashed: false,
                dots,
            }],
            None,
        );
        // Two line segments, and the sample in the legend.
        assert_eq!(
            (
                svg.matches("class=\"curve\"").count(),
                svg.matches("class=\"dot\"").count()
            ),
            (2 + 1, 5 + 1)
        );
    }
}
