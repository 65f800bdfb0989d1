//! Stacked bars on a linear axis.

use super::axis::{linear_ticks, number, tick_label};
use super::svg::{BOTTOM, CHARACTER, COLORS, RIGHT, TOP, WIDTH, escaped, opening_tag};
use std::fmt::Write;

/// Height of a bar with the gap below it.
const ROW: f64 = 22.0;
/// Room for the names of bars.
const NAMES: f64 = 190.0;
/// Parts that are below this fraction of the longest bar in every bar are merged into one.
const MIN_PART: f64 = 0.005;

/// One stacked bar.
#[derive(Clone, Debug)]
pub struct Bar {
    /// Label to the left of the bar.
    pub name: String,
    /// Its parts: index into the part names, and length.
    pub parts: Vec<(usize, f64)>,
}

impl Bar {
    /// Length of the whole bar.
    fn length(&self) -> f64 {
        self.parts
            .iter()
            .map(|p| p.1)
            .filter(|v| v.is_finite() && *v > 0.0)
            .sum::<f64>()
    }

    /// Length of part `n`.
    fn length_of(&self, n: usize) -> f64 {
        self.parts
            .iter()
            .filter(|p| p.0 == n && p.1.is_finite() && p.1 > 0.0)
            .map(|p| p.1)
            .sum::<f64>()
    }
}

/// The labels and layout of a bar plot. Positions and lengths are in SVG units unless stated.
struct BarLayout<'a> {
    /// Quantity and unit of the axis.
    label: &'a str,
    /// Names of all parts.
    parts: &'a [&'a str],
    /// Left end of the bars, right of their names.
    left: f64,
    /// Left end of the legend.
    right: f64,
    /// Height of all rows together.
    rows: f64,
    /// Height of the plot.
    height: f64,
    /// Length of the longest bar, in the unit of the axis.
    longest: f64,
    /// SVG units per unit of the axis.
    scale: f64,
    /// Indices of the parts that are shown, not merged into "other".
    shown_parts: Vec<usize>,
}

impl<'a> BarLayout<'a> {
    fn of(label: &'a str, parts: &'a [&'a str], bars: &[Bar]) -> Self {
        let longest = bars.iter().map(Bar::length).fold(0.0, f64::max);
        let longest = if longest > 0.0 { longest } else { 1.0 };
        let shown_parts: Vec<usize> = (0..parts.len())
            .filter(|n| bars.iter().any(|b| b.length_of(*n) >= MIN_PART * longest))
            .collect();
        let left = (bars.iter().map(|b| b.name.chars().count()).max().unwrap_or(0) as f64 * CHARACTER + 12.0)
            .clamp(60.0, NAMES);
        let longest_part = shown_parts
            .iter()
            .map(|n| parts[*n].chars().count())
            .max()
            .unwrap_or(0);
        let right = WIDTH - (longest_part as f64 * CHARACTER + 40.0).clamp(RIGHT, 0.4 * WIDTH);
        let rows = (bars.len() as f64 * ROW).max(18.0 * (shown_parts.len() + 1) as f64);
        let scale = (right - left) / (longest * 1.12);
        Self {
            label,
            parts,
            left,
            right,
            rows,
            height: TOP + rows + BOTTOM,
            longest,
            scale,
            shown_parts,
        }
    }
}

/// Stacked bars, one below the other, on a linear axis from 0. Parts that are short in every bar
/// are merged into one, "other".
pub fn bars(title: &str, label: &str, parts: &[&str], bars: &[Bar]) -> String {
    let layout = BarLayout::of(label, parts, bars);
    let BarLayout {
        left,
        right,
        rows,
        height,
        longest,
        scale,
        ..
    } = layout;
    let mut svg = opening_tag(title, height);
    for value in linear_ticks(longest) {
        let px = left + value * scale;
        let _ = write!(
            svg,
            "<path class=\"grid\" d=\"M{px:.1} {TOP}V{:.1}\"/>",
            TOP + rows
        );
        let _ = write!(
            svg,
            "<text x=\"{px:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            TOP + rows + 16.0,
            tick_label(value)
        );
    }
    let _ = write!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
        0.5 * (left + right),
        height - 10.0,
        escaped(label)
    );
    for (row, bar) in bars.iter().enumerate() {
        write_bar(&mut svg, &layout, row, bar);
    }
    write_legend(&mut svg, &layout);
    svg.push_str("</svg>\n");
    svg
}

/// Writes one bar, with its name and its total length.
fn write_bar(svg: &mut String, layout: &BarLayout, row: usize, bar: &Bar) {
    let BarLayout {
        label,
        parts,
        left,
        scale,
        shown_parts,
        ..
    } = layout;
    let top = TOP + row as f64 * ROW;
    let most = ((left - 8.0) / CHARACTER) as usize;
    let short: String = if bar.name.chars().count() > most {
        bar.name
            .chars()
            .take(most.saturating_sub(1))
            .chain(['…'])
            .collect()
    } else {
        bar.name.clone()
    };
    let _ = write!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
        left - 8.0,
        top + 14.0,
        escaped(&short)
    );
    let mut x = *left;
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
    for &n in shown_parts {
        part(format!("c{}", n % (COLORS - 1)), parts[n], bar.length_of(n));
    }
    let other: f64 = (0..parts.len())
        .filter(|n| !shown_parts.contains(n))
        .map(|n| bar.length_of(n))
        .sum();
    part(format!("c{}", COLORS - 1), "other", other);
    let _ = write!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
        x + 5.0,
        top + 14.0,
        number(bar.length())
    );
}

/// Writes the names of the parts with their colours.
fn write_legend(svg: &mut String, layout: &BarLayout) {
    let BarLayout {
        parts,
        right,
        shown_parts,
        ..
    } = layout;
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_are_as_long_as_their_parts() {
        let all = [
            Bar {
                name: "one".into(),
                parts: vec![(0, 30.0), (1, 10.0), (2, 0.01)],
            },
            Bar {
                name: "two".into(),
                parts: vec![(1, 80.0)],
            },
        ];
        let svg = bars("stages", "ms", &["draw", "read", "bind"], &all);
        let widths: Vec<f64> = svg
            .split(" width=\"")
            .skip(1)
            .filter_map(|p| p.split('"').next()?.parse().ok())
            .collect();
        assert!(
            (widths[0] / widths[1] - 3.0).abs() < 0.01 && (widths[3] / widths[1] - 8.0).abs() < 0.01,
            "{widths:?}"
        );
        assert!(
            svg.contains(">other</text>") && svg.contains(">draw</text>") && !svg.contains(">bind</text>")
        );
        assert!(svg.contains(">40.0</text>") && svg.contains(">80.0</text>"));
    }
}
