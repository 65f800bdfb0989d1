//! Comparison of pictures, and tests of the comparison itself: a comparison of a picture with
//! itself would always pass.

use incise::picture::Picture;

/// The difference of two pictures, premultiplied RGBA, all four channels.
#[derive(Debug)]
pub struct Difference {
    /// Mean over all channels of all pixels.
    pub mean: f64,
    /// Largest of any channel.
    pub max: f64,
    /// Fraction of pixels in which every channel differs by at most 4/255.
    pub within_4: f64,
    /// Peak signal-to-noise ratio, dB, peak 1.
    pub psnr: f64,
}

/// One 8-bit step.
pub const STEP: f64 = 1.0 / 255.0;

/// Compares two pictures of the same size.
///
/// Errors: different sizes, no pixels, values that are not finite, both pictures without any
/// content.
pub fn difference(a: &Picture, b: &Picture) -> Result<Difference, String> {
    if (a.width, a.height) != (b.width, b.height) || a.pixels.len() != b.pixels.len() {
        return Err("sizes differ".into());
    }
    if a.pixels.is_empty() {
        return Err("no pixels".into());
    }
    if a.pixels.iter().chain(&b.pixels).flatten().any(|v| !v.is_finite()) {
        return Err("a value is not finite".into());
    }
    if [a, b].iter().any(|p| p.pixels.iter().all(|q| q[3] == 0.0)) {
        return Err("a picture is empty".into());
    }
    let (mut sum, mut squares, mut max, mut within) = (0.0, 0.0, 0.0f64, 0usize);
    for (p, q) in a.pixels.iter().zip(&b.pixels) {
        let mut worst = 0.0f64;
        for c in 0..4 {
            let d = f64::from((p[c] - q[c]).abs());
            sum += d;
            squares += d * d;
            worst = worst.max(d);
        }
        max = max.max(worst);
        within += usize::from(worst <= 4.0 * STEP);
    }
    let n = a.pixels.len() as f64;
    Ok(Difference {
        mean: sum / (4.0 * n),
        max,
        within_4: within as f64 / n,
        psnr: -10.0 * (squares / (4.0 * n)).max(1e-30).log10(),
    })
}

fn gradient_picture() -> Picture {
    let pixels = (0..64 * 48).map(|n| {
        let (x, y) = ((n % 64) as f32 / 64.0, (n / 64) as f32 / 48.0);
        let alpha = 0.3 + 0.6 * (9.0 * x).sin().abs();
        [alpha * x, alpha * y, alpha * (x * y), alpha]
    });
    Picture {
        width: 64,
        height: 48,
        pixels: pixels.collect(),
    }
}

pub fn equal_pictures_are_equal() {
    let d = difference(&gradient_picture(), &gradient_picture()).unwrap();
    assert!(d.mean == 0.0 && d.max == 0.0 && d.within_4 == 1.0 && d.psnr > 200.0);
}

/// Differences that the comparison must reject, given the parity bound.
pub fn the_comparer_rejects() {
    let a = gradient_picture();
    let accepts = |b: &Picture| difference(&a, b).is_ok_and(|d| d.mean <= 0.5 * STEP && d.within_4 >= 0.999);
    assert!(accepts(&a));
    let mut shifted = a.clone();
    shifted.pixels.rotate_right(1);
    let mut alpha = a.clone();
    alpha.pixels.iter_mut().for_each(|p| p[3] *= 0.97);
    let mut swapped = a.clone();
    swapped.pixels.iter_mut().for_each(|p| p.swap(0, 1));
    let mut nan = a.clone();
    nan.pixels[77][2] = f32::NAN;
    let empty = Picture {
        pixels: vec![[0.0; 4]; a.pixels.len()],
        ..a.clone()
    };
    let other = Picture {
        width: 48,
        height: 64,
        ..a.clone()
    };
    for (name, b) in [
        ("shift", shifted),
        ("alpha", alpha),
        ("channels", swapped),
        ("NaN", nan),
        ("empty", empty),
        ("size", other),
    ] {
        assert!(!accepts(&b), "{name} was accepted");
    }
}
