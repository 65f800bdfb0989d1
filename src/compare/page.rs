//! A comparison as one page: plots, tables, pictures, and a wipe between two of them.
//!
//! The page embeds its pictures and loads nothing else, so that it can be mailed, archived, and
//! opened offline.

use super::curves::{self, Curve, CurvePoint, EqualError, MIN_ERROR};
use super::explanation::explanation;
use super::plot::{self, Bar, Dot, PlotAxis, PlotSeries, escaped, number};
use super::report::{Encoded, Protocol, Report, VERSION};
use super::run::{Run, ViewKey, renderer_name, samples, stage_milliseconds};
use crate::scene::Mode;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;

impl Report {
    /// The page.
    pub(super) fn page(&self, pictures: &[Encoded], differences: &[Encoded], equal: &[EqualError]) -> String {
        let title = escaped(&self.title);
        let views = curves::views(&self.runs);
        let how_large = self.size().map_or_else(
            || "One scene".to_owned(),
            |[width, height]| format!("One scene, {width} × {height} pixels"),
        );
        let mut page = format!(
            "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
             <title>{title}</title>\n<style>{STYLE}{}</style>\n<h1>{title}</h1>\n\
             <p>{how_large}: every picture shows the same data, transfer function, lighting and deformations, and compared pictures share \
             the same view. incise {VERSION}.</p>\n",
            plot::STYLE
        );
        if let Some(protocol) = &self.protocol {
            page.push_str(&protocol_text(protocol));
        }
        page.push_str(&self.methods());
        if self.protocol.is_some() {
            page.push_str(&self.equal_table(equal, &views));
        }
        for shown in &views {
            page.push_str(&self.plots(shown, &views, equal));
        }
        let captions: Vec<String> = self
            .runs
            .iter()
            .map(|run| run.name.clone())
            .chain(self.pairs.iter().map(|pair| {
                format!(
                    "difference of {} and {}",
                    self.runs[pair.a].name, self.runs[pair.b].name
                )
            }))
            .map(|caption| escaped(&caption))
            .collect();
        // Pictures of different views or sizes cannot be overlaid.
        let frame_of = |run: &Run| {
            views
                .iter()
                .position(|v| v.camera == run.shown.camera && v.size == run.shown.size)
                .unwrap_or(0)
        };
        let frames: Vec<usize> = self
            .runs
            .iter()
            .map(frame_of)
            .chain(self.pairs.iter().map(|pair| frame_of(&self.runs[pair.a])))
            .collect();
        if captions.len() > 1 {
            let option = |(n, caption): (usize, &String)| {
                format!(
                    "<option value=\"picture-{n}\" data-frame=\"{}\">{caption}</option>",
                    frames[n]
                )
            };
            let options: String = captions.iter().enumerate().map(option).collect();
            page.push_str(&format!(
                "<section id=\"wipe\" hidden>\n<h2>Swipe comparison</h2>\n<p><label>Left <select id=\"left\">{options}</select></label> \
                 <label>Right <select id=\"right\">{options}</select></label></p>\n\
                 <div id=\"stack\"><img id=\"left-picture\" alt=\"\" draggable=\"false\"><img id=\"right-picture\" alt=\"\" draggable=\"false\">\
                 <div id=\"edge\"></div></div>\n\
                 <p><input id=\"at\" type=\"range\" min=\"0\" max=\"100\" step=\"0.1\" value=\"50\" \
                 aria-label=\"Position of the divider, percent\"></p>\n\
                 </section>\n"
            ));
        }
        page.push_str(&self.run_table());
        if !self.pairs.is_empty() {
            page.push_str(&self.pair_table());
        }
        page.push_str("<h2>Pictures</h2>\n<div class=\"pictures\">\n");
        for (n, (encoded, caption)) in pictures.iter().chain(differences).zip(&captions).enumerate() {
            page.push_str(&format!(
                "<figure><img id=\"picture-{n}\" alt=\"{caption}\" src=\"data:image/png;base64,{}\"><figcaption>{caption}</figcaption></figure>\n",
                STANDARD.encode(&encoded.png)
            ));
        }
        page.push_str("</div>\n");
        if !self.scene_toml.trim().is_empty() {
            page.push_str(&format!(
                "<details><summary>The scene</summary><pre>{}</pre></details>\n",
                escaped(&self.scene_toml)
            ));
        }
        page.push_str(&format!("<script>{SCRIPT}</script>\n</html>\n"));
        page
    }

    /// How each renderer works, and where differences come from.
    fn methods(&self) -> String {
        let mut seen = Vec::new();
        let mut rows = String::new();
        for run in &self.runs {
            let key = (run.renderer(), run.is_reference);
            if seen.contains(&key) || run.method.samples.is_empty() {
                continue;
            }
            seen.push(key);
            let m = &run.method;
            let name = renderer_name(run.renderer());
            let name = if run.is_reference {
                format!("reference ({name})")
            } else {
                name
            };
            rows.push_str(&format!("<tr><th>{}</th>", escaped(&name)));
            let slab = m.slab.map_or_else(|| "–".to_owned(), |n| n.to_string());
            for cell in [
                m.samples,
                m.order,
                &slab,
                m.blend_format,
                m.filter,
                m.map_filter,
                m.jacobian,
                m.light,
                m.early_stop,
            ] {
                rows.push_str(&format!("<td class=\"text\">{}</td>", escaped(cell)));
            }
            rows.push_str("</tr>\n");
        }
        if rows.is_empty() {
            return rows;
        }
        let reasons: String = explanation(&self.runs)
            .iter()
            .map(|reason| format!("{} ", escaped(reason)))
            .collect();
        format!(
            "<h2>Methods</h2>\n<div class=\"wide\"><table>\n<tr><th>Renderer</th><th>Samples</th><th>Composition</th><th>Slab</th>\
             <th>Blend format</th><th>Voxel filter</th><th>Map filter</th><th>Jacobians</th><th>Shading</th><th>Early termination</th></tr>\n{rows}</table></div>\n<p>{}</p>\n",
            reasons.trim_end()
        )
    }

    /// Plots of all runs of one view.
    fn plots(&self, shown: &ViewKey, views: &[ViewKey], equal: &[EqualError]) -> String {
        let curves = curves::curves(&self.runs, shown);
        let runs: Vec<&Run> = self
            .runs
            .iter()
            .filter(|run| run.shown == *shown && !run.is_reference)
            .collect();
        if runs.len() < 2 {
            return String::new();
        }
        let mut steps: Vec<f64> = runs.iter().map(|run| f64::from(run.step)).collect();
        steps.sort_by(f64::total_cmp);
        steps.dedup();
        let several = steps.len() > 1;
        let heading = if views.len() > 1 {
            format!("Plots: {shown}")
        } else {
            "Plots".to_owned()
        };
        let mut text = format!("<h2>{}</h2>\n<div class=\"plots\">\n", escaped(&heading));
        let series = |dot: &dyn Fn(&CurvePoint) -> Dot| -> Vec<PlotSeries> {
            let one = |c: &Curve| PlotSeries {
                name: renderer_name((c.mode, &c.backend, &c.variant)),
                color: color_of(c.mode, c.backend == "cpu"),
                dashed: c.backend != "cpu",
                dots: c.points.iter().map(dot).collect(),
            };
            curves.iter().map(one).collect()
        };
        let time = PlotAxis {
            label: "rendering, ms".to_owned(),
            ticks: Vec::new(),
        };
        let error = PlotAxis {
            label: "RMS error (0–255)".to_owned(),
            ticks: Vec::new(),
        };
        let has_errors = runs.iter().any(|run| run.error.is_some());
        if several {
            let step = PlotAxis {
                label: "step, voxels".to_owned(),
                ticks: if steps.len() <= 8 { steps } else { Vec::new() },
            };
            let by_step = series(&|p| Dot {
                x: p.step,
                y: p.milliseconds,
                spread: Some(p.spread),
            });
            text.push_str(&plot::curves("Time by step", &step, &time, &by_step, None));
            if has_errors {
                let or_nan = |error: f64| if error >= MIN_ERROR { error } else { f64::NAN };
                let errors = series(&|p| Dot {
                    x: p.step,
                    y: or_nan(p.error),
                    spread: None,
                });
                text.push_str(&plot::curves("Error by step", &step, &error, &errors, None));
                let common = equal.iter().find(|e| e.shown == *shown).map(|e| e.error);
                let both = series(&|p| Dot {
                    x: or_nan(p.error),
                    y: p.milliseconds,
                    spread: None,
                });
                text.push_str(&plot::curves(
                    "Time against error (lower left is better; dotted: the common error)",
                    &error,
                    &time,
                    &both,
                    common,
                ));
            }
        }
        let names = self.stage_names();
        let index = |name: &str| names.iter().position(|n| *n == name).unwrap_or(0);
        let plain_name = |run: &Run| {
            let step = if several {
                format!(" step {}", run.step)
            } else {
                String::new()
            };
            format!("{}{step}", renderer_name(run.renderer()))
        };
        let bar = |run: &&Run| Bar {
            name: plain_name(run),
            parts: run.stages.iter().map(|(name, ms)| (index(name), *ms)).collect(),
        };
        text.push_str(&plot::bars(
            "Time by stage",
            "ms",
            &names,
            &runs.iter().map(bar).collect::<Vec<_>>(),
        ));
        text.push_str("</div>\n");
        text
    }

    /// The cost of renderers at equal error, or why it cannot be given.
    fn equal_table(&self, equal: &[EqualError], views: &[ViewKey]) -> String {
        let mut text = String::from("<h2>Speed at equal error</h2>\n");
        let steps: std::collections::BTreeSet<u32> = self
            .runs
            .iter()
            .filter(|run| !run.is_reference)
            .map(|run| run.step.to_bits())
            .collect();
        if self.runs.iter().all(|run| run.error.is_none()) {
            return text + "<p>Not available: there is no reference to measure errors against.</p>\n";
        }
        if steps.len() < 2 {
            return text
                + "<p>Not available: errors at two or more steps are needed. Run again with, for example, <code>--steps 0.5,1,2</code>.</p>\n";
        }
        for shown in views {
            let Some(e) = equal.iter().find(|e| e.shown == *shown) else {
                text.push_str(&format!(
                    "<p>{}: not available; two or more renderers with overlapping error ranges are needed.</p>\n",
                    escaped(&shown.to_string())
                ));
                continue;
            };
            text.push_str(&format!(
                "<p>{}: at an RMS error of {} (of 255).</p>\n<div class=\"wide\"><table>\n\
                 <tr><th>Renderer</th><th>Rendering, ms</th><th>Step, voxels</th></tr>\n",
                escaped(&shown.to_string()),
                number(e.error)
            ));
            for entry in &e.entries {
                let cells = match (entry.at, entry.coarsest) {
                    (Some(p), _) => format!("<td>{}</td><td>{}</td>", number(p.milliseconds), number(p.step)),
                    (None, Some(p)) => format!(
                        "<td>less than {}</td><td>more than {}</td>",
                        number(p.milliseconds),
                        number(p.step)
                    ),
                    (None, None) => "<td>–</td><td>–</td>".to_owned(),
                };
                text.push_str(&format!(
                    "<tr><th>{}</th>{cells}</tr>\n",
                    escaped(&renderer_name((entry.mode, &entry.backend, &entry.variant)))
                ));
            }
            text.push_str("</table></div>\n");
        }
        text + "<p class=\"note\">The common error is the smallest error that every renderer reaches. Time and step are those of the fastest step with no \
                larger error, or interpolated between neighbouring steps on logarithmic axes; nothing is extrapolated. “Less than” means that the \
                coarsest step was already more accurate.</p>\n"
    }

    fn run_table(&self) -> String {
        let stages = self.stage_names();
        let mut table = String::from(
            "<h2>Cost</h2>\n<div class=\"wide\"><table>\n<tr><th>Run</th><th>Backend</th><th>Step, voxels</th><th>Time, ms</th><th>min to max</th>\
             <th>Rendering, ms</th><th>Mean error (0–255)</th><th>Largest</th><th>PSNR, dB</th><th>SSIM</th>\
             <th>Samples taken</th><th>Skipped</th><th>Terminated</th><th>Volume, MB</th><th>Gradients, MB</th><th>Maps, MB</th><th>Peak, MB</th>",
        );
        for stage in &stages {
            table.push_str(&format!("<th>{}, ms</th>", escaped(stage)));
        }
        table.push_str("</tr>\n");
        let cell = |text: Option<String>| format!("<td>{}</td>", text.unwrap_or_else(|| "–".to_owned()));
        let megabytes = |bytes: u64| format!("{:.1}", bytes as f64 / 1e6);
        for run in &self.runs {
            table.push_str(&format!(
                "<tr><th>{}</th><td class=\"text\">{}</td>",
                escaped(&run.name),
                escaped(&run.backend)
            ));
            table.push_str(&cell(Some(run.step.to_string())));
            table.push_str(&cell(Some(number(run.milliseconds.median))));
            table.push_str(&cell((run.repetitions > 1).then(|| {
                format!(
                    "{} – {}",
                    number(run.milliseconds.min),
                    number(run.milliseconds.max)
                )
            })));
            table.push_str(&cell(Some(number(run.rendering.median))));
            let error = run.error;
            table.push_str(&cell(error.map(|d| format!("{:.3}", d.mean))));
            table.push_str(&cell(error.map(|d| format!("{:.1}", d.max))));
            table.push_str(&cell(error.map(|d| decibels(d.psnr_db))));
            table.push_str(&cell(error.map(|d| format!("{:.5}", d.ssim))));
            for count in samples(run) {
                table.push_str(&cell(count.map(grouped)));
            }
            let memory = run.memory;
            for bytes in [
                memory.volume_bytes,
                memory.gradient_bytes,
                memory.map_bytes + memory.surface_bytes,
            ] {
                table.push_str(&cell(Some(megabytes(bytes))));
            }
            table.push_str(&cell(run.memory.peak_bytes.map(megabytes)));
            for stage in &stages {
                table.push_str(&cell(stage_milliseconds(run, stage).map(number)));
            }
            table.push_str("</tr>\n");
        }
        table.push_str(
            "</table></div>\n<p class=\"note\">Time is for one complete picture: preparing the scene (transfer function, maps, empty space) and rendering it; \
             rendering includes uploads and readback. Runs reuse whatever a second picture would reuse. Stages are those of \
             the median run. Errors are relative to the reference. Skipped samples lie in empty cells; terminated samples lie behind opaque ones. The \
             sizes of the volume and its gradients are those in the renderer's memory (GPU memory for a GPU); maps include surface distance fields; \
             the peak is the largest resident size of the process so far, so it never decreases. A dash means not \
             measured or not applicable.</p>\n",
        );
        table
    }

    fn pair_table(&self) -> String {
        let mut table = String::from(
            "<h2>Differences</h2>\n<div class=\"wide\"><table>\n<tr><th>Run</th><th>Run</th><th>Mean (0–255)</th><th>Largest (0–255)</th>\
             <th>PSNR, dB</th><th>SSIM</th></tr>\n",
        );
        for (n, pair) in self.pairs.iter().enumerate() {
            let d = pair.difference;
            table.push_str(&format!(
                "<tr><th>{}</th><th><a href=\"#picture-{}\">{}</a></th><td>{:.3}</td><td>{:.1}</td><td>{}</td><td>{:.5}</td></tr>\n",
                escaped(&self.runs[pair.a].name),
                self.runs.len() + n,
                escaped(&self.runs[pair.b].name),
                d.mean,
                d.max,
                decibels(d.psnr_db),
                d.ssim
            ));
        }
        table.push_str(&format!(
            "</table></div>\n<p class=\"note\">Mean, largest and PSNR are over premultiplied red, green, blue and alpha, without the background. SSIM: \
             Wang et al. 2004, 11 × 11 Gaussian window, luminance over black. Difference pictures show the largest difference of any channel, \
             amplified {} times: black is no difference, then violet, orange, pale yellow.</p>\n",
            self.amplify
        ));
        table
    }
}

/// Describes how the runs were made.
fn protocol_text(protocol: &Protocol) -> String {
    let mut text = String::from("<p>");
    text.push_str(&format!("{}. ", escaped(&protocol.cpu)));
    if let Some(gpu) = &protocol.gpu {
        text.push_str(&format!("GPU: {}. ", escaped(gpu)));
    }
    let times = if protocol.repeat == 1 {
        "Timed once".to_owned()
    } else {
        format!("Times are the median of {} runs", protocol.repeat)
    };
    text.push_str(&times);
    if protocol.gpu.is_some() {
        text.push_str(
            ", on the GPU after an untimed warm-up picture (volume upload and shader compilation); GPU sample counts come from a separate picture",
        );
    }
    text.push_str(". ");
    let first: f64 = protocol.first_preparation.iter().map(|s| s.1).sum();
    if first > 0.0 {
        let stages: Vec<String> = protocol
            .first_preparation
            .iter()
            .filter(|s| s.1 >= 0.05)
            .map(|(name, ms)| format!("{} {}", escaped(name), number(*ms)))
            .collect();
        text.push_str(&format!(
            "Preparing the scene for the first time took {} ms on the CPU ({}); later runs reuse the cached parts. ",
            number(first),
            stages.join(", ")
        ));
    }
    match protocol.reference_step {
        Some(step) => text.push_str(&format!(
            "Errors are relative to CPU references at a step of {step} voxels: ray casting for slicing and ray casting, and surface rendering for \
             surfaces, which show different content."
        )),
        None => text.push_str("No references were rendered."),
    }
    text.push_str(
        " The protocol follows Meissner, Huang, Bartz, Mueller and Crawfis, “A Practical Evaluation of Popular Volume Rendering Algorithms”, \
         2000: same optical model, same view, same transfer function.</p>\n",
    );
    if !protocol.notices.is_empty() {
        let items: String = protocol
            .notices
            .iter()
            .map(|n| format!("<li>{}</li>", escaped(n)))
            .collect();
        text.push_str(&format!("<ul class=\"note\">{items}</ul>\n"));
    }
    text
}

/// The colour index of a renderer's curves: a hue per mode, with a different lightness for the CPU
/// and for GPUs.
fn color_of(mode: Mode, cpu: bool) -> usize {
    let hue = match mode {
        Mode::Slice => 0,
        Mode::Raycast => 1,
        Mode::Surface => 2,
    };
    if cpu { hue } else { hue + 5 }
}

fn decibels(psnr_db: f64) -> String {
    if psnr_db.is_finite() {
        format!("{psnr_db:.2}")
    } else {
        "∞".to_owned()
    }
}

/// A count in groups of three digits, separated by non-breaking spaces.
fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut out = String::new();
    for (n, digit) in digits.chars().enumerate() {
        if n > 0 && (digits.len() - n).is_multiple_of(3) {
            out.push('\u{a0}');
        }
        out.push(digit);
    }
    out
}

/// Greys only: colour is left to the pictures and plots. Text has a contrast of at least 7 to 1 on
/// either background.
const STYLE: &str = "
:root{color-scheme:light dark;--page:#fff;--text:#1b1b1b;--quiet:#505050;--line:#c4c4c4}
@media (prefers-color-scheme:dark){:root{--page:#171717;--text:#e4e4e4;--quiet:#b4b4b4;--line:#484848}}
body{margin:2em;font:15px/1.45 system-ui,sans-serif;color:var(--text);background:var(--page)}
h1{font-size:1.5em;font-weight:600}h2{font-size:1.15em;font-weight:600;margin:1.8em 0 .5em}
.note,figcaption{color:var(--quiet);max-width:60em}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.25em .8em;border-bottom:1px solid var(--line);text-align:right;white-space:nowrap}
th,td.text{text-align:left;font-weight:600}td.text{font-weight:400}
img{display:block;max-width:100%;height:auto;background:repeating-conic-gradient(#777 0 25%,#999 0 50%) 0 0/16px 16px}
.pictures{display:flex;flex-wrap:wrap;gap:1.5em}
figure{margin:0;max-width:100%}figcaption{margin-top:.3em}
#stack{position:relative;width:fit-content;max-width:100%;touch-action:pan-y;cursor:ew-resize;user-select:none}
#right-picture{position:absolute;inset:0;width:100%;height:100%}
#edge{position:absolute;top:0;bottom:0;width:2px;margin-left:-1px;background:#fff;outline:1px solid #000;pointer-events:none}
#at{width:100%;max-width:40em}
select{font:inherit;color:inherit;background:var(--page);border:1px solid var(--quiet);padding:.15em}
.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(34em,100%),1fr));gap:.5em 2em;max-width:110em}
a{color:inherit}code{font-size:.95em}
pre{overflow-x:auto;padding:1em;border:1px solid var(--line)}summary{margin-top:1.8em;cursor:pointer}
";

/// The wipe refers to the page's pictures by their ids, so that the page holds each once.
const SCRIPT: &str = "
(() => {
  const byId = id => document.getElementById(id);
  const wipe = byId('wipe');
  if (!wipe) return;
  const stack = byId('stack'), at = byId('at');
  const sides = ['left', 'right'].map(side => ({ select: byId(side), picture: byId(side + '-picture') }));
  const frame = select => select.selectedOptions[0].dataset.frame;
  const choose = () => {
    // On the right only what lies over the picture on the left.
    const right = sides[1].select, wanted = frame(sides[0].select);
    [...right.options].forEach(o => o.hidden = o.disabled = o.dataset.frame !== wanted);
    if (frame(right) !== wanted) right.selectedIndex = [...right.options].findIndex(o => !o.disabled);
    sides.forEach(show);
  };
  const show = ({ select, picture }) => {
    const from = byId(select.value);
    picture.src = from.src;
    picture.alt = from.alt;
  };
  const move = () => {
    const x = Number(at.value);
    sides[0].picture.style.clipPath = 'inset(0 ' + (100 - x) + '% 0 0)';
    sides[1].picture.style.clipPath = 'inset(0 0 0 ' + x + '%)';
    byId('edge').style.left = x + '%';
  };
  const drag = event => {
    if (!(event.buttons & 1)) return;
    const box = stack.getBoundingClientRect();
    at.value = 100 * (event.clientX - box.left) / box.width;
    move();
  };
  sides[1].select.selectedIndex = 1;
  sides.forEach(({ select }) => select.addEventListener('change', choose));
  at.addEventListener('input', move);
  stack.addEventListener('pointerdown', event => { stack.setPointerCapture(event.pointerId); drag(event); });
  stack.addEventListener('pointermove', drag);
  choose();
  move();
  wipe.hidden = false;
})();
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_grouped() {
        assert_eq!(
            [7, 1_000, 1_234_567].map(grouped),
            ["7", "1\u{a0}000", "1\u{a0}234\u{a0}567"]
        );
    }
}
