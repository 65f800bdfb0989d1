//! Saved and automatically saved scenes survive when the window is killed.

use super::HEAD;
use super::bench::{Bench, workstation};
use egui_kittest::kittest::Queryable;
use incise::engine::Backend;
use incise::gui::state::files::Dialog;
use incise::gui::state::session::Session;
use incise::scene::{Deformation, Scene};
use proptest::prelude::Rng as _;
use proptest::test_runner::{RngAlgorithm, TestRng};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Set in the child process that edits until it is killed: the folder for its scenes.
pub const CHILD: &str = "INCISE_TEST_EDITS_IN";

/// Run by the process to be killed: edits, saves and autosaves as fast as possible.
pub fn edit_until_killed() {
    let folder = PathBuf::from(std::env::var_os(CHILD).unwrap());
    let mut harness = workstation(&folder.join("home"), Some(Path::new(HEAD)), Backend::Cpu);
    while harness.state().doc.is_none() {
        harness.step();
    }
    let ctx = harness.ctx.clone();
    let file = folder.join("work.toml");
    println!("ready");
    for n in 0u32.. {
        let app = harness.state_mut();
        let doc = app.doc.as_mut().unwrap();
        if doc.scene.deformation.len() > 6 {
            doc.scene.deformation.clear();
        }
        let mut d = Deformation::new(["twist", "peel", "box", "pull"][n as usize % 4]);
        d.name = Some(format!("edit {n}"));
        doc.add(d);
        app.autosave();
        if n % 3 == 0 {
            app.save_to(&ctx, &file, None);
            // The next edit makes an automatic save necessary again.
        }
        harness.step();
    }
}

pub fn the_last_save_opens_after_a_crash() {
    let mut random = TestRng::from_seed(RngAlgorithm::ChaCha, &[7; 32]);
    let folder = tempfile::tempdir().unwrap();
    let (mut recovered, mut saved) = (0, 0);
    for _ in 0..20 {
        use std::io::BufRead;
        let program = std::env::current_exe().unwrap();
        let mut child = std::process::Command::new(program)
            .env(CHILD, folder.path())
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let mut ready = String::new();
        std::io::BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut ready)
            .unwrap();
        assert_eq!(ready.trim(), "ready");
        std::thread::sleep(Duration::from_micros(u64::from(random.next_u32() % 400_000)));
        child.kill().unwrap();
        child.wait().unwrap();
        let mut problems = Vec::new();
        let session = Session::open(Some(folder.path().join("home")), &mut problems);
        assert!(problems.is_empty(), "{problems:?}");
        for left in session.left_behind() {
            let scene = Scene::load(&left.file).unwrap_or_else(|e| panic!("{e}"));
            assert!(
                scene
                    .deformation
                    .iter()
                    .all(|d| d.name.as_ref().is_some_and(|n| n.starts_with("edit ")))
            );
            recovered += 1;
            session.discard(&left);
        }
        let work = folder.path().join("work.toml");
        if work.exists() {
            Scene::load(&work).unwrap_or_else(|e| panic!("{e}"));
            saved += 1;
        }
    }
    println!("killed 20 times: {recovered} automatic saves and {saved} saved scenes, all of which open");
    assert!(recovered >= 10, "{recovered}");
    // A new window offers it.
    let mut bench = loop {
        let program = std::env::current_exe().unwrap();
        let mut child = std::process::Command::new(program)
            .env(CHILD, folder.path())
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_secs(2));
        child.kill().unwrap();
        child.wait().unwrap();
        let mut bench = Bench {
            harness: workstation(&folder.path().join("home"), None, Backend::Cpu),
            folder: tempfile::tempdir().unwrap(),
        };
        bench.step();
        bench.step();
        // If the process was killed just after saving, there is nothing to recover.
        match bench.app().dialog {
            Some(Dialog::Recover(_)) => break bench,
            _ => assert!(
                bench.app().session.left_behind().is_empty(),
                "nothing was offered"
            ),
        }
    };
    bench.harness.get_all_by_label("Recover").next().unwrap().click();
    bench.settle();
    assert!(
        bench
            .app()
            .doc
            .as_ref()
            .is_some_and(|d| d.is_changed() && !d.scene.deformation.is_empty()),
        "{}",
        bench.app().log.text()
    );
}
