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

use std::fmt::Write;

/// Width of a plot, in its own units; a page may scale it.
const WIDTH: f64 = 640.0;
/// Height of a plot of curves.
const HEIGHT: f64 = 330.0;
/// Margins to the left, to the right (for the legend), above and below.
const LEFT: f64 = 66.0;
const RIGHT: f64 = 150.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 48.0;
/// Height of a bar with the gap below it.
const ROW: f64 = 22.0;
/// Room for the names of bars.
const NAMES: f64 = 190.0;
/// Approximate width of a character in the plots' font size.
const CHARACTER: f64 = 6.3;
/// Number of colours for curves and parts of bars.
const COLORS: usize = 10;
/// Margin between the data and the frame of a logarithmic axis, as a fraction of the data's extent.
const MARGIN: f64 = 0.08;
/// Parts that are below this fraction of the longest bar in every bar are merged into one.
const MIN_PART: f64 = 0.005;

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

/// One stacked bar.
#[derive(Clone, Debug)]
pub struct Bar {
    /// Label to the left of the bar.
    pub name: String,
    /// Its parts: index into the part names, and length.
    pub parts: Vec<(usize, f64)>,
}

/// A plot of curves over two logarithmic axes; `mark` is a dotted line at a value of x.
pub fn curves(title: &str, x: &PlotAxis, y: &PlotAxis, series: &[PlotSeries], mark: Option<f64>) -> String {
    let shown = |v: f64| v.is_finite() && v > 0.0;
    let dots = || series.iter().flat_map(|s| &s.dots).filter(|d| shown(d.x) && shown(d.y));
    let ends = dots().flat_map(|d| d.spread.unwrap_or([d.y; 2])).filter(|v| shown(*v));
    let across = Span::around(dots().map(|d| d.x).chain(mark.filter(|m| shown(*m))));
    let upwards = Span::around(dots().map(|d| d.y).chain(ends));
    let [right, bottom] = [WIDTH - RIGHT, HEIGHT - BOTTOM];
    let at = |d: &Dot| [LEFT + across.share(d.x) * (right - LEFT), bottom - upwards.share(d.y) * (bottom - TOP)];
    let mut svg = opening(title, HEIGHT);
    for value in ticks_of(x, &across) {
        let px = LEFT + across.share(value) * (right - LEFT);
        let _ = write!(svg, "<path class=\"grid\" d=\"M{px:.1} {TOP}V{bottom}\"/>");
        let _ = write!(svg, "<text x=\"{px:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>", bottom + 16.0, tick_label(value));
    }
    for value in ticks_of(y, &upwards) {
        let py = bottom - upwards.share(value) * (bottom - TOP);
        let _ = write!(svg, "<path class=\"grid\" d=\"M{LEFT} {py:.1}H{right}\"/>");
        let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>", LEFT - 7.0, py + 4.0, tick_label(value));
    }
    let _ = write!(svg, "<path class=\"frame\" d=\"M{LEFT} {TOP}V{bottom}H{right}\"/>");
    let middle = [0.5 * (LEFT + right), 0.5 * (TOP + bottom)];
    let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>", middle[0], HEIGHT - 10.0, escaped(&x.label));
    let _ = write!(svg, "<text transform=\"translate(15 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>", middle[1], escaped(&y.label));
    if let Some(m) = mark.filter(|m| shown(*m)) {
        let px = LEFT + across.share(m) * (right - LEFT);
        let _ = write!(svg, "<path class=\"mark\" d=\"M{px:.1} {TOP}V{bottom}\"/>");
    }
    for (n, s) in series.iter().enumerate() {
        let _ = write!(svg, "<g class=\"c{}\">", s.color % COLORS);
        // A dot that cannot be shown interrupts the line.
        for stretch in s.dots.split(|d| !(shown(d.x) && shown(d.y))).filter(|stretch| stretch.len() > 1) {
            let path: Vec<String> = stretch.iter().map(at).map(|[px, py]| format!("{px:.1} {py:.1}")).collect();
            let _ = write!(svg, "<path class=\"curve\"{} d=\"M{}\"/>", dash(s.dashed), path.join("L"));
        }
        for d in s.dots.iter().filter(|d| shown(d.x) && shown(d.y)) {
            let [px, py] = at(d);
            if let Some([least, most]) = d.spread.filter(|s| s.iter().all(|v| shown(*v))) {
                let [low, high] = [least, most].map(|y| at(&Dot { y, ..*d })[1]);
                let _ = write!(svg, "<path class=\"spread\" d=\"M{px:.1} {low:.1}V{high:.1}\"/>");
            }
            let tooltip = format!("{}: {} {}, {} {}", s.name, number(d.x), x.label, number(d.y), y.label);
            svg.push_str(&dot(px, py, s.dashed, &tooltip));
        }
        let (lx, ly) = (right + 14.0, TOP + 8.0 + 18.0 * n as f64);
        let _ = write!(svg, "<path class=\"curve\"{} d=\"M{lx} {ly}h26\"/>{}", dash(s.dashed), dot(lx + 13.0, ly, s.dashed, ""));
        let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\">{}</text></g>", lx + 32.0, ly + 4.0, escaped(&s.name));
    }
    svg.push_str("</svg>\n");
    svg
}

/// Stacked bars, one below the other, on a linear axis from 0. Parts that are short in every bar
/// are merged into one, "other".
pub fn bars(title: &str, label: &str, parts: &[&str], bars: &[Bar]) -> String {
    let length = |b: &Bar| b.parts.iter().map(|p| p.1).filter(|v| v.is_finite() && *v > 0.0).sum::<f64>();
    let longest = bars.iter().map(length).fold(0.0, f64::max);
    let longest = if longest > 0.0 { longest } else { 1.0 };
    let of_part = |b: &Bar, n: usize| b.parts.iter().filter(|p| p.0 == n && p.1.is_finite() && p.1 > 0.0).map(|p| p.1).sum::<f64>();
    let shown_parts: Vec<usize> = (0..parts.len()).filter(|n| bars.iter().any(|b| of_part(b, *n) >= MIN_PART * longest)).collect();
    let names = (bars.iter().map(|b| b.name.chars().count()).max().unwrap_or(0) as f64 * CHARACTER + 12.0).clamp(60.0, NAMES);
    let longest_part = shown_parts.iter().map(|n| parts[*n].chars().count()).max().unwrap_or(0);
    let right = WIDTH - (longest_part as f64 * CHARACTER + 40.0).clamp(RIGHT, 0.4 * WIDTH);
    let rows = (bars.len() as f64 * ROW).max(18.0 * (shown_parts.len() + 1) as f64);
    let height = TOP + rows + BOTTOM;
    let mut svg = opening(title, height);
    let scale = (right - names) / (longest * 1.12);
    for value in linear_ticks(longest) {
        let px = names + value * scale;
        let _ = write!(svg, "<path class=\"grid\" d=\"M{px:.1} {TOP}V{:.1}\"/>", TOP + rows);
        let _ = write!(svg, "<text x=\"{px:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>", TOP + rows + 16.0, tick_label(value));
    }
    let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>", 0.5 * (names + right), height - 10.0, escaped(label));
    for (row, bar) in bars.iter().enumerate() {
        let top = TOP + row as f64 * ROW;
        let most = ((names - 8.0) / CHARACTER) as usize;
        let short: String =
            if bar.name.chars().count() > most { bar.name.chars().take(most.saturating_sub(1)).chain(['…']).collect() } else { bar.name.clone() };
        let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>", names - 8.0, top + 14.0, escaped(&short));
        let mut x = names;
        let mut part = |color: String, name: &str, value: f64| {
            if value > 0.0 {
                let tooltip = escaped(&format!("{}, {name}: {} {label}", bar.name, number(value)));
                let wide = value * scale;
                let _ = write!(
                    svg,
                    "<g class=\"{color}\"><rect class=\"part\" x=\"{x:.2}\" y=\"{:.1}\" width=\"{wide:.2}\" height=\"{:.1}\"><title>{tooltip}</title></rect></g>",
                    top + 3.0,
                    ROW - 6.0
                );
                x += wide;
            }
        };
        for &n in &shown_parts {
            part(format!("c{}", n % (COLORS - 1)), parts[n], of_part(bar, n));
        }
        let other: f64 = (0..parts.len()).filter(|n| !shown_parts.contains(n)).map(|n| of_part(bar, n)).sum();
        part(format!("c{}", COLORS - 1), "other", other);
        let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\">{}</text>", x + 5.0, top + 14.0, number(length(bar)));
    }
    let legend = shown_parts.iter().map(|&n| (n % (COLORS - 1), parts[n]));
    let other = (shown_parts.len() < parts.len()).then_some((COLORS - 1, "other"));
    for (n, (color, name)) in legend.chain(other).enumerate() {
        let (x, y) = (right + 14.0, TOP + 18.0 * n as f64);
        let _ = write!(
            svg,
            "<g class=\"c{color}\"><rect class=\"part\" x=\"{x}\" y=\"{:.1}\" width=\"12\" height=\"12\"/><text x=\"{:.1}\" y=\"{:.1}\">{}</text></g>",
            y + 2.0,
            x + 18.0,
            y + 12.0,
            escaped(name)
        );
    }
    svg.push_str("</svg>\n");
    svg
}

fn opening(title: &str, height: f64) -> String {
    let title = escaped(title);
    format!(
        "<svg class=\"plot\" viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" aria-label=\"{title}\">\
         <text x=\"0\" y=\"14\" font-weight=\"600\">{title}</text>"
    )
}

fn dash(dashed: bool) -> &'static str {
    if dashed { " stroke-dasharray=\"6 4\"" } else { "" }
}

/// A disc or a square, with its tooltip.
fn dot(x: f64, y: f64, square: bool, tooltip: &str) -> String {
    let tooltip = if tooltip.is_empty() { String::new() } else { format!("<title>{}</title>", escaped(tooltip)) };
    if square {
        return format!("<rect class=\"dot\" x=\"{:.1}\" y=\"{:.1}\" width=\"8\" height=\"8\">{tooltip}</rect>", x - 4.0, y - 4.0);
    }
    format!("<circle class=\"dot\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\">{tooltip}</circle>")
}

/// The range of a logarithmic axis.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Span {
    low: f64,
    high: f64,
}

impl Span {
    /// Around positive values, with a margin; for a single value or none, a factor of two to either
    /// side.
    fn around(values: impl Iterator<Item = f64>) -> Self {
        let [low, high] = values.fold([f64::INFINITY, 0.0f64], |[low, high], v| [low.min(v), high.max(v)]);
        if low > high {
            return Self { low: 0.5, high: 2.0 };
        }
        let more = (high / low).powf(MARGIN).max(if high / low < 1.5 { 1.5 } else { 1.0 });
        Self { low: low / more, high: high * more }
    }

    /// Position of a value, 0 at the low end and 1 at the high end.
    fn share(&self, value: f64) -> f64 {
        (value / self.low).ln() / (self.high / self.low).ln()
    }
}

/// The ticks set for an axis, or round ones.
fn ticks_of(axis: &PlotAxis, span: &Span) -> Vec<f64> {
    if axis.ticks.is_empty() {
        return ticks(span.low, span.high);
    }
    axis.ticks.iter().copied().filter(|v| *v >= span.low && *v <= span.high).collect()
}

/// Round numbers within `low..high` on a logarithmic axis: about three to nine of them, rounder for
/// a wider range.
pub fn ticks(low: f64, high: f64) -> Vec<f64> {
    if !(low.is_finite() && high.is_finite() && low > 0.0 && high > low) {
        return Vec::new();
    }
    let decades = |mantissas: &[f64], every: i32| -> Vec<f64> {
        let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
        let powers = (first..=last).filter(|p| p.rem_euclid(every) == 0);
        powers.flat_map(|p| mantissas.iter().map(move |m| m * 10f64.powi(p))).filter(|v| *v >= low && *v <= high).collect()
    };
    let span = (high / low).log10();
    if span > 9.0 {
        return decades(&[1.0], (span / 5.0).ceil() as i32);
    }
    let choices: [&[f64]; 5] = [
        &[1.0],
        &[1.0, 3.0],
        &[1.0, 2.0, 5.0],
        &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0],
        &[1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0, 8.0, 9.0],
    ];
    let found = choices.into_iter().map(|m| decades(m, 1)).find(|t| t.len() >= 4);
    found.unwrap_or_else(|| {
        // Within a few percent no mantissa is round: linear steps.
        let step = round_step((high - low) / 4.0);
        let first = (low / step).ceil() as i64;
        (0..8).map(|n| (first + n) as f64 * step).filter(|v| *v >= low && *v <= high).collect()
    })
}

/// Round numbers from 0 to `longest` on a linear axis.
fn linear_ticks(longest: f64) -> Vec<f64> {
    let step = round_step(longest / 5.0);
    (0..=10).map(|n| f64::from(n) * step).filter(|v| *v <= longest * 1.05).collect()
}

/// The least of 1, 2 and 5 times a power of ten that is at least `step`.
fn round_step(step: f64) -> f64 {
    if !(step.is_finite() && step > 0.0) {
        return 1.0;
    }
    let power = 10f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|v| *v >= step * (1.0 - 1e-9)).unwrap_or(10.0 * power)
}

/// A tick's number: only as many digits as needed, thousands as k and millions as M.
pub fn tick_label(value: f64) -> String {
    let magnitude = value.abs();
    let (scaled, unit) = if magnitude >= 1e6 {
        (value / 1e6, "M")
    } else if magnitude >= 1e4 {
        (value / 1e3, "k")
    } else {
        (value, "")
    };
    if scaled != 0.0 && scaled.abs() < 1e-4 {
        return format!("{scaled:.0e}");
    }
    let text = format!("{:.*}", if scaled.abs() < 0.1 { 5 } else { 3 }, scaled);
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{unit}")
}

/// A measured number with three significant digits.
pub fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".to_owned() } else { "–".to_owned() };
    }
    let digits = 2 - value.abs().log10().floor() as i32;
    if digits > 7 { format!("{value:.2e}") } else { format!("{value:.*}", digits.max(0) as usize) }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(ticks(0.9, 1100.0), [1.0, 10.0, 100.0, 1000.0]);
        assert_eq!(ticks(0.9, 60.0), [1.0, 3.0, 10.0, 30.0]);
        assert_eq!(ticks(9.0, 52.0), [10.0, 15.0, 20.0, 30.0, 50.0]);
        for (low, high) in [(0.4, 2.3), (1e-9, 1e12), (99.0, 101.0), (3.0, 3.6), (1e-3, 2e-3), (17.0, 5e4)] {
            let t = ticks(low, high);
            assert!((2..=12).contains(&t.len()), "{low} to {high}: {t:?}");
            assert!(t.iter().all(|v| *v >= low && *v <= high) && t.windows(2).all(|w| w[0] < w[1]), "{low} to {high}: {t:?}");
        }
        for (low, high) in [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (1.0, f64::INFINITY)] {
            assert!(ticks(low, high).is_empty());
        }
        assert_eq!(linear_ticks(47.0), [0.0, 10.0, 20.0, 30.0, 40.0]);
        assert!(linear_ticks(f64::MIN_POSITIVE).len() < 12);
    }

    #[test]
    fn numbers_are_short() {
        let labels = [0.0, 0.5, 1.0, 0.0625, 150.0, 2000.0, 20_000.0, 3e6, 0.3 - 0.1, 2e-6].map(tick_label);
        assert_eq!(labels, ["0", "0.5", "1", "0.0625", "150", "2000", "20k", "3M", "0.2", "2e-6"]);
        assert_eq!([1234.5, 12.345, 0.012_345, 0.0].map(number), ["1234", "12.3", "0.0123", "0"]);
    }

    #[test]
    fn a_power_is_a_straight_line() {
        let dots: Vec<Dot> = [1.0, 10.0, 100.0].map(|x| Dot { x, y: 5.0 * x * x, spread: None }).into();
        let series = PlotSeries { name: "a < b".into(), color: 3, dashed: false, dots };
        let svg = curves("t", &PlotAxis::default(), &PlotAxis::default(), std::slice::from_ref(&series), Some(10.0));
        let path = svg.split("class=\"curve\" d=\"M").nth(1).and_then(|p| p.split('"').next()).unwrap_or_default().to_owned();
        let at: Vec<Vec<f64>> = path.split('L').map(|p| p.split(' ').filter_map(|v| v.parse().ok()).collect()).collect();
        assert!(at.len() == 3 && (at[2][0] - 2.0 * at[1][0] + at[0][0]).abs() < 0.3 && (at[2][1] - 2.0 * at[1][1] + at[0][1]).abs() < 0.3, "{at:?}");
        assert!(at[0][1] > at[2][1], "upwards is more");
        assert!(svg.contains("a &lt; b") && !svg.contains("a < b") && svg.contains("class=\"mark\"") && svg.contains("class=\"c3\""));
        assert_eq!(svg.matches("<svg").count(), svg.matches("</svg>").count());
    }

    #[test]
    fn what_cannot_be_shown_is_left_out() {
        let dot = |x: f64, y: f64| Dot { x, y, spread: Some([0.0, f64::NAN]) };
        let dots = vec![dot(1.0, 0.0), dot(f64::NAN, 1.0), dot(2.0, f64::INFINITY), dot(-1.0, 3.0), dot(1.0, 4.0)];
        let series = [PlotSeries { name: String::new(), color: 99, dashed: true, dots }];
        let svg = curves("", &PlotAxis::default(), &PlotAxis::default(), &series, Some(f64::NAN));
        assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.matches("class=\"dot\"").count() == 2, "{svg}");
        let none = curves("", &PlotAxis::default(), &PlotAxis::default(), &[], None);
        assert!(!none.contains("NaN") && !none.contains("inf"));
        let svg = bars("", "ms", &["a"], &[Bar { name: "x".into(), parts: vec![(0, f64::NAN), (0, -1.0)] }]);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }

    #[test]
    fn a_gap_breaks_the_line() {
        let dots: Vec<Dot> = [1.0, 2.0, f64::NAN, 4.0, 5.0, 6.0].map(|y| Dot { x: y.max(3.0), y, spread: None }).into();
        let svg = curves("", &PlotAxis::default(), &PlotAxis::default(), &[PlotSeries { name: String::new(), color: 0, dashed: false, dots }], None);
        // Two line segments, and the sample in the legend.
        assert_eq!((svg.matches("class=\"curve\"").count(), svg.matches("class=\"dot\"").count()), (2 + 1, 5 + 1));
    }

    #[test]
    fn bars_are_as_long_as_their_parts() {
        let all = [Bar { name: "one".into(), parts: vec![(0, 30.0), (1, 10.0), (2, 0.01)] }, Bar { name: "two".into(), parts: vec![(1, 80.0)] }];
        let svg = bars("stages", "ms", &["draw", "read", "bind"], &all);
        let widths: Vec<f64> = svg.split(" width=\"").skip(1).filter_map(|p| p.split('"').next()?.parse().ok()).collect();
        assert!((widths[0] / widths[1] - 3.0).abs() < 0.01 && (widths[3] / widths[1] - 8.0).abs() < 0.01, "{widths:?}");
        assert!(svg.contains(">other</text>") && svg.contains(">draw</text>") && !svg.contains(">bind</text>"));
        assert!(svg.contains(">40.0</text>") && svg.contains(">80.0</text>"));
    }
}
