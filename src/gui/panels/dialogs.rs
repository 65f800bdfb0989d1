//! Questions and forms.

use super::rows::{ANTIALIAS, drop_down};
use crate::gui::state::Workstation;
use crate::gui::state::files::{ClipForm, ClipMotion, Dialog, NextStep, PictureForm};
use crate::picture::MAX_PICTURE_EDGE;
use eframe::egui::{self, Context, DragValue, Id, Modal, RichText, Slider, Ui};

/// The decision made in a dialog.
enum Decision {
    /// The dialog stays open.
    Open,
    /// The dialog closes.
    Close,
    /// The dialog closes, and an action follows.
    Do(DialogAction),
}

/// An action after a dialog.
type DialogAction = Box<dyn FnOnce(&mut Workstation, &Context)>;

fn then(f: impl FnOnce(&mut Workstation, &Context) + 'static) -> Decision {
    Decision::Do(Box::new(f))
}

impl Workstation {
    /// Shows the open dialog, and the file dialog over it.
    pub(in crate::gui) fn show_dialogs(&mut self, ctx: &Context) {
        self.show_files(ctx);
        let Some(mut dialog) = self.dialog.take() else {
            return;
        };
        let modal = Modal::new(Id::new("dialog")).show(ctx, |ui| {
            ui.set_max_width(430.0);
            match &mut dialog {
                Dialog::Unsaved(after) => self.unsaved(ui, after),
                Dialog::Recover(left) => recover(ui, left),
                Dialog::Picture(form) => picture(ui, form),
                Dialog::Clip(form) => self.clip(ui, form),
                Dialog::Locate { .. } => locate(ui, &dialog),
                Dialog::Second(path) => second(ui, path),
                Dialog::Running => running(ui),
                Dialog::SaveMap { name, stack } => save_map(ui, name, *stack),
            }
        });
        // A question about possible loss of work must be answered and cannot be dismissed.
        let must = matches!(dialog, Dialog::Unsaved(_) | Dialog::Recover(_));
        match modal.inner {
            Decision::Open if modal.should_close() && !must => {}
            Decision::Open => self.dialog = Some(dialog),
            Decision::Close => {}
            Decision::Do(f) => f(self, ctx),
        }
    }

    fn unsaved(&self, ui: &mut Ui, after: &NextStep) -> Decision {
        ui.heading("Unsaved changes");
        ui.label(format!(
            "{} has unsaved changes.",
            self.doc.as_ref().map_or("The scene", |d| &d.name)
        ));
        let mut decision = Decision::Open;
        let after = after.clone();
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            if ui.button("Save").clicked() {
                let after = after.clone();
                decision = then(move |app, ctx| app.save(ctx, Some(after)));
            }
            if ui.button("Discard").clicked() {
                let after = after.clone();
                decision = then(move |app, ctx| {
                    app.session.forget();
                    app.proceed(ctx, after);
                });
            }
            if ui.button("Cancel").clicked() {
                decision = Decision::Close;
            }
        });
        decision
    }

    fn clip(&self, ui: &mut Ui, form: &mut ClipForm) -> Decision {
        ui.heading("Export clip");
        let deformations = self.doc.as_ref().map_or(&[][..], |d| &d.scene.deformation);
        let named = |travel: &ClipMotion| match travel {
            ClipMotion::Orbit => "camera orbit (360°)".to_owned(),
            ClipMotion::Progress(n) => {
                format!(
                    "{} {}: progress",
                    n + 1,
                    deformations
                        .get(*n)
                        .map_or_else(String::new, crate::gui::state::document::Document::title_of)
                )
            }
            ClipMotion::Parameter(n, name) => {
                format!(
                    "{} {}: {name}",
                    n + 1,
                    deformations
                        .get(*n)
                        .map_or_else(String::new, crate::gui::state::document::Document::title_of)
                )
            }
        };
        let mut travels = vec![ClipMotion::Orbit];
        for (n, d) in deformations.iter().enumerate() {
            let kind = crate::gui::gizmos::kind_of(d);
            travels.push(ClipMotion::Progress(n));
            travels.extend(
                kind.iter()
                    .flat_map(|k| k.parameters)
                    .map(|p| ClipMotion::Parameter(n, p.name.to_owned())),
            );
        }
        egui::Grid::new("clip")
            .num_columns(2)
            .spacing([12.0, 6.0])
            .show(ui, |ui| {
                ui.label("Animate");
                egui::ComboBox::from_id_salt("travel")
                    .width(240.0)
                    .selected_text(named(&form.travel))
                    .show_ui(ui, |ui| {
                        for travel in travels {
                            let text = named(&travel);
                            if ui.selectable_label(form.travel == travel, text).clicked() {
                                form.back = travel != ClipMotion::Orbit;
                                if let (ClipMotion::Parameter(n, name), Some(doc)) = (&travel, &self.doc) {
                                    let d = &doc.scene.deformation[*n];
                                    if let Some(kind) = crate::gui::gizmos::kind_of(d)
                                        && let Some(p) = kind.parameters.iter().position(|p| p.name == name)
                                    {
                                        let size =
                                            crate::gui::gizmos::BoxPlacement::of(d, kind, &doc.bounds()).size;
                                        form.range = crate::gui::gizmos::parameter(d, kind, p, size).1;
                                    }
                                } else {
                                    form.range = [0.0, 1.0];
                                }
                                form.travel = travel;
                            }
                        }
                    });
                ui.end_row();
                if form.travel != ClipMotion::Orbit {
                    ui.label("Range");
                    ui.horizontal(|ui| {
                        let [a, b] = &mut form.range;
                        ui.add(DragValue::new(a).speed(0.01).max_decimals(3));
                        ui.add(DragValue::new(b).speed(0.01).max_decimals(3));
                        ui.checkbox(&mut form.back, "Back and forth");
                    });
                    ui.end_row();
                }
                ui.label("Frames");
                ui.horizontal(|ui| {
                    ui.add(DragValue::new(&mut form.frames).range(2..=2000));
                    ui.add(
                        DragValue::new(&mut form.rate)
                            .range(1.0..=60.0)
                            .suffix(" fps")
                            .max_decimals(0),
                    );
                });
                ui.end_row();
                size_row(ui, &mut form.size, 4096);
            });
        buttons(ui, "Choose file…", form.clone(), |app, form| {
            app.choose_clip_file(form)
        })
    }
}

fn size_row(ui: &mut Ui, size: &mut [u32; 2], most: u32) {
    ui.label("Size");
    ui.horizontal(|ui| {
        let [w, h] = size;
        ui.add(DragValue::new(w).range(16..=most).suffix(" px"));
        ui.label("×");
        ui.add(DragValue::new(h).range(16..=most).suffix(" px"));
    });
    ui.end_row();
}

fn buttons<T: 'static>(
    ui: &mut Ui,
    word: &str,
    form: T,
    f: impl FnOnce(&mut Workstation, T) + 'static,
) -> Decision {
    let mut decision = Decision::Open;
    ui.add_space(8.0);
    ui.horizontal(|ui| {
        if ui.button(word).clicked() {
            decision = then(move |app, _| f(app, form));
        } else if ui.button("Cancel").clicked() {
            decision = Decision::Close;
        }
    });
    decision
}

fn recover(ui: &mut Ui, left: &[crate::gui::state::session::Recovered]) -> Decision {
    ui.heading("Recover unsaved work");
    ui.label("incise quit unexpectedly with unsaved changes in these scenes:");
    let mut decision = Decision::Open;
    ui.add_space(6.0);
    for one in left {
        let name = one
            .original
            .as_ref()
            .and_then(|p| p.file_name())
            .map_or_else(|| "unsaved scene".into(), |n| n.to_string_lossy().into_owned());
        let ago = one
            .saved
            .and_then(|t| t.elapsed().ok())
            .map_or_else(String::new, |d| match d.as_secs() {
                s if s < 120 => format!(", {s} s ago"),
                s if s < 7200 => format!(", {} min ago", s / 60),
                s if s < 172_800 => format!(", {} h ago", s / 3600),
                s => format!(", {} days ago", s / 86_400),
            });
        ui.horizontal(|ui| {
            if ui.button("Recover").clicked() {
                let one = one.clone();
                decision = then(move |app, ctx| {
                    // Its file is retained until the recovered scene has an automatic save of its
                    // own.
                    app.after(ctx, NextStep::Recover(one.file, one.original));
                });
            }
            if ui.button("Discard").clicked() {
                let one = one.clone();
                decision = then(move |app, _| {
                    app.session.discard(&one);
                    let left = app.session.left_behind();
                    app.dialog = (!left.is_empty()).then_some(Dialog::Recover(left));
                });
            }
            ui.label(format!("{name}{ago}"));
        });
    }
    ui.add_space(6.0);
    if ui.button("Later").clicked() {
        decision = Decision::Close;
    }
    decision
}

fn picture(ui: &mut Ui, form: &mut PictureForm) -> Decision {
    ui.heading("Export picture");
    ui.horizontal_wrapped(|ui| {
        for (word, width) in [("HD", 1920), ("4K", 3840), ("8K", 7680)] {
            if ui.button(word).clicked() {
                let [w, h] = form.size;
                form.size = [
                    width,
                    ((f64::from(h) * f64::from(width) / f64::from(w.max(1))).round() as u32)
                        .clamp(16, MAX_PICTURE_EDGE),
                ];
            }
        }
    });
    egui::Grid::new("picture")
        .num_columns(2)
        .spacing([12.0, 6.0])
        .show(ui, |ui| {
            size_row(ui, &mut form.size, MAX_PICTURE_EDGE);
            ui.label("Anti-aliasing");
            drop_down(ui, "Anti-aliasing", &mut form.antialias, &ANTIALIAS);
            ui.end_row();
            ui.label("Step (voxels)");
            ui.add(
                Slider::new(&mut form.step, 0.1..=2.0)
                    .clamping(egui::SliderClamping::Edits)
                    .logarithmic(true)
                    .max_decimals(2),
            );
            ui.end_row();
            ui.label("Background");
            ui.checkbox(&mut form.transparent, "Transparent");
            ui.end_row();
        });
    buttons(ui, "Choose file…", form.clone(), |app, form| {
        app.choose_picture_file(form)
    })
}

fn running(ui: &mut Ui) -> Decision {
    ui.heading("Exports in progress");
    ui.label("If you close the window now, no files will be written.");
    let mut decision = Decision::Open;
    ui.add_space(8.0);
    ui.horizontal(|ui| {
        if ui.button("Cancel exports and close").clicked() {
            decision = then(|app, ctx| {
                app.tasks.iter().for_each(crate::gui::state::tasks::Task::cancel);
                app.end_tasks();
                app.after(ctx, NextStep::Quit);
            });
        } else if ui.button("Wait").clicked() {
            decision = Decision::Close;
        }
    });
    decision
}

fn locate(ui: &mut Ui, dialog: &Dialog) -> Decision {
    let Dialog::Locate { problem, .. } = dialog else {
        return Decision::Close;
    };
    ui.heading("A file is missing");
    ui.label(problem);
    ui.label(RichText::new("Other missing files in the same folder will be located too.").weak());
    let mut decision = Decision::Open;
    ui.add_space(8.0);
    ui.horizontal(|ui| {
        if ui.button("Locate…").clicked() {
            let dialog = dialog.clone();
            decision = then(move |app, _| app.choose_missing_file(dialog));
        } else if ui.button("Cancel").clicked() {
            decision = Decision::Close;
        }
    });
    decision
}

fn second(ui: &mut Ui, path: &std::path::Path) -> Decision {
    ui.heading("A second volume");
    let name = path.file_name().map_or_else(
        || path.display().to_string(),
        |n| n.to_string_lossy().into_owned(),
    );
    ui.label(format!("How should {name} be used?"));
    let mut decision = Decision::Open;
    ui.add_space(8.0);
    let path = path.to_owned();
    ui.horizontal_wrapped(|ui| {
        if ui.button("Open as a new scene").clicked() {
            let path = path.clone();
            decision = then(move |app, ctx| app.open(ctx, &path));
        } else if ui.button("Use as label map").clicked() {
            let path = path.clone();
            decision = then(move |app, _| app.set_labels(&path));
        } else if ui.button("Add as surface").clicked() {
            let path = path.clone();
            decision = then(move |app, ctx| app.add_surface_of(ctx, &path));
        } else if ui.button("Use as displacement field").clicked() {
            let path = path.clone();
            decision = then(move |app, _| app.add_field(&path));
        } else if ui.button("Cancel").clicked() {
            decision = Decision::Close;
        }
    });
    decision
}

fn save_map(ui: &mut Ui, name: &mut String, stack: bool) -> Decision {
    ui.heading("Save to the library");
    ui.horizontal(|ui| {
        ui.label("Name");
        let field = ui.add(egui::TextEdit::singleline(name).desired_width(240.0));
        field.widget_info(|| egui::WidgetInfo::text_edit(true, "", "", "Map name"));
    });
    let form = (name.clone(), stack);
    let mut decision = Decision::Open;
    ui.add_space(8.0);
    ui.horizontal(|ui| {
        if ui.button("Save to library").clicked() {
            decision = then(move |app, ctx| app.save_map(ctx, &form.0, form.1));
        } else if ui.button("Cancel").clicked() {
            decision = Decision::Close;
        }
    });
    decision
}
