//! Clips: frames as one animated file, as a video, or as a folder of pictures.
//!
//! An animated PNG keeps every pixel and its alpha. A GIF holds 256 colours per frame, pixels that
//! are either opaque or transparent, and delays in hundredths of a second; it is for viewers that
//! support nothing else. A video needs an external encoder: frames are piped into the program
//! `ffmpeg`, if it is installed. A folder of pictures is for further processing by other programs.
//!
//! As with any output, no partial file is left behind, whether the work is cancelled or a frame
//! fails.

use crate::files::OutputFile;
use crate::files::unfinished::PartFolder;
use crate::{Error, Result, Watch};
use image::codecs::gif::{GifEncoder, Repeat};
use image::codecs::png::PngEncoder;
use image::{Delay, ExtendedColorType, ImageEncoder, ImageError, RgbaImage};
use std::ffi::OsString;
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::Path;
use std::process::{ChildStdin, Command, Stdio};

/// Fewest and most frames per second.
const FRAMES_PER_SECOND: [f32; 2] = [0.1, 240.0];
/// Viewers treat a delay of less than two hundredths of a second as an error and show a tenth.
const MAX_GIF_FRAMES_PER_SECOND: f64 = 50.0;
/// Most frames of a clip.
const MAX_FRAMES: usize = 100_000;
/// Effort of the search for a GIF's colours, from 1 (best) to 30 (fastest).
const GIF_SPEED: i32 = 10;
/// Longest part of ffmpeg's error output that is quoted, characters.
const LONGEST_QUOTE: usize = 400;

/// The output format of a clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClipFormat {
    /// Animated GIF: 256 colours per frame, no partial alpha.
    Gif,
    /// Animated PNG: exact.
    Apng,
    /// A folder of numbered PNG files: exact.
    Frames,
    /// H.264 in MP4, over black, by `ffmpeg`.
    Mp4,
}

impl ClipFormat {
    /// The format for a path's extension: `.gif`, `.png` or `.apng`, `.mp4`; no extension, or an
    /// existing folder, gives numbered pictures.
    ///
    /// # Errors
    /// Any other extension.
    pub fn of(path: &Path) -> Result<Self> {
        let Some(ending) = path.extension().filter(|_| !path.is_dir()) else {
            return Ok(Self::Frames);
        };
        match ending.to_string_lossy().to_lowercase().as_str() {
            "gif" => Ok(Self::Gif),
            "png" | "apng" => Ok(Self::Apng),
            "mp4" => Ok(Self::Mp4),
            _ => Err(Error::file(
                path,
                "does not name a clip format; use .gif, .png or .apng, .mp4, or no extension for a folder of frames",
            )),
        }
    }
}

/// A clip being written.
struct Clip<'a> {
    path: &'a Path,
    size: [u32; 2],
    frames_per_second: f64,
    count: usize,
    frame: &'a mut dyn FnMut(usize) -> Result<Vec<u8>>,
    watch: &'a Watch<'a>,
}

/// Writes a clip of `count` frames of `size` (width and height, pixels) in the format of the path's
/// extension. `frame(n)` returns frame n, counted from 0, as 8-bit RGBA, not premultiplied, rows
/// from the top; frames are requested once and in order. The watch receives the fraction of frames
/// done and is checked before every frame.
///
/// # Errors
/// An unknown extension; a size, number or rate of frames that is out of range; a folder of frames
/// that exists and is not empty; a destination that cannot be written; no `ffmpeg` for a video;
/// errors from `frame`; [`Error::Cancelled`].
pub fn write(
    path: &Path,
    size: [u32; 2],
    frames_per_second: f32,
    count: usize,
    frame: &mut dyn FnMut(usize) -> Result<Vec<u8>>,
    watch: &Watch,
) -> Result<()> {
    let format = ClipFormat::of(path)?;
    let [least, most] = FRAMES_PER_SECOND;
    if !(least..=most).contains(&frames_per_second) {
        return Err(Error::value(
            "frames per second",
            format!("{frames_per_second} is outside {least} to {most}"),
        ));
    }
    if !(1..=MAX_FRAMES).contains(&count) {
        return Err(Error::value(
            "frames",
            format!("a clip of {count} frames cannot be made; it has 1 to {MAX_FRAMES}"),
        ));
    }
    if size.contains(&0) {
        return Err(Error::value(
            "size",
            format!(
                "{} x {} is not a valid clip size; each edge must be at least 1 pixel",
                size[0], size[1]
            ),
        ));
    }
    let mut clip = Clip {
        path,
        size,
        frames_per_second: f64::from(frames_per_second),
        count,
        frame,
        watch,
    };
    match format {
        ClipFormat::Gif => clip.gif(),
        ClipFormat::Apng => clip.apng(),
        ClipFormat::Frames => clip.folder(),
        ClipFormat::Mp4 => clip.mp4(),
    }
}

impl Clip<'_> {
    /// Renders a frame, unless the work was cancelled.
    fn frame(&mut self, n: usize) -> Result<Vec<u8>> {
        self.watch.check()?;
        let rgba = (self.frame)(n)?;
        let [width, height] = self.size;
        if rgba.len() as u64 != 4 * u64::from(width) * u64::from(height) {
            let problem = format!(
                "has {} bytes, which is not {width} x {height} pixels of RGBA",
                rgba.len()
            );
            return Err(Error::value(format!("frame {}", n + 1), problem));
        }
        (self.watch.progress)((n + 1) as f32 / self.count as f32);
        Ok(rgba)
    }

    fn gif(&mut self) -> Result<()> {
        if self.frames_per_second > MAX_GIF_FRAMES_PER_SECOND {
            let problem = format!(
                "{} is too many for a GIF; use at most {MAX_GIF_FRAMES_PER_SECOND}, or .png",
                self.frames_per_second
            );
            return Err(Error::value("frames per second", problem));
        }
        let path = self.path;
        let failed = |e: ImageError| encoding(path, "GIF", e);
        OutputFile::create(path)?.finish_with(|file| {
            let mut encoder = GifEncoder::new_with_speed(file, GIF_SPEED);
            encoder.set_repeat(Repeat::Infinite).map_err(failed)?;
            for n in 0..self.count {
                let mut rgba = self.frame(n)?;
                all_or_nothing(&mut rgba);
                let delay = Delay::from_numer_denom_ms(10 * hundredths(n, self.frames_per_second), 1);
                let picture = RgbaImage::from_raw(self.size[0], self.size[1], rgba)
                    .ok_or_else(|| Error::file(path, "has a frame without pixels"))?;
                encoder
                    .encode_frame(image::Frame::from_parts(picture, 0, 0, delay))
                    .map_err(failed)?;
            }
            Ok(())
        })
    }

    fn apng(&mut self) -> Result<()> {
        let path = self.path;
        let failed = |e: png::EncodingError| match e {
            png::EncodingError::IoError(e) => Error::io(path, "writing", e),
            e => Error::file(path, format!("could not be encoded as animated PNG: {e}")),
        };
        let (numerator, denominator) = seconds(self.frames_per_second);
        OutputFile::create(path)?.finish_with(|file| {
            let mut encoder = png::Encoder::new(file, self.size[0], self.size[1]);
            encoder.set_color(png::ColorType::Rgba);
            encoder.set_depth(png::BitDepth::Eight);
            // Zero plays means endless looping.
            encoder.set_animated(self.count as u32, 0).map_err(failed)?;
            encoder.set_frame_delay(numerator, denominator).map_err(failed)?;
            encoder.validate_sequence(true);
            let mut writer = encoder.write_header().map_err(failed)?;
            for n in 0..self.count {
                let rgba = self.frame(n)?;
                writer.write_image_data(&rgba).map_err(failed)?;
            }
            writer.finish().map_err(failed)
        })
    }

    /// The folder is filled under a temporary name and renamed at the end.
    fn folder(&mut self) -> Result<()> {
        let path = self.path;
        if path.is_dir() {
            let mut entries = std::fs::read_dir(path).map_err(|e| Error::io(path, "reading", e))?;
            if entries.next().is_some() {
                return Err(Error::file(
                    path,
                    "is a folder that is not empty; name a new one for the frames",
                ));
            }
        } else if path.exists() {
            return Err(Error::file(
                path,
                "is a file; name a new folder for the frames, or a clip with an ending (.gif, .png, .mp4)",
            ));
        }
        let beside = path
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let folder = PartFolder::in_folder(beside).map_err(|e| Error::io(path, "making", e))?;
        let digits = self.count.to_string().len().max(4);
        for n in 0..self.count {
            let rgba = self.frame(n)?;
            let mut bytes = Vec::new();
            PngEncoder::new(&mut bytes)
                .write_image(&rgba, self.size[0], self.size[1], ExtendedColorType::Rgba8)
                .map_err(|e| encoding(path, "PNG", e))?;
            let file = format!("frame-{:0digits$}.png", n + 1);
            std::fs::write(folder.path().join(&file), &bytes)
                .map_err(|e| Error::io(&path.join(&file), "writing", e))?;
        }
        folder.persist(path).map_err(|e| Error::io(path, "writing", e))
    }

    fn mp4(&mut self) -> Result<()> {
        OutputFile::create(self.path)?.finish_by_path(|file| self.encoded(file))
    }

    /// Writes a video into a file with ffmpeg.
    fn encoded(&mut self, file: &Path) -> Result<()> {
        let path = self.path;
        let writing = |e: std::io::Error| Error::io(path, "writing", e);
        // A pipe without a reader would fill up and block ffmpeg; its stderr goes to a file
        // instead.
        let mut stderr_file = tempfile::tempfile().map_err(writing)?;
        let [width, height] = self.size;
        let size = format!("{width}x{height}");
        let rate = self.frames_per_second.to_string();
        // The prefix keeps ffmpeg from taking the path for an option or a URL.
        let mut target = OsString::from("file:");
        target.push(file.as_os_str());
        let mut ffmpeg = Command::new("ffmpeg")
            .args(["-hide_banner", "-loglevel", "error", "-y"])
            .args([
                "-f", "rawvideo", "-pix_fmt", "rgba", "-s", &size, "-r", &rate, "-i", "-",
            ])
            // Chroma has half the resolution, so both edges must be even.
            .args([
                "-vf",
                "pad=ceil(iw/2)*2:ceil(ih/2)*2",
                "-pix_fmt",
                "yuv420p",
                "-movflags",
                "+faststart",
                "-f",
                "mp4",
            ])
            .arg(target)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::from(stderr_file.try_clone().map_err(writing)?))
            .spawn()
            .map_err(|e| match e.kind() {
                ErrorKind::NotFound => Error::file(
                    path,
                    "needs the program ffmpeg, which is not there; install it, or choose .gif or .png",
                ),
                _ => Error::io(Path::new("ffmpeg"), "starting", e),
            })?;
        let fed = match ffmpeg.stdin.take() {
            Some(pipe) => self.feed(pipe),
            None => Ok(false),
        };
        if fed.is_err() {
            // It may already have exited.
            let _ = ffmpeg.kill();
        }
        let status = ffmpeg
            .wait()
            .map_err(|e| Error::io(Path::new("ffmpeg"), "waiting for it", e))?;
        if !(fed? && status.success()) {
            let mut words = Vec::new();
            stderr_file
                .rewind()
                .and_then(|()| stderr_file.read_to_end(&mut words))
                .map_err(writing)?;
            let words: String = String::from_utf8_lossy(&words)
                .trim()
                .chars()
                .take(LONGEST_QUOTE)
                .collect();
            return Err(Error::file(
                path,
                format!("ffmpeg failed ({status}): {words}; choose .gif or .png"),
            )
            .printable());
        }
        Ok(())
    }

    /// Sends all frames; false if ffmpeg stopped reading, in which case its stderr gives the
    /// reason.
    fn feed(&mut self, mut pipe: ChildStdin) -> Result<bool> {
        for n in 0..self.count {
            let mut rgba = self.frame(n)?;
            over_black(&mut rgba);
            match pipe.write_all(&rgba) {
                Ok(()) => (),
                Err(e) if e.kind() == ErrorKind::BrokenPipe => return Ok(false),
                Err(e) => return Err(Error::io(Path::new("ffmpeg"), "sending frames", e)),
            }
        }
        Ok(true)
    }
}

fn encoding(path: &Path, format: &str, error: ImageError) -> Error {
    match error {
        ImageError::IoError(e) => Error::io(path, "writing", e),
        e => Error::file(path, format!("could not be encoded as {format}: {e}")),
    }
}

/// Display time of frame n of a GIF, 1/100 s: whole numbers that sum to the time of all frames.
fn hundredths(n: usize, frames_per_second: f64) -> u32 {
    let end = |frames: usize| (100.0 * frames as f64 / frames_per_second).round() as u64;
    (end(n + 1) - end(n)) as u32
}

/// Display time of a frame of an animated PNG, as a fraction of a second.
fn seconds(frames_per_second: f64) -> (u16, u16) {
    let numerator: u16 = if frames_per_second * 1000.0 <= f64::from(u16::MAX) {
        1000
    } else {
        100
    };
    (
        numerator,
        (f64::from(numerator) * frames_per_second).round() as u16,
    )
}

/// Makes pixels with alpha below one half transparent and all others opaque.
fn all_or_nothing(rgba: &mut [u8]) {
    for pixel in rgba.chunks_exact_mut(4) {
        if pixel[3] < 128 {
            pixel.fill(0);
        } else {
            pixel[3] = 255;
        }
    }
}

/// Composites over black, since a video has no alpha.
fn over_black(rgba: &mut [u8]) {
    for pixel in rgba.chunks_exact_mut(4) {
        let alpha = u16::from(pixel[3]);
        for c in &mut pixel[..3] {
            *c = ((u16::from(*c) * alpha + 127) / 255) as u8;
        }
        pixel[3] = 255;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::AnimationDecoder;
    use image::codecs::gif::GifDecoder;
    use image::codecs::png::PngDecoder;
    use std::io::Cursor;
    use std::sync::atomic::{AtomicBool, Ordering};

    const SIZE: [u32; 2] = [8, 6];

    fn pixels(n: usize) -> Vec<u8> {
        let pixel = |p: usize| {
            [
                (40 * n + p) as u8,
                (p * 5) as u8,
                100,
                if p % 7 == n { 0 } else { 255 },
            ]
        };
        (0..48).flat_map(pixel).collect()
    }

    fn write_three(path: &Path, frames_per_second: f32) -> Result<()> {
        write(
            path,
            SIZE,
            frames_per_second,
            3,
            &mut |n| Ok(pixels(n)),
            &Watch::NONE,
        )
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn an_animated_png_is_exact() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clip.png");
        write_three(&path, 25.0).unwrap();
        let decoder = PngDecoder::new(Cursor::new(std::fs::read(&path).unwrap()))
            .unwrap()
            .apng()
            .unwrap();
        let frames = decoder.into_frames().collect_frames().unwrap();
        assert_eq!(frames.len(), 3);
        for (n, frame) in frames.iter().enumerate() {
            assert_eq!(frame.delay().numer_denom_ms(), (40, 1));
            assert_eq!(frame.buffer().dimensions(), (8, 6));
            assert_eq!(frame.buffer().as_raw(), &pixels(n), "frame {n}");
        }
    }

    /// Frames of fewer than 256 colours are stored exactly.
    #[test]
    fn a_gif_has_its_frames() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clip.GIF");
        write_three(&path, 25.0).unwrap();
        let frames = GifDecoder::new(Cursor::new(std::fs::read(&path).unwrap()))
            .unwrap()
            .into_frames()
            .collect_frames()
            .unwrap();
        assert_eq!(frames.len(), 3);
        for (n, frame) in frames.iter().enumerate() {
            assert_eq!(frame.delay().numer_denom_ms(), (40, 1));
            for (p, (shown, meant)) in frame.buffer().pixels().zip(pixels(n).chunks_exact(4)).enumerate() {
                assert_eq!(shown[3], meant[3], "frame {n}, pixel {p}");
                assert!(
                    meant[3] == 0 || shown.0 == *meant,
                    "frame {n}, pixel {p}: {shown:?}, not {meant:?}"
                );
            }
        }
        assert!(
            write_three(&path, 60.0).is_err(),
            "a GIF faster than viewers show"
        );
    }

    #[test]
    fn a_folder_has_a_file_for_every_frame() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames");
        write_three(&path, 25.0).unwrap();
        assert_eq!(
            names(&path),
            ["frame-0001.png", "frame-0002.png", "frame-0003.png"]
        );
        let second = image::load_from_memory(&std::fs::read(path.join("frame-0002.png")).unwrap()).unwrap();
        assert_eq!(second.into_rgba8().into_raw(), pixels(1));
        assert!(write_three(&path, 25.0).is_err(), "frames over others");
        let empty = folder.path().join("empty.one");
        std::fs::create_dir(&empty).unwrap();
        write_three(&empty, 25.0).unwrap();
        assert_eq!(names(&empty).len(), 3);
        assert_eq!(names(folder.path()), ["empty.one", "frames"]);
    }

    #[test]
    fn what_is_stopped_or_fails_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["clip.gif", "clip.apng", "frames"] {
            let path = folder.path().join(name);
            let stop = AtomicBool::new(false);
            let watch = Watch {
                progress: &|_| (),
                cancel: &stop,
            };
            let mut frame_count = 0;
            let stopped = write(
                &path,
                SIZE,
                25.0,
                3,
                &mut |n| {
                    frame_count += 1;
                    stop.store(n == 1, Ordering::Relaxed);
                    Ok(pixels(n))
                },
                &watch,
            );
            assert!(
                matches!(stopped, Err(Error::Cancelled)) && frame_count == 2,
                "{name}: {stopped:?}"
            );
            let frame = |n: usize| {
                if n == 2 {
                    Err(Error::value("frame", "none"))
                } else {
                    Ok(pixels(n))
                }
            };
            assert!(
                write(&path, SIZE, 25.0, 3, &mut |n| frame(n), &Watch::NONE).is_err(),
                "{name}"
            );
            assert!(
                write(&path, SIZE, 25.0, 3, &mut |_| Ok(vec![0; 7]), &Watch::NONE).is_err(),
                "{name}"
            );
            assert_eq!(names(folder.path()), [""; 0], "{name}");
        }
    }

    /// With and without ffmpeg installed.
    #[test]
    fn a_video_is_made_or_ffmpeg_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clip.mp4");
        match write_three(&path, 25.0) {
            Ok(()) => assert_eq!(&std::fs::read(&path).unwrap()[4..8], b"ftyp"),
            Err(e) => {
                assert!(
                    e.to_string().contains("ffmpeg") && e.to_string().contains(".gif or .png"),
                    "{e}"
                );
                assert_eq!(names(folder.path()), [""; 0]);
            }
        }
    }

    #[test]
    fn endings_name_formats() {
        for (path, format) in [
            ("a/b.gif", ClipFormat::Gif),
            ("b.PNG", ClipFormat::Apng),
            ("b.apng", ClipFormat::Apng),
            ("b.mp4", ClipFormat::Mp4),
        ] {
            assert_eq!(ClipFormat::of(Path::new(path)).unwrap(), format, "{path}");
        }
        assert_eq!(
            ClipFormat::of(Path::new("no/such/frames")).unwrap(),
            ClipFormat::Frames
        );
        for path in ["a.webm", "a.jpg", "a.b.c"] {
            assert!(
                ClipFormat::of(Path::new(path)).is_err_and(|e| e.to_string().contains(".gif")),
                "{path}"
            );
        }
    }

    #[test]
    fn what_is_no_clip_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("clip.png");
        let write = |size, rate, count| write(&path, size, rate, count, &mut |n| Ok(pixels(n)), &Watch::NONE);
        assert!(
            write([0, 6], 25.0, 3).is_err()
                && write(SIZE, 0.0, 3).is_err()
                && write(SIZE, f32::NAN, 3).is_err()
                && write(SIZE, 25.0, 0).is_err()
        );
        assert_eq!(names(folder.path()), [""; 0]);
    }

    #[test]
    fn delays_add_up() {
        assert_eq!((0..30).map(|n| hundredths(n, 30.0)).sum::<u32>(), 100);
        assert!((0..1000).all(|n| hundredths(n, 50.0) == 2 && hundredths(n, 48.0) >= 2));
        for rate in [0.1, 1.0, 29.97, 30.0, 60.0, 120.0, 240.0] {
            let (numerator, denominator) = seconds(rate);
            assert!(
                (f64::from(denominator) / f64::from(numerator) - rate).abs() < 1e-9,
                "{rate}: {numerator}/{denominator}"
            );
        }
    }

    #[test]
    fn alpha_is_taken_away() {
        let pixels = [200, 100, 0, 128, 200, 100, 0, 127, 7, 8, 9, 255];
        let (mut gif, mut video) = (pixels, pixels);
        all_or_nothing(&mut gif);
        over_black(&mut video);
        assert_eq!(gif, [200, 100, 0, 255, 0, 0, 0, 0, 7, 8, 9, 255]);
        assert_eq!(video, [100, 50, 0, 255, 100, 50, 0, 255, 7, 8, 9, 255]);
    }
}
