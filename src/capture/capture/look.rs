//! Looks at one photograph.

use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use crate::image::{Header, Image, ImageError, Linear, Srgb, Unread, read_header, srgb_to_linear};

use super::budget::DecodeBudget;
use super::entries::Entry;
use super::photograph::{Assessment, CaptureView, CaptureWarning};
use super::preparation::{Kind, Preparation};
use super::prepared::PreparedImage;
use super::print::Print;
use super::watch::{Look, Watch};
use super::white_balances::WhiteBalances;

/// Long side at which photographs are assessed, px: decoding dominates, so this is enough.
pub const ASSESSED_SIDE: usize = 320;

/// Photographs decoded at a time. Each takes its full size in 8 or 16 bit; the budget limits the
/// total.
const DECODED_AT_ONCE: usize = 2;

/// Smallest side of a photograph: below it COLMAP finds hardly any features.
const SMALLEST_SIDE: usize = 64;

/// A mean V below this share of white, sRGB, leaves only a few grey levels in an 8-bit file.
const DARK_MEAN_V: f32 = 0.02;

/// A photograph whose sharpness is below this share of the capture's median is reported as blurred.
const BLURRED_SHARE: f32 = 0.35;
/// Measurements of one photograph.
pub(super) struct Seen {
    pub(super) header: Header,
    /// blake3 of the small picture: equal pictures have equal hashes in any file format.
    pub(super) picture: [u8; 32],
    /// The same picture, to compare with others.
    pub(super) print: Print,
    /// Mean V, sRGB, 0 to 1.
    pub(super) mean_v: f32,
    /// Gradient energy relative to brightness: comparable within one capture only.
    pub(super) sharpness: f32,
    /// The image that the pipeline reads; none if it could not be written.
    pub(super) prepared: Option<PreparedImage>,
}

/// Why a photograph is not used.
pub(super) struct Fault {
    reason: String,
    unsupported_format: bool,
    header: Option<Box<Header>>,
}

impl Fault {
    pub(super) fn of(reason: String) -> Self {
        Self { reason, unsupported_format: false, header: None }
    }

    pub(super) fn assessment(self, entry: &Entry) -> Assessment {
        Assessment {
            unsupported_format: self.unsupported_format,
            width: self.header.as_ref().map_or(0, |header| header.width),
            height: self.header.as_ref().map_or(0, |header| header.height),
            focal_px: self.header.and_then(|header| header.focal_px),
            ..Assessment::refused(entry.name().to_string(), self.reason)
        }
    }
}

impl From<ImageError> for Fault {
    fn from(error: ImageError) -> Self {
        let reason = match &error {
            // The path would be one of ours.
            ImageError::Io { source, .. } if source.kind() == ErrorKind::NotFound => {
                "a link that leads nowhere".to_owned()
            }
            ImageError::Io { source, .. } => format!("cannot be read: {source}"),
            error => error.to_string(),
        };
        Self { unsupported_format: error.is_unsupported_format(), ..Self::of(reason) }
    }
}

/// What looks at the photographs of one capture.
pub(super) struct Assessor<'a> {
    budget: DecodeBudget,
    tell: &'a (dyn Fn(Look<'_>) + Sync),
    preparation: &'a Preparation,
    white_balances: WhiteBalances,
    /// The first failure to write a prepared image.
    failure: Mutex<Option<io::Error>>,
}

impl<'a> Assessor<'a> {
    /// Requests the memory for the largest photographs of `all`.
    pub(super) fn open<'b>(
        watch: &Watch<'a>,
        preparation: &'a Preparation,
        all: impl Iterator<Item = &'b Entry>,
    ) -> Self {
        let read = |entry: &Entry| watched(watch.tell, entry, || read_header(&entry.file)).ok();
        let headers: Vec<Header> = all.filter_map(read).collect();
        let mut bytes: Vec<u64> = headers.iter().map(|header| header.decoded_bytes).collect();
        bytes.sort_unstable_by(|a, b| b.cmp(a));
        let largest = bytes.iter().take(DECODED_AT_ONCE).sum();
        Self {
            budget: (watch.lend)(largest),
            tell: watch.tell,
            preparation,
            white_balances: WhiteBalances::of(headers.iter().filter_map(|h| h.raw.as_ref())),
            failure: Mutex::new(None),
        }
    }

    /// The first failure to write a prepared image.
    pub(super) fn into_failure(self) -> Option<io::Error> {
        self.failure.into_inner().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks at every photograph.
    pub(super) fn look_at_all(&self, photographs: &[Entry]) -> Vec<Result<Seen, Fault>> {
        let all = photographs.par_iter().enumerate();
        on_few_threads(|| all.map(|(index, one)| self.look_at(index, one)).collect())
    }

    fn header(&self, entry: &Entry) -> Result<Header, ImageError> {
        watched(self.tell, entry, || read_header(&entry.file))
    }

    /// Runs work that decodes a picture, once there is memory for it and the same again for one
    /// plane.
    pub(super) fn decoding<T>(
        &self,
        entry: &Entry,
        work: impl FnOnce() -> Result<T, ImageError>,
    ) -> Result<T, ImageError> {
        let header = self.header(entry)?;
        let plane = (header.width * header.height) as u64;
        let _share = self.budget.take(header.decoded_bytes.saturating_add(plane));
        watched(self.tell, entry, work)
    }

    /// The small picture, once there is memory to decode it, and the prepared one of this name.
    fn small(
        &self,
        entry: &Entry,
        header: &Header,
        (kind, name): (Kind, &str),
    ) -> Result<(Image<Srgb>, Option<PreparedImage>), ImageError> {
        let _share = self.budget.take(header.decoded_bytes);
        let white_balance = header.raw.as_ref().and_then(|raw| self.white_balances.of_camera(raw));
        let decode = || Image::load_balanced(&entry.file, self.preparation.side, white_balance);
        let image = watched(self.tell, entry, decode)?;
        let (width, height) = image.size_at_most(ASSESSED_SIDE);
        let small = image.resize_area(width, height).to_srgb();
        Ok((small, self.written(self.preparation.write(&image, kind, name))))
    }

    /// A prepared image; notes a failure to write it.
    fn written(&self, outcome: io::Result<PreparedImage>) -> Option<PreparedImage> {
        let written = outcome.map_err(|error| {
            self.failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        });
        written.ok()
    }

    /// Longest side of prepared images, px.
    pub(super) fn prepared_side(&self) -> usize {
        self.preparation.side
    }

    /// The image of a photograph that became this view.
    pub(super) fn named(
        &self,
        image: Option<PreparedImage>,
        kind: Kind,
        name: &str,
    ) -> Option<PreparedImage> {
        self.written(image?.rename(kind.file(name)))
    }

    /// Writes how much each pixel of photograph `index` counts.
    pub(super) fn prepared_mask(
        &self,
        index: usize,
        shares: &Image<Linear>,
    ) -> Option<PreparedImage> {
        self.written(self.preparation.write(shares, Kind::Mask, &unnamed(index)))
    }

    fn look_at(&self, index: usize, entry: &Entry) -> Result<Seen, Fault> {
        if let Some(bytes) = entry.too_large {
            let unread = Unread::named(Path::new(entry.path.name())).map(ImageError::Unread);
            return Err(unread.unwrap_or(ImageError::TooManyBytes { bytes }).into());
        }
        let header = self.header(entry)?;
        let reject = |reason: String| {
            Err(Fault { header: Some(Box::new(header.clone())), ..Fault::of(reason) })
        };
        if header.width.min(header.height) < SMALLEST_SIDE {
            return reject(format!(
                "{} x {} px: each side must have at least {SMALLEST_SIDE}",
                header.width, header.height
            ));
        }
        let (small, prepared) = match self.small(entry, &header, (Kind::View, &unnamed(index))) {
            Ok(small) => small,
            Err(error) => {
                return Err(Fault { header: Some(Box::new(header)), ..Fault::from(error) });
            }
        };
        (self.tell)(Look::Seen(entry.name().as_str(), &entry.file, &small));
        let bytes: Vec<u8> = small.data().iter().flat_map(|v| v.to_le_bytes()).collect();
        let v = small.pixels();
        let mean_v = (0..v).map(|i| largest(&small, i)).sum::<f32>() / v as f32;
        // Light of a raw file may be below black, that of a wide gamut above white.
        let mean_v = mean_v.clamp(0.0, 1.0);
        let (low, high) =
            small.data().iter().fold((f32::MAX, f32::MIN), |(l, h), &v| (l.min(v), h.max(v)));
        if high - low < 1.5 / 255.0 {
            prepared.iter().for_each(PreparedImage::remove);
            let colour = if high < 1.5 / 255.0 { "black" } else { "one colour" };
            return reject(format!("nothing is seen: the whole picture is {colour}"));
        }
        let sharpness = sharpness(&small);
        let (picture, print) = (*blake3::hash(&bytes).as_bytes(), Print::of(&small));
        Ok(Seen { header, picture, print, mean_v, sharpness, prepared })
    }

    /// The views with ground truth among `find`'s results. It is prepared if its proportions match
    /// the view's within 1 % and it is intact: a broken file must fail now, not when the scene is
    /// measured.
    pub(super) fn truths<'b>(
        &self,
        views: &[CaptureView],
        find: impl Fn(&CaptureView) -> Option<&'b Entry> + Sync,
    ) -> Vec<Option<Option<PreparedImage>>> {
        let look = |view| find(view).map(|entry| self.truth(view, entry));
        on_few_threads(|| views.par_iter().map(look).collect())
    }

    fn truth(&self, view: &CaptureView, entry: &Entry) -> Option<PreparedImage> {
        let header = self.header(entry).ok()?;
        let ratio = (header.width * view.height) as f64 / (header.height * view.width) as f64;
        if (ratio - 1.0).abs() >= 0.01 {
            return None;
        }
        self.small(entry, &header, (Kind::GroundTruth, &view.name)).ok()?.1
    }
}

/// The name of a photograph's images until the photograph is accepted as a view. No view's name
/// begins with a dot.
fn unnamed(index: usize) -> String {
    format!(".{index:05}")
}

/// Runs the work on a photograph and reports its beginning and end.
fn watched<T>(tell: &dyn Fn(Look<'_>), entry: &Entry, work: impl FnOnce() -> T) -> T {
    let name = entry.name();
    tell(Look::Begins(name.as_str()));
    let done = work();
    tell(Look::Ended(name.as_str()));
    done
}

/// Runs parallel work on few enough threads to bound the memory of decoded photographs.
pub fn on_few_threads<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(DECODED_AT_ONCE).build() {
        Ok(pool) => pool.install(work),
        // No dedicated threads available: use the shared ones.
        Err(_) => work(),
    }
}

fn largest(image: &Image<Srgb>, i: usize) -> f32 {
    image.plane(0)[i].max(image.plane(1)[i]).max(image.plane(2)[i])
}

/// Mean squared gradient of linear luma over the squared mean: independent of exposure. At a
/// long side of 320 px most of the noise is averaged away in photographs of usual size.
fn sharpness(small: &Image<Srgb>) -> f32 {
    let luma: Vec<f32> = small.luma().into_iter().map(srgb_to_linear).collect();
    let (width, height) = (small.width(), small.height());
    let mean = (luma.iter().sum::<f32>() / luma.len() as f32).max(1e-6);
    let mut energy = 0.0;
    for y in 0..height - 1 {
        for x in 0..width - 1 {
            let here = luma[y * width + x];
            let (dx, dy) = (luma[y * width + x + 1] - here, luma[(y + 1) * width + x] - here);
            energy += f64::from(dx * dx + dy * dy);
        }
    }
    energy as f32 / luma.len() as f32 / (mean * mean)
}

impl Seen {
    /// The photograph, unless it has a fault; then its prepared image is removed.
    pub(super) fn unless(self, fault: Option<Fault>) -> Result<Self, Fault> {
        let Some(fault) = fault else { return Ok(self) };
        self.prepared.iter().for_each(PreparedImage::remove);
        Err(fault)
    }

    /// Warnings about it, given the capture's median sharpness.
    pub(super) fn warnings(&self, typical_sharpness: f32) -> Vec<CaptureWarning> {
        let mut warnings = Vec::new();
        if let Some(transfer) = self.header.hdr {
            let message = format!("it is HDR ({transfer}) and was tone-mapped to sRGB");
            warnings.push(CaptureWarning::new("hdr", message));
        }
        if let Some(reason) = &self.header.profile_fault {
            let message = format!(
                "its colour profile is not used ({reason}): its values are taken as sRGB's"
            );
            warnings.push(CaptureWarning::new("profile", message));
        }
        if let Some(reader) = self.header.raw.as_ref().and_then(|raw| raw.reader.as_ref()) {
            let message = format!("it was read by {reader}, which cuts noise at black");
            warnings.push(CaptureWarning::new("libraw", message));
        }
        if self.mean_v < DARK_MEAN_V {
            let levels = self.mean_v * 255.0;
            warnings.push(CaptureWarning::new(
                "dark",
                format!("very dark: the mean level is {levels:.1} of 255, most detail is noise"),
            ));
        }
        if self.sharpness < BLURRED_SHARE * typical_sharpness {
            let share = 100.0 * self.sharpness / typical_sharpness;
            warnings.push(CaptureWarning::new(
                "blurred",
                format!("much more blurred than the others: {share:.0} % of the usual sharpness"),
            ));
        }
        warnings
    }
}
