//! Tears at the faces of a deformation's box are reported, with the face, the amount and a remedy
//! that works.

use incise::deform::Argument;
use incise::prepare::{Assets, Prepared};
use incise::scene::{Deformation, Scene, Size};

/// A deformation about the origin.
fn about_origin(kind: &str, size: f32, settings: &[(&str, Argument)]) -> Deformation {
    let mut d = Deformation::new(kind);
    (d.center, d.size) = (Some([0.0; 3]), Some(Size::Cube(size)));
    for (name, value) in settings {
        d.parameters.0.insert((*name).to_owned(), value.clone());
    }
    d
}

fn number(n: f64) -> Argument {
    Argument::Number(n as f32)
}

/// A face that tears, by how much, and the fade that mends it, mm.
type Torn = (&'static str, f32, Option<f32>);

/// The faces that tear, and the notices.
fn tears(deformations: &[Deformation]) -> (Vec<Torn>, Vec<String>) {
    let mut scene = Scene::of_volume("phantom:ball:size=64");
    scene.deformation = deformations.to_vec();
    let assets = Assets::load(&scene).unwrap();
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let found = prepared
        .tears
        .iter()
        .map(|t| (t.face, t.amount_mm, t.fade_mm))
        .collect();
    let notices = prepared
        .notices
        .iter()
        .filter(|n| n.contains("torn"))
        .cloned()
        .collect();
    (found, notices)
}

/// A shear moves the upper face of its box by the height times the tangent of its angle and leaves the
/// lower one; the ball, of radius 60 mm, reaches beyond a box of 60 mm; sheared, it stays within one
/// of 240 mm.
pub fn tears_have_their_amount() {
    let shear = |size: f32, fade: f64| {
        about_origin("shear", size, &[("angle", number(20.0)), ("fade", number(fade))])
    };
    let (found, notices) = tears(&[shear(60.0, 0.0)]);
    println!("{found:?} {notices:?}");
    let expected = 60.0 * 20f32.to_radians().tan();
    let amount = |face: &str| found.iter().find(|t| t.0 == face).map(|t| t.1);
    assert!(
        amount("+z face").is_some_and(|mm| (mm - expected).abs() < 0.01 * expected),
        "{found:?}"
    );
    assert_eq!(amount("-z face"), None);
    assert!(
        notices.len() == 1 && notices[0].contains("+z face (by up to 21.8 mm)"),
        "{notices:?}"
    );
    // The suggested fade mends it.
    let fade = found.iter().filter_map(|t| t.2).fold(0.0, f32::max);
    assert!(
        fade > 0.0 && notices[0].contains(&format!("fade = {fade}")),
        "{fade} {notices:?}"
    );
    assert!(tears(&[shear(60.0, f64::from(fade))]).0.is_empty());
    assert!(tears(&[shear(240.0, 0.0)]).0.is_empty());
}

/// What is not seen does not tear: behind a mask, in a cut, outside the body.
pub fn only_what_is_seen_tears() {
    let shear = about_origin("shear", 40.0, &[("angle", number(20.0))]);
    assert!(!tears(std::slice::from_ref(&shear)).0.is_empty());
    let removal = about_origin("box", 60.0, &[]);
    // A removal comes last, wherever it stands.
    assert!(tears(&[shear.clone(), removal.clone()]).0.is_empty());
    let mut away = shear;
    away.center = Some([0.0, 0.0, 75.0]);
    assert!(tears(&[away]).0.is_empty());
}

/// Round an axis the axis itself may tear, where no fade reaches; a kind with a setting `fade` of its
/// own is not told to use it.
pub fn remedies_can_be_followed() {
    let round = |kind: &str, settings: &[(&str, Argument)]| {
        let mut d = about_origin(kind, 110.0, settings);
        d.parameters.insert("mapping", "cylindrical");
        d
    };
    let (found, notices) = tears(&[round(
        "slab",
        &[("thickness", number(10.0)), ("gap", number(8.0))],
    )]);
    let axis = found
        .iter()
        .find(|t| t.0 == "axis")
        .unwrap_or_else(|| panic!("{found:?}"));
    assert!(axis.1 > 1.0 && axis.2.is_none(), "{axis:?}");
    println!("{notices:?}");
    for (_, amount, fade) in &found {
        assert!(
            fade.is_none_or(|fade| (1.0..=55.0).contains(&fade)),
            "{amount} {fade:?}"
        );
    }
    // Control points have a setting of that name with another meaning.
    let mut points = about_origin("points", 60.0, &[]);
    points.parameters.0.insert(
        "pairs".to_owned(),
        Argument::Numbers(vec![0.0, 0.0, 0.0, 20.0, 0.0, 0.0]),
    );
    points.parameters.insert("method", "rbf");
    points.parameters.insert("width", 200.0f32);
    points.parameters.insert("fade", 0.0f32);
    let (found, notices) = tears(&[points]);
    println!("{found:?} {notices:?}");
    assert!(found.iter().all(|t| t.2.is_none()) && !found.is_empty());
    assert!(notices.iter().all(|n| !n.contains("fade =")), "{notices:?}");
}
